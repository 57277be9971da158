"""The robot's symmetries in what a policy sees: each state is shown in the pose that is nearest to the built one.

Names of nodes mean nothing to the physics. If a robot's nodes exchange their names so that masses, springs and motors
stay as they are, its motion is the same motion under other names. On level ground it also stays the same motion if the
robot is turned about the vertical. So a policy has to know what to do in one of these poses only. It is then
equivariant: in all others it does the same, by other motors and in another direction. (Canonicalisation: Kaba et al.
2023, arXiv:2211.06489.)
"""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.control.environments import Environment
from jaxgrity.control.sensors import Observation, turning_pairs
from jaxgrity.core.errors import InputError
from jaxgrity.core.primitives import inverse, length
from jaxgrity.core.types import AnyArray
from jaxgrity.model.law_symmetry import keeps
from jaxgrity.model.laws import Symmetry
from jaxgrity.model.scene import Scene
from jaxgrity.model.symmetry import symmetries

NO_TURN, BY_DIRECTION, BY_POSE = "", "direction", "pose"
"""Turns about the vertical: none; so that the wanted direction is +x; or, without one, to the built pose."""
SOME_ANGLE = 1.0
"""An angle about the vertical, rad: what stays the same after it does so after all."""


class Exchange(NamedTuple):
    """One symmetry: the old place of each reading in its new order. Arrays have all symmetries in front."""

    turning: AnyArray
    """of directions and spins"""
    signs: AnyArray
    """of directions: -1 where the ends of a strut are exchanged"""
    mirror: AnyArray
    """of y: -1 where left and right are exchanged"""
    cables: AnyArray
    nodes: AnyArray
    motors: AnyArray


class CanonicalPose(eqx.Module):
    """How a policy sees a robot: by that symmetry and turn after which it is nearest to the built pose.

    Nearest: the sum of products of the directions of struts with those as built is largest.
    """

    built: AnyArray
    """(turning, 3), directions of the struts, then of bodies, of the robot as built"""
    exchange: Exchange
    """of all symmetries; the identity first"""
    turned: str = eqx.field(static=True)
    """one of `NO_TURN`, `BY_DIRECTION`, `BY_POSE`"""

    @property
    def shape(self) -> dict[str, Any]:
        """All from which `empty` makes a pose with the same shapes: numbers of parts, and the turn."""
        way = self.exchange
        parts = {name: getattr(way, name).shape[1] for name in ("turning", "cables", "nodes", "motors")}
        return parts | {"symmetries": len(way.mirror), "turned": self.turned}

    @staticmethod
    def empty(turning: int, cables: int, nodes: int, motors: int, symmetries: int, turned: str) -> "CanonicalPose":
        """A pose whose arrays a file fills."""
        sizes = (turning, turning, None, cables, nodes, motors)
        kinds = (jnp.int32, jnp.float32, jnp.float32, jnp.int32, jnp.int32, jnp.int32)
        shapes = ((symmetries,) if size is None else (symmetries, size) for size in sizes)
        way = Exchange(*(jnp.zeros(shape, kind) for shape, kind in zip(shapes, kinds)))
        return CanonicalPose(jnp.zeros((turning, 3), jnp.float32), way, turned)

    def seen(self, observation: AnyArray) -> tuple[AnyArray, AnyArray]:
        """The observation in the canonical pose, and the number of the symmetry that leads there.

        `observation` is that of an environment: see `sensed`.
        """
        told = self._parts(observation)
        directions, spins = told.directions, told.spins
        wanted: AnyArray = told.place
        if self.turned == BY_DIRECTION:
            (size,), (along,) = _polar(wanted[None])
            directions, spins = (_turned(x, along) for x in (directions, spins))
            wanted = jnp.stack([size, jnp.zeros_like(size)])
        all_ways = jax.vmap(_exchanged, (None, 0))(directions, self.exchange)
        fit, along = self._fits(all_ways)
        which = jnp.argmax(fit)
        way = jax.tree.map(lambda x: x[which], self.exchange)
        directions, spins = all_ways[which], _spins_exchanged(spins, way)
        if self.turned == BY_POSE:
            directions, spins = (_turned(x, along[which]) for x in (directions, spins))
        lengths, tensions = (x[way.cables] for x in (told.cable_lengths, told.tensions))
        shown = (directions, spins, lengths, tensions, told.contact[way.nodes], wanted, told.contraction[way.motors])
        return jnp.concatenate([jnp.ravel(x) for x in shown]).astype(observation.dtype), which

    def placed(self, action: AnyArray, which: AnyArray) -> AnyArray:
        """The action of each motor, (actuators,), by one in the canonical pose of symmetry number `which`."""
        return action[jnp.argsort(self.exchange.motors, axis=1)[which]]

    def _fits(self, directions: AnyArray) -> tuple[AnyArray, AnyArray]:
        """How near (symmetries, turning, 3) are to the built pose, (symmetries,), and where its +x is, (symmetries, 2).

        The turn that fits best has the tangent of sum (b × d)_z over sum (b·d of x and y).
        """
        products = jnp.sum(self.built * directions, axis=1)
        if self.turned != BY_POSE:
            return products.sum(-1), products[:, :2]
        crossed = self.built[:, 0] * directions[..., 1] - self.built[:, 1] * directions[..., 0]
        size, along = _polar(jnp.stack([products[:, 0] + products[:, 1], crossed.sum(1)], axis=-1))
        return size + products[:, 2], along

    def _parts(self, observation: AnyArray) -> Observation:
        """The readings of an observation, with the wanted direction, (2,), for the place."""
        way = self.exchange
        turning, cables, nodes, motors = (x.shape[1] for x in (way.turning, way.cables, way.nodes, way.motors))
        sizes = (3 * turning, 3 * turning, cables, cables, nodes, 2, motors)
        parts = Observation(*jnp.split(observation, np.cumsum(sizes)[:-1]))
        each = lambda x: x.reshape(turning, 3)  # noqa: E731
        return parts._replace(directions=each(parts.directions), spins=each(parts.spins))


def canonical_pose(environment: Environment) -> CanonicalPose:
    """The pose in which policies of this environment see the robot. Without symmetry, each state is seen as it is.

    Left and right are exchanged, and the robot is turned, only where its ground, and all laws of the scene, stay as
    they are. The ground's bumps of a task are random, so they count as level. A robot with supports is not turned.
    """
    scene = _as_if_level(environment)
    pairs = turning_pairs(scene.structure)
    ways = [way for s in _kept(scene) if (way := _exchange(scene, environment.plant.members, pairs, s)) is not None]
    together = Exchange(*(jnp.asarray(np.array(x)) for x in zip(*ways)))
    nodes = np.asarray(scene.structure.nodes, float)
    built = np.array([nodes[i] - nodes[j] for i, j in pairs]).reshape(-1, 3)
    built = built / np.linalg.norm(built, axis=1, keepdims=True)
    turned = NO_TURN
    if _turns(scene):
        turned = BY_POSE if environment.task.towards == "anywhere" else BY_DIRECTION
    return CanonicalPose(jnp.asarray(built, jnp.float32), together, turned)


def _as_if_level(environment: Environment) -> Scene:
    scene = environment.scene
    if not environment.task.bumps or scene.ground is None:
        return scene
    return dataclasses.replace(scene, ground=dataclasses.replace(scene.ground, surface=None))  # type: ignore[call-arg]


def _turns(scene: Scene) -> bool:
    """Whether all stays as it is when the robot is turned about the vertical."""
    cos, sin = np.cos(SOME_ANGLE), np.sin(SOME_ANGLE)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return not scene.structure.fixed and scene.shaking is None and _keeps(scene, _identity(scene)._replace(matrix=turn))


def _kept(scene: Scene) -> list[Symmetry]:
    """Exchanges of names, with what they do in space: nothing, or y becomes -y."""
    first = _identity(scene)
    if scene.structure.fixed or scene.shaking is not None:
        return [first]
    try:
        found = symmetries(scene.structure)
    except InputError:  # positions do not say what is exchanged
        return [first]
    in_space = [np.diag([1.0, np.sign(np.linalg.det(s.matrix)), 1.0]) for s in found]
    moved = [s._replace(matrix=matrix) for s, matrix in zip(found, in_space)]
    return [s for s in moved if _keeps(scene, s)]


def _identity(scene: Scene) -> Symmetry:
    structure = scene.structure
    members = sum(len(kind.edges) for kind in structure.members)
    return Symmetry(tuple(range(len(structure.nodes))), np.eye(3), tuple(range(members)))


def _keeps(scene: Scene, symmetry: Symmetry) -> bool:
    """Whether gravity, ground and all other laws beside the structure's own stay as they are."""
    own = {type(law) for law in Scene(scene.structure).laws}
    balls = None if scene.ground is None else scene.ground.balls
    alike = balls is None or balls.turn_alike(scene.structure.bodies, symmetry.nodes)
    return alike and all(keeps(law, scene)(symmetry) for law in scene.laws if type(law) not in own)


def _exchange(scene: Scene, actuated: tuple[int, ...], pairs: Any, symmetry: Symmetry) -> Exchange | None:
    """What a symmetry does to readings; None where it moves what is read, or actuated, to what is not."""
    number = {pair: (k, 1.0) for k, pair in enumerate(pairs)} | {(j, i): (k, -1.0) for k, (i, j) in enumerate(pairs)}
    images = [number.get((symmetry.nodes[i], symmetry.nodes[j])) for i, j in pairs]
    members = [symmetry.members[k] for k in actuated]
    if None in images or set(members) != set(actuated):
        return None
    places = [image[0] for image in images if image is not None]
    signs = np.array([image[1] for image in images if image is not None])
    first, cables = scene.structure.first_cable, scene.structure.cables
    numbers = () if cables is None else range(first, first + len(cables.edges))
    old = lambda new: np.argsort(np.array(new, int)).astype(np.int32)  # noqa: E731
    came = old(places)
    return Exchange(
        came,
        signs[came].astype(np.float32),
        np.array(symmetry.matrix[1, 1], np.float32),
        old([symmetry.members[k] - first for k in numbers]),
        old(symmetry.nodes),
        old([actuated.index(k) for k in members]),
    )


def _exchanged(directions: AnyArray, way: Exchange) -> AnyArray:
    return directions[way.turning] * way.signs[:, None] * jnp.array([1.0, way.mirror, 1.0])


def _spins_exchanged(spins: AnyArray, way: Exchange) -> AnyArray:
    # a mirror turns the sense of rotation; a strut spins alike from either end
    return spins[way.turning] * jnp.array([way.mirror, 1.0, way.mirror])


def _polar(vectors: AnyArray) -> tuple[AnyArray, AnyArray]:
    """Lengths and directions of vectors in the plane, (n, 2); +x for one of zero, with derivatives of zero."""
    size = length(jnp.pad(vectors, ((0, 0), (0, 1))))
    ahead = jnp.array([1, 0], vectors.dtype) * (size == 0)[:, None]
    return size, vectors * inverse(size)[:, None] + ahead


def _turned(vectors: AnyArray, along: AnyArray) -> AnyArray:
    """Vectors (n, 3) after the turn about the vertical that takes the unit vector `along`, (2,), to +x."""
    cos, sin = along
    x, y, z = vectors.T
    return jnp.stack([cos * x + sin * y, cos * y - sin * x, z], axis=-1)
