"""What simple controllers reach in the environments: a gait as it is, feedback, predictive control, a trained policy.

The trained policy is feedback with steering, whose eleven numbers CMA-ES of evosax (extra `baselines`) adapts to each
task: gains, gains of swings, factors of amplitude and frequency, and the bend towards the direction that is wanted. It
is compared on episodes on which it was not trained. What is told is the progress v·d of the reward; training counts
effort too.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

from jaxgrity.cli.script import measured, run

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from jaxgrity import InputError, SolverOptions, as_dtype, load_gait, load_scene
from jaxgrity.control import (
    TASKS,
    Environment,
    PhaseLocked,
    Sampling,
    Steered,
    centre_offsets,
    environment,
    lead_to,
    measure,
    progressed,
    sure_footed,
)
from jaxgrity.io.files import save_json
from jaxgrity.report import plot

FAR = 1000.0
"""m, to a goal that stands for a direction"""
SCALE = np.array([0.15] * 4 + [0.1] * 4 + [0.1, 0.1, 0.15])
"""of the numbers that are trained, about how far each may move at first"""
OPEN, FEEDBACK, SURE, TRAINED, PREDICTIVE = "open loop", "feedback", "sure-footed", "trained", "predictive"


@dataclass
class Settings:
    tasks: tuple[str, ...] = tuple(TASKS)
    generations: int = 50
    """of training, of each task"""
    candidates: int = 24
    episodes: int = 16
    """of each candidate in each generation, and of each controller in the end, on others"""
    led: int = 16
    """episodes of the predictive controller"""
    seed: int = 0
    out: Path = Path("results/task_baselines")
    """folder for task_baselines.json and its figure"""
    quick: bool = False
    """one task, one generation of 6 candidates, 2 episodes of 1 s, and no predictive controller"""


def main(settings: Settings) -> None:
    seconds = 10.0
    if settings.quick:
        settings.tasks, settings.generations, settings.candidates = ("heading",), 1, 6
        settings.episodes, settings.led, seconds = 2, 0, 1.0
    unknown = sorted(set(settings.tasks) - set(TASKS))
    if unknown:
        raise InputError(f"tasks = {unknown}: unknown; expected some of {', '.join(TASKS)}")
    strategy = built(settings.candidates)
    rows: list[dict[str, Any]] = []
    for task in tqdm(settings.tasks, unit="task"):
        began = time.perf_counter()
        options = SolverOptions(dt=0.01, dtype="float32")
        env = environment(task, load_scene("exact"), options=options, seconds=seconds)
        rolled = rollouts(env)
        trained = train(rolled, strategy, settings)
        known = known_controllers() | {TRAINED: trained}
        progress = judged(rolled, list(known.values()), settings)
        row: dict[str, Any] = {"task": task, "trained": trained} | {
            "progress": {name: float(own.mean()) for name, own in zip(known, progress)},
            "error": {name: float(own.std(ddof=1) / np.sqrt(len(own))) for name, own in zip(known, progress)},
        }
        if settings.led:
            led = predicted(env, settings)
            row["progress"][PREDICTIVE] = float(led.mean())
            row["error"][PREDICTIVE] = float(led.std(ddof=1) / np.sqrt(len(led)))
        rows.append(row | {"seconds": time.perf_counter() - began})
        told = {"episodes": settings.episodes, "led": settings.led, "generations": settings.generations}
        save_json(settings.out / "task_baselines.json", {**measured(), **told, "rows": rows})
    plot.save(figure(rows), settings.out / "task_baselines.png")
    for row in rows:
        print(f"{row['task']}: " + ", ".join(f"{name} {x:.2f} m/s" for name, x in row["progress"].items()))


def judged(rolled: Callable, numbers: list[np.ndarray], settings: Settings) -> np.ndarray:
    """(controllers, episodes), m/s: progress on episodes on which nothing was trained, as many controllers at once as
    there are candidates, for which all is compiled."""
    found: list[np.ndarray] = []
    while len(found) < len(numbers):
        some = numbers[len(found) : len(found) + settings.candidates]
        padded = [*some, *[some[-1]] * (settings.candidates - len(some))]
        found += list(rolled(np.array(padded), keys(settings, 10**6))[0][: len(some)])
    return np.array(found)


def built(population: int):
    """CMA-ES and its parameters. Raises `InputError` where evosax is missing."""
    try:
        from evosax import algorithms
    except ImportError as error:
        raise InputError("the trained policy needs evosax: pip install -e '.[baselines]'") from error
    strategy = algorithms.CMA_ES(population, np.zeros(len(SCALE)))
    return strategy, strategy.default_params.replace(std_init=1.0)


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


def train(rolled: Callable, strategy, settings: Settings) -> np.ndarray:
    """The mean of the distribution after all generations, which begins at sure-footed feedback with some bend."""
    algorithm, parameters = strategy
    key, start = jax.random.key(settings.seed), known_controllers()[SURE] + np.array([0.0] * 10 + [0.1])
    state = algorithm.init(key, np.zeros(len(SCALE)), parameters)
    for number in range(settings.generations):
        asked, told = jax.random.split(jax.random.fold_in(key, number))
        genes, state = algorithm.ask(asked, state, parameters)
        _, reward = rolled(start + SCALE * np.asarray(genes), keys(settings, number))
        state, _ = algorithm.tell(told, genes, -reward.mean(1), state, parameters)
    return start + SCALE * np.asarray(state.mean)


def keys(settings: Settings, number: int):
    return jax.random.split(jax.random.key(10**7 * (settings.seed + 1) + number), settings.episodes)


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


def predicted(env: Environment, settings: Settings) -> np.ndarray:
    """(episodes,), m/s: progress, counted as for all others, of predictive control whose model is the robot itself."""
    found = []
    policy = controller(np.asarray(known_controllers()[FEEDBACK], np.float32))
    for number, key in enumerate(keys(settings, 10**6)[: settings.led]):
        state = env.reset(key)
        plant, aim, average = state.pipeline_state
        goal = np.asarray(wanted(env, aim), float)
        sampling = Sampling(patience=env.episode * env.plant.period, per_second=round(1 / env.plant.period))
        there = lead_to(env.plant, env.plant, policy, goal, start=plant.motion, seed=number, sampling=sampling)
        told = []
        for before, place in pairwise(there.path):
            progress, average = progressed(env.task, aim, before, place, env.plant.period, average)
            told.append(float(progress))
        found.append(np.mean(told))
    return np.array(found)


@plot.styled
def figure(rows: list[dict[str, Any]]) -> Figure:
    """Progress of each controller in each task."""
    chart = Figure(figsize=(6, 0.75 * len(rows) + 1.4), layout="constrained")
    axes = chart.subplots()
    names = (OPEN, FEEDBACK, SURE, TRAINED, PREDICTIVE)
    for k, name in enumerate(names):
        there = [(place, row) for place, row in enumerate(rows) if name in row["progress"]]
        own = [(place, row["progress"][name], row["error"][name]) for place, row in there]
        if own:
            places, sizes, errors = (np.array(x) for x in zip(*own))
            axes.barh(places + 0.16 * (k - 2), sizes, height=0.15, xerr=errors, label=name, error_kw={"lw": 0.8})
    axes.set_yticks(range(len(rows)), [row["task"] for row in rows])
    axes.set(xlabel="progress (m/s)")
    axes.grid(axis="y", visible=False)
    axes.invert_yaxis()
    chart.legend(loc="outside upper center", ncols=3)
    return chart


if __name__ == "__main__":
    run(main, Settings)
