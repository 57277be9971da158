"""Tasks: what a robot is rewarded for, on which ground, and from which starts."""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.typed import typed
from jaxgrity.core.errors import InputError, unknown
from jaxgrity.core.types import AnyArray, NodeVectors, State
from jaxgrity.model.ground import Ground
from jaxgrity.model.height_fields import bumps
from jaxgrity.model.scales import length_scale, speed_scale, time_scale
from jaxgrity.model.scene import Scene
from jaxgrity.stepping.dynamics import centre_of_mass

REACHED = 0.3
"""m, from a goal, within which it counts as reached, where nothing else is said"""
DROP = 1.0, 2.0
"""m/s and rad/s, standard deviations of velocity and spin of a robot of one metre that has fallen"""
CLEAR = 0.02
"""m, between the ground and the lowest node of a robot of one metre that starts"""
BUMPS = 0.8
"""m, length of bumps for a robot of one metre"""
AVERAGED = 1.0
"""s, over which the velocity of a robot of one metre is averaged where any direction is as good as another"""


class Task(NamedTuple):
    """What is asked of a robot. In every control period it is rewarded for its progress, m/s: for v·d, with the
    velocity v of its centre of mass and the direction d that is wanted. Where no direction is, for |u| with
    du/dt = (v - u)/T, T = `AVERAGED`: shaking in place gets it nowhere."""

    towards: str
    """what d is: "anywhere", none; "heading", one drawn at the start; "goal", that to the goal; "uphill" """
    incline: float = 0.0
    """rad, of the ground"""
    bumps: float = 0.0
    """m, standard deviation of the ground's height"""
    fallen: bool = False
    """whether it starts high in the air, moving and spinning; else at rest, just above the ground; any way up"""
    distance: float = 10.0
    """m, from the start to the goal, in a direction drawn at the start"""
    reached: float = REACHED
    """m, from the goal, within which the episode is done"""


TASKS: dict[str, Task] = {
    "speed": Task("anywhere"),
    "heading": Task("heading"),
    "goal": Task("goal"),
    "slope": Task("uphill", incline=np.radians(5.0)),
    "bumps": Task("heading", bumps=0.02),
    "recover": Task("heading", fallen=True),
}
"""the tasks by their names"""


def find_task(name: str) -> Task:
    """The task called `name`. Raises `InputError` where there is none."""
    if name not in TASKS:
        raise InputError(f"task = {name!r}: {unknown(name, TASKS)}; expected one of {', '.join(TASKS)}")
    return TASKS[name]


@typed
def ground_of(task: Task, scene: Scene, seed: int) -> Scene:
    """The scene on the task's ground, its robot just above it; bumps are drawn by `seed`.

    A task that says nothing of the ground leaves the scene's own. Raises `InputError` where the scene has no ground, or
    one that is not level although the task brings its own.
    """
    ground, size = scene.ground, float(length_scale(scene))
    if ground is None:
        raise InputError("this scene has no ground to roll on; expected [ground]")
    if task.incline or task.bumps:
        if ground.surface is not None or float(ground.incline) != 0:
            raise InputError("ground: this task brings its own; expected a scene on a level plane")
        surface = bumps(task.bumps, BUMPS * size, seed) if task.bumps else None
        ground = dataclasses.replace(ground, incline=task.incline, surface=surface)  # type: ignore[call-arg]
    q = ground.set_down(np.asarray(scene.structure.nodes, float), -CLEAR * size, size)
    structure = dataclasses.replace(scene.structure, nodes=q)
    return dataclasses.replace(scene, ground=ground, structure=structure)


@typed
def task_start(task: Task, scene: Scene, key: Any) -> State:
    """A start, q and v, drawn by `key`, turned anyhow: at rest just above the ground, or falling from the air."""
    turns, heights, speeds, spins = jax.random.split(key, 4)
    q = jnp.asarray(scene.structure.nodes)
    body = (q - centre_of_mass(scene, q)) @ _any_turn(jax.random.normal(turns, (4,), q.dtype)).T
    size = length_scale(scene)
    if not task.fallen:
        return lifted(scene.ground, body, CLEAR * size), jnp.zeros_like(q)
    falls = DROP[0] * speed_scale(scene), DROP[1] / time_scale(scene)
    speed, spin = (each * jax.random.normal(k, (3,), q.dtype) for each, k in zip(falls, (speeds, spins)))
    height = size * (CLEAR + jax.random.uniform(heights, (), q.dtype))
    return lifted(scene.ground, body, height), speed + jnp.cross(spin, body)


def lifted(ground: Ground | None, q: NodeVectors, height: AnyArray | float) -> NodeVectors:
    """The nodes moved up or down until the lowest is about `height`, m, above the ground."""
    assert ground is not None, "`ground_of` refuses a scene without a ground"
    for _ in range(2 if ground.surface is not None else 1):
        q = q + jnp.array([0.0, 0.0, 1.0], q.dtype) * (height - jnp.min(ground.signed_distance(q)))
    return q


def wanted_direction(task: Task, aim: AnyArray, place: AnyArray) -> AnyArray:
    """d, (2,), a unit vector, or shorter within a centimetre of the goal; `aim` is a heading or the goal's place. Where
    no direction is wanted, zeros."""
    if task.towards == "heading":
        return aim
    if task.towards == "goal":
        way = aim - place[:2]
        return way / jnp.sqrt(jnp.sum(way * way) + 1e-4)
    return jnp.array([-1.0 if task.towards == "uphill" else 0.0, 0.0], place.dtype)


@typed
def progressed(
    task: Task, aim: AnyArray, before: AnyArray, place: AnyArray, period: float, average: AnyArray
) -> tuple[AnyArray, AnyArray]:
    """How well a robot does that was at `before` one period, s, ago and is at `place`, (3,), m.

    Returns its progress, m/s, and the averaged velocity u, (2,), m/s, which was `average` a period ago.
    """
    velocity = (place - before)[:2] / period
    average = average + -float(np.expm1(-period / AVERAGED)) * (velocity - average)
    if task.towards != "anywhere":
        return jnp.dot(velocity, wanted_direction(task, aim, before)), average
    return jnp.sqrt(jnp.sum(average * average) + 1e-12), average


def drawn_aim(task: Task, place: AnyArray, key: Any) -> AnyArray:
    """(2,), a heading, or a goal at its distance from `place`."""
    angle = 2 * jnp.pi * jax.random.uniform(key, (), place.dtype)
    heading = jnp.stack([jnp.cos(angle), jnp.sin(angle)])
    return place[:2] + task.distance * heading if task.towards == "goal" else heading


def _any_turn(four: AnyArray) -> AnyArray:
    """The rotation of a quaternion; of four normal deviates, one as likely as any other."""
    w, x, y, z = four / jnp.sqrt(jnp.sum(four * four) + jnp.finfo(four.dtype).tiny)
    rows = (
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    )
    return jnp.stack([jnp.stack(row) for row in rows])
