"""A gait that lasts by programs that share no code with jaxgrity: hand-written C, and MuJoCo with contacts of its own.

Nothing was searched for on them. Robots that begin at different phases of the gait are rolled out; their speed is the
displacement after they have settled. Extra: `peer` for MuJoCo; --limit names the folder of the built C programs.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from jaxgrity.cli.script import measured, run

import limit
import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from jaxgrity import Scene, SolverOptions, contact_twin, gaits_of, load_gait, load_scene, simulate_population, with_gait
from jaxgrity.io.files import save_json
from jaxgrity.model import body_length
from jaxgrity.report import plot

Ends = Callable[[np.ndarray, float], np.ndarray]
"""of phases (robots, actuators) and a duration, s: where the robots' centres of mass are, (robots, 3), m"""


@dataclass
class Settings:
    gait: str = "straight"
    """of the library, with one amplitude and one frequency for all actuators"""
    robots: int = 16
    """that begin at phases of their own"""
    settled: float = 20.0
    """s, after which the displacement counts"""
    duration: float = 60.0
    """s"""
    limit: Path | None = None
    """folder with the programs exact64 and limit64, built"""
    out: Path = Path("results/third_opinions")
    """folder for third_opinions.json and its figure"""
    quick: bool = False
    """two robots, 10 s, without MuJoCo"""


def main(settings: Settings) -> None:
    if settings.quick:
        settings.robots, settings.settled, settings.duration = 2, 5.0, 10.0
    scene = with_gait(load_scene("exact"), load_gait(settings.gait))
    engines = engines_of(scene, settings)
    turns = np.random.default_rng(0).uniform(0, 2 * np.pi, (settings.robots, 1))
    phases = np.asarray(scene.gait.phase) + turns
    rows, speeds = [], {}
    for name, ends in tqdm(engines.items(), unit="engine"):
        moved = ends(phases, settings.duration) - ends(phases, settings.settled)
        seconds = settings.duration - settings.settled
        speeds[name] = np.hypot(moved[:, 0], moved[:, 1]) / seconds / float(body_length(scene))
        mean, scatter, slowest = (float(f(speeds[name])) for f in (np.mean, np.std, np.min))
        rows.append({"engine": name, "mean": mean, "standard_deviation": scatter, "slowest": slowest})
    save_json(settings.out / "third_opinions.json", {**measured(), "robots": settings.robots, "rows": rows})
    plot.save(figure(speeds), settings.out / "third_opinions.png")
    for row in rows:
        print(
            f"{row['engine']:24s} {row['mean']:.3f} body lengths/s (standard deviation {row['standard_deviation']:.2g})"
        )
    print(f"wrote {settings.out}/")


def engines_of(scene: Scene, settings: Settings) -> dict[str, Ends]:
    """What rolls the robots out, by its name: on rigid contact, then on springs, then by MuJoCo."""
    twin = contact_twin(scene)
    found = {"jaxgrity, exact": by_jaxgrity(scene), "jaxgrity, penalty": by_jaxgrity(twin)}
    if settings.limit is not None:
        found["C, exact (exact64)"] = by_c(settings.limit / "exact64", scene, 2.5e-3)
        found["C, penalty (limit64)"] = by_c(settings.limit / "limit64", twin, 2e-4)
    if find_spec("mujoco") is not None and not settings.quick:
        found["MuJoCo"] = by_mujoco(twin)
    return found


def by_jaxgrity(scene: Scene) -> Ends:
    """In float64, at the scene's own step."""

    def ends(phases: np.ndarray, duration: float) -> np.ndarray:
        options = SolverOptions(dtype="float64")
        return np.asarray(simulate_population(scene, gaits_of(scene.gait, phases), duration, options=options).com_end)

    return ends


def by_c(program: Path, scene: Scene, dt: float) -> Ends:
    """At a step of `dt`, s."""
    return lambda phases, duration: limit.roll(program, scene, phases, round(duration / dt), dt, threads=2)[0]


def by_mujoco(scene: Scene) -> Ends:
    """Spring struts and cables, and MuJoCo's own soft contact, by RK4 at 0.2 ms."""
    import mujoco_peer

    mass = np.asarray(scene.structure.lumped_mass)

    def ends(phases: np.ndarray, duration: float) -> np.ndarray:
        q, _ = mujoco_peer.roll(scene, phases, duration, 2e-4, "RK4")
        return np.einsum("n,rnk->rk", mass / mass.sum(), q)

    return ends


@plot.styled
def figure(speeds: dict[str, np.ndarray]) -> Figure:
    """The speed of each robot on each engine."""
    chart = Figure(figsize=(7, 3.4), layout="constrained")
    axes = chart.subplots()
    for k, values in enumerate(speeds.values()):
        axes.plot(values, k + 0.15 * np.linspace(-1, 1, len(values)), "o", markersize=4)
    axes.set(
        yticks=range(len(speeds)), yticklabels=list(speeds), xlabel="steady speed (body lengths/s)", xlim=(0, None)
    )
    axes.invert_yaxis()
    return chart


if __name__ == "__main__":
    run(main, Settings)
