"""Rigid bodies on supports that move: a pendulum whose pivot is shaken, by its equation of motion."""

import equinox as eqx
import jax
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxgrity import Scene, SolverOptions, energy_audit, final_state, parse_scene, simulate
from jaxgrity.stepping import resolve

PENDULUM = """
[structure]
kind = "custom"
height = 1.0
nodes = [[0, -0.1, 0], [0, 0.1, 0], [0.3, -0.1, 0.05], [0.3, 0.1, 0.2], [0.15, 0, 0.1]]
fixed = [0, 1]
[gravity]
[shaking]
amplitude = [0.05, 0.0, 0.02]
frequency = 3.0
start = 0.0
ramp = 0.2
[[bodies]]
nodes = [0, 1, 2, 3, 4]
mass = 1.2
inertia = [0.01, 0.02, 0.015]
centre = [0.2, 0.0, 0.0]
"""
MASS, ARM, INERTIA, DURATION = 1.2, 0.2, 0.02, 0.5


def swung(scene: Scene) -> np.ndarray:
    """(nodes, 3), m: where the nodes end by (m r^2 + I) a'' = m r ((g + z'') cos a + x'' sin a), a below the level."""
    pivot = jax.jit(jax.jacfwd(jax.jacfwd(scene.shaking.displacement)))

    def slope(t, y):
        x, _, z = np.asarray(pivot(t))
        turning = MASS * ARM * ((9.81 + z) * np.cos(y[0]) + x * np.sin(y[0]))
        return [y[1], turning / (MASS * ARM**2 + INERTIA)]

    a, u, t = 0.0, 0.0, 0.0
    for end in (0.2, DURATION):  # the acceleration jumps where the ramp ends
        a, u = solve_ivp(slope, (t, end), [a, u], method="DOP853", rtol=1e-10, atol=1e-11).y[:, -1]
        t = end
    turn = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    nodes = np.asarray(scene.structure.nodes)
    return nodes[0] + np.asarray(scene.shaking.displacement(DURATION)) + (nodes - nodes[0]) @ turn.T


@pytest.mark.slow
def test_a_pendulum_on_a_shaken_pivot_swings_by_its_equation():
    """Exact stepping at second order; one node follows the others. Energy and momentum balance."""
    scene, errors = parse_scene(PENDULUM), []
    assert len(scene.structure.bodies[0].carried) == 1
    expected = swung(scene)
    for dt in (1e-3, 5e-4):
        motion = simulate(scene, DURATION, options=SolverOptions(dt=dt))
        errors.append(np.abs(motion.positions[-1] - expected).max())
    assert errors[1] < 1e-5
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.1)
    audit = energy_audit(scene, DURATION, options=SolverOptions(dt=5e-4))
    assert np.max(audit.momentum_residual) < 1e-10
    assert np.max(np.abs(audit.residual)) < 1e-4


@pytest.mark.slow
def test_methods_without_impulses_move_shaken_bodies_too():
    """RK4, with multipliers."""
    scene = parse_scene(PENDULUM)
    motion = simulate(scene, DURATION, options=SolverOptions("rk4", dt=1e-3))
    np.testing.assert_allclose(motion.positions[-1], swung(scene), rtol=0, atol=2e-5)


@pytest.mark.slow
def test_derivatives_of_shaken_bodies_are_those_of_differences():
    """With respect to the amplitude."""
    scene = parse_scene(PENDULUM)
    options = resolve(scene, 0.2)

    @jax.jit
    def place(factor):
        size = lambda s: s.shaking.amplitude  # noqa: E731
        return final_state(eqx.tree_at(size, scene, size(scene) * factor), 0.2, options)[0][4, 0]

    difference = (place(1 + 1e-5) - place(1 - 1e-5)) / 2e-5
    assert float(jax.jit(jax.grad(place))(1.0)) == pytest.approx(float(difference), rel=1e-6)
