"""Tasks: what a robot is rewarded for, on which ground, and from which starts."""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.types import AnyArray, NodeVectors, State
from jaxgrity.model.ground import Ground
from jaxgrity.model.height_fields import bumps
from jaxgrity.model.scene import Scene
from jaxgrity.stepping.dynamics import centre_of_mass

DROP = 1.0, 2.0
"""m/s and rad/s, standard deviations of velocity and spin of a robot that has fallen"""


class Task(NamedTuple):
    """What is asked of a robot. In every control period it is rewarded by v·d for the velocity v of its centre of mass
    along the direction d that is wanted, m/s."""

    towards: str
    """what d is: "anywhere", the direction in which it moves; "heading", one drawn at the start; "goal", that to the
    goal; "uphill" """
    incline: float = 0.0
    """rad, of the ground"""
    bumps: float = 0.0
    """m, standard deviation of the ground's height"""
    fallen: bool = False
    """whether it starts in the air, any way up, moving and spinning; else it stands, turned about the vertical"""
    distance: float = 10.0
    """m, from the start to the goal, in a direction drawn at the start"""
    reached: float = 0.3
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
        raise InputError(f"task = {name!r}: unknown; expected one of {', '.join(TASKS)}")
    return TASKS[name]


def ground_of(task: Task, scene: Scene, seed: int) -> Scene:
    """The scene on the task's ground; bumps are drawn by `seed`. Raises `InputError` where it has no ground."""
    if scene.ground is None:
        raise InputError("this scene has no ground to roll on; expected [ground]")
    ground = scene.ground
    if task.incline:
        ground = dataclasses.replace(ground, incline=task.incline, surface=None)  # type: ignore[call-arg]
    if task.bumps:
        surface = bumps(task.bumps, 0.8, seed)
        ground = dataclasses.replace(ground, incline=0.0, surface=surface)  # type: ignore[call-arg]
    q = ground.set_down(np.asarray(scene.structure.nodes, float), -0.02)
    structure = dataclasses.replace(scene.structure, nodes=q)
    return dataclasses.replace(scene, ground=ground, structure=structure)


def task_start(task: Task, scene: Scene, key: Any) -> State:
    """A start, q and v, drawn by `key`: just above the ground, turned about the vertical, or fallen from the air."""
    turns, heights, speeds, spins = jax.random.split(key, 4)
    q = jnp.asarray(scene.structure.nodes)
    body = q - centre_of_mass(scene, q)
    if not task.fallen:
        angle = 2 * jnp.pi * jax.random.uniform(turns, (), q.dtype)
        c, s, none, one = jnp.cos(angle), jnp.sin(angle), jnp.zeros_like(angle), jnp.ones_like(angle)
        turn = jnp.stack([c, -s, none, s, c, none, none, none, one]).reshape(3, 3)
        return lifted(scene.ground, body @ turn.T, 0.02), jnp.zeros_like(q)
    body = body @ _any_turn(jax.random.normal(turns, (4,), q.dtype)).T
    speed, spin = (size * jax.random.normal(k, (3,), q.dtype) for size, k in zip(DROP, (speeds, spins)))
    height = 0.02 + jax.random.uniform(heights, (), q.dtype)
    return lifted(scene.ground, body, height), speed + jnp.cross(spin, body)


def lifted(ground: Ground | None, q: NodeVectors, height: AnyArray | float) -> NodeVectors:
    """The nodes moved up or down until the lowest is about `height`, m, above the ground."""
    assert ground is not None, "`ground_of` refuses a scene without a ground"
    for _ in range(2 if ground.surface is not None else 1):
        q = q + jnp.array([0.0, 0.0, 1.0], q.dtype) * (height - jnp.min(ground.signed_distance(q)))
    return q


def wanted_direction(task: Task, aim: AnyArray, place: AnyArray, velocity: AnyArray) -> AnyArray:
    """d, (2,), a unit vector, or shorter within a centimetre of the goal; `aim` is a heading or the goal's place."""
    if task.towards == "heading":
        return aim
    if task.towards == "uphill":
        return jnp.array([-1.0, 0.0], place.dtype)
    way = aim - place[:2] if task.towards == "goal" else velocity[:2]
    return way / jnp.sqrt(jnp.sum(way * way) + 1e-4)


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
