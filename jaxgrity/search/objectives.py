"""What makes one gait better than another: an objective for one rollout, and the fitness of an ensemble of them."""

from abc import abstractmethod
from collections.abc import Callable
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxgrity.core.errors import InputError
from jaxgrity.core.types import AnyArray, PerGait, Scalar
from jaxgrity.model.actuation import Gait
from jaxgrity.model.scene import Scene
from jaxgrity.rollout.metrics import Metrics
from jaxgrity.rollout.population import Outcomes, roll_out
from jaxgrity.rollout.uncertainty import Uncertainty, ensemble
from jaxgrity.stepping.options import ResolvedOptions

ROUND = 64
"""robots by which the last judgements begin, and of which more are added by as many"""
BEYOND_BOUNDS = 1e3
"""the least loss of a gait that exceeds a bound on its actuators; it loses more, the further it exceeds it"""


class Objective(eqx.Module):
    """What one rollout is worth; more is better."""

    unit: eqx.AbstractClassVar[str]
    """empty for a plain number"""
    needs_metrics: eqx.AbstractClassVar[bool]
    """whether rollouts have to be measured step by step (`Outcomes.metrics`)"""
    any_heading: eqx.AbstractClassVar[bool]
    """whether a rollout that is turned about the vertical is worth the same"""

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


class CostOfTransport(Objective):
    """-W/(m g d), W the actuators' own work without what is done on them, d the distance.

    It is `Metrics.effort`: a strut that contracts releases prestress, and no motor stores it. Raises `InputError` on a
    scene without gravity.
    """

    unit: ClassVar[str] = ""
    needs_metrics: ClassVar[bool] = True
    any_heading: ClassVar[bool] = True

    def worth(self, scene, outcomes, duration):
        if scene.gravity is None:
            raise InputError("cost of transport needs gravity; expected a [gravity] table")
        weight = scene.structure.node_mass.sum() * scene.gravity
        return -metrics_of(outcomes).effort / (weight * outcomes.distance())


class Straightness(Objective):
    """Distance over the length of the horizontal path of the centre of mass."""

    unit: ClassVar[str] = ""
    needs_metrics: ClassVar[bool] = True
    any_heading: ClassVar[bool] = True

    def worth(self, scene, outcomes, duration):
        return outcomes.distance() / metrics_of(outcomes).path


OBJECTIVES: dict[str, type[Objective]] = {}
"""the objectives by the names that commands know them by"""


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
        raise InputError(f"objective = {name!r}: unknown; expected one of {', '.join(OBJECTIVES)}")
    return OBJECTIVES[name]


register_objective("distance", Distance)
register_objective("direction", Direction)
register_objective("speed", Speed)
register_objective("cost of transport", CostOfTransport)
register_objective("straightness", Straightness)


class ActuatorBounds(eqx.Module):
    """The most that a gait may ask of any actuator; None: no bound. Gaits that ask for more come after all others."""

    rate: float | None = eqx.field(static=True, default=None)
    """|dL/dt|, m/s"""
    force: float | None = eqx.field(static=True, default=None)
    """N"""
    power: float | None = eqx.field(static=True, default=None)
    """W"""

    def __check_init__(self):
        for name, bound in self.given.items():
            if not bound > 0:
                raise InputError(f"largest_{name} = {bound}: expected a positive number")

    @property
    def given(self) -> dict[str, float]:
        """Those that there are, by name."""
        return {name: bound for name, bound in vars(self).items() if bound is not None}

    def applied(self, worth: PerGait, metrics: Metrics) -> PerGait:
        """`worth`, and less than -`BEYOND_BOUNDS` for gaits beyond a bound."""
        shares = [getattr(metrics, f"peak_{name}").max(-1) / bound for name, bound in self.given.items()]
        beyond = sum(jnp.where(share > 1, share, 0) for share in shares)
        return jnp.where(beyond > 0, -BEYOND_BOUNDS * (1 + beyond), jnp.maximum(worth, -BEYOND_BOUNDS))


def metrics_of(outcomes: Outcomes) -> Metrics:
    """The metrics of rollouts for an objective that needs them."""
    assert outcomes.metrics is not None, "rollouts for an objective that needs metrics have them"
    return outcomes.metrics


def body_length(scene: Scene) -> Scalar:
    """The longest strut as built, m; of a structure without struts, the longest cable.

    Raises `InputError` where there are no members.
    """
    members = scene.structure.struts or scene.structure.cables
    if members is None:
        raise InputError("the structure has no members; expected some, to measure its length in")
    i, j = np.array(members.edges).T
    nodes = scene.structure.nodes
    return jnp.sqrt(jnp.max(jnp.sum((nodes[i] - nodes[j]) ** 2, axis=1)))


class Fitness(eqx.Module):
    """How a gait is judged: by the mean of an objective over an ensemble of robots, less some of its spread."""

    objective: Objective = eqx.field(default_factory=Distance)
    uncertainty: Uncertainty = eqx.field(default_factory=Uncertainty)
    robots: int = eqx.field(static=True, default=1)
    """in each gait's ensemble"""
    caution: float = eqx.field(static=True, default=0.0)
    """how many standard deviations of the ensemble are held against a gait: small perturbations that grow are spread"""
    bounds: ActuatorBounds = eqx.field(default_factory=ActuatorBounds)

    def __check_init__(self):
        if self.robots < 1:
            raise InputError(f"robots = {self.robots}: expected at least 1")
        if self.robots == 1 and self.caution:
            raise InputError(f"caution = {self.caution}: one robot has no spread; expected robots = 2 or more")
        if self.uncertainty.none and self.caution:
            raise InputError(
                f"caution = {self.caution}: nothing is uncertain, nothing spreads; expected an uncertainty"
            )

    @property
    def needs_metrics(self) -> bool:
        """Whether rollouts have to be measured step by step."""
        return self.objective.needs_metrics or bool(self.bounds.given)

    @property
    def rollouts(self) -> int:
        """That judge one gait: where nothing is uncertain, one says it all."""
        return 1 if self.uncertainty.none else self.robots

    def worth(self, scene: Scene, outcomes: Outcomes, duration: Scalar) -> PerGait:
        """(population,): the objective, within the bounds."""
        worth = self.objective.worth(scene, outcomes, duration)
        return self.bounds.applied(worth, metrics_of(outcomes)) if self.bounds.given else worth


def with_robots(fitness: Fitness, robots: int) -> Fitness:
    """The same fitness by an ensemble of another size."""
    return Fitness(fitness.objective, fitness.uncertainty, robots, fitness.caution, fitness.bounds)


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
def judge(key, scene: Scene, gaits: Gait, duration: Scalar, options: ResolvedOptions, fitness: Fitness) -> Scores:
    """Score every gait by its ensemble, all of them rolled out in one call."""
    differences = None
    if not fitness.uncertainty.none:
        gaits, differences = ensemble(key, scene, gaits, fitness.uncertainty, fitness.robots)
    outcomes = roll_out(scene, gaits, duration, options, differences, with_metrics=fitness.needs_metrics)
    return scored(fitness.worth(scene, outcomes, duration).reshape(-1, fitness.rollouts), fitness.caution)


def scored(each: Float[AnyArray, "population robots"], caution: float) -> Scores:
    """The scores of gaits of whose ensembles every robot was worth so much."""
    failed = ~jnp.isfinite(each).all(1)
    mean, spread = each.mean(1), each.std(1)
    worth = jnp.where(failed, -jnp.inf, mean - caution * spread)
    return Scores(worth, mean, spread, failed, each)


def judge_until(
    judged: Callable[[int], Scores], robots: int, caution: float, enough: Callable[[np.ndarray], bool]
) -> Scores:
    """Scores over more and more robots: `judged(k)` for k = 0, 1, ..., until `enough(each)`, or there are so many.

    Every round has other draws. Of a round's robots the second half has the opposite draws of the first; it is so in
    what comes back too.
    """
    found = jax.tree.map(np.asarray, judged(0))
    rounds = [found.each.reshape(len(found.each), 2 - found.each.shape[1] % 2, -1)]
    while found.each.shape[1] < robots and not enough(found.each):
        rounds.append(np.asarray(judged(len(rounds)).each).reshape(rounds[0].shape))
        each = np.concatenate(rounds, axis=2)
        found = jax.tree.map(np.asarray, scored(each.reshape(len(each), -1), caution))
    return found


def standard_error(each: PerGait) -> float:
    """Of the mean over robots whose second half has the opposite draws of the first, so that pairs are independent."""
    pairs = np.asarray(each.reshape(2, -1).mean(0) if each.size % 2 == 0 else each)
    return float(pairs.std(ddof=1) / np.sqrt(pairs.size)) if pairs.size > 1 else np.inf
