"""Derivatives through landings and bounces on exact contact are those of the motion in continuous time.

Those of bounces agree with closed forms, with an error in proportion to the step, in both modes, for both solvers.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_scenes import swept

from jaxgrity import (
    ConeFriction,
    ExactGround,
    Gait,
    Members,
    Scene,
    Slope,
    SolverOptions,
    Structure,
    final_state,
    gaits_of,
)
from jaxgrity.model.scene import as_dtype
from jaxgrity.search import checkpointed_end, distances
from jaxgrity.stepping import resolve

START = jnp.array([0.3, 9.81, -0.4])
"""height, m, gravity, m/s^2, and upward velocity, m/s"""
HEIGHTS = jnp.linspace(0.0, 0.04, 16)[:, None] * jnp.array([1.0, 0, 0])
"""m, added to the first, so that impacts fall on all parts of a step"""
ALONG, TIME = 2.0, 0.44
"""horizontal velocity, m/s, and time of the end, s, before the second impact"""
STEPS = (8e-3, 1e-3)
"""s"""


def ball(restitution: float | None, mu: float | None = None, surface=None) -> Scene:
    """One node."""
    friction = None if mu is None else ConeFriction(mu)
    ground = ExactGround(restitution=restitution, surface=surface)
    return Scene(Structure([[0.0, 0, 1]], [2.0]), gravity=9.81, ground=ground, friction=friction)


def thrown(scene: Scene, dt: float, coupled: bool = False, until: float = TIME):
    """x, z and their rates at the end, as a function of `START`."""
    options = resolve(scene, until, SolverOptions(dt=dt, coupled=coupled))

    def end(start):
        height, g, speed = start
        there = eqx.tree_at(lambda s: s.gravity, scene, g)
        first = (jnp.array([[0.0, 0, 1]]) * height, jnp.array([[ALONG, 0, 0]]) + jnp.array([[0.0, 0, 1]]) * speed)
        q, v = final_state(there, until, options, first)
        return jnp.stack([q[0, 0], q[0, 2], v[0, 0], v[0, 2]])

    return end


def bounced(start, e: float, mu: float):
    """The same in closed form: a parabola, a jump of the velocity, a parabola."""
    height, g, speed = start
    hits = jnp.sqrt(speed**2 + 2 * g * height)
    first = (speed + hits) / g
    slower, rest = ALONG - mu * (1 + e) * hits, TIME - first
    up = e * hits
    return jnp.stack([ALONG * first + slower * rest, up * rest - g * rest**2 / 2, slower, up - g * rest])


def errors(ends, exact, steps, starts):
    """Of derivatives, at each step: the mean over starts of |error| by parameter, as a share of the derivative."""
    expected = jax.vmap(jax.jacfwd(exact))(starts)
    found = [jax.jit(jax.vmap(jax.jacfwd(ends(dt))))(starts) for dt in steps]
    size = jnp.linalg.norm(expected, axis=1)
    return np.array([jnp.mean(jnp.linalg.norm(each - expected, axis=1) / size) for each in found])


def order(steps, found) -> float:
    return np.polyfit(np.log(steps), np.log(found), 1)[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mu", "coupled"),
    [
        (0.2, False),
        pytest.param(None, False, marks=pytest.mark.campaign),
        pytest.param(0.2, True, marks=pytest.mark.campaign),
    ],
)
def test_through_a_bounce_of_a_node_the_derivative_is_that_of_the_closed_form(mu, coupled):
    """By height, gravity and velocity at the start, of position and velocity at the end, for many robots at once."""
    scene = ball(0.5, mu)
    found = errors(lambda dt: thrown(scene, dt, coupled), lambda x: bounced(x, 0.5, mu or 0.0), STEPS, START + HEIGHTS)
    assert found[1] < 0.01
    assert 0.8 < order(STEPS, found) < 1.3


def over_heights(end, start, width: float):
    """Gradients by height of the end, at 200 heights within so many metres; and the difference of both ends."""
    places = jnp.linspace(0.0, width, 200, endpoint=False) + width / 400
    heights = lambda x: start.at[0].add(x)  # noqa: E731
    slopes = jax.jit(jax.vmap(lambda x: jax.jvp(lambda x: end(heights(x)), (x,), (jnp.ones_like(x),))[1]))(places)
    first, last = jax.jit(jax.vmap(lambda x: end(heights(x))))(jnp.array([0.0, width]))
    return np.asarray(slopes), np.asarray(last - first) / width


@pytest.mark.slow
def test_differences_agree_over_many_steps_but_not_within_one():
    """The motion by steps jumps where the impact gets into another step: differences within a step do not see that."""
    end = thrown(ball(0.5), 1e-3)
    slopes, difference = over_heights(end, START, 0.1)
    np.testing.assert_allclose(slopes.mean(0)[[1, 3]], difference[[1, 3]], rtol=0.05, atol=0.03)
    _, small = over_heights(end, START, 1e-7)
    assert difference[3] > 5
    assert abs(small[3]) < 0.1


@pytest.mark.campaign
def test_reverse_mode_agrees_on_a_slope_as_a_surface_with_forward_mode_on_the_plane():
    """Two bounces down the slope. Where a node with a restitution of 0 stops, both modes agree too."""
    plane = dataclasses.replace(ball(0.5, 0.2), ground=ExactGround(0.1, restitution=0.5))
    ends = [thrown(scene, 2e-3, until=0.6) for scene in (plane, ball(0.5, 0.2, Slope(0.1)))]
    forward, reverse = jax.jit(jax.jacfwd(ends[0]))(START), jax.jit(jax.jacrev(ends[1]))(START)
    assert np.abs(forward).max() > 1
    np.testing.assert_allclose(reverse, forward, rtol=1e-6, atol=1e-8)
    end = thrown(ball(0.0, 0.2), 4e-3)
    forward, reverse = (jax.jit(of(end))(START) for of in (jax.jacfwd, jax.jacrev))
    assert np.abs(forward[0]).min() > 0.01
    np.testing.assert_allclose(reverse, forward, rtol=1e-9, atol=1e-12)


def slid(start):
    """Where a node is that lands without restitution and slides on, in closed form."""
    height, g, speed = start
    hits, mu = jnp.sqrt(speed**2 + 2 * g * height), 0.3
    first = (speed + hits) / g
    rest = TIME - first
    return jnp.stack([ALONG * first + (ALONG - mu * hits) * rest - mu * g * rest**2 / 2, 0 * g])


@pytest.mark.slow
@pytest.mark.parametrize("coupled", [False, pytest.param(True, marks=pytest.mark.campaign)])
def test_through_a_landing_that_slides_the_derivative_is_that_of_the_closed_form(coupled):
    """Without restitution the step itself has it: the impulse of an impact is dealt out to two steps by its time."""
    end = lambda dt: lambda x: thrown(ball(None, 0.3), dt, coupled)(x)[:2]  # noqa: E731
    assert errors(end, slid, STEPS[:1], START + HEIGHTS)[0] < 1e-9


@pytest.mark.slow
def test_through_a_landing_that_sticks_the_derivative_is_right_in_the_mean_over_a_step():
    """A node that sticks at once stops in the middle of a step. In steps it stops at its start, or slides on a little:
    what is continuous in the time of the impact has a derivative of 0 or of mu, and v_t/v_n in the mean."""
    slopes, difference = over_heights(thrown(ball(None, 2.0), 4e-3), START, 0.1)
    low, high = (START.at[0].add(x) for x in (0.0, 0.1))
    first = lambda x: (x[2] + jnp.sqrt(x[2] ** 2 + 2 * x[1] * x[0])) / x[1]  # noqa: E731
    expected = float(ALONG * (first(high) - first(low))) / 0.1
    assert set(np.round(slopes[:, 0], 6)) == {0.0, 2.0}
    assert slopes[:, 0].mean() == pytest.approx(expected, rel=0.1)
    assert difference[0] == pytest.approx(expected, rel=0.1)


MASSES, PIVOT = np.array([1.0, 2.0]), np.array([-2.0, 1.0]) / 3
"""kg, of a rod's ends, and their places along it, m, from its centre of mass"""
TILT, SPIN, UNTIL = 0.5, 2.0, 0.27


def rod(gait: Gait | None = None) -> Scene:
    """A rod of one metre without friction."""
    structure = Structure([[0.0, 0, 1], [1.0, 0, 1]], MASSES, Members(((0, 1),), None, [1.0]))
    return Scene(structure, gravity=9.81, ground=ExactGround(restitution=0.5), gait=gait)


def ends_of(height, tilt):
    """x and z of both ends."""
    return jnp.stack([PIVOT * jnp.cos(tilt), height + PIVOT * jnp.sin(tilt)], axis=1)


def tumbled(start):
    """Both ends of a rod that turns in its plane, after one bounce of its lower end: x, z and their rates."""
    height, g, speed = start
    fallen = lambda t: height + speed * t - g * t**2 / 2  # noqa: E731
    gap = lambda t: ends_of(fallen(t), TILT + SPIN * t)[0, 1]  # noqa: E731
    t = jnp.asarray(0.2)
    for _ in range(20):
        t = t - gap(t) / jax.grad(gap)(t)
    arm, mass, inertia = PIVOT[0] * jnp.cos(TILT + SPIN * t), MASSES.sum(), (MASSES * PIVOT**2).sum()
    falls = speed - g * t
    impulse = -1.5 * (falls + SPIN * arm) / (1 / mass + arm**2 / inertia)
    up, turns, rest = falls + impulse / mass, SPIN + impulse * arm / inertia, UNTIL - t
    last = lambda s: ends_of(fallen(t) + up * s - g * s**2 / 2, TILT + SPIN * t + turns * s)  # noqa: E731
    q, v = jax.jvp(last, (rest,), (jnp.ones_like(rest),))
    return jnp.concatenate([q.ravel(), v.ravel()])


def tumbling(scene: Scene, dt: float, coupled: bool = False, until: float = UNTIL):
    """The same by steps."""
    options = resolve(scene, until, SolverOptions(dt=dt, coupled=coupled))
    spun = SPIN * np.stack([-PIVOT * np.sin(TILT), 0 * PIVOT, PIVOT * np.cos(TILT)], axis=1)

    def end(start):
        height, g, speed = start
        there = eqx.tree_at(lambda s: s.gravity, scene, g)
        q = ends_of(height, TILT)
        first = jnp.stack([q[:, 0], 0 * q[:, 0], q[:, 1]], axis=1), spun + jnp.array([0.0, 0, 1]) * speed
        return jnp.concatenate([x[:, np.array([0, 2])].ravel() for x in final_state(there, until, options, first)])

    return end


@pytest.mark.campaign
@pytest.mark.parametrize("coupled", [False, True])
def test_through_a_bounce_of_a_spinning_rod_the_derivative_is_that_of_the_closed_form(coupled):
    """The impact sets both ends in motion, and where it is depends on the angle at its time."""
    starts = jnp.array([0.45, 9.81, -0.3]) + HEIGHTS / 2
    found = errors(lambda dt: tumbling(rod(), dt, coupled), tumbled, STEPS, starts)
    assert found[1] < 0.01
    assert 0.8 < order(STEPS, found) < 1.3


@pytest.mark.campaign
def test_actuated_rods_have_their_lengths_whenever_the_impact_is():
    """A rod that lengthens fast as it bounces: gradients agree with differences over many steps in the mean."""
    gait = Gait((0,), [0.0], [0.3], [2.0], start=0.0, ramp=0.01)
    end = tumbling(rod(gait), 5e-4, until=0.2)
    slopes, difference = over_heights(end, jnp.array([0.45, 9.81, -0.3]), 0.03)
    for rows in (slice(4), slice(4, 8)):
        size = np.abs(difference[rows]).max()
        assert size > 1
        np.testing.assert_allclose(slopes.mean(0)[rows], difference[rows], atol=0.03 * size)


@pytest.mark.campaign
def test_gradients_of_populations_are_those_of_each_robot():
    """Side by side in memory, with dampers, friction and restitution."""
    scene = as_dtype(swept(), "float64")
    scene = eqx.tree_at(lambda s: s.ground.restitution, scene, jnp.asarray(0.5), is_leaf=lambda x: x is None)
    phases, options = jnp.array([[0.3], [1.0], [2.5]]), resolve(scene, 0.5, SolverOptions(dt=5e-3))
    mass = scene.structure.node_mass

    def alone(phase):
        there = eqx.tree_at(lambda s: s.gait.phase, scene, phase)
        ends = final_state(there, 0.5, options)[0]
        return jnp.linalg.norm((mass @ (ends - scene.structure.nodes) / mass.sum())[:2])

    def together(phases):
        return jnp.sum(distances(scene, gaits_of(scene.gait, phases), 0.5, options, checkpointed_end))

    expected = jax.jit(jax.vmap(jax.grad(alone)))(phases)
    assert np.abs(expected).max() > 1e-3
    np.testing.assert_allclose(jax.jit(jax.grad(together))(phases), expected, rtol=1e-8, atol=1e-10)
