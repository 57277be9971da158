"""How often the ranges that searches print cover what is true: the same gaits judged again and again, by other robots.

Two gaits of the library meet the same ensembles of robots that differ, once for each of many seeds, on both contact
models. What all robots together say counts as true. Ranges are two standard errors to both sides, and should cover it
in 19 of 20 cases. Speeds of robots along their paths, as records have them, are drawn again too, and the multipliers of
orbits, by other disturbances: their range is the largest difference from three more draws.
"""

from collections.abc import Iterator

import jax
import numpy as np
from measurements.measurement import Figure, Record, measurement
from measurements.pages import table
from tqdm import tqdm

from jaxgrity import (
    Fitness,
    Gait,
    Scene,
    SolverOptions,
    SteadySpeed,
    contact_twin,
    gaits_of,
    load_gait,
    load_scene,
    with_gait,
)
from jaxgrity.orbits import find_orbit, stability
from jaxgrity.report import plot
from jaxgrity.search import EvaluationConfig, Judging, influences, judge, model_of, robot_motions, standard_error

COVERING = 2.0
"""standard errors in a range"""
CAUTION = 1.0
"""standard deviations that the fitness holds against a gait, as in a default search"""
DISTURBED = 4
"""draws of disturbances from which a multiplier has its range, as in `orbit_error_bars`"""
WATCHED = 120.0
"""s, for an orbit"""
GAIN = "gain from the first to the second"
"""name in the record of the second gait's fitness less the first one's"""


Redrawn = tuple[np.ndarray, np.ndarray, float]
"""of each draw the value, and half of the width of its range, and what is true"""


@measurement(
    page="search_records.md",
    quick={"draws": 4, "robots": 8, "duration": 8.0, "contacts": ("exact",)},
    drawn=("off",),
)
def redraws(
    gaits: tuple[str, str] = ("straight", "lasting"),
    draws: int = 60,
    robots: int = 128,
    duration: float = 30.0,
    contacts: tuple[str, ...] = ("exact", "penalty"),
) -> Iterator[Record]:
    """A row for each statistic on each contact model.

    Args:
        gaits: names of two of the library's gaits, whose members are the same
        draws: ensembles
        robots: in each of them
        duration: s
        contacts: contact models
    """
    pair = [load_gait(name) for name in gaits]
    own = [with_gait(load_scene("exact"), gait) for gait in pair]
    for contact in contacts:
        scenes = own if contact == "exact" else [contact_twin(scene) for scene in own]
        found = statistics(judged(scenes[0], pair_of(pair), draws, robots, duration), gaits)
        for name, scene in zip(gaits, scenes):
            found[f"speed of {name} along its path"] = along_its_path(scene, draws, robots, duration)
            found[f"Floquet multiplier of {name}"] = multipliers(scene, draws)
        for statistic, (values, ranges, true) in found.items():
            off = (values - true) / ranges
            covered = float(np.mean(np.abs(off) <= 1))
            yield {"statistic": statistic, "contact": contact, "covered": covered, "off": off}
    return {"draws": draws, "robots": robots}


def pair_of(gaits: list[Gait]) -> Gait:
    """Both as one population, which has the start and the ramp of the first."""
    amplitude, frequency = (
        np.stack([np.asarray(getattr(g, name)) for g in gaits]) for name in ("amplitude", "frequency")
    )
    return gaits_of(gaits[0], np.stack([np.asarray(g.phase) for g in gaits]), amplitude, frequency)


def judged(scene: Scene, pair: Gait, draws: int, robots: int, duration: float) -> np.ndarray:
    """(draws, gaits, robots), steady speeds, body lengths/s."""
    fitness = Fitness(SteadySpeed(), EvaluationConfig().uncertainty, robots, CAUTION)
    seeds = tqdm(range(draws), unit="ensemble", leave=False)
    model = model_of(scene, duration, SolverOptions(dtype="float32"))
    judging = Judging((model,), duration, fitness)
    return np.array([judge(jax.random.key(seed), judging, pair).each for seed in seeds])


def along_its_path(scene: Scene, draws: int, robots: int, duration: float) -> Redrawn:
    """The mean that records and `robot_motions` have, of each draw, with its range, and what all robots say; m/s."""
    uncertainty = EvaluationConfig().uncertainty
    asked = {"robots": robots, "duration": duration, "options": SolverOptions(dtype="float32")}
    seeds = tqdm(range(draws), desc="along its path", unit="ensemble", leave=False)
    found = [robot_motions(scene, uncertainty, seed=seed, **asked).summary() for seed in seeds]
    speed, error = (np.array([each[name] for each in found], float) for name in ("speed", "standard_error"))
    return speed, COVERING * error, float(speed.mean())


def multipliers(scene: Scene, draws: int) -> Redrawn:
    """The largest multiplier per cycle, of each draw, with its range, and the mean of all."""
    orbit, seeds = find_orbit(scene, WATCHED), tqdm(range(DISTURBED * draws), desc="multiplier", leave=False)
    found = np.array([stability(scene, orbit, seed=seed).largest for seed in seeds]).reshape(draws, DISTURBED)
    return found[:, 0], np.abs(found[:, 1:] - found[:, :1]).max(1), float(found.mean())


def statistics(each: np.ndarray, gaits: tuple[str, str]) -> dict[str, Redrawn]:
    """Of each draw the value and its range, and what all robots say."""
    every = each.swapaxes(0, 1).reshape(2, -1)
    pooled = fitness_of(every)
    found: dict[str, Redrawn] = {}
    for k, name in enumerate(gaits):
        ranges = np.array([COVERING * standard_error(one[k]) for one in each])
        found[f"mean speed of {name}"] = each[:, k].mean(1), ranges, float(every[k].mean())
        ranges = np.array([COVERING * standard_error(influences(one, CAUTION)[k]) for one in each])
        values = np.array([fitness_of(one)[k] for one in each])
        found[f"fitness of {name}"] = values, ranges, float(pooled[k])
    ranges = np.array([COVERING * standard_error(np.subtract(*influences(one, CAUTION)[::-1])) for one in each])
    values = np.array([np.subtract(*fitness_of(one)[::-1]) for one in each])
    found[GAIN] = values, ranges, float(np.subtract(*pooled[::-1]))
    return found


def fitness_of(each: np.ndarray) -> np.ndarray:
    """(gaits,), mean less caution times standard deviation over (gaits, robots)."""
    return each.mean(1) - CAUTION * each.std(1)


@redraws.table
def words(record: Record) -> str:
    """How many of the ranges cover the truth, by statistic and contact model; 95 % should."""
    covered: dict[str, dict[str, float]] = {}
    for row in record["rows"]:
        covered.setdefault(row["statistic"], {})[row["contact"]] = row["covered"]
    contacts = list(dict.fromkeys(row["contact"] for row in record["rows"]))
    told = lambda share: "-" if share is None else f"{100 * share:.0f} %"  # noqa: E731
    written = said(record["rows"])
    head = ["± of", "should contain the true value", *(f"contains it, {c} contact" for c in contacts)]
    rows = [[written[name], "95 %", *(told(shares.get(c)) for c in contacts)] for name, shares in covered.items()]
    return table(head, rows)


def said(rows: list[Record]) -> dict[str, str]:
    """The statistics in words, by their names."""
    names = list(dict.fromkeys(row["statistic"] for row in rows))
    first, second = (name for name in names if name.startswith("fitness of "))
    return {name: name for name in names} | {GAIN: f"{second} less that of {first.removeprefix('fitness of ')}"}


@redraws.figure()
def figure(record: Record, chart: Figure) -> None:
    """By how much each draw is off, in ranges: within -1 and 1 a range covers."""
    written = said(record["rows"])
    names, contacts = (list(dict.fromkeys(row[key] for row in record["rows"])) for key in ("statistic", "contact"))
    chart.set_figheight(0.55 * len(names) + 1.2)
    axes = chart.subplots()
    axes.axvspan(-1, 1, color=plot.GROUND, alpha=0.5, lw=0, label="± covers the error")
    for k, (contact, marker) in enumerate(zip(contacts, plot.MARKERS)):
        own = {row["statistic"]: np.asarray(row["off"], float) for row in record["rows"] if row["contact"] == contact}
        place = np.concatenate([np.full(off.shape, names.index(name) + 0.3 * (k - 0.5)) for name, off in own.items()])
        off = np.concatenate(list(own.values()))
        axes.plot(off, place, marker, color=f"C{k}", alpha=0.4, markersize=4, label=f"{contact} contact")
    axes.set(
        yticks=range(len(names)),
        yticklabels=[written[name] for name in names],
        xlabel="error of each ensemble, in multiples of its ±",
    )
    axes.invert_yaxis()
    chart.legend(loc="outside upper center", ncols=3)
