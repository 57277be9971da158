"""Error bars of distances: they cover the error of the steps, and are infinite where a rollout fails."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrity import SolverOptions, gaits_of, random_phases, simulate_population, verify

pytestmark = pytest.mark.slow

OPTIONS = SolverOptions(dt=1e-3)


def test_error_bar_covers_the_error(reference):
    """Against a step 16 times smaller, for gaits that nothing was tuned on."""
    gaits = gaits_of(reference.gait, random_phases(4, 6, seed=8))
    verified = verify(reference, gaits, 3.0, options=OPTIONS)
    truth = simulate_population(reference, gaits, 3.0, options=SolverOptions(dt=1e-3 / 16))
    assert np.all(np.linalg.norm(verified.com_end - truth.com_end, axis=1) <= verified.error_bar)
    assert np.all(verified.error_bar < 0.05)
    assert verified.steps == (1e-3, 5e-4, 2.5e-4)


def test_error_bar_of_a_failure_is_infinite(reference):
    """A gait that cannot be integrated has no distance, and says so; the others have theirs."""
    amplitude = np.full((4, 6), 0.3)
    amplitude[2] = 1e9  # an array of JAX is a search's own, and is not looked at
    verified = verify(
        reference, gaits_of(reference.gait, random_phases(4, 6, seed=8), jnp.asarray(amplitude)), 3.0, options=OPTIONS
    )
    assert np.isnan(verified.distance).tolist() == [False, False, True, False]
    assert np.isinf(verified.error_bar).tolist() == [False, False, True, False]
