"""Obstacles, ways round them, gaits to choose from, and robots that are led round obstacles."""

import re
from dataclasses import replace

import jax
import numpy as np
import pytest

import jaxgrity
from jaxgrity import Cylinder, InputError, Slope, SolverOptions, Union, control
from jaxgrity.control import CAUTIOUS, Discs, PhaseLocked, Sampling
from jaxgrity.control.plant import scenes_of
from jaxgrity.control.predictive import arrivals
from jaxgrity.control.samples import costs
from jaxgrity.control.tasks import REACHED, at_size

ARENA = (-2.0, -4.0, 12.0, 4.0)
NOTHING = Discs(np.zeros((0, 2)), np.zeros(0))
NEAR = CAUTIOUS._replace(samples=6, interval=0.5, horizon=1.5, patience=6.0)
"""what serves several tests by the same programs, with two frictions"""


@pytest.fixture(scope="module")
def scene():
    return jaxgrity.load_scene("exact")


def test_a_way_round_a_disc_is_as_long_as_a_taut_string():
    """Two tangents and an arc about the disc and the robot's reach; 3 % longer, in 16 directions and beyond comfort."""
    way = control.way_map(
        Discs(np.array([[5.0, 0.0]]), np.array([1.0])), np.array([10.0, 0.0]), ARENA, comfort=1e-6, spacing=0.05
    )
    radius, far = 1.6, 5.0
    tangent = np.sqrt(far**2 - radius**2)
    taut = 2 * tangent + radius * (np.pi - 2 * np.arctan2(tangent, radius))
    (length,) = way.to_go(np.zeros((1, 2)))
    assert taut <= length <= 1.03 * taut
    points = way.way(np.zeros(2))
    np.testing.assert_allclose(points[-1], [10.0, 0.0], atol=0.05)
    assert control.room(way.discs, points).min() > 0.6
    assert np.linalg.norm(np.diff(points, axis=0), axis=1).sum() == pytest.approx(length, rel=1e-6)


@pytest.mark.parametrize("spacing", [0.3, 0.1])
def test_a_way_keeps_the_reach_between_its_points_too(spacing):
    """Past a thin post, where a step of the grid would cut the corner between two points that are clear of it."""
    post = Discs(np.array([[5.0, 0.05]]), np.array([0.01]))
    way = control.way_map(post, np.array([10.0, 0.1]), ARENA, comfort=1e-6, spacing=spacing)
    for start in ([0.1, 0.1], [0.1, -1.1], [4.9, 0.7], [5.2, -0.8]):
        points = way.way(np.array(start))
        between = np.linspace(points[1:-1], points[2:], 200).reshape(-1, 2)
        assert control.room(post, between).min() >= 0.6
        np.testing.assert_allclose(points[-1], [10.0, 0.1], atol=spacing)


def test_comfort_keeps_ways_away_from_obstacles():
    """With comfort the way leaves more room where there is plenty."""
    disc, goal = Discs(np.array([[5.0, 0.0]]), np.array([1.0])), np.array([10.0, 0.0])
    rooms = [
        control.room(disc, control.way_map(disc, goal, ARENA, comfort=comfort).way(np.zeros(2))).min()
        for comfort in (1e-6, 0.8)
    ]
    assert rooms[1] > rooms[0] + 0.3


def test_ways_and_goals_are_of_the_robots_size(scene):
    """A robot of 5 cm meets at 5 cm what one of a metre meets at a metre: maps, and when a goal counts as reached."""
    built = scene.structure
    struts = replace(built.struts, rest_length=0.05 * built.struts.rest_length)
    small = replace(scene, structure=replace(built, nodes=0.05 * built.nodes, struts=struts))
    disc, goal = Discs(np.array([[5.0, 0.0]]), np.array([1.0])), np.array([10.0, 0.0])
    tiny = Discs(0.05 * disc.centres, 0.05 * disc.radii)
    way = control.way_map(disc, goal, ARENA, robot=scene)
    less = control.way_map(tiny, 0.05 * goal, tuple(0.05 * side for side in ARENA), robot=small)
    places = np.array([[0.0, 0.0], [4.0, 2.0], [5.0, 0.0]])  # no way leads to the goal from the last
    np.testing.assert_allclose(less.to_go(0.05 * places), 0.05 * way.to_go(places), rtol=1e-6)
    assert at_size(None, REACHED, scene) == pytest.approx(0.3)
    assert at_size(None, REACHED, small) == pytest.approx(0.015)
    assert at_size(0.2, REACHED, small) == 0.2


def test_there_is_no_way_through_a_wall():
    """A row of discs from one side of the arena to the other; without it there is a way."""
    wall = Discs(np.stack([np.full(9, 5.0), np.linspace(-4, 4, 9)], axis=1), np.full(9, 0.4))
    blocked, free = (control.way_map(discs, np.array([10.0, 0.0]), ARENA) for discs in (wall, NOTHING))
    start = tuple(np.rint((np.zeros(2) - free.corner) / free.spacing).astype(int))
    assert np.isinf(blocked.distance[start])
    assert free.distance[start] == pytest.approx(10.0)
    assert len(blocked.way(np.zeros(2))) == 1


def test_the_gap_is_that_of_bodies_and_balls_too():
    """A payload without members, over a post beside the line between two of its points; balls stick out."""
    nodes = np.array([[0.0, 0, 0.1], [1.0, 0, 0.1], [0.5, 0.4, 0.1], [0.5, 0.2, 0.5]])
    body = jaxgrity.model.rigid_body(nodes, range(4), 1.0, [0.1, 0.1, 0.1])
    scene = jaxgrity.Scene(jaxgrity.Structure(nodes, np.zeros(4), bodies=(body,)), ground=jaxgrity.ExactGround())
    post = Discs(np.array([[0.5, -0.3]]), np.array([0.1]))
    assert control.gap(post, scene, nodes) == pytest.approx(0.2)
    balls = jaxgrity.model.Balls((0, 1), [0.3, 0.55])
    rolling = replace(scene, ground=jaxgrity.ExactGround(balls=balls))
    assert control.gap(post, rolling, nodes) == pytest.approx(np.hypot(0.5, 0.3) - 0.55 - 0.1)
    centre = nodes.mean(0)
    assert control.reach_of(rolling) == pytest.approx(np.linalg.norm(nodes[1] - centre) + 0.55)
    with pytest.raises(InputError, match=r"q has shape \(3, 3\); expected \(..., 4, 3\)"):
        control.gap(post, scene, nodes[:3])
    with pytest.raises(InputError, match="neither members nor bodies"):
        control.gap(post, jaxgrity.Scene(jaxgrity.Structure(nodes, np.ones(4))), nodes)


def test_the_gap_is_that_of_struts_with_their_radius():
    """A post beside the middle of a strut of six centimetres, of which the ends have no other thickness."""
    nodes = np.array([[-1.0, 0, 0.1], [1.0, 0, 0.1], [-1.0, 2.0, 0.1], [1.0, 2.0, 0.1]])
    struts = jaxgrity.Members(((0, 1), (2, 3)), None, [2.0, 2.0])
    thin = jaxgrity.Scene(jaxgrity.Structure(nodes, np.ones(4), struts), ground=jaxgrity.ExactGround())
    thick = jaxgrity.with_contact_along_struts(thin, 1, struts=(0,), radius=0.03)
    post = Discs(np.array([[0.2, 0.5], [0.2, 1.6]]), np.array([0.1, 0.1]))
    assert control.gap(post, thin, nodes) == pytest.approx(0.3)
    assert control.gap(Discs(post.centres[:1], post.radii[:1]), thick, nodes) == pytest.approx(0.37)
    assert control.gap(post, thick, nodes) == pytest.approx(0.3)


def test_outside_the_arena_it_is_further():
    """Nothing is gained by leaving it: a metre beyond its border counts more than one inside."""
    way = control.way_map(NOTHING, np.array([10.0, 0.0]), ARENA)
    inside, outside = way.to_go(np.array([[4.0, 4.0], [4.0, 5.0]]))
    assert outside > inside + 2
    assert way.to_go(np.array([4.0, 4.0])) == pytest.approx(inside)  # a place alone has no axis of places


def test_the_gap_is_that_of_members_not_of_nodes(scene):
    """A post beside the middle of a strut, beyond reach of both its ends; and one that the strut goes through."""
    q = np.asarray(scene.structure.nodes, float)
    i, j = scene.structure.struts.edges[0]
    middle, along = (q[i] + q[j])[:2] / 2, (q[i] - q[j])[:2]
    here = Discs(middle[None], np.array([0.05]))
    assert control.gap(here, scene, q) < 0
    assert np.linalg.norm(q[[i, j], :2] - middle, axis=1).min() > 0.05
    side = np.array([-along[1], along[0]]) / np.linalg.norm(along)
    far = q[:, :2] @ side
    beyond = Discs((middle + side * (far.max() - middle @ side + 0.3))[None], np.array([0.1]))
    assert control.gap(beyond, scene, q) == pytest.approx(0.2, abs=0.15)
    assert control.gap(beyond, scene, q) >= 0.2 - 1e-12
    assert control.gap(NOTHING, scene, q[None]).tolist() == [np.inf]


def test_obstacles_of_a_scene_are_discs(scene):
    """An upright post and a box, on a plane or on bumps; stairs are refused."""
    posts = Union((Slope(), Cylinder([2, 1, -1], [2, 1, 1], 0.3), jaxgrity.Box([4, 0, 0.4], [0.6, 0.8, 1.2])))
    found = control.discs_of(replace(scene.ground, surface=posts))
    np.testing.assert_allclose(found.centres, [[2, 1], [4, 0]])
    np.testing.assert_allclose(found.radii, [0.3, 0.5])
    lying = jaxgrity.Box([4, 0, 0.4], [0.6, 1.2, 0.8], np.array([np.pi / 2, 0, 0]))
    lies = control.discs_of(replace(scene.ground, surface=Union((Slope(), lying))))
    np.testing.assert_allclose(lies.radii, [0.5])
    bumpy = Union((jaxgrity.bumps(0.02, 0.8, 0), *posts.parts[1:]))
    np.testing.assert_array_equal(control.discs_of(replace(scene.ground, surface=bumpy)).centres, found.centres)
    within = Union((Slope(), Union(posts.parts[1:])))
    np.testing.assert_array_equal(control.discs_of(replace(scene.ground, surface=within)).radii, found.radii)
    with pytest.raises(InputError, match="Stairs is nothing to go round, nor to roll on"):
        control.discs_of(replace(scene.ground, surface=jaxgrity.Stairs(0.1, 0.3)))


def test_obstacles_of_ground_that_was_moved_are_where_it_is(scene):
    """As far along as it."""
    posts = Union((Slope(), Cylinder([2, 1, -1], [2, 1, 1], 0.3)))
    moved = replace(scene.ground, surface=posts, offset=np.array([0.5, -0.25, 0.1]))
    np.testing.assert_allclose(control.discs_of(moved).centres, [[2.5, 0.75]])
    assert moved.height([2.5], [0.75])[0] == pytest.approx(1.1)


def test_ways_are_as_wide_as_the_robot(scene):
    """A gate of 2 m lets a robot of one metre through, and none of two; a reach less than its own is refused."""
    gate = Discs(np.array([[4.0, 1.5], [4.0, -1.5]]), np.array([0.5, 0.5]))
    small, large = scene, replace(scene, structure=replace(scene.structure, nodes=2 * scene.structure.nodes))
    assert control.reach_of(small) == pytest.approx(np.sqrt(5) / 4)
    goal, arena = np.array([8.0, 0.0]), (-2.0, -1.9, 10.0, 1.9)
    through, not_through = (control.way_map(gate, goal, arena, robot=robot) for robot in (small, large))
    assert through.to_go(np.zeros(2)) == pytest.approx(8.0, rel=0.2)
    assert not_through.way(np.zeros(2)).shape == (1, 2)
    assert (through.reach, not_through.reach) == (control.reach_of(small), control.reach_of(large))
    assert control.way_map(gate, goal, arena).reach == 0.6
    with pytest.raises(InputError, match=r"reach = 0.6 m: the robot sticks out 1.12 m; expected at least that"):
        control.way_map(gate, goal, arena, robot=large, reach=0.6)


def test_gaits_to_choose_from_have_all_images_of_gaits_but_for_shifts_of_time(scene):
    """The travelling wave is its own image; of gaits that turn there are as many as ways to swap strut pairs."""
    gaits = {name: PhaseLocked(jaxgrity.load_gait(name)) for name in ("lasting", "left")}
    gaits["lasting"] = replace(gaits["lasting"], time_scale=0.5)
    found = control.gait_choices(scene.structure, gaits)
    assert found.names == ("lasting", *["left"] * (len(found.names) - 2), "rest")
    assert found.names.count("left") > 1
    assert found.policy.policy.time_scale.tolist() == [0.5, *[1.0] * (len(found.names) - 2), 0.5]
    own = found.chosen(np.array([0, len(found.names) - 1]), np.zeros(2)).policy.gait
    np.testing.assert_allclose(own.amplitude[:, 0], jaxgrity.load_gait("lasting").amplitude, rtol=1e-6)
    assert not np.any(own.amplitude[:, 1])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda scene: control.way_map(NOTHING, np.array([20.0, 0.0]), ARENA), "goal = [20.0, 0.0]"),
        (lambda scene: control.way_map(NOTHING, np.zeros(2), ARENA, spacing=0.0), "expected positive numbers"),
        (lambda scene: control.way_map(NOTHING, np.zeros(3), ARENA), "goal = [0.0, 0.0, 0.0]"),
        (
            lambda scene: control.way_map(NOTHING, np.zeros(2), ARENA, spacing=0.4),
            "a spacing of at most half of reach",
        ),
        (
            lambda scene: control.way_map(
                control.Discs(np.array([[4.0, 0.5]]), np.array([0.5])), np.array([4.0, 1.2]), ARENA
            ),
            "goal = [4.0, 1.2]: 0.2 m from a disc; expected more than reach, 0.6 m",
        ),
        (
            lambda scene: control.way_map(Discs(np.zeros((1, 2)), np.array([-0.5])), np.array([4.0, 0.0]), ARENA),
            "discs: centres of shape (1, 2), radii [-0.5] m; expected",
        ),
        (
            lambda scene: control.way_map(Discs(np.zeros((2, 2)), np.array([0.5])), np.array([4.0, 0.0]), ARENA),
            "discs: centres of shape (2, 2), radii [0.5] m; expected",
        ),
        (lambda scene: control.gait_choices(scene.structure, {}), "gaits: []; expected at least one"),
        (
            lambda scene: control.gait_choices(scene.structure, {"rest": PhaseLocked(jaxgrity.load_gait("lasting"))}),
            "gaits: ['rest']; expected at least one, none of them called 'rest'",
        ),
        (lambda scene: control.discs_of(None), "ground: there is none"),
        (
            lambda scene: control.way_map(NOTHING, np.zeros(2), (-3.0, -5.0, np.nan, 5.0)),
            "arena = (-3.0, -5.0, nan, 5.0): expected four",
        ),
        (
            lambda scene: control.way_map(NOTHING, np.zeros(2), (-1e5, -1e5, 1e5, 1e5)),
            "a grid of 2000001 times 2000001 points 0.1 m apart; expected at most 1,000,000",
        ),
        (
            lambda scene: control.way_map(NOTHING, np.zeros(2), ARENA, comfort=np.nan),
            "reach, comfort, spacing = 0.6, nan, 0.1 m: expected positive numbers",
        ),
        (
            lambda scene: control.way_map(NOTHING, np.zeros(2), ARENA).way(np.array([np.nan, 0])),
            "start = [nan, 0.0]: expected a place",
        ),
        (
            lambda scene: control.sure_footed(replace(jaxgrity.load_gait("lasting"), amplitude=np.full(6, 0.95))),
            "expected less than 0.9,",
        ),
    ],
)
def test_bad_input_is_refused(scene, make, message):
    """Before anything is compiled."""
    with pytest.raises(InputError, match=re.escape(message)):
        make(scene)


def led(scene, discs: list[Discs], sampling: Sampling):
    """Robots that stand at the origin, with goals 3 m away along x."""
    gaits = control.gait_choices(scene.structure, {"lasting": PhaseLocked(jaxgrity.load_gait("lasting"))})
    model = control.plant_of(scene, gaits.policy.members, options=SolverOptions(dt=0.01, dtype="float32"))
    maps = [control.way_map(field, np.array([3.0, 0.0]), ARENA) for field in discs]
    q = np.repeat(np.asarray(scene.structure.nodes, float)[..., None], len(discs), axis=-1)
    start = q, np.zeros_like(q)
    many = control.side_by_side(model, len(discs))
    with pytest.raises(InputError, match="expected one for each"):
        control.lead_to(many, model, gaits, maps[:-1])
    return control.lead_to(many, model, gaits, maps, start=start, sampling=sampling)


def test_arriving_does_not_make_up_for_touching():
    """The straight way to the goal leads through a small disc right before it; one round it is worth more.

    So is standing still. Without the disc the straight way is the best, and the sooner the better; a way that fails
    is the worst.
    """
    share = np.linspace(0.1, 1.0, 10)
    straight = np.stack([3 * share, 0 * share], axis=1)
    soon = np.stack([np.minimum(6 * share, 3.0), 0 * share], axis=1)
    still = 0 * straight
    detour = np.stack([3 * share, 1.5 * np.sin(np.pi * np.minimum(share, 0.8))], axis=1)
    paths = np.stack([straight, soon, detour, still, straight], axis=-1)[:, :, None]
    failed = np.array([[False] * 4 + [True]])
    sampling, goal = Sampling(margin=0.1, within=0.3), np.array([3.0, 0.0])
    disc = Discs(np.array([[2.2, 0.0]]), np.array([0.3]))
    ways = [control.way_map(discs, goal, ARENA, reach=0.3) for discs in (NOTHING, disc)]
    free, blocked = (costs(paths, failed, way, sampling) for way in ways)
    assert free.argmin() == 1
    assert free.argmax() == blocked.argmax() == 4
    assert blocked[2] < blocked[0]
    assert blocked[3] < blocked[0]


def test_a_goal_counts_that_was_reached_in_time_and_with_nothing_touched(scene):
    """Of robots that are moved past a disc, through one, past one until the rollout fails, and not far enough."""
    q = np.asarray(scene.structure.nodes, float)
    q = q - q.mean(0)
    goal, frames = np.array([6.0, 0.0]), 25
    x = np.linspace(0, 6, frames)[:, None, None] * np.array([1.0, 0, 0])
    nodes = np.stack([q + x, q + x, q + x, q + 0.5 * x], axis=-1)
    nodes[10:, ..., 2] = np.nan
    path = nodes.mean(1)
    beside, amid = (Discs(np.array([[3.0, y]]), np.array([0.3])) for y in (2.0, 0.0))
    maps = [control.way_map(discs, goal, ARENA) for discs in (beside, amid, beside, beside)]
    reached, arrived, gaps = arrivals([scene] * 4, nodes, path, maps, Sampling(within=0.3))
    assert reached.tolist() == [True, False, False, False]
    assert gaps[0] > 0 > gaps[1]
    assert arrived.tolist() == [23, 23, 10, 24]


@pytest.mark.campaign
def test_where_a_robot_is_does_not_depend_on_what_it_is_taken_for(scene):
    """Its centre of mass is that of its own masses; the model's are other ones."""
    heavy = replace(scene.structure, node_mass=np.where(np.arange(12) < 2, 2.0, 0.5))
    gaits = control.gait_choices(scene.structure, {"lasting": PhaseLocked(jaxgrity.load_gait("lasting"))})
    options = SolverOptions(dt=0.01, dtype="float32")
    robot, model = (
        control.plant_of(one, gaits.policy.members, options=options) for one in (replace(scene, structure=heavy), scene)
    )
    maps = [control.way_map(NOTHING, np.array([3.0, 0.0]), ARENA)]
    quick = NEAR._replace(friction=(1.0, 1.0), patience=0.5)
    found = control.lead_to(control.side_by_side(robot, 1), model, gaits, maps, sampling=quick)
    own = jaxgrity.stepping.centre_of_mass(robot.scene, found.nodes[-1, ..., 0])
    np.testing.assert_allclose(found.path[-1, :, 0], own, atol=1e-5)
    assert np.abs(own - found.nodes[-1, ..., 0].mean(0)).max() > 0.01


def test_maps_for_a_smaller_robot_are_refused(scene):
    gaits = control.gait_choices(scene.structure, {"lasting": PhaseLocked(jaxgrity.load_gait("lasting"))})
    post = Discs(np.array([[1.0, 2.0]]), np.array([0.3]))
    way = control.way_map(post, np.array([3.0, 0.0]), ARENA)
    built = scene.structure
    struts = replace(built.struts, rest_length=2 * built.struts.rest_length)
    large = replace(scene, structure=replace(built, nodes=2 * built.nodes, struts=struts))
    for one, margin, found in ((large, None, "0.2"), (scene, -0.1, "-0.1")):
        robot, sampling = control.plant_of(one, gaits.policy.members), CAUTIOUS._replace(margin=margin)
        with pytest.raises(InputError, match=rf"made for a reach of 0.6 m, margin = {found} m; expected at least"):
            control.lead_to(robot, robot, gaits, way, sampling=sampling)


def test_a_robot_is_as_wide_as_it_is_not_as_its_model(scene):
    """Of robots side by side, on balls of which the model knows nothing: they need wider ways, and touch sooner."""
    q = np.asarray(scene.structure.nodes, float)
    outermost = int(np.linalg.norm(q[:, :2], axis=1).argmax())
    feet = jaxgrity.model.Balls((outermost,), [0.4])
    gaits = control.gait_choices(scene.structure, {"lasting": PhaseLocked(jaxgrity.load_gait("lasting"))})
    model = control.plant_of(scene, gaits.policy.members)
    wide = control.plant_of(replace(scene, ground=replace(scene.ground, balls=feet)), model.members)
    robots = control.side_by_side(wide, 2, jaxgrity.Differences(friction=np.array([0.5, 1.0])))
    assert [np.max(each.friction.mu) for each in scenes_of(robots)] == [0.25, 0.5]
    post = Discs(np.array([[1.0, 2.0]]), np.array([0.3]))
    ways = [control.way_map(post, np.array([3.0, 0.0]), ARENA)] * 2
    with pytest.raises(InputError, match=r"made for a reach of 0.6 m, margin = 0.1 m; expected at least 0.959 m"):
        control.lead_to(robots, model, gaits, ways)
    out = q[outermost, :2] / np.linalg.norm(q[outermost, :2])
    ways = [control.way_map(Discs((q[outermost, :2] + 0.35 * out)[None], np.array([0.2])), np.array([3.0, 0.0]), ARENA)]
    nodes = np.repeat(q[None, ..., None], 2, axis=-1)
    scenes = [scene, scenes_of(robots)[1]]
    gaps = arrivals(scenes, nodes, nodes.mean(1), 2 * ways, Sampling(within=0.3))[2]
    np.testing.assert_allclose(gaps, [0.15, -0.25], atol=1e-6)


def test_one_sample_is_no_choice_of_gaits(scene):
    """As before, or rest."""
    with pytest.raises(InputError, match="samples = 4: expected at least 2 in each round, to choose from gaits"):
        led(scene, [NOTHING], CAUTIOUS._replace(samples=4, rounds=4))


@pytest.mark.campaign
def test_robots_are_led_to_goals_and_never_touch_without_being_told(scene):
    """One in the open arrives; one whose goal is walled in does not, and keeps clear of the wall or is told not to."""
    angle = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    ring = Discs(np.array([3.0, 0.0]) + 1.2 * np.stack([np.cos(angle), np.sin(angle)], axis=1), np.full(16, 0.25))
    sampling = CAUTIOUS._replace(samples=16, friction=(1.0,), interval=0.5, patience=25.0)
    found = led(scene, [NOTHING, ring], sampling)
    assert found.reached.tolist() == [True, False]
    end = found.arrived[0]
    assert np.linalg.norm(found.path[end, :2, 0] - [3.0, 0.0]) < 0.3
    touched = [control.gap(ring, scene, q) for q in found.nodes[: found.arrived[1] + 1, :, :, 1]]
    assert found.gap[1] == pytest.approx(min(touched))
    # the model is the robot, which starts from rest as the model does; later the robot's solver begins with the
    # impulses of the step before, of which the model is not told
    assert found.surprise[0].max() < 1e-5
    assert np.all(found.spread == 0)


@pytest.mark.campaign
def test_ways_spread_where_robots_of_the_model_differ(scene):
    """In their friction: robots of equal friction go the same way."""
    spreads = [led(scene, [NOTHING], NEAR._replace(friction=friction)).spread for friction in ((1.0, 1.0), (0.5, 1.5))]
    assert spreads[0].max() == 0
    assert spreads[1].max() > 0.01


def test_the_clock_heeds_how_fast_struts_swing(scene):
    """du/dt from spins is that of directions along a motion, by central differences."""
    plant = control.plant_of(scene, jaxgrity.load_gait("lasting").members)
    gait = replace(jaxgrity.load_gait("lasting"), start=np.array(0.0), ramp=np.array(0.1))
    motion = control.simulate_policy(plant, control.OpenLoop(gait), 0.5)
    q, v = np.asarray(motion.positions), np.asarray(motion.velocities)
    k, h = 20, 1e-6
    seen = [control.measure(scene, 0.0, q[k] + s * h * v[k], v[k]) for s in (-1, 0, 1)]
    rate = (seen[2].directions[:, 2] - seen[0].directions[:, 2]) / (2 * h)
    angle = np.asarray(gait.phase)
    expected = float(np.sum(seen[1].directions[:, 2] * rate * np.cos(angle)))
    swings = np.array([[0.5, 0.0], [0.0, 0.0]])
    one = PhaseLocked(gait, np.zeros((2, 2)), swings)
    _, (clock, _) = one(seen[1], 0.01, jax.tree.map(np.asarray, (0.0, 0.0)))
    assert np.abs(rate).max() < 3
    assert abs(expected) > 1e-3
    assert float(clock) == pytest.approx(0.01 * (1 + 0.5 * expected), rel=1e-6)
