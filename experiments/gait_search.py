"""The main job: evolve a rolling gait, polish it by gradients, verify it, and show it.

Leaves gait.json, trajectory.npz, figures, an animation, summary.json and a page to open (index.html).
"""

import shlex
import sys
import time
from dataclasses import asdict, dataclass
from html import escape
from pathlib import Path

from common import SCENES, run

import numpy as np
from tqdm import tqdm

from jaxgrity import (
    Breeding,
    Gait,
    Genome,
    Polishing,
    Scene,
    Trajectory,
    diagnose,
    distinct,
    evolve,
    load_scene,
    plot,
    polish,
    with_gait,
)
from jaxgrity.files import save_arrays, save_json, write_whole
from jaxgrity.refine import Polished
from jaxgrity.search import Generation, Search
from jaxgrity.stability import default_method, default_step, strictest
from jaxgrity.structure import InputError


@dataclass
class Settings:
    scene: Path = SCENES / "reference.toml"
    """scene file (TOML) with a [gait]"""
    out: Path = Path("results/gait_search")
    """folder for everything this script leaves"""
    duration: float = 10.0
    """horizon over which distance counts, s"""
    population: int = 128
    """gaits in a generation"""
    generations: int = 20
    """generations to evolve"""
    amplitude: tuple[float, float] | None = None
    """bounds between which each member's amplitude evolves too"""
    frequency: tuple[float, float] | None = None
    """bounds (Hz) between which the gait's frequency evolves too"""
    polish_gaits: int = 16
    """how many of the best gaits are polished, side by side"""
    polish_steps: int = 30
    """gradient steps"""
    dt: float | None = None
    """step of the search, s; verification is at half of it; without it, the scene decides"""
    seed: int = 0
    """the same seed gives the same search"""
    quick: bool = False
    """a small search that ends within a minute: 5 s horizon, 32 gaits, 4 generations, 4 gradient steps"""


def main(settings: Settings) -> None:
    began = time.perf_counter()
    scene = load_scene(settings.scene)
    if settings.quick:
        settings.duration, settings.population, settings.generations = 5.0, 32, 4
        settings.polish_gaits, settings.polish_steps = 4, 4
    if scene.gait is None:
        raise InputError(f"{settings.scene}: has no [gait]; expected one to evolve")
    if settings.polish_gaits < 1 or settings.polish_steps < 1:
        raise InputError("polish_gaits and polish_steps: expected at least 1 of each")
    settings.out.mkdir(parents=True, exist_ok=True)
    print(scene.describe(), end="\n\n")
    dt = settings.dt or default_step(scene, default_method(scene))
    genome = Genome(len(scene.gait.members), settings.amplitude, settings.frequency)
    search = evolve_with_progress(scene, genome, settings, dt)
    genes = distinct(search.last, genome, settings.polish_gaits)
    if not len(genes):
        raise InputError("every rollout of the last generation failed; expected a scene that can be integrated")
    evolved = genome.gaits(scene.gait, np.asarray(genes, float))
    polished = polish_with_progress(scene, evolved, settings, dt)
    report(scene, search, polished, settings, dt, began)


def evolve_with_progress(scene: Scene, genome: Genome, settings: Settings, dt: float) -> Search:
    """The genetic search in float32, on every core."""
    breeding = Breeding(settings.population, settings.generations, elites=max(1, settings.population // 16))
    with tqdm(total=settings.generations, desc="evolving", unit="generation", file=sys.stdout) as bar:

        def show(number: int, generation: Generation) -> None:
            bar.set_postfix(best=f"{float(generation.fitness[0]):.3f} m", failed=int(generation.failed), refresh=False)
            bar.update()

        return evolve(
            scene,
            genome,
            settings.duration,
            breeding,
            seed=settings.seed,
            dt=dt,
            dtype="float32",
            on_generation=show,
        )


def polish_with_progress(scene: Scene, gaits: Gait, settings: Settings, dt: float) -> Polished:
    """The gradient stage, in float64, at twice the search's step where that is stable: gradients need less accuracy."""
    with tqdm(total=settings.polish_steps, desc="polishing", unit="step", file=sys.stdout) as bar:

        def show(number: int, distance: float) -> None:
            bar.set_postfix(at_horizon=f"{distance:.3f} m", refresh=False)
            bar.update()

        coarser = 2 * dt if 2 * dt <= strictest(scene, default_method(scene))[0] else dt
        polishing = Polishing(settings.polish_steps, dt=coarser)
        return polish(scene, gaits, settings.duration, polishing, dt=dt / 2, on_step=show)


def report(scene: Scene, search: Search, polished: Polished, settings: Settings, dt: float, began: float) -> None:
    """Write everything down, draw it, and say what was found."""
    out, best = settings.out, with_gait(scene, polished.gait)
    verified_at, _, finest = polished.verified.steps
    diagnosis = diagnose(best, settings.duration, dt=verified_at, dtype="float64", frame_rate=50)
    trajectory = diagnosis.trajectory
    distance, bar = float(polished.verified.distance[0]), float(polished.verified.error_bar[0])
    command = shlex.join(["python", *sys.argv])
    save_json(
        out / "gait.json",
        {
            "scene": settings.scene.name,
            "members": polished.gait.members,
            "phase": polished.gait.phase,
            "amplitude": polished.gait.amplitude,
            "frequency": polished.gait.frequency,
            "duration": settings.duration,
            "distance": distance,
            "error_bar": bar,
            "diagnosis": diagnosis.summary(),
            "command": command,
        },
    )
    save_arrays(
        out / "trajectory.npz",
        times=trajectory.times,
        positions=trajectory.positions,
        velocities=trajectory.velocities,
        phase=polished.gait.phase,
    )
    plot.save(plot.convergence_figure(search), out / "convergence.png")
    plot.save(plot.path_figure(best, trajectory, bar), out / "path.png")
    plot.save(plot.member_figure(best, trajectory), out / "members.png")
    with tqdm(desc="animating", unit="frame", file=sys.stdout) as progress:
        plot.animate(best, trajectory, out / "animation.gif", on_frame=lambda k, n: progress.update())
    summary = {
        "command": command,
        "scene": settings.scene.name,
        "settings": {name: value for name, value in asdict(settings).items() if not isinstance(value, Path)},
        "distance": distance,
        "error_bar": bar,
        "verified_at_steps": polished.verified.steps,
        "search": {
            "rollouts": search.rollouts,
            "best": search.best,
            "median": search.median,
            "failed": search.failed,
            "dt": dt,
            "dtype": "float32",
        },
        "polish": {
            "improved": polished.improved,
            "reason": polished.reason,
            "horizon": polished.horizon,
            "largest_sensitivity": Polishing().largest_sensitivity,
            "gradient_norm": polished.gradient_norm,
            "distance_at_horizon": polished.distance,
        },
        "diagnosis": diagnosis.summary(),
        "wall_seconds": time.perf_counter() - began,
    }
    save_json(out / "summary.json", summary)
    write_page(out, settings, summary, trajectory)
    print(f"\n{diagnosis.table()}")
    print(f"polish: {polished.reason} (horizon {polished.horizon:.1f} s)")
    print(
        f"verified: {distance:.4f} ± {bar:.1g} m in {settings.duration:g} s, at {verified_at:g} s, against steps down "
        f"to {finest:g} s, in float64"
    )
    print(f"open {out}/index.html ({summary['wall_seconds']:.0f} s in all)")


def write_page(out: Path, settings: Settings, summary: dict, trajectory: Trajectory) -> None:
    """A page that shows what was found."""
    polish_facts, search_facts = summary["polish"], summary["search"]
    rows = {
        "verified distance": f"{summary['distance']:.4f} ± {summary['error_bar']:.1g} m in {settings.duration:g} s",
        "scene": settings.scene.name,
        "search": f"{search_facts['rollouts']} rollouts, {int(np.sum(search_facts['failed']))} of them failed",
        "polish": f"{polish_facts['reason']}; horizon {polish_facts['horizon']:.1f} s",
        "sensitivity at the end": f"{summary['diagnosis']['sensitivity']:.3g} m/rad",
        "command": summary["command"],
    }
    table = "".join(f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>" for name, text in rows.items())
    pictures = "".join(
        f'<figure><img src="{name}" alt="{escape(text)}"><figcaption>{escape(text)}</figcaption></figure>'
        for name, text in (
            ("animation.gif", "settling, then rolling, in real time"),
            ("path.png", "path of the centre of mass; the bar at the end is the verified error bar"),
            ("convergence.png", "distance in each generation of the search, before verification"),
            ("members.png", "length of every member"),
        )
    )
    page = (
        '<!doctype html><html lang="en"><meta charset="utf-8"><title>A rolling gait</title><style>'
        "body{font:16px/1.5 sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem}img{max-width:100%}"
        "th{text-align:left;padding-right:1.5rem;vertical-align:top}figure{margin:2rem 0}</style>"
        f"<h1>A rolling gait</h1><table>{table}</table>{pictures}</html>\n"
    )
    write_whole(out / "index.html", lambda file: file.write(page.encode()))


if __name__ == "__main__":
    run(main, Settings)
