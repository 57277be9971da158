"""Tasks: reward, ground and starts."""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.arguments import check_key, check_number
from jaxgrity.core.errors import InputError, check_known
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, State
from jaxgrity.model.height_fields import bumps
from jaxgrity.model.rod_contact import set_above, set_down
from jaxgrity.model.scales import length_scale, speed_scale, time_scale
from jaxgrity.model.scene import Scene
from jaxgrity.stepping.dynamics import centre_of_mass

REACHED = 0.3
"""Default distance from a goal within which it counts as reached, m for a robot of one metre."""
DROP = 1.0, 2.0
"""Standard deviations of velocity (m/s) and spin (rad/s) of a robot that has been dropped, for a robot of one metre."""
CLEAR_BY = 0.02
"""Gap between the ground and the lowest node at the start, m for a robot of one metre."""
BUMPS = 0.8
"""Length of bumps, m for a robot of one metre."""
NEARBY = 1 / 30
"""Share of `Task.reached`, a centimetre of 30, within which the direction to a goal becomes shorter than one."""

TOWARDS = "anywhere", "heading", "goal", "uphill"
"""Directions of tasks."""


class Task(NamedTuple):
    """A task for a robot. The reward of every control period is its progress, m/s, less the cost of effort. Progress is
    v·d, with the velocity v of its centre of mass and the wanted direction d. Without a direction it is |u|, with
    du/dt = (v - u)/T and T = `averaged`: shaking in place earns nothing. A task of your own is a subclass with another
    `wanted_direction` or `progressed`."""

    towards: str
    """the direction d: "anywhere", none; "heading", one drawn at the start; "goal", that to the goal; "uphill" """
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
    averaged: float = 1.0
    """s, over which the velocity is averaged where every direction counts alike"""

    def wanted_direction(self, aim: AnyArray, place: AnyArray) -> AnyArray:
        """d, (2,), which is observed: a unit vector, shorter `NEARBY` the goal, or zeros if no direction is wanted.

        Args:
            aim: (2,), the heading or the goal's place, m, as drawn for the episode
            place: (3,), m, the centre of mass
        """
        if self.towards == "heading":
            return aim
        if self.towards == "goal":
            way = aim - place[:2]
            return way / jnp.sqrt(jnp.sum(way * way) + (NEARBY * self.reached) ** 2)
        # a ground with a negative incline falls towards -x
        up = -np.copysign(1.0, self.incline) if self.towards == "uphill" else 0.0
        return jnp.array([up, 0.0], place.dtype)

    @typed
    def progressed(
        self, aim: AnyArray, before: AnyArray, place: AnyArray, period: float, average: AnyArray
    ) -> tuple[AnyArray, AnyArray]:
        """The progress of a robot from `before` to `place`, (3,), m, in one period, s.

        Returns the progress, m/s, and the averaged velocity u, (2,), m/s; `average` is its earlier value.
        """
        velocity = (place - before)[:2] / period
        average = average + -float(np.expm1(-period / self.averaged)) * (velocity - average)
        if self.towards != "anywhere":
            return jnp.dot(velocity, self.wanted_direction(aim, before)), average
        return jnp.sqrt(jnp.sum(average * average) + 1e-12), average


TASKS: dict[str, Task] = {
    "speed": Task("anywhere"),
    "heading": Task("heading"),
    "goal": Task("goal"),
    "slope": Task("uphill", incline=np.radians(5.0)),
    "bumps": Task("heading", bumps=0.02),
    "recover": Task("heading", fallen=True),
}
"""The tasks by their names, for a robot of one metre."""


@typed
def find_task(task: str | Task, scene: Scene) -> Task:
    """The task of that name, scaled to the scene's robot; a task of your own as it is.

    Raises `InputError` for an unknown name, and for a task of your own whose direction is none, or whose numbers are
    negative, or with nothing `averaged` or `reached`. Its functions are tried on shapes alone.
    """
    if isinstance(task, Task):
        own = type(task)
        if own is not Task and own.wanted_direction is Task.wanted_direction and own.progressed is Task.progressed:
            raise InputError(
                f"{own.__name__}: has neither a wanted_direction nor a progressed of its own; expected one"
            )
        if task.towards not in TOWARDS:
            raise InputError(f"task.towards = {task.towards!r}: expected one of {', '.join(TOWARDS)}")
        check_number("task.incline", task.incline, least=-np.pi / 2, most=np.pi / 2, unit="rad")
        if not isinstance(task.fallen, bool | np.bool_):
            raise InputError(f"task.fallen = {task.fallen!r}: expected True or False")
        check_number("task.averaged", task.averaged, above=0.0, unit="s")
        for name in ("bumps", "distance"):
            check_number(f"task.{name}", getattr(task, name), least=0.0, unit="m")
        check_number("task.reached", task.reached, above=0.0, unit="m")
        aim, place = jnp.zeros(2), jnp.zeros(3)
        found = _tried(task, "wanted_direction", task.wanted_direction, aim, place)
        if getattr(found, "shape", None) != (2,):
            raise InputError(
                f"{type(task).__name__}.wanted_direction: returns {found}; expected an array of shape (2,), x and y"
            )
        found = _tried(
            task, "progressed", lambda *x: task.progressed(x[0], x[1], x[2], 0.01, x[3]), aim, place, place, aim
        )
        if not isinstance(found, tuple) or [getattr(x, "shape", None) for x in found] != [(), (2,)]:
            expected = "a number, and two to remember, of shape (2,)"
            raise InputError(f"{type(task).__name__}.progressed: returns {found}; expected {expected}")
        return task
    check_known("task", task, TASKS)
    named, size = TASKS[task], float(length_scale(scene))
    return named._replace(
        bumps=size * named.bumps,
        distance=size * named.distance,
        reached=size * named.reached,
        averaged=float(time_scale(scene)) * named.averaged,
    )


def _tried(task: Task, name: str, function: Callable, *given: AnyArray) -> Any:
    """The shapes of what a task's function returns. Raises `InputError` with what went wrong in it."""
    try:
        return jax.eval_shape(function, *given)
    except Exception as error:
        what = f"{type(error).__name__}: {str(error).strip().partition(chr(10))[0]}"
        wanted = f"a function as `Task.{name}`, in JAX: `jnp.where` in place of `if`"
        raise InputError(f"{type(task).__name__}.{name}: {what}; expected {wanted}") from error


@typed
def at_size(given: float | None, usual: float, scene: Scene) -> float:
    """The given distance, m; by default the one that is usual for a robot of one metre, at the size of the robot."""
    return usual * float(np.max(np.asarray(length_scale(scene)))) if given is None else given


@typed
def ground_of(task: Task, scene: Scene, seed: int) -> Scene:
    """The scene on the task's ground, its robot just above it; bumps are drawn by `seed`.

    A task without a ground keeps the scene's own; supports stay where they are. Raises `InputError` for a scene without
    ground, for one that is not level where the task has its own, and for supports of a robot that shall fall.
    """
    ground, size = scene.ground, float(length_scale(scene))
    if ground is None:
        raise InputError("this scene has no ground to roll on; expected [ground]")
    if task.towards == "uphill" and not task.incline and ground.incline < 0:
        found = f"ground.incline = {ground.incline:g}: it rises towards +x"
        raise InputError(f"{found}; expected a level plane, and this incline as that of the task that leads uphill")
    if task.incline or task.bumps:
        if ground.surface is not None or float(ground.incline) != 0 or scene.up is not None:
            raise InputError("ground: this task brings its own; expected a scene on a level plane")
        surface = bumps(task.bumps, BUMPS * size, seed) if task.bumps else None
        ground = dataclasses.replace(ground, incline=task.incline, surface=surface)  # type: ignore[call-arg]
    if scene.structure.fixed:
        if task.fallen:
            raise InputError("structure.fixed: this task lets the robot fall; expected one without supports")
        return dataclasses.replace(scene, ground=ground)
    placed = dataclasses.replace(scene, ground=ground)
    q = set_down(placed, np.asarray(scene.structure.nodes, float), -CLEAR_BY * size)
    return dataclasses.replace(placed, structure=dataclasses.replace(scene.structure, nodes=q))


@typed
def task_start(task: Task, scene: Scene, key: Any) -> State:
    """A start, q and v, drawn by `key`, in a random orientation: at rest just above the ground, or falling from the
    air.

    Its centre of mass starts above the same place as in the scene. A robot with supports starts as it is posed. The
    same key draws the same start in every precision. Raises `InputError` if `key` is no random key.
    """
    check_key(key)
    turns, heights, speeds, spins = jax.random.split(key, 4)
    q = jnp.asarray(scene.structure.nodes)
    if scene.structure.fixed:
        return q, jnp.zeros_like(q)
    centre = centre_of_mass(scene, q)
    body = (q - centre) @ _any_turn(_normal(turns, 4).astype(q.dtype)).T
    there = body + centre * jnp.array([1.0, 1.0, 0.0], q.dtype)
    size = length_scale(scene)
    assert scene.ground is not None, "`ground_of` refuses a scene without a ground"
    if not task.fallen:
        return set_above(scene, there, CLEAR_BY * size), jnp.zeros_like(q)
    falls = DROP[0] * speed_scale(scene), DROP[1] / time_scale(scene)
    speed, spin = (each * _normal(k, 3).astype(q.dtype) for each, k in zip(falls, (speeds, spins)))
    height = size * (CLEAR_BY + jax.random.uniform(heights, (), jnp.float32).astype(q.dtype))
    return set_above(scene, there, height), speed + jnp.cross(spin, body)


def _normal(key: Any, count: int) -> AnyArray:
    """Normal deviates, (count,), drawn in float32 whatever the precision of the robot."""
    return jax.random.normal(key, (count,), jnp.float32)


def drawn_aim(task: Task, place: AnyArray, key: Any) -> AnyArray:
    """(2,), a heading, or a goal at its distance from `place`."""
    angle = 2 * jnp.pi * jax.random.uniform(key, (), jnp.float32).astype(place.dtype)
    heading = jnp.stack([jnp.cos(angle), jnp.sin(angle)])
    return place[:2] + task.distance * heading if task.towards == "goal" else heading


def _any_turn(four: AnyArray) -> AnyArray:
    """The rotation of a quaternion; uniform for four normal deviates."""
    w, x, y, z = four / jnp.sqrt(jnp.sum(four * four) + jnp.finfo(four.dtype).tiny)
    rows = (
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    )
    return jnp.stack([jnp.stack(row) for row in rows])
