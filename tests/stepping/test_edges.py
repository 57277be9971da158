"""Nodes that meet edges: the face that their way enters first is the one that holds them, on either side of it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrity import (
    Box,
    ConeFriction,
    Cylinder,
    ExactGround,
    Scene,
    Slope,
    SolverOptions,
    Sphere,
    Stairs,
    Structure,
    Union,
    bumps,
    simulate,
)
from jaxgrity.model import Balls
from jaxgrity.stepping.entering import where_met

G, DT = 9.81, 5e-3
CORNER = 1e-9
"""m: nodes that pass an edge within this meet either face"""


def paths(surface, starts, velocities=None, friction=None, duration=0.4):
    """(times, nodes, 3), m: positions after each step of nodes that know nothing of each other."""
    body = Structure(np.asarray(starts, float), np.ones(len(starts)))
    scene = Scene(body, G, ground=ExactGround(surface=surface), friction=friction)
    options = SolverOptions(dt=DT, any_step=True)
    found = simulate(scene, duration, options=options, velocities=velocities, frame_rate=1 / DT)
    assert not found.failed
    return np.asarray(found.positions)


class Block:
    """A convex body with flat faces: n·x <= d for all of them, and what a line meets of it."""

    def __init__(self, normals, distances):
        self.normals, self.distances = np.asarray(normals, float), np.asarray(distances, float)

    def entered(self, start, way):
        """For each line the share at which it enters, infinite where it does not, its face, and whether it is a tie."""
        gap, rate = self.distances - start @ self.normals.T, way @ self.normals.T
        with np.errstate(divide="ignore", invalid="ignore"):
            at = gap / rate
        first = np.where(rate < 0, at, np.where((rate == 0) & (gap < 0), np.inf, -np.inf))
        last = np.where(rate > 0, at, np.inf).min(1)
        order = np.sort(first, axis=1)
        size = np.linalg.norm(way, axis=1)
        with np.errstate(invalid="ignore"):
            tie = (order[:, -1] - order[:, -2]) * size < CORNER
            grazes = abs(order[:, -1] - last) * size < 1e-7
        share = order[:, -1]
        hit = (share <= last) & (share >= 0) & (share < 1)
        return np.where(hit, share, np.inf), self.normals[first.argmax(1)], tie | grazes


def box_block(centre, size, turn=0.0):
    axes = np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1.0]])
    normals = np.vstack([axes, -axes])
    return Box(np.asarray(centre), np.asarray(size), turn), Block(normals, normals @ centre + np.tile(size, 2) / 2)


FLOOR = Slope(), Block([[0, 0, 1.0], [0, 0, 1.0]], [0.0, 1.0])
FIRST, SECOND = box_block([0.0, 0, 0.05], [0.4, 4.0, 0.3]), box_block([0.25, 0, 0.1], [0.12, 0.3, 0.4], 0.5)
THIN = box_block([0.0, 0, 0.25], [0.3, 4.0, 0.02])
TREADS = [Block([[-1.0, 0, 0], [0, 0, 1.0]], [-0.1 - 0.2 * k, 0.15 * (k + 1)]) for k in range(3)]
GROUNDS = {
    "stairs": (Stairs(0.15, 0.2, 3, start=0.1), [*TREADS, FLOOR[1]], [0.1, 0.3, 0.5]),
    "box": (Union((FIRST[0], FLOOR[0])), [FIRST[1], FLOOR[1]], [-0.2, 0.2]),
    "boxes that meet": (Union((FIRST[0], SECOND[0], FLOOR[0])), [FIRST[1], SECOND[1], FLOOR[1]], [0.2, 0.25]),
    "a thin shelf": (Union((THIN[0], FLOOR[0])), [THIN[1], FLOOR[1]], [-0.15, 0.15]),
}


def drops(rims, count, seed=0):
    """Starts about rims, m, and velocities, m/s."""
    draw = np.random.default_rng(seed)
    x = draw.choice(rims, count) + draw.uniform(-0.03, 0.03, count)
    starts = np.stack([x, draw.uniform(-0.2, 0.2, count), draw.uniform(0.6, 1.0, count)], 1)
    velocities = draw.normal(0, 0.7, (count, 3)) * (draw.uniform(size=count) < 0.7)[:, None]
    return starts, velocities


def lines_that_enter(blocks, start, way):
    """Of each line and block: the share at which it enters, infinite where not, that face; and where these are sure."""
    share, normal, tie = (np.stack(x, 1) for x in zip(*(block.entered(start, way) for block in blocks)))
    enters, size = np.isfinite(share), np.linalg.norm(way, axis=1)
    in_order = np.sort(share, axis=1)
    with np.errstate(invalid="ignore"):
        apart = (in_order[:, 1] - in_order[:, 0]) * size > CORNER
    return share, normal, enters.any(1) & apart & ~(tie & enters).any(1)


def sides(ground, count):
    """How many times nodes entered the ground, and by how much, m, one ended that step elsewhere than a face says.

    Without friction a node ends it where its free motion does, less what leads into the face of a block that it met
    first; where it enters two blocks, of either of them.
    """
    surface, blocks, rims = ground
    q, worst, met = paths(surface, *drops(rims, count)), 0.0, 0
    for before, now, after in zip(q, q[1:], q[2:]):
        way = now - before
        outside = ExactGround(surface=surface).measured(now[None]).distance[0] > CORNER
        share, n, sure = lines_that_enter(blocks, now, way)
        free = now + way - np.array([0, 0, G * DT**2])
        at = now[:, None] + np.where(np.isfinite(share), share, 0)[..., None] * way[:, None]
        deep = np.minimum(np.sum(n * (free[:, None] - at), axis=2), 0)
        off = np.linalg.norm((after - free)[:, None] + deep[..., None] * n, axis=2)
        off = np.where(np.isfinite(share), off, np.inf).min(1)[outside & sure]
        worst, met = max(worst, off.max(initial=0.0)), met + len(off)
    return met, worst


@pytest.mark.campaign
def test_no_node_leaves_by_a_side_that_it_did_not_enter():
    """Drops about rims of stairs, straight and across; the campaign has other grounds too."""
    met, worst = sides(GROUNDS["stairs"], 400)
    assert met > 150
    assert worst < 1e-7


@pytest.mark.campaign
@pytest.mark.parametrize("name", GROUNDS)
def test_none_of_many_drops_leaves_by_another_side(name):
    """10,000 of them on each ground."""
    met, worst = sides(GROUNDS[name], 10_000)
    assert met > 5000
    assert worst < 1e-7


INSIDE_BY = np.array([1e-7, 1e-5, 1e-4, 1e-3, 3e-3, 1e-2, 2e-2])
POST = Cylinder(np.array([0.0, 0, -1]), np.array([0.0, 0, 0.2]), 0.5)
EDGES = {
    "a stair": Stairs(0.2, 0.5, 1, start=-0.5),
    "a box": Box(np.zeros(3), np.array([1.0, 40.0, 0.4])),
    "a shelf": Box(np.array([0, 0, 0.19]), np.array([1.0, 40.0, 0.02])),
    "a post": POST,
    "a ridge of two boxes": Union((Box(np.array([-0.25, 0, 0]), np.array([0.5, 40.0, 0.4])), Slope())),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.campaign] * (name not in ("a box", "a shelf"))) for name in EDGES],
)
def test_a_node_dropped_inside_an_edge_stays_there(name):
    """On treads, tops and shelves, 0.1 um to 20 mm inside their edges, with friction: it does not move sideways."""
    starts = np.tile([-0.5, 0, 0.5], (len(INSIDE_BY), 1))
    starts[:, 0] += INSIDE_BY
    end = paths(EDGES[name], starts, None, ConeFriction(0.5), 0.4)[-1]
    np.testing.assert_allclose(end, starts - [0, 0, 0.3], rtol=0, atol=1e-8)


@pytest.mark.slow
def test_a_node_that_passes_an_edge_by_goes_on():
    """As far outside: it reaches the ground below."""
    starts = np.tile([-0.5, 0, 0.5], (len(INSIDE_BY), 1))
    starts[:, 0] -= INSIDE_BY + 1e-6
    end = paths(EDGES["a ridge of two boxes"], starts, None, ConeFriction(0.5), 0.4)[-1]
    np.testing.assert_allclose(end, starts - [0, 0, 0.5], rtol=0, atol=1e-8)


@pytest.mark.slow
def test_a_small_ball_does_not_let_a_node_through():
    """One that is no thicker than the way of a step throws back what falls on it, and does not pass it on."""
    ball = Sphere(np.array([0.0, 0, 0.0]), 0.01)
    starts = np.array([[x, 0, 0.8] for x in (0.0, 1e-3, -2e-3)])
    q = paths(ball, starts, duration=0.45)
    landed = int(np.argmin(np.linalg.norm(q[:, 0], axis=1)))
    assert np.all(q[landed, :, 2] > 0)
    np.testing.assert_allclose(q[-1, 0], [0, 0, 0.01], atol=1e-9)
    assert q[-1, 1, 0] > 0.01
    assert q[-1, 2, 0] < -0.01


CURVES = {
    "slope": Slope(0.2),
    "bumps": bumps(0.1, 0.5, seed=0),
    "bowl": Sphere([0.0, 0.0, 2.0], 2.0, hollow=True),
    "ball": Sphere([0.0, 0.0, -2.0], 2.0),
    "log": Cylinder([0.0, -3.0, -2.0], [0.0, 3.0, -2.0], 2.0),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.campaign] * (name not in ("bumps", "ball"))) for name in CURVES]
)
def test_the_normal_on_a_curve_is_where_a_node_touches_it_first(name):
    """Of a node in contact at its place, of one that lands where it does, of one that does not reach the ground at the
    end of its way."""
    ground = ExactGround(surface=CURVES[name])
    place = jnp.array([[0.1, 0.2, float(ground.height(np.array([0.1]), np.array([0.2]))[0])]] * 3)
    n = ground.frame(place).normal[0]
    along = jnp.cross(n, jnp.array([0.0, 1.0, 0.0]))
    v = jnp.stack([2 * along, along - 3 * n, along + n])
    # the second is half of its way away, the third on its way up
    q = place + jnp.array([0.0, 1.5 * DT, 0.05])[:, None] * n
    met = where_met(ground, 1.0, DT, q, v)
    np.testing.assert_allclose(met.share, [0, 0.5, 1], atol=2e-2)
    touches = q + DT * met.share[:, None] * v
    turn = np.linalg.norm(ground.frame(q + DT * v).normal[1] - n)
    np.testing.assert_allclose(met.frame.normal, ground.frame(touches).normal, atol=0.5 * turn + 1e-9)
    np.testing.assert_allclose(met.frame.normal[0], n, atol=1e-9)
    assert abs(ground.signed_distance(touches)[1]) < 1e-4
    follows = v[0] - met.frame.normal[0] * (met.frame.normal[0] @ v[0])
    np.testing.assert_allclose(met.distance[0], ground.signed_distance((q[0] + DT * follows)[None])[0], atol=1e-12)


@pytest.mark.campaign
def test_in_a_union_nodes_follow_curves_too():
    """Bumps beside a box that is far away are as bumps alone, for nodes in contact and for one that lands."""
    hills, far = CURVES["bumps"], Box([50.0, 0.0, 0.0], [1.0, 1.0, 1.0])
    x, y = np.array([0.1, -0.2]), np.array([0.2, 0.3])
    q = jnp.stack([x, y, hills.height(x, y) + np.array([0.0, 1e-3])], axis=1)
    v = jnp.array([[2.0, 1.0, 0.0], [1.0, 0.0, -2.0]])
    alone, beside = (where_met(ExactGround(surface=s), 1.0, DT, q, v) for s in (hills, Union((hills, far))))
    np.testing.assert_allclose(beside.frame.normal[0], alone.frame.normal[0], atol=1e-9)
    np.testing.assert_allclose(beside.frame.normal[1], alone.frame.normal[1], atol=0.05)
    np.testing.assert_allclose(beside.distance, alone.distance, atol=1e-4)


def test_balls_touch_a_curve_by_their_radius():
    """A ball that rests on the ground has the normal at its place; one that passes through it has none of it."""
    bowl = Sphere([0.0, 0.0, 2.0], 2.0, hollow=True)
    q, v = jnp.array([[0.0, 0.0, 0.1], [0.3, 0.0, 0.5]]), jnp.array([[1.0, 0.0, 0.0]] * 2)
    met = where_met(ExactGround(surface=bowl, balls=Balls((0,), [0.1])), 1.0, DT, q, v)
    np.testing.assert_allclose(met.share, [0, 1])
    np.testing.assert_allclose(met.frame.normal[0], [0, 0, 1], atol=1e-12)
    assert met.distance[0] == pytest.approx(2 - np.hypot(1.9, DT) - 0.1)


def test_a_plane_is_met_at_the_nodes():
    q, v = jnp.array([[0.1, 0.2, 0.3], [0.4, 0.0, -0.1]]), jnp.array([[0.3, 0.1, -5.0], [0.0, 0.0, -4.0]])
    plane = ExactGround(0.2)
    np.testing.assert_array_equal(where_met(plane, 1.0, DT, q, v).distance, plane.signed_distance(q))


@pytest.mark.campaign
def test_the_place_of_entry_has_the_derivative_of_the_root():
    """In start, way and the ground's own numbers, against differences; in float32 it is found too."""
    q, v = jnp.array([[0.4, 0.1, 0.33], [-0.3, 0.0, 0.42]]), jnp.array([[1.0, 0.2, -6.0], [-0.5, 0.3, -9.0]])

    def place(numbers):
        surface = Cylinder(jnp.array([0.0, -1, 0]), jnp.array([0.0, 1, 0]), numbers[6] * 0.5)
        start, speed = q + numbers[:3], v + numbers[3:6]
        share = where_met(ExactGround(surface=surface), 1.0, 0.01, start, speed).share
        return (start + 0.01 * share[:, None] * speed).ravel()

    numbers, h = np.eye(7)[6], 1e-6
    jacobian = jax.jit(jax.jacfwd(place))(numbers)
    beside = jax.jit(jax.vmap(place))(numbers + h * np.concatenate([np.eye(7), -np.eye(7)]))
    np.testing.assert_allclose(jacobian, (beside[:7] - beside[7:]).T / (2 * h), rtol=0, atol=1e-6)
    np.testing.assert_allclose(jax.jit(jax.jacrev(place))(numbers), jacobian, rtol=0, atol=1e-12)
    assert np.abs(jacobian[:, 6]).max() > 0.1
    post = jax.tree.map(jnp.float32, POST)
    single = where_met(ExactGround(surface=post), 1.0, 0.01, q.astype(jnp.float32), v.astype(jnp.float32))
    assert single.distance.dtype == jnp.float32


@pytest.mark.slow
@pytest.mark.parametrize(
    "friction", [None, pytest.param(ConeFriction(0.3), marks=pytest.mark.campaign)], ids=["smooth", "rough"]
)
def test_no_node_passes_a_wall_that_stands_on_the_floor(friction):
    """Thin and thick, met by nodes that slide along the floor, or land in the corner, by up to 3 cm a step.

    A step knows one face of each node. Yet none gains energy by walls that are thicker than its way in a step.
    """
    count, lies = 60, np.arange(60)
    for thickness in (0.02, 0.2):
        wall = Box(np.array([thickness / 2, 0, 0.1]), np.array([thickness, 4, 0.6]))
        slides = np.stack([np.linspace(-0.5, -0.4, count), 0 * lies, np.where(lies % 2, 0, -1e-7)], 1)
        lands = np.stack([np.linspace(-0.25, -0.15, count), 0 * lies, np.linspace(0.01, 0.3, count)], 1)
        for speed in (1.0, 3.0, 6.0):
            along, down = np.tile([speed, 0.2, 0.0], (count, 1)), np.tile([speed, 0.0, -speed], (count, 1))
            starts, velocities = np.vstack([slides, lands]), np.vstack([along, down])
            q = paths(Union((Slope(), wall)), starts, velocities, friction)
            assert q[..., 0].max() < min(0.5 * thickness, DT * speed)
            assert q[-1, :, 0].max() < 1e-3
            v = np.diff(q, axis=0) / DT
            energy = np.sum(v**2, -1) / 2 + G * (q[1:] + q[:-1])[..., 2] / 2
            if speed * DT < thickness:
                assert np.all(energy < energy[0] + 1e-6)
