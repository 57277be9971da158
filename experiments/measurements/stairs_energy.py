"""A block that falls down stairs, by smaller and smaller steps: what its energy audit misses, on both contact models.

The block's eight nodes land on treads, and pass from one face of the stairs to the next within a step, where the force
jumps: what the balance of energy misses there is an error of the step.
"""

from dataclasses import dataclass
from pathlib import Path

from jaxgrity.cli.script import measured, run

import numpy as np
from tqdm import tqdm

from jaxgrity import (
    ConeFriction,
    ExactGround,
    Members,
    PenaltyGround,
    Scene,
    SmoothFriction,
    SolverOptions,
    Stairs,
    Structure,
    edge_lengths,
    energy_audit,
)
from jaxgrity.io.files import save_json

STEPS = {"penalty": (1e-3, 5e-4, 2.5e-4, 1.25e-4), "exact": (4e-3, 2e-3, 1e-3, 5e-4)}
"""s, of each contact model"""


@dataclass
class Settings:
    duration: float = 1.0
    """s"""
    out: Path = Path("results/stairs_energy")
    """folder for stairs_energy.json"""
    quick: bool = False
    """two steps of each model"""


def falling_block(kind: str) -> Scene:
    """A cube of 0.2 m and 2 kg, its eight nodes joined by 28 springs, over the edge of a stair."""
    nodes = 0.1 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    edges = tuple((i, j) for i in range(8) for j in range(i))
    struts = Members(edges, np.full(28, 5e3), edge_lengths(nodes, edges), np.full(28, 5.0))
    body = Structure(nodes + np.array([0.05, 0.0, 0.25]), np.full(8, 0.25), struts)
    stairs = Stairs(0.1, 0.3, 3, start=0.0, rounding=0.005)
    if kind == "exact":
        return Scene(body, 9.81, np.full(8, 0.2), ExactGround(surface=stairs), ConeFriction(0.6))
    return Scene(body, 9.81, np.full(8, 0.2), PenaltyGround(1e4, 2.0, surface=stairs), SmoothFriction(0.6, 0.01))


def audited(kind: str, dt: float, duration: float) -> dict:
    """What the audit of one rollout misses, as a share of what it turns over."""
    audit = energy_audit(falling_block(kind), duration, options=SolverOptions(dt=dt), frame_rate=20.0)
    return {
        "contact": kind,
        "dt": dt,
        "missed": float(abs(audit.residual).max() / audit.turned_over),
        "turned_over": audit.turned_over,
        "height_at_end": float(audit.positions[-1, :, 2].mean()),
    }


def main(settings: Settings) -> None:
    cases = [(kind, dt) for kind, steps in STEPS.items() for dt in (steps[:2] if settings.quick else steps)]
    rows = [audited(kind, dt, settings.duration) for kind, dt in tqdm(cases, desc="rollouts")]
    save_json(settings.out / "stairs_energy.json", measured() | {"duration": settings.duration, "rows": rows})
    for row in rows:
        print(f"{row['contact']:<8} {1e3 * row['dt']:.3g} ms: {row['missed']:.2%} of {row['turned_over']:.3g} J")


if __name__ == "__main__":
    run(main, Settings)
