"""The genetic algorithm: circular genes, elites, repeatability, failures."""

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxgrity import Breeding, Genome, InputError, distinct, evolve
from jaxgrity.search import Generation, breed, towards

SMALL = Breeding(population=12, generations=3, elites=2)
QUICK = {"dt": 1e-3, "dtype": "float32"}


@pytest.fixture(scope="module")
def search(reference):
    """One small search, and the best fitness that each generation reported."""
    seen = []
    result = evolve(
        reference,
        Genome(6),
        2.0,
        SMALL,
        seed=3,
        on_generation=lambda k, g: seen.append((k, float(g.fitness[0]))),
        **QUICK,
    )
    return result, seen


def test_elites_survive(search):
    """The best gait never gets worse, and the last generation is sorted, best first."""
    result, _ = search
    assert np.all(np.diff(result.best) >= 0)
    assert np.all(np.diff(np.asarray(result.last.fitness)) <= 0)
    assert result.rollouts == 36


def test_every_generation_is_reported(search):
    """Progress arrives once a generation, with the fitness that the history keeps."""
    result, seen = search
    assert [k for k, _ in seen] == [0, 1, 2]
    assert [fitness for _, fitness in seen] == result.best.tolist()


def test_a_seed_repeats_its_search(reference, search):
    """The same seed gives the same genes to the last bit, another seed others."""
    result, _ = search
    again = evolve(reference, Genome(6), 2.0, SMALL, seed=3, **QUICK)
    np.testing.assert_array_equal(result.last.genes, again.last.genes)
    other = evolve(reference, Genome(6), 2.0, SMALL, seed=4, **QUICK)
    assert not np.array_equal(result.last.genes, other.last.genes)


@settings(max_examples=50, deadline=None)
@given(st.floats(0, 0.999), st.floats(0, 0.999))
def test_the_way_between_angles_is_the_shorter_one(a, b):
    """From a, the way `towards` b arrives at b, and is at most half a turn."""
    way = float(towards(np.array([[a]]), np.array([[b]]), np.array([True]))[0, 0])
    assert abs(way) <= 0.5
    gap = abs((a + way) % 1 - b)
    assert min(gap, 1 - gap) < 1e-9


def test_children_of_parents_across_the_seam_stay_there():
    """Parents at 0.95 and 0.05 of a turn have children near 0, not near 0.5; bounded genes stay in their bounds."""
    breeding = Breeding(population=64, generations=2, elites=1, mutation_rate=0.0)
    genes = np.tile([[0.95, 0.0], [0.05, 1.0]], (32, 1))
    generation = Generation(jax.numpy.asarray(genes), jax.numpy.zeros(64), jax.numpy.array(0))
    children = np.asarray(breed(jax.random.key(0), generation, 0.0, Genome(1, frequency=(0.1, 1.0)), breeding))
    from_seam = np.minimum(children[:, 0], 1 - children[:, 0])
    assert from_seam.max() <= 0.06 + 1e-12
    assert children[:, 1].min() >= 0
    assert children[:, 1].max() <= 1
    assert np.ptp(children[:, 1]) > 0.5


def test_genes_become_gaits_within_bounds(reference):
    """Phases in radians, an amplitude for each member, one frequency for all."""
    genome = Genome(6, amplitude=(0.1, 0.3), frequency=(0.2, 1.0))
    assert genome.size == 13
    genes = np.full((2, 13), 0.5)
    gaits = genome.gaits(reference.gait, genes)
    np.testing.assert_allclose(gaits.phase, np.pi)
    np.testing.assert_allclose(gaits.amplitude, 0.2)
    np.testing.assert_allclose(gaits.frequency, 0.6)


def test_amplitudes_and_frequency_evolve(reference):
    """The wider genome runs through a whole search."""
    genome = Genome(6, amplitude=(0.1, 0.3), frequency=(0.3, 0.6))
    result = evolve(reference, genome, 2.0, Breeding(8, 2, elites=1), **QUICK)
    assert result.last.genes.shape == (8, 13)
    assert np.isfinite(result.best).all()


def test_failed_rollouts_rank_last(reference):
    """Steps near the stable one tear some robots apart: they are counted, and none of them outranks a success."""
    genome, step = Genome(6, amplitude=(0.0, 0.95)), 9.8e-3
    unstable = evolve(reference, genome, 4.0, Breeding(64, 1, elites=1), any_step=True, dt=step, dtype="float32")
    fitness, failed = np.asarray(unstable.last.fitness), int(unstable.failed[-1])
    assert 0 < failed < len(fitness)
    assert np.isneginf(fitness[-failed:]).all()
    assert np.isfinite(fitness[:-failed]).all()


def test_distinct_gaits_differ(reference):
    """The same gait twice counts once, also across the seam of the circle."""
    genes = np.array([[0.999, 0.5], [0.001, 0.5], [0.3, 0.5]])
    generation = Generation(jax.numpy.asarray(genes), jax.numpy.array([3.0, 2.0, 1.0]), jax.numpy.array(0))
    chosen = distinct(generation, Genome(2), 3)
    np.testing.assert_allclose(chosen, genes[[0, 2]])


def test_bad_settings_are_refused():
    """Elites that fill the population, bounds the wrong way round."""
    with pytest.raises(InputError, match="elites = 8: expected 1 to 7"):
        Breeding(population=8, elites=8)
    with pytest.raises(InputError, match="population = 0: expected at least 2"):
        Breeding(population=0)
    with pytest.raises(InputError, match="amplitude"):
        Genome(6, amplitude=(0.4, 0.2))
