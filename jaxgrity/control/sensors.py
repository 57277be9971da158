"""What a robot senses: orientation and spin of its struts, lengths and tensions of its cables, contact, its place.

Sensors err: they add a bias that stays and noise that does not, are read less often than commands are given, and what
they say arrives late.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxgrity.core.arguments import check_count
from jaxgrity.core.errors import InputError
from jaxgrity.core.primitives import edge_vectors, inverse, length, scale
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, NodeVectors, Scalar
from jaxgrity.model.scales import length_scale
from jaxgrity.model.scene import Scene
from jaxgrity.stepping.dynamics import centre_of_mass, member_tensions


class Observation(NamedTuple):
    """What sensors say of one robot."""

    directions: Float[AnyArray, "struts 3"]
    """unit vectors along the struts, from the second end to the first, in the coordinates of the ground"""
    spins: Float[AnyArray, "struts 3"]
    """rad/s, angular velocity of each strut; none about itself"""
    cable_lengths: Float[AnyArray, " cables"]
    """m"""
    tensions: Float[AnyArray, " cables"]
    """N, by the law of each cable without its damper; 0 where a cable is slack"""
    contact: Float[AnyArray, " nodes"]
    """1 where a node touches the ground, else 0"""
    place: Float[AnyArray, "3"]
    """m, of the centre of mass, as a camera above the ground or a radio beacon tells it"""


class Errors(NamedTuple):
    """How large the error of each part of an `Observation` is: a standard deviation, in the part's unit.

    Directions stay unit vectors, and no tension is negative.
    """

    directions: float = 0.0
    """of each component: about the angle in rad"""
    spins: float = 0.0
    cable_lengths: float = 0.0
    tensions: float = 0.0
    contact: float = 0.0
    """the probability, not a standard deviation, with which a node's contact is told wrongly"""
    place: float = 0.0


class Readings(NamedTuple):
    """What sensors carry from one control period to the next."""

    bias: Observation | None
    """None: the sensors have none"""
    recent: Observation | None
    """the last ones, newest first, as an axis in front of every array; None: nothing is held or late"""


class Sensors(eqx.Module):
    """How sensors err; by default they do not.

    Raises `InputError` where a standard deviation is negative or not finite, a probability is above 1, a delay is
    negative, or control periods are no whole numbers.
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
        """Whether anything is carried from one control period to the next: a bias, or readings held or late."""
        return any(self.bias) or self.every > 1 or self.delay > 0

    def __check_init__(self):
        if not (isinstance(self.noise, Errors) and isinstance(self.bias, Errors)):
            raise InputError("sensors: noise and bias are no `Errors`; expected such as Errors(place=0.01)")
        sizes = np.array([*self.noise, *self.bias], float)
        if not (np.isfinite(sizes).all() and (sizes >= 0).all() and max(self.noise.contact, self.bias.contact) <= 1):
            raise InputError(
                f"sensors: noise = {self.noise}, bias = {self.bias}; expected finite numbers, none negative, "
                "and for contact at most 1"
            )
        check_count("sensors.every", self.every, 1)
        check_count("sensors.delay", self.delay, 0)


@typed
def measure(scene: Scene, t: Scalar, q: NodeVectors, v: NodeVectors) -> Observation:
    """What sensors without any error say of a robot at time t, s, at `q`, m, with velocities `v`, m/s.

    A strut along d = x_i - x_j spins by d × (v_i - v_j)/|d|². A cable pulls by its law: K max(0, l - L(t)), a table
    of forces, a limit, one tension in a cluster. A node touches the ground where phi < `Ground.touched_below`.
    """
    nothing: AnyArray = jnp.zeros((0, 3), q.dtype)
    directions, spins, lengths, tensions = nothing, nothing, nothing[:, 0], nothing[:, 0]
    contact: AnyArray = jnp.zeros_like(q[:, 0])
    if scene.structure.struts is not None:
        d, rate = (edge_vectors(x, scene.structure.struts.edges) for x in (q, v))
        each = inverse(length(d))
        directions = scale(d, each)
        spins = jnp.cross(directions, scale(rate, each))
    cables = scene.structure.cables
    if cables is not None:
        lengths = length(edge_vectors(q, cables.edges))
        tensions = member_tensions(scene, t, q)["cables"]
    if scene.ground is not None:
        contact = (scene.ground.signed_distance(q) < scene.ground.touched_below * length_scale(scene)).astype(q.dtype)
    return Observation(directions, spins, lengths, tensions, contact, centre_of_mass(scene, q))


@typed
def first_readings(sensors: Sensors, seen: Observation, key: Any) -> Readings:
    """Before the first control period; `seen` is what sensors without error say, of one robot or of many.

    A robot that has stood still until then has been read before: late sensors begin with one such reading, which errs
    as all others do.
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
    """What arrives in control period number `tick`, and what sensors carry on.

    Arithmetic is by elements, so that it is the same for one robot and for many with the population last.
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
    """Errors of contact turn a bit over; all others are added."""
    off = jax.tree.map(jnp.add, seen, error)
    off = off._replace(contact=jnp.abs(seen.contact - error.contact))
    if size.directions:
        off = off._replace(directions=off.directions / jnp.linalg.norm(off.directions, axis=1, keepdims=True))
    return off._replace(tensions=jnp.maximum(off.tensions, 0)) if size.tensions else off


def _drawn(size: Errors, like: Observation, key: Any) -> Observation:
    """Normal deviates, and 1 for contact that is wrong; zeros, without any drawing, where they have no size."""
    keys = Observation(*jax.random.split(key, len(like)))
    normal = lambda s, x, k: s * jax.random.normal(k, x.shape, x.dtype) if s else jnp.zeros_like(x)  # noqa: E731
    drawn = Observation(*(normal(*part) for part in zip(size, like, keys)))
    wrong = jax.random.bernoulli(keys.contact, size.contact, like.contact.shape)
    return drawn._replace(contact=wrong.astype(like.contact.dtype))
