"""The robot's symmetries in what a policy sees: each state is shown in the pose that is nearest to the built one.

Numbers of nodes mean nothing to the physics. If a robot's nodes are renumbered so that masses, springs and motors stay
as they are, its motion is the same motion with other numbers. On level ground it also stays the same motion if the
robot is turned about the vertical. So a policy has to know what to do in one of these poses only. It is then
equivariant: in all others it does the same, by other motors and in another direction. (Canonicalisation: Kaba et al.
2023, arXiv:2211.06489.)
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.control.environments import Environment
from jaxgrity.control.sensors import Observation, turning_pairs
from jaxgrity.control.tasks import Task
from jaxgrity.core.errors import InputError
from jaxgrity.core.primitives import inverse, length
from jaxgrity.core.types import AnyArray
from jaxgrity.model.laws import Symmetry
from jaxgrity.model.scene import Scene
from jaxgrity.model.symmetry import kept_by, symmetries

NO_TURN, BY_DIRECTION, BY_POSE = "", "direction", "pose"
"""Turns about the vertical: none; so that the wanted direction is +x; or, without one, to the built pose."""
SOME_ANGLE = 1.0
"""An angle about the vertical, rad: what stays the same after it does so after all."""
STATES, PERIOD, AS_EQUAL = 16, 0.01, 1e-3
"""Random states at which the progress of a task of one's own is compared, their period, s, and how nearly, m/s."""
SAME_ROBOT = 0.1
"""Largest difference of the cosines between struts, as built, of two robots that a policy takes for one: 6 degrees."""


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
    members: tuple[int, ...] = eqx.field(static=True)
    """that the actions are for"""

    @property
    def shape(self) -> dict[str, Any]:
        """All from which `empty` makes a pose with the same shapes: numbers of parts, the turn, and the members."""
        way = self.exchange
        parts = {name: getattr(way, name).shape[1] for name in ("turning", "cables", "nodes")}
        return parts | {"symmetries": len(way.mirror), "turned": self.turned, "members": self.members}

    @staticmethod
    def empty(
        turning: int, cables: int, nodes: int, symmetries: int, turned: str, members: Sequence[int]
    ) -> "CanonicalPose":
        """A pose whose arrays a file fills. Raises `ValueError` for an unknown turn."""
        if turned not in (NO_TURN, BY_DIRECTION, BY_POSE):
            raise ValueError(turned)
        sizes = (turning, turning, None, cables, nodes, len(members))
        kinds = (jnp.int32, jnp.float32, jnp.float32, jnp.int32, jnp.int32, jnp.int32)
        shapes = ((symmetries,) if size is None else (symmetries, size) for size in sizes)
        way = Exchange(*(jnp.zeros(shape, kind) for shape, kind in zip(shapes, kinds)))
        return CanonicalPose(jnp.zeros((turning, 3), jnp.float32), way, turned, tuple(members))

    def misfit(self, environment: Environment) -> str | None:
        """What of an environment is not of the robot, or the kind of task, that this pose is of; None: nothing.

        Robots may differ a little, by `SAME_ROBOT`, and in all but their shape: masses, ground, motors.
        """
        if self.members != environment.plant.members:
            return f"it moves members {list(self.members)}, and the environment {list(environment.plant.members)}"
        shapes = [np.asarray(each) @ np.asarray(each).T for each in (_built(environment.scene), self.built)]
        if shapes[0].shape != shapes[1].shape or np.abs(shapes[0] - shapes[1]).max(initial=0) > SAME_ROBOT:
            return "it is of a robot whose struts have other directions"
        without = environment.task.towards == "anywhere"
        if self.turned != NO_TURN and (self.turned == BY_POSE) != without:
            return f"it learned a task {'with' if without else 'without'} a wanted direction"
        return None

    def seen(self, observation: AnyArray) -> tuple[AnyArray, AnyArray]:
        """The observation in the canonical pose, and the number of the symmetry that leads there.

        `observation` is that of an environment: see `sensed`.
        """
        built, exchange = jax.lax.stop_gradient((self.built, self.exchange))
        told = self._parts(observation)
        directions, spins = told.directions, told.spins
        wanted: AnyArray = told.place
        if self.turned == BY_DIRECTION:
            (size,), (along,) = _polar(wanted[None])
            directions, spins = (_turned(x, along) for x in (directions, spins))
            wanted = jnp.stack([size, jnp.zeros_like(size)])
        all_ways = jax.vmap(_exchanged, (None, 0))(directions, exchange)
        fit, along = self._fits(built, all_ways)
        which = jnp.argmax(fit)
        way = jax.tree.map(lambda x: x[which], exchange)
        directions, spins = all_ways[which], _spins_exchanged(spins, way)
        wanted = wanted * jnp.stack([jnp.ones_like(way.mirror), way.mirror])
        if self.turned == BY_POSE:
            directions, spins = (_turned(x, along[which]) for x in (directions, spins))
        lengths, tensions = (x[way.cables] for x in (told.cable_lengths, told.tensions))
        shown = (directions, spins, lengths, tensions, told.contact[way.nodes], wanted, told.contraction[way.motors])
        return jnp.concatenate([jnp.ravel(x) for x in shown]).astype(observation.dtype), which

    def placed(self, action: AnyArray, which: AnyArray) -> AnyArray:
        """The action of each motor, (actuators,), by one in the canonical pose of symmetry number `which`."""
        return action[jnp.argsort(self.exchange.motors, axis=1)[which]]

    def _fits(self, built: AnyArray, directions: AnyArray) -> tuple[AnyArray, AnyArray]:
        """How near (symmetries, turning, 3) are to the built pose, (symmetries,), and where its +x is, (symmetries, 2).

        The turn that fits best has the tangent of sum (b × d)_z over sum (b·d of x and y).
        """
        products = jnp.sum(built * directions, axis=1)
        if self.turned != BY_POSE:
            return products.sum(-1), products[:, :2]
        crossed = built[:, 0] * directions[..., 1] - built[:, 1] * directions[..., 0]
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
    they are, and so does the task's progress. The ground's bumps of a task are random, so they count as level. A robot
    with supports is not turned.
    """
    scene, task, members = _as_if_level(environment), environment.task, environment.plant.members
    own = {type(law) for law in Scene(scene.structure).laws}
    kept = kept_by(scene, [law for law in scene.laws if type(law) not in own])
    held = scene.structure.fixed or scene.shaking is not None
    first, turn, mirrored = _identity(scene), _turn(SOME_ANGLE), _progress_kept(task, np.diag([1.0, -1.0, 1.0]))
    ways = [first] if held else [s for s in _renumberings(scene, first) if kept(s) and (mirrored or s.matrix[1, 1] > 0)]
    found = [way for s in ways if (way := _exchange(scene, members, s)) is not None]
    together = Exchange(*(jnp.asarray(np.array(x)) for x in zip(*found)))
    turned = NO_TURN
    if not held and kept(first._replace(matrix=turn)) and _progress_kept(task, turn):
        if task.towards != "anywhere":
            turned = BY_DIRECTION
        elif type(task).wanted_direction is Task.wanted_direction:
            turned = BY_POSE
    return CanonicalPose(jnp.asarray(_built(scene), jnp.float32), together, turned, members)


def _progress_kept(task: Task, matrix: np.ndarray) -> bool:
    """Whether the task's progress is the same for a robot whose aim and way, and what is remembered, are turned or
    mirrored: at random states, for a task of one's own."""
    if type(task).progressed is Task.progressed:
        return True
    random = np.random.default_rng(0)

    def progress(aim, average, before, place, m):
        to, remembered = (jnp.asarray(m[:2, :2] @ x) for x in (aim, average))
        return task.progressed(to, jnp.asarray(m @ before), jnp.asarray(m @ place), PERIOD, remembered)[0]

    for _ in range(STATES):
        aim, average, before = (random.normal(size=n) for n in (2, 2, 3))
        state = aim, average, before, before + PERIOD * random.normal(size=3)
        if not np.allclose(progress(*state, np.eye(3)), progress(*state, matrix), rtol=AS_EQUAL, atol=AS_EQUAL):
            return False
    return True


def _built(scene: Scene) -> np.ndarray:
    """(turning, 3), directions of struts and bodies as built."""
    nodes, pairs = np.asarray(scene.structure.nodes, float), turning_pairs(scene.structure)
    vectors = np.array([nodes[i] - nodes[j] for i, j in pairs]).reshape(-1, 3)
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _as_if_level(environment: Environment) -> Scene:
    scene = environment.scene
    if not environment.task.bumps or scene.ground is None:
        return scene
    return dataclasses.replace(scene, ground=dataclasses.replace(scene.ground, surface=None))  # type: ignore[call-arg]


def _turn(angle: float) -> np.ndarray:
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def _renumberings(scene: Scene, first: Symmetry) -> list[Symmetry]:
    """Ways to renumber nodes, with what they do in space: nothing, or y becomes -y. The identity is `first`."""
    try:
        found = symmetries(scene.structure)
    except InputError:  # positions do not say what is exchanged
        return [first]
    in_space = [np.diag([1.0, np.sign(np.linalg.det(s.matrix)), 1.0]) for s in found]
    return [s._replace(matrix=matrix) for s, matrix in zip(found, in_space)]


def _identity(scene: Scene) -> Symmetry:
    structure = scene.structure
    members = sum(len(kind.edges) for kind in structure.members)
    return Symmetry(tuple(range(len(structure.nodes))), np.eye(3), tuple(range(members)))


def _exchange(scene: Scene, actuated: tuple[int, ...], symmetry: Symmetry) -> Exchange | None:
    """What a symmetry does to readings; None where it moves what is read, or actuated, to what is not."""
    pairs = turning_pairs(scene.structure)
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
