"""A genetic algorithm over gaits: genes of fast gaits that also roll on perturbed robots."""

import math
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxgrity.core import draws
from jaxgrity.core.arguments import check_count, check_each, check_number
from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, PerGait, Scalar
from jaxgrity.search.cma_es import asked_next, check_optimiser, fewest
from jaxgrity.search.genome import Genes, Genome
from jaxgrity.search.judging import Judging, judge
from jaxgrity.search.problem import SearchProblem
from jaxgrity.stepping.options import Options


class GAConfig(eqx.Module):
    """Settings of `evolve`: the number of gaits and generations, and how one generation is bred from the last."""

    population: int = eqx.field(static=True, default=128)
    """number of gaits in a generation"""
    generations: int = eqx.field(static=True, default=16)
    """number of generations"""
    elites: int = eqx.field(static=True, default=8)
    """number of best gaits that go on unchanged"""
    tournament: int = eqx.field(static=True, default=3)
    """number of random gaits of which the best becomes a parent"""
    mutation_rate: float = eqx.field(static=True, default=0.3)
    """share of genes that mutate"""
    mutation_size: tuple[float, float] = eqx.field(static=True, default=(0.1, 0.02))
    """standard deviation of a mutation, in turns of the circle, in the first and in the last generation"""
    drawn: int | None = eqx.field(static=True, default=None)
    """number of random gaits from which the best make the first generation; None: as many as a generation has"""
    crossover: float = eqx.field(static=True, default=1.0)
    """share of children that have two parents; the others have one"""
    parents: int | None = eqx.field(static=True, default=None)
    """number of best gaits from which parents are drawn with equal probability; None: tournaments among all"""
    optimiser: str = eqx.field(static=True, default="genetic")
    """ "genetic", or "cma-es". CMA-ES begins at the best gait of the first generation, with the standard deviation of
    its mutations. Elites, tournaments, crossover and parents then have no effect"""

    def __check_init__(self):
        check_optimiser(self.optimiser)
        check_count("population", self.population, fewest(self.optimiser))
        check_count("generations", self.generations, 1)
        check_count("tournament", self.tournament, 1)
        check_count("elites", self.elites, 1)
        for name, least in (("drawn", self.population), ("parents", 1)):
            if getattr(self, name) is not None:
                check_count(name, getattr(self, name), least)
        check_number("mutation_rate", self.mutation_rate, least=0.0, most=1.0)
        check_number("crossover", self.crossover, least=0.0, most=1.0)
        check_each("mutation_size", self.mutation_size, shape=(2,), least=0.0)
        if self.elites >= self.population:
            raise InputError(f"elites = {self.elites}: expected 1 to {self.population - 1}, fewer than the population")
        if self.parents is not None and self.parents > self.population:
            raise InputError(f"parents = {self.parents}: expected 1 to {self.population}, the population")

    def progress(self, number: int, dtype) -> np.ndarray:
        """How far mutations have shrunk after generation `number`: from 0 to 1."""
        return np.asarray(number / max(1, self.generations - 1), dtype)


class Generation(NamedTuple):
    """One evaluated generation; a row for each gait, best first."""

    genes: Genes
    """(population, genes), in [0, 1): see `Genome`"""
    fitness: PerGait
    """-inf where a rollout failed"""
    spread: PerGait
    """standard deviation of the objective over each gait's ensemble"""
    failed: Int[AnyArray, ""]
    """number of failed gaits"""


class Record(NamedTuple):
    """The record of each generation."""

    best: Float[np.ndarray, " generations"]
    """fitness of the best gait"""
    median: Float[np.ndarray, " generations"]
    """of the median gait, among those within the bounds on actuators if any"""
    failed: Float[np.ndarray, " generations"]
    """number of failed gaits"""
    within: Float[np.ndarray, " generations"]
    """number of gaits within the bounds on actuators on all their robots"""


class EvolutionState(NamedTuple):
    """An evolution between two generations: enough to continue it to the same end."""

    number: int
    """of the generation that comes next"""
    key: AnyArray
    """of the random numbers that are still to be drawn"""
    genes: Genes
    """to be evaluated next"""
    record: Record
    """of the generations so far"""
    evaluated: Generation | None
    """the last generation; None before the first"""
    memory: AnyArray | None = None
    """(numbers,), memory of CMA-ES; None before the second generation, and of a genetic algorithm"""


class Evolution(NamedTuple):
    """Result of `evolve`: the last generation, and numbers of every generation."""

    last: Generation
    """the last generation; its first row has the best gait"""
    best: np.ndarray
    """(generations,), fitness of the best gait"""
    median: np.ndarray
    """(generations,), of the median gait"""
    failed: np.ndarray
    """(generations,), number of failed gaits"""
    within: np.ndarray
    """(generations,), number of gaits within the bounds on actuators on all their robots (in a wide screening, the
    bound on rates alone); where 0, the best has the least excess"""
    rollouts: int
    """number of rollouts in all generations"""


def begin(genome: Genome, config: GAConfig, seed: int, dtype: str, parent: Genes | None = None) -> EvolutionState:
    """An evolution before its first generation: random genes, or those of a `parent` and of its mutations.

    Of these, all genes mutate, by up to the width of the config's first mutations. Small mutations are as frequent as
    large ones: their widths are uniform in the logarithm, down to a hundredth.
    """
    key, first = jax.random.split(jax.random.key(seed))
    shape = config.drawn or config.population, genome.size
    if parent is None:
        genes = draws.uniform(first, shape, dtype)
    else:
        widths, moves = jax.random.split(first)
        width = config.mutation_size[0] * 10 ** (-2 * jax.random.uniform(widths, (shape[0], 1), dtype))
        children = jnp.asarray(parent, dtype) + width * jax.random.normal(moves, shape, dtype)
        genes = genome.wrapped(children.at[0].set(jnp.asarray(parent, dtype)))
    nothing = Record(*(np.zeros(0) for _ in Record._fields))
    return EvolutionState(0, jax.random.key_data(key), genes, nothing, None)


@typed
def evolve(
    problem: SearchProblem,
    config: GAConfig | None = None,
    *,
    seed: int = 0,
    options: Options = None,
    state: EvolutionState | None = None,
    on_generation: Callable[[EvolutionState], None] | None = None,
) -> Evolution:
    """Evolve gaits by a genetic algorithm, or by CMA-ES, a whole population in one call for each generation.

    Every generation, elites included, meets new perturbations. The same seed gives the same evolution; so does its
    continuation from a `state`.

    Args:
        problem: scene, genome, duration (s) and fitness.
        config: population, generations and breeding.
        seed: seed of the random number generator; without effect if you give a state.
        options: solver options; by default the scene's.
        state: of an interrupted evolution, to continue it.
        on_generation: called with the state after each generation.

    Returns:
        The last generation, best gait first, and the record of all generations.

    Raises:
        InputError: bad options (see `resolve`), before anything compiles.

    Example:
        >>> scene = jaxgrity.load_scene("exact")
        >>> problem = jaxgrity.SearchProblem(scene, jaxgrity.Genome(6), 1.5, jaxgrity.Fitness())
        >>> found = jaxgrity.evolve(problem, jaxgrity.GAConfig(population=4, generations=2, elites=1))
        >>> found.last.genes.shape, found.rollouts
        ((4, 6), 8)
    """
    config, judging = config or GAConfig(), problem.judging(options)
    state = state or begin(problem.genome, config, seed, judging.dtype)
    return evolve_by(judging, problem.genome, config, state, on_generation)


def evolve_by(
    judging: Judging,
    genome: Genome,
    config: GAConfig,
    state: EvolutionState,
    on_generation: Callable[[EvolutionState], None] | None = None,
) -> Evolution:
    """`evolve` by any judging, from a state on."""
    while state.number < config.generations:
        state = _advance(state, judging, genome, config)
        if on_generation is not None:
            on_generation(state)
    assert state.evaluated is not None, "there is at least one generation"
    gaits = config.population * config.generations + (config.drawn or config.population) - config.population
    rollouts = gaits * judging.fitness.rollouts
    best, median, failed, within = state.record
    return Evolution(state.evaluated, best, median, failed.astype(int), within.astype(int), rollouts)


def _advance(state: EvolutionState, judging: Judging, genome: Genome, config: GAConfig) -> EvolutionState:
    key, now = jax.random.split(jax.random.wrap_key_data(jnp.asarray(state.key)))
    drawn, bred = jax.random.split(now)
    # NumPy: on all devices, as breeding leaves them, genes would have the next rollouts compiled again
    raw = np.asarray(state.genes)
    genes = raw if state.memory is None else np.asarray(genome.wrapped(raw))
    scores = judge(drawn, judging, genome.gaits(judging.models[0].scene.gait, genes))
    order = np.argsort(-scores.merit, kind="stable")[: config.population]
    generation = Generation(genes[order], scores.fitness[order], scores.spread[order], np.sum(scores.failed))
    memory = None
    if config.optimiser == "cma-es":
        width = config.mutation_size[0]
        children, memory = asked_next(bred, raw, scores.merit, state.memory, config.population, width)
    else:
        children = breed(bred, generation, config.progress(state.number, genes.dtype), genome, config)
    within = (scores.beyond == 0) & ~scores.failed
    median = _median(scores.fitness[within] if within.any() else scores.fitness)
    newest = (float(generation.fitness[0]), median, float(generation.failed), float(within.sum()))
    record = Record(*(np.append(so_far, x) for so_far, x in zip(state.record, newest)))
    return EvolutionState(state.number + 1, jax.random.key_data(key), children, record, generation, memory)


@eqx.filter_jit
def breed(key, generation: Generation, progress: Scalar, genome: Genome, config: GAConfig) -> Genes:
    """The genes of the next generation: elites, and children of one parent or of two.

    A child of two takes each gene from a point between its parents, or a little beyond; for an angle along the shorter
    way round the circle. Some genes mutate by a normal deviate. Of the symmetric images of the second parent the one
    nearest to the first counts.
    """
    draw, blend, which, mutate, crossed = jax.random.split(key, 5)
    genes, dtype = generation.genes, generation.genes.dtype
    children = config.population - config.elites
    # sorted best first, so the best of a tournament is its lowest index
    rivals, among = (config.tournament, config.population) if config.parents is None else (1, config.parents)
    parents = jax.random.randint(draw, (2, children, rivals), 0, among).min(axis=-1)
    mother, father = genes[parents[0]], genome.nearest_image(genes[parents[0]], genes[parents[1]])
    weight = jax.random.uniform(blend, mother.shape, dtype, -0.1, 1.1)
    weight = jnp.where(jax.random.bernoulli(crossed, config.crossover, (children, 1)), weight, 0)
    child = mother + weight * genome.towards(mother, father)
    first, last = config.mutation_size
    size = jnp.asarray(first * (last / first) ** progress, dtype)
    mutated = jax.random.bernoulli(which, config.mutation_rate, child.shape)
    child = child + jnp.where(mutated, size * jax.random.normal(mutate, child.shape, dtype), 0)
    return jnp.concatenate([genes[: config.elites], genome.wrapped(child)])


@typed
def distinct(generation: Generation, genome: Genome, count: int, apart: float = 0.02) -> Genes:
    """(at most `count`, genes), the best gaits of a generation, of which each two differ by at least `apart`.

    Two gaits differ by their largest difference in a gene, after the symmetry of the robot that brings them nearest.
    Waves are compared without symmetries.
    """
    chosen: list[int] = []
    genes = np.asarray(generation.genes)
    for k in np.flatnonzero(np.isfinite(generation.fitness)):
        if len(chosen) < count and all(genome.gap(genes[k], genes[c]) >= apart for c in chosen):
            chosen.append(int(k))
    return genes[np.array(chosen, int)]


def _median(fitness: PerGait) -> float:
    finite = np.asarray(fitness)[np.isfinite(fitness)]
    return float(np.median(finite)) if finite.size else -math.inf
