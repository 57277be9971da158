"""Steering: struts on one side of the robot move further than those on the other, so that its path bends; and blends of
gaits."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxgrity.control.policies import Memory, Policy
from jaxgrity.control.sensors import Observation, turning_pairs
from jaxgrity.core.arguments import check_each, check_indices, check_number
from jaxgrity.core.errors import InputError
from jaxgrity.core.tracing import traced
from jaxgrity.core.typed import check_fields, typed
from jaxgrity.core.types import AnyArray, PerActuator, Scalar, as_float, as_float_or_none
from jaxgrity.model.structure import Structure

SLOWEST_TRAVEL = 0.05
"""Default of `Steered.slowest`, m/s, for robots of about a metre."""


class Steered(Policy):
    """A policy that turns the robot: it multiplies the command of strut k by 1 - s y_k.

    y_k says how far the strut's centre is to the left of the robot's centre of mass, seen along the direction of
    travel. Its unit is the largest distance of a strut's centre, as built. It follows from the struts' directions. With
    s > 0, struts on the left stay longer, and the path bends to the left (measured: docs/control.md).

    Without a goal, s is `bend`. With one, s is `bend` times clip(a/`full`, -1, 1), where a (rad) is the angle from the
    direction of travel to the goal, positive to the left.

    Raises `InputError` for a bend beyond -1 and 1, a goal that is not two finite numbers, and offsets for other members
    than the policy's.
    """

    policy: Policy
    bend: Scalar = eqx.field(converter=as_float)
    """at most 1 in size; positive: to the left"""
    offsets: AnyArray = eqx.field(converter=as_float)
    """(actuators, directions), from `centre_offsets`: where a strut's centre is, as a sum of what sensors tell"""
    goal: AnyArray | None = eqx.field(converter=as_float_or_none, default=None)
    """(2,), m; None: `bend` stays as it is"""
    full: Scalar = eqx.field(converter=as_float, default=0.8)
    """rad, from which angle to the goal on all of the bend is used"""
    averaged: Scalar = eqx.field(converter=as_float, default=1.0)
    """s, over which the direction of travel is averaged"""
    slowest: float = eqx.field(static=True, default=SLOWEST_TRAVEL)
    """m/s, below which there is hardly a direction of travel, and steering fades: less for small robots"""

    def __check_init__(self):
        check_fields(self)
        check_number("slowest", self.slowest, above=0.0, unit="m/s")
        check_each("offsets", self.offsets)
        check_each("full", self.full, above=0.0, unit="rad")
        check_each("averaged", self.averaged, above=0.0, unit="s")
        if not traced(self.bend) and not np.all(np.abs(np.asarray(self.bend)) <= 1):
            raise InputError(f"bend = {np.asarray(self.bend).tolist()}: expected numbers between -1 and 1")
        if self.goal is not None and np.shape(self.goal)[:1] != (2,):
            raise InputError(f"goal has the shape {np.shape(self.goal)}: expected (2,), a place (x, y), m")
        if self.goal is not None and not traced(self.goal) and not np.isfinite(self.goal).all():
            raise InputError(f"goal = {np.asarray(self.goal).tolist()}: expected finite numbers, m")
        if np.ndim(self.offsets) < 2 or np.shape(self.offsets)[0] != len(self.members):
            expected = f"({len(self.members)}, directions), of `centre_offsets`"
            raise InputError(f"offsets have the shape {np.shape(self.offsets)}: expected {expected}")

    @property
    def members(self) -> tuple[int, ...]:
        return self.policy.members

    def first(self) -> Memory:
        """The policy's memory, the last place, m, the velocity of travel, m/s, and the time, s."""
        return self.policy.first(), jnp.zeros(2), jnp.zeros(2), jnp.zeros(())

    def __call__(self, observation: Observation, t: Scalar, memory: Memory) -> tuple[PerActuator, Memory]:
        inner, last, travel, before = memory
        shape, told = np.shape(self.offsets), len(observation.directions)
        if shape[1] != told:
            raise InputError(
                f"offsets have the shape {shape}: the robot's sensors tell {told} directions; expected its own offsets"
            )
        wanted, inner = self.policy(observation, t, inner)
        place, passed = observation.place[:2], t - before
        fresh = jnp.where(before > 0, (place - last) / passed, 0)
        travel = travel + (1 - jnp.exp(-passed / self.averaged)) * (fresh - travel)
        left = jnp.stack([-travel[1], travel[0]])
        side = self.offsets @ (observation.directions[:, :2] @ left)
        side = side / jnp.sqrt(jnp.sum(travel * travel) + self.slowest**2)
        bend = self.bend
        if self.goal is not None:
            away = self.goal - place
            # straight ahead where the robot hardly moves, and smooth there
            slow = self.slowest * jnp.sqrt(jnp.sum(away * away) + self.slowest**2 * self.averaged**2)
            off = jnp.arctan2(jnp.dot(left, away), jnp.dot(travel, away) + slow)
            bend = bend * jnp.clip(off / self.full, -1, 1)
        return wanted * (1 - bend * side), (inner, place, travel, t)


class Blend(Policy):
    """The mean of two policies' commands, (1 - s) a + s b with s = `share`: a gradual change from one gait to another.
    Both clocks run on, whatever the share. Raises `InputError` for policies with different members."""

    one: Policy
    other: Policy
    share: Scalar = eqx.field(converter=as_float)
    """of the other one"""

    def __check_init__(self):
        check_fields(self)
        if self.one.members != self.other.members:
            raise InputError(f"other.members = {self.other.members}: expected {self.one.members}, those of the first")
        check_each("share", self.share, least=0.0, most=1.0)

    @property
    def members(self) -> tuple[int, ...]:
        return self.one.members

    def first(self) -> Memory:
        """The memories of both policies."""
        return self.one.first(), self.other.first()

    def __call__(self, observation: Observation, t: Scalar, memory: Memory) -> tuple[PerActuator, Memory]:
        asked, kept = zip(*(policy(observation, t, m) for policy, m in zip((self.one, self.other), memory)))
        return (1 - self.share) * asked[0] + self.share * asked[1], kept


def clock_moved(memory: Memory, times: AnyArray | float, jump: AnyArray | float) -> Memory:
    """The memory of a steered `PhaseLocked` policy with its clock multiplied by a factor, and advanced by `jump`, s."""
    (clock, until), *others = memory
    return ((clock * jnp.asarray(times, clock.dtype) + jnp.asarray(jump, clock.dtype), until), *others)


@typed
def centre_offsets(structure: Structure, members: tuple[int, ...]) -> np.ndarray:
    """The matrix B, (actuators, directions), for `Steered`: B d gives the places of struts from their directions d.

    Row k of B d is the offset of strut k's centre from the robot's centre of mass, in units of the largest offset. d
    are the directions that sensors measure, of struts and then of rigid bodies. B is the least-squares solution for
    the built shape. Raises `InputError` for a member that is no strut, and without members.
    """
    struts = structure.struts
    members = check_indices("members", members)
    if struts is None or not members or max(members) >= len(struts.edges):
        raise InputError(f"members = {list(members)}: expected struts alone, to steer by those on one side")
    x, mass = np.asarray(structure.nodes, float), np.asarray(structure.lumped_mass, float)
    first, second = np.array(turning_pairs(structure)).T
    directions = (x[first] - x[second]) / np.linalg.norm(x[first] - x[second], axis=1)[:, None]
    i, j = np.array(struts.edges).T
    centres = ((x[i] + x[j]) / 2 - mass @ x / mass.sum())[np.array(members)]
    return centres @ np.linalg.pinv(directions) / np.linalg.norm(centres, axis=1).max()
