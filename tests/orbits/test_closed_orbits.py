"""Orbits closed by Newton's method, and the derivatives of their speed."""

import re
from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrity import (
    EnergyTerm,
    ForceLaw,
    Gait,
    InputError,
    Members,
    Scene,
    SolverOptions,
    Structure,
    load_gait,
    load_scene,
    wind,
    with_gait,
    with_terms,
)
from jaxgrity.core.dense import INVERTED_AT_ONCE
from jaxgrity.identification import speed_slopes
from jaxgrity.orbits import closed_orbit, find_orbit
from jaxgrity.stepping import resolve


def speeds(scene, orbit, options, x):
    """Speed with friction, all masses, amplitude and frequency so many times as large."""
    places = (
        lambda s: s.friction.mu,
        lambda s: s.structure.node_mass,
        lambda s: s.gait.amplitude,
        lambda s: s.gait.frequency,
    )
    for where, factor in zip(places, x):
        scene = eqx.tree_at(where, scene, where(scene) * factor)
    return closed_orbit(scene, orbit, options).speed


@pytest.fixture(scope="module")
def close(crawler):
    """The orbit of a scene like the crawler, closed from that of the crawler."""
    _, orbit, options = crawler
    return jax.jit(lambda scene: closed_orbit(scene, orbit, options))


@pytest.mark.slow
def test_the_closed_orbit_is_the_one_that_a_long_rollout_settles_on(crawler, close):
    """With the same speed, and a state that a cycle maps on itself."""
    scene, orbit, _ = crawler
    closed = close(scene)
    assert orbit.settled
    assert closed.residual < 1e-9
    assert closed.speed > 1e-3
    np.testing.assert_allclose(closed.speed, orbit.speed, rtol=1e-4)
    np.testing.assert_allclose(closed.turning, orbit.turning, atol=1e-6)


@pytest.mark.campaign
def test_closing_an_orbit_solves_no_system_by_threads(reference, crawler):
    """Of 12 nodes, 75 unknowns: each matrix that is inverted is one on which LAPACK works in one thread."""
    orbit, nodes = crawler[1], reference.structure.nodes
    scene = with_gait(reference, load_gait("lasting"))
    orbit = orbit._replace(state=(nodes, 0 * nodes), period=1 / float(scene.gait.frequency[0]))
    options = resolve(scene, orbit.period)
    text = str(jax.make_jaxpr(jax.grad(lambda mu: speeds(scene, orbit, options, [mu, 1.0, 1.0, 1.0])))(1.0))
    sizes = [int(n) for n in re.findall(r"\[(\d+),\d+\][^\n]* = lu\b", text)]
    assert sizes
    assert max(sizes) <= INVERTED_AT_ONCE


@pytest.mark.slow
def test_derivatives_of_speed_agree_with_differences(crawler):
    """Forward and reverse mode and central differences of orbits closed anew, to 1e-6 of the largest."""
    f = partial(speeds, *crawler)
    with_reverse = jax.jit(jax.value_and_grad(f))
    at, h = np.ones(4), 1e-4
    forward, reverse = jax.jit(jax.jacfwd(f))(at), with_reverse(at)[1]
    steps = h * np.eye(4)
    differences = [(with_reverse(at + step)[0] - with_reverse(at - step)[0]) / (2 * h) for step in steps]
    size = np.abs(forward).max()
    assert size > 1e-3
    np.testing.assert_allclose(reverse, forward, atol=1e-9 * size)
    np.testing.assert_allclose(differences, forward, atol=1e-6 * size)


@pytest.mark.slow
def test_a_higher_frequency_has_an_orbit_of_its_own(crawler, close):
    """Found from the orbit of the lower one, it is the one on which the robot settles at that frequency."""
    scene, orbit, options = crawler
    quicker = eqx.tree_at(lambda s: s.gait.frequency, scene, scene.gait.frequency * 1.02)
    closed = close(quicker)
    assert abs(closed.speed - orbit.speed) > 1e-4 * orbit.speed
    np.testing.assert_allclose(closed.speed, find_orbit(quicker, 60.0, options=options).speed, rtol=1e-4)


@pytest.mark.campaign
def test_newton_closes_an_orbit_on_exact_contact(exact):
    """From velocities that are off by 0.1 m/s it ends, but for rounding, where rolling on ends too."""
    scene = with_gait(exact, load_gait("straight"))
    orbit = find_orbit(scene, 110.0)
    q, v = orbit.state
    deviates = 0.1 * np.random.default_rng(0).normal(size=v.shape)
    options = resolve(scene, orbit.period)
    close = jax.jit(lambda v: closed_orbit(scene, orbit._replace(state=(q, v)), options))
    closed = [close(each) for each in (v, v + deviates)]
    for found in closed:
        assert found.residual < 1e-10
        np.testing.assert_allclose(found.speed, closed[0].speed, rtol=1e-8)
        np.testing.assert_allclose(found.speed, orbit.speed, rtol=1e-3)
        np.testing.assert_allclose(found.turning, orbit.turning, atol=1e-3)


def test_closed_orbits_are_those_of_level_ground(crawler):
    """On a slope or in wind an orbit that is turned is none, so Newton's equations do not hold."""
    scene, orbit, options = crawler
    leaning = replace(scene, ground=replace(scene.ground, incline=0.1))
    windy = with_terms(scene, wind((1.0, 0.0, 0.0), 0.1, len(scene.structure.nodes)))
    for other in (leaning, windy):
        with pytest.raises(InputError, match=r"^closed_orbit: the ground slopes, or a law"):
            closed_orbit(other, orbit, options)


def test_scenes_without_slopes_of_speed_are_refused(crawler):
    """Rigid struts, exact contact: their derivatives lack the times of impacts."""
    _, orbit, _ = crawler
    with pytest.raises(InputError, match=r"^speed_slopes: the scene has rigid struts or exact contact; expected"):
        speed_slopes(load_scene("exact"), (), orbit)


class Afloat(EnergyTerm):
    """A spring to the level z = 0."""

    name = "afloat"

    def energy(self, at):
        return 25.0 * (at.q[:, 2] ** 2).sum()


class Thrust(ForceLaw):
    """On the first node, along the strut and to its left."""

    name, cause = "thrust", "thrust"

    def force(self, motion, other_forces):
        d = motion.at.q[0] - motion.at.q[1]
        return jnp.stack([d + 0.3 * jnp.stack([-d[1], d[0], 0 * d[0]]), 0 * d])


@pytest.mark.campaign
def test_where_a_robot_turns_its_speed_depends_on_where_its_mass_is():
    """A strut that swims in a circle, without gravity: derivatives by each mass, by central differences.

    The centre of mass of one with other masses goes round on another circle.
    """
    struts = Members(((0, 1),), [200.0], [1.0], damping=[5.0])
    structure = Structure(np.array([[0.0, 0, 0], [1, 0, 0]]), [1.0, 3.0], struts)
    gait = Gait((0,), [0.0], [0.2], [1.0], start=0.0, ramp=1.0)
    scene = Scene(structure, node_damping=[1.0, 2.0], gait=gait, terms=(Afloat(), Thrust()))
    options = resolve(scene, 1.0, SolverOptions("rk4", 0.05))
    orbit = find_orbit(scene, 50.0, options=options)
    assert orbit.turning > 0.3

    @jax.jit
    @jax.value_and_grad
    def speed(mass):
        return closed_orbit(eqx.tree_at(lambda s: s.structure.node_mass, scene, mass), orbit, options).speed

    h, mass = 1e-4, np.array([1.0, 3.0])
    differences = [(speed(mass + step)[0] - speed(mass - step)[0]) / (2 * h) for step in h * np.eye(2)]
    np.testing.assert_allclose(speed(mass)[1], differences, rtol=1e-5)
