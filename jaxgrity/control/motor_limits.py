"""Motors between a controller's commands and the members: lag, and bounds of rate and force."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.arguments import is_number
from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray


class MotorLimits(eqx.Module):
    """The limits of the motors of all actuated members; by default nearly none.

    Raises `InputError` for motors that cannot move.

    Within a control period T a motor covers the share 1 - exp(-T/lag) of the way to the commanded rest length: the
    exact response of a first-order lag to a held command. It moves by `rate` T at most, and not at all against a force
    of its member above `force`. Commands are cut at `stroke`.
    """

    lag: float | None = eqx.field(static=True, default=None)
    """s; None: commands are reached within a control period"""
    rate: float | None = eqx.field(static=True, default=None)
    """m/s, the largest |dL/dt|; None: unbounded"""
    force: float | None = eqx.field(static=True, default=None)
    """N, beyond which a motor stalls; None: unbounded"""
    stroke: float = eqx.field(static=True, default=0.9)
    """the largest fraction of its length by which a member is shortened or lengthened, less than 1"""

    def __check_init__(self):
        for name, value in vars(self).items():
            if value is not None and not (is_number(value) and value > 0 and np.isfinite(value)):
                raise InputError(f"motors.{name} = {value!r}: expected a positive, finite number, or None")
        if self.stroke is None or not self.stroke < 1:
            raise InputError(f"motors.stroke = {self.stroke}: expected less than 1, a fraction of a member's length")


@typed
def contraction_reached(
    motors: MotorLimits, now: AnyArray, wanted: AnyArray, period: float, lengths: AnyArray, tension: AnyArray | None
) -> AnyArray:
    """The contraction of each member after a control period T, by the law of `MotorLimits`.

    All arrays are (actuators,), or (actuators, robots).

    Args:
        motors: the limits.
        now: contraction of each member before the period.
        wanted: commanded contraction.
        period: control period T, s.
        lengths: full rest length L0 of each member, m.
        tension: force with which each member pulls, N; None: motors do not stall.

    Returns:
        now + clip((wanted - now) (1 - exp(-T/lag)), -rate T/L0, rate T/L0), with `wanted` cut at the stroke. It is
        `now` where a motor stalls.
    """
    change = jnp.clip(wanted, -motors.stroke, motors.stroke) - now
    if motors.lag is not None:
        # a number of NumPy's is as precise as float64, and would make single precision double
        change = change * float(1 - np.exp(-period / motors.lag))
    if motors.rate is not None:
        most = motors.rate * period / lengths
        change = jnp.clip(change, -most, most)
    if motors.force is not None and tension is not None:
        # shortening works against a pull, lengthening against a push
        stalled = (jnp.abs(tension) > motors.force) & (tension * change > 0)
        change = jnp.where(stalled, 0, change)
    return now + change
