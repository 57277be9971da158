"""Whether gradients through the robot's motion teach a policy faster than PPO does, at equal processor time.

Gradients through the motion teach by short-horizon actor-critic (SHAC): see `short_rollouts.py`.
"""

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np
from measurements.measurement import Figure, Record, check_names, measurement
from measurements.pages import columns
from studies.short_rollouts import reaching, with_short_horizon

from jaxgrity import InputError, SolverOptions, contact_twin, load_scene, with_error
from jaxgrity.control import Environment, LearningConfig, environment, learn, learner, trials
from jaxgrity.io.files import read_text
from jaxgrity.report import plot

PPO, SHAC = "PPO", "short-horizon"
SYMMETRIC = "symmetric"
CONTACTS = {"exact": 0.01, "penalty": 0.001}
"""Time step for each contact model, s. Penalty contact is unstable at 1.4 ms."""
CASES = (
    *("exact PPO 128 0", "exact PPO 128 1", "exact short-horizon 64 0", "exact short-horizon 64 1"),
    *("penalty PPO 128 0", "penalty short-horizon 64 0"),
    *("exact PPO 128 0 symmetric", "exact short-horizon 64 0 symmetric"),
)
"""Some minutes of processor time in all."""
POINTS = 50
"""Points of a learning curve in the record, at least."""


@measurement(
    page="environments.md",
    quick={"seconds": 0.1, "cases": ("exact PPO 8 0", "exact short-horizon 8 0"), "horizon": 2, "episodes": 2},
)
def short_horizon(
    cases: tuple[str, ...] = CASES,
    seconds: float = 60.0,
    horizon: int = 16,
    episodes: int = 64,
    earlier: Path | None = None,
) -> Iterator[Record]:
    """A row for each case.

    Args:
        cases: contact model, method, number of robots side by side, seed, and "symmetric" for a policy that knows the
            robot's symmetries
        seconds: of processor time for each policy, without compilation
        horizon: decisions of a short rollout, of four control periods each
        episodes: new ones, by which a policy is judged
        earlier: a record of the same settings, whose cases are not measured again
    """
    known = {} if earlier is None else {case_of(row): row for row in json.loads(read_text(earlier))["rows"]}
    for case, asked in {case: parts_of(case, horizon) for case in cases}.items():
        yield known.get(case) or measured_case(*asked, seconds, episodes)
    return {"seconds": seconds, "horizon": horizon, "episodes": episodes}


def case_of(row: Record) -> str:
    """The name of a row's case."""
    symmetric = [SYMMETRIC] if row.get(SYMMETRIC) else []  # older rows have none
    return " ".join([*(str(row[name]) for name in ("contact", "method", "robots", "seed")), *symmetric])


def parts_of(case: str, horizon: int) -> tuple[str, str, LearningConfig, int]:
    """Contact model, method, settings and seed. Raises `InputError` for what is no case."""
    try:
        contact, method, robots, seed, *known = case.split()
        check_names("knowing", known, (SYMMETRIC,))
        check_names("contact", [contact], CONTACTS)
        check_names("method", [method], (PPO, SHAC))
        settings = {"robots": int(robots), "symmetric": bool(known)}
        config = LearningConfig(**settings | ({"decisions": horizon} if method == SHAC else {}))
        return contact, method, config, int(seed)
    except ValueError as error:
        raise InputError(f"cases = {case!r}: {error}; expected such as {CASES[0]!r}") from error


def measured_case(
    contact: str, method: str, config: LearningConfig, seed: int, seconds: float, episodes: int
) -> Record:
    """What a policy reaches in new episodes after some processor time."""
    scene = load_scene("exact") if contact == "exact" else contact_twin(load_scene("exact"))
    env = environment("speed", scene, options=SolverOptions(dt=CONTACTS[contact], dtype="float32"))
    policy, curve, norms = learned(method, env, config, seed, seconds)
    found = trials(env, policy, jax.random.key(1000 + seed), episodes)
    return {
        "contact": contact,
        "method": method,
        "robots": config.robots,
        "seed": seed,
        SYMMETRIC: config.symmetric,
        "periods": len(curve) * config.robots * config.decisions * config.held,
        "updates": len(curve),
        "progress": float(found.mean()),
        "error": 2 * float(found.std(ddof=1)) / episodes**0.5,
        "norms": norms,
        "curve": curve[:: max(1, len(curve) // POINTS)],
    }


def learned(
    method: str, env: Environment, config: LearningConfig, seed: int, seconds: float
) -> tuple[Any, list[tuple[float, float]], list[float] | None]:
    """The policy after some processor time; progress of the tries, m/s, against that time, s; and of gradients through
    the motion, by one decision of one robot, the median norm and the largest, m/s."""
    now = learner(env, jax.random.key(seed), config)
    if method == PPO:
        facts: dict[str, float] = {}
        update = lambda now: (learn(env, now, 1, config, lambda _, told: facts.update(told)), facts)  # noqa: E731
    else:
        now, update = with_short_horizon(env, now, config)
    update(now)  # compiles
    curve, norms, spent = [], [], 0.0
    while spent < seconds:
        began = time.process_time()
        now, told = jax.block_until_ready(update(now))
        spent += time.process_time() - began
        curve.append((spent, float(told["progress"])))
        norms.append((float(told.get("median", np.nan)), float(told.get("largest", np.nan))))
    if method == PPO:
        return now.policy, curve, None
    median, largest = np.array(norms).T
    return reaching(env, now.policy), curve, [float(np.median(median)), float(largest.max())]


@short_horizon.table
def words(record: Record) -> str:
    """What each method reaches; whatever is the same in all rows is left out."""
    told = {
        "contact": lambda row: row["contact"],
        "method": called,
        "seed": lambda row: str(row["seed"]),
    }
    cells = {name: cell for name, cell in told.items() if len({cell(row) for row in record["rows"]}) > 1}
    cells |= {
        "progress, m/s": lambda row: with_error(row["progress"], row["error"], decimals=2),
        "updates": "{updates}",
        "control periods": lambda row: f"{row['periods'] / 1e6:.2f} million",
        "norm of gradients, m/s: median, largest": lambda row: (
            "-" if row["norms"] is None else " and ".join(f"{x:.2g}" for x in row["norms"])
        ),
    }
    return columns(record["rows"], cells)


def called(row: Record) -> str:
    """The method of a row, in words."""
    return f"{row['method']}, {row['robots']} robots{', symmetric' if row.get(SYMMETRIC) else ''}"


@short_horizon.figure(4.2)
def figure(record: Record, chart: Figure) -> None:
    """Progress of the policies that are tried, against processor time, for each contact model."""
    name = lambda row: f"{called(row)}, seed {row['seed']}"  # noqa: E731
    contacts = list(dict.fromkeys(row["contact"] for row in record["rows"]))
    looks = {each: (plot.MARKERS[k], f"C{k}") for k, each in enumerate(dict.fromkeys(map(name, record["rows"])))}
    lines = {}
    for axes, contact in zip(np.ravel(chart.subplots(1, len(contacts), sharey=True, squeeze=False)), contacts):
        for row in (row for row in record["rows"] if row["contact"] == contact):
            (marker, colour), (time, progress) = looks[name(row)], np.array(row["curve"]).T
            look = {"marker": marker, "markevery": 0.1, "markersize": 5, "color": colour}
            lines.setdefault(name(row), axes.plot(time, progress, **look, label=name(row))[0])
        axes.set(title=f"{contact} contact", xlabel="processor time (s)")
        axes.set_xlim(0, None)
    chart.legend(handles=list(lines.values()), loc="outside upper center", ncols=2)
    chart.axes[0].set_ylabel("progress with exploration (m/s)")
