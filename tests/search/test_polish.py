"""Polish: right gradients, improvements kept only when they verify, and a refusal where gradients mean nothing."""

import equinox as eqx
import jax
import numpy as np
import pytest
from scipy.special import ndtri

from jaxgrity import (
    Fitness,
    Genome,
    InputError,
    Objective,
    Polishing,
    Uncertainty,
    gaits_of,
    polish,
    random_phases,
    sensitivity,
    simulate_population,
    verify,
)
from jaxgrity.trust.error_bars import Sensitivity
from jaxgrity.search.gradients import (
    Gradient,
    Task,
    combine,
    distance_and_gradient,
    distances,
    pathwise_gradient,
    smoothed_gradient,
    utilities,
)
from jaxgrity.search.polish import check_polishing
from jaxgrity.model.scene import as_dtype
from jaxgrity.stepping.simulate import settle


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


HORIZON, STEP = 4.0, 1e-2
GENOME = Genome(6)
ROBUST = Fitness(uncertainty=Uncertainty(phase=0.03), robots=4)
SMALL = Polishing(rollouts=480, samples=12, robots=4, width=(0.02, 0.02), learning_rate=0.02, final_robots=16)


def polished(scene, polishing, starts=1, **options):
    """From random gaits, over 4 s at a coarse step."""
    genes = random_phases(starts, 6, seed=7) / (2 * np.pi)
    options = {"fitness": ROBUST, "dt": STEP, "final_dt": STEP, "final_robots": 16} | options
    return genes, polish(scene, GENOME, genes, HORIZON, polishing, **options)


def test_polish_improves_and_verifies(exact):
    """From a random gait there is much to gain; the last judgement in float64 repeats what is returned."""
    steps = []
    _, result = polished(exact, SMALL, on_step=steps.append)
    assert result.improved
    assert "the polished gait is kept" in result.reason
    assert result.after.mean[0] > result.before.mean[0] + 0.1
    assert tuple(steps) == result.steps
    assert result.rollouts == 480 == len(steps) * 48
    _, again = polished(exact, SMALL)
    np.testing.assert_array_equal(again.genes, result.genes)
    np.testing.assert_array_equal(again.after.each, result.after.each)


def test_the_best_of_several_climbs_counts(exact):
    """Each climb has its share, and the comparison of their ends is paid; the result beats the first start."""
    _, result = polished(exact, SMALL, starts=2)
    assert result.rollouts == 2 * 4 * 48 + 2 * 16
    assert result.after.mean[0] > result.before.mean[0]


def test_polish_keeps_the_start_where_nothing_is_gained(exact):
    """Steps of no length gain nothing."""
    genes, result = polished(exact, SMALL._replace(rollouts=48, learning_rate=0.0))
    assert not result.improved
    assert "kept as it was" in result.reason
    np.testing.assert_array_equal(result.genes, genes[0])


@pytest.mark.parametrize("kind", ["pathwise", "combined"])
def test_no_pathwise_gradient_where_the_sensitivity_forbids_it(exact, kind):
    """With a bound that any motion passes it is not used, and the reason says so; the combined one goes on smoothed."""
    genes, result = polished(exact, SMALL._replace(kind=kind, largest_sensitivity=1e-6))
    assert "no pathwise gradient was used: |d com/d phase| passes 1e-06 m/rad" in result.reason
    assert all(step.pathwise_share == 0 for step in result.steps)
    if kind == "pathwise":
        assert not result.steps
        assert not result.improved
        np.testing.assert_array_equal(result.genes, genes[0])
    else:
        assert result.improved


def test_pathwise_polish_where_the_sensitivity_allows_it(exact):
    """Over the horizon that the measured sensitivity allows, and half way there in the first half of its steps."""
    quick = eqx.tree_at(lambda s: s.gait.frequency, exact, np.ones(6))
    _, result = polished(quick, SMALL._replace(kind="pathwise", rollouts=600, samples=4, largest_sensitivity=3.0))
    assert result.horizon == result.sensitivity.horizon(3.0)
    ahead = [step.horizon for step in result.steps]
    assert ahead[0] < ahead[-1] == result.horizon
    assert all(step.pathwise_share == 1 for step in result.steps)
    assert result.improved


def test_smoothed_and_pathwise_gradients_agree(exact):
    """In the first second of a gait, where the distance is smooth: within two standard errors of the first one,
    which are a fifth of it at most."""
    settings = settle(exact, 2.0, None, STEP, "float64")
    task = Task(as_dtype(exact, "float64"), GENOME, 2.0, settings, Fitness(), width=1e-3)
    genes = jax.numpy.asarray(random_phases(1, 6, seed=7)[0] / (2 * np.pi))
    smoothed = smoothed_gradient(jax.random.key(0), genes, task, np.asarray(2.0), 512, 1)
    pathwise = pathwise_gradient(jax.random.key(0), genes, task, 2.0, 4)
    assert float(pathwise.noise) < 1e-20
    assert float(smoothed.value) == pytest.approx(float(pathwise.value), abs=1e-4)
    error = float(np.sqrt(smoothed.noise))
    assert error < 0.2 * np.linalg.norm(pathwise.mean)
    assert np.linalg.norm(smoothed.mean - pathwise.mean) < 2 * error


def test_utilities():
    """The best weighs most and the worse half alike, however far it falls or fails; nothing is known where a quarter
    failed."""
    normal = np.random.default_rng(0).permutation(ndtri((np.arange(64) + 0.5) / 64))
    fitness = 3 + 0.1 * normal
    found, scale = utilities(fitness)
    assert np.argmax(found) == np.argmax(fitness)
    assert np.ptp(found[fitness < 3]) == 0
    for fallen in (-9.0, -np.inf):
        other, same = utilities(np.where(fitness == fitness.min(), fallen, fitness))
        np.testing.assert_array_equal(other, found)
        assert same == scale
    some = np.arange(12.0)
    assert utilities(np.where(some < 2, -np.inf, some))[1] > 0
    assert utilities(np.where(some < 3, -np.inf, some))[1] == 0


def test_utilities_covary_with_a_normal_fitness_as_it_does():
    """Of 64 gaits, over 2000 samples, to 5%: the scaled ones have its variance for a covariance with it."""
    samples = 0.3 * np.random.default_rng(0).normal(size=(2000, 64))
    found, scale = jax.vmap(utilities)(samples)
    covariance = np.mean((found - found.mean(1, keepdims=True)) * np.asarray(scale)[:, None] * samples)
    assert covariance == pytest.approx(0.09, rel=0.05)


@pytest.mark.parametrize("kind", ["smoothed", "combined"])
def test_climbs_keep_their_precision(exact, kind, monkeypatch):
    """Gradients in float32 stay there: a gait in float64 would be rolled out in float64, at twice the cost."""
    found = []

    def watched(*arguments):
        found.append(smoothed_gradient(*arguments))
        return found[-1]

    monkeypatch.setattr("jaxgrity.refine.smoothed_gradient", watched)
    polished(exact, SMALL._replace(kind=kind, rollouts=300))
    assert len(found) > 1
    assert {leaf.dtype for gradient in found for leaf in gradient} == {np.dtype("float32")}


def test_gradients_are_combined_by_their_variances():
    """A quarter of the variance has four times the weight; one that is not finite has none."""
    one, other = Gradient(1.0, np.array([1.0, 0.0]), 4.0), Gradient(2.0, np.array([0.0, 1.0]), 1.0)
    both, share = combine(one, other)
    assert float(share) == pytest.approx(0.8)
    np.testing.assert_allclose(both.mean, [0.2, 0.8])
    assert float(both.noise) == pytest.approx(0.8)
    for nothing in (Gradient(2.0, np.zeros(2), np.nan), Gradient(2.0, np.full(2, np.nan), np.nan)):
        both, share = combine(one, nothing)
        assert float(share) == 0
        np.testing.assert_allclose(both.mean, one.mean)
        assert both.noise == 4
        both, share = combine(nothing, one)
        assert float(share) == 1
        np.testing.assert_allclose(both.mean, one.mean)
        assert both.noise == 4
    certain = Gradient(1.0, np.ones(2), 0.0)
    assert np.isfinite(combine(certain, certain)[0].mean).all()


def test_bad_polishing_is_refused(exact):
    """An unknown gradient, too few rollouts, and a pathwise gradient of what is metered."""
    with pytest.raises(InputError, match="polishing by 'exact': unknown"):
        polished(exact, SMALL._replace(kind="exact"))
    with pytest.raises(InputError, match="8 rollouts of polish: expected 128 or more, for 2 climbs"):
        polished(exact, SMALL._replace(rollouts=8), starts=2)
    with pytest.raises(InputError, match="80 rollouts of polish: expected 128 or more, for 2 climbs"):
        check_polishing(SMALL._replace(rollouts=2 * 16 + 48), ROBUST, 2)
    check_polishing(SMALL._replace(rollouts=2 * (16 + 48)), ROBUST, 2)
    metered = Fitness(Objective("straightness"))
    with pytest.raises(InputError, match="what is metered has no pathwise gradient"):
        polished(exact, SMALL._replace(kind="pathwise"), fitness=metered)
    cautious = Fitness(uncertainty=Uncertainty(phase=0.03), robots=4, caution=1.0)
    with pytest.raises(InputError, match="caution has no pathwise gradient"):
        polished(exact, SMALL._replace(kind="combined"), fitness=cautious)
    with pytest.raises(InputError, match="samples = 5: expected an even number"):
        polished(exact, SMALL._replace(samples=5))


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
