"""What controllers reach in the environments: a gait as it is, feedback, predictive control, and what was learned.

The trained policy is feedback with steering, whose eleven numbers CMA-ES of evosax (extra `baselines`) adapts to each
task: gains, gains of swings, factors of amplitude and frequency, and the bend towards the direction that is wanted. It
is compared on episodes on which it was not trained. What is told is the progress v·d of the reward; training counts
effort too. The policies of the library join: the one of `speed`, and the one of `heading` in every task with a
direction. So do two for these tasks by gradients through the motion (SHAC: see `short_horizon.py`).
"""

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from measurements.measurement import Figure, Record, check_names, measurement
from measurements.pages import table
from studies.lasting_baselines import built
from studies.short_horizon import SHAC, learned

from jaxgrity import SolverOptions, as_dtype, load_gait, load_scene
from jaxgrity.control import (
    TASKS,
    Environment,
    LearningConfig,
    PhaseLocked,
    Sampling,
    Steered,
    centre_offsets,
    environment,
    lead_to,
    load_policy,
    measure,
    sure_footed,
    trials,
)
from jaxgrity.io.files import read_text

TESTED = 10**6
"""Number of the episodes of the comparison, as if of a generation that no training reaches."""
FAR = 1000.0
"""m, to a goal that stands for a direction"""
SCALE = np.array([0.15] * 4 + [0.1] * 4 + [0.1, 0.1, 0.15])
"""of the numbers that are trained, about how far each may move at first"""
OPEN, FEEDBACK, SURE, TRAINED, PREDICTIVE = "open loop", "feedback", "sure-footed", "trained", "predictive"
LEARNED, CLIMBED = "PPO", "SHAC"
CLIMBING = LearningConfig(robots=64, decisions=16)
"""As in `short_horizon.py`, with the settings that were best there."""
CLIMBING_TIME = 60.0
"""Processor time of each of these policies, s."""
WRITTEN = {FEEDBACK: "plain feedback", SURE: "`sure_footed`"}
"""Names of controllers in the table."""


class Training(NamedTuple):
    """What each task gets."""

    generations: int
    candidates: int
    """in a generation"""
    episodes: int
    """of each candidate in each generation, and of each controller in the end, on others"""
    seed: int


@measurement(
    page="environments.md",
    quick={
        **{"tasks": ("heading",), "generations": 1, "candidates": 6, "episodes": 2, "seconds": 1.0, "slow": False},
    },
)
def task_baselines(
    tasks: tuple[str, ...] = tuple(TASKS),
    generations: int = 50,
    candidates: int = 24,
    episodes: int = 16,
    seconds: float = 10.0,
    slow: bool = True,
    earlier: Path | None = None,
) -> Iterator[Record]:
    """A row for each task: what each controller reaches.

    Args:
        tasks: of the environments
        generations: of training, of each task
        candidates: in a generation
        episodes: of each candidate in each generation, and of each controller in the end, on others
        seconds: s, of an episode
        slow: also those that take minutes: predictive control, and policies by gradients through the motion
        earlier: record of a run with the same settings: only learned policies are tried anew
    """
    check_names("tasks", tasks, TASKS)
    training = Training(generations, candidates, episodes, seed=0)
    rows = {} if earlier is None else {row["task"]: row for row in json.loads(read_text(earlier))["rows"]}
    check_names("tasks", tasks, TASKS if earlier is None else rows)
    strategy = built(candidates, len(SCALE), 1.0) if earlier is None else None
    policies: dict[str, dict[str, Any]] = {}
    for task in tasks:
        env = of_task(task, seconds)
        row = rows.get(task) or compared(env, strategy, training, slow) | {"task": task}
        learned_for = "heading" if env.task.towards != "anywhere" else "speed"
        if learned_for not in policies:
            policies[learned_for] = learned_policies(learned_for, seconds, slow)
        own = policies[learned_for].items()
        found = told({name: trials(env, each, key_of(training, TESTED), episodes) for name, each in own})
        yield row | {name: row[name] | found[name] for name in found}


def of_task(task: str, seconds: float) -> Environment:
    """The environment of a task, as for learning."""
    return environment(task, load_scene("exact"), options=SolverOptions(dt=0.01, dtype="float32"), seconds=seconds)


def learned_policies(task: str, seconds: float, slow: bool) -> dict[str, Any]:
    """The library's policy for a task, and one by gradients through the motion."""
    found = {LEARNED: load_policy(task)}
    if slow:
        found[CLIMBED] = learned(SHAC, of_task(task, seconds), CLIMBING, 0, CLIMBING_TIME)[0]
    return found


def compared(env: Environment, strategy, training: Training, slow: bool) -> Record:
    """What all controllers but those of the library reach in an environment."""
    rolled = rollouts(env)
    trained = train(rolled, strategy, training)
    known = known_controllers() | {TRAINED: trained}
    progress = dict(zip(known, judged(rolled, list(known.values()), training)))
    if slow:
        progress[PREDICTIVE] = predicted(env, training)
    return {"trained": trained} | told(progress)


def told(progress: dict[str, np.ndarray]) -> Record:
    """Mean progress of each controller, m/s, and its standard error."""
    return {
        "progress": {name: float(own.mean()) for name, own in progress.items()},
        "error": {name: float(own.std(ddof=1) / np.sqrt(len(own))) for name, own in progress.items()},
    }


@task_baselines.table
def words(record: Record) -> str:
    """What each controller reaches in each task; without `sure_footed`, which is as fast as plain feedback."""
    names = [name for name in dict.fromkeys(name for row in record["rows"] for name in row["progress"]) if name != SURE]
    rows = [
        [
            row["task"],
            *(
                f"{row['progress'][name]:.2f} ± {2 * row['error'][name]:.2f}" if name in row["progress"] else "-"
                for name in names
            ),
        ]
        for row in record["rows"]
    ]
    return table(["progress, m/s", *(WRITTEN.get(name, name) for name in names)], rows)


def judged(rolled: Callable, numbers: list[np.ndarray], training: Training) -> np.ndarray:
    """(controllers, episodes), m/s: progress on episodes on which nothing was trained, as many controllers at once as
    there are candidates, for which all is compiled."""
    found: list[np.ndarray] = []
    while len(found) < len(numbers):
        some = numbers[len(found) : len(found) + training.candidates]
        padded = [*some, *[some[-1]] * (training.candidates - len(some))]
        found += list(rolled(np.array(padded), keys(training, TESTED))[0][: len(some)])
    return np.array(found)


def known_controllers() -> dict[str, np.ndarray]:
    """Eleven numbers of each controller that is not trained."""
    gait = load_gait("lasting")
    plain, sure = PhaseLocked(gait), sure_footed(gait)
    larger, faster = (float(np.mean(getattr(sure.gait, x) / getattr(gait, x))) for x in ("amplitude", "frequency"))
    none = np.zeros(4)
    return {
        OPEN: np.array([*none, *none, 1.0, 1.0, 0.0]),
        FEEDBACK: np.array([*np.ravel(plain.gains), *none, 1.0, 1.0, 0.0]),
        SURE: np.array([*np.ravel(sure.gains), *np.ravel(sure.swings), larger, faster, 0.0]),
    }


def train(rolled: Callable, strategy, training: Training) -> np.ndarray:
    """The mean of the distribution after all generations, which begins at sure-footed feedback with some bend."""
    algorithm, parameters = strategy
    key, start = jax.random.key(training.seed), known_controllers()[SURE] + np.array([0.0] * 10 + [0.1])
    state = algorithm.init(key, np.zeros(len(SCALE)), parameters)
    for number in range(training.generations):
        asked, told = jax.random.split(jax.random.fold_in(key, number))
        genes, state = algorithm.ask(asked, state, parameters)
        _, reward = rolled(start + SCALE * np.asarray(genes), keys(training, number))
        state, _ = algorithm.tell(told, genes, -reward.mean(1), state, parameters)
    return start + SCALE * np.asarray(state.mean)


def keys(training: Training, number: int):
    """Keys of episodes; `trials` draws the same ones from `key_of`."""
    return jax.random.split(key_of(training, number), training.episodes)


def key_of(training: Training, number: int):
    """The key of a generation's episodes."""
    return jax.random.key(10**7 * (training.seed + 1) + number)


def rollouts(env: Environment) -> Callable[[np.ndarray, Any], tuple[np.ndarray, np.ndarray]]:
    """Of controllers and keys: progress and reward, m/s, (controllers, episodes), in the mean over each episode, to its
    end or the time's."""
    each = jax.vmap(lambda one, key: episode(env, one, key), in_axes=(None, 0))
    compiled = jax.jit(jax.vmap(each, in_axes=(0, None)))

    def rolled(numbers, drawn):
        progress, reward = compiled(jnp.asarray(numbers, jnp.float32), drawn)
        return np.asarray(progress, float), np.asarray(reward, float)

    return rolled


def episode(env: Environment, numbers, key):
    """One episode of the controller that eleven numbers describe."""
    policy = controller(numbers)
    state = env.reset(key)
    goal = wanted(env, state.pipeline_state.aim)

    def step(carry, tick):
        before, memory = carry
        seen = measure(env.plant.scene, 0.0, *before.pipeline_state.plant.motion)
        contraction, memory = replace(policy, goal=goal)(seen, jnp.float32(env.plant.period) * (tick + 1), memory)
        state = env.step(before, 2 * contraction / env.plant.motors.stroke - 1)
        return (state, memory), (state.metrics["progress"], state.reward, 1 - before.done)

    first = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), policy.first())
    _, (progress, reward, counted) = jax.lax.scan(step, (state, first), jnp.arange(env.episode))
    return progress.sum() / counted.sum(), reward.sum() / counted.sum()


def controller(numbers) -> Steered:
    """Feedback with steering, of eleven numbers."""
    gait = load_gait("lasting")
    own = replace(gait, amplitude=gait.amplitude * numbers[8], frequency=gait.frequency * numbers[9])
    locked = PhaseLocked(own, numbers[:4].reshape(2, 2), numbers[4:8].reshape(2, 2))
    offsets = centre_offsets(load_scene("exact").structure, gait.members)
    return as_dtype(Steered(locked, numbers[10], offsets), "float32")


def wanted(env: Environment, aim):
    """(2,), m: where to steer to; a task without a direction has none to steer to, and gets any."""
    if env.task.towards == "goal":
        return aim
    return jnp.array([-FAR, 0.0], jnp.float32) if env.task.towards == "uphill" else FAR * aim


def predicted(env: Environment, training: Training) -> np.ndarray:
    """(episodes,), m/s: progress, counted as for all others, of predictive control whose model is the robot itself."""
    found = []
    policy = controller(np.asarray(known_controllers()[FEEDBACK], np.float32))
    for number, key in enumerate(keys(training, TESTED)):
        state = env.reset(key)
        plant, aim, average, *_ = state.pipeline_state
        goal = np.asarray(wanted(env, aim), float)
        period = env.plant.period
        sampling = Sampling(patience=env.episode * period, per_second=round(1 / period), seed=number)
        there = lead_to(env.plant, env.plant, policy, goal, start=plant.motion, sampling=sampling)
        steps = []
        for before, place in pairwise(there.path):
            progress, average = env.task.progressed(aim, before, place, env.plant.period, average)
            steps.append(float(progress))
        found.append(np.mean(steps))
    return np.array(found)


@task_baselines.figure()
def figure(record: Record, chart: Figure) -> None:
    """Progress of each controller in each task."""
    rows = record["rows"]
    chart.set_figheight(0.75 * len(rows) + 1.4)
    axes = chart.subplots()
    names = (OPEN, FEEDBACK, SURE, TRAINED, PREDICTIVE, LEARNED)
    for k, name in enumerate(names):
        there = [(place, row) for place, row in enumerate(rows) if name in row["progress"]]
        own = [(place, row["progress"][name], 2 * row["error"][name]) for place, row in there]
        if own:
            places, sizes, errors = (np.array(x) for x in zip(*own))
            label = WRITTEN.get(name, name).strip("`")
            axes.barh(places + 0.14 * (k - 2.5), sizes, height=0.13, xerr=errors, label=label, error_kw={"lw": 0.8})
    axes.set_yticks(range(len(rows)), [row["task"] for row in rows])
    axes.set(xlabel="progress (m/s), with two standard errors")
    axes.grid(axis="y", visible=False)
    axes.invert_yaxis()
    chart.legend(loc="outside upper center", ncols=3)
