"""The robot as a controller sees it: once in a control period, commands go in and observations come out.

A plant has one robot, or many side by side, with the population as the last axis in memory (`populations/lanes.py`).
Steps and physics are the scene's own.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.control.motor_limits import MotorLimits, contraction_reached
from jaxgrity.control.possible_starts import lift_for, possible
from jaxgrity.control.sensors import Observation, Readings, Sensors, first_readings, measure, read
from jaxgrity.core.arguments import check_count, check_indices, check_key, check_number, is_number
from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, State
from jaxgrity.model.actuation import Command, Gait, actuated_lengths
from jaxgrity.model.scene import Scene, as_dtype, start_of, with_gait
from jaxgrity.populations.lanes import in_lanes, lane_axes, lanes_last, last_axes, over_lanes, step_axes
from jaxgrity.populations.metrics import actuator_tension, check_told_apart
from jaxgrity.populations.uncertainty import Differences
from jaxgrity.stepping.complementarity import Lift
from jaxgrity.stepping.discretisation import discretise, with_scales_and_mobility
from jaxgrity.stepping.loop import Carried, Step, advance, carried_at, state_of
from jaxgrity.stepping.options import Options, ResolvedOptions, resolve

PERFECT, UNBOUNDED = Sensors(), MotorLimits()
"""Defaults of a plant: sensors without errors, and motors without limits."""


class PlantState(NamedTuple):
    """The carry of a robot, its motors and its sensors from one control period to the next."""

    tick: Any
    """control periods since the start"""
    motion: State
    """q, m, and v, m/s, as the method carries them (`whole_state`)"""
    solver: Any
    """the method's carry"""
    contraction: AnyArray
    """(actuators,), contraction of each actuated member"""
    tension: AnyArray | None
    """(actuators,), N: force with which each member pulled in the last step; None if no motor has a largest force"""
    readings: Readings
    key: Any
    """of the noise to come"""


class Plant(eqx.Module):
    """A scene with motors and sensors, at a fixed step. Made by `plant_of`."""

    scene: Scene
    """without a gait; of many robots with the population last, as from `in_lanes`"""
    members: tuple[int, ...] = eqx.field(static=True)
    """which are actuated, as in a `Gait`"""
    options: ResolvedOptions = eqx.field(static=True)
    """whose step is fixed"""
    period: float = eqx.field(static=True)
    """s, from one command to the next"""
    sensors: Sensors = Sensors()
    motors: MotorLimits = MotorLimits()
    robots: int | None = eqx.field(static=True, default=None)
    """number of robots; None: one, without an axis for it"""

    @property
    def lift(self) -> Lift:
        """The map from one robot to all; "s" stands for the scene's axes."""
        return _lift_of(self, self.scene)

    @property
    def steps(self) -> int:
        """The number of the method's steps in a control period."""
        assert self.options.dt is not None, "`plant_of` refuses a method that adapts its step"
        return max(1, int(np.ceil(self.period / self.options.dt - 1e-6)))


def scenes_of(plant: Plant) -> list[Scene]:
    """The scene of each robot."""
    if plant.robots is None:
        return [plant.scene]
    axes, known = lane_axes(plant.scene), jax.tree.map(np.asarray, plant.scene)
    alone = lambda k: jax.tree.map(lambda x, axis: x if axis is None else x[..., k], known, axes)  # noqa: E731
    return [alone(k) for k in range(plant.robots)]


def check_one(plant: Plant, where: str) -> None:
    """Raise `InputError` for a plant of many robots."""
    if plant.robots is not None:
        raise InputError(f"{where}: the plant has {plant.robots} robots side by side; expected one, of `plant_of`")


def check_model(robot: Plant, model: Plant) -> None:
    """Raise `InputError` where a model's members or control period are not the robot's."""
    if (model.members, model.period) != (robot.members, robot.period):
        own, other = (f"members {plant.members} every {plant.period:g} s" for plant in (robot, model))
        raise InputError(f"model: {other}; expected {own}, as the robot has")


def whole_number(name: str, seconds: float, part: float) -> int:
    """The number of parts (s each) in some seconds. Raises `InputError` if it is not whole."""
    count = round(seconds / part) if is_number(seconds) and np.isfinite(seconds) else 0
    if count < 1 or abs(seconds / part - count) > 1e-6 * count:
        shown = f"{seconds:g}" if is_number(seconds) else repr(seconds)
        raise InputError(f"{name} = {shown} s: expected a multiple of {part:g} s")
    return count


@typed
def plant_of(
    scene: Scene,
    members: tuple[int, ...],
    *,
    period: float = 0.01,
    sensors: Sensors = PERFECT,
    motors: MotorLimits = UNBOUNDED,
    options: Options = None,
) -> Plant:
    """A scene as a plant of one robot; `side_by_side` makes many of it.

    Args:
        scene: the robot; its own gait does not count.
        members: the actuated ones, as in a `Gait`.
        period: s, from one command to the next; the method divides it into equal steps.
        sensors: their errors; by default none.
        motors: their limits; by default none.
        options: solver options; by default the scene's.

    Returns:
        The plant, for `simulate_policy`.

    Raises:
        InputError: bad options (see `resolve`), or a method with adaptive steps. No members or unknown ones. A period
            that is not positive. Motors with a largest force, if rigid struts share nodes.

    Example:
        >>> plant = jaxgrity.control.plant_of(jaxgrity.load_scene("exact"), members=(0, 1, 2, 3, 4, 5))
        >>> plant.period  # s
        0.01
    """
    if not np.size(members) or np.ndim(members) != 1:
        found = members if np.ndim(members) else type(members).__name__
        raise InputError(f"members = {found}: expected at least one that is actuated, as (0, 1, 2)")
    members = check_indices("members", members, scene.structure.member_count)
    period = check_number("period", period, above=0.0, unit="s")
    if motors.force is not None:
        check_told_apart(scene)
    zeros = np.zeros(len(members))
    scene = with_gait(scene, Gait(members, zeros, zeros, zeros))
    resolved = resolve(scene, period, options)
    if resolved.dt is None or resolved.method.implicit:
        raise InputError(f"method = {resolved.method.name!r}: expected an explicit one at a fixed step, for control")
    bare = as_dtype(with_scales_and_mobility(with_gait(scene, None)), resolved.dtype)
    return Plant(bare, members, resolved, float(period), sensors, motors)


@typed
def side_by_side(plant: Plant, robots: int, differences: Differences | None = None) -> Plant:
    """The plant of many robots; the rows of `differences` are robots.

    Raises `InputError` for a plant of many robots, fewer than one robot, or another number of differences. Differences
    of velocity are refused too: they belong to the start (`plant_start`).
    """
    check_one(plant, "side_by_side")
    robots = check_count("robots", robots, 1)
    if differences is not None and differences.velocities is not None:
        raise InputError("differences.velocities: a plant has none; expected them in the `start` of a rollout")
    if differences is not None:
        differences.check(plant.scene, robots)
    nothing = jnp.zeros((len(plant.members), robots), plant.options.dtype)
    same = Gait(plant.members, nothing, nothing, nothing)
    if differences is not None:
        differences = jax.tree.map(lambda x: jnp.asarray(x, plant.options.dtype), lanes_last(differences))
    scene, _ = in_lanes(plant.scene, same, differences)
    bare = eqx.tree_at(lambda s: s.gait, scene, None)
    return replace(plant, scene=bare, robots=robots)


@typed
def plant_start(plant: Plant, key: Any, start: State | None = None) -> PlantState:
    """The state at t = 0, with motors at rest and sensors on: from `start`, q and v; by default the scene's own.

    Raises `InputError` for a start of another shape, or if `key` is no key. A known start of one robot must not violate
    rigid struts, exact contact or supports. If many robots or traced starts violate them, the motion fails.
    """
    check_key(key)
    dtype = plant.options.dtype
    shapes = None if start is None else [np.shape(x) for x in start]
    if shapes is not None and shapes != 2 * [plant.scene.structure.nodes.shape]:
        expected = f"q and v of shape {plant.scene.structure.nodes.shape} each"
        raise InputError(f"start has arrays of shape {', '.join(map(str, sorted(set(shapes))))}: expected {expected}")
    motion = start_of(plant.scene) if start is None else jax.tree.map(lambda x: jnp.asarray(x, dtype), tuple(start))
    alone, constrained = plant.robots is None, plant.options.method.constrained
    return begun(plant, key, possible(plant.scene, motion, one=alone, constrained=constrained))


def begun(plant: Plant, key: Any, motion: State, tick: Any = 0, contraction: AnyArray | None = None) -> PlantState:
    """The state at the start of control period number `tick`, from q and v in the midst of a motion.

    `contraction` is that of the motors, (actuators,); by default none.
    """
    dtype = plant.options.dtype
    nothing = jnp.zeros((len(plant.members), *motion[0].shape[2:]), dtype)
    key, of_bias = jax.random.split(key)
    tension = nothing if plant.motors.force is not None else None
    reached = nothing if contraction is None else contraction
    state = PlantState(jnp.asarray(tick), motion, None, reached, tension, Readings(None, None), key)
    # forces in the midst of a motion are those of the lengths that were commanded, and of this time
    scene = _commanded(plant, state, reached)
    scheme, step = discretise(plant.options, _lift_of(plant, scene)), jnp.asarray(plant.period / plant.steps, dtype)
    motion, first = carried_at(scheme, scene, jnp.asarray(state.tick * plant.period, dtype), step, motion)
    state = state._replace(motion=(jnp.asarray(motion[0]), jnp.asarray(motion[1])), solver=first)
    if not plant.sensors.remember:
        return state
    return state._replace(readings=first_readings(plant.sensors, sense_now(plant, state), of_bias))


def whole_state(plant: Plant, state: PlantState) -> State:
    """Positions q, m, and velocities v, m/s, now. A rollout from this start continues the motion."""
    scene, now = _commanded(plant, state, state.contraction), state.tick * plant.period
    carried = Carried(state.motion, state.solver)
    if plant.robots is None:
        return state_of(scene, now, carried)
    return over_lanes(state_of, (lane_axes(scene), None, last_axes(carried)))(scene, now, carried)


def sense_now(plant: Plant, state: PlantState) -> Observation:
    """The readings of sensors without errors."""
    scene = _commanded(plant, state, state.contraction)
    axes = ("s", None, -1, -1)
    return _lift_of(plant, scene)(measure, axes)(scene, state.tick * plant.period, *state.motion)


@typed
def observe(plant: Plant, state: PlantState) -> tuple[Observation, PlantState]:
    """The sensors' readings, and the state afterwards. Call it once in a control period, before `actuate`."""
    key, of_noise = jax.random.split(state.key)
    seen, readings = read(plant.sensors, sense_now(plant, state), state.readings, state.tick, of_noise)
    return seen, state._replace(readings=readings, key=key)


@typed
def actuate(plant: Plant, state: PlantState, wanted: AnyArray) -> PlantState:
    """The state one control period later: motors move towards the `wanted` contractions at a constant rate.

    Differentiable in reverse mode, with recomputation step by step. Raises `InputError` for another number of
    contractions than of actuated members.
    """
    if np.shape(wanted) != state.contraction.shape:
        shapes = f"{np.shape(wanted)}: expected {state.contraction.shape}"
        raise InputError(f"commands have the shape {shapes}, one for each actuated member")
    lengths = plant.lift(lambda scene: actuated_lengths(scene.structure, plant.members), ("s",))(plant.scene)
    reached = contraction_reached(plant.motors, state.contraction, wanted, plant.period, lengths, state.tension)
    scene = _commanded(plant, state, reached)
    scheme = discretise(plant.options, _lift_of(plant, scene))
    h = jnp.asarray(plant.period / plant.steps, plant.options.dtype)

    def step(carry, k):
        before, _ = carry
        t0 = (state.tick * plant.steps + k) * h
        after = advance(scheme, scene, (t0, t0 + h), before)
        tension = None if plant.motors.force is None else _tension(plant, scene, Step(t0, h, before, after))
        return (after, tension), None

    kept = step if plant.options.method.recomputes else jax.checkpoint(step)
    first = Carried(state.motion, state.solver), state.tension
    (((q, v), memory), tension), _ = jax.lax.scan(kept, first, jnp.arange(plant.steps))
    v = jnp.where(jnp.isnan(wanted).any(0), jnp.nan, v)  # slack cables would hide it
    return PlantState(state.tick + 1, (q, v), memory, reached, tension, state.readings, state.key)


def _commanded(plant: Plant, state: PlantState, reached: AnyArray) -> Scene:
    """The scene with members that move from their present lengths to those at the end of the control period."""
    rate = (reached - state.contraction) / plant.period
    since = jnp.asarray(state.tick * plant.period, plant.options.dtype)
    command = Command(plant.members, state.contraction, rate, since)
    return eqx.tree_at(lambda s: s.gait, plant.scene, command, is_leaf=lambda x: x is None)


def _tension(plant: Plant, scene: Scene, step: Step) -> AnyArray:
    return _lift_of(plant, scene)(actuator_tension, ("s", step_axes(step.after)))(scene, step)


def _lift_of(plant: Plant, scene: Scene) -> Lift:
    return lift_for(scene, plant.robots is None)
