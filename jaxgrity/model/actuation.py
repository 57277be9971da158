"""Gaits: rest lengths that change with time."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.arguments import check_all_finite, is_count
from jaxgrity.core.display import of_report
from jaxgrity.core.errors import InputError
from jaxgrity.core.primitives import place_rows, take_rows
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, PerActuator, PerMember, Scalar, Times, as_float, namespace_of
from jaxgrity.model.motors import wound
from jaxgrity.model.structure import Members, Structure


class Overtone(eqx.Module):
    """One more sine in every member's rest length, at a multiple of the gait's frequency."""

    size: PerActuator = eqx.field(converter=as_float)
    """of the sine, where the gait's own is 1; not negative"""
    phase: PerActuator = eqx.field(converter=as_float)
    """rad"""

    def __check_init__(self):
        if isinstance(self.size, np.ndarray) and np.any(self.size < 0):
            raise InputError(f"overtone.size = {self.size.min()}: expected none negative; move the phase by pi instead")


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
    """delta: a member shortens by at most this fraction of its rest length; 0 or more, less than 1"""
    frequency: PerActuator = eqx.field(converter=as_float)
    """f, Hz, not negative"""
    start: Scalar = eqx.field(converter=as_float, default=0.0)
    """s; where it is the end of a step, as of the library's gaits, the motion's derivative in it has two sides"""
    ramp: Scalar = eqx.field(converter=as_float, default=1.0)
    """s"""
    overtones: tuple[Overtone, ...] = ()
    """of twice the frequency, three times, and so on"""
    robot: str | None = eqx.field(static=True, default=None)
    """`Structure.robot` of the one that it is for; None: any that has these members"""

    def __check_init__(self):
        if isinstance(self.ramp, np.ndarray) and not np.all(self.ramp > 0):
            raise InputError(f"gait.ramp = {self.ramp}: expected a positive time, s, however short")
        if isinstance(self.amplitude, np.ndarray) and np.any((self.amplitude < 0) | (self.amplitude >= 1)):
            worst = self.amplitude.min() if np.any(self.amplitude < 0) else self.amplitude.max()
            raise InputError(
                f"gait.amplitude = {worst}: expected from 0 to less than 1, at which a rest length reaches zero"
            )
        if isinstance(self.frequency, np.ndarray) and np.any(self.frequency < 0):
            raise InputError(f"gait.frequency = {self.frequency.min()} Hz: expected none negative")
        for k in self.members:
            if not (is_count(k, 0) or is_count(-k, 0)):
                raise InputError(f"gait.members = {list(self.members)}: expected whole numbers")
        check_all_finite(self, "gait")

    def _repr_html_(self) -> str:
        return of_report("notebook", "gait_html")(self)


class Command(eqx.Module):
    """Rest lengths that a controller asks for: L_k(t) = L0_k (1 - (now_k + rate_k (t - since))).

    In a closed loop it stands in a scene in the place of its gait, for one control period at a time.
    """

    members: tuple[int, ...] = eqx.field(static=True)
    """which members are actuated, as in a `Gait`"""
    now: PerActuator
    """by which fraction each is shortened at `since`"""
    rate: PerActuator
    """1/s, by which that fraction grows"""
    since: Scalar
    """s"""


class Commands(eqx.Module):
    """Rest lengths that a controller asked for over time: L_k(t) = L0_k (1 - c_k(t)), c_k linear between the times.

    What a motion in a closed loop remembers of its controller. Before the first time and after the last one c_k goes
    on at the rate that it has there.
    """

    members: tuple[int, ...] = eqx.field(static=True)
    """which members are actuated, as in a `Gait`"""
    times: Times
    """(times,), s, ascending; two or more"""
    contraction: AnyArray
    """(times, actuators), by which fraction each is shortened"""


Actuation = Gait | Command | Commands
"""What changes rest lengths: a gait, a command, or the commands that were given."""


def random_members(candidates: range, fraction: float, seed: int) -> tuple[int, ...]:
    """About `fraction` of the candidates (at least one), drawn at random without replacement, in ascending order."""
    count = max(1, round(fraction * len(candidates)))
    chosen = np.random.default_rng(seed).choice(np.asarray(candidates), count, replace=False)
    return tuple(sorted(int(k) for k in chosen))


def random_phases(gaits: int, actuators: int, seed: int) -> np.ndarray:
    """`gaits` rows of phases, uniform on the circle, rad."""
    return np.random.default_rng(seed).uniform(0, 2 * np.pi, (gaits, actuators))


def contraction(gait: Actuation, t: Scalar) -> PerActuator:
    """By which fraction each actuated member is shortened at time t."""
    if isinstance(gait, Command):
        return gait.now + gait.rate * (t - gait.since)
    if isinstance(gait, Commands):
        k = jnp.clip(jnp.searchsorted(gait.times, t, side="right") - 1, 0, gait.times.shape[0] - 2)
        (t0, t1), (c0, c1) = gait.times[k + jnp.arange(2)], gait.contraction[k + jnp.arange(2)]
        return c0 + (c1 - c0) * ((t - t0) / (t1 - t0))
    r = jnp.clip((t - gait.start) / gait.ramp, 0, 1)
    angle = 2 * jnp.pi * t * gait.frequency
    wave = jnp.sin(angle + gait.phase)
    if gait.overtones:
        for h, overtone in enumerate(gait.overtones, start=2):
            wave = wave + overtone.size * jnp.sin(h * angle + overtone.phase)
        wave = wave / (1 + sum(overtone.size for overtone in gait.overtones))
    return gait.amplitude / 2 * r * (1 + wave)


def waves_ahead(gait: Gait, angle: AnyArray) -> Gait:
    """The gait whose waves are `angle` (rad, of each actuated member) ahead, and keep their shapes.

    Harmonic h moves by h times as much, as where an actuator is early, or late where the angle is negative. In the
    precision of the gait.
    """
    dtype = gait.phase.dtype
    overtones = tuple(
        Overtone(each.size, (each.phase + h * angle).astype(dtype)) for h, each in enumerate(gait.overtones, start=2)
    )
    moved = eqx.tree_at(lambda g: g.phase, gait, (gait.phase + angle).astype(dtype))
    return eqx.tree_at(lambda g: g.overtones, moved, overtones) if overtones else moved


@typed
def rest_length(members: Members, gait: Actuation | None, t: Scalar, first: int) -> PerMember:
    """L(t) of the struts or of the cables, m; `first` is the number that a gait gives to the first of them."""
    count = len(members.edges)
    own = members.rest_length
    for motor in members.motors:
        change = jnp.asarray(wound(motor, take_rows(members.rest_length, (motor.member,))[0], t))
        own = own + place_rows(change[None], (motor.member,), count)
    works = {first + k for k in range(count) if k not in members.stuck}
    slots = tuple(a for a, k in enumerate(gait.members) if k in works) if gait else ()
    if gait is None or not slots:
        return own
    rows = tuple(gait.members[a] - first for a in slots)
    shortened = contraction(gait, t)
    if slots != tuple(range(len(gait.members))):
        shortened = take_rows(shortened, slots)
    if rows != tuple(range(count)):
        shortened = place_rows(shortened, rows, count)
    return own * (1 - shortened)


@eqx.filter_jit
def rest_lengths_along(members: Members, gait: Actuation | None, times: Times, first: int) -> AnyArray:
    """(times, members), m: L(t) as `rest_length` says, at many times in one program."""
    return jax.vmap(lambda t: rest_length(members, gait, t, first))(times)


def check_robot(gait: Gait, structure: Structure) -> None:
    """Raises `InputError` where the gait is that of another robot."""
    if gait.robot not in (None, structure.robot):
        raise InputError(
            f"gait: that of another robot, of {gait.robot}; this one has {structure.robot}; expected a gait of its own"
        )


def check_fit(gait: Gait, structure: Structure) -> None:
    """Raises `InputError` where the gait does not fit the structure."""
    check_robot(gait, structure)
    members = structure.member_count
    if len(set(gait.members)) < len(gait.members):
        raise InputError(f"gait.members = {list(gait.members)}: expected each member once")
    for k in gait.members:
        if not 0 <= k < members:
            known = f"0 to {members - 1}, struts first" if members else "no gait, since there are no members"
            raise InputError(f"gait.members names member {k}; expected {known}")
    driven = set(gait.members) & set(structure.driven)
    if driven:
        raise InputError(f"gait.members names {sorted(driven)}, which have motors; expected members without")
    parts = {name: getattr(gait, name) for name in ("phase", "amplitude", "frequency")}
    for h, overtone in enumerate(gait.overtones, start=2):
        parts |= {f"overtone {h}, size": overtone.size, f"overtone {h}, phase": overtone.phase}
    for name, part in parts.items():
        if np.shape(part) != (len(gait.members),):
            raise InputError(
                f"gait.{name} has shape {np.shape(part)}; expected one number for each of the "
                f"{len(gait.members)} actuated members"
            )


def peak_rates(gait: Gait, rest_lengths: PerMember, samples: int = 96) -> PerActuator:
    """The largest |dL/dt| of every actuated member over a period, m/s, once the ramp is over; of a population too.

    L0 delta/2 2 pi f max |s'|, s' being the wave's derivative in its angle: 1 for a single sine. With overtones it is
    the largest of so many `samples`, which begin with the first harmonic, so that it depends on the wave's shape alone,
    and of the parabolas through three of them. `rest_lengths` are L0, m, (actuators,).
    """
    steepest: PerActuator | float = 1.0
    if gait.overtones:
        xp = namespace_of(gait.phase)
        angles = np.linspace(0, 2 * np.pi, samples, endpoint=False).reshape(-1, *[1] * np.ndim(gait.phase))
        angles = angles.astype(gait.phase.dtype)
        slope = xp.cos(angles) + 0 * gait.phase
        for h, overtone in enumerate(gait.overtones, start=2):
            slope = slope + h * overtone.size * xp.cos(h * angles + overtone.phase - h * gait.phase)
        size = abs(slope)
        before, after = xp.roll(size, 1, axis=0), xp.roll(size, -1, axis=0)
        bend = 2 * size - before - after
        top = (size >= before) & (size >= after) & (bend > 0)
        peaks = size + xp.where(top, (after - before) ** 2 / (8 * xp.where(top, bend, 1)), 0)
        steepest = peaks.max(0) / (1 + sum(overtone.size for overtone in gait.overtones))
    return rest_lengths * gait.amplitude * np.pi * gait.frequency * steepest


def actuated_lengths(structure: Structure, members: tuple[int, ...]) -> PerMember:
    """Rest lengths of the actuated members, m, as built."""
    kinds = [m for m in (structure.struts, structure.cables) if m is not None]
    return jnp.concatenate([jnp.asarray(m.rest_length) for m in kinds])[np.array(members)]
