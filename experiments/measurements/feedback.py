"""What feedback wins over the open loop on both contact models: drops, pushes, friction, late sensors, bumps, slopes.

Robots are dropped as in basin.py: a third of them actuated by the gait as it is, a third with its clock locked to their
rolling, and a third with feedback that was tuned on bumps, on other ground and from other drops than those here. After
15 s each is pushed by 1 N s, in a direction and at a time of its own within 5 s, and has 15 s more.
"""

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
    Drive,
    Loop,
    PhaseLocked,
    Plant,
    Scene,
    Sensors,
    SolverOptions,
    Task,
    as_dtype,
    bumps,
    contact_twin,
    drive,
    gait_record,
    ground_of,
    load_gait,
    load_scene,
    loop_start,
    plant_of,
    plot,
    side_by_side,
    simulate_policy,
    sure_footed,
    view,
    with_gait,
)
from jaxgrity.io.files import save_json

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
        settings.robots, settings.friction, settings.delays = 8, (0.5,), (0.1,)
    gait = load_gait("lasting")
    own = with_gait(load_scene("exact"), gait)
    speed = float(gait_record("lasting")["steady"]["speed"])
    rows: list[dict[str, Any]] = []
    scene = own if settings.contact == "exact" else contact_twin(own)
    plant = plant_of(scene, gait.members, options=_options(scene))
    name = settings.out / f"feedback_{settings.contact}"
    count = 5 + len(settings.friction) + len(settings.delays)
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


def _options(scene: Scene) -> SolverOptions:
    return SolverOptions(dt=0.01 if scene.constrained else None, dtype="float32")


def _said(settings: Settings, speed: float) -> dict[str, Any]:
    return {"robots": settings.robots, "orbit_speed": speed, "impulse": IMPULSE, "bumps": BUMPS, "settling": SETTLING}


def _cases(plant: Plant, settings: Settings, speed: float):
    """The name of each case, and of both policies the share of robots that roll, and their mean speed, m/s."""
    there = dropped(plant, settings)
    yield f"dropped, after {SETTLING:.0f} s", _told(there, speed)
    rolled = _speeds(there) >= ENOUGH * speed
    yield f"pushed by {IMPULSE:.0f} N s", _told(pushed(plant, settings, there.end), speed, among=rolled)
    for mu in settings.friction:
        factor = np.full(len(POLICIES) * settings.robots, mu / float(plant.scene.friction.sliding_mu))
        yield f"friction {mu:g}", _told(dropped(plant, settings, factor), speed)
    for delay in settings.delays:
        late = replace(plant, sensors=Sensors(delay=round(delay / plant.period)))
        yield f"sensors {1000 * delay:.0f} ms late", _told(dropped(late, settings), speed)
    rough = _on_bumps(plant.scene, settings.seed)
    yield f"bumps of {100 * BUMPS:.0f} cm", _told(dropped(_like(plant, rough), settings), speed)
    steep = ground_of(Task("uphill", incline=np.radians(SLOPE)), plant.scene, seed=0)
    there = dropped(_like(plant, steep), settings)
    ahead = np.diff(np.asarray(there.path)[-2:, 0], axis=0)[0]
    for name, chosen in (("up", ahead < 0), ("down", ahead > 0)):
        yield f"slope of {SLOPE:.0f} degrees, on the way {name}", _told(there, speed, among=chosen)


def _like(plant: Plant, scene: Scene) -> Plant:
    return plant_of(scene, plant.members, options=_options(scene))


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


def _driven(many: Plant, policy: PhaseLocked, loop: Loop) -> Drive:
    return drive(many, policy, loop, round(PART / many.period), round(SETTLING / PART), each=True)


def _speeds(there: Drive) -> np.ndarray:
    """(robots,), m/s, in the last part of the time; 0 where the rollout failed."""
    path = np.asarray(there.path)[-2:, :2]
    return np.where(np.asarray(there.failure) == 0, np.linalg.norm(path[1] - path[0], axis=0) / PART, 0.0)


def _told(there: Drive, speed: float, among: np.ndarray | None = None) -> dict[str, dict[str, float]]:
    """Of each third, among those robots that count: the share that roll as fast as the orbit, nearly, and the mean."""
    speeds = _speeds(there).reshape(len(POLICIES), -1)
    counted = np.ones(speeds.shape, bool) if among is None else among.reshape(len(POLICIES), -1)
    return {
        name: {
            "rolling": float(np.mean(own[chosen] >= ENOUGH * speed)) if chosen.any() else 0.0,
            "speed": float(own[chosen].mean()) if chosen.any() else 0.0,
            "counted": int(chosen.sum()),
        }
        for name, own, chosen in zip(POLICIES, speeds, counted)
    }


@plot.styled
def figure(rows: list[dict[str, Any]]) -> Figure:
    """The share of robots that roll in every case."""
    chart = Figure(figsize=(6, 5), layout="constrained")
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
