"""Motors, between what a controller asks for and what members do: they lag, and are bounded in rate and in force."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.arguments import is_number
from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray


class MotorLimits(eqx.Module):
    """What the motors of all actuated members can do; by default nearly anything.

    Raises `InputError` where that is nothing.

    Within a control period of length T a motor approaches the rest length that is asked for by the share
    1 - exp(-T/lag) of what is missing, the exact answer of a first-order lag to a command that is held, yet by `rate` T
    at most, and not at all against a member that pulls or pushes more than `force`. Commands beyond `stroke` count as
    that.
    """

    lag: float | None = eqx.field(static=True, default=None)
    """s; None: what is asked for is reached within a control period"""
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
        if not self.stroke < 1:
            raise InputError(f"motors.stroke = {self.stroke}: expected less than 1, a fraction of a member's length")


@typed
def contraction_reached(
    motors: MotorLimits, now: AnyArray, wanted: AnyArray, period: float, lengths: AnyArray, tension: AnyArray | None
) -> AnyArray:
    """The contraction that motors reach within a control period, (actuators,), or with the population last.

    Args:
        motors: what they can do.
        now: by which fraction each member is shortened.
        wanted: what is asked for.
        period: s.
        lengths: L0, m, of the members.
        tension: N, with which each member pulls; needed where forces are bounded.
    """
    change = jnp.clip(wanted, -motors.stroke, motors.stroke) - now
    if motors.lag is not None:
        change = change * (1 - np.exp(-period / motors.lag))
    if motors.rate is not None:
        most = motors.rate * period / lengths
        change = jnp.clip(change, -most, most)
    if motors.force is not None and tension is not None:
        # shortening works against a pull, lengthening against a push
        stalled = (jnp.abs(tension) > motors.force) & (tension * change > 0)
        change = jnp.where(stalled, 0, change)
    return now + change
