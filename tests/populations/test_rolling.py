"""How a robot moves: motions made by hand, of which everything is known, and a rollout."""

import dataclasses
import json

import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxgrity import (
    ExactGround,
    InputError,
    PenaltyGround,
    Scene,
    Structure,
    Trajectory,
    forces_along,
    gait_names,
    gait_record,
    load_gait,
    load_scene,
    simulate,
    with_gait,
)
from jaxgrity.model import rigid_body
from jaxgrity.model.balls import Balls
from jaxgrity.orbits.motion_report import motion_report
from jaxgrity.populations import rod_depths
from jaxgrity.populations.motion_kinds import Rolling, faces, name_of_motion, rolling
from jaxgrity.stepping.simulate import some_frames

BODY = np.sqrt(5) / 2
"""m, from one node of the icosahedron to the one opposite"""
DOWN = np.array([0.0, 0.0, -1.0])


@pytest.fixture(scope="module")
def scene(exact):
    """The robot on exact ground, without a gait."""
    return with_gait(exact, None)


@pytest.fixture(scope="module")
def lying(scene):
    """Its nodes, at rest on a face."""
    nodes = np.asarray(scene.structure.nodes)
    return nodes - [0, 0, nodes[:, 2].min()]


def motion(times, positions, velocities, failure: int = 0) -> Trajectory:
    nothing = jnp.zeros((), int)
    return Trajectory(times, positions, velocities, nothing + failure, nothing, nothing, "complementarity", None)


def translation(lying, times, shift) -> Trajectory:
    """Moved by `shift` (frames, 3), m; velocities are its differences."""
    return motion(times, lying + shift[:, None], np.gradient(shift, times, axis=0)[:, None] + 0 * lying)


def outward(nodes, face) -> np.ndarray:
    normal = np.cross(nodes[face[1]] - nodes[face[0]], nodes[face[2]] - nodes[face[0]])
    normal *= np.sign(normal @ (nodes[list(face)].mean(0) - nodes.mean(0)))
    return normal / np.linalg.norm(normal)


def turn_onto(nodes, face) -> tuple[np.ndarray, np.ndarray]:
    """The rotation vector, and a point of its axis, about the edge on the ground that lays a neighbouring face down."""
    normal = outward(nodes, face)
    axis = np.cross(normal, DOWN)
    pivot = nodes[min(face, key=lambda node: nodes[node, 2])]
    return axis / np.linalg.norm(axis) * np.arccos(normal @ DOWN), pivot


def test_faces_of_the_icosahedron(scene):
    """20 sorted triangles, all nodes on one side of each; 8 of them have cables all around."""
    found = faces(scene.structure)
    assert len(found) == len(set(found)) == 20
    assert found == tuple(sorted(tuple(sorted(face)) for face in found))
    nodes = np.asarray(scene.structure.nodes)
    for face in found:
        assert np.all((nodes - nodes[face[0]]) @ outward(nodes, face) < 1e-12)
    cables = {tuple(sorted(edge)) for edge in scene.structure.cables.edges}
    closed = [(i, j, k) for i, j, k in found if {(i, j), (j, k), (i, k)} <= cables]
    assert len(closed) == 8


def test_a_flat_face_is_one(scene):
    """A prism of five struts that slides upright on its base, rattling by a micrometre, does not roll."""
    angle = 2 * np.pi * np.arange(5) / 5
    ring = np.stack([np.cos(angle), np.sin(angle)], 1)
    nodes = np.concatenate([np.insert(ring, 2, 0.0, axis=1), np.insert(ring, 2, 1.5, axis=1)])
    sides = ((0, 1, 5, 6), (0, 4, 5, 9), (1, 2, 6, 7), (2, 3, 7, 8), (3, 4, 8, 9))
    body = Structure(nodes, np.ones(10))
    assert set(faces(body)) == {(0, 1, 2, 3, 4), (5, 6, 7, 8, 9), *sides}
    times = np.linspace(0, 4, 401)
    slides = translation(nodes, times, times[:, None] * [0.5, 0, 0])
    rattles = 1e-6 * np.random.default_rng(0).uniform(size=(8, 10))[np.arange(401) // 50 % 8]
    rattling = dataclasses.replace(
        slides, positions=slides.positions + np.stack([0 * rattles, 0 * rattles, rattles], 2)
    )
    found = rolling(Scene(body, 9.81, ground=scene.ground), rattling)
    assert (found.kind, found.supports) == ("slides", ((0, 1, 2, 3, 4),))


@pytest.mark.parametrize("count", [3, 4, 9])
def test_flat_structures_have_no_faces(count):
    nodes = np.random.default_rng(0).normal(size=(count, 3)) * [1, 1, 0]
    with pytest.raises(InputError, match=f"{count} nodes lie in a plane"):
        faces(Structure(nodes, np.ones(count)))


def test_rolling_over_edges(scene, lying):
    """Turned about one edge after another: the faces are those it was laid on, at their times, and nothing slips."""
    hull, rest, turn, rate = faces(scene.structure), 0.3, 0.4, 100
    face = min(hull, key=lambda face: lying[list(face), 2].sum())
    q, walk, legs = lying, [face], []
    positions, velocities = [], []
    for _ in range(6):
        positions += [q] * round(rest * rate)
        velocities += [0 * q] * round(rest * rate)
        # Straight on where that goes: the neighbour, not yet visited, whose centre is furthest along x.
        ahead = [f for f in hull if len(set(f) & set(face)) == 2 and f not in walk]
        face = max(ahead, key=lambda f: q[list(f), 0].mean())
        vector, pivot = turn_onto(q, face)
        for share in np.arange(round(turn * rate)) / (turn * rate):
            positions.append(Rotation.from_rotvec(share * vector).apply(q - pivot) + pivot)
            velocities.append(np.cross(vector / turn, positions[-1] - pivot))
        end = Rotation.from_rotvec(vector).apply(q - pivot) + pivot
        legs.append((end - q).mean(0)[:2])
        q = end
        walk.append(face)
    positions += [q] * round(rest * rate)
    velocities += [0 * q] * round(rest * rate)
    times = np.arange(len(positions)) / rate
    found = rolling(scene, motion(times, np.array(positions), np.array(velocities)))
    assert found.supports == tuple(walk)
    assert found.rolls == 6
    assert found.since[0] == 0
    began = rest + (rest + turn) * np.arange(6)
    assert np.all((began < found.since[1:]) & (found.since[1:] < began + turn))
    assert found.slip_share == found.airborne_share == 0
    length = np.linalg.norm(legs, axis=1).sum()
    np.testing.assert_allclose(found.path_length, length, rtol=1e-12)
    np.testing.assert_allclose(found.straightness, np.linalg.norm(np.sum(legs, axis=0)) / length, rtol=1e-12)
    assert found.kind == "rolls"
    slipping = rolling(scene, motion(times, np.array(positions), np.add(velocities, [0.1, 0, 0])))
    assert (slipping.rolls, slipping.slip_share, slipping.kind) == (6, 1, "rolls")


@pytest.mark.parametrize("incline", [0.0, 0.3, -0.3])
@pytest.mark.parametrize(("speed", "duration", "slip_share"), [(0.5, 4.0, 1.0), (0.019, 60.0, 0.0)])
def test_sliding(scene, lying, incline, speed, duration, slip_share):
    """Down the slope, and up; a robot that creeps far without rolling slides too, though no node slips."""
    scene = dataclasses.replace(scene, ground=ExactGround(incline))
    times = np.linspace(0, duration, 401)
    shift = speed * times[:, None] * np.array(scene.ground.tangents[0])
    tilted = Rotation.from_rotvec([0, incline, 0]).apply(lying)
    found = rolling(scene, translation(tilted, times, shift))
    assert found.kind == "slides"
    assert found.rolls == 0
    assert len(found.supports) == 1
    assert found.airborne_share == 0
    np.testing.assert_allclose(found.slip_share, slip_share)
    np.testing.assert_allclose(found.straightness, 1)
    np.testing.assert_allclose(found.path_length, speed * duration * np.cos(incline))


@pytest.mark.parametrize("ahead", [0.0, 0.5])
@pytest.mark.parametrize(("stiffness", "sunk"), [(None, 0.0), (1e4, 1e-3)])
def test_hopping(scene, lying, ahead, stiffness, sunk):
    """On the spot or ahead: in the air from 2 mm on with exact contact, from 0 on with penalty contact."""
    ground = PenaltyGround(stiffness) if stiffness else ExactGround()
    scene = dataclasses.replace(scene, ground=ground, friction=None)
    times = np.linspace(0, 4, 4001)
    height = 0.1 * np.maximum(0, np.sin(2 * np.pi * times))
    found = rolling(scene, translation(lying, times, np.stack([ahead * times, 0 * times, height - sunk], axis=1)))
    threshold = sunk if stiffness else 2e-3
    np.testing.assert_allclose(found.airborne_share, 0.5 - np.arcsin(threshold / 0.1) / np.pi, atol=2e-3)
    assert found.slip_share == (ahead > 0)
    assert found.kind == "hops"


def test_staying(scene, lying):
    """At rest; and in the air, where nothing touches."""
    times = np.linspace(0, 2, 201)
    found = rolling(scene, translation(lying, times, np.zeros((201, 3))))
    (face,) = found.supports
    np.testing.assert_allclose(lying[list(face), 2], 0, atol=1e-12)
    assert found[2:] == (0, 0, 0, 0, 0, "stays", 2)
    assert found.sentence().startswith("stays: 0 changes of support in 2 s (")
    above = rolling(scene, translation(lying - DOWN, times, np.zeros((201, 3))))
    assert (above.airborne_share, above.slip_share) == (1, 0)


@pytest.mark.parametrize(("velocity", "share"), [([0.015, 0.015, 0], 1 / 3), ([0.01, 0.015, 0.5], 0)])
def test_slip_is_summed_over_nodes(scene, lying, velocity, share):
    """One of the three nodes on the ground moves along it, or off it: at times unevenly spaced, for half of them."""
    times = np.concatenate([np.linspace(0, 1, 101), np.linspace(1, 2, 1001)[1:]])
    velocities = np.zeros((len(times), *lying.shape))
    velocities[times < 1, lying[:, 2].argmin()] = velocity
    found = rolling(scene, motion(times, lying + 0 * velocities, velocities))
    np.testing.assert_allclose(found.slip_share, share / 2, atol=2e-3)


@pytest.mark.parametrize("lengths", [0.09, 0.11])
def test_staying_is_less_than_a_tenth_of_a_body_length(scene, lying, lengths):
    times = np.linspace(0, 2, 201)
    found = rolling(scene, translation(lying, times, lengths * BODY / 2 * times[:, None] * [0, 1, 0]))
    assert found.kind == ("stays" if lengths < 0.1 else "slides")


@pytest.mark.parametrize(("held", "rolls"), [(0.05, 0), (0.09, 0), (0.1, 2), (0.5, 2)])
@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_a_face_counts_once_it_lasts(scene, lying, held, rolls, dtype):
    """Laid on another face for a while, and back: 0.05 s are a flicker."""
    times = np.linspace(0, 30, 3001)
    there = (times > 25.005) & (times < 25.015 + held)
    vector, pivot = turn_onto(lying, next(f for f in faces(scene.structure) if 0.1 < -outward(lying, f)[2] < 0.9))
    turned = Rotation.from_rotvec(vector).apply(lying - pivot) + pivot
    positions = np.where(there[:, None, None], turned, lying)
    found = rolling(scene, motion(*(x.astype(dtype) for x in (times, positions, 0 * positions))))
    assert found.rolls == rolls
    np.testing.assert_allclose(found.since, [0, 25.01, 25.02 + held][: rolls + 1], rtol=1e-6)
    assert found.supports[0] == found.supports[-1]
    assert len(set(found.supports)) == 1 + (rolls > 0)


def test_flat_on_the_ground_rounding_changes_no_support(scene, lying):
    """All faces are equally low: noise of 1e-12 m, which changes slowly, chooses none of them."""
    times = np.linspace(0, 2, 201)
    noise = np.random.default_rng(0).normal(0, 1e-12, (5, *lying.shape))
    positions = lying * [1, 1, 0] + noise[np.arange(201) // 50]
    assert rolling(scene, motion(times, positions, 0 * positions)).rolls == 0


def test_what_comes_before_the_gait_does_not_count(exact, lying):
    """Sliding for a second, before the gait starts."""
    times = np.linspace(0, 3, 301)
    trajectory = translation(lying, times, np.minimum(times, 0.99)[:, None] * [1, 0, 0])
    found = rolling(exact, trajectory)
    assert found.since.tolist() == [1]
    assert found[2:] == (0, 0, 0, 0, 0, "stays", 2)
    assert rolling(with_gait(exact, None), trajectory).kind == "slides"


@pytest.mark.slow
def test_a_rollout(exact):
    """Its numbers fit each other and its trajectory, and go into JSON."""
    trajectory = simulate(exact, 8.0, frame_rate=50.0)
    found = rolling(exact, trajectory)
    assert found.rolls == len(found.supports) - 1 >= 0
    assert set(found.supports) <= set(faces(exact.structure))
    assert all(a != b for a, b in zip(found.supports, found.supports[1:]))
    assert found.since[0] >= 1
    assert np.all(np.diff(found.since) > 0)
    assert all(0 <= share <= 1 for share in (found.slip_share, found.airborne_share, found.straightness))
    centre = np.asarray(trajectory.positions)[np.asarray(trajectory.times) > 0.999].mean(1)
    displacement = np.linalg.norm((centre[-1] - centre[0])[:2])
    assert found.path_length >= displacement
    np.testing.assert_allclose(found.straightness * found.path_length, displacement, rtol=1e-9)
    summary = json.loads(json.dumps(found.summary()))
    assert list(summary) == list(Rolling._fields)
    assert summary["supports"] == [list(face) for face in found.supports]
    assert summary["since"] == list(found.since)
    assert summary["duration"] == pytest.approx(7)


def test_the_sentence():
    found = Rolling(((0, 4, 8), (0, 4, 9), (0, 3, 9)), np.array([1, 2, 3.0]), 2, 0.12, 0.03, 0.91, 2.0, "rolls", 10.0)
    faces = "(0-4-8, 0-4-9, ...), slips 12 % of contact time, airborne 3 %, straightness 0.91"
    assert found.sentence() == f"rolls: 2 changes of support in 10 s {faces}"
    once = found._replace(supports=found.supports[:2], rolls=1)
    assert once.sentence().startswith("rolls: 1 change of support in 10 s (0-4-8, 0-4-9), slips")
    assert "(none lasts)" in found._replace(supports=(), rolls=0).sentence()


def test_what_cannot_be_told_is_refused(exact, scene, lying):
    """No ground, a failed rollout, one that ends before the gait starts."""
    times = np.linspace(0, 0.9, 10)
    still = translation(lying, times, np.zeros((10, 3)))
    with pytest.raises(InputError, match="no ground"):
        rolling(Scene(scene.structure), still)
    with pytest.raises(InputError, match="torn apart; expected one that succeeded"):
        rolling(scene, motion(times, still.positions, still.velocities, failure=2))
    with pytest.raises(InputError, match=r"ends at 0\.9 s; expected at least two frames from 1 s on"):
        rolling(exact, still)


@pytest.mark.parametrize("ask", [rolling, forces_along, rod_depths])
def test_a_motion_of_another_robot_or_without_frames_is_refused(scene, lying, ask):
    """As is one whose times do not grow."""
    jaxtyping.config.update("jaxtyping_disable", True)  # for this test: its own refusals would come first
    for times, nodes, message in (
        ([0.0, 0.1], lying[:4], r"trajectory.positions has shape \(2, 4, 3\); expected \(2, 12, 3\): a motion of this"),
        ([], lying, "trajectory.times has 0 numbers; expected one or more, and that they grow"),
        ([0.0, np.nan], lying, "trajectory.times has 2 numbers; expected one or more, and that they grow"),
        ([0.1, 0.1], lying, "trajectory.times has 2 numbers; expected one or more, and that they grow"),
    ):
        still = np.repeat(nodes[None], len(times), axis=0)
        with pytest.raises(InputError, match=message):
            ask(scene, motion(np.array(times), still, 0 * still))


ROUNDS = np.linspace(0, 1, 400)[:, None]
IN_TURN = ((0, 1, 2), (1, 2, 3), (2, 3, 4), (3, 4, 5), (4, 5, 6), (5, 6, 7), (6, 7, 8), (0, 7, 8))
TO_AND_FRO = ((0, 1, 2), (1, 2, 3)) * 4


def line(length: float) -> np.ndarray:
    return ROUNDS * [length, 0.0]


def circle(radius: float, rounds: float = 1.0, wobble: float = 0.0) -> np.ndarray:
    angle = 2 * np.pi * rounds * ROUNDS
    radius = radius + wobble * np.sin(40 * np.pi * ROUNDS)
    return radius * np.concatenate([np.cos(angle), np.sin(angle)], axis=1)


def to_and_fro(size: float, times: int = 4, drift: float = 0.0) -> np.ndarray:
    return np.concatenate([size / 2 * np.sin(2 * np.pi * times * ROUNDS) + drift * ROUNDS, 0 * ROUNDS], axis=1)


@pytest.mark.parametrize(
    ("name", "path", "supports", "airborne"),
    [
        ("rolls", line(3.0), IN_TURN, 0.0),
        ("rolls", line(3.0), IN_TURN, 0.09),
        ("rolls", line(0.5), IN_TURN[:3], 0.0),
        ("rolls", circle(2.0), IN_TURN * 2, 0.0),
        ("rolls", circle(2.0, 0.5), IN_TURN, 0.0),
        ("rolls", circle(2.0, 3.0, 0.05), IN_TURN * 5, 0.0),
        ("rolls", circle(0.6), IN_TURN, 0.0),
        ("rolls", to_and_fro(1.2, 1), IN_TURN[:4] + IN_TURN[2::-1], 0.0),
        ("rolls", to_and_fro(0.2, 10, drift=3.0), IN_TURN, 0.0),
        ("slides", line(3.0), IN_TURN[:2], 0.0),
        ("slides", line(0.2), IN_TURN[:1], 0.0),
        ("slides", circle(2.0), IN_TURN[:4], 0.0),
        ("slides", to_and_fro(0.2, 10, drift=3.0), IN_TURN[:3], 0.0),
        ("slides", to_and_fro(4.0, 2), IN_TURN, 0.0),
        ("slides", line(3.0), TO_AND_FRO, 0.0),
        ("rolls", line(3.0), IN_TURN[:2] * 2 + IN_TURN[1:3] * 2 + IN_TURN[2:4], 0.0),
        ("rocks", to_and_fro(0.4), TO_AND_FRO, 0.0),
        ("rocks", to_and_fro(0.9, 2), IN_TURN[:2] + IN_TURN[:1], 0.05),
        ("rocks", to_and_fro(0.3, 5), IN_TURN[:1], 0.0),
        ("slides", circle(0.3, 4.0), IN_TURN[:1], 0.0),
        ("rolls", np.concatenate([line(0.9)[::8], np.tile(line(0.9)[-1:], (500, 1))]), IN_TURN[:2], 0.0),
        ("turns on the spot", circle(0.3, 4.0), IN_TURN, 0.0),
        ("turns on the spot", circle(0.3, -2.0, 0.02), IN_TURN * 2, 0.0),
        ("stays", to_and_fro(0.05), TO_AND_FRO, 0.0),
        ("stays", circle(0.04, 5.0), IN_TURN[:1], 0.0),
        ("stays", line(0.0), (), 0.0),
        ("hops", line(3.0), IN_TURN, 0.2),
        ("hops", line(0.0), IN_TURN[:1], 0.2),
    ],
)
def test_motions_have_their_names(name, path, supports, airborne):
    """By path, width, turns and supports; a closed circle is rolled along as half of one is."""
    for turn in (0.0, 1.0):
        turned = path @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]) + np.array([3, -2])
        assert name_of_motion(turned, supports, airborne) == name
        assert name_of_motion(turned[::-1], supports[::-1], airborne) == name


SOFTER = ("gentle", "thrifty")
"""for a softer robot"""
HOPPING_GAITS = ("cables", "fast", "gentle", "steep", "swift", "uphill")
"""of the library"""


@pytest.mark.slow
@pytest.mark.parametrize("scene_name", ["exact", pytest.param("reference", marks=pytest.mark.campaign)])
def test_the_gaits_of_the_library_have_their_names(scene_name):
    """Those that were found as rolling ones roll, straight on and in circles, however long one looks."""
    for gait in gait_names():
        scene = load_scene(gait_record(gait)["scene"] if gait in SOFTER else scene_name)
        there = with_gait(scene, load_gait(gait))
        motion = simulate(there, 20.0)
        named = {rolling(there, each).kind for each in (motion, some_frames(motion, motion.times <= 8.0))}
        assert named == {"hops" if gait in HOPPING_GAITS else "rolls"}, gait


def test_a_ball_that_rolls_does_not_slip_and_one_that_is_pushed_does():
    """1 m in 2 s on one ball of 0.1 m about the middle of a body; its other nodes pass, and make the faces."""
    nodes = 0.05 * np.array([[0.0, 0, 0], [1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    body = rigid_body(nodes, range(5), 1.0, np.full(3, 0.004))
    ground = ExactGround(balls=Balls((0,), [0.1]))
    scene = Scene(Structure(nodes, np.zeros(5), bodies=(body,)), gravity=9.81, ground=ground)
    times = np.linspace(0, 2, 201)
    centre, speed = np.stack([0.5 * times, 0 * times, 0 * times + 0.1], 1), np.array([0.5, 0, 0])
    for spin, share in ((0.5 / 0.1, 0.0), (0.0, 1.0)):
        turned = np.stack([Rotation.from_rotvec([0, spin * t, 0]).apply(nodes) for t in times])
        moved = motion(times, turned + centre[:, None], speed + np.cross([0, spin, 0], turned))
        seen = rolling(scene, moved)
        assert seen.slip_share == share
        assert (seen.rolls > 0) == (spin > 0)
        assert seen.kind == ("rolls" if spin else "slides")
        assert motion_report(scene, moved).kind == seen.kind  # of a body without members too
