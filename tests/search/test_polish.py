"""Polish: improvements are kept only when they verify, and gradients are refused where they mean nothing."""

import equinox as eqx
import numpy as np
import pytest

from jaxgrity import (
    Fitness,
    Genome,
    InputError,
    PolishConfig,
    SearchProblem,
    SolverOptions,
    SteadySpeed,
    Straightness,
    Uncertainty,
    check_polish,
    polish,
    random_phases,
)
from jaxgrity.search.gradients import smoothed_gradients

OPTIONS = SolverOptions(dt=1e-2)
ROBUST = Fitness(uncertainty=Uncertainty(phase=0.03), robots=4)
SMALL = PolishConfig(
    rollouts=480,
    samples=12,
    robots=4,
    width=(0.02, 0.02),
    learning_rate=0.02,
    comparison_robots=16,
    final_robots=16,
)


def polished(scene, config, starts=1, fitness=ROBUST, on_step=None):
    """From random gaits, over 4 s at a coarse step."""
    genes = random_phases(starts, 6, seed=7) / (2 * np.pi)
    problem = SearchProblem(scene, Genome(6), 4.0, fitness)
    return genes, polish(problem, genes, config, options=OPTIONS, final_options=OPTIONS, on_step=on_step)


@pytest.mark.slow
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


@pytest.mark.slow
def test_the_best_of_several_climbs_counts(exact):
    """Each climb has its share, and the comparison of their ends is paid; the result beats the first start."""
    _, result = polished(exact, SMALL, starts=2)
    assert result.rollouts == 2 * 4 * 48 + 2 * 16
    assert result.after.mean[0] > result.before.mean[0]


@pytest.mark.slow
def test_polish_keeps_the_start_where_nothing_is_gained(exact):
    """Steps of no length gain nothing."""
    genes, result = polished(exact, SMALL._replace(rollouts=48, learning_rate=0.0))
    assert not result.improved
    assert "kept as it was" in result.reason
    np.testing.assert_array_equal(result.genes, genes[0])


@pytest.mark.slow
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


@pytest.fixture(scope="module")
def brisk(exact):
    """With a gait at 1 Hz, whose first period is over before it becomes sensitive."""
    return eqx.tree_at(lambda s: s.gait.frequency, exact, np.ones(6))


@pytest.mark.slow
def test_pathwise_polish_where_the_sensitivity_allows_it(brisk):
    """Over the horizon that the measured sensitivity allows, and half way there in the first half of its steps."""
    _, result = polished(brisk, SMALL._replace(kind="pathwise", rollouts=600, largest_sensitivity=3.0))
    assert result.horizon == result.sensitivity.horizon(3.0)
    ahead = [step.horizon for step in result.steps]
    assert ahead[0] < ahead[-1] == result.horizon
    assert all(step.pathwise_share == 1 for step in result.steps)
    assert result.improved


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["smoothed", "combined"])
def test_climbs_keep_their_precision(brisk, kind, monkeypatch):
    """Gradients in float32 stay there: a gait in float64 would be rolled out in float64, at twice the cost."""
    found = []

    def watched(*arguments):
        found.append(smoothed_gradients(*arguments))
        return found[-1]

    monkeypatch.setattr("jaxgrity.search.climb.smoothed_gradients", watched)
    polished(brisk, SMALL._replace(kind=kind, rollouts=300))
    assert len(found) > 1
    assert {leaf.dtype for gradient in found for leaf in gradient} == {np.dtype("float32")}


def test_bad_polish_configs_are_refused(exact):
    """An unknown gradient, too few rollouts, and a pathwise gradient of what needs metrics."""
    with pytest.raises(InputError, match="polishing by 'exact': unknown"):
        polished(exact, SMALL._replace(kind="exact"))
    with pytest.raises(InputError, match=r"8 rollouts of polish: expected 128 or more \(climbs: 2\)"):
        polished(exact, SMALL._replace(rollouts=8), starts=2)
    with pytest.raises(InputError, match=r"80 rollouts of polish: expected 128 or more \(climbs: 2\)"):
        check_polish(SMALL._replace(rollouts=2 * 16 + 48), ROBUST, 2)
    check_polish(SMALL._replace(rollouts=2 * (16 + 48)), ROBUST, 2)
    measured = Fitness(Straightness())
    with pytest.raises(InputError, match="an objective or a bound that needs metrics has no pathwise gradient"):
        polished(exact, SMALL._replace(kind="pathwise"), fitness=measured)
    cautious = Fitness(uncertainty=Uncertainty(phase=0.03), robots=4, caution=1.0)
    with pytest.raises(InputError, match="caution has no pathwise gradient"):
        polished(exact, SMALL._replace(kind="combined"), fitness=cautious)
    with pytest.raises(InputError, match="a steady objective has no pathwise gradient"):
        polished(exact, SMALL._replace(kind="pathwise"), fitness=Fitness(SteadySpeed()))
    with pytest.raises(InputError, match="samples = 5: expected an even number"):
        polished(exact, SMALL._replace(samples=5))
