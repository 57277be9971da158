"""CMA-ES in the place of the genetic algorithm: the same states, the same end after an interruption, one clear line."""

import sys

import jax
import numpy as np
import pytest

from jaxgrity import Fitness, GAConfig, Genome, InputError, SearchConfig, SearchProblem, SolverOptions, evolve
from jaxgrity.search import ga_configs, open_checkpoint

OPTIONS = SolverOptions(dt=1e-2, dtype="float32")


@pytest.fixture(scope="module")
def problem(swimmer):
    """Phases alone, the distance of one robot in 2 s."""
    return SearchProblem(swimmer, Genome(2), 2.0, Fitness())


@pytest.fixture(scope="module")
def search(problem):
    """Eight generations of eight gaits, and the state that each of them reported."""
    pytest.importorskip("evosax")
    seen, config = [], GAConfig(8, 8, elites=1, drawn=16, optimiser="cma-es")
    return config, evolve(problem, config, seed=3, options=OPTIONS, on_generation=seen.append), seen


def assert_same(mine, its):
    """To the last bit."""
    for a, b in zip(jax.tree.leaves(mine), jax.tree.leaves(its), strict=True):
        np.testing.assert_array_equal(a, b)


def test_it_narrows_down_on_what_is_best(problem, search):
    """The last generation lies closer together than the second, and its gaits are better than most at random."""
    config, found, seen = search
    spread = [np.std(state.evaluated.genes, axis=0).max() for state in (seen[1], seen[-1])]
    assert spread[1] < 0.7 * spread[0]
    chance = evolve(problem, GAConfig(256, 1, elites=1), seed=9, options=OPTIONS).last
    assert found.last.fitness[0] > np.quantile(chance.fitness, 0.95)
    assert found.rollouts == 16 + 7 * 8
    assert np.all(np.diff(found.last.fitness) <= 0)
    assert np.all((found.last.genes >= 0) & (found.last.genes < 1))
    assert config.optimiser == "cma-es"


def test_it_goes_on_from_any_of_its_states(problem, search, tmp_path):
    """Also from a file, to the very same end."""
    config, found, seen = search
    with open_checkpoint(tmp_path, {}) as checkpoint:
        checkpoint.save(0, seen[3])
    with open_checkpoint(tmp_path, {}, resume=True) as checkpoint:
        assert_same(checkpoint.states, (seen[3],))
        for state in (seen[0], *checkpoint.states):
            assert_same(evolve(problem, config, seed=7, options=OPTIONS, state=state), found)


def test_searches_choose_it_by_name():
    """On every level; it needs a few gaits where the genetic algorithm does with two."""
    pytest.importorskip("evosax")
    configs = ga_configs(SearchConfig(population=16, optimiser="cma-es"), 2)
    assert [config.optimiser for config in configs] == ["cma-es", "cma-es"]
    assert [config.population for config in configs] == [16, 5]
    with pytest.raises(InputError, match="population = 4: expected at least 5 gaits"):
        GAConfig(4, 2, elites=1, optimiser="cma-es")


def test_an_unknown_one_is_refused():
    """With those that are known."""
    with pytest.raises(InputError, match="optimiser = 'newton': unknown; expected one of genetic, cma-es"):
        GAConfig(optimiser="newton")


def test_without_its_extra_there_is_one_clear_line(monkeypatch):
    """Before anything compiles."""
    monkeypatch.setitem(sys.modules, "evosax", None)
    monkeypatch.setitem(sys.modules, "evosax.algorithms", None)
    with pytest.raises(InputError, match=r"evosax is not installed; expected it, as by: pip install 'jaxgrity\[base"):
        ga_configs(SearchConfig(optimiser="cma-es"), 2)
