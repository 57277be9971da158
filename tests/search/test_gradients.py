"""Derivatives of the distance rolled, by forward mode through a second of the reference scene, against differences."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrity.stepping.dynamics import centre_of_mass
from jaxgrity.stepping.simulate import integrate, settle, simulate

DT = 5e-4
# (where in the scene, name): each is varied by a factor, so that all derivatives are metres.
PARAMETERS = {
    **{f"phase of strut {k}": None for k in range(6)},
    "amplitude": lambda s: s.gait.amplitude,
    "frequency": lambda s: s.gait.frequency,
    "strut stiffness": lambda s: s.structure.struts.stiffness,
    "cable stiffness": lambda s: s.structure.cables.stiffness,
    "mass": lambda s: s.structure.node_mass,
    "friction": lambda s: s.friction.mu,
}


def changed(scene, x):
    """The scene with phases moved by x[:6] (rad) and each other parameter made 1 + x[k] times as large."""
    scene = eqx.tree_at(lambda s: s.gait.phase, scene, scene.gait.phase + x[:6])
    for k, where in enumerate(PARAMETERS.values()):
        if where is not None:
            scene = eqx.tree_at(where, scene, where(scene) * (1 + x[k]))
    return scene


@pytest.fixture(scope="module")
def displacement(reference):
    """Horizontal displacement of the centre of mass, (2,) m, from t = 1 s, where the robot has settled, to 2 s."""
    settled = simulate(reference, 1.0, dt=DT)
    start = (settled.positions[-1], settled.velocities[-1])
    settings = settle(reference, 1.0, "rk4", DT)
    times = jnp.linspace(1.0, 2.0, 2)

    def distance(x):
        scene = changed(reference, x)
        q = integrate(start, times, scene, settings).ys[0]
        return (centre_of_mass(scene, q[-1]) - centre_of_mass(scene, q[0]))[:2]

    return jax.jit(distance)


@pytest.fixture(scope="module")
def jacobian(displacement):
    return np.asarray(jax.jit(jax.jacfwd(displacement))(jnp.zeros(len(PARAMETERS))))


def test_robot_moves_and_every_parameter_matters(displacement, jacobian):
    assert np.linalg.norm(displacement(jnp.zeros(len(PARAMETERS)))) > 1e-3
    assert np.all(np.linalg.norm(jacobian, axis=0) > 1e-4)


@pytest.mark.parametrize("k", range(len(PARAMETERS)), ids=list(PARAMETERS))
def test_derivative_is_that_of_central_differences(displacement, jacobian, central_difference, k):
    """To 1e-6, of the same discrete map: RK4 at a fixed step."""
    unit = jnp.eye(len(PARAMETERS))[k]
    expected = np.asarray(central_difference(lambda x: displacement(x * unit), 0.0, 1e-6))
    np.testing.assert_allclose(jacobian[:, k], expected, rtol=0, atol=1e-6 * np.linalg.norm(expected))
