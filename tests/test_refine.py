"""Polish: right gradients, improvements kept only when they verify, and a refusal where gradients mean nothing."""

import jax
import numpy as np
import pytest

from jaxgrity import InputError, Polishing, gaits_of, polish, random_phases, sensitivity, simulate_population, verify
from jaxgrity.diagnostics import Sensitivity
from jaxgrity.gradients import distance_and_gradient, distances
from jaxgrity.scene import as_dtype
from jaxgrity.simulate import settle


def test_reverse_mode_gradient_is_the_derivative(reference):
    """Against central differences over the first second of the gait; h = 1e-5 leaves an error of about 1e-9."""
    settings = settle(reference, 2.0, dt=1e-3, dtype="float64")
    scene, phase = as_dtype(reference, "float64"), random_phases(2, 6, seed=5)
    both = jax.jit(lambda p: distance_and_gradient(scene, gaits_of(scene.gait, p), 2.0, settings))
    _, gradient = both(phase)
    for k in (0, 4):
        step = np.zeros(6)
        step[k] = 1e-5
        slope = (both(phase + step)[0] - both(phase - step)[0]) / 2e-5
        np.testing.assert_allclose(gradient[:, k], slope, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("name", ["reference", "exact"])
def test_reverse_mode_is_forward_mode(request, name):
    """The same derivative of the same steps, to rounding, by both modes and both methods."""
    scene = as_dtype(request.getfixturevalue(name), "float64")
    dt = 1e-3 if name == "reference" else 1e-2
    settings = settle(scene, 1.5, dt=dt, dtype="float64", any_step=True)
    phase = random_phases(3, 6, seed=5)

    def distance(p):
        return distances(scene, gaits_of(scene.gait, p), 1.5, settings)

    _, gradient = jax.jit(lambda p: distance_and_gradient(scene, gaits_of(scene.gait, p), 1.5, settings))(phase)
    tangents = np.broadcast_to(np.eye(6)[:, None], (6, 3, 6))
    forward = jax.jit(lambda p: jax.lax.map(lambda t: jax.jvp(distance, (p,), (t,))[1], tangents))(phase)
    assert np.abs(gradient).max() > 1e-3
    np.testing.assert_allclose(gradient, forward.T, rtol=0, atol=1e-9 * np.abs(gradient).max())


@pytest.fixture(scope="module")
def starting(reference):
    """Two random gaits to polish."""
    return gaits_of(reference.gait, random_phases(2, 6, seed=7))


def test_polish_improves_and_verifies(reference, starting):
    """From random gaits there is much to gain: what is returned is further than the best of them, by its own bars."""
    before = verify(reference, starting, 4.0, 1e-3)
    steps = []
    result = polish(
        reference,
        starting,
        4.0,
        Polishing(8, learning_rate=0.1, largest_sensitivity=1e3),
        dt=1e-3,
        on_step=lambda k, d: steps.append(k),
    )
    assert steps == list(range(8))
    assert result.improved
    assert "verified gain" in result.reason
    assert result.verified.distance[0] > before.distance.max() + result.verified.error_bar[0]
    again = verify(reference, gaits_of(reference.gait, result.gait.phase[None]), 4.0, 1e-3)
    np.testing.assert_allclose(again.distance, result.verified.distance, rtol=0, atol=1e-12)


def test_polish_keeps_the_start_where_nothing_verifies(reference, starting):
    """A step too small to matter gains less than the error bars: the best start is returned, and the reason says so."""
    before = verify(reference, starting, 4.0, 1e-3)
    best = int(np.argmax(before.distance - before.error_bar))
    result = polish(reference, starting, 4.0, Polishing(1, learning_rate=1e-9, largest_sensitivity=1e3), dt=1e-3)
    assert not result.improved
    assert "no gait on the way" in result.reason
    np.testing.assert_array_equal(result.gait.phase, starting.phase[best])


def test_no_gradient_where_the_sensitivity_forbids_it(reference, starting):
    """With a bound that any motion passes, no gradient step is taken, and the reason names the bound."""
    result = polish(reference, starting, 4.0, Polishing(5, largest_sensitivity=1e-6), dt=1e-3)
    assert not result.improved
    assert len(result.gradient_norm) == 0
    assert "no gradient was used" in result.reason


def test_polish_refuses_gaits_that_all_fail(reference):
    """Amplitudes that tear every robot apart leave nothing to polish."""
    gaits = gaits_of(reference.gait, random_phases(2, 6, seed=7), amplitude=np.full((2, 6), 1e9))
    with pytest.raises(InputError, match="every gait failed"):
        polish(reference, gaits, 2.0, dt=1e-3)


def test_error_bar_covers_the_error(reference):
    """Against a step 16 times smaller, for gaits that nothing was tuned on."""
    gaits = gaits_of(reference.gait, random_phases(4, 6, seed=8))
    verified = verify(reference, gaits, 3.0, 1e-3)
    truth = verify(reference, gaits, 3.0, 1e-3 / 16)
    assert np.all(np.linalg.norm(verified.com_end - truth.com_end, axis=1) <= verified.error_bar)
    assert np.all(verified.error_bar < 0.05)
    assert verified.steps == (1e-3, 5e-4, 2.5e-4)


def test_error_bar_of_a_failure_is_infinite(reference):
    """A gait that cannot be integrated has no distance, and says so."""
    gaits = gaits_of(reference.gait, random_phases(1, 6, seed=7), amplitude=np.full((1, 6), 1e9))
    verified = verify(reference, gaits, 2.0, 1e-3)
    assert np.isnan(verified.distance[0])
    assert np.isinf(verified.error_bar[0])


def test_sensitivity_is_the_derivative_of_the_path(reference):
    """Zero until the gait starts, then the norm of d com/d phase, here by central differences."""
    growth = sensitivity(reference, 2.0, dt=1e-3)
    assert growth.norm[growth.times <= 1.0].max() == 0
    phase, columns = np.asarray(reference.gait.phase), []
    for k in range(6):
        ends = []
        for sign in (1, -1):
            changed = phase.copy()
            changed[k] += sign * 1e-5
            ends.append(
                simulate_population(reference, gaits_of(reference.gait, changed[None]), 2.0, dt=1e-3).com_end[0]
            )
        columns.append((ends[0] - ends[1]) / 2e-5)
    assert growth.norm[-1] == pytest.approx(np.linalg.norm(np.array(columns), 2), rel=1e-5)


def test_horizon_is_the_last_time_before_the_bound_is_passed():
    """Also where the norm falls again later, and where it is never passed, or at once."""
    growth = Sensitivity(np.arange(5.0), np.array([0.0, 1.0, 2.0, 9.0, 1.0]))
    assert growth.horizon(2.0) == 2.0
    assert growth.horizon(10.0) == 4.0
    assert growth.horizon(-1.0) == 0.0
