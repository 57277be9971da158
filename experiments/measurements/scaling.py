"""How cost grows: with the number of devices, of gaits and of struts; what one rollout costs, and what starting does.

Every part runs in processes of its own, which may use as many cores as they have devices; with --quick all parts for as
many devices share one.
"""

import contextlib
import functools
import os
from functools import partial

import numpy as np
from measurements import limit as hand_written
from measurements.measurement import Figure, Record, measurement
from measurements.pages import table
from measurements.scaling_costs import (
    METHODS,
    cost_in_c,
    exponents,
    in_process,
    population_cost,
    process,
    single_cost,
    start_up,
    tower_cost,
)
from tqdm import tqdm

from jaxgrity.report import plot

LARGEST = 1024
"""Gaits at most with which numbers of devices are compared."""
SEARCHED = 256
"""Population between the smallest and the largest that is quoted too."""
PARTS = ("devices", "population", "struts", "single", "C")
DRAWN = ("population", "struts")
"""parts that the figure shows"""


@measurement(
    page="scaling.md",
    quick={"methods": ("complementarity",), "sizes": (16,), "struts": (6, 12), "repeats": 1, "shared": True},
    raw=tuple(part for part in PARTS if part not in DRAWN),
    drawn=DRAWN,
)
def scaling(
    methods: tuple[str, ...] = tuple(METHODS),
    sizes: tuple[int, ...] = (64, 128, 256, 1024, 4096),
    struts: tuple[int, ...] = (6, 18, 60, 180, 600),
    repeats: int = 5,
    shared: bool = False,
) -> Record:
    """All parts, and what the pages quote of them.

    Args:
        methods: names of those that are measured
        sizes: gaits of populations
        struts: of towers
        repeats: timed calls, of which the median counts, after one that compiles
        shared: all parts for as many devices share a process, and nothing is warmed up
    """
    cores, most = len(os.sched_getaffinity(0)), min(LARGEST, sizes[-1])
    tasks: list[tuple] = [("devices", d, population_cost, (m, most, repeats)) for m in methods for d in (1, cores)]
    tasks += [("population", cores, population_cost, (m, n, repeats)) for m in methods for n in sizes]
    tasks += [("struts", cores, tower_cost, (m, n, repeats)) for m in methods for n in struts]
    tasks += [("single", 1, single_cost, (m, dtype, repeats)) for m in methods for dtype in ("float32", "float64")]
    if (folder := hand_written.programs()) is not None:
        tasks += [("C", 1, cost_in_c, (folder, m, most, 1, repeats)) for m in methods]
        tasks += [("C", cores, cost_in_c, (folder, m, n, cores, repeats)) for m in methods for n in sizes]
    parts: dict[str, list[Record]] = {part: [] for part in PARTS}
    with contextlib.ExitStack() as running:
        pools = functools.cache(lambda devices: running.enter_context(process(devices)))
        for name, devices, function, arguments in tqdm(tasks, unit="run"):
            found = pools(devices).apply(function, arguments) if shared else in_process(devices, function, arguments)
            parts[name].append({"devices": devices, **found})
    start = start_up(min(3, repeats), warm=not shared)
    return {"methods": quoted(parts), "start": start, **parts}


def quoted(parts: dict[str, list[Record]]) -> list[Record]:
    """Of each method what the table has of it."""
    rows = []
    for method, exponent in exponents(parts["struts"]).items():
        mine = {name: [row for row in parts[name] if row["method"] == method] for name in PARTS}
        one, several = mine["devices"]
        struts, sizes = mine["struts"], mine["population"]
        told = {row["gaits"]: row for row in (sizes[0], *(row for row in sizes if row["gaits"] == SEARCHED), sizes[-1])}
        rows.append(
            {
                "method": method,
                "devices": several["devices"],
                "speed_up": one["seconds"] / several["seconds"],
                "populations": list(told),
                "per_gait_and_simulated_second": [row["per_gait_and_simulated_second"] for row in told.values()],
                "struts": [struts[0]["struts"], struts[-1]["struts"]],
                "per_gait_and_step": [struts[0]["per_gait_and_step"], struts[-1]["per_gait_and_step"]],
                "exponent": exponent,
                "times_real_time": [row["times_real_time"] for row in mine["single"]],
                "in_C": in_c(mine["C"], list(told)) if mine["C"] else None,
            }
        )
    return rows


def in_c(mine: list[Record], sizes: list[int]) -> Record:
    """Of the C program that does the same as a method: its speed-up, and its cost in populations of the sizes."""
    cost = {(row["devices"], row["gaits"]): row["per_gait_and_simulated_second"] for row in mine}
    several = max(threads for threads, _ in cost)
    shared = next(gaits for threads, gaits in cost if threads == 1)
    return {
        "speed_up": cost[1, shared] / cost[several, shared],
        "per_gait_and_simulated_second": [cost[several, size] for size in sizes],
    }


def microseconds(seconds: float) -> str:
    return f"{1e6 * seconds:.0f}"


@scaling.table
def words(record: Record) -> str:
    """What populations cost by each method, and by the C program that does the same; then structures, and one robot."""
    known = [(row["method"], row) for row in record["methods"]]
    known += [(f"hand-written C, as {name}", row["in_C"]) for name, row in known if row["in_C"]]
    first = record["methods"][0]
    populations = [
        [name, f"{row['speed_up']:.2f}", *map(microseconds, row["per_gait_and_simulated_second"])]
        for name, row in known
    ]
    others = [
        [
            row["method"],
            *(f"{1e6 * cost:.2g}" for cost in row["per_gait_and_step"]),
            f"{row['exponent']:.2f}",
            *(f"{times:.0f}" for times in row["times_real_time"]),
        ]
        for row in record["methods"]
    ]
    by_size = table(
        ["method", f"speedup by {first['devices']} devices"] + [f"{size} gaits, µs" for size in first["populations"]],
        populations,
    )
    by_struts = table(
        ["method", *(f"step, {struts} struts, µs" for struts in first["struts"]), "exponent p"]
        + [f"{dtype}, times real time" for dtype in ("float32", "float64")],
        others,
    )
    return f"{by_size}\n\n{by_struts}"


@partial(scaling.table, part="million")
def million(record: Record) -> str:
    """What a search of 10^6 gaits costs, by arithmetic on the largest population."""
    rows = []
    for row in record["methods"]:
        cost = row["per_gait_and_simulated_second"][-1]
        rows.append([row["method"], microseconds(cost), f"{1e6 * 10 * cost / 60:.0f} minutes"])
    head = ["float32", "µs per gait and simulated second", f"10^6 rollouts of 10 s on {record['cores']} cores"]
    return table(head, rows)


@partial(scaling.table, part="start", page="performance.md")
def starting(record: Record) -> str:
    """What a user waits for."""
    start = record["start"]
    rows = [
        ["JAX and diffrax imported", f"{start['jax and diffrax']:.2f}"],
        ["jaxgrity imported too", f"{start['jaxgrity']:.2f}"],
        ["a scene simulated, programs kept", f"{start['first steps']:.1f}"],
        ["a scene simulated, nothing compiled before", f"{start['first steps, cold']:.1f}"],
    ]
    return table(["since the start of a script", "s"], rows)


@scaling.figure(4.6)
def figure(record: Record, chart: Figure) -> None:
    """Cost per gait against the size of the population, and cost per step against the number of struts."""
    left, right = chart.subplots(1, 2)
    for method, marker in zip(dict.fromkeys(row["method"] for row in record["population"]), plot.MARKERS):
        ours = [row for row in record["population"] if row["method"] == method]
        x, y = ([row[key] for row in ours] for key in ("gaits", "per_gait_and_simulated_second"))
        left.loglog(x, 1e6 * np.array(y), f"{marker}-", label=method)
        ours = [row for row in record["struts"] if row["method"] == method]
        x, y = ([row[key] for row in ours] for key in ("struts", "per_gait_and_step"))
        line = right.loglog(x, 1e6 * np.array(y), f"{marker}-")[0]
        right.loglog(x, 1e6 * y[0] * np.array(x) / x[0], ":", color=line.get_color(), lw=1)
    right.plot([], [], ":", color="black", lw=1, label="proportional to the struts")
    left.set(xlabel="gaits", ylabel="µs per gait and simulated second", title="size of the population")
    right.set(xlabel="struts", ylabel="µs per gait and step", title="size of the structure")
    chart.legend(loc="outside lower center", ncols=3)
