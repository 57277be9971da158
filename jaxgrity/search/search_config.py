"""How a search looks for gaits and how it evaluates them, and the problem that this makes of a scene."""

import dataclasses
from dataclasses import dataclass, field
from typing import Any, Literal

from jaxgrity.core.arguments import check_count, check_number, is_count
from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import check_fields, typed
from jaxgrity.model.scene import Scene
from jaxgrity.populations.uncertainty import Uncertainty
from jaxgrity.search.cma_es import fewest
from jaxgrity.search.genetic_algorithm import GAConfig
from jaxgrity.search.judging import Fitness
from jaxgrity.search.objectives import ActuatorBounds, Objective, SteadySpeed
from jaxgrity.search.polish_config import PolishConfig, check_polish
from jaxgrity.search.problem import SearchProblem
from jaxgrity.search.search_space import NO_GAIT, SearchSpace, genome_of

UNCERTAIN = Uncertainty(phase=0.03, actuation=0.02, friction=0.2, cable_stiffness=0.05, node_mass=0.05)
"""Default half-widths of what a search takes as uncertain: the phase in rad, all others as shares."""
DRAWN = 4
"""Number of gaits drawn at random for the first generation of a wide search, as a multiple of the population."""
MUTATIONS = ((0.12, 0.01), (0.02, 0.004))
"""Standard deviations of mutations, as shares of the circle, in the first and last generation: first for a wide
screening, then for the generations after it."""
NEAR = ((0.06, 0.01), (0.02, 0.004))
"""The same for a search that begins with a gait; of its genes, half mutate."""
COMPARED = 16
"""Number of evolved gaits, and of random ones, that are judged on all fidelity levels. The ranks of both show how far
levels agree (`fidelity.png`): those of evolved gaits alone are too close to say."""


@dataclass(frozen=True)
class EvaluationConfig:
    """How gaits are evaluated: for what, by which robots, and within which bounds on the actuators."""

    objective: Objective = field(default_factory=SteadySpeed)
    """objective of the search"""
    bounds: ActuatorBounds = field(default_factory=lambda: ActuatorBounds(rate=1.0, power=200.0))
    """bounds on the rate, force and power of each actuator; a `wide` screening leaves out force and power"""
    uncertainty: Uncertainty = field(default_factory=lambda: UNCERTAIN)
    """half-widths by which perturbed robots differ"""
    robots: int = 4
    """number of perturbed robots that evaluate each gait in a generation"""
    caution: float = 1.0
    """number of standard deviations over perturbed robots that are subtracted from the mean objective"""
    both_models: bool = True
    """whether the best gaits are evaluated on both contact models before one is chosen"""
    attracting: bool = True
    """whether, among the best, gaits whose orbit attracts disturbed robots are preferred (`stability`; for steady
    objectives)"""

    def __post_init__(self):
        check_fields(self)
        self.fitness()  # it checks the numbers

    def fitness(self) -> Fitness:
        """The fitness of the gaits of a generation. Finalists are evaluated by more robots."""
        return Fitness(self.objective, self.uncertainty, self.robots, self.caution, self.bounds)


class _Grouped:
    """Says where a setting is that 0.2.0 had outside of the groups. It goes with the next release."""

    def __new__(cls, *given, **named):
        moved: list[str] = []
        groups: list[str] = []
        for group, kind in {"space": SearchSpace, "evaluation": EvaluationConfig}.items():
            if own := [name for name in named if name in {part.name for part in dataclasses.fields(kind)}]:
                groups.append(f"{group}=jaxgrity.search.{kind.__name__}({', '.join(f'{name}=...' for name in own)})")
                moved += own
        if moved:
            raise InputError(f"{', '.join(moved)}: expected in a group now, {cls.__name__}({', '.join(groups)})")
        return super().__new__(cls)


@dataclass(frozen=True)
class SearchConfig(_Grouped):
    """How to search for a gait. The defaults look for a fast gait that lasts, within bounds on the actuators.

    What varies, how gaits are evaluated, and how the best are polished, are groups of settings. For example,
    `SearchConfig(population=64, space=SearchSpace(waves="none"))`, with `SearchSpace` of `jaxgrity.search`.
    """

    duration: float = 40.0
    """simulated time of each rollout, s"""
    population: int = 128
    """number of gaits per generation"""
    generations: tuple[int, int] = (10, 2)
    """numbers of generations: of screening, and then on the scene's own model, with its own step and within all bounds
    (`search_levels` says when)"""
    optimiser: Literal["genetic", "cma-es"] = "genetic"
    """search method: a genetic algorithm, or CMA-ES (the extra `baselines`), which starts from the best gait of the
    first generation"""
    from_gait: bool = False
    """whether the first generation has the scene's own gait and its mutations, and no random gaits; later mutations are
    smaller, too. Like all gaits it gets the ramp of `space`, and strokes are scaled down to the bound on the rate"""
    wide: bool = True
    """whether screening begins with 4 times as many random gaits, and continues with children of the best eighth. A
    wide screening ignores bounds on force and power. After it, an eighth of the population continues on the scene's own
    model, within all bounds"""
    dt: float | None = None
    """time step of the scene's own model, s; None: the scene's. On penalty ground evolution and polish take twice that,
    if stable; verification takes its half and its quarter, too"""
    seed: int = 0
    """seed of the random number generator"""
    space: SearchSpace = field(default_factory=SearchSpace)
    """what varies from gait to gait"""
    evaluation: EvaluationConfig = field(default_factory=EvaluationConfig)
    """how gaits are evaluated"""
    polish: PolishConfig | None = field(default_factory=PolishConfig)
    """budget, gradient and number of gaits of polishing; None: no polish"""

    def __post_init__(self):
        check_fields(self)
        pair = isinstance(self.generations, tuple) and len(self.generations) == 2
        if not pair or not all(is_count(count, 0) for count in self.generations):
            raise InputError(f"generations = {self.generations!r}: expected two whole numbers, such as (10, 2)")
        check_number("duration", self.duration, above=0.0, unit="s")
        check_count("population", self.population, 1)
        check_count("seed", self.seed, 0)
        if self.dt is not None:
            check_number("dt", self.dt, above=0.0, unit="s")


@typed
def ga_configs(config: SearchConfig, levels: int) -> tuple[GAConfig, ...]:
    """The settings of `evolve` on each of the first `levels` levels of a search, coarsest first."""
    size, counts = config.population, config.generations[:levels]
    if not config.wide:
        few = max(1, size // 8)
        return tuple(GAConfig(size, generations=count, elites=few, optimiser=config.optimiser) for count in counts)
    # of screening, and of the own model, which few gaits reach and none that is drawn at random
    sizes, drawn = (size, max(fewest(config.optimiser), size // 8)), (DRAWN * size, None)
    best = [max(1, each // 8) for each in sizes]
    return tuple(
        GAConfig(
            each,
            count,
            elites=few,
            mutation_rate=0.5 if config.from_gait else 1.0,
            mutation_size=width,
            drawn=first,
            parents=few,
            optimiser=config.optimiser,
        )
        for each, count, few, width, first in zip(sizes, counts, best, NEAR if config.from_gait else MUTATIONS, drawn)
    )


@typed
def search_problem(scene: Scene, config: SearchConfig) -> SearchProblem:
    """What evolves, and how it is judged. Raises `InputError` before anything compiles."""
    if scene.gait is None:
        raise InputError(NO_GAIT)
    fitness = config.evaluation.fitness()
    if config.polish is not None:
        if not is_count(config.polish.gaits, 1) or config.polish.gaits > COMPARED:
            raise InputError(f"polish: gaits = {config.polish.gaits}; expected 1 to {COMPARED}")
        check_polish(config.polish, fitness, config.polish.gaits)
    if config.from_gait and config.space.members != "scene":
        raise InputError(f"members = {config.space.members!r}: the gait to begin with has its own; expected 'scene'")
    genome = genome_of(scene, config.space, fitness)
    if config.from_gait:
        genome.genes_of(scene.gait)  # refuses what no genes encode
    if config.duration <= scene.gait.start:
        begins = f"the gait begins at {float(scene.gait.start):g} s"
        raise InputError(f"duration = {config.duration:g} s: {begins}; expected a longer time")
    return SearchProblem(scene, genome, config.duration, fitness)


def plain_config(config: SearchConfig) -> dict[str, Any]:
    """The config as it goes into a JSON file, flat as the options of the command.

    Objectives, bounds and uncertainties have their class as `kind`.
    """

    def plain(value: Any) -> Any:
        if isinstance(value, PolishConfig):
            return value._asdict()
        return (
            {"kind": type(value).__name__, **vars(value)}
            if isinstance(value, (Objective, ActuatorBounds, Uncertainty))
            else value
        )

    found: dict[str, Any] = {}
    for name, value in vars(config).items():
        found |= vars(value) if isinstance(value, SearchSpace | EvaluationConfig) else {name: value}
    return {name: plain(value) for name, value in found.items()}
