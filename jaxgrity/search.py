"""A genetic algorithm over gaits: which phases (amplitudes, frequency) make the robot roll far."""

import math
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxgrity.actuation import Gait
from jaxgrity.population import gaits_of, roll_out
from jaxgrity.scene import Scene, as_dtype
from jaxgrity.simulate import Settings, settle
from jaxgrity.structure import InputError
from jaxgrity.types import AnyArray, Scalar

Genes = Float[AnyArray, "*population genes"]
Fitness = Float[AnyArray, " population"]


class Genome(eqx.Module):
    """What evolves, as genes in [0, 1): phases, which go round a circle, then what else has bounds.

    Genes are phase/2 pi for each actuator, then one amplitude each if `amplitude` has bounds, then one frequency for
    all if `frequency` (Hz) has bounds. What has none stays as the scene's gait says.
    """

    actuators: int = eqx.field(static=True)
    amplitude: tuple[float, float] | None = eqx.field(static=True, default=None)
    frequency: tuple[float, float] | None = eqx.field(static=True, default=None)

    def __check_init__(self):
        for name, top in (("amplitude", 1.0), ("frequency", math.inf)):
            bounds = getattr(self, name)
            if bounds is not None and not 0 <= bounds[0] < bounds[1] <= top:
                raise InputError(f"{name} = {bounds}: expected two ascending bounds between 0 and {top:g}")

    @property
    def size(self) -> int:
        return self.actuators * (2 if self.amplitude else 1) + (1 if self.frequency else 0)

    @property
    def circular(self) -> np.ndarray:
        """(genes,), which genes are angles."""
        return np.arange(self.size) < self.actuators

    def gaits(self, gait: Gait | None, genes: Genes) -> Gait:
        """The population of gaits that `genes` stand for, around the scene's own `gait`."""
        n, amplitude, frequency = self.actuators, None, None
        if self.amplitude:
            amplitude = _between(self.amplitude, genes[:, n : 2 * n])
        if self.frequency:
            frequency = jnp.broadcast_to(_between(self.frequency, genes[:, -1:]), (genes.shape[0], n))
        return gaits_of(gait, 2 * jnp.pi * genes[:, :n], amplitude, frequency)


class Breeding(eqx.Module):
    """How one generation makes the next."""

    population: int = eqx.field(static=True, default=128)
    generations: int = eqx.field(static=True, default=16)
    elites: int = eqx.field(static=True, default=8)
    """the best, which go on unchanged"""
    tournament: int = eqx.field(static=True, default=3)
    """each parent is the best of so many drawn at random"""
    mutation_rate: float = eqx.field(static=True, default=0.3)
    """share of genes that mutate"""
    mutation_size: tuple[float, float] = eqx.field(static=True, default=(0.1, 0.02))
    """standard deviation of a mutation, in turns of the circle, in the first and in the last generation"""

    def __check_init__(self):
        if self.population < 2:
            raise InputError(f"population = {self.population}: expected at least 2 gaits")
        if not 0 < self.elites < self.population:
            raise InputError(f"elites = {self.elites}: expected 1 to {self.population - 1}, fewer than the population")
        if self.generations < 1 or self.tournament < 1:
            raise InputError(
                f"generations = {self.generations}, tournament = {self.tournament}: expected at least 1 of each"
            )


class Generation(NamedTuple):
    """One generation, evaluated, best gait first."""

    genes: Genes
    fitness: Fitness
    """distance, m; -inf where the rollout failed"""
    failed: Int[AnyArray, ""]
    """how many rollouts failed"""


class Search(NamedTuple):
    """A finished search: its last generation, and how it got there."""

    last: Generation
    best: np.ndarray
    """(generations,), distance of the best gait, m"""
    median: np.ndarray
    """(generations,), of the median gait, m"""
    failed: np.ndarray
    """(generations,), how many rollouts failed"""
    rollouts: int


def evolve(
    scene: Scene,
    genome: Genome,
    duration: float,
    breeding: Breeding | None = None,
    *,
    seed: int = 0,
    method: str | None = None,
    dt: float | None = None,
    dtype: str | None = None,
    any_step: bool = False,
    on_generation: Callable[[int, Generation], None] | None = None,
) -> Search:
    """Evolve gaits for the horizontal displacement of the centre of mass over `duration` (s).

    The same seed gives the same search. `on_generation` is called with each generation's number and content.
    Raises `InputError` as `simulate.settle` does, before anything compiles.
    """
    breeding = breeding or Breeding()
    settings = settle(scene, duration, method, dt, dtype, any_step=any_step)
    scene = as_dtype(scene, settings.dtype)
    key, first = jax.random.split(jax.random.key(seed))
    genes: Genes = jax.random.uniform(first, (breeding.population, genome.size), settings.dtype)
    history = []
    for number in range(breeding.generations):
        key, now = jax.random.split(key)
        generation, genes = _generation(
            now, genes, np.asarray(number), scene, genome, np.asarray(duration, float), breeding, settings
        )
        history.append([float(generation.fitness[0]), _median(generation.fitness), int(generation.failed)])
        if on_generation is not None:
            on_generation(number, generation)
    best, median, failed = np.array(history).T
    return Search(generation, best, median, failed.astype(int), breeding.population * breeding.generations)


@eqx.filter_jit
def _generation(
    key, genes: Genes, number, scene: Scene, genome: Genome, duration, breeding: Breeding, settings: Settings
) -> tuple[Generation, Genes]:
    """Evaluate `genes`, and breed those of the next generation."""
    distance = roll_out(scene, genome.gaits(scene.gait, genes), duration, settings).distance()
    fitness = jnp.where(jnp.isfinite(distance), distance, -jnp.inf)
    order = jnp.argsort(-fitness)
    generation = Generation(genes[order], fitness[order], jnp.sum(~jnp.isfinite(distance)))
    progress = number / max(1, breeding.generations - 1)
    return generation, breed(key, generation, progress, genome, breeding)


def breed(key, generation: Generation, progress: Scalar, genome: Genome, breeding: Breeding) -> Genes:
    """The genes of the next generation: elites, and children of two parents, each a tournament's best.

    A child takes each gene from a point between its parents, or a little beyond, along the shorter way round the
    circle where the gene is an angle, and mutates some by a normal deviate.
    """
    draw, blend, which, mutate = jax.random.split(key, 4)
    genes, dtype = generation.genes, generation.genes.dtype
    children = breeding.population - breeding.elites
    # sorted best first, so the best of a tournament is its lowest index
    parents = jax.random.randint(draw, (2, children, breeding.tournament), 0, breeding.population).min(axis=-1)
    mother, father = genes[parents[0]], genes[parents[1]]
    weight = jax.random.uniform(blend, mother.shape, dtype, -0.1, 1.1)
    child = mother + weight * towards(mother, father, genome.circular)
    first, last = breeding.mutation_size
    size = jnp.asarray(first * (last / first) ** progress, dtype)
    mutated = jax.random.bernoulli(which, breeding.mutation_rate, child.shape)
    child = child + jnp.where(mutated, size * jax.random.normal(mutate, child.shape, dtype), 0)
    child = jnp.where(genome.circular, child % 1, jnp.clip(child, 0, 1))
    return jnp.concatenate([genes[: breeding.elites], child])


def towards(a: Genes, b: Genes, circular: np.ndarray) -> Genes:
    """b - a, the shorter way round where the gene is an angle: in [-1/2, 1/2) of a turn."""
    return jnp.where(circular, (b - a + 0.5) % 1 - 0.5, b - a)


def distinct(generation: Generation, genome: Genome, count: int, apart: float = 0.02) -> Genes:
    """The best `count` gaits of a generation that differ from each other by at least `apart` in some gene."""
    chosen: list[int] = []
    for k in np.flatnonzero(np.isfinite(generation.fitness)):
        gaps = [np.abs(towards(generation.genes[k], generation.genes[c], genome.circular)).max() for c in chosen]
        if len(chosen) < count and all(gap >= apart for gap in gaps):
            chosen.append(int(k))
    return generation.genes[np.array(chosen, int)]


def _between(bounds: tuple[float, float], genes: Genes) -> Genes:
    return bounds[0] + (bounds[1] - bounds[0]) * genes


def _median(fitness: Fitness) -> float:
    finite = np.asarray(fitness)[np.isfinite(fitness)]
    return float(np.median(finite)) if finite.size else -math.inf
