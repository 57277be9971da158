"""Structures that several tests of the model use."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrity.stepping.dynamics import total_force
from jaxgrity.stepping.power import powers

MOMENTS = 20
"""in time, at which `booked` looks"""


@pytest.fixture(scope="session")
def booked():
    """`booked(scene)`: the powers that the energy audit books, W, at random moments; of supports that stand still.

    Nodes are off by up to `spread`, m, and move anyhow. What forces take from T is what U gains at fixed time and what
    is lost; the actuators' power is how U changes with time where nothing moves.
    """

    def at_random(scene, spread=0.05, until=1.0):
        random = np.random.default_rng(0)
        q = np.asarray(scene.structure.nodes) + random.uniform(-spread, spread, (MOMENTS, *scene.structure.nodes.shape))
        v, t = random.normal(0, 0.5, q.shape), random.uniform(0, until, MOMENTS)

        @jax.jit
        @jax.vmap
        def at(t, q, v):
            _, gained = jax.jvp(lambda q: scene.potential_energy(q, t), (q,), (v,))
            earlier, later = (scene.potential_energy(q, t + way) for way in (-1e-6, 1e-6))
            return jnp.sum(v * total_force(scene, t, q, v)) + gained, (later - earlier) / 2e-6, powers(scene, t, q, v)

        lost, actuation, found = at(t, q, v)
        causes = {name: rate for name, rate in found.items() if name not in ("actuation", "impulse", "moment")}
        np.testing.assert_allclose(-lost, sum(causes.values()), rtol=1e-11, atol=1e-9)
        np.testing.assert_allclose(found["actuation"], actuation, rtol=1e-5, atol=1e-5)
        return jax.tree.map(np.asarray, found)

    return at_random
