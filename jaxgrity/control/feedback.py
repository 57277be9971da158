"""Feedback that keeps a gait: its clock runs slower or faster with the robot's orientation."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.control.policies import Memory, Policy, check_gait
from jaxgrity.control.sensors import Observation
from jaxgrity.core.arguments import check_each
from jaxgrity.core.errors import InputError
from jaxgrity.core.tracing import traced
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, PerActuator, Scalar, as_float
from jaxgrity.model.actuation import Gait, check_robot, contraction
from jaxgrity.model.scales import time_scale
from jaxgrity.model.scene import Scene

SLOWEST, FASTEST = 0.0, 2.0
"""Limits of the speed of a gait's clock, as multiples of its own speed."""


GAINS = ((0.2, 0.29), (-0.15, 0.17))
"""Default gains of feedback, rounded from one search for the gait "lasting", which
`python experiments/run.py tune` repeats and compares with these."""

SURE_GAINS, SURE_SWINGS = ((0.23, 0.45), (-0.34, 0.24)), ((0.24, 0.02), (-0.19, -0.01))
SURE_AMPLITUDE, SURE_FREQUENCY = 1.11, 1.14
"""Gains of `sure_footed`, and factors on the amplitude and frequency of the gait "lasting": rounded from one search on
bumps, which `python experiments/run.py tune` repeats and compares with these."""
FASTEST_SWING = 3.0
"""Largest rate du/dt that counts, 1/s for a robot of one metre on Earth. Faster ones count as this one."""


class PhaseLocked(Policy):
    """A gait of struts with a clock c in step with the robot's rolling: a phase-locked oscillator.

    dc/dt = 1 + sum_h (a_h C_h + b_h S_h + a'_h C'_h + b'_h S'_h), within `SLOWEST` and `FASTEST`, with

        C_h = sum_k u_k^2 cos(h theta_k),         S_h = sum_k u_k^2 sin(h theta_k),   h = 1, 2,
        C'_h = sum_k u_k T du_k/dt cos(h theta_k),  S'_h = sum_k u_k T du_k/dt sin(h theta_k),

    where u_k is the vertical component of strut k's direction, and theta_k = 2 pi f_k c + phase_k its actuator's angle.
    T is the robot's `time_scale`: robots that are alike but in size have the same gains.
    All these are invariant under a rotation that maps the gait on itself up to a shift of time: one law serves on every
    face. With gains of zero it is the open loop.
    """

    gait: Gait
    gains: AnyArray = eqx.field(converter=as_float, default=GAINS)
    """(2, 2): a_h and b_h in row h"""
    swings: AnyArray = eqx.field(converter=as_float, default=((0.0, 0.0), (0.0, 0.0)))
    """(2, 2), s for a robot of one metre on Earth: a'_h and b'_h likewise; T du_k/dt, from the struts' spins, counts up
    to `FASTEST_SWING`"""
    time_scale: Scalar = eqx.field(converter=as_float, default=1.0)
    """T, of `jaxgrity.model.scales.time_scale(scene)`, without derivatives: how many times as long as for a robot of
    one metre on Earth what the robot does takes"""

    @property
    def members(self) -> tuple[int, ...]:
        return self.gait.members

    def __check_init__(self):
        check_gait(self.gait)
        check_each("time_scale", self.time_scale, above=0.0)
        for name in ("gains", "swings"):
            own = getattr(self, name)
            if np.shape(own)[:2] != (2, 2):
                raise InputError(f"{name} has shape {np.shape(own)}; expected (2, 2), a_h and b_h in each row")
            if not traced(own) and not np.isfinite(own).all():
                raise InputError(f"{name} = {np.asarray(own).tolist()}: expected finite numbers")

    def first(self) -> Memory:
        """The clock and its time, s."""
        return jnp.zeros(()), jnp.zeros(())

    def check(self, scene: Scene) -> None:
        check_robot(self.gait, scene.structure)
        struts = scene.structure.struts
        if max(self.members) >= (0 if struts is None else len(struts.edges)):
            raise InputError(
                f"gait.members = {list(self.members)}: expected struts alone: the clock needs their directions"
            )

    def __call__(self, observation: Observation, t: Scalar, memory: Memory) -> tuple[PerActuator, Memory]:
        clock, last = memory
        own = np.array(self.members)
        along, spin = observation.directions[own], observation.spins[own]
        upright = along[:, 2]
        swing = jax.lax.stop_gradient(self.time_scale) * (spin[:, 0] * along[:, 1] - spin[:, 1] * along[:, 0])
        angle = 2 * jnp.pi * self.gait.frequency * clock + self.gait.phase
        waves = jnp.stack([jnp.stack([jnp.cos(h * angle), jnp.sin(h * angle)]) for h in (1, 2)])
        told = jnp.sum(self.gains * (waves @ upright**2))
        told = told + jnp.sum(self.swings * (waves @ (upright * jnp.clip(swing, -FASTEST_SWING, FASTEST_SWING))))
        rate = jnp.clip(1 + told, SLOWEST, FASTEST)
        clock = clock + rate * (t - last)
        return contraction(self.gait, clock), (clock, t)


def one_frequency(gait: Gait) -> float:
    """The duration of the gait's cycle, s.

    Raises `InputError` for a gait of several frequencies or of none: it has no cycle in which a clock could jump.
    """
    frequency = np.asarray(gait.frequency)
    if np.ptp(frequency) > 0 or not frequency.max() > 0:
        raise InputError(
            f"gait.frequency = {frequency.tolist()}: expected the same for all members, above 0 Hz, "
            "since their clock jumps to another place of the cycle"
        )
    return 1 / float(frequency.max())


@typed
def sure_footed(gait: Gait, scene: Scene | None = None) -> PhaseLocked:
    """Feedback for uneven ground: a slightly larger and faster gait; its clock depends on the struts' swing.

    Gains, and the factors of amplitude and frequency, were found for the library's gait "lasting" on bumps of 2 cm.
    docs/control.md has the measured benefit there and on other ground. Pass the `scene` of a robot that is much larger
    or smaller than one metre, or under another gravity: swings then count by its `time_scale`.

    Raises `InputError` where a member would lose all of its length.
    """
    larger = SURE_AMPLITUDE * np.asarray(gait.amplitude)
    if not np.all(larger < 1):
        raise InputError(
            f"gait.amplitude = {np.asarray(gait.amplitude).tolist()}: expected less than 0.9, to be enlarged"
        )
    faster = replace(gait, amplitude=larger, frequency=SURE_FREQUENCY * np.asarray(gait.frequency))
    scale = 1.0 if scene is None else time_scale(scene)
    return PhaseLocked(faster, np.array(SURE_GAINS), np.array(SURE_SWINGS), scale)
