"""What feedback wins over the open loop on both contact models: drops, pushes, friction, late sensors, bumps, slopes.

Robots are dropped as in basin.py: a third of them actuated by the gait as it is, a third with its clock locked to their
rolling, and a third with feedback that was tuned on bumps, on other ground and from other drops than those here. After
15 s each is pushed by 1 N s, in a direction and at a time of its own within 5 s, and has 15 s more. Beside that the
ground begins to lean after 15 s, so that each robot finds itself on its way up or down a slope, and has 15 s more.
MotorLimits are bounded; drops and bumps are repeated with others.
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from jaxgrity.cli.script import measured, run

import jax
import jax.numpy as jnp
import numpy as np
from basin import ENOUGH, PART, drops
from matplotlib.figure import Figure
from tqdm import tqdm

from jaxgrity import (
    Differences,
    Scene,
    SolverOptions,
    as_dtype,
    bumps,
    contact_twin,
    gait_record,
    load_gait,
    load_scene,
    with_gait,
)
from jaxgrity.control import (
    Drive,
    Loop,
    MotorLimits,
    PhaseLocked,
    Plant,
    Sensors,
    Task,
    drive,
    ground_of,
    loop_start,
    plant_of,
    side_by_side,
    simulate_policy,
    sure_footed,
)
from jaxgrity.io.files import save_json
from jaxgrity.report import plot, view

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


@dataclass
class Settings:
    robots: int = 256
    """for each of the three"""
    friction: tuple[float, ...] = (0.2, 0.35, 0.7, 1.0)
    """coefficients"""
    delays: tuple[float, ...] = (0.05, 0.1)
    """s, of all sensors"""
    rate: float = 1.2
    """m/s, of the motors"""
    other_rates: tuple[float, ...] = (1.0, math.inf)
    """m/s, likewise, of drops and bumps that are repeated"""
    contact: Literal["exact", "penalty"] = "exact"
    """its model"""
    seed: int = 0
    """of drops, pushes and bumps"""
    out: Path = Path("results/feedback")
    """folder for feedback_CONTACT.json and its figure"""
    quick: bool = False
    """8 robots, one coefficient of friction, one delay"""


def main(settings: Settings) -> None:
    if settings.quick:
        settings.robots, settings.friction, settings.delays, settings.other_rates = 8, (0.5,), (0.1,), ()
    gait = load_gait("lasting")
    own = with_gait(load_scene("exact"), gait)
    speed = float(gait_record("lasting")["steady"]["speed"])
    rows: list[dict[str, Any]] = []
    scene = own if settings.contact == "exact" else contact_twin(own)
    plant = _plant(scene, settings.rate)
    name = settings.out / f"feedback_{settings.contact}"
    count = 6 + len(settings.friction) + len(settings.delays) + 2 * len(settings.other_rates)
    bar = tqdm(_cases(plant, settings, speed), total=count, unit="case")
    for case, values in bar:
        bar.set_postfix_str(case)
        rows += [{"case": case, "policy": policy, **told} for policy, told in values.items()]
        save_json(f"{name}.json", {**measured(), **_said(settings, speed), "rows": rows})
    plot.save(figure(rows), f"{name}.png")
    keep_replay(plant, settings, Path(f"{name}.html"))
    for row in rows:
        print(f"{row['case']}, {row['policy']}: {row['rolling']:.0%}, {row['speed']:.2f} m/s")
    print(f"wrote {settings.out}/")


def keep_replay(plant: Plant, settings: Settings, path: Path) -> None:
    """One robot of the drops under each policy, side by side."""
    (q,), (v,) = drops(plant.scene, 1, settings.seed)
    seconds, every = 1.0 if settings.quick else SETTLING, _policy(1)
    motions = [
        simulate_policy(plant, jax.tree.map(lambda x, k=k: x[..., k], every), seconds, start=(q, v))
        for k in range(len(POLICIES))
    ]
    others = [
        view.Robot(motion.scene, motion, policy, (0.0, 3.0 * k, 0.0))
        for k, (motion, policy) in enumerate(zip(motions, POLICIES))
        if k
    ]
    view.keep_html(motions[0].scene, motions[0], path, others=others, title=", ".join(POLICIES))


def _plant(scene: Scene, rate: float) -> Plant:
    options = SolverOptions(dt=0.01 if scene.constrained else None, dtype="float32")
    motors = MotorLimits(rate=rate if math.isfinite(rate) else None)
    return plant_of(scene, load_gait("lasting").members, motors=motors, options=options)


def _said(settings: Settings, speed: float) -> dict[str, Any]:
    about = {"robots": settings.robots, "orbit_speed": speed, "impulse": IMPULSE, "bumps": BUMPS, "settling": SETTLING}
    return about | {"rate": settings.rate}


def _cases(plant: Plant, settings: Settings, speed: float):
    """The name of each case, and of all policies the share of robots that roll, and their mean speed, m/s."""
    there = dropped(plant, settings)
    yield f"dropped, after {SETTLING:.0f} s", _told(there, speed)
    rolled = _speeds(there) >= ENOUGH * speed
    before = there
    yield f"pushed by {IMPULSE:.0f} N s", _told(pushed(plant, settings, there.end), speed, among=rolled)
    for mu in settings.friction:
        factor = np.full(len(POLICIES) * settings.robots, mu / float(plant.scene.friction.sliding_mu))
        yield f"friction {mu:g}", _told(dropped(plant, settings, factor), speed)
    for delay in settings.delays:
        late = replace(plant, sensors=Sensors(delay=round(delay / plant.period)))
        yield f"sensors {1000 * delay:.0f} ms late", _told(dropped(late, settings), speed)
    rough, bumpy = _on_bumps(plant.scene, settings.seed), f"bumps of {100 * BUMPS:.0f} cm"
    yield bumpy, _told(dropped(_plant(rough, settings.rate), settings), speed)
    steep = _plant(ground_of(Task("uphill", incline=np.radians(SLOPE)), plant.scene, seed=0), settings.rate)
    slope = f"slope of {SLOPE:.0f} degrees"
    yield f"{slope}, any way", _told(dropped(steep, settings), speed)
    for name, sign in (("up", 1.0), ("down", -1.0)):
        ahead = _moved(before) / (np.linalg.norm(_moved(before), axis=0) + 1e-9)
        there = leaning(plant, settings, before.end, sign * ahead)
        yield f"{slope}, on the way {name}", _told(there, speed, among=rolled, towards=ahead)
    for rate in settings.other_rates:
        motors = f"motors of {rate:g} m/s" if math.isfinite(rate) else "unbounded motors"
        for name, scene in (("dropped", plant.scene), (bumpy, rough)):
            yield f"{name}, {motors}", _told(dropped(_plant(scene, rate), settings), speed)


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


def dropped(plant: Plant, settings: Settings, friction: np.ndarray | None = None) -> Drive:
    """All thirds from the same drops; where they get to in `SETTLING`."""
    count, every = settings.robots, len(POLICIES) * settings.robots
    many = side_by_side(plant, every, Differences(friction=np.ones(every) if friction is None else friction))
    ground = plant.scene.ground
    height = np.array([0, 0, 4 * BUMPS if ground.surface is not None else 0.6 * np.tan(ground.incline)])
    q, v = (np.tile(x, (len(POLICIES), 1, 1)) for x in drops(plant.scene, count, settings.seed))
    start = np.moveaxis(q + height, 0, -1), np.moveaxis(v, 0, -1)
    policy = _policy(count)
    loop = loop_start(many, policy, jax.random.key(settings.seed), start, each=True)
    return _driven(many, policy, loop)


def pushed(plant: Plant, settings: Settings, loop: Loop) -> Drive:
    """Each robot with the impulse in a direction and at a time of its own, the same in all thirds, from where it is."""
    count, every = settings.robots, len(POLICIES) * settings.robots
    many, policy = side_by_side(plant, every, Differences(friction=np.ones(every))), _policy(count)
    draw = np.random.default_rng(settings.seed)
    angle = np.tile(draw.uniform(0, 2 * np.pi, count), len(POLICIES))
    when = np.tile(draw.integers(0, TIMES, count), len(POLICIES))
    kick = IMPULSE / float(plant.scene.structure.mass) * np.stack([np.cos(angle), np.sin(angle), 0 * angle])

    def stretch(loop: Loop, k):
        (q, v), now = loop.plant.motion, jnp.asarray(kick) * (when == k)
        state = loop.plant._replace(motion=(q, v + now.astype(v.dtype)))
        rolled = drive(many, policy, loop._replace(plant=state), round(PUSHES / TIMES / plant.period), each=True)
        return rolled.end, None

    loop, _ = jax.lax.scan(stretch, loop, jnp.arange(TIMES))
    return _driven(many, policy, loop)


def leaning(plant: Plant, settings: Settings, loop: Loop, uphill: np.ndarray) -> Drive:
    """From where robots are, on ground that rises from now on in the directions `uphill`, (2, robots)."""
    angle = np.radians(SLOPE)
    up = np.stack([*(np.sin(angle) * uphill), np.full(uphill.shape[1], np.cos(angle))], axis=-1)
    return _driven(side_by_side(plant, len(up), Differences(up=up)), _policy(settings.robots), loop)


def _driven(many: Plant, policy: PhaseLocked, loop: Loop) -> Drive:
    return drive(many, policy, loop, round(PART / many.period), round(SETTLING / PART), each=True)


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


@plot.styled
def figure(rows: list[dict[str, Any]]) -> Figure:
    """The share of robots that roll in every case."""
    chart = Figure(figsize=(6.5, 7), layout="constrained")
    axes = chart.subplots()
    for k, policy in enumerate(POLICIES):
        own = [row for row in rows if row["policy"] == policy]
        places = np.arange(len(own)) + 0.27 * (k - 1)
        axes.barh(places, [100 * row["rolling"] for row in own], height=0.25, label=policy)
        axes.set_yticks(np.arange(len(own)), [row["case"] for row in own])
    axes.set(xlabel="robots that roll (%)", xlim=(0, 103))
    axes.grid(axis="y", visible=False)
    axes.invert_yaxis()
    chart.legend(loc="outside upper right", ncols=3)
    return chart


if __name__ == "__main__":
    run(main, Settings)
