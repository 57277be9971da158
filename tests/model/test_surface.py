"""Surfaces: that their signed distances are distances, their normals unit vectors, and what is no surface."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxgrity import (
    Box,
    Cylinder,
    ExactGround,
    HeightFunction,
    HeightWaves,
    InputError,
    PenaltyGround,
    Slope,
    Sphere,
    Stairs,
    Union,
    bumps,
    height_map,
)

BOX = Box(np.array([0.3, -0.2, 0.1]), np.array([0.8, 0.5, 0.4]), turn=0.4, rounding=0.05)
SURFACES = {
    "slope": Slope(0.3),
    "sphere": Sphere(np.array([0.1, 0.2, -0.3]), 0.7),
    "bowl": Sphere(np.array([0.0, 0.0, 2.0]), 2.0, hollow=True),
    "box": BOX,
    "sharp box": Box(BOX.centre, BOX.size),
    "tilted box": Box(BOX.centre, BOX.size, np.array([0.3, -0.7, 0.5]), 0.05),
    "log": Cylinder(np.array([-1.0, 0.0, 0.2]), np.array([1.0, 0.5, 0.3]), 0.25),
    "post": Cylinder(np.array([0.0, 0.0, 0.0]), np.array([0.0, 0.0, 0.5]), 0.3, rounding=0.1),
    "stairs": Stairs(0.15, 0.3, 4, start=-0.3, turn=0.5, rounding=0.02),
    "union": Union((Slope(0.1), BOX)),
}
HEIGHTS = {
    "bumps": bumps(0.05, 0.7, seed=3),
    "function": HeightFunction(lambda x, y: 0.2 * jnp.sin(3 * x) * jnp.cos(2 * y)),
    "map": height_map(np.random.default_rng(0).uniform(0, 0.2, (8, 9)), (2.0, 2.0)),
}


height = eqx.filter_jit(lambda surface, x, y: surface.height(x, y))


def points(count=200, seed=0):
    return np.random.default_rng(seed).uniform([-1, -1, 0.0], [1, 1, 1.5], (count, 3))


@functools.cache
def measured(name):
    """A function of 200 points, the same program for all tests: distances, frames (200, 3, 3), gradients, in NumPy."""
    surface = (SURFACES | HEIGHTS)[name]

    @jax.jit
    def at(q):
        frame, phi = surface.frame(q), surface.signed_distance(q)
        slope = jax.grad(lambda q: surface.signed_distance(q).sum())(q)
        return phi, jnp.stack([frame.normal, *frame.tangents], 1), slope

    return lambda q: tuple(map(np.asarray, at(q)))


@functools.cache
def from_above(name):
    """Points on the surface as seen from above; elsewhere NaN."""
    x, y = np.random.default_rng(2).uniform(-0.9, 0.9, (2, 200))
    z = np.asarray(height((SURFACES | HEIGHTS)[name], x, y))
    found = np.isfinite(z)
    assert found.sum() > 6
    return np.where(found[:, None], np.stack([x, y, z], 1), np.nan)


@pytest.mark.parametrize("name", SURFACES)
def test_the_nearest_point_is_where_distance_and_normal_say(name):
    """phi(x - phi n) = 0 outside, and no other point of the surface is nearer: phi changes by no more than the way."""
    q, other = points(), points(seed=1)
    phi, axes, _ = measured(name)(q)
    outside = phi > 1e-6
    assert outside.sum() > 20
    np.testing.assert_allclose(measured(name)(q - phi[:, None] * axes[:, 0])[0][outside], 0, atol=1e-9)
    assert np.all(abs(phi - measured(name)(other)[0]) <= np.linalg.norm(q - other, axis=1) + 1e-12)


@pytest.mark.parametrize("name", [*SURFACES, *HEIGHTS])
def test_frames_are_orthonormal_and_their_normals_are_gradients(name):
    """At points on the surface, as seen from above; near its edges the gradient has a kink."""
    q = from_above(name)
    found = np.isfinite(q[:, 2])
    _, axes, _ = measured(name)(q)
    _, _, slope = measured(name)(q + 1e-7 * axes[:, 0])
    axes, slope = axes[found], slope[found]
    np.testing.assert_allclose(axes @ axes.swapaxes(1, 2), np.broadcast_to(np.eye(3), axes.shape), atol=1e-12)
    np.testing.assert_allclose(slope, axes[:, 0], atol=1e-5)


@pytest.mark.parametrize("name", [*SURFACES, *HEIGHTS])
def test_height_is_where_the_signed_distance_vanishes(name):
    """Also near rims, and on edges that are rounded; from there up all is outside, and all is where there is none."""
    x, y = np.random.default_rng(2).uniform(-0.9, 0.9, (2, 200))
    z = np.asarray(height((SURFACES | HEIGHTS)[name], x, y))
    some, above = np.isfinite(z), np.linspace(0, 2, 21)
    assert some.sum() > 6
    q = np.stack([x, y, np.where(some, z, -1)], 1)
    np.testing.assert_allclose(measured(name)(q)[0][some], 0, rtol=0, atol=1e-9)
    for further in above[1:]:
        assert np.all(measured(name)(q + np.array([0, 0, further]))[0] > 0)


def test_a_box_is_turned_as_a_body_is():
    """About any axis, by SciPy's rotation of its vector; a number turns it about z."""
    way, q = np.array([0.3, -0.7, 0.5]), points()
    tilted = Box(BOX.centre, BOX.size, way)
    np.testing.assert_allclose(tilted.axes, Rotation.from_rotvec(way).as_matrix().T, atol=1e-15)
    straight = Box(np.zeros(3), BOX.size)
    back = Rotation.from_rotvec(way).inv().apply(q - BOX.centre)
    np.testing.assert_allclose(tilted.signed_distance(q), straight.signed_distance(back), atol=1e-14)
    upright = Box(BOX.centre, BOX.size, np.array([0, 0, 0.4]), 0.05)
    np.testing.assert_allclose(upright.signed_distance(q), BOX.signed_distance(q), atol=1e-15)


def test_a_height_map_goes_through_its_heights():
    """And beyond its edge, level, on."""
    heights = np.random.default_rng(1).normal(size=(5, 7))
    surface = height_map(heights, (4.0, 3.0), centre=(1.0, 2.0))
    x, y = np.meshgrid(np.linspace(-1, 3, 5), np.linspace(0.5, 3.5, 7), indexing="ij")
    found = np.asarray(height(surface, np.append(x, -5.0), np.append(y, 2.0)))
    np.testing.assert_allclose(found[:-1], heights.ravel(), atol=1e-12)
    np.testing.assert_allclose(found[-1], heights[0, 3], atol=1e-12)


def test_a_height_map_is_a_straight_ramp_up_to_its_edge():
    """And any cubic: heights and slopes are those of the function, in the corners too."""
    x, y = np.linspace(-1, 1, 6), np.linspace(-2, 2, 5)
    q = np.random.default_rng(0).uniform([-1, -2], [1, 2], (50, 2))
    q[:4] = [[-1, -2], [1, 2], [-1 + 1e-6, 0], [0.3, 2 - 1e-6]]
    for f in (lambda x, y: 0.2 * x - 0.3 * y + 1, lambda x, y: x**3 - 0.5 * x * y**2 + 0.1 * y**3):
        surface = height_map(f(x[:, None], y), (2.0, 4.0))
        np.testing.assert_allclose(height(surface, *q.T), f(*q.T), rtol=0, atol=1e-12)


def test_a_height_map_of_a_smooth_hill_has_its_slopes():
    """To the fourth order in the grid's spacing."""
    errors = []
    for count in (21, 41):
        x = np.linspace(-2, 2, count)
        surface = height_map(np.cos(x[:, None] * np.pi / 2) * np.cos(x * np.pi / 2), (4.0, 4.0))
        at = np.random.default_rng(0).uniform(-1, 1, (2, 50))
        exact = np.cos(at[0] * np.pi / 2) * np.cos(at[1] * np.pi / 2)
        errors.append(abs(np.asarray(height(surface, *at)) - exact).max())
    assert errors[0] < 1e-4
    assert errors[1] < errors[0] / 12


def test_bumps_are_as_high_as_asked_and_another_seed_is_another_ground():
    """Their standard deviation over a wide field."""
    x, y = np.random.default_rng(0).uniform(-50, 50, (2, 20000))
    first, second = (np.asarray(height(bumps(0.04, 0.5, seed), x, y)) for seed in (0, 1))
    np.testing.assert_allclose([first.std(), second.std()], 0.04, rtol=0.05)
    assert abs(np.corrcoef(first, second)[0, 1]) < 0.1


def test_a_gradient_in_the_terrain_is_that_of_finite_differences(central_difference):
    """dU/d(amplitude of a wave), of nodes that press on bumps."""
    q, ground = points() * [1, 1, 0.05], bumps(0.05, 0.7, seed=3)

    @jax.jit
    def energy(a):
        waves = HeightWaves(ground.amplitude * a, ground.length, ground.direction, ground.phase)
        phi = PenaltyGround(1e3, surface=waves).signed_distance(q)
        return 500 * jnp.sum(jnp.minimum(phi, 0) ** 2)

    assert energy(1.0) > 0.1
    np.testing.assert_allclose(jax.jit(jax.grad(energy))(1.0), central_difference(energy, 1.0, 1e-6), rtol=1e-6)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Sphere(np.zeros(3), -1.0), "sphere.radius = -1 m: expected a positive number"),
        (lambda: Box(np.zeros(3), np.array([1.0, 1.0, 0.0])), "box.size"),
        (
            lambda: Cylinder([0, 0, 0], [0, 0, 0.1], 0.5, rounding=0.3),
            "cylinder.rounding = 0.3: expected a radius from 0 to half of its smallest side",
        ),
        (lambda: Box(np.zeros(3), np.ones(3), np.zeros(2)), r"box.turn has shape \(2,\); expected \(3,\)"),
        (lambda: Box(np.zeros(3), np.ones(3), rounding=0.6), "box.rounding = 0.6: expected a radius from 0 to half"),
        (lambda: Cylinder(np.zeros(3), np.zeros(3), 1.0), "expected two points apart"),
        (lambda: Stairs(0.1, 0.3, steps=0), "stairs.steps = 0: expected a whole number, at least 1"),
        (lambda: Stairs(0.1, -0.3), "stairs.run = -0.3"),
        (lambda: Union(()), "expected at least one surface"),
        (
            lambda: Union((Slope(), Box([1, 0, 0.5], [0.6, 0.8, 1.0]))),
            "centre = .1.0, 0.0, 0.0., size = .0.6, 0.8, 2.0.",
        ),
        (
            lambda: Union((Box([0, 0, 0], [1, 1, 1]), Box([1, 0.3, 0], [1, 1, 0.5]))),
            "a face of part 0 .box. lies on part",
        ),
        (
            lambda: Union((Stairs(0.2, 0.5), Box([0.3, 0, 0.25], [0.1, 0.1, 0.1]))),
            "part 1 .box. lies on part 0 .stairs.",
        ),
        (lambda: Union((Slope(), Cylinder([0, 0, 0], [0, 0, 1], 0.2))), "part 1 .cylinder. lies on part 0 .slope."),
        (
            lambda: Union((Slope(), Union((Box([1, 0, 0.5], [0.6, 0.8, 1.0]), Sphere([3, 0, 0], 0.3))))),
            "a face of part 1 .box. lies on part 0 .slope.",
        ),
        (lambda: bumps(0.0, 1.0, 0), "bumps.deviation = 0: expected a positive number"),
        (lambda: height_map(np.zeros((2, 9)), (1.0, 1.0)), "expected a table, at least 4 by 4"),
        (lambda: height_map(np.full((4, 4), np.nan), (1.0, 1.0)), r"heights\[0, 0\] = nan: expected a finite number"),
        (lambda: height_map(np.zeros((4, 4)), (1.0, 0.0)), "expected two positive numbers"),
        (lambda: HeightWaves(np.ones(2), np.ones(2), np.ones(2), np.ones(3)), "one number a wave"),
        (lambda: HeightWaves([], [], [], []), "waves: there are none; expected one wave or more"),
        (lambda: ExactGround(0.1, surface=Slope()), "ground.incline = 0.1: it is that of the plane"),
        (lambda: ExactGround(offset=np.zeros(3)), "ground.offset moves a surface"),
        (
            lambda: ExactGround(surface=Slope(0.1), offset=np.zeros((1, 3))),
            r"offset has shape \(1, 3\); expected \(3,\)",
        ),
        (lambda: ExactGround(surface=Slope(0.1)).normal, "differs from place to place"),
    ],
)
def test_what_is_no_surface_is_refused(make, words):
    with pytest.raises(InputError, match=words):
        make()


@pytest.mark.parametrize(
    "parts",
    [
        (Slope(), Box([1, 0, 0.4], [0.6, 0.8, 1.2])),
        (Slope(0.1), Box([1, 0, 0.5], [0.6, 0.8, 1.0])),
        (Box([0, 0, 0], [1, 1, 1]), Box([1, 0.3, 0], [1.01, 1, 1])),
        (Box([0, 0, 0], [1, 1, 1]), Box([1, 1, 0], [1, 1, 1])),
        (Box([0, 0, 0], [1, 1, 1]), Box([2.5, 0, 0], [1, 1, 1]), Slope()),
        (Slope(), Cylinder([0, -1, 0.2], [0, 1, 0.2], 0.2), Sphere([2, 0, 0.3], 0.3)),
        (Box([0, 0, 0], [1, 1, 1]), Box([1, 0, 0], [1, 1, 1]), Box([0.5, 0, 0], [0.5, 1.2, 1.2])),
    ],
    ids=["deeper", "on a slope", "overlapping", "edge to edge", "apart", "round", "covered"],
)
def test_parts_without_a_wall_in_common_are_a_union(parts):
    assert Union(parts).parts == parts


def test_a_ball_is_hollow_or_not():
    jaxtyping.config.update("jaxtyping_disable", True)  # for this test: its own refusal would come first
    with pytest.raises(InputError, match=r"sphere\.hollow = 1\.5: expected True or False"):
        Sphere([0.0, 0, 1], 1.0, hollow=1.5)
