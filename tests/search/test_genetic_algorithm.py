"""The genetic algorithm: circular genes, elites, repeatability, what is uncertain, failures."""

import dataclasses
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrity import (
    ActuatorBounds,
    Direction,
    Fitness,
    GAConfig,
    Genome,
    InputError,
    SearchProblem,
    SolverOptions,
    Uncertainty,
    evolve,
)
from jaxgrity.report import plot
from jaxgrity.search import FidelityLevel, Generation, distinct, judge_at, open_checkpoint
from jaxgrity.search.genetic_algorithm import begin, breed

SMALL = GAConfig(population=12, generations=3, elites=2)
OPTIONS = SolverOptions(dt=1e-2, dtype="float32")


@pytest.fixture(scope="module")
def problem(swimmer):
    """Phases alone, the distance of one robot in 2 s."""
    return SearchProblem(swimmer, Genome(2), 2.0, Fitness())


@pytest.fixture(scope="module")
def search(problem):
    """One small search, and the state that each generation reported."""
    seen = []
    result = evolve(problem, SMALL, seed=3, options=OPTIONS, on_generation=seen.append)
    return result, seen


def assert_same(mine, its):
    """Two searches with the same end, to the last bit."""
    for a, b in zip(jax.tree.leaves(mine), jax.tree.leaves(its), strict=True):
        np.testing.assert_array_equal(a, b)


def test_elites_survive(search):
    """The best gait never gets worse, and the last generation is sorted, best first."""
    result, _ = search
    assert np.all(np.diff(result.best) >= 0)
    assert np.all(np.diff(np.asarray(result.last.fitness)) <= 0)
    assert result.rollouts == 36


def test_the_record_tells_where_no_gait_keeps_the_bounds(problem, search):
    """Its best is the one least beyond then, and marked as such in the figure."""
    everyone = np.full(SMALL.generations, SMALL.population)
    np.testing.assert_array_equal(search[0].within, everyone)
    tight = problem._replace(fitness=dataclasses.replace(problem.fitness, bounds=ActuatorBounds(rate=1e-6)))
    beyond = evolve(tight, SMALL, seed=3, options=OPTIONS)
    np.testing.assert_array_equal(beyond.within, 0 * everyone)
    labels = [
        [text.get_text() for text in plot.convergence_figure([result]).axes[0].get_legend().get_texts()]
        for result in (search[0], beyond)
    ]
    assert labels == [["best", "median"], ["best", "median", "every gait beyond a bound"]]


def test_every_generation_is_reported(search):
    """Progress arrives once a generation: as evaluated, with the record so far and the genes that come next."""
    result, seen = search
    assert [state.number for state in seen] == [1, 2, 3]
    for state in seen:
        assert state.record.best.tolist() == result.best[: state.number].tolist()
        assert float(state.evaluated.fitness[0]) == result.best[state.number - 1]
        assert float(np.median(state.evaluated.fitness)) == result.median[state.number - 1]
    assert_same(seen[-1].evaluated, result.last)
    for before, after in pairwise(seen):
        np.testing.assert_array_equal(before.genes[:2], before.evaluated.genes[:2])
        # sorted by fitness since
        assert sorted(before.genes.tolist()) == sorted(after.evaluated.genes.tolist())


def test_a_seed_repeats_its_search(problem, search):
    """The same seed gives the same genes to the last bit, another seed others."""
    result, _ = search
    assert_same(evolve(problem, SMALL, seed=3, options=OPTIONS), result)
    other = evolve(problem, SMALL, seed=4, options=OPTIONS)
    assert not np.array_equal(result.last.genes, other.last.genes)


def test_a_search_goes_on_from_any_of_its_states(problem, search, tmp_path):
    """To the very same end, also where the state comes from a file, and whatever the seed."""
    result, seen = search
    first = begin(Genome(2), SMALL, 3, "float32")
    with open_checkpoint(tmp_path, {}) as checkpoint:
        for number, state in enumerate((first, *seen)):
            checkpoint.save(number, state)
    with open_checkpoint(tmp_path, {}, resume=True) as checkpoint:
        for state in (first, *seen, *checkpoint.states):
            later = []
            again = evolve(problem, SMALL, seed=7, options=OPTIONS, state=state, on_generation=later.append)
            assert_same(again, result)
            assert [s.number for s in later] == list(range(state.number + 1, 4))
            assert_same(later, seen[state.number :])


def test_nothing_is_spread_where_nothing_is_uncertain(search):
    """One robot a gait."""
    np.testing.assert_array_equal(search[0].last.spread, 0)


@pytest.mark.slow
def test_a_robust_search_repeats_with_its_seed(swimmer):
    """To the last bit, by the same draws, with genes that count symmetries; gaits are judged with their spread."""
    doubts = Uncertainty(phase=0.2, actuation=0.3)
    fitness = Fitness(Direction(heading=1.0), doubts, robots=3, caution=1.0)
    genome = Genome(2, images=((0, 1), (1, 0)))
    seen = []
    problem = SearchProblem(swimmer, genome, 2.0, fitness)
    result = evolve(problem, SMALL, seed=1, options=OPTIONS, on_generation=seen.append)
    assert result.rollouts == 36 * 3
    assert np.asarray(result.last.spread).min() > 0
    assert_same(evolve(problem, SMALL, seed=1, options=OPTIONS), result)
    assert_same(evolve(problem, SMALL, options=OPTIONS, state=seen[0]), result)
    # elites are judged again, by other robots
    before, after = (dict(zip(map(tuple, s.evaluated.genes.tolist()), s.evaluated.fitness.tolist())) for s in seen[:2])
    known, elites = set(before) & set(after), {tuple(genes) for genes in seen[0].evaluated.genes[:2].tolist()}
    assert elites <= known
    assert all(before[genes] != after[genes] for genes in known)


def test_children_of_parents_across_the_seam_stay_there():
    """Parents at 0.95 and 0.05 of a turn have children near 0, not near 0.5; bounded genes stay in their bounds."""
    config = GAConfig(population=64, generations=2, elites=1, mutation_rate=0.0)
    genes = np.tile([[0.95, 0.0], [0.05, 1.0]], (32, 1))
    generation = Generation(jnp.asarray(genes), jnp.zeros(64), jnp.zeros(64), jnp.array(0))
    children = np.asarray(breed(jax.random.key(0), generation, 0.0, Genome(1, frequency=(0.1, 1.0)), config))
    from_seam = np.minimum(children[:, 0], 1 - children[:, 0])
    assert from_seam.max() <= 0.06 + 1e-12
    assert children[:, 1].min() >= 0
    assert children[:, 1].max() <= 1
    assert np.ptp(children[:, 1]) > 0.5


def test_children_of_one_parent_are_near_one_of_the_best():
    """Without crossover every child is a mutation of one gait, and of the few best alone where so many are parents."""
    config = GAConfig(32, 2, 1, mutation_rate=1.0, mutation_size=(0.01, 0.01), crossover=0.0, parents=3)
    genes = np.linspace(0, 0.9, 32)[:, None] * np.ones(2)
    generation = Generation(jnp.asarray(genes), jnp.zeros(32), jnp.zeros(32), jnp.array(0))
    children = np.asarray(breed(jax.random.key(1), generation, 0.0, Genome(2), config))
    gaps = np.abs((children[1:, None] - genes[:3] + 0.5) % 1 - 0.5).max(-1)
    assert gaps.min(1).max() < 0.06
    assert set(gaps.argmin(1)) == {0, 1, 2}


def test_a_wide_first_generation_hands_on_its_best(problem):
    """Of 24 gaits drawn at random 6 go on; all of them were rolled out, and are in the record."""
    config = GAConfig(population=6, generations=2, elites=2, drawn=24)
    seen = []
    found = evolve(problem, config, seed=3, options=OPTIONS, on_generation=seen.append)
    assert found.rollouts == 24 + 6
    assert len(found.last.genes) == 6
    drawn = np.asarray(begin(problem.genome, config, 3, "float32").genes)
    level = FidelityLevel("", problem.scene, OPTIONS.dt, "float32")
    worth = judge_at(level, problem.genome.gaits(problem.scene.gait, drawn), problem, 0).fitness
    np.testing.assert_array_equal(seen[0].evaluated.genes, drawn[np.argsort(-worth, kind="stable")[:6]])
    assert found.median[0] == np.median(worth)
    assert found.within[0] == 24
    with pytest.raises(InputError, match="drawn = 4: expected a whole number, at least 6"):
        GAConfig(population=6, elites=2, drawn=4)
    with pytest.raises(InputError, match="parents = 7: expected 1 to 6, the population"):
        GAConfig(population=6, elites=2, parents=7)


def test_children_of_images_are_images_of_a_parent():
    """Parents that are one gait, seen from two sides, have children that are this gait, not half of each."""
    config = GAConfig(population=64, generations=2, elites=1, mutation_rate=0.0)
    genome = Genome(3, images=((0, 1, 2), (1, 2, 0), (2, 0, 1)))
    genes = np.tile([[0.1, 0.3, 0.6], [0.3, 0.6, 0.1]], (32, 1))
    generation = Generation(jnp.asarray(genes), jnp.zeros(64), jnp.zeros(64), jnp.array(0))
    children = breed(jax.random.key(0), generation, 0.0, genome, config)
    np.testing.assert_allclose(jax.jit(genome.gap)(jnp.asarray(genes), children), 0, atol=1e-15)


@pytest.mark.slow
def test_everything_evolves_and_failed_rollouts_rank_last(exact):
    """The widest genome runs through a whole search. Ten strokes a second of almost a strut's length tear some robots
    apart: they are counted, and none of them outranks a success."""
    genome = Genome(6, amplitude=(0.7, 0.95), frequency=(5.0, 15.0), overtones=1, active=5)
    seen = []
    problem, config = SearchProblem(exact, genome, 2.0, Fitness()), GAConfig(32, 2, elites=1)
    result = evolve(problem, config, options=OPTIONS, on_generation=seen.append)
    assert result.last.genes.shape == (32, 31)
    assert np.isfinite([result.best, result.median]).all()
    fitness, failed = np.asarray(seen[0].evaluated.fitness), int(result.failed[0])
    assert 0 < failed < len(fitness)
    assert np.isneginf(fitness[-failed:]).all()
    assert np.isfinite(fitness[:-failed]).all()


def test_distinct_gaits_differ():
    """The same gait twice counts once, also across the seam of the circle, or turned; what failed does not count."""
    genes = np.array([[0.999, 0.5], [0.001, 0.5], [0.3, 0.5], [0.5, 0.3], [0.7, 0.7]])
    fitness = jnp.array([3.0, 2.0, 1.0, 0.5, -jnp.inf])
    generation = Generation(jnp.asarray(genes), fitness, jnp.zeros(5), jnp.array(1))
    np.testing.assert_array_equal(distinct(generation, Genome(2), 5), genes[[0, 2, 3]])
    np.testing.assert_array_equal(distinct(generation, Genome(2), 2), genes[[0, 2]])
    np.testing.assert_array_equal(distinct(generation, Genome(2, images=((0, 1), (1, 0))), 5), genes[[0, 2]])


def test_bad_configs_are_refused():
    """Elites that fill the population; too few gaits, generations or gaits in a tournament."""
    with pytest.raises(InputError, match="elites = 8: expected 1 to 7"):
        GAConfig(population=8, elites=8)
    with pytest.raises(InputError, match="population = 0: expected a whole number, at least 2"):
        GAConfig(population=0)
    for options in ({"generations": 0}, {"tournament": 0}):
        with pytest.raises(InputError, match="= 0: expected a whole number, at least 1"):
            GAConfig(**options)


def test_a_search_begins_with_a_gait_and_its_mutations():
    """The gait comes first and unchanged; mutations are of all sizes up to that of the first generation."""
    parent, config = np.array([0.05, 0.6]), GAConfig(population=400, generations=2, mutation_size=(0.1, 0.02))
    genes = np.asarray(begin(Genome(2), config, 3, "float64", parent).genes)
    np.testing.assert_array_equal(genes[0], parent)
    assert np.all((genes >= 0) & (genes < 1))  # around the circle
    away = np.abs((genes[1:] - parent + 0.5) % 1 - 0.5)
    for size, share in ((0.3, 1.0), (0.03, 0.8), (0.003, 0.3)):
        assert abs(np.mean(away < size) - share) < 0.12
