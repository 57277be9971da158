"""Rollouts in a closed loop: a policy, sensors, motors and a robot, or many robots side by side."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.control.plant import Plant, PlantState, actuate, begun, check_one, observe, plant_start, whole_state
from jaxgrity.control.policies import Memory, Policy
from jaxgrity.core.arguments import check_count, check_number
from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, State
from jaxgrity.model.actuation import Commands
from jaxgrity.model.scene import floats_as
from jaxgrity.populations.lanes import last_axes, over_lanes
from jaxgrity.stepping.complementarity import ImpulseState
from jaxgrity.stepping.discretisation import state_failure
from jaxgrity.stepping.dynamics import centre_of_mass
from jaxgrity.stepping.simulate import Trajectory


class Loop(NamedTuple):
    """The state of a rollout in a closed loop."""

    plant: PlantState
    memory: Memory
    """of the policy"""


class Drive(NamedTuple):
    """Where robots are after a rollout in a closed loop."""

    path: AnyArray
    """(samples + 1, 3), or (samples + 1, 3, robots): the centre of mass at the start and after each sample, m"""
    end: Loop
    failure: AnyArray
    """index into `FAILURES`, of each robot; 0: succeeded"""


@typed
def loop_start(plant: Plant, policy: Policy, key: Any, start: State | None = None, *, each: bool = False) -> Loop:
    """The state of a closed loop at t = 0, for `roll_on` and `drive`.

    Args:
        plant: one robot, or many side by side.
        policy: a `Policy` for the plant's members.
        key: JAX random key of the sensors' errors.
        start: positions q, m, and velocities v, m/s, (nodes, 3) or (nodes, 3, robots) each; by default the scene's.
        each: whether each robot has its own policy parameters. All arrays of the policy then have the robots last.

    Returns:
        The state of the plant, and the policy's memory in the plant's precision.

    Raises:
        InputError: no policy, or no key. A policy for other members or another robot. `each` for a plant of one robot,
            or for a policy without a row for each. A start of another shape, or a known start of one robot that
            violates rigid struts, exact contact or supports.
    """
    if not isinstance(policy, Policy):
        raise InputError(f"policy is a {type(policy).__name__}: expected a Policy, such as OpenLoop(gait)")
    if policy.members != plant.members:
        raise InputError(f"policy.members = {policy.members}: expected {plant.members}, those of the plant")
    policy.check(plant.scene)
    memory, robots = policy.first(), plant.robots
    if each and robots is None:
        raise InputError("each = True: the plant has one robot; expected many, of `side_by_side`")
    if robots is not None and each:
        _check_each(policy, robots)
        memory = jax.vmap(type(policy).first, in_axes=(last_axes(policy),), out_axes=-1)(policy)
    elif robots is not None:
        memory = jax.tree.map(lambda x, count=robots: jnp.repeat(jnp.asarray(x)[..., None], count, axis=-1), memory)
    return Loop(plant_start(plant, key, start), floats_as(memory, plant.options.dtype))


@typed
def roll_on(
    plant: Plant, policy: Policy, loop: Loop, ticks: int, keep: Callable[[PlantState], Any], *, each: bool = False
) -> tuple[Loop, Any]:
    """Simulate some control periods. In each, sensors are read, the policy commands, and motors move.

    This is a `lax.scan`: you can jit it, and differentiate it in forward and reverse mode. Reverse mode recomputes each
    period. Derivatives of a failed rollout are not finite.

    Args:
        plant: one robot, or many side by side.
        policy: the controller; its arrays are its parameters.
        loop: the state to start from, as from `loop_start`.
        ticks: number of control periods.
        keep: function of the `PlantState` after each period. What it returns, a tree of arrays, is saved.
        each: whether each robot has its own policy parameters, as in `loop_start`.

    Returns:
        The state at the end, and the results of `keep`, with the control periods as first axis.
    """
    ask: Callable = type(policy).__call__
    policy = floats_as(policy, plant.options.dtype)
    if plant.robots is not None:
        if each:
            _check_each(policy, plant.robots)
        ask = over_lanes(ask, (last_axes(policy) if each else None, -1, None, -1))

    def tick(loop: Loop, _):
        seen, state = observe(plant, loop.plant)
        until = (state.tick + 1) * jnp.asarray(plant.period, plant.options.dtype)
        wanted, memory = ask(policy, seen, until, loop.memory)
        state = actuate(plant, state, wanted)
        return Loop(state, memory), keep(state)

    return jax.lax.scan(jax.checkpoint(tick), loop, length=ticks)


@typed
def drive(plant: Plant, policy: Policy, loop: Loop, ticks: int, samples: int = 1, *, each: bool = False) -> Drive:
    """Roll on for `samples` times `ticks` control periods, and record the centre of mass after each `ticks` of them.

    Raises `InputError` for numbers that are negative or not whole.
    """
    ticks, samples = check_count("ticks", ticks, 0), check_count("samples", samples, 0)
    return _driven(plant, policy, loop, ticks, samples, each)


@eqx.filter_jit
def _driven(plant: Plant, policy: Policy, loop: Loop, ticks: int, samples: int, each: bool) -> Drive:
    """`drive`, with numbers that are no arrays: those would be traced."""

    def sample(loop: Loop, _):
        loop, _ = roll_on(plant, policy, loop, ticks, lambda state: None, each=each)
        return loop, places(plant, loop)

    end, path = jax.lax.scan(sample, loop, length=samples)
    return Drive(jnp.concatenate([places(plant, loop)[None], path]), end, failures(plant, end))


def places(plant: Plant, loop: Loop) -> AnyArray:
    """(3,), or (3, robots), m: centres of mass."""
    return plant.lift(centre_of_mass, ("s", -1))(plant.scene, loop.plant.motion[0])


def failures(plant: Plant, loop: Loop) -> AnyArray:
    """The index into `FAILURES` of each robot; 0: no failure."""
    return plant.lift(state_failure, ("s", -1, -1))(plant.scene, *loop.plant.motion)


def taken_over(model: Plant, loop: Loop, each: int) -> Loop:
    """The robots' state as the start of some robots of a model for each of them, side by side.

    The model takes over motion, motors with their lengths and forces, time and memory; its sensors begin anew. Where
    both methods are complementarity stepping, the model's continues from the robots'; else it begins anew. For one
    robot `loop` has no axis of robots.
    """
    robots = loop.plant.motion[0].shape[2:]

    def spread(x):
        x = floats_as(x, model.options.dtype)
        return jnp.repeat(x if robots else x[..., None], each, axis=-1)

    motion = jax.tree.map(spread, loop.plant.motion)
    state = begun(model, loop.plant.key, motion, loop.plant.tick, spread(loop.plant.contraction))
    last, own = loop.plant.solver, state.solver
    if isinstance(last, ImpulseState) and isinstance(own, ImpulseState):
        # velocities that lie half of the robots' last step before, and not at the time of the start
        taken = spread(jnp.broadcast_to(last.step_size, robots))
        state = state._replace(motion=motion, solver=own._replace(step_size=taken))
    if state.tension is not None and loop.plant.tension is not None:
        state = state._replace(tension=spread(loop.plant.tension))
    return Loop(state, jax.tree.map(spread, loop.memory))


@typed
def simulate_policy(
    plant: Plant, policy: Policy, duration: float, *, start: State | None = None, seed: int = 0
) -> Trajectory:
    """One robot's motion under a policy.

    Args:
        plant: the robot, its sensors and motors, as from `plant_of`.
        policy: its controller.
        duration: s, rounded to whole control periods.
        start: q (nodes, 3), m, and v, m/s; by default the scene's, at rest.
        seed: seed of the sensors' noise.

    Returns:
        The motion, one frame for each control period, with the contractions of the motors (`commands`): forces and
        pictures take the rest lengths from them. Its scene has no gait. A failed rollout has a failure code.

    Raises:
        InputError: a plant of many robots, a policy for other members than the plant's, or a duration that is not
            positive.

    Example:
        >>> scene = jaxgrity.load_scene("exact")
        >>> policy = jaxgrity.control.OpenLoop(jaxgrity.load_gait("lasting"))
        >>> plant = jaxgrity.control.plant_of(scene, policy.members)
        >>> jaxgrity.control.simulate_policy(plant, policy, 0.1).positions.shape  # (frames, nodes, 3), m
        (11, 12, 3)
    """
    check_one(plant, "simulate_policy")
    duration = check_number("duration", duration, above=0.0, unit="s")
    loop = loop_start(plant, policy, jax.random.key(seed), start)
    ticks = max(1, round(duration / plant.period))
    later, failure = _motion(plant, policy, loop, ticks)
    return trajectory_of(plant, frame(plant, loop.plant), later, failure)


def trajectory_of(plant: Plant, first: Any, later: Any, failure: AnyArray) -> Trajectory:
    """The motion of one robot from its `frame`s: the first, and those after each control period."""
    (q, v), reached = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, later)
    times = plant.period * jnp.arange(len(q), dtype=q.dtype)
    return Trajectory(
        times=times,
        positions=q,
        velocities=v,
        failure=jnp.asarray(failure),
        steps=jnp.asarray((len(q) - 1) * plant.steps),
        rejected=jnp.asarray(0),
        method=plant.options.method.name,
        dt=plant.period / plant.steps,
        scene=plant.scene,
        commands=Commands(plant.members, times, reached),
    )


@eqx.filter_jit
def _motion(plant: Plant, policy: Policy, loop: Loop, ticks: int):
    end, motion = roll_on(plant, policy, loop, ticks, lambda state: frame(plant, state))
    return motion, state_failure(plant.scene, *end.plant.motion)


def frame(plant: Plant, state: PlantState) -> tuple[State, AnyArray]:
    """The robot's places, and the contraction of each motor."""
    return whole_state(plant, state), state.contraction


def _check_each(policy: Policy, robots: int) -> None:
    """Raise `InputError` for a policy with an array whose last axis is not one for each robot."""
    sizes = {np.shape(x)[-1] for x in jax.tree.leaves(policy) if np.ndim(x)}
    if sizes - {robots}:
        found = f"the last axes have {', '.join(map(str, sorted(sizes)))} rows"
        raise InputError(f"each = True: {found}; expected {robots}, one for each robot, in all arrays of the policy")
