"""Rotations and mirrorings that map a structure on itself, and a gait on gaits that roll the same way elsewhere."""

from collections.abc import Callable, Sequence

import jax
import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.model.actuation import Gait
from jaxgrity.model.law_symmetry import keeps
from jaxgrity.model.laws import SAME, Law, Symmetry, unchanged
from jaxgrity.model.scene import Scene
from jaxgrity.model.structure import Structure


@typed
def symmetries(structure: Structure, mirrors: bool = True) -> tuple[Symmetry, ...]:
    """All maps under which masses, supports, struts and cables, with all their properties, stay as they are, to `SAME`.

    The identity first, then rotations, then, where asked for, those with a mirror. Raises `InputError` where positions
    do not decide the map: all nodes lie in a plane with the centre of mass, or two are in one place.
    """
    mass, x = np.asarray(structure.lumped_mass, float), np.asarray(structure.nodes, float)
    r = x - mass @ x / mass.sum()
    products, basis = r @ r.T, _basis(r)
    # a map keeps products, so few nodes can be the images of the basis, and they say what the map is
    images: list[tuple[int, ...]] = [()]
    for k in range(3):
        wanted = products[basis[k], basis[: k + 1]]
        images = [
            (*image, new)
            for image in images
            for new in range(len(r))
            if np.all(np.abs(products[new, [*image, new]] - wanted) <= SAME * products.max())
        ]
    maps = [np.linalg.solve(r[basis], r[list(image)]).T for image in images]
    laws = Scene(structure).laws
    moved = [symmetry for matrix in maps if (symmetry := _as_symmetry(structure, r, matrix)) is not None]
    found = [symmetry for symmetry in moved if all(law.keeps(symmetry) for law in laws)]
    if not found:
        raise InputError("two nodes are in one place; expected nodes apart, which positions can tell from each other")
    # puts the identity first, since no other permutation sorts before it
    found.sort(key=lambda s: (-round(np.linalg.det(s.matrix)), s.nodes))
    return tuple(s for s in found if mirrors or np.linalg.det(s.matrix) > 0)


@typed
def standing_symmetries(scene: Scene) -> tuple[Symmetry, ...]:
    """Those `symmetries` of the structure that every law of the scene keeps: gravity, ground, friction and all others.

    They map the start on itself, and a motion of the scene on another of its motions. Where supports move, only the
    identity is counted. Raises as `symmetries` does.
    """
    kept = kept_by(scene, scene.laws)
    found = tuple(s for s in symmetries(scene.structure) if kept(s))
    return found if scene.shaking is None else found[:1]


def kept_by(scene: Scene, laws: Sequence[Law]) -> Callable[[Symmetry], bool]:
    """Whether a symmetry leaves these laws of the scene as they are, and balls turning with the same bodies."""
    rules = [keeps(law, scene) for law in laws]
    balls = None if scene.ground is None else scene.ground.balls
    if balls is not None:
        rules.append(lambda s: balls.turn_alike(scene.structure.bodies, s.nodes))
    return lambda symmetry: all(rule(symmetry) for rule in rules)


@typed
def image(gait: Gait, symmetry: Symmetry) -> Gait:
    """The gait, or population of gaits, by which members[k] is actuated as k was; its `members` stay in their order.

    Under `standing_symmetries` its motion from the start is the image of the gait's. Raises `InputError` where it
    would actuate other members.
    """
    found = gene_permutations(gait.members, (symmetry,))
    if not found:
        moved = sorted(symmetry.members[k] for k in gait.members)
        raise InputError(f"the image of the gait actuates members {moved}; expected {sorted(gait.members)}, its own")
    # start and ramp, which all actuators share, are the arrays without an axis
    return jax.tree.map(lambda x: x[..., np.array(found[0])] if np.ndim(x) else x, gait)


def gene_permutations(members: tuple[int, ...], symmetries: tuple[Symmetry, ...]) -> tuple[tuple[int, ...], ...]:
    """The distinct p for which values[..., p] are what an image of a gait of these `members` has of its values.

    Symmetries under which other members would be actuated are left out.
    """
    moved = [[symmetry.members[k] for k in members] for symmetry in symmetries]
    return tuple(dict.fromkeys(tuple(m.index(k) for k in members) for m in moved if set(m) == set(members)))


def _basis(r: np.ndarray) -> list[int]:
    """Three nodes whose positions `r`, from the centre of mass, span space: each sticks out most from those before."""
    basis, left = [], r
    for _ in range(3):
        away = np.linalg.norm(left, axis=1)
        # the most distant node of those left: the map that three images determine then has the least rounding
        basis.append(int(np.argmax(away)))
        if away.max() <= SAME * np.linalg.norm(r, axis=1).max():
            raise InputError("all nodes lie in a plane with the centre of mass; expected a structure in space")
        axis = left[basis[-1]] / away.max()
        left = left - np.outer(left @ axis, axis)
    return basis


def _as_symmetry(structure: Structure, r: np.ndarray, matrix: np.ndarray) -> Symmetry | None:
    """What `matrix` does to nodes and members; None where it does not map masses on masses and members on members."""
    gaps = np.linalg.norm((r @ matrix.T)[:, None] - r, axis=2)
    nodes = tuple(np.argmin(gaps, axis=1).tolist())
    apart = gaps.min(axis=1).max() > SAME * np.linalg.norm(r, axis=1).max()
    if apart or len(set(nodes)) < len(nodes) or not unchanged(structure.node_mass, nodes):
        return None
    if structure.fixed and not _same_supports(structure, nodes, matrix):
        return None
    members: list[int] = []
    for kind in structure.members:
        number = {frozenset(edge): k for k, edge in enumerate(kind.edges)}
        moved = [number.get(frozenset((nodes[i], nodes[j])), -1) for i, j in kind.edges]
        if -1 in moved:
            return None
        if kind.mass is not None and not unchanged(kind.mass, moved):
            return None
        members += [len(members) + k for k in moved]
    return Symmetry(nodes, matrix, tuple(members))


def _same_supports(structure: Structure, nodes: tuple[int, ...], matrix: np.ndarray) -> bool:
    """Whether the directions in which each node is fixed are mapped on those of the node whose place it takes."""
    # projectors, since a symmetry may exchange the axes of a support that is held along both
    held = np.eye(3) * ~structure.free[:, :, None]
    return bool(np.allclose(matrix @ held @ matrix.T, held[list(nodes)], rtol=0, atol=SAME))
