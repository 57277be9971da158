"""Roll a scene out: once, with its own gait, or once for each row of phases in a CSV file."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, TypeVar

from common import run

import jax
import numpy as np
import tyro

from jaxgrity import (
    FAILURES,
    Scene,
    diagnose,
    gait_record,
    gaits_of,
    load_gait,
    load_scene,
    one_gait,
    plot,
    simulate,
    simulate_population,
    verify,
    with_gait,
)
from jaxgrity.io.files import load_phases, save_arrays, save_json
from jaxgrity.stepping.simulate import centre_path

Result = TypeVar("Result")


@dataclass
class Settings:
    scene: Annotated[Path, tyro.conf.Positional]
    """scene file (TOML)"""
    gaits: Path | None = None
    """CSV without a header: the phases (rad) of one gait a row"""
    gait: str | None = None
    """a gait of the library by its name, or the gait.json of a search, in place of the scene's own"""
    duration: float = 10.0
    """s"""
    method: str | None = None
    """rk4, tsit5, dopri8, kvaerno3, kvaerno5, symplectic or complementarity; without it, the scene decides"""
    dt: float | None = None
    """fixed step, s; without it, adaptive methods adapt theirs, others take a safe one"""
    dtype: Literal["float32", "float64"] = "float64"
    """precision of the rollout"""
    any_step: bool = False
    """let a step pass that would blow up"""
    diagnose: bool = True
    """say how far the result can be trusted: error bars, energy audit, sensitivity; takes several more rollouts"""
    out: Path = Path("results/simulate")
    """folder for summary.json, figures, and trajectory.npz of a single rollout"""
    quick: bool = False
    """at most 2 s of motion"""


def main(settings: Settings) -> None:
    scene = load_scene(settings.scene)
    if settings.gait is not None:
        scene = with_gait(scene, load_gait(settings.gait))
        found = gait_record(settings.gait).get("scene")
        if found not in (None, settings.scene.name):
            print(f"the gait {settings.gait} was found on {found}")
    print(scene.describe())
    duration = min(settings.duration, 2.0) if settings.quick else settings.duration
    options = {
        "method": settings.method,
        "dt": settings.dt,
        "dtype": settings.dtype,
        "any_step": settings.any_step,
    }
    if settings.gaits is None:
        summary = single(scene, duration, options, settings.out, settings.diagnose)
    else:
        phases = load_phases(settings.gaits, len(scene.gait.members) if scene.gait else 0)
        summary = several(scene, phases, duration, options, settings.out, settings.diagnose)
    save_json(settings.out / "summary.json", {"scene": settings.scene.name, **summary})
    print(f"wrote {settings.out}/summary.json")


def timed(function: Callable[[], Result]) -> tuple[Result, float, float]:
    """The result of a second, warm call, its wall time, and what the first call took longer: compilation."""
    seconds = []
    for _ in range(2):
        start = time.perf_counter()
        result = jax.block_until_ready(function())
        seconds.append(time.perf_counter() - start)
    return result, seconds[1], max(0.0, seconds[0] - seconds[1])


def single(scene: Scene, duration: float, options: dict, out: Path, checked: bool) -> dict:
    """One rollout with the scene's own gait: its trajectory, its figures, its summary."""
    trajectory, wall, compilation = timed(lambda: simulate(scene, duration, **options))
    path = centre_path(scene, trajectory)
    distance = float(np.hypot(*(path[-1] - path[0])[:2]))
    save_arrays(
        out / "trajectory.npz",
        times=trajectory.times,
        positions=trajectory.positions,
        velocities=trajectory.velocities,
        phase=scene.gait.phase if scene.gait else [],
    )
    diagnosis = diagnose(scene, duration, **options) if checked else None
    if not trajectory.failed:
        bar = diagnosis.error_bar if diagnosis else None
        plot.save(plot.path_figure(scene, trajectory, bar), out / "path.png")
        if scene.structure.struts or scene.structure.cables:
            plot.save(plot.member_figure(scene, trajectory), out / "members.png")
    print(
        f"{FAILURES[int(trajectory.failure)]}: {duration:g} s in {int(trajectory.steps)} steps, "
        f"{wall:.3f} s of wall time ({compilation:.1f} s to compile); moved {distance:.4f} m"
    )
    if diagnosis:
        print(diagnosis.table())
    return {
        "method": trajectory.method,
        "dt": trajectory.dt,
        "dtype": options["dtype"],
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
        "diagnosis": diagnosis.summary() if diagnosis else None,
    }


def several(scene: Scene, phases: np.ndarray, duration: float, options: dict, out: Path, checked: bool) -> dict:
    """One rollout for each row of phases, all in one call; diagnosed is the gait that goes furthest."""
    gaits = gaits_of(scene.gait, phases)
    outcomes, wall, compilation = timed(lambda: simulate_population(scene, gaits, duration, **options))
    failed, distance = np.asarray(outcomes.failure) != 0, np.asarray(outcomes.distance())
    figure = plot.outcomes_figure(np.asarray(outcomes.com_start), np.asarray(outcomes.com_end), failed)
    plot.save(figure, out / "outcomes.png")
    best = f"; furthest: row {int(np.nanargmax(distance)) + 1}, {np.nanmax(distance):.4f} m" if not failed.all() else ""
    print(
        f"{len(phases)} gaits, {int(failed.sum())} failed: {duration:g} s each, "
        f"{wall:.3f} s of wall time ({compilation:.1f} s to compile){best}"
    )
    verified = diagnosis = None
    if checked and not failed.all():
        verified = verify(scene, gaits, duration, outcomes.dt, outcomes.method, options["any_step"])
        furthest = with_gait(scene, one_gait(gaits, int(np.nanargmax(distance))))
        diagnosis = diagnose(furthest, duration, **options)
        print(f"error bars: {np.median(verified.error_bar):.2g} m (median); of the furthest:\n{diagnosis.table()}")
    steps = np.asarray(outcomes.steps)
    return {
        "method": outcomes.method,
        "dt": outcomes.dt,
        "dtype": options["dtype"],
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
        "diagnosis_of_furthest": diagnosis.summary() if diagnosis else None,
    }


if __name__ == "__main__":
    run(main, Settings)
