"""Rigid-strut coordinates against nodes: positions, velocities and kinetic energy of random states."""

from functools import partial

import jax
import numpy as np
import pytest
import scipy

from jaxgrity.model.rigid_body import end_positions, end_velocities, inertia, rigid_kinetic_energy
from jaxgrity.model.scene import Scene
from jaxgrity.model.structure import Structure
from jaxgrity.stepping.dynamics import kinetic_energy


def cross_matrix(w):
    return np.cross(np.eye(3), w)


@pytest.fixture(params=range(5))
def state(request):
    """Centre, orientation, velocity, spin, arms and masses of one random strut; its masses differ."""
    rng = np.random.default_rng(request.param)
    R = scipy.linalg.expm(cross_matrix(rng.normal(size=3)))
    axis = rng.normal(size=3)
    arms = np.stack([0.6 * axis, -0.4 * axis])
    return rng.normal(size=3), R, rng.normal(size=3), rng.normal(size=3), arms, rng.uniform(0.1, 2.0, 2)


def test_kinetic_energy_is_that_of_the_nodes(state):
    """To 1e-12, the rounding of some twenty operations on numbers of order one."""
    p, R, v, spin, arms, mass = state
    scene = Scene(Structure(np.asarray(end_positions(p, R, arms)), mass))
    nodes = kinetic_energy(scene, end_velocities(v, spin, R, arms))
    assert float(rigid_kinetic_energy(v, spin, R, arms, mass)) == pytest.approx(float(nodes), rel=1e-12)


@partial(jax.jit, static_argnames="in_space")
def derivative_in_time(p, R, v, spinning, arms, in_space):
    """d/dt of the ends' positions at t = 0, m/s."""

    def moved(t):
        turn = jax.scipy.linalg.expm(t * spinning)
        return end_positions(p + t * v, turn @ R if in_space else R @ turn, arms)

    return jax.jvp(moved, (0.0,), (1.0,))[1]


@pytest.mark.parametrize("in_space", [True, False])
def test_push_forward_is_the_derivative_of_the_map(state, in_space):
    """Both conventions: spin in the axes of space turns R from the left, in the strut's own from the right."""
    p, R, v, spin, arms, _ = state
    velocities = derivative_in_time(p, R, v, cross_matrix(spin), arms, in_space)
    expected = end_velocities(v, spin if in_space else R @ spin, R, arms)
    np.testing.assert_allclose(velocities, expected, rtol=0, atol=1e-12)


def test_two_point_masses_have_five_degrees_of_freedom(state):
    """J has rank 2, and spinning about the strut's own axis moves neither end."""
    _, R, _, _, arms, mass = state
    moments = np.linalg.eigvalsh(inertia(R, arms, mass))
    assert moments[0] == pytest.approx(0, abs=1e-12)
    assert moments[1] > 1e-3
    along = R @ (arms[0] - arms[1])
    np.testing.assert_allclose(end_velocities(np.zeros(3), along, R, arms), 0, atol=1e-12)
