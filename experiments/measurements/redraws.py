"""How often the ranges that searches print cover what is true: the same gaits judged again and again, by other robots.

Two gaits of the library meet the same ensembles of robots that differ, once for each of many seeds, on both contact
models. What all robots together say counts as true. Ranges are two standard errors to both sides, and should cover it
in 19 of 20 cases. On exact contact the speeds of robots along their paths, as records have them, are drawn again too.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from jaxgrity.cli.script import measured, run

import jax
import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from jaxgrity import (
    Fitness,
    Gait,
    InputError,
    Scene,
    SearchConfig,
    SolverOptions,
    SteadySpeed,
    contact_twin,
    gait_names,
    gaits_of,
    load_gait,
    load_scene,
    with_gait,
)
from jaxgrity.io.files import save_json
from jaxgrity.report import plot
from jaxgrity.search import Level, influences, judge, model_of, robot_motions, standard_error

COVERING = 2.0
"""standard errors in a range"""
CAUTION = 1.0
"""standard deviations that the fitness holds against a gait, as in a default search"""


@dataclass
class Settings:
    gaits: tuple[str, str] = ("straight", "lasting")
    """names of two of the library's gaits, whose members are the same"""
    draws: int = 60
    """ensembles"""
    robots: int = 128
    """in each of them"""
    duration: float = 30.0
    """s"""
    contacts: tuple[Literal["exact", "penalty"], ...] = ("exact", "penalty")
    """contact models"""
    out: Path = Path("results/redraws")
    """folder for redraws.json and its figure"""
    quick: bool = False
    """4 ensembles of 8 robots for 8 s, with exact contact alone"""


def main(settings: Settings) -> None:
    if settings.quick:
        settings.draws, settings.robots, settings.duration, settings.contacts = 4, 8, 8.0, ("exact",)
    unknown = sorted(set(settings.gaits) - set(gait_names()))
    if unknown:
        raise InputError(f"gaits = {unknown}: unknown; expected some of {', '.join(gait_names())}")
    own = with_gait(load_scene("exact"), load_gait(settings.gaits[0]))
    pair = pair_of([load_gait(name) for name in settings.gaits])
    rows, errors = [], {}
    for contact in settings.contacts:
        scene = own if contact == "exact" else contact_twin(own)
        found = statistics(judged(scene, pair, settings, contact), settings.gaits)
        if contact == "exact":
            found |= {f"speed of {name} along its path": along_its_path(name, settings) for name in settings.gaits}
        for statistic, (values, ranges, true) in found.items():
            off = (values - true) / ranges
            rows.append({"statistic": statistic, "contact": contact, "covered": float(np.mean(np.abs(off) <= 1))})
            errors[f"{statistic}, {contact}"] = off
    facts = {"draws": settings.draws, "robots": settings.robots, "duration": settings.duration, "rows": rows}
    save_json(settings.out / "redraws.json", {**measured(), **facts})
    plot.save(figure(errors), settings.out / "redraws.png")
    print("\n".join(f"{row['statistic']}, {row['contact']}: {row['covered']:.0%} of ranges cover" for row in rows))
    print(f"wrote {settings.out}/")


def pair_of(gaits: list[Gait]) -> Gait:
    """Both as one population."""
    amplitude, frequency = (
        np.stack([np.asarray(getattr(g, name)) for g in gaits]) for name in ("amplitude", "frequency")
    )
    return gaits_of(gaits[0], np.stack([np.asarray(g.phase) for g in gaits]), amplitude, frequency)


def judged(scene: Scene, pair: Gait, settings: Settings, contact: str) -> np.ndarray:
    """(draws, gaits, robots), steady speeds, body lengths/s."""
    fitness = Fitness(SteadySpeed(), SearchConfig().uncertainty, settings.robots, CAUTION)
    seeds = tqdm(range(settings.draws), desc=contact, unit="ensemble")
    model = model_of(scene, settings.duration, SolverOptions(dtype="float32"))
    level = Level((model,), settings.duration, fitness)
    return np.array([judge(jax.random.key(seed), level, pair).each for seed in seeds])


def along_its_path(gait: str, settings: Settings) -> tuple[np.ndarray, np.ndarray, float]:
    """The mean that records and `robot_motions` have, of each draw, with its range, and what all robots say; m/s."""
    scene, uncertainty = with_gait(load_scene("exact"), load_gait(gait)), SearchConfig().uncertainty
    asked = {"robots": settings.robots, "duration": settings.duration, "options": SolverOptions(dtype="float32")}
    seeds = tqdm(range(settings.draws), desc=f"{gait}, along its path", unit="ensemble")
    found = [robot_motions(scene, uncertainty, seed=seed, **asked).summary() for seed in seeds]
    speed, error = (np.array([each[name] for each in found]) for name in ("speed", "standard_error"))
    return speed, COVERING * error, float(speed.mean())


def statistics(each: np.ndarray, gaits: tuple[str, str]) -> dict[str, tuple[np.ndarray, np.ndarray, float]]:
    """Of each draw the value and its range, and what all robots say."""
    every = each.swapaxes(0, 1).reshape(2, -1)
    pooled = fitness_of(every)
    found: dict[str, tuple[np.ndarray, np.ndarray, float]] = {}
    for k, name in enumerate(gaits):
        ranges = np.array([COVERING * standard_error(one[k]) for one in each])
        found[f"mean speed of {name}"] = each[:, k].mean(1), ranges, float(every[k].mean())
        ranges = np.array([COVERING * standard_error(influences(one, CAUTION)[k]) for one in each])
        values = np.array([fitness_of(one)[k] for one in each])
        found[f"fitness of {name}"] = values, ranges, float(pooled[k])
    ranges = np.array([COVERING * standard_error(np.subtract(*influences(one, CAUTION)[::-1])) for one in each])
    values = np.array([np.subtract(*fitness_of(one)[::-1]) for one in each])
    found["gain from the first to the second"] = values, ranges, float(np.subtract(*pooled[::-1]))
    return found


def fitness_of(each: np.ndarray) -> np.ndarray:
    """(gaits,), mean less caution times standard deviation over (gaits, robots)."""
    return each.mean(1) - CAUTION * each.std(1)


@plot.styled
def figure(errors: dict[str, np.ndarray]) -> Figure:
    """By how much each draw is off, in ranges: within -1 and 1 a range covers."""
    chart = Figure(figsize=(8, 0.5 * len(errors) + 1.5), layout="constrained")
    axes = chart.subplots()
    for k, off in enumerate(errors.values()):
        axes.plot(off, np.full(off.shape, k), "o", color=plot.PATH, alpha=0.5, markersize=4)
    axes.axvspan(-1, 1, color=plot.GROUND, alpha=0.5, lw=0)
    axes.set(yticks=range(len(errors)), yticklabels=list(errors), xlabel="error of a draw, in ranges of ±")
    return chart


if __name__ == "__main__":
    run(main, Settings)
