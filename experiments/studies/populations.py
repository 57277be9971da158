"""What a gait costs in populations of 256 up to a million, by both contact models in both precisions.

It measures the devices that JAX finds: a GPU where there is one; `JAX_PLATFORMS=cpu` takes the cores. Each row is saved
as soon as it is measured, and --beside FILE shows the rows of another machine next to these.
"""

import json
from collections.abc import Generator
from itertools import product
from pathlib import Path

from jaxgrity.cli.script import command_header

import jax
import numpy as np
from measurements.engines import clock
from measurements.measurement import Figure, Record, measurement
from measurements.pages import table
from measurements.scaling_costs import METHODS

from jaxgrity import SolverOptions, gaits_of, load_scene, random_phases, simulate_population
from jaxgrity.io.files import read_text

DURATION = 0.5
"""s, that populations are rolled out for"""
SIZES = [4**k for k in range(4, 11)]
COMPARED = 256
"""gaits whose places at the end are kept: every population begins with them, on every machine"""


@measurement(
    page="scaling.md",
    quick={"largest": SIZES[0], "methods": ("complementarity",)},
    raw=("rows", "ends", "device", "jax"),
)
def populations(
    largest: int = SIZES[-1], methods: tuple[str, ...] = tuple(METHODS), beside: Path | None = None
) -> Generator[Record, None, Record]:
    """A row for each size, method and precision; then both machines.

    Args:
        largest: gaits in the largest population
        methods: methods
        beside: populations.json of another machine
    """
    device, rows, ends = jax.devices()[0], [], {}
    sizes = [size for size in SIZES if size <= largest]
    for gaits, method, dtype in product(sizes, methods, ("float32", "float64")):
        row, end = cost(method, dtype, gaits)
        rows.append(row)
        ends.setdefault(f"{method} {dtype}", end.tolist())
        yield row
    name = device.device_kind if device.platform != "cpu" else f"{len(jax.devices())} cores"
    own = {"device": name, "jax": jax.__version__, "ends": ends}
    machines = [command_header() | own | {"rows": rows}]
    if beside is not None:
        machines.append(json.loads(read_text(beside)))
    other = machines[-1]["ends"]
    # on other machines populations may be smaller
    apart = {key: float(np.abs(np.subtract(x, other[key])).max()) for key, x in ends.items() if key in other}
    kept = [{key: each[key] for key in ("device", "jax", "command", "rows")} for each in machines]
    return own | {"machines": kept, "apart": apart}


def cost(method: str, dtype: str, gaits: int) -> tuple[dict, np.ndarray]:
    """Of one call, the fastest of up to three after one that compiles; and where the first robots end, m."""
    name, dt = METHODS[method]
    scene = load_scene(name)
    phases = np.concatenate([random_phases(COMPARED, 6, seed=0), random_phases(gaits, 6, seed=1)])[:gaits]
    rows, options = gaits_of(scene.gait, phases), SolverOptions(method=method, dt=dt, dtype=dtype, any_step=True)
    seconds: list[float] = []
    while len(seconds) < 2 or (len(seconds) < 4 and sum(seconds[1:]) < 4.0):
        spent, found = clock(lambda: simulate_population(scene, rows, DURATION, options=options))
        seconds.append(spent)
    facts = {
        "method": method,
        "dtype": dtype,
        "gaits": gaits,
        "per_gait_and_simulated_second": min(seconds[1:]) / gaits / DURATION,
    }
    return facts, np.asarray(found.com_end[:COMPARED], float)


@populations.table
def words(record: Record) -> str:
    """Costs of each machine, a line for each method and precision."""
    here, there = record["machines"][0], record["machines"][-1]
    sizes = list(dict.fromkeys(row["gaits"] for row in there["rows"]))[::2]
    rows = []
    for method, dtype in dict.fromkeys((row["method"], row["dtype"]) for row in there["rows"]):
        for machine in record["machines"]:
            cost_of = {
                row["gaits"]: row["per_gait_and_simulated_second"]
                for row in machine["rows"]
                if (row["method"], row["dtype"]) == (method, dtype)
            }
            device = f"{machine['device']}, JAX {machine['jax']}"
            costs = (f"{1e6 * cost_of[size]:.3g}" if size in cost_of else "-" for size in sizes)
            apart = "-" if machine is here else f"{1e3 * record['apart'][f'{method} {dtype}']:.1g}"
            rows.append([f"{method}, {dtype}", device, *costs, apart])
    head = ["method", "device", *(f"{size:,} gaits, µs" for size in sizes), "distance of ends, mm"]
    return table(head, rows)


@populations.figure(4)
def figure(record: Record, chart: Figure) -> None:
    """Cost per gait and simulated second against the size of the population; dashed: the other machine's."""
    for axes, method in zip(chart.subplots(1, 2, sharey=True, squeeze=False)[0], METHODS):
        for style, machine in zip(("o-", "s--"), record["machines"]):
            for colour, dtype in zip(("C0", "C1"), ("float32", "float64")):
                rows = [r for r in machine["rows"] if (r["method"], r["dtype"]) == (method, dtype)]
                each = 1e6 * np.array([row["per_gait_and_simulated_second"] for row in rows])
                label = f"{dtype}, {machine['device']}"
                axes.loglog([row["gaits"] for row in rows], each, style, color=colour, label=label)
        axes.set(xlabel="gaits", title=method)
    chart.legend(*chart.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    chart.axes[0].set_ylabel("µs per gait and simulated second")
