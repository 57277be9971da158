"""Learn a policy by reinforcement learning, test it on new episodes, and save it with a replay."""

import time
from functools import partial
from typing import Any

import equinox as eqx
import jax
import numpy as np
from matplotlib.figure import Figure

from jaxgrity.cli.progress import Bars
from jaxgrity.cli.scenes import chosen_scene, scene_name
from jaxgrity.cli.settings import TrainSettings
from jaxgrity.control import environment, episode, learn, learner, save_policy, trials
from jaxgrity.control.environments import Environment
from jaxgrity.control.ppo import Learner, LearningConfig
from jaxgrity.core.arguments import check_count
from jaxgrity.core.display import significant, with_error
from jaxgrity.core.errors import InputError
from jaxgrity.io.files import read_json, save_json, write_whole
from jaxgrity.report import plot, view
from jaxgrity.search.checkpoint import check_same_settings
from jaxgrity.stepping.options import SolverOptions

SAVED = 20
"""Updates from one checkpoint to the next."""
QUICK = LearningConfig(robots=16, decisions=4, batches=1)
"""The size at which one sees how learning goes on, and nothing is learned."""


def main(settings: TrainSettings) -> None:
    """Learn, save at intervals, judge on new episodes of this contact model, and write the results."""
    check_count("seed", settings.seed, 0)
    check_count("updates", settings.updates, 0)
    check_count("episodes", settings.episodes, 2)  # whose spread is the error of their mean
    out, curve = settings.out, earlier_curve(settings)
    scene = chosen_scene(settings.scene, settings.gait)
    options = SolverOptions(dt=settings.dt, dtype="float32")
    env = environment(settings.task, scene, options=options)
    config = QUICK if settings.quick else LearningConfig(robots=settings.robots)
    updates, episodes = (2, 4) if settings.quick else (settings.updates, settings.episodes)
    now = resumed(env, config, settings)
    periods = config.robots * config.decisions * config.held
    print(
        f"{settings.task}: {updates} updates of {periods} control periods, by {config.robots} robots. "
        f"Results go to {out}/. After Ctrl-C, the same command with --resume continues.",
        flush=True,
    )
    now = learned(env, config, now, updates, curve, settings)
    save_policy(now.policy, out / "policy.eqx")
    progress = trials(env, now.policy, jax.random.key(settings.seed + 1), episodes)
    error = 2 * float(progress.std(ddof=1)) / len(progress) ** 0.5
    told = with_error(float(progress.mean()), error, " m/s")
    print(f"progress: {told} (mean of {len(progress)} new episodes, two standard errors)")
    facts = {"progress": progress.mean(), "two_standard_errors": error, "standard_deviation": progress.std(ddof=1)}
    wall = curve[-1]["seconds"] if curve else 0.0
    print(f"{len(curve)} updates, {len(curve) * periods} control periods, {wall:.0f} s")
    plot.save(curve_figure(curve, periods), out / "learning.png")
    trajectory = episode(env, now.policy, jax.random.key(settings.seed + 2))
    if plot.drawn("replay.html", lambda: view.keep_html(env.plant.scene, trajectory, out / "replay.html")):
        print(f"to watch an episode in 3D, open {out}/replay.html in a browser")
    named = {"task": settings.task, "scene": scene_name(settings.scene), "seed": settings.seed}
    save_json(out / "summary.json", named | facts | {"seconds": wall, "periods": len(curve) * periods, "curve": curve})
    print(f"wrote {out}/summary.json and {out}/policy.eqx")


def what_is_learned(settings: TrainSettings) -> dict[str, Any]:
    """The settings that a resumed run has in common with the earlier one."""
    names = ("task", "scene", "gait", "robots", "dt", "seed", "quick")
    return {name: getattr(settings, name) for name in names}


def earlier_curve(settings: TrainSettings) -> list[dict]:
    """The learning curve of the run that is resumed; empty for a new run. Raises `InputError` for other settings."""
    if not settings.resume:
        return []
    try:
        saved = read_json(settings.out / "curve.json")
        before, curve = dict(saved["settings"]), list(saved["curve"])
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{settings.out}: nothing to resume; expected an earlier run") from error
    check_same_settings(settings.out, before, what_is_learned(settings))
    return curve


def resumed(env: Environment, config: LearningConfig, settings: TrainSettings) -> Learner:
    """The start of learning: the state saved by an earlier run, or a new one."""
    first = learner(env, jax.random.key(settings.seed), config)
    if not settings.resume:
        return first
    try:
        return eqx.tree_deserialise_leaves(settings.out / "learner.eqx", first)
    except (OSError, EOFError, RuntimeError, ValueError) as error:
        raise InputError(
            f"{settings.out}: nothing to resume; expected an earlier run of this version with the same robot"
        ) from error


def learned(
    env: Environment, config: LearningConfig, now: Learner, updates: int, curve: list[dict], settings: TrainSettings
) -> Learner:
    """Learn up to a number of updates, and save the state of learning."""
    spent = curve[-1]["seconds"] if curve else 0.0
    start = time.perf_counter()
    with Bars() as bars:
        while len(curve) < updates:
            bars.show("learning", len(curve), updates)

            def hear(_: int, facts: dict[str, float]) -> None:
                curve.append(facts | {"seconds": spent + time.perf_counter() - start})
                bars.show("learning", len(curve), updates)
                bars.bar.set_postfix({"progress": f"{significant(facts['progress'])} m/s"})

            now = learn(env, now, min(SAVED, updates - len(curve)), config, hear)
            write_whole(settings.out / "learner.eqx", partial(eqx.tree_serialise_leaves, pytree=now))
            save_json(settings.out / "curve.json", {"settings": what_is_learned(settings), "curve": curve})
    return now


def curve_figure(curve: list[dict[str, Any]], periods: int) -> Figure:
    """Progress of the policies against the control periods of learning."""
    chart = Figure(figsize=(6, 3.5), layout="constrained")
    axes = chart.subplots()
    axes.plot(np.arange(1, len(curve) + 1) * periods / 1e6, [row["progress"] for row in curve])
    axes.set(xlabel="control periods (millions)", ylabel="progress with exploration (m/s)", ylim=(0, None))
    return chart
