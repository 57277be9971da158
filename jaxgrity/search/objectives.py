"""What makes one gait better than another: an objective for one rollout, and the fitness of an ensemble of them."""

from typing import Literal, NamedTuple, get_args

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxgrity.model.actuation import Gait
from jaxgrity.rollout.metrics import Meters
from jaxgrity.rollout.population import Outcomes, roll_out
from jaxgrity.model.scene import Scene
from jaxgrity.stepping.simulate import Settings
from jaxgrity.core.errors import InputError
from jaxgrity.core.types import AnyArray, PerGait, Scalar
from jaxgrity.rollout.uncertainty import Uncertainty, ensemble

Kind = Literal["distance", "direction", "speed", "cost of transport", "straightness"]
UNITS = {"distance": "m", "direction": "m", "speed": "body lengths/s", "cost of transport": "", "straightness": ""}
METERED = ("cost of transport", "straightness")
REFUSED = 1e3
"""the least that a gait within all bounds is worth; what exceeds one is worth less, the more it does"""


class Objective(eqx.Module):
    """What one rollout is worth; more is better.

    distance: horizontal displacement of the centre of mass, m. direction: its part along `heading`, m. speed: distance
    over duration, in body lengths a second. cost of transport: -W/(m g d), W the actuators' own work without what is
    done on them (`Meters.effort`: a contracting strut releases prestress, and no motor stores it). straightness: d over
    the length of the path. Gaits that ask more of an actuator than a bound come after all that do not.
    """

    kind: Kind = eqx.field(static=True, default="distance")
    heading: float = eqx.field(static=True, default=0.0)
    """rad from +x, for direction"""
    largest_rate: float | None = eqx.field(static=True, default=None)
    """m/s, bound on any actuator's |dL/dt|"""
    largest_force: float | None = eqx.field(static=True, default=None)
    """N"""
    largest_power: float | None = eqx.field(static=True, default=None)
    """W"""

    def __check_init__(self):
        if self.kind not in get_args(Kind):
            raise InputError(f"objective = {self.kind!r}: unknown; expected one of {', '.join(get_args(Kind))}")
        for name, bound in self.bounds.items():
            if not bound > 0:
                raise InputError(f"largest_{name} = {bound}: expected a positive number")

    @property
    def bounds(self) -> dict[str, float]:
        every = {"rate": self.largest_rate, "force": self.largest_force, "power": self.largest_power}
        return {name: bound for name, bound in every.items() if bound is not None}

    @property
    def metered(self) -> bool:
        """Whether rollouts have to be metered."""
        return self.kind in METERED or bool(self.bounds)

    @property
    def unit(self) -> str:
        return UNITS[self.kind]

    def worth(self, scene: Scene, outcomes: Outcomes, duration: Scalar) -> PerGait:
        """(population,), NaN where the rollout failed."""
        worth = distance = outcomes.distance()
        if self.kind == "direction":
            moved = outcomes.com_end - outcomes.com_start
            along = moved[:, 0] * np.cos(self.heading) + moved[:, 1] * np.sin(self.heading)
            worth = jnp.where(jnp.isfinite(distance), along, jnp.nan)
        elif self.kind == "speed":
            worth = distance / duration / body_length(scene)
        return self._metered(scene, outcomes.meters, worth) if self.metered else worth

    def _metered(self, scene: Scene, meters: Meters | None, worth: PerGait) -> PerGait:
        """`worth`, m or m/s, where the kind or a bound needs meters."""
        assert meters is not None, "rollouts of what is metered have meters"
        if self.kind == "cost of transport":
            if scene.gravity is None:
                raise InputError("cost of transport needs gravity; expected a [gravity] table")
            worth = -meters.effort / (scene.structure.node_mass.sum() * scene.gravity * worth)
        elif self.kind == "straightness":
            worth = worth / meters.path
        if not self.bounds:
            return worth
        shares = [getattr(meters, f"peak_{name}").max(-1) / bound for name, bound in self.bounds.items()]
        beyond = sum(jnp.where(share > 1, share, 0) for share in shares)
        return jnp.where(beyond > 0, -REFUSED * (1 + beyond), jnp.maximum(worth, -REFUSED))


def body_length(scene: Scene) -> Scalar:
    """The longest strut as built, m; of a structure without struts, the longest cable."""
    members = scene.structure.struts or scene.structure.cables
    if members is None:
        raise InputError("the structure has no members; expected some, to measure its length in")
    i, j = np.array(members.edges).T
    nodes = scene.structure.nodes
    return jnp.sqrt(jnp.max(jnp.sum((nodes[i] - nodes[j]) ** 2, axis=1)))


class Fitness(eqx.Module):
    """How a gait is judged: by the mean of an objective over an ensemble of robots, less some of its spread."""

    objective: Objective = eqx.field(default_factory=Objective)
    uncertainty: Uncertainty = eqx.field(default_factory=Uncertainty)
    robots: int = eqx.field(static=True, default=1)
    """in each gait's ensemble"""
    caution: float = eqx.field(static=True, default=0.0)
    """how many standard deviations of the ensemble are held against a gait: small perturbations that grow are spread"""

    def __check_init__(self):
        if self.robots < 1:
            raise InputError(f"robots = {self.robots}: expected at least 1")
        if self.robots == 1 and self.caution:
            raise InputError(f"caution = {self.caution}: one robot has no spread; expected robots = 2 or more")
        if self.uncertainty.none and self.caution:
            raise InputError(
                f"caution = {self.caution}: nothing is uncertain, nothing spreads; expected an uncertainty"
            )


def with_robots(fitness: Fitness, robots: int) -> Fitness:
    """The same fitness by an ensemble of another size."""
    return Fitness(fitness.objective, fitness.uncertainty, robots, fitness.caution)


class Scores(NamedTuple):
    """Of each gait."""

    fitness: PerGait
    """mean less caution times spread; -inf where a robot failed"""
    mean: PerGait
    spread: PerGait
    """standard deviation over the ensemble"""
    failed: Bool[AnyArray, " population"]
    """whether any robot of the ensemble failed"""
    each: Float[AnyArray, "population robots"]
    """the objective of every robot"""


@eqx.filter_jit
def judge(key, scene: Scene, gaits: Gait, duration: Scalar, settings: Settings, fitness: Fitness) -> Scores:
    """Score every gait by its ensemble, all of them rolled out in one call."""
    differences = None
    if not fitness.uncertainty.none:
        gaits, differences = ensemble(key, scene, gaits, fitness.uncertainty, fitness.robots)
    objective = fitness.objective
    outcomes = roll_out(scene, gaits, duration, settings, differences, objective.metered)
    each = objective.worth(scene, outcomes, duration).reshape(-1, 1 if fitness.uncertainty.none else fitness.robots)
    failed = ~jnp.isfinite(each).all(1)
    mean, spread = each.mean(1), each.std(1)
    worth = jnp.where(failed, -jnp.inf, mean - fitness.caution * spread)
    return Scores(worth, mean, spread, failed, each)
