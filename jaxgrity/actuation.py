"""Gaits: rest lengths that change with time."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxgrity.primitives import place_rows, take_rows
from jaxgrity.structure import Members
from jaxgrity.types import PerActuator, PerMember, Scalar, as_float


class Gait(eqx.Module):
    """Sinusoidal rest lengths: L_k(t) = L0_k (1 - delta_k/2 r(t) (1 + sin(2 pi f_k t + phase_k))).

    r(t) = clip((t - start)/ramp, 0, 1) lets the robot settle first and keeps the motion smooth.
    """

    members: tuple[int, ...] = eqx.field(static=True)
    """which members are actuated: struts count from 0, cables go on after them"""
    phase: PerActuator = eqx.field(converter=as_float)
    """rad"""
    amplitude: PerActuator = eqx.field(converter=as_float)
    """delta: a member shortens by at most this fraction of its rest length"""
    frequency: PerActuator = eqx.field(converter=as_float)
    """f, Hz"""
    start: Scalar = eqx.field(converter=as_float, default=0.0)
    """s"""
    ramp: Scalar = eqx.field(converter=as_float, default=1.0)
    """s"""


def random_members(candidates: range, fraction: float, seed: int) -> tuple[int, ...]:
    """About `fraction` of the candidates (at least one), drawn at random without replacement, in ascending order."""
    count = max(1, round(fraction * len(candidates)))
    chosen = np.random.default_rng(seed).choice(np.asarray(candidates), count, replace=False)
    return tuple(sorted(int(k) for k in chosen))


def random_phases(gaits: int, actuators: int, seed: int) -> np.ndarray:
    """`gaits` rows of phases, uniform on the circle, rad."""
    return np.random.default_rng(seed).uniform(0, 2 * np.pi, (gaits, actuators))


def contraction(gait: Gait, t: Scalar) -> PerActuator:
    """By which fraction each actuated member is shortened at time t."""
    r = jnp.clip((t - gait.start) / gait.ramp, 0, 1)
    return gait.amplitude / 2 * r * (1 + jnp.sin(2 * jnp.pi * t * gait.frequency + gait.phase))


def rest_length(members: Members, gait: Gait | None, t: Scalar, first: int) -> PerMember:
    """L(t) of the struts or of the cables, m; `first` is the number that a gait gives to the first of them."""
    count = len(members.edges)
    slots = tuple(a for a, k in enumerate(gait.members) if first <= k < first + count) if gait else ()
    if gait is None or not slots:
        return members.rest_length
    rows = tuple(gait.members[a] - first for a in slots)
    shortened = contraction(gait, t)
    if slots != tuple(range(len(gait.members))):
        shortened = take_rows(shortened, slots)
    if rows != tuple(range(count)):
        shortened = place_rows(shortened, rows, count)
    return members.rest_length * (1 - shortened)
