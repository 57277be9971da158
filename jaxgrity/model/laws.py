"""What a scene is made of: the interfaces of its laws. One law is one class, which says everything about itself.

A law is a term of U(q, t), a term of R(v; q, t), a force without either, or a constraint. `Scene.laws` lists those
that act; forces, the energy audit, `describe`, symmetries and the largest stable step read nothing but that list.
"""

from abc import abstractmethod
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax
import numpy as np
import scipy.sparse as sp

from jaxgrity.core.errors import InputError
from jaxgrity.core.primitives import dot, edge_vectors, length, over
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, MemberVectors, NodeVectors, PerMember, PerNode, Scalar, Vector, VectorsByKind
from jaxgrity.model.actuation import rest_length
from jaxgrity.model.clusters import added_up, cables_of, nodes_along
from jaxgrity.model.pulleys import path_lengths
from jaxgrity.model.structure import Members, Structure

SAME = 1e-9
"""Largest relative difference between lengths, masses and properties that count as equal."""


class Symmetry(NamedTuple):
    """An orthogonal map about the centre of mass, matrix @ r_i = r_nodes[i], and what it does to the members."""

    nodes: tuple[int, ...]
    """node i goes where node nodes[i] was"""
    matrix: np.ndarray
    """(3, 3); its determinant is -1 with a mirror"""
    members: tuple[int, ...]
    """member k becomes member members[k]: struts count from 0, cables go on after them"""

    @property
    def is_identity(self) -> bool:
        """Whether every node stays in its place, and nothing turns."""
        still = self.nodes == tuple(range(len(self.nodes)))
        return still and bool(np.allclose(self.matrix, np.eye(3), rtol=0, atol=SAME))

    def leaves(self, direction: tuple[float, float, float] | Vector) -> bool:
        """Whether it leaves a unit vector as it is, to `SAME`."""
        return bool(np.allclose(self.matrix @ np.asarray(direction), direction, rtol=0, atol=SAME))


@runtime_checkable
class SceneParts(Protocol):
    """The parts of a `Scene` from which laws are made."""

    structure: Structure
    gravity: Any
    node_damping: Any
    ground: Any
    friction: Any
    gait: Any
    up: Any
    shaking: Any
    scales: Any


class Configuration(NamedTuple):
    """Positions and time, of which U is a function. `EnergyTerm.energy` gets one."""

    q: NodeVectors
    """positions, m"""
    t: Scalar
    """time, s"""
    known: VectorsByKind
    """`vector` of the members with forces of the library, by kind"""
    scene: Any
    """the `Scene` that the law belongs to"""

    def vector(self, kind: str) -> MemberVectors:
        """d = x_i - x_j, m, of each of the "struts" or "cables"; `InputError` where there are none."""
        return self.known[kind] if kind in self.known else edge_vectors(self.q, _members(self.scene, kind).edges)

    def length(self, kind: str) -> PerMember:
        """l, m, of each of the "struts" or "cables", over pulleys too."""
        return path_lengths(_members(self.scene, kind), self.vector(kind), self.q)

    def stretch(self, kind: str) -> PerMember:
        """l - L(t), m, of each of the "struts" or "cables"; a cable is slack where it is negative.

        Segments of one cable are added up: see `clusters.py`.
        """
        members = _members(self.scene, kind)
        first = 0 if kind == "struts" else self.scene.structure.first_cable
        return added_up(self.length(kind) - rest_length(members, self.scene.gait, self.t, first), members.clusters)


class Motion(NamedTuple):
    """Velocities and configuration, of which R is a function. `dissipation` and `force` get one."""

    v: NodeVectors
    """velocities, m/s"""
    known: VectorsByKind
    """`rate` of those members that have dampers, by their kinds"""
    normal_force: PerNode | None
    """F_n, N, with which the ground presses on each node, held fixed in dR/dv; None where it presses by no force"""
    at: Configuration
    """where"""

    def rate(self, kind: str) -> MemberVectors:
        """d' = v_i - v_j, m/s, of each of the "struts" or "cables"; `InputError` where there are none."""
        return self.known[kind] if kind in self.known else edge_vectors(self.v, _members(self.at.scene, kind).edges)

    def rate_of_length(self, kind: str) -> PerMember:
        """l' = d·d'/|d|, m/s, of each of the "struts" or "cables"; over pulleys that of `Configuration.length`."""
        members, d = _members(self.at.scene, kind), self.at.vector(kind)
        if members.pulleys:
            return jax.jvp(partial(path_lengths, members), (d, self.at.q), (self.rate(kind), self.v))[1]
        return over(dot(d, self.rate(kind)), length(d))


class Law(eqx.Module):
    """What every law says about itself."""

    name: eqx.AbstractClassVar[str]
    """as `describe` lists it"""

    def keeps(self, symmetry: Symmetry) -> bool | None:
        """Whether the law is the same after the symmetry, which then maps motions onto motions.

        None: not known. jaxgrity then compares the law at random states and at their images. Return True or False for
        a law that acts in few states only, since random ones may miss it.
        """
        return None

    def check(self, nodes: int) -> None:
        """Raises `InputError` where the law does not fit a structure of so many nodes."""

    def during(self, begin: Scalar | AnyArray, end: Scalar) -> "Law":
        """The law that acts at each time from `begin` to `end`, s, as this one does in their mean.

        Complementarity stepping takes forces once in a step. A law that may act for less time than a step takes says
        here what its mean is.
        """
        return self

    def later(self, seconds: float) -> "Law":
        """The law that does at time t what this one does at t + `seconds`; itself, if it does not know the time.

        A motion that goes on from the state of an orbit begins at t = 0 again.
        """
        return self

    def bends(self) -> AnyArray:
        """(times,), s: when it begins, ends, or bends otherwise; steps that adapt end there."""
        return np.zeros(0)

    def longest_step(self) -> float:
        """s, the largest fixed step of Runge-Kutta methods that sees all of it; infinite where any does."""
        return np.inf

    def misplaced(self, h: float) -> float:
        """N s^2: impulse times the time by which complementarity stepping in steps of h (s) may be off with it.

        Smaller steps show what lasts for longer than that; for it this is 0.
        """
        return 0.0


class ForceTerm(Law):
    """A term of U or of R. `step_limit` names the part of it that limits the step."""

    def parts(self, scene: SceneParts) -> tuple[str, ...]:
        """Names of the parts that push and pull one by one, such as "strut 0 (nodes 0, 1)"; else those of the nodes."""
        return node_names(f"{self.name} at", scene)

    def scaled(self, factors: AnyArray) -> "ForceTerm | None":
        """The same term with the force of each of its parts multiplied by its factor.

        None where parts are the nodes, or there is one part: then the forces on the nodes are multiplied.
        """
        return None


class EnergyTerm(ForceTerm):
    """A term of the potential energy; its force is -dU/dq."""

    @abstractmethod
    def energy(self, at: Configuration) -> Scalar:
        """U, J."""


class DissipationTerm(ForceTerm):
    """A term of Rayleigh's dissipation function; its force is -dR/dv."""

    cause: eqx.AbstractClassVar[str]
    """under which the energy audit books what is lost"""

    @abstractmethod
    def dissipation(self, motion: Motion) -> Scalar:
        """R, W."""


class ForceLaw(Law):
    """A force that has neither a potential nor a dissipation function."""

    cause: eqx.AbstractClassVar[str]
    """under which the energy audit books what is lost"""

    @abstractmethod
    def force(self, motion: Motion, other_forces: NodeVectors) -> NodeVectors:
        """N, (nodes, 3), given the sum of all forces that come from U and R."""


class Constraint(Law):
    """A law that impulses satisfy at the end of each step, such as exact contact. You cannot add one of your own."""

    @abstractmethod
    def keeps(self, symmetry: Symmetry) -> bool:
        """Whether the constraint is the same after the map."""

    @abstractmethod
    def directions(self, q: np.ndarray, size: float) -> sp.csr_array:
        """(constraints, 3 nodes): the directions in which it holds nodes at `q` (nodes, 3), m, of a body of `size`
        (`length_scale`). Sparse: each constraint holds one node or two."""

    @abstractmethod
    def gaps(self, q: NodeVectors, t: Scalar) -> AnyArray:
        """(parts,), m: by how much a start at `q` violates each part of it at time t, also of traced numbers."""

    @property
    def left_by_steps(self) -> float:
        """Largest violation at the end of a step, m for a body of one metre. A start may violate it by as much."""
        return 0.0

    @abstractmethod
    def complaint(self, q: np.ndarray, t: float, part: int) -> str:
        """Words for how a start at `q` (nodes, 3) violates that part."""


def rows_on_nodes(blocks: np.ndarray, nodes: np.ndarray, size: int) -> sp.csr_array:
    """(rows, size), of rows that have `blocks` (rows, k, 3) at x, y and z of k `nodes` each (rows, k), else 0."""
    columns = (3 * nodes[..., None] + np.arange(3)).ravel()
    first = 3 * nodes.shape[1] * np.arange(len(nodes) + 1)
    return sp.csr_array((blocks.ravel(), columns, first), shape=(len(nodes), size))


def unchanged(values: AnyArray, moved: Sequence[int]) -> bool:
    """Whether a number per node or member is the same after a symmetry: values[moved[k]] = values[k], to `SAME`."""
    return bool(np.allclose(np.asarray(values)[list(moved)], values, rtol=SAME, atol=0))


def unchanged_per_node(coefficient: AnyArray, symmetry: Symmetry) -> bool:
    """The same for a coefficient that is one number for all nodes, or one for each."""
    return np.ndim(coefficient) == 0 or unchanged(coefficient, symmetry.nodes)


def moved_members(members: Members, first: int, symmetry: Symmetry) -> list[int]:
    """Which of the members takes the place of each, counted from the `first` of their kind."""
    return [symmetry.members[first + k] - first for k in range(len(members.edges))]


def same_roles(members: Members, moved: Sequence[int]) -> bool:
    """Whether stuck members take the places of stuck ones, and cables those of cables; no motor is like another."""
    clusters = {frozenset(moved[k] for k in cluster) for cluster in members.clusters}
    still = all(moved[motor.member] == motor.member for motor in members.motors)
    same = clusters == set(map(frozenset, members.clusters))
    return {moved[k] for k in members.stuck} == set(members.stuck) and same and still


@typed
def member_names(kind: str, members: Members) -> tuple[str, ...]:
    """Names of members: "strut 0 (nodes 0, 1)"; of a cable through several nodes "cable 3, 4 (nodes 5, 2, 7)"."""
    names = []
    for segments in cables_of(members.clusters, len(members.edges)):
        numbers = ", ".join(map(str, segments))
        nodes = ", ".join(map(str, nodes_along(tuple(members.edges[k] for k in segments))))
        names.append(f"{kind} {numbers} (nodes {nodes})")
    return tuple(names)


def named_parts(term: ForceTerm, scene: SceneParts) -> tuple[str, ...]:
    """Its `parts`. Raises `InputError` where nothing says what each of them does: see `ForceTerm.scaled`."""
    names = term.parts(scene)
    if len(names) not in (1, len(scene.structure.nodes)) and term.scaled(np.ones(len(names))) is None:
        raise InputError(f"{term.name} has {len(names)} parts and no `scaled`; expected one, or one for each node")
    return names


def node_names(what: str, scene: SceneParts) -> tuple[str, ...]:
    """A name for each node of the scene: "contact of node 0" and so on, if `what` is "contact of"."""
    return tuple(f"{what} node {k}" for k in range(len(scene.structure.nodes)))


def _members(scene: SceneParts, kind: str) -> Members:
    every = {name: members for name, members, _ in scene.structure.numbered}
    if kind not in every:
        expected = " or ".join(map(repr, every)) or "a scene with members"
        raise InputError(f"a law acts along {kind!r}, which the scene does not have; expected {expected}")
    return every[kind]
