"""Motors that wind members: rest lengths that follow a list of commanded lengths at a limited rate.

A motor is an exact function of time and does not depend on the robot, so methods carry no state for it. A limit on its
force is a separate law (`force_laws.force_limit`).
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.arguments import check_each, check_index
from jaxgrity.core.errors import InputError
from jaxgrity.core.types import AnyArray, Scalar, as_float, as_float_or_none


class Motor(eqx.Module):
    """A motor that winds a member towards each commanded length until it is there, or the next command comes.

    The wound length w changes at `rate`, and stops at `smallest`. The rest length lags behind: L' = (w - L)/lag. Before
    the first command, both are the member's rest length.

    Raises `InputError` if numbers do not fit.
    """

    member: int = eqx.field(static=True)
    """number of the member among the struts, or among the cables, from 0"""
    times: AnyArray = eqx.field(converter=as_float)
    """(commands,), ascending times of the commands, s"""
    lengths: AnyArray = eqx.field(converter=as_float)
    """(commands,), commanded rest lengths, m"""
    rate: Scalar = eqx.field(converter=as_float)
    """rate of winding in and paying out, m/s"""
    lag: Scalar | None = eqx.field(converter=as_float_or_none, default=None)
    """lag, s; None: no lag"""
    smallest: Scalar | None = eqx.field(converter=as_float_or_none, default=None)
    """smallest length, m, at which the spool stops; None: no limit"""

    def __check_init__(self):
        check_index("motor.member", self.member)
        where = f"motor of member {self.member}"
        if np.ndim(self.times) != 1 or np.shape(self.times) != np.shape(self.lengths) or not np.size(self.times):
            shapes = f"times has shape {np.shape(self.times)}, lengths {np.shape(self.lengths)}"
            raise InputError(f"{where}: {shapes}; expected a length for each time")
        if isinstance(self.times, np.ndarray) and np.any(np.diff(self.times) <= 0):
            raise InputError(f"{where}: times = {self.times.tolist()}; expected ascending ones")
        check_each(f"{where}.times", self.times)
        check_each(f"{where}.lengths", self.lengths, above=0.0, unit="m")
        for name, unit in (("rate", "m/s"), ("lag", "s"), ("smallest", "m")):
            check_each(f"{where}.{name}", getattr(self, name), shape=(), above=0.0, unit=unit)


def wound(motor: Motor, start: Scalar, t: Scalar) -> Scalar:
    """Change L(t) - L(0) of a rest length that is `start` at first, m.

    Each command is a ramp of w at the motor's rate, from the end of the last one. After s seconds, the lagged response
    to a ramp of slope 1 is s - lag (1 - exp(-s/lag)).
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
    """(2 commands,), times at which the motor begins and ends to wind, s; `start` is the first rest length."""
    ends = [begins + jnp.abs(move) / motor.rate for begins, move in zip(motor.times, _moves(motor, start))]
    return jnp.concatenate([jnp.asarray(motor.times), jnp.stack(ends)])


def _moves(motor: Motor, start: Scalar) -> list[Scalar]:
    """Change of w after each command until the next, m."""
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
    """Response to a ramp of slope 1 that begins at s = 0."""
    s = jnp.maximum(s, 0)
    return s if lag is None else s + lag * jnp.expm1(-s / lag)
