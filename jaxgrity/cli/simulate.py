"""Simulate a robot: once with the gait of its scene, or once for each row of a CSV file of phases."""

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

import jax
import numpy as np

from jaxgrity.cli.progress import Bars
from jaxgrity.cli.scenes import chosen_scene, replaced_files, scene_name
from jaxgrity.cli.settings import SimulateSettings
from jaxgrity.core.display import finite_or, known_words, significant
from jaxgrity.core.errors import InputError
from jaxgrity.formats.trajectories import save_trajectory
from jaxgrity.io.files import load_phases, save_json
from jaxgrity.model.actuation import Gait
from jaxgrity.model.scales import time_scale
from jaxgrity.model.scene import Scene, with_gait
from jaxgrity.orbits.motion_report import MotionReport, motion_report
from jaxgrity.populations.population import gaits_of, one_gait, simulate_population
from jaxgrity.report import plot, view
from jaxgrity.report.animation import animate, check_film
from jaxgrity.search.paths import stays_within
from jaxgrity.statics.describe import describe
from jaxgrity.stepping.discretisation import FAILURES
from jaxgrity.stepping.options import SolverOptions, resolve
from jaxgrity.stepping.pieces import OnTime
from jaxgrity.stepping.simulate import Trajectory, centre_path, simulate
from jaxgrity.trust.error_bars import verify
from jaxgrity.trust.trust_report import UNKNOWN_BAR, TrustReport, diagnose

Result = TypeVar("Result")

SAVED, SEEN = 100.0, 50.0
"""Saved frames per second: at all, and of a robot of one metre. A smaller one changes its face sooner."""

WARM = 4
"""Number of pieces from which on a motion's own pieces say how long it takes: the first compiles."""

LEFT = (
    *("summary.json", "trajectory.npz", "path.png", "members.png", "forces.png"),
    *("replay.html", "animation.gif", "animation.mp4", "outcomes.png"),
)
"""Files that this command writes. Those of an earlier run are removed first."""


def main(settings: SimulateSettings) -> None:
    """Roll out, and write summary.json, figures and the trajectory."""
    scene = chosen_scene(settings.scene, settings.gait)
    gaits: Gait | None = None
    duration = min(settings.duration, 2.0) if settings.quick else settings.duration
    if settings.gaits is not None and settings.animation != "none":
        found = f"--animation {settings.animation}: --gaits makes a simulation of each row"
        raise InputError(f"{found}; expected --animation with a single one, or none")
    if settings.gaits is not None:
        if scene.gait is None:
            raise InputError(f"--gaits {settings.gaits}: the scene has no gait; expected one with a [gait], or --gait")
        gaits = gaits_of(scene.gait, load_phases(settings.gaits, len(scene.gait.members)))
    elif settings.animation != "none":
        check_film(film_of(settings), settings.fps, settings.width, settings.camera)
    # what cannot be rolled out is refused before anything is said
    resolve(scene if gaits is None else with_gait(scene, one_gait(gaits, 0)), duration, options_of(settings))
    if words := replaced_files([settings.out / name for name in LEFT if (settings.out / name).exists()], settings.out):
        print(words)
    print(describe(scene), flush=True)
    summary = single(scene, duration, settings) if gaits is None else several(scene, gaits, duration, settings)
    save_json(settings.out / "summary.json", {"scene": scene_name(settings.scene), **summary})
    print(f"wrote {settings.out}/summary.json")


def options_of(settings: SimulateSettings) -> SolverOptions:
    """The solver options of the settings."""
    return SolverOptions(method=settings.method, dt=settings.dt, dtype=settings.dtype, any_step=settings.any_step)


def frame_rate_of(scene: Scene) -> float:
    """Saved frames per second, enough to see what the robot does on its ground."""
    return SAVED if scene.ground is None or not scene.gravity else max(SAVED, SEEN / float(time_scale(scene)))


def film_of(settings: SimulateSettings) -> Path:
    """The file of the animated picture."""
    return settings.out / f"animation.{settings.animation}"


def forget_earlier(folder: Path) -> None:
    """Remove an earlier run's files; called once there is a new result, since a refused run has none."""
    for left in LEFT:
        (folder / left).unlink(missing_ok=True)


def timed(function: Callable[[OnTime], Result], duration: float, bars: Bars) -> tuple[Result, float, float]:
    """The result, the wall time of a warm call, and the extra time of the first call: compilation.

    A long motion, which comes in pieces, is made once: all pieces but the first and the last are warm. Others are made
    twice, and so is one that failed on the way.
    """
    seconds: list[float] = []
    for stage in ("rolling out", "timing"):
        pieces: list[tuple[float, float]] = []

        def heard(done: float, total: float, stage: str = stage, pieces: list = pieces) -> None:
            pieces.append((done, time.perf_counter()))
            bars.show(stage, float(f"{done:.4g}"), total)

        bars.show(stage, 0.0, duration)
        start = time.perf_counter()
        result = jax.block_until_ready(function(heard))
        seconds.append(time.perf_counter() - start)
        bars.show(stage, duration, duration)
        if len(pieces) > WARM and not getattr(result, "failed", False):
            (begun, since), (done, until) = pieces[1], pieces[-2]
            seconds.append((until - since) * duration / (done - begun))
            break
    return result, seconds[1], max(0.0, seconds[0] - seconds[1])


def diagnosed(scene: Scene, duration: float, options: SolverOptions, **known: Any) -> TrustReport:
    """`diagnose`, with a progress bar; `known` goes to it."""
    with Bars() as bars:
        heard = lambda done, total: bars.show("diagnosing", done, total)  # noqa: E731
        return diagnose(scene, duration, options=options, on_progress=heard, **known)


def single(scene: Scene, duration: float, settings: SimulateSettings) -> dict[str, Any]:
    """One rollout with the scene's own gait: its trajectory, its figures, its summary."""
    options, out = options_of(settings), settings.out
    with Bars() as bars:
        rate = frame_rate_of(scene)
        roll = lambda heard: simulate(scene, duration, options=options, frame_rate=rate, on_progress=heard)  # noqa: E731
        trajectory, wall, compilation = timed(roll, duration, bars)
    known = {"motion": trajectory, "frame_rate": rate}
    forget_earlier(out)
    path = centre_path(scene, trajectory)
    distance = float(np.hypot(*(path[-1] - path[0])[:2]))
    save_trajectory(trajectory, out / "trajectory.npz")
    print(
        f"{FAILURES[int(trajectory.failure)]}: {duration:g} s in {int(trajectory.steps)} steps, "
        f"{wall:.3f} s of wall time ({compilation:.1f} s to compile)"
    )
    leave_replay(scene, trajectory, settings)  # first: it shows the motion while the rest is computed
    with ThreadPoolExecutor(1) as beside:  # compiling leaves a core free to draw
        drawing = beside.submit(leave_pictures, scene, trajectory, settings)
        trust = (
            plot.drawn("diagnosis", lambda: diagnosed(scene, duration, options, **known)) if settings.diagnose else None
        )
        with Bars() as bars:
            bars.show("drawing", 0, None)
            drawing.result()
            if not trajectory.failed:
                bar = trust.error_bar if trust else None
                plot.drawn("path.png", lambda: plot.save(plot.path_figure(scene, trajectory, bar), out / "path.png"))
    motion = plot.drawn("account of the motion", lambda: motion_report(scene, trajectory))
    bar = trust.error_bar if trust else None
    print(conclusion(distance, bar, motion, stays_within(scene, max(distance, bar or 0.0), duration)))
    if trust:
        print(trust.table())
    return {
        "method": trajectory.method,
        "dt": trajectory.dt,
        "dtype": settings.dtype,
        "duration": duration,
        "steps": int(trajectory.steps),
        "rejected_steps": int(trajectory.rejected),
        "wall_seconds": wall,
        "compile_seconds": compilation,
        "com_start": [path[0]],
        "com_end": [path[-1]],
        "distance": [distance],
        "failed": [0] if trajectory.failed else [],
        "outcome": [FAILURES[int(trajectory.failure)]],
        "motion": motion.summary() if motion else None,
        "diagnosis": trust.summary() if trust else None,
    }


def conclusion(distance: float, error_bar: float | None, motion: MotionReport | None, still: bool = False) -> str:
    """Distance and motion of a rollout in words; that it is not known if the error bar exceeds the distance, m.

    `still`: whether the robot stays where it is (`stays_within`), by all that the error bar allows.
    """
    if not np.isfinite(distance):
        return "no distance: the simulation failed"
    moved = f"moved {significant(distance, 4)} m"
    if error_bar is not None and not np.isfinite(error_bar):
        moved = f"do not trust the distance, since its error bar is unknown: {moved}"
    elif still:
        moved = "moved less than a hundredth of a body length horizontally"
    elif error_bar is not None:
        told = known_words(distance, error_bar, " m", ".2g")
        moved = f"how far the robot moved is {told}" if error_bar > distance else f"moved {told}"
    return moved if motion is None else f"{moved}\n{motion.sentence()}"


def leave_replay(scene: Scene, trajectory: Trajectory, settings: SimulateSettings) -> None:
    """Write the replay of a rollout, if it is wanted, and say where it is. A failure costs the replay, with a line."""
    if trajectory.failed or not settings.replay:
        return
    page, title = settings.out / "replay.html", scene_name(settings.scene)
    if plot.drawn(page.name, lambda: view.keep_html(scene, trajectory, page, title=title)):
        print(f"to watch the motion in 3D, open {page} in a browser", flush=True)


def leave_pictures(scene: Scene, trajectory: Trajectory, settings: SimulateSettings) -> None:
    """Write all pictures of a rollout that need no diagnosis.

    A failure costs one picture, with a line, and nothing else of the rollout.
    """
    out = settings.out
    if trajectory.failed:
        return
    if scene.structure.member_count:
        plot.drawn("members.png", lambda: plot.save(plot.member_figure(scene, trajectory), out / "members.png"))
        plot.drawn("forces.png", lambda: plot.save(plot.force_figure(scene, trajectory), out / "forces.png"))
    if settings.animation != "none":
        film = film_of(settings)
        width, camera = settings.width, settings.camera
        plot.drawn(film.name, lambda: animate(scene, trajectory, film, settings.fps, width=width, camera=camera))


def several(scene: Scene, gaits: Gait, duration: float, settings: SimulateSettings) -> dict[str, Any]:
    """One rollout for each gait, all in one call; the report on trust is of the gait with the largest distance."""
    options = options_of(settings)
    with Bars() as bars:
        roll = lambda heard: simulate_population(scene, gaits, duration, options=options)  # noqa: E731
        outcomes, wall, compilation = timed(roll, duration, bars)
    forget_earlier(settings.out)
    failed, distance = np.asarray(outcomes.failure) != 0, np.asarray(outcomes.distance())
    figure = plot.outcomes_figure(np.asarray(outcomes.com_start), np.asarray(outcomes.com_end), failed)
    plot.save(figure, settings.out / "outcomes.png")
    best = ""
    if not failed.all():
        first = int(np.nanargmax(distance))
        best = f"; furthest: row {first + 1}, {significant(float(distance[first]), 4)} m"
    print(
        f"{len(gaits.phase)} gaits, {int(failed.sum())} failed: {duration:g} s each, "
        f"{wall:.3f} s of wall time ({compilation:.1f} s to compile){best}"
    )
    verified = trust = None
    if settings.diagnose and not failed.all():
        verified = verify(scene, gaits, duration, options=options)
        furthest = with_gait(scene, one_gait(gaits, int(np.nanargmax(distance))))
        trust = diagnosed(furthest, duration, options)
        median = finite_or(float(np.median(verified.error_bar)), "m (median)", "of most gaits " + UNKNOWN_BAR)
        print(f"error bars: {median}; report on the gait that goes furthest:\n{trust.table()}")
    steps = np.asarray(outcomes.steps)
    return {
        "method": outcomes.method,
        "dt": outcomes.dt,
        "dtype": settings.dtype,
        "duration": duration,
        "steps": int(steps[0]) if np.ptp(steps) == 0 else steps,
        "wall_seconds": wall,
        "compile_seconds": compilation,
        "com_start": outcomes.com_start,
        "com_end": outcomes.com_end,
        "distance": [float(d) if np.isfinite(d) else None for d in distance],
        "failed": np.flatnonzero(failed),
        "outcome": [FAILURES[int(code)] for code in outcomes.failure],
        "error_bar": verified.error_bar if verified else None,
        "diagnosis_of_furthest": trust.summary() if trust else None,
    }
