"""What a search for gaits may vary and how it judges, and the problem that this makes of a scene."""

import dataclasses
import hashlib
from dataclasses import dataclass, field
from typing import Any, Literal

import jax
import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.model.actuation import Gait
from jaxgrity.model.scene import Scene, with_gait
from jaxgrity.model.symmetry import gene_permutations, standing_symmetries
from jaxgrity.rollout.uncertainty import Uncertainty
from jaxgrity.search.genetic_algorithm import SearchProblem
from jaxgrity.search.genome import Genome
from jaxgrity.search.objectives import ActuatorBounds, Distance, Fitness, Objective
from jaxgrity.search.polish_config import GradientKind, PolishConfig, check_polish

COMPARED = 16
"""evolved gaits, and as many random ones, that are judged on all fidelity levels"""


@dataclass(frozen=True)
class SearchConfig:
    """How to search for a gait."""

    duration: float = 10.0
    """horizon over which the objective counts, s"""
    population: int = 64
    """gaits in a generation"""
    generations: tuple[int, int] = (32, 20)
    """generations of screening; on the scene's own model, where screening is on its contact twin"""
    robots: int = 4
    """that each gait is tried on in a generation, drawn from what is uncertain"""
    objective: Objective = field(default_factory=Distance)
    """what a rollout is worth"""
    bounds: ActuatorBounds = field(default_factory=ActuatorBounds)
    """the most that a gait may ask of an actuator"""
    uncertainty: Uncertainty = field(default_factory=lambda: Uncertainty(phase=0.03))
    """half-widths of what is not known exactly"""
    caution: float = 0.0
    """standard deviations of its robots that are held against a gait"""
    amplitude: tuple[float, float] | None = None
    """bounds between which each member's amplitude evolves too"""
    frequency: tuple[float, float] | None = None
    """bounds (Hz) between which the gait's frequency evolves too"""
    overtones: int = 0
    """how many more sines each member's Fourier series has"""
    members: Literal["scene", "struts", "cables"] = "scene"
    """which members may be actuated: those of the scene's gait, all struts or all cables"""
    active: int | None = None
    """how many of them are, which ones evolves too"""
    polish: GradientKind = "smoothed"
    """by which gradient"""
    polish_rollouts: int = 4096
    """what polishing may cost; 0: no polish"""
    polish_gaits: int = 4
    """how many of the best gaits are polished"""
    dt: float | None = None
    """step of the scene's own model, s; verification is at it and below, as errors ask; None: the scene decides"""
    seed: int = 0
    """the same seed gives the same search"""


def with_actuated(scene: Scene, members: Literal["scene", "struts", "cables"]) -> Scene:
    """The scene with a gait of the members that may be actuated, as strong and as fast as the scene's own.

    Raises `InputError` where the scene has no gait, or no such members.
    """
    if scene.gait is None:
        raise InputError("the scene has no [gait]; expected one to evolve")
    if members == "scene":
        return scene
    first, every = scene.structure.first_cable, scene.structure.member_count
    chosen = tuple(range(first)) if members == "struts" else tuple(range(first, every))
    if not chosen:
        raise InputError(f"members = {members!r}: the scene has none; expected members that it has")
    one, own = np.ones(len(chosen)), scene.gait
    strongest, quickest = float(np.max(own.amplitude)), float(np.max(own.frequency))
    return with_gait(scene, Gait(chosen, 0 * one, strongest * one, quickest * one, own.start, own.ramp))


def search_problem(scene: Scene, config: SearchConfig) -> SearchProblem:
    """What evolves, and how it is judged. Raises `InputError` before anything compiles."""
    if not 1 <= config.polish_gaits <= COMPARED:
        raise InputError(f"polish_gaits = {config.polish_gaits}: expected 1 to {COMPARED}")
    assert scene.gait is not None, "a scene without a gait is refused before"
    fitness = Fitness(config.objective, config.uncertainty, config.robots, config.caution, config.bounds)
    if config.polish_rollouts:
        check_polish(PolishConfig(config.polish_rollouts, config.polish), fitness, config.polish_gaits)
    members = scene.gait.members
    # which gaits are the same depends on where the objective leads
    turned = standing_symmetries(scene) if config.objective.any_heading else ()
    images = gene_permutations(members, turned)
    genome = Genome(len(members), config.amplitude, config.frequency, config.overtones, config.active, images)
    if scene.gait is not None and config.duration <= scene.gait.start:
        begins = f"the gait begins at {float(scene.gait.start):g} s"
        raise InputError(f"duration = {config.duration:g} s: {begins}; expected a longer time")
    return SearchProblem(scene, genome, config.duration, fitness)


def without_idle(gait: Gait) -> Gait:
    """The gait of those members alone that move."""
    rows = np.flatnonzero(np.asarray(gait.amplitude) > 0)
    # start and ramp, which all actuators share, are the arrays without an axis
    moving = jax.tree.map(lambda x: np.asarray(x)[rows] if np.ndim(x) else x, gait)
    return dataclasses.replace(moving, members=tuple(gait.members[k] for k in rows))


def fingerprint(scene: Scene) -> str:
    """A hash of everything that a scene says, by which a search knows its scene again."""
    leaves, structure = jax.tree.flatten(scene)
    digest = hashlib.sha256(str(structure).encode())
    for leaf in leaves:
        digest.update(np.asarray(leaf, float).tobytes())
    return digest.hexdigest()


def plain_config(config: SearchConfig) -> dict[str, Any]:
    """The config as it goes into a JSON file: an objective, say, by its class and what it holds."""

    def plain(value: Any) -> Any:
        return (
            {"kind": type(value).__name__, **vars(value)}
            if isinstance(value, (Objective, ActuatorBounds, Uncertainty))
            else value
        )

    return {part.name: plain(getattr(config, part.name)) for part in dataclasses.fields(config)}
