"""The report of a gait search: facts, figures, an animation and a page."""

import itertools
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from jaxgrity.formats.trajectories import save_trajectory
from jaxgrity.io.files import save_json, write_whole
from jaxgrity.io.gait_library import gait_facts
from jaxgrity.model.scales import time_scale
from jaxgrity.model.scene import Scene
from jaxgrity.populations.motion_kinds import Rolling, rolling
from jaxgrity.populations.population import one_gait
from jaxgrity.report import plot, view
from jaxgrity.report.animation import animate
from jaxgrity.report.gait_rows import leading_sentences, outcome_rows, search_rows
from jaxgrity.report.measuring import gait_measured, verified_stays
from jaxgrity.report.steady import STAGES, on_orbit
from jaxgrity.search.pipeline import SearchResult
from jaxgrity.search.polish import Polished
from jaxgrity.search.promotion import Agreement, Promoted
from jaxgrity.stepping.options import SolverOptions
from jaxgrity.stepping.simulate import Trajectory, simulate, some_frames
from jaxgrity.trust.trust_report import TrustReport, diagnose

FRAME_RATE, REPLAYED = 50, 25.0
"""Frames per second of the trajectory that is kept, and of its replay."""
FILMED = 15.0
"""Duration of the animation, s for a robot of one metre. Drawing takes longer than any other part of the report, and
the replay has all of the motion."""
REPLAY, MOVES = "replay.html", "the motion from the start, in real time"
"""Name of the replay, and its caption."""
PICTURES = {
    "animation.gif": "the first seconds of the motion, in real time",
    "orbit.png": "the orbit: one cycle, in a frame that moves at the steady speed",
    "gait.png": "rest lengths of the actuated members, and the faces that the robot stands on",
    "path.png": "path of the centre of mass; the bar at the end is the verified error bar",
    "robust.png": "objective of perturbed robots",
    "fidelity.png": "the same gaits on coarse and fine fidelity levels: how far to trust screening",
    "polish.png": "what polishing did: the wave before and after, and the mean fitness around each step",
    "convergence.png": "fitness in each generation of the search, before verification",
    "members.png": "lengths of all members",
    "forces.png": "forces in all members",
}
"""Pictures of the page, and their captions."""
FILES = ("trajectory.npz", "index.html", REPLAY, *PICTURES)
"""Names of the files that `write_report` leaves, beside those of the search itself."""
STYLE = (
    "body{font:16px/1.5 sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem}img{max-width:100%}"
    "th{text-align:left;padding-right:1.5rem;vertical-align:top;white-space:nowrap}figure{margin:2rem 0}"
    "table{border-spacing:0 .3rem}"
    "@media(max-width:40rem){th,td{display:block}}"
    "iframe{width:100%;height:34rem;border:1px solid #ddd}"
)
"""CSS of the page: readable on a phone, too."""


VIEWPORT = '<meta name="viewport" content="width=device-width, initial-scale=1">'
"""Element of a page's head that makes a phone show it at the phone's own width."""


class Origin(NamedTuple):
    """Origin of a gait, as its files record it."""

    scene: str
    """name of the scene"""
    objective: str
    """name of the objective"""
    settings: dict[str, Any]
    """of the search"""
    command: str


Ticker = Callable[[str, int, int | None], None]
"""Function that hears what is being done, how much of it is done, and how much there is."""


def write_report(result: SearchResult, origin: Origin, folder: Path, on_progress: Ticker) -> dict[str, str]:
    """Leave gait.json, trajectory.npz, summary.json, figures, an animation and a page in the folder.

    Returns the results in words, by their headings. The summary's `reporting_seconds` are those of its longest parts,
    which run side by side; figures and the replay are the rest.
    """
    scene, duration = result.scene, float(result.problem.duration)
    fine = SolverOptions(dt=result.verdict.verified.steps[0], dtype="float64")
    parts = 5 + (STAGES if result.problem.seeks_orbits else 0)
    tick, began = _ticker(on_progress, parts), time.perf_counter()
    assert scene.gait is not None, "a search finds a gait"
    known = {
        "scene": origin.scene,
        **gait_facts(scene.gait, scene.structure),
        "duration": duration,
        "objective": origin.objective,
        "unit": result.problem.fitness.objective.unit,
        "settings": origin.settings,
        **result.verdict.summary(),
        "stays": verified_stays(scene, result.verdict.verified, duration),
        "command": origin.command,
    }
    # one may use the gait while the rest of the report is made
    save_json(folder / "gait.json", known)
    trajectory, trust, (steady, found, asked), parts_took = _side_by_side(result, fine, folder, tick)
    draw(result, trust, folder)
    motion = None if scene.ground is None or trajectory.failed else rolling(scene, trajectory)
    gait = known | {
        "steady": steady,
        "motion": None if motion is None else motion.summary(),
        "directions": found,
        "actuators": asked,
        "within_bounds": asked["excess"] == 0,
        "diagnosis": trust.summary(),
    }
    save_json(folder / "gait.json", gait)
    save_trajectory(trajectory, folder / "trajectory.npz")
    draw_motion(scene, trajectory, motion, steady, folder)
    tick()
    seconds = {str(stage): spent for stage, spent in result.seconds.items()}
    seconds |= {"reporting": time.perf_counter() - began}
    summary = {
        **gait,
        "fidelity": agreement_facts(result.promoted.agreement),
        "finalists": finalist_facts(result.promoted),
        "searches": [{**search._asdict(), "last": None} for search in result.searches],
        "polish": None if result.polished is None else polish_facts(result.polished),
        "stage_seconds": seconds,
        "reporting_seconds": parts_took,
        "wall_seconds": sum(seconds.values()),
    }
    save_json(folder / "summary.json", summary)
    first, rest = outcome_rows(summary), search_rows(summary, motion, result.problem.fitness.objective)
    title, rows = f"A gait that {motion.kind}" if motion else "A gait", {**rest, "command": origin.command}
    write_page(folder, title, leading_sentences(summary), first, rows)
    return {"how far to trust it": "\n" + trust.table(), **first, **rest}


def _side_by_side(result: SearchResult, fine: SolverOptions, folder: Path, tick: Callable[[], None]):
    """The motion, its diagnosis, what `gait_measured` finds, and the seconds that each took; an animation and a replay.

    Compilation, a rollout of one robot and drawing each use one core.
    """
    scene, duration, spent = result.scene, float(result.problem.duration), {}

    def clocked(part: str, function: Callable, *given, **options) -> Any:
        start = time.perf_counter()
        found = function(*given, **options)
        spent[part] = time.perf_counter() - start
        return found

    tick()
    with ThreadPoolExecutor() as beside:
        measuring = beside.submit(clocked, "measuring", gait_measured, result, fine, tick)
        frames = {"options": fine, "frame_rate": FRAME_RATE / float(time_scale(scene))}
        trajectory = clocked("motion", simulate, scene, duration, **frames)
        diagnosing = beside.submit(clocked, "diagnosis", diagnose, scene, duration, **frames)
        diagnosing.add_done_callback(lambda _: tick())
        film = folder / "animation.gif"
        film.unlink(missing_ok=True)
        beginning = some_frames(trajectory, np.asarray(trajectory.times) <= FILMED * float(time_scale(scene)))
        clocked("animation", plot.drawn, film.name, lambda: animate(scene, beginning, film))
        how = {"frame_rate": REPLAYED, "title": "the motion from the start"}
        plot.drawn(REPLAY, lambda: view.keep_html(scene, trajectory, folder / REPLAY, **how))
        tick()
        return trajectory, diagnosing.result(), measuring.result(), spent


def finalist_facts(promoted: Promoted) -> dict[str, Any]:
    """The finalists, best first, for a JSON file."""
    multipliers = None if promoted.multipliers is None else promoted.multipliers.tolist()
    return {"fitness": np.asarray(promoted.finals.fitness).tolist(), "multipliers": multipliers}


def polish_facts(polished: Polished) -> dict[str, Any]:
    """The results of polishing, for a JSON file."""
    growth = polished.sensitivity
    return {
        "improved": polished.improved,
        "reason": polished.reason,
        "rollouts": polished.rollouts,
        "horizon": polished.horizon,
        "fitness_before": float(polished.before.fitness[0]),
        "fitness_after": float(polished.after.fitness[0]),
        "sensitivity": None if growth is None else {"times": growth.times, "norm": growth.norm},
        "steps": [step._asdict() for step in polished.steps],
    }


def agreement_facts(agreement: Agreement) -> dict[str, Any]:
    """The agreement of the fidelity levels, for a JSON file."""
    levels = [{"name": level.name, "dt": level.dt, "dtype": level.dtype} for level in agreement.levels]
    return {**agreement._asdict(), "levels": levels}


def _ticker(on_progress: Ticker, parts: int) -> Callable[[], None]:
    """A callback for each finished part, from any thread."""
    done, turn = itertools.count(), threading.Lock()

    def tick() -> None:
        with turn:
            on_progress("reporting", next(done), parts)

    return tick


def draw(result: SearchResult, trust: TrustReport, folder: Path) -> None:
    """Figures of the search and of its result."""
    scene, polished, verdict = result.scene, result.polished, result.verdict
    agreement = result.promoted.agreement
    unit, trajectory = result.problem.fitness.objective.unit, trust.trajectory
    names = tuple(level.name for level in result.levels)
    ranks = agreement.rank_correlation, agreement.rank_correlation_of_the_evolved
    compared = tuple(level.name for level in agreement.levels)
    seen: dict[str, np.ndarray] = {
        "other contact model": np.asarray(verdict.other_model.each[0]),
        "found": np.asarray(verdict.robust.each[0]),
    }
    if polished is not None and polished.improved:
        seen["before polish"] = np.asarray(polished.before.each[0])
    pictures = {
        "convergence.png": lambda: plot.convergence_figure(list(result.searches), names, unit),
        "fidelity.png": lambda: plot.fidelity_figure(compared, agreement.fitness, agreement.evolved, ranks, unit),
        "robust.png": lambda: plot.robust_figure({name: x[np.isfinite(x)] for name, x in seen.items()}, unit),
        "path.png": lambda: plot.path_figure(scene, trajectory, float(verdict.verified.error_bar[0])),
    }
    (folder / "polish.png").unlink(missing_ok=True)
    if polished is not None and polished.improved and polished.steps:
        start = one_gait(result.problem.genome.gaits(result.problem.scene.gait, result.promoted.genes[:1]), 0)
        steps, steady = [step.fitness for step in polished.steps], result.problem.fitness.objective.steady
        # pathwise gradients of a steady objective are those of an orbit, whose steps are judged by whole rollouts
        horizons = {step.horizon: 0 for step in polished.steps if not (steady and step.pathwise_share == 1)}
        pictures["polish.png"] = lambda: plot.polish_figure(start, result.gait, steps, unit, tuple(horizons))
    leave_figures(pictures, folder)


def leave_figures(pictures: dict[str, Callable[[], Figure]], folder: Path) -> None:
    """Write figures by their names, over earlier ones; a failure costs one figure, with a line."""
    for name, figure in pictures.items():
        (folder / name).unlink(missing_ok=True)
        plot.drawn(name, lambda name=name, figure=figure: plot.save(figure(), folder / name))  # type: ignore[misc]


def draw_motion(
    scene: Scene, trajectory: Trajectory, motion: Rolling | None, steady: dict[str, Any] | None, folder: Path
) -> None:
    """The gait beside the motion, lengths, forces; if the robot settles in that time, of the last cycle alone."""
    gait = scene.gait
    assert gait is not None, "a search finds a gait"
    end, begin = float(trajectory.times[-1]), 0.0
    (folder / "orbit.png").unlink(missing_ok=True)
    pictures: dict[str, Callable[[], Figure]] = {}
    if scene.ground is not None and steady is not None and on_orbit(steady, end) and not trajectory.failed:
        cycle, turning = steady["period"] * steady["periods"], steady["turning"]
        begin = end - cycle
        pictures["orbit.png"] = lambda: plot.orbit_figure(scene, trajectory, cycle, turning)
    shown = some_frames(trajectory, np.asarray(trajectory.times) >= begin)
    pictures["gait.png"] = lambda: plot.gait_figure(gait, end, motion, begin)
    pictures["members.png"] = lambda: plot.member_figure(scene, shown)
    pictures["forces.png"] = lambda: plot.force_figure(scene, shown)
    leave_figures(pictures, folder)


def write_page(out: Path, title: str, lead: tuple[str, ...], first: dict[str, str], rest: dict[str, str]) -> None:
    """The page: sentences, `first` rows, pictures of the motion, the `rest`, and the other pictures in the folder."""
    shown, replay = {name: text for name, text in PICTURES.items() if (out / name).exists()}, ""
    if (out / REPLAY).exists():
        shown.pop("animation.gif", None)
        replay = f'<figure><iframe title="{MOVES}" src="{REPLAY}"></iframe><figcaption>{MOVES}</figcaption></figure>'
    pictures = {
        name: f'<figure><img src="{name}" alt="{escape(text)}"><figcaption>{escape(text)}</figcaption></figure>'
        for name, text in shown.items()
    }
    moving = replay + "".join(pictures.pop(name, "") for name in ("animation.gif", "orbit.png"))
    page = (
        f'<!doctype html><html lang="en"><meta charset="utf-8">{VIEWPORT}<title>{escape(title)}</title>'
        f"<style>{STYLE}</style><h1>{escape(title)}</h1><p>{escape(' '.join(lead))}</p>{_table(first)}{moving}"
        f"<h2>How it was found, and how far to trust it</h2>{_table(rest)}{''.join(pictures.values())}</html>\n"
    )
    write_whole(out / "index.html", lambda file: file.write(page.encode()))


def _table(rows: dict[str, str]) -> str:
    lines = (f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>" for name, text in rows.items())
    return f"<table>{''.join(lines)}</table>"
