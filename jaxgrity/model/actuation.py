"""Gaits: rest lengths that change with time."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.primitives import place_rows, take_rows
from jaxgrity.core.types import PerActuator, PerMember, Scalar, as_float
from jaxgrity.model.structure import Members


class Overtone(eqx.Module):
    """One more sine in every member's rest length, at a multiple of the gait's frequency."""

    size: PerActuator = eqx.field(converter=as_float)
    """of the sine, where the gait's own is 1; not negative"""
    phase: PerActuator = eqx.field(converter=as_float)
    """rad"""


class Gait(eqx.Module):
    """Periodic rest lengths: L_k(t) = L0_k (1 - delta_k/2 r(t) (1 + s_k(t))).

    s_k = sin(2 pi f_k t + phase_k), or with overtones the normalised Fourier series
    (sin(2 pi f_k t + phase_k) + sum_h a_hk sin(2 pi h f_k t + phase_hk))/(1 + sum_h a_hk), h = 2, 3, ..., which stays
    within -1 and 1. r(t) = clip((t - start)/ramp, 0, 1) lets the robot settle first and keeps the motion smooth.

    A population of gaits is one `Gait` whose arrays have a row for each; start and ramp are common to all.
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
    overtones: tuple[Overtone, ...] = ()
    """of twice the frequency, three times, and so on"""


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
    angle = 2 * jnp.pi * t * gait.frequency
    wave = jnp.sin(angle + gait.phase)
    if gait.overtones:
        for h, overtone in enumerate(gait.overtones, start=2):
            wave = wave + overtone.size * jnp.sin(h * angle + overtone.phase)
        wave = wave / (1 + sum(overtone.size for overtone in gait.overtones))
    return gait.amplitude / 2 * r * (1 + wave)


def rest_length(members: Members, gait: Gait | None, t: Scalar, first: int) -> PerMember:
    """L(t) of the struts or of the cables, m; `first` is the number that a gait gives to the first of them."""
    count = len(members.edges)
    works = {first + k for k in range(count) if k not in members.stuck}
    slots = tuple(a for a, k in enumerate(gait.members) if k in works) if gait else ()
    if gait is None or not slots:
        return members.rest_length
    rows = tuple(gait.members[a] - first for a in slots)
    shortened = contraction(gait, t)
    if slots != tuple(range(len(gait.members))):
        shortened = take_rows(shortened, slots)
    if rows != tuple(range(count)):
        shortened = place_rows(shortened, rows, count)
    return members.rest_length * (1 - shortened)
