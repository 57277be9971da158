"""Gaits for steep slopes: each search begins with the gait found on the slope before, the first one with `uphill`.

Random gaits slide down steep slopes, so searches that begin with them end at gaits that stand still. What counts is the
displacement straight uphill, on robots that differ. Gaits are chosen on exact contact, and judged on both contact
models.
"""

import json
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from measurements.measurement import Figure, Record, measurement
from measurements.pages import columns

from jaxgrity import (
    Scene,
    SearchConfig,
    SteadyDirection,
    gait_facts,
    load_gait,
    parse_scene,
    scene_text,
    search_gaits,
    with_gait,
)
from jaxgrity.io.files import read_text
from jaxgrity.orbits import find_orbit
from jaxgrity.report import plot
from jaxgrity.search import EvaluationConfig, SearchSpace

UPHILL = np.pi
"""Heading straight up the slope of the scene `uphill`, rad from +x."""
CAUTION = 0.5
"""Standard deviations over robots that count against a gait: half as many as usual. Where few robots climb, gaits on
which no two robots differ are those that stand still."""
WATCHED = 300.0
"""Time for which an orbit is looked for, s."""
CLIMBS = 0.05
"""Speed uphill from which on a robot counts as climbing, body lengths/s."""


@measurement(
    page="gait_records.md",
    raw=("gaits",),
    drawn=("speeds",),
    quick={"slopes": (15.0,), "duration": 12.0, "population": 8, "generations": (1, 1)},
)
def steep(
    slopes: tuple[float, ...] = (17.5, 20.0, 21.0, 22.0, 23.0, 24.0, 25.0),
    duration: float = 60.0,
    population: int = 128,
    generations: tuple[int, int] = (40, 4),
    friction: float = 0.8,
    start: str = "uphill",
    earlier: Path | None = None,
) -> Iterator[Record]:
    """A row for each slope: how fast robots that differ climb, and the orbit of the robot as it is said.

    Args:
        slopes: degrees, in the order of the searches
        duration: of a rollout, s
        population: gaits per generation
        generations: of screening, and on the scene's own model
        friction: of the ground
        start: gait of the library with which the first search begins
        earlier: a record, whose rows come first and are not measured again
    """
    known = {"rows": [], "speeds": []} if earlier is None else json.loads(read_text(earlier))
    yield from ({"friction": known.get("friction")} | row for row in known["rows"])
    gait, gaits, speeds = load_gait(start), [], list(known["speeds"])
    for slope in slopes:
        scene = on_slope(slope, friction)
        config = SearchConfig(
            duration=duration,
            population=population,
            generations=generations,
            from_gait=True,
            space=SearchSpace(waves="none", amplitude=(0.05, 0.7), frequency=(0.2, 2.5), ramp=None),
            evaluation=EvaluationConfig(SteadyDirection(UPHILL), caution=CAUTION, both_models=False),
            polish=None,
        )
        found = search_gaits(with_gait(scene, gait), config)
        gait, summary = found.gait, found.verdict.summary()
        orbit = find_orbit(found.scene, WATCHED)
        x, y = orbit.velocity
        own, other = found.verdict.robust, found.verdict.other_model
        robots = {name: np.nan_to_num(scores.each[0]) for name, scores in (("own", own), ("other", other))}
        gaits.append(gait_facts(gait, scene.structure))
        speeds.append({name: np.sort(each).tolist() for name, each in robots.items()})
        yield {
            "slope": slope,
            "friction": friction,
            **{name: summary[name] for name in ("robust", "other_contact_model")},
            "climbing": {name: float(np.mean(each > CLIMBS)) for name, each in robots.items()},
            "settled": bool(orbit.settled),
            "uphill": -float(x) / orbit.body_length,
            "off": float(np.degrees(np.arctan2(abs(y), -x / np.cos(np.radians(slope))))),
        }
    return {"duration": duration, "gaits": gaits, "speeds": speeds}


def on_slope(slope: float, friction: float) -> Scene:
    """The scene `uphill` on another slope, degrees, with another coefficient of friction."""
    text = scene_text("uphill")
    for name, value in {"incline": float(np.radians(slope)), "mu": float(friction)}.items():
        text, count = re.subn(rf"(?m)^{name} = [0-9.]+", f"{name} = {value!r}", text)
        assert count == 1, f"the scene file says {name} once"
    return parse_scene(text)


@steep.table
def words(record: Record) -> str:
    """What was found on each slope."""
    cells = {
        "friction, slope": "{friction:g}, {slope:g}°",
        "perturbed robots: speed, body lengths/s": lambda row: _with_spread(row["robust"]),
        "of these climb": lambda row: f"{row['climbing']['own']:.0%}",
        "speed on penalty contact": lambda row: _with_spread(row["other_contact_model"]),
        "climb there": lambda row: f"{row['climbing']['other']:.0%}",
        "orbit: uphill": lambda row: f"{row['uphill']:.2f}" if row["settled"] else "none",
        "off the steepest way": lambda row: f"{row['off']:.0f}°" if row["settled"] else "-",
    }
    return columns(record["rows"], cells)


def _with_spread(robots: Record) -> str:
    return f"{robots['mean']:.2f} ({robots['standard_deviation']:.2g})"


@steep.figure(5.6)
def figure(record: Record, chart: Figure) -> None:
    """Of each slope's gait, how fast its robots climb: the share of robots that are as fast or slower."""
    frictions = list(dict.fromkeys(row["friction"] for row in record["rows"]))
    panes = chart.subplots(len(frictions), 2, sharey=True, sharex=True, squeeze=False)
    for friction, beside in zip(frictions, panes):
        gaits = [
            (row["slope"], speeds)
            for row, speeds in zip(record["rows"], record["speeds"], strict=True)
            if row["friction"] == friction
        ]
        for axes, name, title in zip(beside, ("own", "other"), ("exact contact", "penalty contact")):
            for (slope, speeds), marker in zip(gaits, plot.MARKERS):
                share = (np.arange(len(speeds[name])) + 0.5) / len(speeds[name])
                axes.plot(speeds[name], share, f"{marker}-", markevery=0.1, markersize=4, label=f"{slope:g}°")
            axes.axvline(0, color="black", linewidth=0.8)
            axes.set(title=f"friction {friction:g}, {title}")
        beside[0].set_ylabel("share of robots")
        beside[1].legend(title="slope", loc="center left", bbox_to_anchor=(1.02, 0.5))
    for axes in panes[-1]:
        axes.set_xlabel("speed (body lengths/s)")
