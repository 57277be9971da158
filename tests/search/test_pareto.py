"""A Pareto front: none of its gaits dominates another, and each needs what its rollout says."""

import jax
import jaxtyping
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxgrity import ActuatorBounds, Fitness, GAConfig, Genome, InputError, SearchProblem, SolverOptions
from jaxgrity.model.actuation import actuated_lengths, peak_rates
from jaxgrity.populations.population import roll_out
from jaxgrity.search import pareto_front
from jaxgrity.search.models import model_of
from jaxgrity.search.pareto import best_first, ranks_of

CONFIG = GAConfig(population=12, generations=4, elites=4, parents=6, mutation_rate=1.0)
OPTIONS = SolverOptions(dt=1e-2)


@pytest.fixture(scope="module")
def problem(swimmer):
    """Phases, amplitudes and the frequency of a swimmer; fitness is the distance."""
    genome = Genome(2, amplitude=(0.05, 0.5), frequency=(0.5, 1.5))
    return SearchProblem(swimmer, genome, 2.0, Fitness(bounds=ActuatorBounds(power=50.0, force=80.0)))


@pytest.fixture(scope="module")
def fronts(problem):
    """The front of the last generation, and those of all."""
    seen = []
    return pareto_front(problem, CONFIG, seed=1, options=OPTIONS, on_generation=seen.append), seen


pairs = st.lists(st.tuples(st.integers(0, 4), st.integers(0, 4)), min_size=1, max_size=12)


@given(pairs)
def test_ranks_are_those_of_the_definition(points):
    """Front by front: what is left without the fronts before, and not dominated by any of these."""
    fitness, need = np.array(points, float).T
    dominates = lambda a, b: fitness[a] >= fitness[b] and need[a] <= need[b] and points[a] != points[b]  # noqa: E731
    left, rank = set(range(len(points))), 0
    ranks = ranks_of(fitness, need)
    while left:
        front = {k for k in left if not any(dominates(other, k) for other in left)}
        assert set(np.flatnonzero(ranks == rank)) == front
        left, rank = left - front, rank + 1


def test_ends_come_first_and_crowded_gaits_last():
    """Of four gaits on a front the two ends, then the one with more room; then those behind it."""
    fitness, need = np.array([1.0, 1.1, 2.0, 3.0, 0.5]), np.array([1.0, 1.1, 2.0, 3.0, 4.0])
    order = best_first(fitness, need).tolist()
    assert set(order[:2]) == {0, 3}
    assert order[2:] == [2, 1, 4]


def test_failed_gaits_come_last():
    """Their fitness is -inf, and their need infinite."""
    fitness, need = np.array([-np.inf, 1.0, -np.inf, 2.0]), np.array([np.inf, 1.0, np.inf, 5.0])
    assert set(best_first(fitness, need)[2:].tolist()) == {0, 2}


@pytest.mark.parametrize("against", ["power", "force", "rate"])
@pytest.mark.slow
def test_a_front_says_what_its_gaits_need(problem, fronts, against):
    """Fitness and need ascend together, and are those of the gaits' own rollouts."""
    bounded = problem._replace(fitness=Fitness(bounds=ActuatorBounds(power=50.0, force=80.0, rate=2.0)))
    last = fronts[0] if against == "power" else pareto_front(bounded, CONFIG, against=against, seed=1, options=OPTIONS)
    assert len(last.need) >= 2
    assert np.all(np.diff(last.need) > 0)
    assert np.all(np.diff(last.fitness) > 0)
    scene, options = model_of(problem.scene, problem.duration, OPTIONS)
    gaits = problem.genome.gaits(problem.scene.gait, last.genes)
    outcomes = roll_out(scene, gaits, np.asarray(2.0), options, None, with_metrics=True)
    if against == "rate":  # at full amplitude, as for bounds
        peak = peak_rates(gaits, actuated_lengths(scene.structure, scene.gait.members))
    else:
        peak = getattr(outcomes.metrics, f"peak_{against}")
    np.testing.assert_allclose(last.need, peak.max(-1), rtol=1e-6)
    np.testing.assert_allclose(last.fitness, outcomes.distance(), rtol=1e-6)


def test_a_front_is_found_again_and_grows(problem, fronts):
    """The same seed gives the same front, to the last bit; later fronts reach farther."""
    last, seen = fronts
    again = pareto_front(problem, CONFIG, seed=1, options=OPTIONS)
    assert jax.tree.all(jax.tree.map(np.array_equal, last, again))
    assert [each.rollouts for each in seen] == [12, 24, 36, 48]
    assert seen[-1].fitness.max() >= seen[0].fitness.max()


def test_gaits_below_the_least_fitness_come_last(problem, fronts):
    """So the front begins there; where none reaches it, it is empty, and the fastest are bred all the same."""
    middle = float(np.median(fronts[0].fitness))
    above = pareto_front(problem, CONFIG, least=middle, seed=1, options=OPTIONS)
    assert len(above.need)
    assert above.fitness.min() >= middle
    assert best_first(np.array([0.1, 0.3, 0.2, 0.5]), np.array([np.inf, np.inf, np.inf, 9.0])).tolist() == [3, 1, 2, 0]
    nothing = pareto_front(problem, CONFIG, least=1e3, seed=1, options=OPTIONS)
    assert nothing.fitness.size == nothing.need.size == 0
    with pytest.raises(InputError, match="least = nan: expected a number"):
        pareto_front(problem, CONFIG, least=np.nan, options=OPTIONS)


def test_a_front_needs_a_scale(problem):
    """A bound on what is compared."""
    with pytest.raises(InputError, match=r"bounds: none on the rate; expected ActuatorBounds\(rate=\.\.\.\)"):
        pareto_front(problem, CONFIG, against="rate", options=OPTIONS)


def test_a_front_is_against_what_has_a_bound(problem):
    """Another word is answered with those that there are."""
    jaxtyping.config.update("jaxtyping_disable", True)  # which users do not have; of this test alone
    with pytest.raises(InputError, match="against = 'forces': unknown; perhaps you meant force; expected one of"):
        pareto_front(problem, CONFIG, against="forces", options=OPTIONS)


def test_a_front_is_not_of_cma_es(problem, monkeypatch):
    """It would be bred all the same, whether or not the extra is installed."""
    monkeypatch.setattr("jaxgrity.search.genetic_algorithm.check_optimiser", lambda name: None)
    pytest.importorskip("evosax", reason="without it, the configuration is refused")
    with pytest.raises(InputError, match="optimiser = 'cma-es': a front is bred; expected 'genetic'"):
        pareto_front(problem, GAConfig(population=16, optimiser="cma-es"), options=OPTIONS)
