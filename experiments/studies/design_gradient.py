"""What a design of design_study.py still gains by the derivative of its orbit's speed, where there is one.

On penalty contact the speed of a closed orbit, and forces and powers of its actuators along it, have derivatives in all
numbers of a design. Each step maximises the linearised speed within the linearised limits and a box (a linear
programme). It counts where the orbit that the robot then settles on is faster within all limits, or passes them by
less where they were passed; else the box is halved. Where a design settles on no orbit on penalty contact there is
nothing to climb, and the table says so.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from measurements.measurement import Figure, Record, measurement
from measurements.pages import by_name, table
from scipy.optimize import linprog
from studies.design_space import HIGHEST, LOWEST, NAMES, Limits, designed, on_orbit
from tqdm import tqdm

from jaxgrity import InputError, Scene, load_gait, load_scene, with_gait
from jaxgrity.io.files import read_text
from jaxgrity.model import penalty_twin, rest_length
from jaxgrity.orbits import Orbit, closed_orbit, find_orbit, restarted
from jaxgrity.report import plot
from jaxgrity.stepping import resolve, states_at

WINDOW = 0.05
"""s, time constant of the moving mean of forces, as that of `orbit_cycle`"""
FRAMES = 256
"""in a cycle, at which they are told"""
INSIDE = 0.99
"""of the limits, that a step aims at: they bend"""
WATCHED = 100.0
"""s, for an orbit"""


@measurement(page="gait_records.md", quick={"steps": 1, "last": 1}, drawn=("each", "slopes"))
def design_gradient(
    study: Path = Path("results/design_study/design_study.json"),
    steps: int = 8,
    box: float = 0.06,
    last: int | None = None,
) -> Iterator[Record]:
    """A row for each design that rolls.

    Args:
        study: designs to begin with
        steps: gradients, at most, from each design
        box: by which a step may change the logarithm of each number, at first
        last: number of designs, those of most power; all, where not given
    """
    known = json.loads(read_text(study))
    begun = [row for row in known["rows"] if row["kind"] == "robot and gait" and (row["speed"] or 0) > 0]
    if not begun:
        raise InputError(f"{study}: no design that rolls; expected one to begin with")
    exact = with_gait(load_scene("exact"), load_gait("lasting"))
    limits = Limits(*known["limits"])
    for row in begun if last is None else begun[-last:]:
        x, power = np.log([row["factors"][name] for name in NAMES]), row["power"]
        yield {"power": power, "exact": row["speed"]} | climbed(exact, x, limits, power, steps, box)


class Slopes(NamedTuple):
    """What an orbit is worth, and how that changes with the design."""

    speed: Any
    """m/s, or per unit of the logarithms"""
    force: Any
    """N, of the strut that bears most, for a strut of the scene's length"""
    power: Any
    """W, of the actuator that gives most"""


def climbed(exact: Scene, x: np.ndarray, limits: Limits, power: float, most: int, first_box: float) -> dict[str, Any]:
    """From one design on penalty contact, and back on exact contact in the end."""
    scene, box, steps, first_slope = penalty_twin(exact), first_box, [], None
    first = here = on_orbit(scene, x)
    if not here["settled"]:
        return {"penalty": None, "each": [], "steps": 0, "kept": 0}
    for _ in tqdm(range(most), unit="gradient", leave=False):
        orbit = find_orbit(designed(scene, x), max(WATCHED, 60 / float(designed(scene, x).gait.frequency[0])))
        value, slope = slopes(scene, x, orbit)
        first_slope = slope if first_slope is None else first_slope
        while np.isfinite(slope.speed).all() and box >= first_box / 16:
            tried = x + best_step(x, value, slope, box, limits, power)
            there = on_orbit(scene, tried)
            better = there["settled"] and worth(there, limits, power) > worth(here, limits, power)
            steps.append({"box": box, "speed": there["speed"], "power": there["peak_power"], "kept": better})
            if better:
                x, here = tried, there
                break
            box /= 2
        else:
            break
    back = on_orbit(exact, x) if any(step["kept"] for step in steps) else None
    kept = sum(step["kept"] for step in steps)
    found = {"penalty": first, "climbed": here, "back": back}
    found |= {"steps": len(steps), "kept": kept, "each": by_name(steps, "speed", "kept") if steps else []}
    return found | ({} if first_slope is None else {"slopes": first_slope._asdict()})


def worth(found: dict[str, Any], limits: Limits, power: float) -> float:
    """The speed; below zero, the farther the more, where a limit is passed."""
    asked = [
        found["strut_force"] / limits.strut_force,
        found["cable_force"] / limits.cable_force,
        found["peak_power"] / power,
    ]
    beyond = sum(max(share, 1) - 1 for share in asked)
    return -beyond if beyond else found["speed"]


def best_step(x: np.ndarray, value: Slopes, slope: Slopes, box: float, limits: Limits, power: float) -> np.ndarray:
    """The d that maximises the linearised speed within a box, the bounds and the linearised limits."""
    room = np.array([INSIDE * limits.strut_force - value.force, INSIDE * power - value.power])
    least = np.array([slope.force, slope.power])
    # where a limit is passed already by more than the box can mend: as far back as it can
    reach = box * np.abs(least).sum(1)
    bounds = np.stack([np.maximum(-box, LOWEST - x), np.minimum(box, HIGHEST - x)], axis=1)
    bounds = np.stack([np.minimum(bounds[:, 0], 0), np.maximum(bounds[:, 1], 0)], axis=1)
    found = linprog(-slope.speed, A_ub=least, b_ub=np.maximum(room, -0.5 * reach), bounds=bounds)
    return found.x if found.success else np.zeros_like(x)


def slopes(scene: Scene, x: np.ndarray, orbit: Orbit) -> tuple[Slopes, Slopes]:
    """Speed, force and power of the closed orbit, and their derivatives in the design, in forward mode."""
    options = resolve(scene, orbit.period)
    steps = int(np.ceil(orbit.cycle / FRAMES / float(options.dt)))
    i, j = np.array(scene.structure.struts.edges).T

    def told(x):
        robot = designed(scene, x)
        closed = closed_orbit(robot, orbit, options)
        running = restarted(robot, orbit)
        times = jnp.linspace(0.0, 1.0, FRAMES + 1) * orbit.periods / running.gait.frequency[0]
        q, v = states_at(running, (closed.q, closed.v), times, steps, options)
        struts = running.structure.struts

        def force(q, v, t):
            arm, moved = q[i] - q[j], v[i] - v[j]
            length = jnp.linalg.norm(arm, axis=1)
            want, change = jax.jvp(lambda t: rest_length(struts, running.gait, t, 0), (t,), (1.0,))
            rate = jnp.sum(arm * moved, axis=1) / length - change
            return struts.stiffness * (want - length) - struts.damping * rate, change

        pushed, change = jax.vmap(force)(q, v, times)
        share = 1 - jnp.exp(-(times[1] - times[0]) / WINDOW)
        # what is periodic, twice: the mean has forgotten its beginning in the second cycle
        _, mean = jax.lax.scan(
            lambda mean, now: (mean + share * (now - mean),) * 2, pushed[0], jnp.concatenate([pushed, pushed])
        )
        mean = mean[len(times) :]
        most = jnp.max(jnp.exp(x[2:5])) ** 2 * jnp.max(jnp.abs(mean))
        found = Slopes(closed.speed, most, jnp.max(jnp.abs(mean * change)))
        return found, found

    slope, value = jax.jit(jax.jacfwd(told, has_aux=True))(jnp.asarray(x))
    return jax.tree.map(np.asarray, (value, slope))


@design_gradient.table
def words(record: Record) -> str:
    """What each climb gained, and what is left of that on exact contact."""
    rows = []
    for row in record["rows"]:
        about = [f"{row['power']:g} W", f"{row['exact']:.3f}"]
        if not row["penalty"]:
            rows.append([*about, "settles on no orbit on penalty contact", "", "", ""])
            continue
        penalty, higher, back = (row[name] and told(row[name]) for name in ("penalty", "climbed", "back"))
        rows.append([*about, penalty, higher, f"{row['kept']} of {row['steps']}", back or ""])
    head = ["power allowed", "search, exact contact, m/s", "search, penalty contact"]
    head += ["climb, penalty contact", "steps kept", "climb, exact contact"]
    return table(head, rows)


def told(found: Record) -> str:
    """Of one design on one contact model."""
    return f"{found['speed']:.3f}, {found['peak_power']:.0f} W" + ("" if found["settled"] else ", no orbit")


@design_gradient.figure(6.5)
def figure(record: Record, chart: Figure) -> None:
    """What speed and power depend on in each design, and how the climbs went."""
    rows = record["rows"]
    (speed, power), (climb, beside) = chart.subplots(2, 2)
    beside.set_axis_off()
    some = [row for row in rows if row["each"] and "slopes" in row]  # a record that keeps no steps is refused
    for k, (row, marker) in enumerate(zip(some, plot.MARKERS)):
        place = np.arange(len(NAMES)) + 0.8 * (k - (len(some) - 1) / 2) / max(len(some), 1)
        for axes, name in ((speed, "speed"), (power, "power")):
            relative = np.asarray(row["slopes"][name]) / row["penalty"]["speed" if name == "speed" else "peak_power"]
            axes.barh(place, relative, 0.8 / len(some), label=f"{row['power']:g} W")
        kept = [row["penalty"]["speed"], *np.array(row["each"]["speed"])[row["each"]["kept"]]]
        climb.plot(range(len(kept)), kept, f"{marker}-")
    for axes, name in ((speed, "speed"), (power, "power")):
        axes.axvline(0, color="black", linewidth=0.8)
        axes.set_yticks(range(len(NAMES)), NAMES if axes is speed else [""] * len(NAMES))
        axes.grid(axis="y", visible=False)
        axes.invert_yaxis()
        axes.set(xlabel=f"change of {name} (%) for 1 % of the number", title=f"What {name} depends on")
    climb.set(xlabel="steps kept", ylabel="steady speed (m/s)", ylim=(0, None), title="Climbs on penalty contact")
    climb.xaxis.get_major_locator().set_params(integer=True)
    beside.legend(*speed.get_legend_handles_labels(), title="power allowed", loc="upper left")
