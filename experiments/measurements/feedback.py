"""What feedback wins over the open loop on both contact models: drops, pushes, friction, late sensors, bumps, slopes.

Robots are dropped as in basin.py: a third of them actuated by the gait as it is, a third with its clock locked to their
rolling, and a third with feedback that was tuned on bumps, on other ground and from other drops than those here. After
15 s each is pushed by 1 N s, in a direction and at a time of its own within 5 s, and has 15 s more. Beside that the
ground begins to lean after 15 s, so that each robot finds itself on its way up or down a slope, and has 15 s more.
MotorLimits are bounded; drops and bumps are repeated with others.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from measurements.driven import ENOUGH, PART, RATE, bounded, dropped_loop, drops
from measurements.measurement import Figure, Record, measurement
from measurements.pages import table

from jaxgrity import Differences, Scene, as_dtype, bumps, contact_twin, gait_record, load_gait, load_scene, with_gait
from jaxgrity.control import (
    Drive,
    Loop,
    PhaseLocked,
    Plant,
    Sensors,
    Task,
    drive,
    ground_of,
    side_by_side,
    sure_footed,
)

SETTLING = 15.0
"""s, until robots are pushed"""
IMPULSE = 1.0
"""N s"""
PUSHES, TIMES = 5.0, 20
"""s, for how long from then on, and at how many different times, robots are pushed; each once"""
BUMPS, LENGTH = 0.02, 0.8
"""m, standard deviation and length of bumps"""
SLOPE = 5.0
"""degrees"""
POLICIES = ("open loop", "feedback", "sure-footed")
WRITTEN = {"feedback": "plain feedback", "sure-footed": "`sure_footed`"}
"""Names of policies in the table."""


class Dropped(NamedTuple):
    """The robots."""

    robots: int
    """for each of the three"""
    seed: int
    """of drops, pushes and bumps"""


@measurement(page="control.md", quick={"robots": 8, "friction": (0.5,), "delays": (0.1,), "other_rates": ()})
def feedback(
    contact: Literal["exact", "penalty"],
    robots: int = 256,
    friction: tuple[float, ...] = (0.2, 0.35, 0.7, 1.0),
    delays: tuple[float, ...] = (0.05, 0.1),
    other_rates: tuple[float, ...] = (1.0, math.inf),
    seed: int = 0,
) -> Iterator[Record]:
    """A row for each case and policy: how many robots roll, and how fast.

    Args:
        contact: its model
        robots: for each of the three
        friction: coefficients
        delays: s, of all sensors
        other_rates: m/s, of motors, of drops and bumps that are repeated
        seed: of drops, pushes and bumps
    """
    own = with_gait(load_scene("exact"), load_gait("lasting"))
    speed, many = float(gait_record("lasting")["steady"]["speed"]), Dropped(robots, seed)
    plant = bounded(own if contact == "exact" else contact_twin(own))
    there = dropped(plant, many)
    for cases in (
        as_it_is(plant, many, speed, there),
        with_friction(plant, many, speed, friction),
        late(plant, many, speed, delays),
        on_other_ground(plant, many, speed, there),
        with_motors(plant, many, speed, other_rates),
    ):
        for case, values in cases:
            for policy, told in values.items():
                yield {"case": case, "policy": policy, **told}
    return {"robots": robots, "orbit_speed": speed, "rate": RATE}


@feedback.table
def words(record: Record) -> str:
    """How many robots roll in each case under each policy, and how fast they are."""
    found = {(row["case"], row["policy"]): row for row in record["rows"]}
    policies = list(dict.fromkeys(row["policy"] for row in record["rows"]))
    rows = []
    for case in dict.fromkeys(row["case"] for row in record["rows"]):
        own = (found[case, policy] for policy in policies)
        rows.append([case, *(f"{row['rolled']} of {row['counted']}, {row['speed']:.2f} m/s" for row in own)])
    return table(["case", *(WRITTEN.get(policy, policy) for policy in policies)], rows)


Cases = Iterator[tuple[str, dict[str, dict[str, float]]]]
"""the name of each case, and of all policies the share of robots that roll, and their mean speed, m/s"""


def as_it_is(plant: Plant, many: Dropped, speed: float, there: Drive) -> Cases:
    """Dropped, and pushed."""
    yield f"dropped, after {SETTLING:.0f} s", _told(there, speed)
    pushed_on = pushed(plant, many, there.end)
    yield f"pushed by {IMPULSE:.0f} N s", _told(pushed_on, speed, among=_speeds(there) >= ENOUGH * speed)


def with_friction(plant: Plant, many: Dropped, speed: float, friction: tuple[float, ...]) -> Cases:
    """Other coefficients."""
    for mu in friction:
        factor = np.full(len(POLICIES) * many.robots, mu / float(plant.scene.friction.sliding_mu))
        yield f"friction {mu:g}", _told(dropped(plant, many, factor), speed)


def late(plant: Plant, many: Dropped, speed: float, delays: tuple[float, ...]) -> Cases:
    """Late sensors."""
    for delay in delays:
        behind = replace(plant, sensors=Sensors(delay=round(delay / plant.period)))
        yield f"sensors {1000 * delay:.0f} ms late", _told(dropped(behind, many), speed)


def on_other_ground(plant: Plant, many: Dropped, speed: float, there: Drive) -> Cases:
    """Bumps, a slope from the start on, and ground that begins to lean."""
    rough = bounded(_on_bumps(plant.scene, many.seed))
    yield f"bumps of {100 * BUMPS:.0f} cm", _told(dropped(rough, many), speed)
    steep = bounded(ground_of(Task("uphill", incline=np.radians(SLOPE)), plant.scene, seed=0))
    yield f"slope of {SLOPE:.0f} degrees, any way", _told(dropped(steep, many), speed)
    rolled, ahead = _speeds(there) >= ENOUGH * speed, _moved(there) / (np.linalg.norm(_moved(there), axis=0) + 1e-9)
    for name, sign in (("up", 1.0), ("down", -1.0)):
        leant = leaning(plant, many, there.end, sign * ahead)
        yield f"slope of {SLOPE:.0f} degrees, on the way {name}", _told(leant, speed, among=rolled, towards=ahead)


def with_motors(plant: Plant, many: Dropped, speed: float, rates: tuple[float, ...]) -> Cases:
    """Drops and bumps with other motors."""
    scenes = {"dropped": plant.scene, f"bumps of {100 * BUMPS:.0f} cm": _on_bumps(plant.scene, many.seed)}
    for rate in rates:
        motors = f"motors of {rate:g} m/s" if math.isfinite(rate) else "unbounded motors"
        for name, scene in scenes.items():
            yield (
                f"{name}, {motors}",
                _told(dropped(bounded(scene, rate), many), speed),
            )


def _on_bumps(scene: Scene, seed: int) -> Scene:
    ground = replace(scene.ground, incline=0.0, surface=bumps(BUMPS, LENGTH, seed))
    high = scene.structure.nodes + np.array([0, 0, 4 * BUMPS])
    return replace(scene, ground=ground, structure=replace(scene.structure, nodes=high))


def _policy(robots: int) -> PhaseLocked:
    """A third of the robots under each policy."""
    gait = load_gait("lasting")
    locked = PhaseLocked(gait)
    own = (replace(locked, gains=0 * locked.gains), locked, sure_footed(gait))
    stacked = jax.tree.map(
        lambda *x: jnp.repeat(jnp.stack([jnp.asarray(a) for a in x], axis=-1), robots, axis=-1), *own
    )
    return as_dtype(stacked, "float32")


def dropped(plant: Plant, many: Dropped, friction: np.ndarray | None = None) -> Drive:
    """All thirds from the same drops; where they get to in `SETTLING`."""
    count, every = many.robots, len(POLICIES) * many.robots
    plants = side_by_side(plant, every, Differences(friction=np.ones(every) if friction is None else friction))
    ground = plant.scene.ground
    height = np.array([0, 0, 4 * BUMPS if ground.surface is not None else 0.6 * np.tan(ground.incline)])
    q, v = drops(plant.scene, count, many.seed)
    policy = _policy(count)
    return _driven(plants, policy, dropped_loop(plants, policy, (q + height, v), len(POLICIES), many.seed))


def pushed(plant: Plant, many: Dropped, loop: Loop) -> Drive:
    """Each robot with the impulse in a direction and at a time of its own, the same in all thirds, from where it is."""
    count, every = many.robots, len(POLICIES) * many.robots
    plants, policy = side_by_side(plant, every, Differences(friction=np.ones(every))), _policy(count)
    draw = np.random.default_rng(many.seed)
    angle = np.tile(draw.uniform(0, 2 * np.pi, count), len(POLICIES))
    when = np.tile(draw.integers(0, TIMES, count), len(POLICIES))
    kick = IMPULSE / float(plant.scene.structure.mass) * np.stack([np.cos(angle), np.sin(angle), 0 * angle])

    def stretch(loop: Loop, k):
        (q, v), now = loop.plant.motion, jnp.asarray(kick) * (when == k)
        state = loop.plant._replace(motion=(q, v + now.astype(v.dtype)))
        rolled = drive(plants, policy, loop._replace(plant=state), round(PUSHES / TIMES / plant.period), each=True)
        return rolled.end, None

    loop, _ = jax.lax.scan(stretch, loop, jnp.arange(TIMES))
    return _driven(plants, policy, loop)


def leaning(plant: Plant, many: Dropped, loop: Loop, uphill: np.ndarray) -> Drive:
    """From where robots are, on ground that rises from now on in the directions `uphill`, (2, robots)."""
    angle = np.radians(SLOPE)
    up = np.stack([*(np.sin(angle) * uphill), np.full(uphill.shape[1], np.cos(angle))], axis=-1)
    return _driven(side_by_side(plant, len(up), Differences(up=up)), _policy(many.robots), loop)


def _driven(plants: Plant, policy: PhaseLocked, loop: Loop) -> Drive:
    return drive(plants, policy, loop, round(PART / plants.period), round(SETTLING / PART), each=True)


def _speeds(there: Drive, towards: np.ndarray | None = None) -> np.ndarray:
    """(robots,), m/s, in the last part of the time, in a direction or in any; 0 where the rollout failed."""
    moved = _moved(there) / PART
    speeds = np.linalg.norm(moved, axis=0) if towards is None else np.sum(towards * moved, axis=0)
    return np.where(np.asarray(there.failure) == 0, speeds, 0.0)


def _moved(there: Drive) -> np.ndarray:
    """(2, robots), m, in the last part of the time."""
    return np.diff(np.asarray(there.path)[-2:, :2], axis=0)[0]


def _told(
    there: Drive, speed: float, among: np.ndarray | None = None, towards: np.ndarray | None = None
) -> dict[str, dict[str, float]]:
    """Of each third, among those robots that count: the share that roll as fast as the orbit, nearly, and the mean."""
    speeds = _speeds(there, towards).reshape(len(POLICIES), -1)
    counted = np.ones(speeds.shape, bool) if among is None else among.reshape(len(POLICIES), -1)
    return {
        name: {
            "rolling": float(np.mean(own[chosen] >= ENOUGH * speed)) if chosen.any() else 0.0,
            "speed": float(own[chosen].mean()) if chosen.any() else 0.0,
            "rolled": int(np.sum(own[chosen] >= ENOUGH * speed)),
            "counted": int(chosen.sum()),
        }
        for name, own, chosen in zip(POLICIES, speeds, counted)
    }


@feedback.figure(7.5)
def figure(record: Record, chart: Figure) -> None:
    """The share of robots that roll in every case."""
    axes = chart.subplots()
    for k, policy in enumerate(POLICIES):
        own = [row for row in record["rows"] if row["policy"] == policy]
        places = np.arange(len(own)) + 0.27 * (k - 1)
        label = WRITTEN.get(policy, policy).strip("`")
        axes.barh(places, [100 * row["rolling"] for row in own], height=0.25, label=label)
        axes.set_yticks(np.arange(len(own)), [row["case"] for row in own])
    axes.set(xlabel="robots that roll (%)", xlim=(0, 103))
    axes.grid(axis="y", visible=False)
    axes.invert_yaxis()
    chart.legend(loc="outside upper right", ncols=3)
