"""Objectives of a search, and bounds on actuators."""

import inspect
from abc import abstractmethod
from functools import partial
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp

from jaxgrity.core.arguments import check_number
from jaxgrity.core.errors import InputError, check_known
from jaxgrity.core.types import PerGait, Scalar
from jaxgrity.model.scales import speed_scale
from jaxgrity.model.scene import Scene, body_length
from jaxgrity.populations.metrics import Metrics, cost_of_transport
from jaxgrity.populations.population import Outcomes
from jaxgrity.search.paths import FEWEST_PARTS, along_and_across, parts_of_path, path_bend, steady_velocity

INSIDE = 1 - 1e-5
"""Share of the bound on rates that is used, so that no rounding carries a gait beyond the bound."""


SLOW = 0.3
"""Least steady speed from which a start is measured, m/s for a body of one metre: a third of what good gaits reach."""


class Objective(eqx.Module):
    """A number for each rollout; more is better."""

    unit: eqx.AbstractClassVar[str]
    """unit of the objective; empty for a plain number"""
    needs_metrics: eqx.AbstractClassVar[bool]
    """whether rollouts must be measured step by step (`Outcomes.metrics`)"""
    any_heading: eqx.AbstractClassVar[bool]
    """whether turning a rollout about the vertical keeps its objective"""
    either_hand: ClassVar[bool] = True
    """whether mirroring a rollout keeps its objective"""
    per_mass: ClassVar[bool] = False
    """whether it is inversely proportional to the mass, so that each perturbed robot's own mass counts"""
    parts: ClassVar[int] = 1
    """number of parts into which the path of the centre of mass is divided (`Outcomes.com_path`)"""

    def parts_of(self, scene: Scene, duration: float) -> int:
        """Number of parts of the path for this duration, s."""
        return self.parts

    @property
    def steady(self) -> bool:
        """Whether it evaluates the settled motion."""
        return self.parts > 1

    @abstractmethod
    def worth(self, scene: Scene, outcomes: Outcomes, duration: Scalar) -> PerGait:
        """(population,), objective in `unit`; NaN for failed rollouts. `duration` is in s."""


class Distance(Objective):
    """Horizontal displacement of the centre of mass, m."""

    unit: ClassVar[str] = "m"
    needs_metrics: ClassVar[bool] = False
    any_heading: ClassVar[bool] = True

    def worth(self, scene, outcomes, duration):
        return outcomes.distance()


class Direction(Objective):
    """Displacement of the centre of mass along one heading, m."""

    heading: float = eqx.field(static=True, converter=partial(check_number, "heading"), default=0.0)
    """heading, rad from +x"""
    unit: ClassVar[str] = "m"
    needs_metrics: ClassVar[bool] = False
    any_heading: ClassVar[bool] = False

    def worth(self, scene, outcomes, duration):
        along, _ = along_and_across(outcomes.com_end - outcomes.com_start, self.heading)
        return jnp.where(jnp.isfinite(outcomes.distance()), along, jnp.nan)


class Speed(Objective):
    """Distance over duration, in body lengths per second."""

    unit: ClassVar[str] = "body lengths/s"
    needs_metrics: ClassVar[bool] = False
    any_heading: ClassVar[bool] = True

    def worth(self, scene, outcomes, duration):
        return outcomes.distance() / duration / body_length(scene)


class SteadySpeed(Objective):
    """Displacement over the settled part of a rollout, divided by its time, in body lengths per second.

    The settled part is all but the first quarter of the time, in which the gait should come into full swing. A gait
    that later stalls, circles or loses its way gets a small value, however fast it began.
    """

    unit: ClassVar[str] = "body lengths/s"
    needs_metrics: ClassVar[bool] = False
    any_heading: ClassVar[bool] = True
    parts: ClassVar[int] = FEWEST_PARTS

    def worth(self, scene, outcomes, duration):
        velocity = steady_velocity(outcomes, duration)
        return jnp.sqrt(jnp.sum(velocity * velocity, axis=1)) / body_length(scene)


class SteadyDirection(Objective):
    """Horizontal displacement along a heading over the settled part of a rollout, in body lengths per second.

    Displacement across the heading may count against it, times `sideways`. On a slope both are less than along it.
    """

    heading: float = eqx.field(static=True, converter=partial(check_number, "heading"), default=0.0)
    """heading, rad from +x"""
    sideways: float = eqx.field(static=True, converter=partial(check_number, "sideways", least=0.0), default=0.0)
    """share of the displacement across the heading that is subtracted"""
    unit: ClassVar[str] = "body lengths/s"
    needs_metrics: ClassVar[bool] = False
    any_heading: ClassVar[bool] = False
    parts: ClassVar[int] = FEWEST_PARTS

    def worth(self, scene, outcomes, duration):
        along, across = along_and_across(steady_velocity(outcomes, duration), self.heading)
        return (along - self.sideways * jnp.abs(across)) / body_length(scene)


class SteadyTurn(Objective):
    """Speed along a path with a given turning, over the settled part of a rollout, in body lengths per second.

    Arcs through the centre of mass at the ends of parts of the time approximate the path. The difference between its
    turning per body length and the requested one is subtracted, times `sharpness`.
    """

    turning: float = eqx.field(static=True, converter=partial(check_number, "turning"), default=0.44)
    """requested turning, rad per body length, positive to the left"""
    sharpness: float = eqx.field(static=True, converter=partial(check_number, "sharpness", least=0.0), default=2.0)
    """penalty, body lengths/s for each rad per body length of difference"""
    unit: ClassVar[str] = "body lengths/s"
    needs_metrics: ClassVar[bool] = False
    any_heading: ClassVar[bool] = True
    either_hand: ClassVar[bool] = False
    parts: ClassVar[int] = FEWEST_PARTS

    def parts_of(self, scene, duration):
        return parts_of_path(scene, duration)

    def worth(self, scene, outcomes, duration):
        speed, bend = path_bend(scene, outcomes, duration)
        off = jnp.minimum(jnp.abs(bend - self.turning), 1.0)
        return jnp.where(outcomes.failure == 0, speed - self.sharpness * off, jnp.nan)


class QuickStart(Objective):
    """d/v - T, s: minus the time that the start costs.

    v is the steady velocity (`SteadySpeed`), and d the displacement along it in the whole time T. A robot that moves
    steadily at once loses no time. One that waits loses the wait, and one that first rolls back loses more. Robots
    slower than `SLOW` count as that fast: who stands still loses all the time.
    """

    unit: ClassVar[str] = "s"
    needs_metrics: ClassVar[bool] = False
    any_heading: ClassVar[bool] = True
    parts: ClassVar[int] = FEWEST_PARTS

    def worth(self, scene, outcomes, duration):
        velocity = steady_velocity(outcomes, duration)
        square = jnp.sum(velocity * velocity, axis=1)
        speed = jnp.sqrt(jnp.where(square > 0, square, 1.0))
        along = jnp.sum((outcomes.com_end - outcomes.com_start)[:, :2] * velocity, axis=1) / speed
        return along / jnp.maximum(speed, SLOW * speed_scale(scene)) - duration


class CostOfTransport(Objective):
    """-W/(m g d): W is the work that the actuators do (`Metrics.effort`), d the distance, since the gait began.

    Work done on the actuators does not count: no motor stores the prestress that a contracting strut releases. Raises
    `InputError` for a scene without gravity.
    """

    unit: ClassVar[str] = ""
    needs_metrics: ClassVar[bool] = True
    any_heading: ClassVar[bool] = True
    per_mass: ClassVar[bool] = True

    def worth(self, scene, outcomes, duration):
        if scene.gravity is None:
            raise InputError("cost of transport needs gravity; expected a [gravity] table")
        return -cost_of_transport(scene, metrics_of(outcomes).effort, _moved(outcomes))


class Straightness(Objective):
    """Distance over the length of the horizontal path of the centre of mass since the gait began; at most 1."""

    unit: ClassVar[str] = ""
    needs_metrics: ClassVar[bool] = True
    any_heading: ClassVar[bool] = True

    def worth(self, scene, outcomes, duration):
        return _moved(outcomes) / metrics_of(outcomes).path


class JumpHeight(Objective):
    """How far the centre of mass rises above its place when the gait began, m: the height of the highest jump."""

    unit: ClassVar[str] = "m"
    needs_metrics: ClassVar[bool] = True
    any_heading: ClassVar[bool] = True

    def worth(self, scene, outcomes, duration):
        return jnp.where(outcomes.failure == 0, metrics_of(outcomes).rise, jnp.nan)


OBJECTIVES: dict[str, type[Objective]] = {}
"""Objectives, by their names in commands."""


def register_objective(name: str, kind: type[Objective]) -> type[Objective]:
    """Register your own objective under a name for commands. Returns it.

    Raises `InputError` if the name is taken, or the kind is no subclass of `Objective`.
    """
    if not (inspect.isclass(kind) and issubclass(kind, Objective)):
        raise InputError(f"objective = {name!r}: its kind is {kind!r}; expected a subclass of Objective")
    if name in OBJECTIVES:
        raise InputError(f"objective = {name!r}: there is one of this name already; expected another name")
    OBJECTIVES[name] = kind
    return kind


def find_objective(name: str) -> type[Objective]:
    """The objective with this name. Raises `InputError` if there is none."""
    check_known("objective", name, OBJECTIVES)
    return OBJECTIVES[name]


register_objective("distance", Distance)
register_objective("direction", Direction)
register_objective("speed", Speed)
register_objective("cost of transport", CostOfTransport)
register_objective("straightness", Straightness)
register_objective("jump height", JumpHeight)
register_objective("quick start", QuickStart)
register_objective("steady speed", SteadySpeed)
register_objective("steady direction", SteadyDirection)
register_objective("steady turn", SteadyTurn)


class ActuatorBounds(eqx.Module):
    """Bounds on each actuator; None: no bound. Gaits beyond them rank after all others."""

    rate: float | None = eqx.field(static=True, default=None)
    """bound on |dL/dt| after the gait's ramp, m/s; it follows from the gait alone (`peak_rates`)"""
    force: float | None = eqx.field(static=True, default=None)
    """bound on the force, N"""
    power: float | None = eqx.field(static=True, default=None)
    """bound on the power, W"""

    def __check_init__(self):
        for name, bound in vars(self).items():
            if bound is not None:
                check_number(f"bounds.{name} (--objective.largest-{name})", bound, above=0.0)

    @property
    def needs_metrics(self) -> bool:
        """Whether rollouts must be measured step by step, for forces and powers."""
        return self.force is not None or self.power is not None

    @property
    def words(self) -> str:
        """What a gait is within that keeps them, in words; empty without a bound."""
        return "bounds" if self.needs_metrics else "" if self.rate is None else "the bound on rates"

    def excess(self, rate: PerGait, metrics: Metrics | None) -> PerGait:
        """(population,), excess over the bounds, as a fraction summed over them; 0 within all. `rate`: largest rate,
        m/s."""
        found = jnp.zeros_like(rate) if self.rate is None else jnp.maximum(rate / self.rate - 1, 0)
        for name in ("force", "power"):
            bound = getattr(self, name)
            if bound is not None:
                assert metrics is not None, "rollouts for a bound on forces have metrics"
                found = found + jnp.maximum(getattr(metrics, f"peak_{name}").max(-1) / bound - 1, 0)
        return found


def _moved(outcomes: Outcomes) -> PerGait:
    """(population,), displacement since the gait began, m; NaN for failed rollouts."""
    x, y = metrics_of(outcomes).moved_x, metrics_of(outcomes).moved_y
    return jnp.where(outcomes.failure == 0, jnp.sqrt(x * x + y * y), jnp.nan)


def metrics_of(outcomes: Outcomes) -> Metrics:
    """Metrics of rollouts, for objectives that need them."""
    assert outcomes.metrics is not None, "rollouts for an objective that needs metrics have them"
    return outcomes.metrics
