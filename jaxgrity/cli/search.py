"""Search for a rolling gait: evolve it, polish it by gradients, verify it, and show it."""

import dataclasses
import time
from dataclasses import asdict
from typing import Any, cast

from jaxgrity.cli.script import command_header

import numpy as np

from jaxgrity.cli.progress import Bars
from jaxgrity.cli.scenes import chosen_scene, replaced_files, scene_name
from jaxgrity.cli.search_settings import ObjectiveSettings, SearchSettings
from jaxgrity.core.display import in_digits
from jaxgrity.core.errors import InputError
from jaxgrity.model.contact_twin import contact_twin, exact_twin, is_exact
from jaxgrity.model.friction import ConeFriction
from jaxgrity.model.ground import ExactGround
from jaxgrity.model.inertia import with_mass_at_ends
from jaxgrity.model.scene import Scene
from jaxgrity.model.strut_contact import without_strut_contact
from jaxgrity.populations.population import one_gait
from jaxgrity.populations.uncertainty import Uncertainty
from jaxgrity.report.gait_report import FILES, Origin, write_report
from jaxgrity.report.gait_rows import late_words
from jaxgrity.search.checkpoint import holds_unfinished, left_over
from jaxgrity.search.models import rough_step
from jaxgrity.search.objectives import ActuatorBounds, Objective, find_objective
from jaxgrity.search.pipeline import Progress, SearchResult, search_gaits
from jaxgrity.search.polish_config import PolishConfig
from jaxgrity.search.search_config import EvaluationConfig, SearchConfig, search_problem
from jaxgrity.search.search_space import SearchSpace
from jaxgrity.statics.describe import describe
from jaxgrity.stepping.methods import default_method
from jaxgrity.stepping.options import ROUGH, SolverOptions, is_coupled
from jaxgrity.stepping.step_limits import default_step

MANY_STEPS = 4
"""As many times the steps of the own contact model on the other one are worth a word."""
WEAKER = 0.005
"""Smallest loss of strokes of which a search tells, as a share: half a per cent is what it shows."""


def objective_of(settings: ObjectiveSettings) -> Objective:
    """The objective of the settings. Raises `InputError` for an unknown one."""
    kind = find_objective(settings.kind)
    known = {part.name for part in dataclasses.fields(kind)}
    given = {name: getattr(settings, name) for name in ("heading", "sideways", "turning")}
    chosen = {name: value for name, value in given.items() if value is not None}
    for name, value in chosen.items():
        if name not in known:
            raise InputError(f"{name} = {value}: {settings.kind!r} has none; expected an objective that has")
    return kind(**chosen)


def config_of(settings: SearchSettings) -> SearchConfig:
    """The configuration of the search. Raises `InputError` for an unknown objective."""
    asked, given = settings.objective, dict(vars(settings))
    given["objective"] = objective_of(asked)
    given["bounds"] = ActuatorBounds(asked.largest_rate, asked.largest_force, asked.largest_power)
    given["uncertainty"] = Uncertainty(**vars(settings.uncertainty))
    given |= {"polish": polish_of(settings), "from_gait": settings.gait is not None}

    def group(kind: type) -> Any:
        return kind(**{part.name: given[part.name] for part in dataclasses.fields(kind)})

    given |= {"space": group(SearchSpace), "evaluation": group(EvaluationConfig)}
    return group(SearchConfig)


def polish_of(settings: SearchSettings) -> PolishConfig | None:
    """The configuration of polishing; None without a budget."""
    if not settings.polish_rollouts:
        return None
    usual = cast(PolishConfig, SearchConfig().polish)
    usual = usual._replace(rollouts=settings.polish_rollouts, kind=settings.polish)
    return usual._replace(gaits=settings.polish_gaits, overtones=settings.polish_overtones)


def make_quick(settings: SearchSettings) -> None:
    """Lower the settings to those of a quick search; smaller ones stay."""
    # rollouts of 8 s and 16 gaits found no gait that lasts for five of eight seeds (docs/my_robot.toml)
    settings.duration, settings.population = min(settings.duration, 16.0), min(settings.population, 64)
    screening, own = settings.generations
    settings.generations = min(screening, 3), min(own, 2)
    settings.polish_gaits, settings.polish_rollouts = 1, min(settings.polish_rollouts, 256)


def main(settings: SearchSettings) -> None:
    """Search, and write gait, figures and page."""
    began = time.perf_counter()
    if settings.quick:
        make_quick(settings)
    scene, config = chosen_scene(settings.scene, settings.gait), config_of(settings)
    polished = "polished by gradients, and " if config.polish is not None else ""
    said = (
        f"Searching for a gait of {scene_name(settings.scene)}: gaits evolve on a rough model, and finer models test "
        f"the best.\nThe winner is {polished}verified. Compiling takes a minute the first time.\n"
        f"Results go to {settings.out}/. After Ctrl-C, the same command with --resume continues.\n\n"
        f"{replaced_words(settings)}{changed_words(scene, config)}{standstill_words(scene, config)}"
        f"{equal_mass_words(scene, config)}{faster_words(scene, str(settings.scene))}"
        f"{twin_words(scene, config)}"
    )
    found: dict[str, str] = {}
    with Bars() as bars:

        def hear(progress: Progress) -> None:
            if not bars.stage:  # the search has refused what it would
                print(f"{said}{describe(scene)}", end="\n\n", flush=True)
            bars.hear(progress)

        def report(result: SearchResult) -> None:
            name, command = scene_name(settings.scene), command_header()["command"]
            origin = Origin(name, settings.objective.kind, told(settings), command)
            found.update(write_report(result, origin, settings.out, bars.show))

        search_gaits(
            scene,
            config,
            folder=settings.out,
            resume=settings.resume,
            restart=settings.restart,
            on_progress=hear,
            report=report,
        )
    print("\n" + "\n".join(f"{name}: {text}" for name, text in found.items()))
    print(f"open {settings.out}/index.html ({time.perf_counter() - began:.0f} s since this command began)")


def replaced_words(settings: SearchSettings) -> str:
    """The files of an earlier run that the search replaces, in words; none for one that continues or is refused."""
    folder = settings.out
    if settings.resume or (not settings.restart and holds_unfinished(folder)):
        return ""
    words = replaced_files([*left_over(folder), *(folder / name for name in FILES if (folder / name).exists())], folder)
    return f"{words}\n\n" if words else ""


def standstill_words(scene: Scene, config: SearchConfig) -> str:
    """That the objective counts time before the gait is in full swing, in words; none where it does not."""
    if scene.gait is None or not config.evaluation.objective.steady:
        return ""
    ramp = scene.gait.ramp if config.space.ramp is None else config.space.ramp
    late = late_words(float(scene.gait.start + ramp), config.duration)
    return f"The objective {late}.\n\n" if late else ""


def equal_mass_words(scene: Scene, config: SearchConfig) -> str:
    """That uncertain masses change nothing, in words; none where some node has a mass of its own, or bodies have."""
    structure = scene.structure
    if not config.evaluation.uncertainty.node_mass or structure.bodies or np.any(structure.node_mass):
        return ""
    return "Perturbed robots all weigh the same: no node has a mass of its own, and rods have exact ones.\n\n"


def changed_words(scene: Scene, config: SearchConfig) -> str:
    """How the search changes the gait to begin with: by its ramp, and by the bound on the rate; none if it does not."""
    if not config.from_gait:
        return ""
    problem = search_problem(scene, config)
    own, genome = problem.scene.gait, problem.genome
    assert own is not None, "`search_problem` refuses a scene without a gait"
    begun = one_gait(genome.gaits(own, genome.genes_of(own)[None]), 0)
    ramps, changes = [in_digits(float(gait.ramp), 3) for gait in (begun, own)], []
    if ramps[0] != ramps[1]:
        changes.append(f"gets the ramp of the search, {ramps[0]} s (--ramp None: its own, {ramps[1]} s)")
    share = float(np.sum(begun.amplitude) / np.sum(own.amplitude))
    if share < 1 - WEAKER:
        changes.append(f"keeps {share:.0%} of its strokes, by the bound on the rate (--objective.largest-rate)")
    return f"The gait to begin with {', and '.join(changes)}.\n\n" if changes else ""


def faster_words(scene: Scene, name: str) -> str:
    """How the search may take a fraction of its time, in words; none where sweeps solve the robot, or nothing helps.

    On exact contact, on which searches evolve gaits, sweeps do not solve rods with mass, nor balls and rods
    that touch between their ends, and may fail at much friction.
    """
    try:
        exact = scene if is_exact(scene) else exact_twin(scene)
    except InputError:
        return ""  # the search says why
    light = dataclasses.replace(exact, structure=with_mass_at_ends(exact.structure))
    ways = [(light, f"jaxgrity convert {name} light.toml --mass-at-ends (rods are then harder to turn)")]
    if exact.friction is not None:
        smooth = ConeFriction(np.minimum(exact.friction.sliding_mu, ROUGH / 2))
        way = f"[friction] mu below {ROUGH:g}"
        ways = [*ways, (dataclasses.replace(exact, friction=smooth), way)]
        ways.append((dataclasses.replace(light, friction=smooth), f"{ways[0][1]}, and {way}"))

    thin = "no [touching], and no balls and along_struts in [ground] (nodes alone then touch it, and rods pass through)"
    thinner = [(_touching_as_points(variant), f"{way}, and {thin}") for variant, way in ways]
    ways += [(_touching_as_points(exact), thin), *thinner]

    def together(scene: Scene) -> bool:
        return is_coupled(scene, SolverOptions(), default_method(scene), True)

    found = [way for variant, way in ways if not together(variant)] if together(exact) else []
    if not found:
        return ""
    return f"This robot's impulses are solved all at once, several times slower than by sweeps. Faster: {found[0]}.\n\n"


def twin_words(scene: Scene, config: SearchConfig) -> str:
    """That the other contact model takes most of the time, in words; none where it is left out, or takes less."""
    if not config.evaluation.both_models or not is_exact(scene):
        return ""
    try:
        twin = contact_twin(scene)
        coupled = is_coupled(twin, SolverOptions(), default_method(twin), True)
    except InputError:
        return ""  # the search says why
    if not coupled:
        return ""
    own = default_step(scene, default_method(scene)) if config.dt is None else config.dt
    more = own / rough_step(twin)
    if more < MANY_STEPS:
        return ""
    return (
        f"The other contact model takes {more:.0f} times as many steps of this robot, and most of the time. With "
        "--no-both-models it does not help to choose the gait, but robots are tried on it in the end.\n\n"
    )


def _touching_as_points(scene: Scene) -> Scene:
    """The scene, whose nodes touch the ground as points, and whose rods touch nothing between their ends."""
    scene = without_strut_contact(scene)
    if not isinstance(scene.ground, ExactGround):
        return scene
    return dataclasses.replace(scene, ground=dataclasses.replace(scene.ground, capsules=None, balls=None))


def told(settings: SearchSettings) -> dict[str, Any]:
    """The settings of a search, for its files."""
    return {name: value for name, value in asdict(settings).items() if name not in ("out", "scene")}
