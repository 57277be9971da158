"""What varies from gait to gait in a search, and the genomes that this gives on a scene."""

import dataclasses
from dataclasses import dataclass
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.arguments import check_count, check_number
from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import check_fields, typed
from jaxgrity.model.actuation import Gait, actuated_lengths
from jaxgrity.model.gait_waves import travelling_waves
from jaxgrity.model.scene import Scene, with_gait
from jaxgrity.model.symmetry import gene_permutations, standing_symmetries
from jaxgrity.orbits.finding import period_of
from jaxgrity.populations.uncertainty import Differences, Uncertainty, check_strokes, differing, slackened
from jaxgrity.search.genome import Genes, Genome, check_bounds
from jaxgrity.search.judging import Fitness
from jaxgrity.search.objectives import INSIDE
from jaxgrity.search.polish_config import PolishConfig
from jaxgrity.search.problem import SearchProblem

NO_GAIT = (
    'the scene has no [gait]; expected one to begin from, such as [gait] members = "struts", amplitude = 0.3, '
    "frequency = 0.8, phase = { seed = 1 }"
)
"""Message for a scene that a search cannot begin from."""


@dataclass(frozen=True)
class SearchSpace:
    """What varies from gait to gait. By default phases, amplitudes and the frequency vary, and gaits are waves."""

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

    def __post_init__(self):
        check_fields(self)
        check_bounds("amplitude", self.amplitude, 1.0)
        check_bounds("frequency", self.frequency)
        check_count("overtones", self.overtones, 0)
        if self.ramp is not None:
            check_number("ramp", self.ramp, above=0.0, unit="s")
        if self.active is not None:
            check_count("active", self.active, 1)
            if self.waves == "axis":
                both = f"active = {self.active}, waves = 'axis'"
                raise InputError(f"{both}: all members of a wave move; expected one of both")


def with_actuated(scene: Scene, space: SearchSpace) -> Scene:
    """The scene with a gait of the members that may be actuated, as strong and as fast as the scene's own.

    Raises `InputError` where the scene has no gait, or no such members.
    """
    if scene.gait is None:
        raise InputError(NO_GAIT)
    if space.members == "scene":
        return scene
    first, every = scene.structure.first_cable, scene.structure.member_count
    chosen = tuple(range(first)) if space.members == "struts" else tuple(range(first, every))
    if not chosen:
        raise InputError(f"members = {space.members!r}: the scene has none; expected members that it has")
    one, own = np.ones(len(chosen)), scene.gait
    strongest, quickest = float(np.max(own.amplitude)), float(np.max(own.frequency))
    return with_gait(scene, Gait(chosen, 0 * one, strongest * one, quickest * one, own.start, own.ramp))


def genome_of(scene: Scene, space: SearchSpace, fitness: Fitness) -> Genome:
    """The genome of a search on a scene with a gait.

    The objective decides which gaits are the same. The bound on the rate decides how strong gaits may be. Raises
    `InputError` for a scene without a gait, gaits without a common period for a steady objective, and amplitudes that
    reach 1 on perturbed robots.
    """
    gait, objective = scene.gait, fitness.objective
    if gait is None:
        raise InputError(NO_GAIT)
    if objective.steady:
        _check_frequency(gait, space.frequency)
    check_strokes(gait.amplitude if space.amplitude is None else space.amplitude[1], fitness.uncertainty)
    # which gaits are the same depends on where the objective leads
    turned = standing_symmetries(scene) if objective.any_heading else ()
    handed = (each for each in turned if objective.either_hand or np.linalg.det(each.matrix) > 0)
    images = gene_permutations(gait.members, tuple(handed))
    free = space.waves == "none" or space.active is not None
    waves = () if free else travelling_waves(scene.structure, gait.members, one_axis=space.waves == "axis")
    return Genome(
        len(gait.members),
        space.amplitude,
        space.frequency,
        space.overtones,
        space.active,
        images,
        waves,
        _quickest(scene, fitness) if space.scaled else (),
        space.ramp,
    )


@typed
def genome_to_polish(problem: SearchProblem, genes: Genes, polish: PolishConfig) -> tuple[Genome, np.ndarray]:
    """The genome in which polishing climbs, and what its first gaits' genes are there.

    Waves get the overtones of `polish`, but keep those of the scene's gait where these do not evolve. Amplitudes are
    scaled down to the bound on the rate, so that no step leads beyond it, not even in the ramp.
    """
    genome = dataclasses.replace(problem.genome, quickest=_quickest(problem.scene, problem.fitness))
    wider, genes = genome.with_overtones(genes, overtones_to_polish(problem, polish))
    return wider, np.asarray(genes)


def overtones_to_polish(problem: SearchProblem, polish: PolishConfig | None) -> int:
    """Number of overtones that polishing gives to waves; 0 if none, or if the scene's gait has its own."""
    assert problem.scene.gait is not None, "`search_problem` refuses a scene without a gait"
    shaped = not problem.genome.overtones and problem.scene.gait.overtones
    return 0 if polish is None or shaped or not problem.genome.waves else polish.overtones


def _quickest(scene: Scene, fitness: Fitness) -> tuple[float, ...]:
    """The largest |dL/dt| / L0, 1/s, of each actuator, with L0 of the scene's robot.

    A robot whose amplitudes and cables' rest lengths are as far off as can be keeps the bound too. Empty without a
    bound on the rate.
    """
    rate, uncertain = fitness.bounds.rate, fitness.uncertainty
    if rate is None:
        return ()
    assert scene.gait is not None, "`search_problem` refuses a scene without a gait"
    longest = with_longest_cables(scene, uncertain)
    lengths = np.asarray(actuated_lengths(longest.structure, scene.gait.members), float)
    # no draw is at the end of its range; a certain amplitude is at the bound, where rounding would exceed it
    share = 1 / (1 + uncertain.actuation) if uncertain.actuation else INSIDE
    return tuple((rate * share / lengths).tolist())


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
