"""Sensors: orientation and spin of struts and bodies, lengths and tensions of cables, contact, place, motors.

Sensors err: constant bias, random noise, a reading only every few control periods, and delay.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxgrity.core.arguments import check_count, check_number
from jaxgrity.core.errors import InputError
from jaxgrity.core.primitives import edge_vectors, inverse, length, scale
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, Edges, NodeVectors, Scalar
from jaxgrity.model.actuation import Actuation, contraction
from jaxgrity.model.pulleys import path_lengths
from jaxgrity.model.scales import length_scale
from jaxgrity.model.scene import Scene
from jaxgrity.model.structure import Structure
from jaxgrity.stepping.dynamics import centre_of_mass, member_tensions


class Observation(NamedTuple):
    """The sensors' readings of one robot."""

    directions: Float[AnyArray, "turning 3"]
    """unit vectors along the struts, from the second end to the first, in the coordinates of the ground; then of each
    rigid body, from its second basic point to its first, and from the third where there is one"""
    spins: Float[AnyArray, "turning 3"]
    """rad/s, angular velocity of each direction, not about itself; by complementarity stepping half a step earlier"""
    cable_lengths: Float[AnyArray, " cables"]
    """m; beside pulleys with half of each arc"""
    tensions: Float[AnyArray, " cables"]
    """N, by the law of each cable without its damper; 0 where a cable is slack"""
    contact: Float[AnyArray, " nodes"]
    """1 where a node touches the ground, else 0"""
    place: Float[AnyArray, "3"]
    """m, of the centre of mass, as a camera above the ground or a radio beacon tells it"""
    contraction: Float[AnyArray, " actuators"]
    """fraction by which each actuated member is shortened, as the encoders of its motors tell it: not where it is
    stuck"""


class Errors(NamedTuple):
    """The standard deviation of the error of each part of an `Observation`, in the part's unit.

    Directions stay unit vectors, and no tension is negative.
    """

    directions: float = 0.0
    """of each component: about the angle in rad"""
    spins: float = 0.0
    cable_lengths: float = 0.0
    tensions: float = 0.0
    contact: float = 0.0
    """probability of a wrong reading of a node's contact (no standard deviation)"""
    place: float = 0.0
    contraction: float = 0.0


class Readings(NamedTuple):
    """The carry of sensors from one control period to the next."""

    bias: Observation | None
    """None: the sensors have none"""
    recent: Observation | None
    """the last ones, newest first, as an axis in front of every array; None: nothing is held or late"""


class Sensors(eqx.Module):
    """The errors of sensors; by default none.

    Raises `InputError` for a standard deviation that is negative or not finite, a probability above 1, a negative
    delay, or a number of control periods that is not whole.
    """

    noise: Errors = eqx.field(static=True, default=Errors())
    """drawn anew in every reading"""
    bias: Errors = eqx.field(static=True, default=Errors())
    """drawn once"""
    every: int = eqx.field(static=True, default=1)
    """control periods from one reading to the next, between which the last one is held"""
    delay: int = eqx.field(static=True, default=0)
    """control periods until a reading arrives"""

    @property
    def remember(self) -> bool:
        """Whether there is a carry between control periods: a bias, or held or late readings."""
        return any(self.bias) or self.every > 1 or self.delay > 0

    def __check_init__(self):
        if not (isinstance(self.noise, Errors) and isinstance(self.bias, Errors)):
            raise InputError("sensors: noise and bias are no `Errors`; expected such as Errors(place=0.01)")
        for name in ("noise", "bias"):
            sizes: Errors = getattr(self, name)
            for part, size in sizes._asdict().items():
                most = 1.0 if part == "contact" else np.inf
                check_number(f"sensors.{name}.{part}", size, least=0.0, most=most)
        check_count("sensors.every", self.every, 1)
        check_count("sensors.delay", self.delay, 0)


@typed
def measure(scene: Scene, t: Scalar, q: NodeVectors, v: NodeVectors) -> Observation:
    """The readings of sensors without errors at time t, s, at `q`, m, with velocities `v`, m/s.

    A strut along d = x_i - x_j spins by d × (v_i - v_j)/|d|². So does each direction of a body. A cable pulls by its
    law: K max(0, l - L(t)), a table of forces, a limit, one tension in a cluster. A node touches the ground where
    phi < `Ground.touched_below`. Contractions are those of the scene's gait.
    """
    nothing: AnyArray = jnp.zeros((0, 3), q.dtype)
    directions, spins, lengths, tensions = nothing, nothing, nothing[:, 0], nothing[:, 0]
    contact: AnyArray = jnp.zeros_like(q[:, 0])
    if turning := turning_pairs(scene.structure):
        d, rate = (edge_vectors(x, turning) for x in (q, v))
        each = inverse(length(d))
        directions = scale(d, each)
        spins = jnp.cross(directions, scale(rate, each))
    cables = scene.structure.cables
    if cables is not None:
        lengths = path_lengths(cables, edge_vectors(q, cables.edges), q)
        tensions = member_tensions(scene, t, q)["cables"]
    if scene.ground is not None:
        contact = (scene.ground.signed_distance(q) < scene.ground.touched_below * length_scale(scene)).astype(q.dtype)
    shortened = nothing[:, 0] if scene.gait is None else _shortened(scene, scene.gait, t)
    return Observation(directions, spins, lengths, tensions, contact, centre_of_mass(scene, q), shortened)


def _shortened(scene: Scene, gait: Actuation, t: Scalar) -> AnyArray:
    """(actuators,), fraction by which each member of the gait is shortened; 0 of those that are stuck."""
    found, works = contraction(gait, t), moving(scene.structure, gait.members)
    return found if works.all() else found * works.astype(found.dtype)


def moving(structure: Structure, members: tuple[int, ...]) -> np.ndarray:
    """(actuators,), whether each of the actuated members moves: those that are stuck do not."""
    stuck = {first + k for _, each, first in structure.numbered for k in each.stuck}
    return np.array([k not in stuck for k in members])


def turning_pairs(structure: Structure) -> Edges:
    """The pairs of nodes whose direction sensors measure: ends of struts, and basic points of bodies."""
    struts = () if structure.struts is None else structure.struts.edges
    return (*struts, *((body.basic[0], other) for body in structure.bodies for other in body.basic[1:3]))


@typed
def first_readings(sensors: Sensors, seen: Observation, key: Any) -> Readings:
    """The readings before the first control period; `seen`: those without errors, of one robot or of many.

    A robot at rest until then has been read before: late sensors begin with one such reading, with its own error.
    """
    of_bias, of_noise = jax.random.split(key)
    bias = _drawn(sensors.bias, seen, of_bias) if any(sensors.bias) else None
    kept = sensors.delay + 1
    held = sensors.every > 1 or sensors.delay > 0
    before = _erring(sensors, seen, bias, of_noise)
    recent = jax.tree.map(lambda x: jnp.broadcast_to(x, (kept, *x.shape)), before) if held else None
    return Readings(bias, recent)  # type: ignore[arg-type]


@typed
def read(sensors: Sensors, seen: Observation, readings: Readings, tick: Any, key: Any) -> tuple[Observation, Readings]:
    """The readings that arrive in control period number `tick`, and the sensors' carry.

    All arithmetic is elementwise: the same for one robot and for many with the population last.
    """
    new = _erring(sensors, seen, readings.bias, key)
    if readings.recent is None:
        return new, readings
    if sensors.every > 1:
        due = tick % sensors.every == 0
        new = jax.tree.map(lambda x, held: jnp.where(due, x, held[0]), new, readings.recent)
    recent = jax.tree.map(lambda x, held: jnp.concatenate([x[None], held[:-1]]), new, readings.recent)
    return jax.tree.map(lambda held: held[-1], recent), Readings(readings.bias, recent)


def _erring(sensors: Sensors, seen: Observation, bias: Observation | None, key: Any) -> Observation:
    """One reading, with its bias and its noise."""
    if bias is not None:
        seen = _with_error(sensors.bias, seen, bias)
    if any(sensors.noise):
        seen = _with_error(sensors.noise, seen, _drawn(sensors.noise, seen, key))
    return seen


def _with_error(size: Errors, seen: Observation, error: Observation) -> Observation:
    """Errors of contact flip a bit; all others are added."""
    off = jax.tree.map(jnp.add, seen, error)
    off = off._replace(contact=jnp.abs(seen.contact - error.contact))
    if size.directions:
        off = off._replace(directions=off.directions / jnp.linalg.norm(off.directions, axis=1, keepdims=True))
    return off._replace(tensions=jnp.maximum(off.tensions, 0)) if size.tensions else off


def _drawn(size: Errors, like: Observation, key: Any) -> Observation:
    """Normal deviates, and 1 for wrong contact; zeros, without a draw, where errors have no size."""
    keys = Observation(*jax.random.split(key, len(like)))
    normal = lambda s, x, k: s * jax.random.normal(k, x.shape, x.dtype) if s else jnp.zeros_like(x)  # noqa: E731
    drawn = Observation(*(normal(*part) for part in zip(size, like, keys)))
    wrong = jax.random.bernoulli(keys.contact, size.contact, like.contact.shape)
    return drawn._replace(contact=wrong.astype(like.contact.dtype))
