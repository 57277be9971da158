"""Feedback that keeps a gait: its clock runs slower or faster with how the robot lies."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxgrity.control.policies import Memory, Policy
from jaxgrity.control.sensors import Observation
from jaxgrity.core.errors import InputError
from jaxgrity.core.types import AnyArray, PerActuator, Scalar, as_float
from jaxgrity.model.actuation import Gait, contraction

SLOWEST, FASTEST = 0.0, 2.0
"""times its own speed, between which the clock of a gait runs"""


GAINS = ((0.2, 0.29), (-0.15, 0.17))
"""of the gait "lasting", from one run of the method in experiments/measurements/tune_feedback.py; runs that differ in
their rounding end at other gains. What these are worth is measured in docs/control.md."""


class PhaseLocked(Policy):
    """A gait of struts whose clock c is kept in step with the robot's rolling: a phase-locked oscillator.

    dc/dt = 1 + sum_h (a_h C_h + b_h S_h), within `SLOWEST` and `FASTEST`, with

        C_h = sum_k u_k^2 cos(h theta_k),   S_h = sum_k u_k^2 sin(h theta_k),   h = 1, 2,

    where u_k is the vertical component of strut k's direction, and theta_k = 2 pi f_k c + phase_k the angle at which
    its actuator stands. A rotation that maps the gait on itself but for a shift of time leaves C_h and S_h as they are,
    so that one law serves on every face. With gains of zero it is the open loop.
    """

    gait: Gait
    gains: AnyArray = eqx.field(converter=as_float, default=GAINS)
    """(2, 2): a_h and b_h in row h"""

    @property
    def members(self) -> tuple[int, ...]:
        return self.gait.members

    def __check_init__(self):
        if np.shape(self.gains)[:2] != (2, 2):
            raise InputError(f"gains has shape {np.shape(self.gains)}; expected (2, 2), a_h and b_h in each row")

    def first(self) -> Memory:
        """The clock and the time until which it has run, s."""
        return jnp.zeros(()), jnp.zeros(())

    def __call__(self, observation: Observation, t: Scalar, memory: Memory) -> tuple[PerActuator, Memory]:
        if max(self.members) >= len(observation.directions):
            raise InputError(
                f"gait.members = {list(self.members)}: expected struts alone, whose directions tell the clock"
            )
        clock, last = memory
        upright = observation.directions[np.array(self.members), 2] ** 2
        angle = 2 * jnp.pi * self.gait.frequency * clock + self.gait.phase
        waves = jnp.stack([jnp.stack([jnp.cos(h * angle), jnp.sin(h * angle)]) for h in (1, 2)])
        rate = jnp.clip(1 + jnp.sum(self.gains * (waves @ upright)), SLOWEST, FASTEST)
        clock = clock + rate * (t - last)
        return contraction(self.gait, clock), (clock, t)
