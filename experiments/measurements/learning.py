"""How fast policies are learned, and how well they do where they never were: other contact, bad sensors, goals."""

import json
import time
from collections.abc import Iterator
from pathlib import Path

import jax
import numpy as np
from measurements.measurement import Figure, Record, check_names, measurement
from measurements.pages import columns
from measurements.unseen import BAD, unseen

from jaxgrity import InputError, SolverOptions, load_scene, with_error
from jaxgrity.control import LearningConfig, environment, learn, learner, trials
from jaxgrity.io.files import read_text

SPEED, HEADING = "speed", "heading"
POINTS = 50
"""Points of a learning curve in the record, at least."""
CASES = (
    *(f"speed 128 300 {seed}" for seed in range(3)),
    *(f"heading 128 300 {seed}" for seed in range(3)),
    *(f"speed 128 800 {seed} plain" for seed in range(3)),
    *(f"heading 512 1200 {seed} plain" for seed in range(3)),
)
"""Task, robots side by side, updates, seed, and whether the policy is plain: without the robot's symmetries."""
PLAIN = "plain"


@measurement(page="environments.md", quick={"cases": ("heading 8 2 0",), "episodes": 2}, drawn=("curve",))
def learning(
    cases: tuple[str, ...] = CASES,
    episodes: int = 64,
    earlier: Path | None = None,
) -> Iterator[Record]:
    """A row for each policy.

    Args:
        cases: task, number of robots side by side, number of updates, seed of starts, network and tries, and "plain"
            for a policy that does not know the robot's symmetries
        episodes: new ones, by which a policy is judged
        earlier: a record of the same settings, whose cases are not learned again
    """
    before = {"rows": []} if earlier is None else json.loads(read_text(earlier))
    known = {case_of(row): row for row in before["rows"]}
    for case, (task, robots, updates, seed, plain) in {case: numbers_of(case) for case in cases}.items():
        config = LearningConfig(robots=robots, symmetric=not plain)
        yield known.get(case) or learned(task, updates, seed, config, episodes)
    return {"episodes": episodes, "periods": LearningConfig.decisions * LearningConfig.held}


def case_of(row: Record) -> str:
    """The name of a row's case."""
    plain = "" if row.get("symmetric") else f" {PLAIN}"  # older policies all were
    return f"{row['task']} {row['robots']} {row['updates']} {row['seed']}{plain}"


def numbers_of(case: str) -> tuple[str, int, int, int, bool]:
    """Task, robots, updates, seed and whether it is plain. Raises `InputError` for what is no case."""
    try:
        task, *numbers = case.split()
        plain = numbers[3:] == [PLAIN]
        robots, updates, seed = map(int, numbers[: 3 if plain else None])
        check_names("task", [task], (SPEED, HEADING))
        if robots < 1 or updates < 1 or seed < 0:
            raise ValueError(f"{robots} robots, {updates} updates, seed {seed}")
    except ValueError as error:
        raise InputError(f"cases = {case!r}: {error}; expected such as {CASES[0]!r}") from error
    return task, robots, updates, seed, plain


def learned(task: str, updates: int, seed: int, config: LearningConfig, episodes: int) -> Record:
    """What a policy reaches in new episodes."""
    scene = load_scene("exact")
    env = environment(task, scene, options=SolverOptions(dt=0.01, dtype="float32"))
    curve: list[float] = []
    now = learner(env, jax.random.key(seed), config)
    began = time.perf_counter()
    policy = learn(env, now, updates, config, lambda _, told: curve.append(told["progress"])).policy
    spent = time.perf_counter() - began
    tests = {"progress": env} | unseen(task, scene)
    if task == HEADING:  # whose observations are those of the task `goal`
        tests |= {"goal": environment("goal", scene), "erring_goal": environment("goal", scene, sensors=BAD)}
    found = {name: trials(each, policy, jax.random.key(1000 + seed), episodes) for name, each in tests.items()}
    return {
        "task": task,
        "robots": config.robots,
        "updates": updates,
        "seed": seed,
        "symmetric": config.symmetric,
        "seconds": spent,
        **{name: float(each.mean()) for name, each in found.items()},
        "error": 2 * float(found["progress"].std(ddof=1)) / episodes**0.5,
        "curve": curve[:: max(1, updates // POINTS)],
    }


@learning.table
def words(record: Record) -> str:
    """What each policy reaches."""
    cells = {
        "task, robots, seed": lambda row: (
            f"{row['task']}, {row['robots']}, {row['seed']}{'' if row.get('symmetric') else ', without symmetry'}"
        ),
        "progress, m/s": lambda row: with_error(row["progress"], row["error"], decimals=2),
        "steps of 5 ms, float64": "{finer:.2f}",
        "other contact model": "{other:.2f}",
        "bad sensors": "{erring:.2f}",
        "task `goal`; bad sensors": lambda row: (
            "; ".join(f"{row[name]:.2f}" for name in ("goal", "erring_goal") if name in row) or "-"
        ),
        "control periods; wall time": lambda row: (
            f"{row['updates'] * row['robots'] * record['periods'] / 1e6:.0f} million; {row['seconds'] / 60:.1f} min"
        ),
    }
    return columns(record["rows"], cells)


@learning.figure(4.2)
def figure(record: Record, chart: Figure) -> None:
    """Progress of the policies that are tried, against control periods: the mean of all seeds, and their range."""
    tasks = list(dict.fromkeys(row["task"] for row in record["rows"]))
    panes = chart.subplots(1, len(tasks), sharey=True, squeeze=False)[0]
    for axes, task in zip(panes, tasks):
        rows = [row for row in record["rows"] if row["task"] == task]
        of = lambda row: (row["robots"], row["updates"], bool(row.get("symmetric")))  # noqa: E731
        for colour, kind in enumerate(dict.fromkeys(map(of, rows))):
            robots, updates, symmetric = kind
            curves = np.array([row["curve"] for row in rows if of(row) == kind])
            at = (np.arange(curves.shape[1]) + 1) * updates / curves.shape[1] * robots * record["periods"] / 1e6
            name = f"{'with' if symmetric else 'without'} symmetry, mean of {len(curves)} seeds"
            axes.plot(at, curves.mean(0), "-" if symmetric else "--", color=f"C{colour}", label=name)
            axes.fill_between(at, curves.min(0), curves.max(0), color=f"C{colour}", alpha=0.25, label="all seeds")
        axes.set(title=task, xlabel="control periods (millions)", xscale="log")
    panes[0].set_ylabel("progress with exploration (m/s)")
    chart.legend(*panes[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
