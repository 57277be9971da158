"""Which samples lead a robot to a goal soonest: drawn at random, or in rounds about the best; one bend, or several.

The trials are those of goals.py across a slope, where the robot is not the model. All ways cost as many rollouts.
"""

from collections.abc import Iterator
from itertools import product

import numpy as np
from measurements import goals
from measurements.driven import straight_on
from measurements.measurement import Figure, Record, measurement
from measurements.pages import columns

from jaxgrity.control import Sampling, lead_to

WAYS = {"at random": {"rounds": 1}, "two rounds": {"rounds": 2}, "four rounds": {"rounds": 4}}
"""how samples are drawn"""


@measurement(page="control.md", quick={"trials": 1, "patience": 2.0, "twin": False}, drawn=("seconds",))
def sampling_ways(
    trials: int = 20,
    samples: int = 64,
    knots: tuple[int, ...] = (1, 3),
    patience: float = 60.0,
    twin: bool = True,
    seed: int = 100,
) -> Iterator[Record]:
    """A row for each way to draw samples.

    Args:
        trials: of each way
        samples: rollouts of the model for each choice
        knots: bends over the horizon
        patience: s, after which a trial has failed
        twin: whether the robot is the contact twin, and not the model itself
        seed: of starts, friction and samples
    """
    policy = straight_on()
    for name, count in product(WAYS, knots):
        sampling = Sampling(samples=samples, knots=count, patience=patience, **WAYS[name])
        led = [
            lead_to(t.robot, t.model, policy, goals.GOAL, start=t.start, sampling=sampling._replace(seed=number))
            for number, t in enumerate(goals.drawn_trials("slope", trials, twin, seed))
        ]
        seconds = [each.seconds for each in led]
        yield {
            "way": name,
            "knots": count,
            "reached": sum(each.reached for each in led),
            "milliseconds": float(np.median([1000 * sampling.interval / each.real_time for each in led])),
            "mean": float(np.mean(seconds)),
            "deviation": float(np.std(seconds, ddof=1)) if len(seconds) > 1 else 0.0,
            "seconds": seconds,
        }
    return {"trials": trials, "samples": samples, "patience": patience}


@sampling_ways.table
def words(record: Record) -> str:
    """How soon each way of drawing samples leads to the goal."""
    cells = {
        f"{record['samples']} rollouts for each choice": written,
        "reached": lambda row: f"{row['reached']} of {record['trials']}",
        "time (standard deviation)": "{mean:.1f} ({deviation:.1f}) s",
        "a choice takes": "{milliseconds:.0f} ms",
    }
    return columns(record["rows"], cells)


def written(row: Record) -> str:
    """A way of drawing samples in words."""
    return f"{row['way']}, {row['knots']} bend{'s' * (row['knots'] > 1)}"


@sampling_ways.figure()
def figure(record: Record, chart: Figure) -> None:
    """Times of all trials for each way."""
    rows = record["rows"]
    chart.set_figheight(0.45 * len(rows) + 1.4)
    axes = chart.subplots()
    for place, row in enumerate(rows):
        seconds, named = np.array(row["seconds"]), ("a trial", "mean of the trials") if place == 0 else (None, None)
        axes.plot(seconds, place + 0 * seconds, "o", color="C0", markersize=5, alpha=0.5, label=named[0])
        axes.plot(seconds.mean(), place, "|", color="black", markersize=16, markeredgewidth=2, label=named[1])
    axes.set_yticks(range(len(rows)), [written(row) for row in rows])
    axes.set(xlabel="time to the goal (s)")
    axes.invert_yaxis()
    chart.legend(loc="outside upper center", ncols=2)
