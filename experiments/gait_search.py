"""The main job: evolve a rolling gait that stands perturbation, polish it by gradients, verify it, and show it.

Thousands of rough rollouts screen gaits, the scene's own model goes on with the best, and few exact rollouts judge what
comes out. Every generation is saved: --resume goes on after an interruption, to the very same end. Leaves gait.json,
population.npz, trajectory.npz, figures, an animation, summary.json and a page to open (index.html).
"""

import hashlib
import sys
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal

from common import SCENES, run

import numpy as np
from gait_report import report
from tqdm import tqdm

from jaxgrity import (
    Breeding,
    Fitness,
    Gait,
    Genome,
    InputError,
    Objective,
    Polishing,
    Scene,
    Uncertainty,
    distinct,
    gene_permutations,
    load_scene,
    one_gait,
    polish,
    standing_symmetries,
    with_gait,
)
from jaxgrity.io.files import save_arrays
from jaxgrity.search.fidelity import evolve_up, final_verdict, judge_on, rank_correlation, rungs, searched
from jaxgrity.search.objectives import with_robots
from jaxgrity.search.polish import Polished, check_polishing
from jaxgrity.search.checkpoint import Run, open_run
from jaxgrity.search.genetic_algorithm import Search, State
from jaxgrity.stepping.simulate import settle

UNSEEN = 10**6
"""added to the seed of the last judgement, whose draws nothing was chosen by"""
COMPARED = 16
"""evolved gaits, and as many random ones, that go through all rungs of the ladder"""


@dataclass
class Settings:
    scene: Path = SCENES / "reference.toml"
    """scene file (TOML) with a [gait]"""
    out: Path = Path("results/gait_search")
    """folder for everything this script leaves"""
    duration: float = 10.0
    """horizon over which the objective counts, s"""
    population: int = 64
    """gaits in a generation"""
    generations: tuple[int, int] = (32, 20)
    """generations of screening; on the scene's own model, where screening is on its exact twin"""
    robots: int = 4
    """that each gait is tried on in a generation, drawn from what is uncertain"""
    objective: Objective = field(default_factory=Objective)
    """what a rollout is worth"""
    uncertainty: Uncertainty = field(default_factory=lambda: Uncertainty(phase=0.03))
    """half-widths of what is not known exactly; all zero, with --robots 1: plain distance"""
    caution: float = 0.0
    """standard deviations of its robots that are held against a gait"""
    amplitude: tuple[float, float] | None = None
    """bounds between which each member's amplitude evolves too"""
    frequency: tuple[float, float] | None = None
    """bounds (Hz) between which the gait's frequency evolves too"""
    overtones: int = 0
    """how many more sines each member's Fourier series has"""
    members: Literal["scene", "struts", "cables"] = "scene"
    """which members may be actuated"""
    active: int | None = None
    """how many of them are, which ones evolves too"""
    polish: Literal["smoothed", "pathwise", "combined"] = "smoothed"
    """by which gradient"""
    polish_rollouts: int = 4096
    """what polishing may cost; 0: no polish"""
    polish_gaits: int = 4
    """how many of the best gaits are polished"""
    dt: float | None = None
    """step of the scene's own model, s; verification is at half of it and below; without it, the scene decides"""
    seed: int = 0
    """the same seed gives the same search"""
    resume: bool = False
    """go on with the run in the folder, which had the same settings"""
    restart: bool = False
    """begin again where the folder holds an unfinished run"""
    quick: bool = False
    """a small search that ends within two minutes: 4 s at most, 16 gaits, 3 generations, 128 rollouts of polish"""


def main(settings: Settings) -> None:
    began = time.perf_counter()
    if settings.quick:
        settings.duration, settings.population, settings.generations = min(settings.duration, 4.0), 16, (3, 2)
        settings.polish_gaits, settings.polish_rollouts = 1, min(settings.polish_rollouts, 128)
    scene = actuated(load_scene(settings.scene), settings)
    genome, fitness = search_space(scene, settings)
    print(scene.describe(), end="\n\n")
    known = {n: v for n, v in asdict(settings).items() if n not in ("scene", "out", "resume", "restart")}
    known["scene_sha256"] = hashlib.sha256(settings.scene.read_bytes()).hexdigest()
    ladder = rungs(scene, settings.dt)
    for rung in ladder:
        settle(rung.scene, settings.duration, None, rung.dt, rung.dtype)  # refuses what a later rung could not do
    breedings = generations(settings, len(searched(ladder)))
    with open_run(settings.out, known, settings.resume, settings.restart) as folder:
        searches = evolve_with_progress(ladder, genome, fitness, breedings, settings, folder)
        chosen, agreement = promote(ladder, genome, fitness, searches[-1], settings)
        polished = polish_with_progress(ladder, genome, fitness, chosen, settings)
        best = chosen[0] if polished is None else polished.genes
        gait = one_gait(genome.gaits(scene.gait, best[None]), 0)
        if settings.active is not None:
            gait = without_idle(gait)
        verdict = final_verdict(scene, gait, settings.duration, fitness, dt=ladder[-1].dt, seed=settings.seed + UNSEEN)
        report(with_gait(scene, gait), ladder, searches, agreement, polished, verdict, settings, began)
        folder.done()


def actuated(scene: Scene, settings: Settings) -> Scene:
    """The scene with the members that may be actuated."""
    if scene.gait is None:
        raise InputError(f"{settings.scene}: has no [gait]; expected one to evolve")
    if settings.members == "scene":
        return scene
    first = scene.structure.first_cable
    every = first + (0 if scene.structure.cables is None else len(scene.structure.cables.edges))
    members = tuple(range(first)) if settings.members == "struts" else tuple(range(first, every))
    one = np.ones(len(members))
    own = scene.gait
    strongest, quickest = float(np.max(own.amplitude)), float(np.max(own.frequency))
    return with_gait(scene, Gait(members, 0 * one, strongest * one, quickest * one, own.start, own.ramp))


def search_space(scene: Scene, settings: Settings) -> tuple[Genome, Fitness]:
    """What evolves, and how it is judged. Raises `InputError` before anything compiles."""
    if not 1 <= settings.polish_gaits <= COMPARED:
        raise InputError(f"polish_gaits = {settings.polish_gaits}: expected 1 to {COMPARED}")
    assert scene.gait is not None, "a scene without a gait is refused before"
    fitness = Fitness(settings.objective, settings.uncertainty, settings.robots, settings.caution)
    if settings.polish_rollouts:
        check_polishing(Polishing(settings.polish_rollouts, settings.polish), fitness, settings.polish_gaits)
    members = scene.gait.members
    # which gaits are the same depends on where the objective leads
    turned = () if settings.objective.kind == "direction" else standing_symmetries(scene)
    genome = Genome(
        len(members),
        settings.amplitude,
        settings.frequency,
        settings.overtones,
        settings.active,
        gene_permutations(members, turned),
    )
    return genome, fitness


def without_idle(gait: Gait) -> Gait:
    """The gait of those members alone that move."""
    rows = np.flatnonzero(np.asarray(gait.amplitude) > 0)
    parts = [np.asarray(part)[rows] for part in (gait.phase, gait.amplitude, gait.frequency)]
    overtones = tuple(type(o)(np.asarray(o.size)[rows], np.asarray(o.phase)[rows]) for o in gait.overtones)
    return Gait(tuple(gait.members[k] for k in rows), *parts, gait.start, gait.ramp, overtones)


def generations(settings: Settings, rungs: int) -> tuple[Breeding, ...]:
    """How gaits breed on each of the rungs where they are searched."""
    elites = max(1, settings.population // 8)
    return tuple(Breeding(settings.population, n, elites=elites) for n in settings.generations[:rungs])


def evolve_with_progress(
    ladder, genome: Genome, fitness: Fitness, breedings: tuple[Breeding, ...], settings: Settings, folder: Run
) -> list[Search]:
    """The genetic search in float32, on every core, on each of the rungs where gaits are searched."""
    climbed = searched(ladder)
    before = sum(state.number for state in folder.states)
    total = sum(b.generations for b in breedings)
    with tqdm(total=total, initial=before, desc="evolving", unit="generation", file=sys.stdout) as bar:

        def show(number: int, state: State) -> None:
            folder.save(number, state)
            best, _, failed = state.history[-1]
            bar.set_postfix(rung=climbed[number].name, best=f"{best:.3f}", failed=int(failed), refresh=False)
            bar.update()

        searches = evolve_up(
            climbed,
            genome,
            settings.duration,
            breedings,
            fitness=fitness,
            seed=settings.seed,
            states=folder.states,
            on_generation=show,
        )
    save_arrays(settings.out / "population.npz", genes=searches[-1].last.genes, fitness=searches[-1].last.fitness)
    return searches


def promote(ladder, genome: Genome, fitness: Fitness, search: Search, settings: Settings) -> tuple[np.ndarray, dict]:
    """The best gaits of the search, best first by larger ensembles, and how far the rungs of the ladder agree.

    Evolved and random gaits are judged on every rung by the same draws; the last rung says which are best.
    """
    genes = distinct(search.last, genome, COMPARED)
    if not len(genes):
        raise InputError("every rollout of the last generation failed; expected a scene that can be integrated")
    chance = np.random.default_rng(settings.seed).uniform(size=(COMPARED, genome.size))
    gaits = genome.gaits(ladder[1].scene.gait, np.concatenate([genes, chance]))
    many = with_robots(fitness, 4 * settings.robots)
    rows = []
    for rung in tqdm(ladder, desc="promoting", unit="rung", file=sys.stdout):
        rows.append(judge_on(rung, gaits, settings.duration, many, settings.seed + 2).fitness)
    first, table = len(genes), np.array(rows)
    agreement = {
        "rungs": [{"name": rung.name, "dt": rung.dt, "dtype": rung.dtype} for rung in ladder],
        "fitness": table,
        "evolved": first,
        "rank_correlation": rank_correlation(table),
        "rank_correlation_of_the_evolved": rank_correlation(table[:, :first]),
    }
    order = np.argsort(-table[-1, :first])
    return np.asarray(genes, float)[order[: settings.polish_gaits]], agreement


def polish_with_progress(ladder, genome: Genome, fitness: Fitness, genes, settings: Settings) -> Polished | None:
    """The gradient stage, on the last rung on which gaits evolved; a gain is judged on the ladder's last."""
    if not settings.polish_rollouts:
        return None
    own, last = searched(ladder)[-1], ladder[-1]
    polishing = Polishing(settings.polish_rollouts, settings.polish)
    with tqdm(desc="polishing", unit="step", file=sys.stdout) as bar:

        def show(step) -> None:
            bar.set_postfix(fitness=f"{step.fitness:.3f}", refresh=False)
            bar.update()

        return polish(
            own.scene,
            genome,
            genes,
            settings.duration,
            polishing,
            fitness=fitness,
            dt=own.dt,
            final_dt=last.dt,
            seed=settings.seed,
            on_step=show,
        )


if __name__ == "__main__":
    run(main, Settings)
