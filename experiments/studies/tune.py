"""Gains of phase-locked feedback by the cross-entropy method, on level ground and on bumps of 2 cm.

Each generation draws controllers from normal distributions, drops the same robots under each of them, and moves the
distributions towards the best (Rubinstein 1999, doi:10.1023/A:1010091220143). A controller is ten numbers: the gains
and the gains of swings of `PhaseLocked`, and the factors of the gait's amplitude and frequency. In the end
known feedback and what was found are compared on ground and from drops on which nothing was tuned.
"""

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from measurements.driven import ENOUGH, PART, dropped_loop, drops
from measurements.measurement import Figure, Record, measurement
from measurements.pages import by_name, table
from tqdm import tqdm

from jaxgrity import Differences, SolverOptions, as_dtype, gait_record, load_gait, load_scene
from jaxgrity.control import PhaseLocked, Plant, Task, drive, ground_of, plant_of, side_by_side, sure_footed
from jaxgrity.report import plot

GAIT = "lasting"
BUMPS, FAR = 0.02, 30.0
"""m, standard deviation of the height; m, how far from the middle of the ground robots are dropped on bumps"""
LOW, HIGH = np.array([-3.0] * 8 + [0.5] * 2), np.array([3.0] * 8 + [1.4, 1.8])
BEST, MOVED, LEAST_SPREAD = 5, 0.4, 0.01
"""candidates towards which the distributions move, how far, and what is added to their spread"""
OPEN_LOOP = np.array([0.0] * 8 + [1.0] * 2)
COUNTED = 1.1
"""times the orbit's speed, beyond which being faster does not count"""
PARTS = {"gains": slice(4), "swings, s": slice(4, 8), "factors of stroke and frequency": slice(8, 10)}
"""Names of the parts of a controller's ten numbers; the table leaves out those in which controllers do not differ."""
TUNED_BUMPS, JUDGED_BUMPS, JUDGED_DROPS = 10, 0, 10**6
"""seeds of the bumps of the search, and of ground and drops of the last judgement, on which nothing is tuned"""


class Search(NamedTuple):
    """Where a search starts, and how wide; numbers with a spread of 0 stay."""

    plant: Plant
    start: np.ndarray
    spread: np.ndarray
    worth: Callable[[np.ndarray], np.ndarray]
    """(candidates,), of the speeds (candidates, robots), m/s, over the last 5 s of 15 s"""
    generations: int
    known: dict[str, np.ndarray]
    """controllers that are compared with what is found"""


@measurement(
    page="control.md",
    quick={"generations": 2, "candidates": 6, "robots": 2, "judged": 2},
    raw=("rows",),
    drawn=("worth",),
)
def tune(
    what: Literal["feedback", "on bumps"],
    generations: int | None = None,
    candidates: int = 24,
    robots: int = 32,
    judged: int = 256,
    seed: int = 0,
) -> Record:
    """Known controllers and what was found.

    Args:
        what: gains from none on level ground, or gains, amplitude and frequency from plain feedback on bumps
        generations: of candidates; 20 for feedback and 30 on bumps, where not given
        candidates: in a generation
        robots: dropped under each candidate
        judged: robots of the last judgement, under each controller
        seed: of candidates and drops
    """
    search = search_for(what)
    found, rows = tuned(search, generations or search.generations, candidates, robots, seed)
    return {
        "rows": rows,
        "worth": by_name(rows),
        "judged": judgement(search.known | {"found by this run": found}, judged),
    }


def search_for(what: str) -> Search:
    """From open loop by speed and the share that rolls, or from plain feedback by speed on other bumps than judged."""
    gait = load_gait(GAIT)
    plain = numbers_of(PhaseLocked(gait))
    if what == "feedback":
        known = {"open loop": OPEN_LOOP, "plain feedback": plain}
        return Search(level(), OPEN_LOOP, np.array([0.6] * 4 + [0.0] * 6), speed_and_share, 20, known)
    known = {"plain feedback": plain, "`sure_footed`": numbers_of(sure_footed(gait))}
    spread = np.array([0.15] * 4 + [0.1] * 4 + [0.07, 0.08])
    return Search(rough(TUNED_BUMPS), plain, spread, lambda speeds: speeds.mean(1), 30, known)


def speed_and_share(speeds: np.ndarray) -> np.ndarray:
    """m/s, the mean speed, up to a bound, and as much again for the share of robots that roll."""
    speed = orbit_speed()
    return np.minimum(speeds, COUNTED * speed).mean(1) + speed * (speeds >= ENOUGH * speed).mean(1)


def tuned(
    search: Search, generations: int, candidates: int, robots: int, seed: int
) -> tuple[np.ndarray, list[dict[str, Any]]]:
    """The mean after all generations, and of each generation what its start, its mean and its best are worth."""
    draw, mean, spread = np.random.default_rng(seed), search.start, search.spread
    rows: list[dict[str, Any]] = []
    for number in tqdm(range(generations), unit="generation"):
        tried = np.clip(mean + spread * draw.standard_normal((candidates, len(mean))), LOW, HIGH)
        tried[0], tried[1] = search.start, mean
        worth = search.worth(dropped(search.plant, tried, robots, 1000 * (seed + 1) + number))
        best = np.argsort(-worth)[:BEST]
        rows.append({"start": worth[0], "mean": worth[1], "best": worth[best[0]]})
        mean = (1 - MOVED) * mean + MOVED * tried[best].mean(0)
        spread = (1 - MOVED) * spread + MOVED * tried[best].std(0) + LEAST_SPREAD * (search.spread > 0)
    return mean, rows


def dropped(plant: Plant, tried: np.ndarray, each: int, seed: int) -> np.ndarray:
    """(candidates, robots), m/s, over the last part of 15 s; 0 where a rollout failed.

    Robots are dropped anyhow, on uneven ground each at a place of its own.
    """
    count, uneven = each * len(tried), plant.scene.ground.surface is not None
    places = np.random.default_rng(seed).uniform(-FAR, FAR, (each, 3)) * [1, 1, 0]
    many = side_by_side(plant, count, Differences(terrain=np.tile(places, (len(tried), 1))) if uneven else None)
    q, v = drops(load_scene("exact"), each, seed)
    q = q + np.array([0, 0, 4 * BUMPS if uneven else 0])
    policy = feedback(np.moveaxis(np.repeat(tried, each, axis=0), 0, -1))
    loop = dropped_loop(many, policy, (q, v), groups=len(tried))
    there = drive(many, policy, loop, round(PART / many.period), 3, each=True)
    moved = np.asarray(there.path)[-2:, :2]
    speeds = np.where(np.asarray(there.failure) == 0, np.linalg.norm(moved[1] - moved[0], axis=0) / PART, 0)
    return speeds.reshape(len(tried), each)


def feedback(rows: np.ndarray) -> PhaseLocked:
    """Of ten numbers, (10, robots)."""
    count = rows.shape[1]
    policy = jax.tree.map(lambda x: jnp.repeat(jnp.asarray(x)[..., None], count, axis=-1), PhaseLocked(load_gait(GAIT)))
    gains, swings = (rows[k : k + 4].reshape(2, 2, count) for k in (0, 4))
    own = (policy.gait.amplitude * rows[8], policy.gait.frequency * rows[9], gains, swings)
    many = eqx.tree_at(lambda p: (p.gait.amplitude, p.gait.frequency, p.gains, p.swings), policy, own)
    return as_dtype(many, "float32")


def numbers_of(policy: PhaseLocked) -> np.ndarray:
    """(10,), the inverse of `feedback`."""
    gait = load_gait(GAIT)
    factors = [float(np.mean(getattr(policy.gait, name) / getattr(gait, name))) for name in ("amplitude", "frequency")]
    return np.array([*np.ravel(policy.gains), *np.ravel(policy.swings), *factors])


def level() -> Plant:
    return _plant(load_scene("exact"))


def rough(seed: int) -> Plant:
    """On bumps; another seed is another ground."""
    return _plant(ground_of(Task("heading", bumps=BUMPS), load_scene("exact"), seed=seed))


def _plant(scene) -> Plant:
    return plant_of(scene, load_gait(GAIT).members, options=SolverOptions(dt=0.01, dtype="float32"))


def orbit_speed() -> float:
    """m/s, of the gait without feedback."""
    return float(gait_record(GAIT)["steady"]["speed"])


def judgement(controllers: dict[str, np.ndarray], robots: int) -> list[dict[str, Any]]:
    """Of controllers by name: the share of robots that roll and the mean speed, on ground and from drops of its own."""
    tried = np.array(list(controllers.values()))
    rows = [{"name": name, "numbers": numbers} for name, numbers in controllers.items()]
    for where, plant in (("level", level()), ("bumps", rough(JUDGED_BUMPS))):
        speeds = dropped(plant, tried, robots, JUDGED_DROPS)
        for row, own in zip(rows, speeds):
            row[where] = {"rolling": float(np.mean(own >= ENOUGH * orbit_speed())), "speed": float(own.mean())}
    return rows


@tune.table
def words(record: Record) -> str:
    """What known feedback and that of a run are made of, and what they are worth."""
    every, rows = record["judged"], []
    differ = [name for name, part in PARTS.items() if len({tuple(row["numbers"][part]) for row in every}) > 1]
    for row in every:
        told = [f"{100 * row[where]['rolling']:.0f} %, {row[where]['speed']:.2f} m/s" for where in ("level", "bumps")]
        numbers = [", ".join(f"{x + 0:.2f}" for x in row["numbers"][PARTS[name]]) for name in differ]
        rows.append([row["name"], *numbers, *told])
    grounds = (f"{where}: share that rolls, speed" for where in ("level ground", "bumps of 2 cm"))
    return table(["feedback", *differ, *grounds], rows)


@tune.figure(4)
def figure(record: Record, chart: Figure) -> None:
    """What the best, the mean and the start are worth in each generation."""
    axes = chart.subplots()
    labels = {"best": "best candidate", "mean": "mean of the candidates", "start": "where it began"}
    for (name, label), marker in zip(labels.items(), plot.MARKERS):
        found = record["worth"][name]
        axes.plot(np.arange(1, len(found) + 1), found, f"{marker}-", markersize=5, label=label)
    axes.set(xlabel="generation", ylabel="worth (m/s)", ylim=(0, None))
    axes.xaxis.get_major_locator().set_params(integer=True)
    chart.legend(loc="outside upper center", ncols=3)
