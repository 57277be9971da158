"""A repertoire: for each speed and each turning the gait that keeps them best, by MAP-Elites.

Mouret and Clune 2015, arXiv:1504.04909; variation along the line between two elites: Vassiliades and Mouret 2018,
arXiv:1804.03906. A search ends with one gait; a controller that has to steer and to slow down needs many. It is a
search of its own, which `search_gaits` does not use.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxgrity.core.arguments import check_count, check_each, check_number
from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, PerGait
from jaxgrity.model.actuation import peak_rates
from jaxgrity.populations.population import Outcomes
from jaxgrity.search.genome import Genes
from jaxgrity.search.judging import ensembles_rolled_out, masses_and_lengths
from jaxgrity.search.models import RolloutModel, model_of
from jaxgrity.search.paths import parts_of, path_bend, path_size
from jaxgrity.search.problem import SearchProblem
from jaxgrity.stepping.options import Options

WIDE = 0.5
"""Smallest width of a path that advances, as a share of the width of a line or circle of its length and bend. A
narrower path only sways."""


class RepertoireConfig(NamedTuple):
    """What the cells are, and how gaits for them are looked for."""

    speed: tuple[float, float] = (0.0, 1.2)
    """body lengths/s along the path, from the lowest cell's beginning to the highest one's end"""
    bend: tuple[float, float] = (-1.0, 1.0)
    """rad per body length, positive to the left, likewise"""
    cells: tuple[int, int] = (12, 13)
    """of speed and of bend"""
    drawn: int = 256
    """gaits at random, with which it begins"""
    batch: int = 64
    """gaits that are tried in every round after that"""
    rounds: int = 16
    width: float = 0.03
    """standard deviation of a mutation, in turns of the circle or shares of the bounds"""
    line: float = 0.2
    """standard deviation of a step along the line to another elite, as a share of the way"""


class Repertoire(NamedTuple):
    """The best gait of every cell, cells of speed first, then of bend; NaN where a cell is empty."""

    genes: Float[np.ndarray, "speeds bends genes"]
    speed: Float[np.ndarray, "speeds bends"]
    """body lengths/s, in the mean over the robots that a gait was tried on"""
    bend: Float[np.ndarray, "speeds bends"]
    """rad per body length, positive to the left, likewise"""
    quality: Float[np.ndarray, "speeds bends"]
    """minus the standard deviations over those robots, of the speed (body lengths/s) and of the bend (rad per body
    length), added up; by the draws that chose the gait, so that it is worth less by others"""
    filled: tuple[int, ...]
    """cells that had a gait after each round"""
    rollouts: int

    def nearest(
        self, speed: float, bend: float, count: int = 1, weights: tuple[float, float] = (1.0, 1.0)
    ) -> Float[np.ndarray, "count genes"]:
        """The genes of the elites whose speed and bend come nearest, at most so many, nearest first.

        Differences of speed and bend count by `weights`. Raises `InputError` where all cells are empty, or an argument
        is out of its range.
        """
        check_number("speed", speed)
        check_number("bend", bend)
        check_count("count", count, 1)
        check_each("weights", np.asarray(weights), shape=(2,), least=0.0)
        off = (weights[0] * (self.speed - speed)) ** 2 + (weights[1] * (self.bend - bend)) ** 2
        if not np.isfinite(off).any():
            raise InputError("repertoire: all cells are empty; expected an elite in some cell")
        first = np.argsort(off, axis=None)[: min(count, int(np.isfinite(off).sum()))]
        return self.genes.reshape(-1, self.genes.shape[-1])[first]


class _Tried(NamedTuple):
    genes: Genes
    speed: PerGait
    bend: PerGait
    quality: PerGait


@typed
def repertoire(
    problem: SearchProblem,
    config: RepertoireConfig | None = None,
    *,
    seed: int = 0,
    options: Options = None,
    on_round: Callable[[Repertoire], None] | None = None,
) -> Repertoire:
    """Fill cells of speed and bend with gaits, each with the one that differs least from robot to robot in both.

    A gait is tried on the ensemble of the problem's fitness, whose objective does not count; its bound on rates does. A
    gait with a robot beyond that, or with one that fails, has no place. All gaits of a round roll out in one call.

    Args:
        problem: scene, genome, duration (s), and fitness, whose uncertainty and robots count.
        config: cells and rounds.
        seed: seed of the random number generator.
        options: solver options; by default the scene decides.
        on_round: gets the repertoire after each round.

    Raises:
        InputError: cells, rounds or widths out of their range, bounds that do not ascend, bad options (see `resolve`).

    Example:
        >>> scene = jaxgrity.load_scene("exact")
        >>> space = jaxgrity.search.SearchSpace(waves="axis")
        >>> problem = jaxgrity.search.search_problem(scene, jaxgrity.SearchConfig(duration=1.5, space=space))
        >>> config = jaxgrity.search.RepertoireConfig(drawn=8, batch=4, rounds=1)
        >>> found = jaxgrity.search.repertoire(problem, config, options=jaxgrity.SolverOptions(dt=0.01))
        >>> found.speed.shape
        (12, 13)
    """
    config = config or RepertoireConfig()
    _check(config)
    check_count("seed", seed, 0)
    model, size = model_of(problem.scene, problem.duration, options), problem.genome.size
    empty = np.full(config.cells, np.nan)
    found = Repertoire(np.full((*config.cells, size), np.nan), empty, empty, empty, (), 0)
    for number in range(config.rounds + 1):
        # a generator for each round, so that a round depends on nothing but the elites before it
        draw = np.random.default_rng((seed, number))
        elites = found.genes[np.isfinite(found.speed)]
        if number == 0 or not len(elites):
            genes: Genes = draw.uniform(size=(config.drawn if number == 0 else config.batch, size))
        else:
            genes = _varied(problem, elites, config, draw)
        key = jax.random.fold_in(jax.random.key(seed), number)
        found = _placed(found, _tried(key, problem, model, genes), config, problem.fitness.rollouts)
        if on_round is not None:
            on_round(found)
    return found


def _check(config: RepertoireConfig) -> None:
    for name in ("speed", "bend"):
        check_each(name, np.asarray(getattr(config, name)), shape=(2,))
        low, high = getattr(config, name)
        if not low < high:
            raise InputError(f"{name} = {(low, high)}: expected two ascending bounds")
    speeds, bends = config.cells
    counts = {"cells[0]": speeds, "cells[1]": bends, "drawn": config.drawn, "batch": config.batch}
    for name, value in counts.items():
        check_count(name, value, 1)
    check_count("rounds", config.rounds, 0)
    check_number("width", config.width, least=0.0)
    check_number("line", config.line, least=0.0)


def _varied(
    problem: SearchProblem,
    elites: Float[np.ndarray, "elites genes"],
    config: RepertoireConfig,
    draw: np.random.Generator,
) -> Genes:
    """Children of elites, each moved along the line to another one, and mutated."""
    genome, (one, other) = problem.genome, elites[draw.integers(len(elites), size=(2, config.batch))]
    step = config.line * draw.normal(size=(config.batch, 1)) * np.asarray(genome.towards(one, other))
    return np.asarray(genome.wrapped(one + step + config.width * draw.normal(size=one.shape)))


def _tried(key, problem: SearchProblem, model: RolloutModel, genes: Genes) -> _Tried:
    """What each gait does on its ensemble; NaN where a robot fails, or its rate is beyond the bound."""
    scene, fitness = model.scene, problem.without_force_bounds.fitness
    gaits = problem.genome.gaits(problem.scene.gait, np.asarray(genes, model.options.dtype))
    parts, duration = parts_of(scene, gaits, problem.duration)
    robots, differences, outcomes = ensembles_rolled_out(key, model, gaits, duration, fitness, parts, False)
    _, lengths = masses_and_lengths(scene, robots, differences)
    beyond = fitness.bounds.excess(peak_rates(robots, lengths).max(-1), None)
    found = (*_path(scene, outcomes, np.asarray(duration, float)), beyond)
    rows = (np.asarray(x)[: len(genes) * fitness.rollouts].reshape(len(genes), -1) for x in found)
    speed, bend, excess = rows
    kept = np.where((excess == 0).all(1) & np.isfinite(speed).all(1) & np.isfinite(bend).all(1), 1.0, np.nan)
    return _Tried(genes, kept * speed.mean(1), kept * bend.mean(1), -kept * (speed.std(1) + bend.std(1)))


@eqx.filter_jit
def _path(scene, outcomes: Outcomes, duration: AnyArray) -> tuple[PerGait, PerGait]:
    speed, bend = path_bend(scene, outcomes, duration)
    # a line, or a circle of radius 1/bend, would be so wide: what is less wide is long since the robot sways
    wide = jnp.minimum(speed * duration, 2 / jnp.maximum(jnp.abs(bend), 1e-3))
    good = (outcomes.failure == 0) & (path_size(scene, outcomes) >= WIDE * wide)
    return jnp.where(good, speed, jnp.nan), jnp.where(good, bend, jnp.nan)


def _placed(found: Repertoire, tried: _Tried, config: RepertoireConfig, robots: int) -> Repertoire:
    """The repertoire with those gaits that are better than what their cell had."""
    arrays = [np.array(x) for x in (found.genes, found.speed, found.bend, found.quality)]
    places = []
    for values, (low, high), count in zip((tried.speed, tried.bend), (config.speed, config.bend), config.cells):
        share = np.floor((np.nan_to_num(values, nan=-np.inf) - low) / (high - low) * count)
        places.append(np.where((share >= 0) & (share < count), share, -1).astype(int))
    for k in np.flatnonzero((places[0] >= 0) & (places[1] >= 0)):
        cell = places[0][k], places[1][k]
        if not arrays[3][cell] >= tried.quality[k]:
            for array, values in zip(arrays, tried):
                array[cell] = values[k]
    genes, speed, bend, quality = arrays
    filled = (*found.filled, int(np.isfinite(speed).sum()))
    return Repertoire(genes, speed, bend, quality, filled, found.rollouts + len(tried.genes) * robots)
