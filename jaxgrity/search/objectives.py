"""What one rollout is worth, and the most that a gait may ask of its actuators."""

from abc import abstractmethod
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.errors import InputError, unknown
from jaxgrity.core.types import PerGait, Scalar
from jaxgrity.model.scene import Scene, body_length
from jaxgrity.populations.metrics import Metrics, cost_of_transport
from jaxgrity.populations.population import Outcomes
from jaxgrity.search.paths import PARTS, parts_of_path, path_bend, steady_velocity


class Objective(eqx.Module):
    """What one rollout is worth; more is better."""

    unit: eqx.AbstractClassVar[str]
    """empty for a plain number"""
    needs_metrics: eqx.AbstractClassVar[bool]
    """whether rollouts have to be measured step by step (`Outcomes.metrics`)"""
    any_heading: eqx.AbstractClassVar[bool]
    """whether a rollout that is turned about the vertical is worth the same"""
    either_hand: ClassVar[bool] = True
    """whether its mirror image is"""
    parts: ClassVar[int] = 1
    """into how many parts the path of the centre of mass has to be divided (`Outcomes.com_path`)"""

    def parts_of(self, scene: Scene, duration: float) -> int:
        """Into how many parts the path is divided in so many seconds."""
        return self.parts

    @property
    def steady(self) -> bool:
        """Whether it looks at how the robot rolls once it has settled."""
        return self.parts > 1

    @abstractmethod
    def worth(self, scene: Scene, outcomes: Outcomes, duration: Scalar) -> PerGait:
        """(population,), in `unit`; NaN where the rollout failed. `duration` is in s."""


class Distance(Objective):
    """Horizontal displacement of the centre of mass, m."""

    unit: ClassVar[str] = "m"
    needs_metrics: ClassVar[bool] = False
    any_heading: ClassVar[bool] = True

    def worth(self, scene, outcomes, duration):
        return outcomes.distance()


class Direction(Objective):
    """Displacement of the centre of mass along one heading, m."""

    heading: float = eqx.field(static=True, default=0.0)
    """rad from +x"""
    unit: ClassVar[str] = "m"
    needs_metrics: ClassVar[bool] = False
    any_heading: ClassVar[bool] = False

    def worth(self, scene, outcomes, duration):
        moved = outcomes.com_end - outcomes.com_start
        along = moved[:, 0] * np.cos(self.heading) + moved[:, 1] * np.sin(self.heading)
        return jnp.where(jnp.isfinite(outcomes.distance()), along, jnp.nan)


class Speed(Objective):
    """Distance over duration, in body lengths a second."""

    unit: ClassVar[str] = "body lengths/s"
    needs_metrics: ClassVar[bool] = False
    any_heading: ClassVar[bool] = True

    def worth(self, scene, outcomes, duration):
        return outcomes.distance() / duration / body_length(scene)


class SteadySpeed(Objective):
    """Displacement over the settled part of a rollout, in body lengths a second.

    The settled part is the time but its first quarter. A gait that stalls, circles or loses its way later is worth
    little, however fast it began.
    """

    unit: ClassVar[str] = "body lengths/s"
    needs_metrics: ClassVar[bool] = False
    any_heading: ClassVar[bool] = True
    parts: ClassVar[int] = PARTS

    def worth(self, scene, outcomes, duration):
        velocity = steady_velocity(outcomes, duration)
        return jnp.sqrt(jnp.sum(velocity * velocity, axis=1)) / body_length(scene)


class SteadyDirection(Objective):
    """Displacement along one heading over the settled part of a rollout, in body lengths a second: uphill, say."""

    heading: float = eqx.field(static=True, default=0.0)
    """rad from +x"""
    unit: ClassVar[str] = "body lengths/s"
    needs_metrics: ClassVar[bool] = False
    any_heading: ClassVar[bool] = False
    parts: ClassVar[int] = PARTS

    def worth(self, scene, outcomes, duration):
        velocity = steady_velocity(outcomes, duration)
        along = velocity[:, 0] * np.cos(self.heading) + velocity[:, 1] * np.sin(self.heading)
        return along / body_length(scene)


class SteadyTurn(Objective):
    """Speed along a path that turns as asked for, over the settled part of a rollout, in body lengths a second.

    The path is made of arcs through the centre of mass at the ends of parts of the time. What it turns by in a body
    length, less what is asked for, is held against it.
    """

    turning: float = eqx.field(static=True, default=0.44)
    """rad per body length, positive to the left"""
    sharpness: float = eqx.field(static=True, default=2.0)
    """body lengths/s held against a gait for each rad per body length that it is off"""
    unit: ClassVar[str] = "body lengths/s"
    needs_metrics: ClassVar[bool] = False
    any_heading: ClassVar[bool] = True
    either_hand: ClassVar[bool] = False
    parts: ClassVar[int] = PARTS

    def parts_of(self, scene, duration):
        return parts_of_path(scene, duration)

    def worth(self, scene, outcomes, duration):
        speed, bend = path_bend(scene, outcomes, duration)
        off = jnp.minimum(jnp.abs(bend - self.turning), 1.0)
        return jnp.where(outcomes.failure == 0, speed - self.sharpness * off, jnp.nan)


class CostOfTransport(Objective):
    """-W/(m g d), W the actuators' own work without what is done on them, d the distance, since the gait began.

    It is `Metrics.effort`: a strut that contracts releases prestress, and no motor stores it. Raises `InputError` on a
    scene without gravity.
    """

    unit: ClassVar[str] = ""
    needs_metrics: ClassVar[bool] = True
    any_heading: ClassVar[bool] = True

    def worth(self, scene, outcomes, duration):
        if scene.gravity is None:
            raise InputError("cost of transport needs gravity; expected a [gravity] table")
        return -cost_of_transport(scene, metrics_of(outcomes).effort, _moved(outcomes))


class Straightness(Objective):
    """Distance over the length of the horizontal path of the centre of mass, since the gait began: at most 1."""

    unit: ClassVar[str] = ""
    needs_metrics: ClassVar[bool] = True
    any_heading: ClassVar[bool] = True

    def worth(self, scene, outcomes, duration):
        return _moved(outcomes) / metrics_of(outcomes).path


OBJECTIVES: dict[str, type[Objective]] = {}
"""The objectives by the names that commands use."""


def register_objective(name: str, kind: type[Objective]) -> type[Objective]:
    """Let commands search for an objective of one's own, by a name. Returns it.

    Raises `InputError` where the name is taken.
    """
    if name in OBJECTIVES:
        raise InputError(f"objective = {name!r}: there is one of this name already; expected another name")
    OBJECTIVES[name] = kind
    return kind


def find_objective(name: str) -> type[Objective]:
    """The objective of this name. Raises `InputError` where there is none."""
    if name not in OBJECTIVES:
        raise InputError(f"objective = {name!r}: {unknown(name, OBJECTIVES)}; expected one of {', '.join(OBJECTIVES)}")
    return OBJECTIVES[name]


register_objective("distance", Distance)
register_objective("direction", Direction)
register_objective("speed", Speed)
register_objective("cost of transport", CostOfTransport)
register_objective("straightness", Straightness)
register_objective("steady speed", SteadySpeed)
register_objective("steady direction", SteadyDirection)
register_objective("steady turn", SteadyTurn)


class ActuatorBounds(eqx.Module):
    """The most that a gait may ask of any actuator; None: no bound. Gaits that ask for more come after all others."""

    rate: float | None = eqx.field(static=True, default=None)
    """|dL/dt|, m/s, once the gait's ramp is over: it follows from the gait itself (`peak_rates`)"""
    force: float | None = eqx.field(static=True, default=None)
    """N"""
    power: float | None = eqx.field(static=True, default=None)
    """W"""

    def __check_init__(self):
        for name, bound in vars(self).items():
            if bound is not None and not bound > 0:
                raise InputError(f"largest_{name} = {bound}: expected a positive number")

    @property
    def needs_metrics(self) -> bool:
        """Whether rollouts have to be measured step by step, to see forces."""
        return self.force is not None or self.power is not None

    def excess(self, rate: PerGait, metrics: Metrics | None) -> PerGait:
        """By which share each gait exceeds the bounds, summed up over them; 0 within all. `rate`: its largest, m/s."""
        found = jnp.zeros_like(rate) if self.rate is None else jnp.maximum(rate / self.rate - 1, 0)
        for name in ("force", "power"):
            bound = getattr(self, name)
            if bound is not None:
                assert metrics is not None, "rollouts for a bound on forces have metrics"
                found = found + jnp.maximum(getattr(metrics, f"peak_{name}").max(-1) / bound - 1, 0)
        return found


def _moved(outcomes: Outcomes) -> PerGait:
    """(population,), m: displacement since the gait began, as all metrics; NaN where the rollout failed."""
    x, y = metrics_of(outcomes).moved_x, metrics_of(outcomes).moved_y
    return jnp.where(outcomes.failure == 0, jnp.sqrt(x * x + y * y), jnp.nan)


def metrics_of(outcomes: Outcomes) -> Metrics:
    """The metrics of rollouts for an objective that needs them."""
    assert outcomes.metrics is not None, "rollouts for an objective that needs metrics have them"
    return outcomes.metrics
