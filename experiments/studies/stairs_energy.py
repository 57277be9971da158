"""A block that falls down stairs, by smaller and smaller steps: what its energy audit misses, on both contact models.

The block's eight nodes land on treads, and pass from one face of the stairs to the next within a step, where the force
jumps: what the balance of energy misses there is an error of the step.
"""

from collections.abc import Iterator

import numpy as np
from measurements.measurement import Record, measurement
from measurements.pages import columns

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

STEPS = {"penalty": (1e-3, 5e-4, 2.5e-4, 1.25e-4), "exact": (4e-3, 2e-3, 1e-3, 5e-4)}
"""s, of each contact model"""


@measurement(page="terrain.md", quick={"steps": 2})
def stairs_energy(steps: int = 4) -> Iterator[Record]:
    """A row for each contact model and step.

    Args:
        steps: number of steps on each model, the largest ones of STEPS
    """
    for kind, dts in STEPS.items():
        for dt in dts[:steps]:
            yield audited(kind, dt)


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


def audited(kind: str, dt: float) -> dict:
    """What the audit of a rollout of 1 s misses, as a share of what it turns over."""
    audit = energy_audit(falling_block(kind), 1.0, options=SolverOptions(dt=dt), frame_rate=20.0)
    return {
        "contact": kind,
        "dt": dt,
        "missed": float(abs(audit.residual).max() / audit.turned_over),
        "turned_over": audit.turned_over,
    }


@stairs_energy.table
def words(record: Record) -> str:
    """What the audit missed, and of how much."""
    cells = {
        "contact": "{contact}",
        "step": lambda row: f"{1e3 * row['dt']:.3g} ms",
        "largest residual, share of the energy turned over": "{missed:.2%}",
        "energy turned over": "{turned_over:.2f} J",
    }
    return columns(record["rows"], cells)
