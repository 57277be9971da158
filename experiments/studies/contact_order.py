"""Where complementarity stepping loses its second order on rolling robots: one cause at a time is taken away.

Each row changes the scene `exact` in one way. Both methods take the same gaits at three steps. An error is the distance
of the centres of mass at the end from those of the same method at the finest step.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace

import equinox as eqx
import numpy as np
from measurements.measurement import Record, measurement
from measurements.pages import columns, short
from tqdm import tqdm

from jaxgrity import Scene, SolverOptions, gaits_of, load_scene, random_phases, simulate_population

STEPS = (1e-2, 5e-3, 2.5e-3)
"""s"""
FINEST = STEPS[0] / 64
"""s"""
METHODS = ("complementarity", "complementarity2")
"""by number: the plain method, and the one with landings at their own time"""


def _with(where: Callable, value: float | np.ndarray) -> Callable[[Scene], Scene]:
    return lambda scene: eqx.tree_at(where, scene, np.asarray(value, float))


CHANGES: dict[str, Callable[[Scene], Scene]] = {
    "as it is": lambda scene: scene,
    "no friction": lambda scene: replace(scene, friction=None),
    "mu 0.05": _with(lambda scene: scene.friction.mu, 0.05),
    "mu 0.95": _with(lambda scene: scene.friction.mu, 0.95),
    "cables without damping": lambda scene: eqx.tree_at(
        lambda s: s.structure.cables.damping, scene, 0 * scene.structure.cables.damping
    ),
    "cables 30 % shorter": lambda scene: eqx.tree_at(
        lambda s: s.structure.cables.rest_length, scene, 0.7 * scene.structure.cables.rest_length
    ),
    "half the amplitude": lambda scene: eqx.tree_at(lambda s: s.gait.amplitude, scene, scene.gait.amplitude / 2),
    "the gait starts in the air": _with(lambda scene: scene.gait.start, 0.0),
}
"""What is taken away."""


@measurement(page="accuracy.md", quick={"gaits": 4, "duration": 1.2})
def contact_order(gaits: int = 64, duration: float = 4.0, seed: int = 0) -> Iterator[Record]:
    """A row for each change.

    Args:
        gaits: random gaits
        duration: of the rollouts, s
        seed: of the gaits
    """
    for name, change in tqdm(CHANGES.items(), desc="changes", unit="change"):
        scene = change(load_scene("exact"))
        row: Record = {"change": name}
        for number, method in enumerate(METHODS, 1):
            *coarse, finest = (_ends(scene, method, dt, gaits, duration, seed) for dt in (*STEPS, FINEST))
            errors = [np.nanmedian(np.linalg.norm(ends - finest, axis=1)) for ends in coarse]
            row[f"errors_{number}"] = [float(f"{error:.3g}") for error in errors]
        yield row


def _ends(scene: Scene, method: str, dt: float, gaits: int, duration: float, seed: int) -> np.ndarray:
    """m, (gaits, 3): the centres of mass at the end."""
    phases = random_phases(gaits, len(scene.gait.members), seed=seed)
    options = SolverOptions(method=method, dt=dt, dtype="float64", any_step=True)
    return np.asarray(simulate_population(scene, gaits_of(scene.gait, phases), duration, options=options).com_end)


@contact_order.table
def words(record: Record) -> str:
    """Median errors of both methods at each step, and what the second gains."""

    def errors(number: int) -> Callable[[Record], str]:
        return lambda row: ", ".join(short(1e3 * error) for error in row[f"errors_{number}"])

    cells = {
        "scene": "{change}",
        "plain, mm": errors(1),
        "complementarity2, mm": errors(2),
        "ratio at 5 ms": lambda row: f"{row['errors_1'][1] / row['errors_2'][1]:.1f}",
    }
    return columns(record["rows"], cells)
