"""Ways to a gait for a damaged robot: those that are known, and short searches; each judged on both contact models."""

from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np

from jaxgrity import (
    ActuatorBounds,
    Fitness,
    Gait,
    Scene,
    SearchConfig,
    SearchProblem,
    Symmetry,
    Uncertainty,
    as_population,
    contact_twin,
    gait_names,
    gait_record,
    load_gait,
    load_scene,
    one_gait,
    with_gait,
)
from jaxgrity.model import image
from jaxgrity.search import (
    FidelityLevel,
    SearchSpace,
    distinct,
    evolve_through,
    fidelity_levels,
    ga_configs,
    judge_at,
    search_problem,
)

SEARCHES = {
    "wave": SearchSpace(),
    "free": SearchSpace(waves="none"),
    "cables, new": SearchSpace("cables", waves="none", amplitude=(0.05, 0.7), frequency=(0.2, 4.0)),
}
"""what each search of a robot may vary"""
WAYS = ("as it was", "library", *SEARCHES)
FINALISTS, TRIES, ROBOTS, UNSEEN = 8, 16, 64, 10**6
"""gaits of a search that are compared, and the robots by which; those of the last judgement, and what is added to the
seed for it: by its draws no gait is chosen"""
Ways = dict[str, dict[str, Any]]  # what `measure` says of one robot, by the ways to a gait


class Known(NamedTuple):
    """Gaits that are known before anything is damaged."""

    names: tuple[str, ...]
    """in the library; of its images a gait as it is comes first"""
    gaits: Gait
    """a population, of every member, with one start and one ramp"""
    begins: tuple[tuple[float, float], ...]
    """each gait's own start and ramp, s"""


def damaged(scene: Scene) -> dict[str, Scene]:
    """The scene with each cable broken, and with each actuated strut stuck."""
    cables, found = scene.structure.cables, {}
    for k in range(len(cables.edges)):
        whole = np.arange(len(cables.edges)) != k
        parts = ("stiffness",) if cables.damping is None else ("stiffness", "damping")
        broken = replace(cables, **{name: getattr(cables, name) * whole for name in parts})
        found[f"cable {k}"] = eqx.tree_at(lambda s: s.structure.cables, scene, broken)
    for k in scene.gait.members:
        struts = replace(scene.structure.struts, stuck=(k,))
        found[f"strut {k}"] = eqx.tree_at(lambda s: s.structure.struts, scene, struts)
    return found


def plain_names() -> list[str]:
    """The library's gaits without overtones: `of_every_member` places phases, amplitudes and frequencies alone."""
    return [name for name in gait_names() if not load_gait(name).overtones]


def known_gaits(scene: Scene, turned: tuple[Symmetry, ...]) -> Known:
    """The library's gaits that fit, of struts and of cables alike, each turned and mirrored as said."""
    names, gaits, begins = [], [], []
    for name in plain_names():
        own, other = scene.structure, load_scene(gait_record(name)["scene"]).structure
        if (own.struts.edges, own.cables.edges) == (other.struts.edges, other.cables.edges):
            names += [name] * len(turned)
            begins += [(float(load_gait(name).start), float(load_gait(name).ramp))] * len(turned)
            gaits += [image(of_every_member(scene, load_gait(name)), symmetry) for symmetry in turned]
    return Known(tuple(names), together(gaits), tuple(begins))


def of_every_member(scene: Scene, gait: Gait) -> Gait:
    """The same gait, or population, with all other members as actuators that do nothing: so any two are alike."""

    def placed(values):
        found = np.zeros((*np.shape(values)[:-1], scene.structure.member_count))
        found[..., list(gait.members)] = values
        return found

    parts = [placed(part) for part in (gait.phase, gait.amplitude, gait.frequency)]
    return Gait(tuple(range(scene.structure.member_count)), *parts, gait.start, gait.ramp)


def of_cables(scene: Scene) -> Scene:
    """The scene with a gait of all cables to begin from, and no struts that are stuck: they stay as long as they are
    anyway."""
    first, own = scene.structure.first_cable, scene.gait
    one = np.ones(scene.structure.member_count - first)
    cables = tuple(range(first, first + len(one)))
    gait = Gait(cables, 0 * one, own.amplitude.max() * one, own.frequency.max() * one, own.start, own.ramp)
    return eqx.tree_at(lambda s: s.structure.struts, with_gait(scene, gait), replace(scene.structure.struts, stuck=()))


def together(gaits: list[Gait]) -> Gait:
    """Gaits as one population."""
    return jax.tree.map(lambda *rows: np.stack(rows) if np.ndim(rows[0]) else rows[0], *gaits)


def recover(
    intact: Scene,
    robot: Scene,
    before: tuple[Known, str],
    configs: dict[str, SearchConfig],
    seeds: tuple[int, int],
) -> Ways:
    """What `measure` says of the gait as it was, and of the best on each of the ways to another one.

    Args:
        before: gaits that are known, and the name of the robot's own
        configs: of the searches
        seeds: by which gaits are judged, and of the searches
    """
    (known, gait), (seed, drawn) = before, seeds
    problem = search_problem(intact, configs["wave"])._replace(scene=robot)
    level = fidelity_levels(robot).own
    which = best(level, problem, known.gaits, seed)
    chosen = []
    for k in (known.names.index(gait), which):
        start, ramp = known.begins[k]
        chosen.append(replace(one_gait(known.gaits, k), start=start, ramp=ramp))
    for config in configs.values():
        found = evolved(intact, robot, config, drawn)
        chosen.append(one_gait(found, best(level, problem, found, seed)))
    names = (gait, known.names[which], *[None] * len(configs))
    # one by one: a population shares one start and one ramp, and searches may choose others than the library's
    rows = [measure(level, problem, as_population(gait), seed) for gait in chosen]
    return {way: {"gait": name, **row} for way, name, (row,) in zip(WAYS, names, rows, strict=True)}


def evolved(intact: Scene, robot: Scene, config: SearchConfig, seed: int) -> Gait:
    """The finalists of a search of the robot, of every member."""
    if config.space.members == "cables":
        robot = of_cables(robot)
    # waves follow from rotations, of which damage leaves none
    whole = intact if config.space.waves == "every" else robot
    problem = search_problem(whole, config)._replace(scene=robot)
    rough = fidelity_levels(robot, force_bounds=False).screening
    (search,) = evolve_through((rough,), problem, ga_configs(config, 1), seed=seed)
    finalists = distinct(search.last, problem.genome, FINALISTS)
    return of_every_member(robot, problem.genome.gaits(robot.gait, finalists))


def best(level: FidelityLevel, problem: SearchProblem, gaits: Gait, seed: int) -> int:
    """Which gait is fastest in the mean over robots, on the scene's own model; those beyond a bound come last."""
    found = judge_at(level, gaits, with_fitness(problem, TRIES, ActuatorBounds()), seed)
    return int(np.lexsort((-np.nan_to_num(found.mean, nan=-np.inf), ~within_bounds(level, problem, gaits)))[0])


def with_fitness(problem: SearchProblem, robots: int, bounds: ActuatorBounds) -> SearchProblem:
    """The problem with an ensemble of so many robots, and other bounds; one robot is as the scene says."""
    uncertain = problem.fitness.uncertainty if robots > 1 else Uncertainty()
    return problem._replace(fitness=Fitness(problem.fitness.objective, uncertain, robots, bounds=bounds))


def within_bounds(level: FidelityLevel, problem: SearchProblem, gaits: Gait) -> np.ndarray:
    """(gaits,), whether each asks no more of actuators than a default search allows, of the robot as it is said."""
    alone = with_fitness(problem, 1, problem.fitness.bounds)
    found = judge_at(level, gaits, alone, 0)
    return (found.beyond == 0) & ~found.failed


def measure(level: FidelityLevel, problem: SearchProblem, gaits: Gait, seed: int) -> list[dict[str, Any]]:
    """Steady speed of each gait, body lengths/s: mean and spread over robots on the own contact model and the other."""
    rows: list[dict[str, Any]] = [{"within_bounds": bool(inside)} for inside in within_bounds(level, problem, gaits)]
    unbounded = with_fitness(problem, ROBOTS, ActuatorBounds())
    for name, here in (("own", level), ("other", fidelity_levels(contact_twin(problem.scene)).own)):
        found = judge_at(here, gaits, unbounded, seed + UNSEEN)
        for row, mean, spread in zip(rows, found.mean, found.spread, strict=True):
            row[name] = {"mean": float(np.nan_to_num(mean)), "standard_deviation": float(np.nan_to_num(spread))}
    return rows
