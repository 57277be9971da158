"""What a search for gaits may vary and how it judges, and the problem that this makes of a scene."""

import dataclasses
from dataclasses import dataclass, field
from typing import Any, Literal, get_args, get_origin

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.arguments import check_count, check_number, is_count, is_number
from jaxgrity.core.errors import InputError, check_known
from jaxgrity.core.typed import check_fields, typed
from jaxgrity.model.actuation import Gait, actuated_lengths
from jaxgrity.model.gait_waves import travelling_waves
from jaxgrity.model.scene import Scene, with_gait
from jaxgrity.model.symmetry import gene_permutations, standing_symmetries
from jaxgrity.orbits.finding import period_of
from jaxgrity.populations.uncertainty import Differences, Uncertainty, check_strokes, differing, slackened
from jaxgrity.search.cma_es import fewest
from jaxgrity.search.genetic_algorithm import GAConfig, SearchProblem
from jaxgrity.search.genome import Genes, Genome
from jaxgrity.search.judging import Fitness
from jaxgrity.search.objectives import INSIDE, ActuatorBounds, Objective, SteadySpeed
from jaxgrity.search.polish_config import PolishConfig, check_polish

UNCERTAIN = Uncertainty(phase=0.03, actuation=0.02, friction=0.2, cable_stiffness=0.05, node_mass=0.05)
"""Default half-widths of what a search takes as uncertain: the phase in rad, all others as shares."""
DRAWN = 4
"""Number of gaits drawn at random for the first generation of a wide search, as a multiple of the population."""
MUTATIONS = ((0.12, 0.01), (0.02, 0.004))
"""Standard deviations of mutations, as shares of the circle, in the first and last generation: first for a wide
screening, then for the generations after it."""
NO_GAIT = (
    'the scene has no [gait]; expected one to begin from, such as [gait] members = "struts", amplitude = 0.3, '
    "frequency = 0.8, phase = { seed = 1 }"
)
"""Message for a scene that a search cannot begin from."""
FINAL_ROBOTS = 128
"""Most robots that judge what polishing gained: the verdict, which follows, takes more."""
COMPARED = 16
"""Number of evolved gaits, and of random ones, that are judged on all fidelity levels. The ranks of both show how far
levels agree (`fidelity.png`): those of evolved gaits alone are too close to say."""


@dataclass(frozen=True)
class SearchConfig:
    """How to search for a gait. The defaults look for a fast gait that lasts, within bounds on the actuators.

    Phases, amplitudes and the frequency evolve, and gaits are waves (`waves`). Perturbed robots evaluate each gait, and
    the best gaits are evaluated on both contact models.
    """

    # how it searches
    duration: float = 40.0
    """simulated time of each rollout, s"""
    population: int = 128
    """number of gaits per generation"""
    generations: tuple[int, int] = (10, 2)
    """numbers of generations: of screening, and then on the scene's own model (`search_levels` says when)"""
    optimiser: Literal["genetic", "cma-es"] = "genetic"
    """search method: a genetic algorithm, or CMA-ES (the extra `baselines`), which starts from the best gait of the
    first generation"""
    wide: bool = True
    """whether screening begins with 4 times as many random gaits, and continues with children of the best eighth. A
    wide screening ignores bounds on force and power. After it, an eighth of the population continues on the scene's own
    model, within all bounds"""
    dt: float | None = None
    """time step of the scene's own model, s; None: the scene's. On penalty ground evolution and polish take twice that,
    if stable; verification takes its half and its quarter, too"""
    seed: int = 0
    """seed of the random number generator"""

    # what varies
    members: Literal["scene", "struts", "cables"] = "scene"
    """members to actuate: those of the scene's gait, all struts, or all cables"""
    active: int | None = None
    """number of actuated members; evolution also chooses which, and gaits are no waves; None: all of `members`"""
    amplitude: tuple[float, float] | None = (0.05, 0.5)
    """bounds of each member's amplitude; None: the amplitudes of the scene's gait are kept"""
    scaled: bool = True
    """whether amplitudes are scaled down to the bound on the rate, if any, ramp included; otherwise gaits beyond the
    bound come last, and only polishing looks at the ramp"""
    frequency: tuple[float, float] | None = (0.3, 1.6)
    """bounds of the gait's frequency, Hz; None: the frequency of the scene's gait is kept"""
    ramp: float | None = 0.75
    """time in which gaits reach their full amplitude, s; None: that of the scene's gait"""
    waves: Literal["every", "axis", "none"] = "every"
    """symmetry of the gaits (`travelling_waves`): all rotations of the robot, those about one axis (then the robot can
    turn), or none; robots without rotations have no waves, nor have searches with `active`"""
    overtones: int = 0
    """number of further sines in each member's Fourier series"""

    # how gaits are judged
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

    # how the best are polished
    polish: PolishConfig | None = field(default_factory=lambda: PolishConfig(final_robots=FINAL_ROBOTS))
    """budget, gradient and number of gaits of polishing; None: no polish"""

    def __post_init__(self):
        check_fields(self)
        for part in dataclasses.fields(self):
            if get_origin(part.type) is Literal:
                check_known(part.name, str(getattr(self, part.name)), get_args(part.type))
        if not _is_pair(self.generations) or not all(is_count(count, 0) for count in self.generations):
            raise InputError(f"generations = {self.generations!r}: expected two whole numbers, such as (10, 2)")
        for name in ("amplitude", "frequency"):
            bounds = getattr(self, name)
            if bounds is not None and not (_is_pair(bounds) and all(map(is_number, bounds))):
                raise InputError(f"{name} = {bounds!r}: expected two bounds, such as (0.1, 0.5), or None")
        check_number("duration", self.duration, above=0.0, unit="s")
        check_number("caution", self.caution, least=0.0)
        for name, least in (("population", 1), ("robots", 1), ("seed", 0), ("overtones", 0)):
            check_count(name, getattr(self, name), least)
        if self.active is not None:
            check_count("active", self.active, 1)
        for name in ("dt", "ramp"):
            if getattr(self, name) is not None:
                check_number(name, getattr(self, name), above=0.0, unit="s")


def _is_pair(value: Any) -> bool:
    return isinstance(value, tuple) and len(value) == 2


@typed
def ga_configs(config: SearchConfig, levels: int) -> tuple[GAConfig, ...]:
    """Of the search on each of so many levels where gaits evolve."""
    size, counts = config.population, config.generations[:levels]
    if not config.wide:
        few = max(1, size // 8)
        return tuple(GAConfig(size, generations=count, elites=few, optimiser=config.optimiser) for count in counts)
    sizes, drawn = (size, max(fewest(config.optimiser), size // 8)), (DRAWN * size, None)
    best = [max(1, each // 8) for each in sizes]
    return tuple(
        GAConfig(
            each,
            count,
            elites=few,
            mutation_rate=1.0,
            mutation_size=width,
            drawn=first,
            parents=few,
            optimiser=config.optimiser,
        )
        for each, count, few, width, first in zip(sizes, counts, best, MUTATIONS, drawn)
    )


def with_actuated(scene: Scene, members: Literal["scene", "struts", "cables"]) -> Scene:
    """The scene with a gait of the members that may be actuated, as strong and as fast as the scene's own.

    Raises `InputError` where the scene has no gait, or no such members.
    """
    if scene.gait is None:
        raise InputError(NO_GAIT)
    if members == "scene":
        return scene
    first, every = scene.structure.first_cable, scene.structure.member_count
    chosen = tuple(range(first)) if members == "struts" else tuple(range(first, every))
    if not chosen:
        raise InputError(f"members = {members!r}: the scene has none; expected members that it has")
    one, own = np.ones(len(chosen)), scene.gait
    strongest, quickest = float(np.max(own.amplitude)), float(np.max(own.frequency))
    return with_gait(scene, Gait(chosen, 0 * one, strongest * one, quickest * one, own.start, own.ramp))


@typed
def search_problem(scene: Scene, config: SearchConfig) -> SearchProblem:
    """What evolves, and how it is judged. Raises `InputError` before anything compiles."""
    if scene.gait is None:
        raise InputError(NO_GAIT)
    if config.objective.steady:
        _check_frequency(scene.gait, config.frequency)
    fitness = Fitness(config.objective, config.uncertainty, config.robots, config.caution, config.bounds)
    if config.polish is not None:
        if not is_count(config.polish.gaits, 1) or config.polish.gaits > COMPARED:
            raise InputError(f"polish: gaits = {config.polish.gaits}; expected 1 to {COMPARED}")
        check_polish(config.polish, fitness, config.polish.gaits)
    check_strokes(scene.gait.amplitude if config.amplitude is None else config.amplitude[1], config.uncertainty)
    members = scene.gait.members
    # which gaits are the same depends on where the objective leads
    turned = standing_symmetries(scene) if config.objective.any_heading else ()
    handed = (each for each in turned if config.objective.either_hand or np.linalg.det(each.matrix) > 0)
    images = gene_permutations(members, tuple(handed))
    if config.waves == "axis" and config.active is not None:
        raise InputError(f"active = {config.active}, waves = 'axis': all members of a wave move; expected one of both")
    free = config.waves == "none" or config.active is not None
    waves = () if free else travelling_waves(scene.structure, members, one_axis=config.waves == "axis")
    genome = Genome(
        len(members),
        config.amplitude,
        config.frequency,
        config.overtones,
        config.active,
        images,
        waves,
        _quickest(scene, config) if config.scaled else (),
        config.ramp,
    )
    if config.duration <= scene.gait.start:
        begins = f"the gait begins at {float(scene.gait.start):g} s"
        raise InputError(f"duration = {config.duration:g} s: {begins}; expected a longer time")
    return SearchProblem(scene, genome, config.duration, fitness)


@typed
def genome_to_polish(problem: SearchProblem, genes: Genes, config: SearchConfig) -> tuple[Genome, np.ndarray]:
    """The genome in which polishing climbs, and what its first gaits' genes are there.

    Waves get the overtones of `config.polish`, but keep those of the scene's gait where these do not evolve. Amplitudes
    are scaled down to the bound on the rate, so that no step leads beyond it, not even in the ramp.
    """
    genome = dataclasses.replace(problem.genome, quickest=_quickest(problem.scene, config))
    assert problem.scene.gait is not None, "`search_problem` refuses a scene without a gait"
    shaped = not genome.overtones and problem.scene.gait.overtones
    overtones = 0 if config.polish is None or shaped or not genome.waves else config.polish.overtones
    wider, genes = genome.with_overtones(genes, overtones)
    return wider, np.asarray(genes)


def _quickest(scene: Scene, config: SearchConfig) -> tuple[float, ...]:
    """The largest |dL/dt| / L0, 1/s, of each actuator, with L0 of the scene's robot.

    A robot whose amplitudes and cables' rest lengths are as far off as can be keeps the bound too. Empty without a
    bound on the rate.
    """
    if config.bounds.rate is None:
        return ()
    assert scene.gait is not None, "`search_problem` refuses a scene without a gait"
    longest = with_longest_cables(scene, config.uncertainty)
    lengths = np.asarray(actuated_lengths(longest.structure, scene.gait.members), float)
    # no draw is at the end of its range; a certain amplitude is at the bound, where rounding would exceed it
    share = 1 / (1 + config.uncertainty.actuation) if config.uncertainty.actuation else INSIDE
    return tuple((config.bounds.rate * share / lengths).tolist())


def with_longest_cables(scene: Scene, uncertainty: Uncertainty) -> Scene:
    """The scene with each cable's rest length as large as uncertain prestress makes it on any robot.

    Raises `InputError` if prestress is uncertain and the scene has no cables.
    """
    if not uncertainty.prestress:
        return scene
    factors = slackened(scene, jnp.array([[uncertainty.prestress], [-uncertainty.prestress]])).max(0)
    return differing(scene, Differences(cable_rest_length=factors))


def _check_frequency(gait: Gait, bounds: tuple[float, float] | None) -> None:
    """Raise `InputError` where a gait that is to last has no period: orbits are counted in periods."""
    if bounds is None:
        period_of(gait)
    elif not bounds[0] > 0:
        raise InputError(f"frequency = {bounds}: expected bounds above 0 Hz, for a gait that is to last")


def without_idle(gait: Gait) -> Gait:
    """The gait of those members alone that move."""
    rows = np.flatnonzero(np.asarray(gait.amplitude) > 0)
    # start and ramp, which all actuators share, are the arrays without an axis
    moving = jax.tree.map(lambda x: np.asarray(x)[rows] if np.ndim(x) else x, gait)
    return dataclasses.replace(moving, members=tuple(gait.members[k] for k in rows))


def plain_config(config: SearchConfig) -> dict[str, Any]:
    """The config as it goes into a JSON file: an objective, say, by its class and what it holds."""

    def plain(value: Any) -> Any:
        if isinstance(value, PolishConfig):
            return value._asdict()
        return (
            {"kind": type(value).__name__, **vars(value)}
            if isinstance(value, (Objective, ActuatorBounds, Uncertainty))
            else value
        )

    return {part.name: plain(getattr(config, part.name)) for part in dataclasses.fields(config)}
