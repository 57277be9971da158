"""Gaits that last by programs that share no code with jaxgrity: hand-written C, and MuJoCo with contacts of its own.

Nothing was searched for on them. Robots that begin at different phases of the gait are rolled out; their speed is the
displacement after they have settled. Extra: `peer` for MuJoCo; C is there if there is a compiler.
"""

from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from measurements import limit as hand_written
from measurements.engines import mujoco_roll
from measurements.limit import waves_at
from measurements.measurement import Figure, Record, measurement
from measurements.pages import columns

from jaxgrity import Scene, SolverOptions, contact_twin, load_gait, load_scene, simulate_population, with_gait
from jaxgrity.model import body_length

Ends = Callable[[np.ndarray, float], np.ndarray]
"""of phases (robots, actuators) and a duration, s: where the robots' centres of mass are, (robots, 3), m"""


@measurement(
    page="gait_records.md",
    quick={"gaits": ("straight",), "robots": 2, "settled": 5.0, "duration": 10.0, "mujoco": False},
    drawn=("speeds",),
)
def third_opinions(
    gaits: tuple[str, ...] = ("straight", "brisk"),
    robots: int = 16,
    settled: float = 20.0,
    duration: float = 60.0,
    mujoco: bool = True,
) -> Iterator[Record]:
    """A row for each gait and program.

    Args:
        gaits: of the library, on the scene "exact"
        robots: that begin at phases of their own
        settled: s, after which the displacement counts
        duration: s
        mujoco: by MuJoCo too, where it is installed
    """
    several = ((gait, *each) for gait in gaits for each in engines_of(_scene(gait), mujoco).items())
    for gait, name, ends in several:
        phases = np.asarray(load_gait(gait).phase) + np.random.default_rng(0).uniform(0, 2 * np.pi, (robots, 1))
        moved = ends(phases, duration) - ends(phases, settled)
        speeds = np.hypot(moved[:, 0], moved[:, 1]) / (duration - settled) / float(body_length(_scene(gait)))
        numbers = {"mean": np.mean, "standard_deviation": np.std, "median": np.median, "slowest": np.min}
        about = {"gait": gait, "engine": name}
        yield about | {name: float(of(speeds)) for name, of in numbers.items()} | {"speeds": speeds}
    return {"robots": robots}


def _scene(gait: str) -> Scene:
    return with_gait(load_scene("exact"), load_gait(gait))


def engines_of(scene: Scene, mujoco: bool) -> dict[str, Ends]:
    """What rolls the robots out, by its name: on rigid contact, then on springs, then by MuJoCo.

    MuJoCo gets spring struts and cables, and its own soft contact, by RK4 at 0.2 ms.
    """
    twin = contact_twin(scene)
    found = {"jaxgrity, exact": by_jaxgrity(scene), "jaxgrity, penalty": by_jaxgrity(twin)}
    if (programs := hand_written.programs()) is not None:
        found["C, exact contact"] = by_c(programs / "exact64", scene, 2.5e-3)
        found["C, penalty contact"] = by_c(programs / "limit64", twin, 2e-4)
    if find_spec("mujoco") is not None and mujoco:
        found["MuJoCo"] = lambda phases, duration: mujoco_roll(twin, phases, duration, "RK4", 2e-4)[0]
    return found


def by_jaxgrity(scene: Scene) -> Ends:
    """In float64, at the scene's own step."""

    def ends(phases: np.ndarray, duration: float) -> np.ndarray:
        options = SolverOptions(dtype="float64")
        return np.asarray(simulate_population(scene, waves_at(scene.gait, phases), duration, options=options).com_end)

    return ends


def by_c(program: Path, scene: Scene, dt: float) -> Ends:
    """At a step of `dt`, s."""
    return lambda phases, duration: hand_written.roll(program, scene, phases, round(duration / dt), dt, threads=2)[0]


@third_opinions.table
def words(record: Record) -> str:
    """Speeds by program."""
    cells = {
        "gait": "`{gait}`",
        "program": lambda row: row["engine"].partition(" (")[0],
        f"speed of {record['robots']} robots, body lengths/s": "{mean:.3f}",
        "standard deviation": "{standard_deviation:.2g}",
        "median": "{median:.3f}",
        "slowest": "{slowest:.3f}",
    }
    return columns(record["rows"], cells)


@third_opinions.figure(3.6)
def figure(record: Record, chart: Figure) -> None:
    """The speed of each robot on each engine, a pane for each gait."""
    gaits = list(dict.fromkeys(row["gait"] for row in record["rows"]))
    for axes, gait in zip(chart.subplots(1, len(gaits), sharey=True, squeeze=False)[0], gaits):
        rows = [row for row in record["rows"] if row["gait"] == gait]
        for k, row in enumerate(rows):
            axes.plot(row["speeds"], k + 0.15 * np.linspace(-1, 1, len(row["speeds"])), "o", markersize=4)
        names = [row["engine"] for row in rows]
        axes.set(title=gait, yticks=range(len(rows)), yticklabels=names, xlim=(0, None))
        axes.set_xlabel("steady speed (body lengths/s)")
    axes.invert_yaxis()
