"""How fast predictive control is: choices of the controller beside the time that passes for the robot.

A robot is led to a goal behind it, at 10 choices a second, each from rollouts of 2 s. Compilation is left out: a first
journey compiles what the second, which is measured, runs again. The robot that is led is not counted as work of the
controller.
"""

from collections.abc import Iterator

import numpy as np
from measurements.driven import bounded, straight_on
from measurements.measurement import Figure, Record, measurement
from measurements.pages import columns

from jaxgrity import load_scene
from jaxgrity.control import Sampling, lead_to

GOAL = np.array([-12.0, 2.0])
"""m"""


@measurement(page="control.md", quick={"samples": (8,), "seconds": 1.0})
def predictive_speed(
    samples: tuple[int, ...] = (16, 64, 256), rate: float = 10.0, horizon: float = 2.0, seconds: float = 8.0
) -> Iterator[Record]:
    """A row for each number of samples.

    Args:
        samples: rollouts of the model for each choice
        rate: choices a second
        horizon: s, for which each sample is rolled out
        seconds: s, of the journey
    """
    plant, policy = bounded(load_scene("exact")), straight_on()
    for count in samples:
        sampling = Sampling(samples=count, horizon=horizon, interval=1 / rate, patience=seconds)
        lead_to(plant, plant, policy, GOAL, sampling=sampling._replace(patience=2 / rate))
        found = lead_to(plant, plant, policy, GOAL, sampling=sampling)
        yield {
            "samples": count,
            "real_time": found.real_time,
            "milliseconds": 1000 / rate / found.real_time,
            "slowest": 1000 * float(np.quantile(found.spent, 0.95)),
        }
    return {"rate": rate, "horizon": horizon}


@predictive_speed.table
def words(record: Record) -> str:
    """How long a choice takes, beside the time between two of them."""
    cells = {
        f"rollouts of {record['horizon']:g} s": "{samples}",
        "time of a choice, median": "{milliseconds:.0f} ms",
        "95th percentile": "{slowest:.0f} ms",
        f"times faster than real time, at {record['rate']:g} choices a second": "{real_time:.2g}",
    }
    return columns(record["rows"], cells)


@predictive_speed.figure(4)
def figure(record: Record, chart: Figure) -> None:
    """How much faster than the robot the controller is, against the samples of a choice."""
    rows = record["rows"]
    axes = chart.subplots()
    axes.loglog([row["samples"] for row in rows], [row["real_time"] for row in rows], "o-", base=2)
    axes.axhline(1.0, color="black", linewidth=0.8, linestyle=":")
    axes.annotate("real time", (rows[0]["samples"], 1.0), textcoords="offset points", xytext=(0, 4))
    axes.set(xlabel="rollouts for each choice", ylabel="speed (times real time)", ylim=(0.8, 20))
    axes.set_xticks([row["samples"] for row in rows], [f"{row['samples']}" for row in rows])
    axes.yaxis.set_major_formatter("{x:g}")
