"""A repertoire: elites stand in the cells of their speed and bend, and only better ones take their place."""

import itertools

import jax
import numpy as np
import pytest

from jaxgrity import ActuatorBounds, Fitness, Genome, InputError, SearchProblem, SolverOptions, Uncertainty
from jaxgrity.model.actuation import peak_rates
from jaxgrity.search import RepertoireConfig, repertoire
from jaxgrity.search import repertoires as module

CONFIG = RepertoireConfig(speed=(0.0, 0.03), bend=(-1.0, 1.0), cells=(8, 3), drawn=24, batch=16, rounds=4)
OPTIONS = SolverOptions(dt=1e-2)


@pytest.fixture(scope="module")
def problem(swimmer):
    """Phases and amplitudes, by two robots whose amplitudes are off."""
    genome = Genome(2, amplitude=(0.0, 0.5))
    return SearchProblem(swimmer, genome, 4.0, Fitness(uncertainty=Uncertainty(actuation=0.1), robots=2))


@pytest.fixture(scope="module")
def found(problem):
    """The repertoire, and what it was after each round."""
    rounds = []
    return repertoire(problem, CONFIG, seed=2, options=OPTIONS, on_round=rounds.append), rounds


def test_elites_stand_in_the_cells_of_their_speed_and_bend(found):
    """And cells without a gait say so everywhere."""
    elites, _ = found
    full = np.isfinite(elites.speed)
    assert 3 <= full.sum() < full.size
    speed, bend = np.nonzero(full)
    np.testing.assert_array_equal(np.floor(elites.speed[full] / 0.03 * 8), speed)
    np.testing.assert_array_equal(np.floor((elites.bend[full] + 1) / 2 * 3), bend)
    for part in (elites.bend, elites.quality, elites.genes[..., 0]):
        np.testing.assert_array_equal(np.isfinite(part), full)


def test_a_repertoire_only_grows_better(found):
    """Round by round: no cell is emptied, and no quality falls."""
    elites, rounds = found
    assert len(rounds) == 5
    assert elites.filled == tuple(np.isfinite(each.speed).sum() for each in rounds)
    assert elites.filled[-1] > elites.filled[0]
    assert elites.rollouts == (24 + 4 * 16) * 2
    for before, after in itertools.pairwise(rounds):
        known = np.isfinite(before.quality)
        assert np.all(after.quality[known] >= before.quality[known])


def test_a_gait_with_a_robot_beyond_the_bound_on_rates_has_no_place(problem, found):
    """As in a search: that the robot of the scene keeps the bound is not enough, if others are stronger."""
    elites, _ = found
    genes = elites.genes.reshape(-1, 4)[[np.nanargmax(elites.speed)]]
    gait = problem.genome.gaits(problem.scene.gait, genes)
    own = float(peak_rates(gait, problem.scene.structure.struts.rest_length).max())
    for rate, placed in ((1.001 * own, False), (1.11 * own, True)):
        fitness = Fitness(uncertainty=problem.fitness.uncertainty, robots=2, bounds=ActuatorBounds(rate=rate))
        model = module.model_of(problem.scene, problem.duration, OPTIONS)
        tried = module._tried(jax.random.key(0), problem._replace(fitness=fitness), model, genes)
        assert np.isfinite(tried.speed).all() == placed


def test_a_seed_repeats_its_repertoire(problem, found):
    """To the last bit."""
    np.testing.assert_array_equal(repertoire(problem, CONFIG, seed=2, options=OPTIONS).genes, found[0].genes)


def test_the_nearest_elite_is_asked_for_by_speed_and_bend(found):
    """Where all cells are empty there is none."""
    elites, _ = found
    cell = tuple(np.argwhere(np.isfinite(elites.speed))[-1])
    some = elites.nearest(elites.speed[cell], elites.bend[cell], count=500)
    np.testing.assert_array_equal(some[0], elites.genes[cell])
    assert len(some) == elites.filled[-1]
    assert np.isfinite(some).all()
    for asked in ((0.1, 0.0, -1), (np.nan, 0.0), (0.1, 0.0, 1, (1.0, -1.0))):
        with pytest.raises(InputError, match=r"expected a (whole|finite) number"):
            elites.nearest(*asked)
    with pytest.raises(InputError, match="all cells are empty"):
        elites._replace(speed=np.full((8, 3), np.nan)).nearest(0.5, 0.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"speed": (1.0, 1.0)}, r"speed = \(1.0, 1.0\): expected two ascending bounds"),
        ({"bend": (0.0, np.inf)}, r"bend\[1\] = inf: expected a finite number"),
        ({"cells": (0, 3)}, r"cells\[0\] = 0: expected a whole number, at least 1"),
        ({"cells": (2, 2.5)}, r"cells\[1\] = 2.5: expected a whole number, at least 1"),
        ({"rounds": -1}, "rounds = -1: expected a whole number, at least 0"),
        ({"line": -1.0}, "line = -1: expected a finite number, at least 0"),
    ],
)
def test_bad_cells_are_refused(problem, change, message):
    """Before anything compiles."""
    with pytest.raises(InputError, match=message):
        repertoire(problem, CONFIG._replace(**change))
