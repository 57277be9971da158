"""What a gait search leaves: facts, figures, an animation and a page."""

import sys
import time
from dataclasses import asdict
from html import escape
from pathlib import Path
from typing import Any

from common import measured

import jax
import numpy as np
from tqdm import tqdm

from jaxgrity import Objective, Scene, diagnose, plot, rolling, simulate_population, standing_symmetries, verify
from jaxgrity.io.files import save_arrays, save_json, write_whole
from jaxgrity.search.fidelity import Rung, Verdict
from jaxgrity.io.gait_library import gait_facts
from jaxgrity.rollout.population import as_population
from jaxgrity.search.polish import Polished
from jaxgrity.model.symmetry import Symmetry, image

PICTURES = {
    "animation.gif": "settling, then rolling, in real time",
    "path.png": "path of the centre of mass; the bar at the end is the verified error bar",
    "robust.png": "what robots reach that differ from the model by what is uncertain",
    "ladder.png": "the same gaits on rough and on exact rungs: how far screening can be believed",
    "convergence.png": "fitness in each generation of the search, before verification",
    "members.png": "length of every member",
}
STYLE = (
    "body{font:16px/1.5 sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem}img{max-width:100%}"
    "th{text-align:left;padding-right:1.5rem;vertical-align:top}figure{margin:2rem 0}"
)


def report(best: Scene, ladder, searches, agreement, polished, verdict: Verdict, settings, began) -> None:
    """Write everything down, draw it, and say what was found."""
    out, last = settings.out, ladder[-1]
    diagnosis = diagnose(best, settings.duration, dt=last.dt, dtype="float64", frame_rate=50)
    trajectory, found = diagnosis.trajectory, verdict.summary()
    motion = rolling(best, trajectory) if best.ground is not None else None
    command = str(measured()["command"])
    gait = {
        "scene": settings.scene.name,
        **gait_facts(best.gait),
        "duration": settings.duration,
        "objective": settings.objective.kind,
        "settings": {n: v for n, v in asdict(settings).items() if not isinstance(v, Path)},
        **found,
        "motion": None if motion is None else motion.summary(),
        "directions": directions(best, last, settings.duration),
        "actuators": actuators(best, last, settings.duration),
        "diagnosis": diagnosis.summary(),
        "command": command,
    }
    save_json(out / "gait.json", gait)
    save_arrays(
        out / "trajectory.npz",
        times=trajectory.times,
        positions=trajectory.positions,
        velocities=trajectory.velocities,
        phase=best.gait.phase,
    )
    draw(best, diagnosis, ladder, searches, agreement, polished, verdict, settings)
    summary = {
        **gait,
        "ladder": agreement,
        "searches": [{**search._asdict(), "last": None} for search in searches],
        "polish": None if polished is None else polish_facts(polished),
        "wall_seconds": time.perf_counter() - began,
    }
    save_json(out / "summary.json", summary)
    rows = words(summary, motion)
    write_page(out, "A rolling gait", {**rows, "command": command})
    print(f"\n{diagnosis.table()}")
    print("\n".join(f"{name}: {text}" for name, text in rows.items()))
    print(f"open {out}/index.html ({summary['wall_seconds']:.0f} s since this command began)")


def directions(best: Scene, rung: Rung, duration: float) -> list[dict[str, float]]:
    """Where the gait's images under the robot's symmetry lead from the same pose, verified one by one."""
    images = [image(best.gait, symmetry) for symmetry in standing_symmetries(best) if maps_members(best, symmetry)]
    gaits = jax.tree.map(lambda *rows: np.stack(rows) if np.ndim(rows[0]) else rows[0], *images)
    verified = verify(best, gaits, duration, rung.dt)
    moved = verified.com_end - verified.com_start
    return [
        {"heading": heading, "distance": distance, "error_bar": bar}
        for heading, distance, bar in zip(np.arctan2(moved[:, 1], moved[:, 0]), verified.distance, verified.error_bar)
    ]


def maps_members(scene: Scene, symmetry: Symmetry) -> bool:
    """Whether the image of the scene's gait actuates the members that the gait does."""
    return {symmetry.members[k] for k in scene.gait.members} == set(scene.gait.members)


def actuators(best: Scene, rung: Rung, duration: float) -> dict[str, Any]:
    """What the gait asks of its actuators."""
    outcomes = simulate_population(best, as_population(best.gait), duration, dt=rung.dt, dtype="float64", metered=True)
    meters, distance = outcomes.meters, float(outcomes.distance()[0])
    assert meters is not None, "they were asked for"
    weight = float(best.structure.mass) * float(best.gravity or np.nan)
    peaks = {name: float(np.max(getattr(meters, name))) for name in ("peak_rate", "peak_force", "peak_power")}
    works = {name: float(getattr(meters, name)[0]) for name in ("work", "effort")}
    costs = {f"cost_of_transport_by_{name}": amount / weight / distance for name, amount in works.items()}
    return {**peaks, **works, **costs}


def polish_facts(polished: Polished) -> dict[str, Any]:
    """What polishing did, as it goes into a JSON file."""
    growth = polished.sensitivity
    return {
        "improved": polished.improved,
        "reason": polished.reason,
        "rollouts": polished.rollouts,
        "horizon": polished.horizon,
        "before": float(polished.before.mean[0]),
        "after": float(polished.after.mean[0]),
        "sensitivity": None if growth is None else {"times": growth.times, "norm": growth.norm},
        "steps": [step._asdict() for step in polished.steps],
    }


def draw(best: Scene, diagnosis, ladder, searches, agreement, polished, verdict: Verdict, settings) -> None:
    """Figures and an animation."""
    out, unit, trajectory = settings.out, settings.objective.unit, diagnosis.trajectory
    names = tuple(rung.name for rung in ladder)
    plot.save(plot.convergence_figure(searches, names, unit), out / "convergence.png")
    ranks = agreement["rank_correlation"], agreement["rank_correlation_of_the_evolved"]
    plot.save(plot.ladder_figure(names, agreement["fitness"], agreement["evolved"], ranks, unit), out / "ladder.png")
    seen = {"other contact model": verdict.other_model.each[0], "found": verdict.robust.each[0]}
    if polished is not None and polished.improved:
        seen["before polish"] = polished.before.each[0]
    plot.save(plot.robust_figure(seen, unit), out / "robust.png")
    plot.save(plot.path_figure(best, trajectory, float(verdict.verified.error_bar[0])), out / "path.png")
    plot.save(plot.member_figure(best, trajectory), out / "members.png")
    with tqdm(desc="animating", unit="frame", file=sys.stdout) as progress:
        plot.animate(best, trajectory, out / "animation.gif", on_frame=lambda k, n: progress.update())


def words(summary: dict[str, Any], motion) -> dict[str, str]:
    """What was found, in words."""
    unit = Objective(**summary["settings"]["objective"]).unit
    robust, other, asked = summary["robust"], summary["other_contact_model"], summary["actuators"]
    ranks = summary["ladder"]["rank_correlation"][0][-1]
    among = summary["ladder"]["rank_correlation_of_the_evolved"][0][-1]
    rollouts = sum(search["rollouts"] for search in summary["searches"])
    return {
        "verified distance": f"{summary['distance']:.4f} ± {summary['error_bar']:.1g} m in {summary['duration']:g} s",
        "robust": f"{robust['mean']:.3f} ± {robust['standard_deviation']:.2g} {unit} over {robust['robots']} robots, "
        f"step error {robust['step_error']:.1g}",
        "on the other contact model": f"{other['mean']:.3f} ± {other['standard_deviation']:.2g} {unit}",
        "motion": "no ground" if motion is None else motion.sentence(),
        "directions": ", ".join(
            f"{d['distance']:.2f} m towards {np.degrees(d['heading']):.0f}°" for d in summary["directions"]
        ),
        "actuators": f"up to {asked['peak_force']:.0f} N, {asked['peak_rate']:.2g} m/s, {asked['peak_power']:.0f} W; "
        f"cost of transport {asked['cost_of_transport_by_effort']:.2g} (own work of every actuator / (m g d))",
        "search": f"{rollouts} rollouts; screening ranks gaits as verification does with {ranks:.2f} (Spearman; "
        f"{among:.2f} among the evolved)",
        "polish": "none" if summary["polish"] is None else summary["polish"]["reason"],
        "sensitivity at the end": f"{summary['diagnosis']['sensitivity']:.3g} m/rad",
    }


def write_page(out: Path, title: str, rows: dict[str, str]) -> None:
    """A table of `rows`, and below it the pictures that are in the folder."""
    table = "".join(f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>" for name, text in rows.items())
    pictures = "".join(
        f'<figure><img src="{name}" alt="{escape(text)}"><figcaption>{escape(text)}</figcaption></figure>'
        for name, text in PICTURES.items()
        if (out / name).exists()
    )
    page = (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{escape(title)}</title><style>{STYLE}</style>'
        f"<h1>{escape(title)}</h1><table>{table}</table>{pictures}</html>\n"
    )
    write_whole(out / "index.html", lambda file: file.write(page.encode()))
