"""Gaits: rest lengths of the actuated members as periodic functions of time. A `Motor` (`motors.py`) is something else:
it winds one member towards commanded lengths."""

from types import ModuleType

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxgrity.core.arguments import check_all_finite, check_count, check_each, is_count
from jaxgrity.core.display import of_report
from jaxgrity.core.elementwise import derived_as
from jaxgrity.core.errors import InputError
from jaxgrity.core.primitives import place_rows, take_rows
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, PerActuator, PerMember, Scalar, Times, as_float, namespace_of
from jaxgrity.model.motors import wound
from jaxgrity.model.structure import Members, Structure

SAMPLES = 96
"""Fewest samples of a wave in which its steepest slope is sought."""
SAMPLES_OF_A_SINE = 19
"""Fewest samples in a period of its highest overtone: the slope is then right to a thousandth."""


class Overtone(eqx.Module):
    """One more sine, a_hk sin(2 pi h f_k t + phase_hk), in the rest length of every member k: see `Gait`."""

    size: PerActuator = eqx.field(converter=as_float)
    """amplitude of the sine relative to the gait's first sine; not negative"""
    phase: PerActuator = eqx.field(converter=as_float)
    """phase of the sine, rad"""

    def __check_init__(self):
        check_each("overtone.phase", self.phase)
        check_each("overtone.size", self.size, least=0.0)


class Gait(eqx.Module):
    """Periodic rest lengths: L_k(t) = L0_k (1 - delta_k/2 r(t) (1 + s_k(t))).

    s_k = sin(2 pi f_k t + phase_k), or with overtones the normalised Fourier series
    (sin(2 pi f_k t + phase_k) + sum_h a_hk sin(2 pi h f_k t + phase_hk))/(1 + sum_h a_hk), h = 2, 3, ..., between
    -1 and 1. The ramp r(t) = clip((t - start)/ramp, 0, 1) keeps the motion smooth. It starts when the robot has come to
    rest.

    A population of gaits is one `Gait` whose arrays have a row per gait; start and ramp are shared.
    """

    members: tuple[int, ...] = eqx.field(static=True)
    """numbers of the actuated members: struts count from 0, cables follow"""
    phase: PerActuator = eqx.field(converter=as_float)
    """phase of each actuated member, rad"""
    amplitude: PerActuator = eqx.field(converter=as_float)
    """delta: largest contraction of each member, from 0 to less than 1"""
    frequency: PerActuator = eqx.field(converter=as_float)
    """frequency f of each member, Hz, not negative"""
    start: Scalar = eqx.field(converter=as_float, default=0.0)
    """time at which the gait begins, s. If a step ends there, as with library gaits, the derivative with respect to it
    is the mean of two that differ"""
    ramp: Scalar = eqx.field(converter=as_float, default=1.0)
    """time in which the gait reaches its full amplitude, s"""
    overtones: tuple[Overtone, ...] = ()
    """further sines, at 2, 3, ... times the frequency"""
    robot: str | None = eqx.field(static=True, default=None)
    """fingerprint (`Structure.robot`) of the gait's robot; None: any robot with these members"""

    def __check_init__(self):
        check_each("gait.ramp", self.ramp, shape=(), above=0.0, unit="s")
        if isinstance(self.amplitude, np.ndarray) and np.any((self.amplitude < 0) | (self.amplitude >= 1)):
            worst = self.amplitude.min() if np.any(self.amplitude < 0) else self.amplitude.max()
            raise InputError(f"gait.amplitude = {worst}: expected 0 to less than 1; at 1 a rest length reaches zero")
        check_each("gait.frequency", self.frequency, least=0.0, unit="Hz")
        if np.ndim(self.members) != 1 or not all(is_count(k, -(2**31)) for k in self.members):
            raise InputError(f"gait.members = {np.ravel(self.members).tolist()}: expected whole numbers")
        check_each("gait.start", self.start, shape=())
        check_all_finite(self, "gait")

    def _repr_html_(self) -> str:
        return of_report("notebook", "gait_html")(self)


class Command(eqx.Module):
    """Rest lengths that a controller commands: L_k(t) = L0_k (1 - (now_k + rate_k (t - since))).

    In a closed loop it replaces the gait of a scene for one control period.
    """

    members: tuple[int, ...] = eqx.field(static=True)
    """numbers of the actuated members, as in a `Gait`"""
    now: PerActuator
    """contraction of each member at `since`"""
    rate: PerActuator
    """growth rate of that fraction, 1/s"""
    since: Scalar
    """start of the control period, s"""


class Commands(eqx.Module):
    """Rest lengths that a controller commanded over time: L_k(t) = L0_k (1 - c_k(t)), c_k linear between the times.

    A motion in a closed loop saves them. Before the first time and after the last, c_k continues at its rate there.
    """

    members: tuple[int, ...] = eqx.field(static=True)
    """numbers of the actuated members, as in a `Gait`"""
    times: Times
    """(times,), s, ascending; two or more"""
    contraction: AnyArray
    """(times, actuators), contraction of each member"""


Actuation = Gait | Command | Commands
"""Anything that changes rest lengths: a gait, a command, or recorded commands."""


def random_members(candidates: range, fraction: float, seed: int) -> tuple[int, ...]:
    """Random members, ascending: about `fraction` of the candidates, at least one, without replacement."""
    count = max(1, round(fraction * len(candidates)))
    chosen = np.random.default_rng(check_count("seed", seed, 0)).choice(np.asarray(candidates), count, replace=False)
    return tuple(sorted(int(k) for k in chosen))


def random_phases(gaits: int, actuators: int, seed: int) -> np.ndarray:
    """(gaits, actuators), random phases, uniform between 0 and 2 pi, rad."""
    shape = check_count("gaits", gaits, 0), check_count("actuators", actuators, 0)
    return np.random.default_rng(check_count("seed", seed, 0)).uniform(0, 2 * np.pi, shape)


def contraction(gait: Actuation, t: Scalar) -> PerActuator:
    """(actuators,), fraction by which each member is shortened at time t."""
    if isinstance(gait, Command):
        return gait.now + gait.rate * (t - gait.since)
    if isinstance(gait, Commands):
        k = jnp.clip(jnp.searchsorted(gait.times, t, side="right") - 1, 0, gait.times.shape[0] - 2)
        (t0, t1), (c0, c1) = gait.times[k + jnp.arange(2)], gait.contraction[k + jnp.arange(2)]
        return c0 + (c1 - c0) * ((t - t0) / (t1 - t0))
    r = _ramp(gait, t)
    angle = 2 * jnp.pi * t * gait.frequency
    return gait.amplitude / 2 * r * (1 + _wave(gait, angle, jnp))


def _wave(gait: Gait, angle: AnyArray, xp: ModuleType) -> AnyArray:
    """s, from -1 to 1, at an angle 2 pi f t, rad."""
    wave = xp.sin(angle + gait.phase)
    if gait.overtones:
        for h, overtone in enumerate(gait.overtones, start=2):
            wave = wave + overtone.size * xp.sin(h * angle + overtone.phase)
        wave = wave / (1 + sum(overtone.size for overtone in gait.overtones))
    return wave


def _wave_slope(gait: Gait, angle: AnyArray, xp: ModuleType) -> AnyArray:
    """The derivative of `_wave` in the angle."""
    slope = xp.cos(angle + gait.phase)
    if gait.overtones:
        for h, overtone in enumerate(gait.overtones, start=2):
            slope = slope + h * overtone.size * xp.cos(h * angle + overtone.phase)
        slope = slope / (1 + sum(overtone.size for overtone in gait.overtones))
    return slope


def _ramp(gait: Gait, t: Scalar) -> Scalar:
    """r(t); at a corner its derivative is the mean of both sides.

    Steps may end at a corner, and sums of steps miss it by their rounding: what is within that is at the corner.
    """
    share = jnp.asarray((t - gait.start) / gait.ramp)
    from_corner = jnp.minimum(share, 1 - share)
    rounding = 16 * jnp.finfo(share.dtype).eps * (1 + jnp.abs(t) / gait.ramp)
    sides = ((from_corner > rounding).astype(share.dtype) + (from_corner > -rounding).astype(share.dtype)) / 2
    return derived_as(jnp.clip(share, 0, 1), share * jax.lax.stop_gradient(sides))


def waves_ahead(gait: Gait, angle: AnyArray) -> Gait:
    """The gait with each member's wave `angle` (rad, one per actuated member) ahead; a negative angle delays it.

    Waves keep their shapes: harmonic h moves by h times the angle. The result has the precision of the gait.
    """
    dtype = gait.phase.dtype
    overtones = tuple(
        Overtone(each.size, (each.phase + h * angle).astype(dtype)) for h, each in enumerate(gait.overtones, start=2)
    )
    moved = eqx.tree_at(lambda g: g.phase, gait, (gait.phase + angle).astype(dtype))
    return eqx.tree_at(lambda g: g.overtones, moved, overtones) if overtones else moved


@typed
def rest_length(members: Members, gait: Actuation | None, t: Scalar, first: int) -> PerMember:
    """L(t) of the struts or of the cables, m; `first` is the number of the first of them in a gait."""
    count, own = len(members.edges), members.rest_length
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
    """(times, members), m: L(t) from `rest_length` at many times, in one program."""
    return jax.vmap(lambda t: rest_length(members, gait, t, first))(times)


def check_robot(gait: Gait, structure: Structure) -> None:
    """Raises `InputError` if the gait was made for another robot."""
    if gait.robot not in (None, structure.robot):
        raise InputError(
            f"gait: made for a robot of {gait.robot}; this one has {structure.robot}; expected a gait for this robot: "
            "one whose numbers you copy, or one that `jaxgrity search` finds"
        )


def check_fit(gait: Gait, structure: Structure) -> None:
    """Raises `InputError` if the gait does not fit the structure."""
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


def peak_rates(gait: Gait, rest_lengths: Float[AnyArray, "*robots actuators"]) -> PerActuator:
    """Largest |dL/dt| of each actuated member over a period after the ramp, m/s; also for a population.

    It is L0 delta/2 2 pi f max |s'|, with the wave's derivative s' with respect to its angle. For a single sine,
    max |s'| is 1. With overtones it comes from samples of the wave, and parabolas through them. Samples begin at the
    phase of the first harmonic, so the result depends only on the wave's shape. `rest_lengths` are L0, m,
    of one robot, or a row for each.
    """
    steepest: PerActuator | float = 1.0
    if gait.overtones:
        xp = namespace_of(gait.phase)
        size = xp.abs(_wave_slope(gait, _samples(gait) - gait.phase, xp))
        steepest = _highest(xp.concatenate([size[-1:], size, size[:1]]))
    return rest_lengths * gait.amplitude * np.pi * gait.frequency * steepest


def ramp_rates(gait: Gait, rest_lengths: Float[AnyArray, "*robots actuators"]) -> PerActuator:
    """Largest |dL/dt| of each actuated member in the gait's ramp, m/s; also for a population.

    It is that of L0 delta/2 |r' (1 + s) + r 2 pi f s'|. At one angle of the wave this is convex in r, so it is largest
    at the angle's last moment in the ramp, or at most r' (1 + s), which the top of the wave has at any r. So samples of
    the last period are enough. At the first and the last no parabola helps: the result is up to 0.04 % too small (1,000
    random gaits). `rest_lengths` are L0, m: (actuators,) of one robot, or a row for each.
    """
    xp = namespace_of(gait.phase)
    turn = 2 * np.pi * xp.maximum(gait.frequency, np.finfo(gait.phase.dtype).eps)
    samples = _samples(gait)
    before = samples * xp.minimum(1, turn * gait.ramp / samples[-1])  # the end of the ramp, and within the ramp
    r, angle = 1 - before / (turn * gait.ramp), turn * (gait.start + gait.ramp) - before
    rate = (1 + _wave(gait, angle, xp)) / gait.ramp + r * turn * _wave_slope(gait, angle, xp)
    return rest_lengths * gait.amplitude / 2 * _highest(xp.abs(rate))


def _samples(gait: Gait) -> AnyArray:
    """Angles of a period, rad, from 0 on, fine enough for the highest overtone: a row for each."""
    count = max(SAMPLES, SAMPLES_OF_A_SINE * (1 + len(gait.overtones)))
    angles = np.linspace(0, 2 * np.pi, count, endpoint=False).astype(gait.phase.dtype)
    return angles.reshape(-1, *[1] * np.ndim(gait.phase))


def _highest(size: AnyArray) -> AnyArray:
    """The largest along the first axis; between samples, that of a parabola through three of them."""
    xp, before, here, after = namespace_of(size), size[:-2], size[1:-1], size[2:]
    bend = 2 * here - before - after
    top = (here >= before) & (here > after)
    peaks = here + xp.where(top, (after - before) ** 2 / (8 * xp.where(top, bend, 1)), 0)
    return xp.maximum(peaks.max(0), xp.maximum(size[0], size[-1]))


def actuated_lengths(structure: Structure, members: tuple[int, ...]) -> PerMember:
    """(actuators,), rest lengths L0 of the actuated members, m."""
    return jnp.concatenate([jnp.asarray(m.rest_length) for m in structure.members])[np.array(members)]
