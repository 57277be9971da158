"""What a gait search leaves: facts, figures, an animation and a page."""

import itertools
import time
from collections.abc import Callable
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxgrity.io.files import save_arrays, save_json, write_whole
from jaxgrity.io.gait_library import gait_facts
from jaxgrity.model.actuation import Gait
from jaxgrity.model.scene import Scene
from jaxgrity.model.symmetry import Symmetry, image, standing_symmetries
from jaxgrity.report import plot, view
from jaxgrity.report.animation import animate
from jaxgrity.report.steady import PARTS, steady_facts, steady_rows
from jaxgrity.rollout.population import as_population, simulate_population
from jaxgrity.rollout.rolling import Rolling, rolling
from jaxgrity.search.pipeline import UNSEEN, SearchResult
from jaxgrity.search.polish import Polished
from jaxgrity.search.promotion import Agreement
from jaxgrity.stepping.options import SolverOptions
from jaxgrity.stepping.simulate import Trajectory, some_frames
from jaxgrity.stepping.stability import default_method, default_step
from jaxgrity.trust.error_bars import verify
from jaxgrity.trust.trust_report import TrustReport, diagnose

WATCHED = 7.5
"""times the search's duration, for which a gait that is to last is watched"""
FRAME_RATE = 50
"""frames a second of the trajectory that is kept"""
REPLAY = "replay.html"
PICTURES = {
    "animation.gif": "from the start on, in real time",
    "orbit.png": "the orbit that the robot settles on: one cycle, seen from a frame that goes along steadily",
    "gait.png": "which member is how long when, and the faces that the robot stands on",
    "path.png": "path of the centre of mass; the bar at the end is the verified error bar",
    "robust.png": "what robots reach that differ from the model by what is uncertain",
    "fidelity.png": "the same gaits on rough and on exact fidelity levels: how far screening can be believed",
    "convergence.png": "fitness in each generation of the search, before verification",
    "members.png": "length of every member",
    "forces.png": "force in every member",
}
STYLE = (
    "body{font:16px/1.5 sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem}img{max-width:100%}"
    "th{text-align:left;padding-right:1.5rem;vertical-align:top;white-space:nowrap}figure{margin:2rem 0}"
    "table{border-spacing:0 .3rem}"
    "iframe{width:100%;height:34rem;border:1px solid #ddd}"
)


class Origin(NamedTuple):
    """Where a gait came from, as its files say it."""

    scene: str
    """name of the scene"""
    objective: str
    """name of the objective"""
    settings: dict[str, Any]
    """of the search"""
    command: str


Ticker = Callable[[str, int, int | None], None]
"""hears what is being done, how much of it is done, and of how much"""


def write_report(result: SearchResult, origin: Origin, folder: Path, on_progress: Ticker) -> dict[str, str]:
    """Leave gait.json, trajectory.npz, summary.json, figures, an animation and a page in the folder.

    Returns what was found, in words, by its headings.
    """
    scene, duration = result.scene, float(result.problem.duration)
    fine = SolverOptions(dt=result.verdict.verified.steps[0], dtype="float64")
    lasts = result.problem.fitness.objective.steady
    done, parts = itertools.count(), 3 + (PARTS if lasts else 0)
    tick = lambda: on_progress("measuring", next(done), parts)  # noqa: E731
    began = time.perf_counter()
    tick()
    trust = diagnose(scene, duration, options=fine, frame_rate=float(FRAME_RATE))
    trajectory = trust.trajectory
    tick()
    found = directions(scene, fine, duration)
    tick()
    asked = actuators(scene, fine, duration)
    tick()
    steady = _watched(result, tick) if lasts else None
    motion = None if scene.ground is None or trajectory.failed else rolling(scene, trajectory)
    assert scene.gait is not None, "a search finds a gait"
    gait = {
        "scene": origin.scene,
        **gait_facts(scene.gait),
        "duration": duration,
        "objective": origin.objective,
        "settings": origin.settings,
        **result.verdict.summary(),
        "steady": steady,
        "motion": None if motion is None else motion.summary(),
        "directions": found,
        "actuators": asked,
        "within_bounds": result.promoted.within_bounds,
        "diagnosis": trust.summary(),
        "command": origin.command,
    }
    save_json(folder / "gait.json", gait)
    arrays = {name: getattr(trajectory, name) for name in ("times", "positions", "velocities")}
    save_arrays(folder / "trajectory.npz", **arrays, phase=scene.gait.phase)
    measured = time.perf_counter()
    draw(result, trust, folder, on_progress)
    draw_motion(scene, trajectory, motion, steady, folder)
    drawn = time.perf_counter()
    seconds = {str(stage): spent for stage, spent in result.seconds.items()}
    seconds |= {"measuring": measured - began, "animating": drawn - measured}
    summary = {
        **gait,
        "fidelity": agreement_facts(result.promoted.agreement),
        "searches": [{**search._asdict(), "last": None} for search in result.searches],
        "polish": None if result.polished is None else polish_facts(result.polished),
        "stage_seconds": seconds,
        "wall_seconds": sum(seconds.values()),
    }
    save_json(folder / "summary.json", summary)
    first, rest = outcome_rows(summary), search_rows(summary, motion, result.problem.fitness.objective.unit)
    write_page(folder, f"A gait that {motion.kind}" if motion else "A gait", first, {**rest, "command": origin.command})
    return {"how far to trust it": "\n" + trust.table(), **first, **rest}


def _watched(result: SearchResult, tick: Callable[[], None]) -> dict[str, Any]:
    """How the gait lasts, by robots that differ as in the search."""
    # the last level has half of the step that was asked for, which this gait may not allow
    step = min(2 * result.levels[-1].dt, default_step(result.scene, default_method(result.scene)))
    problem = result.problem
    watched, uncertain = WATCHED * float(problem.duration), problem.fitness.uncertainty
    return steady_facts(result.scene, uncertain, duration=watched, dt=step, seed=UNSEEN, on_progress=tick)


def directions(best: Scene, options: SolverOptions, duration: float) -> list[dict[str, float]]:
    """Where the gait's images under the robot's symmetry lead from the same pose, verified one by one."""
    gait = best.gait
    assert gait is not None, "a search finds a gait"
    images = [image(gait, symmetry) for symmetry in standing_symmetries(best) if maps_members(gait, symmetry)]
    gaits = jax.tree.map(lambda *rows: np.stack(rows) if np.ndim(rows[0]) else rows[0], *images)
    verified = verify(best, gaits, duration, options=options)
    moved = verified.com_end - verified.com_start
    return [
        {"heading": heading, "distance": distance, "error_bar": bar}
        for heading, distance, bar in zip(np.arctan2(moved[:, 1], moved[:, 0]), verified.distance, verified.error_bar)
    ]


def maps_members(gait: Gait, symmetry: Symmetry) -> bool:
    """Whether the image of the gait actuates the members that the gait does."""
    return {symmetry.members[k] for k in gait.members} == set(gait.members)


def actuators(best: Scene, options: SolverOptions, duration: float) -> dict[str, Any]:
    """What the gait asks of its actuators."""
    assert best.gait is not None, "a search finds a gait"
    outcomes = simulate_population(best, as_population(best.gait), duration, options=options, with_metrics=True)
    metrics, distance = outcomes.metrics, float(outcomes.distance()[0])
    assert metrics is not None, "they were asked for"
    weight = float(best.structure.mass) * float(best.gravity or np.nan)
    peaks = {name: float(np.max(getattr(metrics, name))) for name in ("peak_rate", "peak_force", "peak_power")}
    works = {name: float(getattr(metrics, name)[0]) for name in ("work", "effort")}
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


def agreement_facts(agreement: Agreement) -> dict[str, Any]:
    """How far the fidelity levels agree, as it goes into a JSON file."""
    levels = [{"name": level.name, "dt": level.dt, "dtype": level.dtype} for level in agreement.levels]
    return {**agreement._asdict(), "levels": levels}


def draw(result: SearchResult, trust: TrustReport, folder: Path, on_progress: Ticker) -> None:
    """Figures and an animation."""
    scene, polished, verdict = result.scene, result.polished, result.verdict
    agreement = result.promoted.agreement
    unit, trajectory = result.problem.fitness.objective.unit, trust.trajectory
    names = tuple(level.name for level in result.levels)
    plot.save(plot.convergence_figure(list(result.searches), names, unit), folder / "convergence.png")
    ranks = agreement.rank_correlation, agreement.rank_correlation_of_the_evolved
    figure = plot.fidelity_figure(names, agreement.fitness, agreement.evolved, ranks, unit)
    plot.save(figure, folder / "fidelity.png")
    seen: dict[str, np.ndarray] = {
        "other contact model": np.asarray(verdict.other_model.each[0]),
        "found": np.asarray(verdict.robust.each[0]),
    }
    if polished is not None and polished.improved:
        seen["before polish"] = np.asarray(polished.before.each[0])
    plot.save(plot.robust_figure(seen, unit), folder / "robust.png")
    plot.save(plot.path_figure(scene, trajectory, float(verdict.verified.error_bar[0])), folder / "path.png")
    gif = folder / "animation.gif"
    animate(scene, trajectory, gif, on_frame=lambda drawn, frames: on_progress("animating", drawn, frames))


def draw_motion(
    scene: Scene, trajectory: Trajectory, motion: Rolling | None, steady: dict[str, Any] | None, folder: Path
) -> None:
    """The gait beside the motion, lengths, forces, of a settled robot for one cycle alone; the motion in 3D, if viser
    is installed."""
    assert scene.gait is not None, "a search finds a gait"
    end, begin = float(trajectory.times[-1]), 0.0
    cycle = steady["period"] * steady["periods"] if steady is not None and steady["settled"] else np.inf
    (folder / "orbit.png").unlink(missing_ok=True)
    if scene.ground is not None and cycle < end and not trajectory.failed:
        begin = end - cycle
        plot.save(plot.orbit_figure(scene, trajectory, cycle, steady["turning"] if steady else 0), folder / "orbit.png")
    shown = some_frames(trajectory, np.asarray(trajectory.times) >= begin)
    plot.save(plot.gait_figure(scene.gait, end, motion, begin), folder / "gait.png")
    plot.save(plot.member_figure(scene, shown), folder / "members.png")
    plot.save(plot.force_figure(scene, shown), folder / "forces.png")
    view.keep_html(scene, trajectory, folder / REPLAY, title="from the start on")


def outcome_rows(summary: dict[str, Any]) -> dict[str, str]:
    """What the gait does and what it needs, in words, by headings."""
    steady, asked = summary["steady"], summary["actuators"]
    return {
        **({"verified distance": distance_words(summary)} if steady is None else steady_rows(steady)),
        "actuators must give": f"up to {asked['peak_force']:.0f} N, {asked['peak_rate']:.2g} m/s, "
        f"{asked['peak_power']:.0f} W; cost of transport {asked['cost_of_transport_by_effort']:.2g} "
        "(own work of every actuator / (m g d))"
        + ("" if summary["within_bounds"] else "; no gait was found that stays within the bounds on actuators"),
    }


def search_rows(summary: dict[str, Any], motion: Rolling | None, unit: str) -> dict[str, str]:
    """How the gait was found and how far that can be trusted, in words; `unit` is the objective's."""
    robust, other = summary["robust"], summary["other_contact_model"]
    ranks = summary["fidelity"]["rank_correlation"][0][-1]
    among = summary["fidelity"]["rank_correlation_of_the_evolved"][0][-1]
    last = summary["fidelity"]["levels"][-1]["name"]
    rollouts = sum(search["rollouts"] for search in summary["searches"])
    verified = {} if summary["steady"] is None else {"verified distance": distance_words(summary)}
    return {
        **verified,
        "motion": "no ground, or no motion" if motion is None else motion.sentence(),
        "directions": ", ".join(
            f"{d['distance']:.2f} m towards {np.degrees(d['heading']):.0f}°" for d in summary["directions"]
        ),
        "objective": f"{robust['mean']:.3f} ± {robust['standard_deviation']:.2g} {unit} over {robust['robots']} robots "
        f"that differ, step error {robust['step_error']:.1g}; {other['mean']:.3f} ± "
        f"{other['standard_deviation']:.2g} on the other contact model",
        "search": f"{rollouts} rollouts; screening ranks gaits as {last} does with {ranks:.2f} (Spearman; "
        f"{among:.2f} among the evolved)",
        "polish": "none" if summary["polish"] is None else summary["polish"]["reason"],
        "sensitivity at the end": f"{summary['diagnosis'].get('sensitivity', np.nan):.3g} m/rad",
    }


def distance_words(summary: dict[str, Any]) -> str:
    """The distance with its error bar, where that says anything."""
    known, told = summary["error_bar"] <= summary["distance"], f"in {summary['duration']:g} s"
    if known:
        return f"{summary['distance']:.4f} ± {summary['error_bar']:.1g} m {told}"
    return f"{summary['distance']:.2f} m {told} at this time step; where the robot gets to depends on the step"


def write_page(out: Path, title: str, first: dict[str, str], rest: dict[str, str]) -> None:
    """A table of what comes `first`, the pictures of the motion, the `rest`, and the other pictures in the folder."""
    shown, replay = {name: text for name, text in PICTURES.items() if (out / name).exists()}, ""
    if (out / REPLAY).exists():
        told = escape(shown.pop("animation.gif", PICTURES["animation.gif"]))
        replay = f'<figure><iframe title="{told}" src="{REPLAY}"></iframe><figcaption>{told}</figcaption></figure>'
    pictures = {
        name: f'<figure><img src="{name}" alt="{escape(text)}"><figcaption>{escape(text)}</figcaption></figure>'
        for name, text in shown.items()
    }
    moving = replay + "".join(pictures.pop(name, "") for name in ("animation.gif", "orbit.png"))
    page = (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{escape(title)}</title><style>{STYLE}</style>'
        f"<h1>{escape(title)}</h1>{_table(first)}{moving}<h2>How it was found, and how far to trust it</h2>"
        f"{_table(rest)}{''.join(pictures.values())}</html>\n"
    )
    write_whole(out / "index.html", lambda file: file.write(page.encode()))


def _table(rows: dict[str, str]) -> str:
    lines = (f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>" for name, text in rows.items())
    return f"<table>{''.join(lines)}</table>"
