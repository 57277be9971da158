"""Motors that wind a member: rest lengths that go from one length asked for to the next, as fast as a motor can.

A motor is an exact function of time, so that no method has to carry a state for it: what it does does not depend on
the robot. A limit on the force is a law of its own (`force_laws.force_limit`).
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.arguments import check_all_finite, check_index, check_scalar
from jaxgrity.core.errors import InputError
from jaxgrity.core.types import AnyArray, Scalar, as_float, as_float_or_none


class Motor(eqx.Module):
    """Winds a member towards each length asked for until it is there, or the next is asked for.

    The wound length w changes at `rate`, and stops at `smallest`; the rest length lags behind it, L' = (w - L)/lag.
    Before the first time, both are the member's own rest length.

    Raises `InputError` where numbers do not fit.
    """

    member: int = eqx.field(static=True)
    """which of the struts, or of the cables, from 0"""
    times: AnyArray = eqx.field(converter=as_float)
    """(commands,), s, ascending: when a length is asked for"""
    lengths: AnyArray = eqx.field(converter=as_float)
    """(commands,), m, the rest lengths then asked for"""
    rate: Scalar = eqx.field(converter=as_float)
    """m/s, at which the motor winds in and pays out"""
    lag: Scalar | None = eqx.field(converter=as_float_or_none, default=None)
    """s; None: none"""
    smallest: Scalar | None = eqx.field(converter=as_float_or_none, default=None)
    """m, the length at which the spool stops; None: it does not"""

    def __check_init__(self):
        check_index("motor.member", self.member)
        where = f"motor of member {self.member}"
        check_all_finite(self, where)
        for name in ("rate", "lag", "smallest"):
            check_scalar(f"{where}.{name}", 0.0 if getattr(self, name) is None else getattr(self, name))
        if np.ndim(self.times) != 1 or np.shape(self.times) != np.shape(self.lengths) or not np.size(self.times):
            shapes = f"times has shape {np.shape(self.times)}, lengths {np.shape(self.lengths)}"
            raise InputError(f"{where}: {shapes}; expected a length for each time")
        if isinstance(self.times, np.ndarray) and np.any(np.diff(self.times) <= 0):
            raise InputError(f"{where}: times = {self.times.tolist()}; expected ascending ones")
        for name in ("lengths", "rate", "lag", "smallest"):
            value = getattr(self, name)
            if isinstance(value, np.ndarray) and np.any(value <= 0):
                raise InputError(f"{where}: {name} = {value.tolist()}; expected positive numbers")


def wound(motor: Motor, start: Scalar, t: Scalar) -> Scalar:
    """L(t) - L(0), m, of a member whose rest length is `start` at first.

    Each command is a ramp of w: from where the last one ended, at the motor's rate, for as long as it takes. The lag's
    answer to a ramp of slope 1 is s - lag (1 - exp(-s/lag)) after s seconds.
    """
    change = 0 * start
    for begins, move in zip(motor.times, _moves(motor, start)):
        since = t - begins
        # not `sign` and `abs`, whose derivatives are 0 where a command repeats the length before it
        way = jnp.where(move >= 0, 1.0, -1.0).astype(jnp.result_type(move))
        turned = _answer(since, motor.lag) - _answer(since - way * move / motor.rate, motor.lag)
        change = change + way * motor.rate * turned
    return change


def bends_of(motor: Motor, start: Scalar) -> AnyArray:
    """(2 commands,), s: when the motor of a member whose rest length is `start` at first begins to wind, and ends."""
    ends = [begins + jnp.abs(move) / motor.rate for begins, move in zip(motor.times, _moves(motor, start))]
    return jnp.concatenate([jnp.asarray(motor.times), jnp.stack(ends)])


def _moves(motor: Motor, start: Scalar) -> list[Scalar]:
    """m: by how much w changes after each command, until the next."""
    asked = motor.lengths if motor.smallest is None else jnp.maximum(motor.lengths, motor.smallest)
    commands, w, found = len(motor.times), start, []
    for k in range(commands):
        move = asked[k] - w
        if k + 1 < commands:
            reach = motor.rate * (motor.times[k + 1] - motor.times[k])
            move = jnp.clip(move, -reach, reach)
        found.append(move)
        w = w + move
    return found


def _answer(s: Scalar, lag: Scalar | None) -> Scalar:
    """To a ramp of slope 1 that begins at s = 0."""
    s = jnp.maximum(s, 0)
    return s if lag is None else s + lag * jnp.expm1(-s / lag)
