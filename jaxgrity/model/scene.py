"""A scene: a structure, everything that acts on it, and the resulting functions U and R."""

import dataclasses
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.arguments import check_all_finite, check_each, check_unit_vector
from jaxgrity.core.display import of_report
from jaxgrity.core.errors import InputError
from jaxgrity.core.functions import hold_functions
from jaxgrity.core.typed import check_fields, typed
from jaxgrity.core.types import (
    AnyArray,
    NodeVectors,
    PerNode,
    Scalar,
    State,
    Vector,
    VectorsByKind,
    as_float_or_none,
    namespace_of,
)
from jaxgrity.model.actuation import Gait, check_fit, check_robot
from jaxgrity.model.dissipation import LOSSES
from jaxgrity.model.energy import CableSprings, Gravity, StrutSprings
from jaxgrity.model.friction import ConeFriction, CoulombCone, Friction, SmoothFriction, SwitchFriction
from jaxgrity.model.ground import ContactDissipation, ExactContact, Ground, PenaltyContact
from jaxgrity.model.law_checks import check_own_laws
from jaxgrity.model.laws import Configuration, Constraint, DissipationTerm, EnergyTerm, ForceLaw, Law, Motion
from jaxgrity.model.load_cases import LoadCase, check_load_cases
from jaxgrity.model.rigidity import LINKS, RIGID
from jaxgrity.model.scales import Scales, scales_of
from jaxgrity.model.shaking import SupportMotion
from jaxgrity.model.slides import Slides, check_slides
from jaxgrity.model.structure import Structure, member_vectors
from jaxgrity.model.strut_pairs import ExactStrutContact

LAWS_OF_STRUCTURES = (StrutSprings, *RIGID, CableSprings, *LOSSES, Gravity)
"""Laws that follow from a scene's structure. Ground and friction add their own laws."""
KNOWN_LAWS = (*LAWS_OF_STRUCTURES, PenaltyContact, ExactContact, ContactDissipation)
KNOWN_FRICTIONS = (SmoothFriction, SwitchFriction, ConeFriction)
"""Kinds of friction that `describe` lists as modelled or not, in addition to `KNOWN_LAWS`."""
CONSTRAINTS_MET = (*LINKS, ExactContact, CoulombCone, ExactStrutContact)
"""Constraints that complementarity stepping satisfies."""
BOOKED_OTHERWISE = ("actuation", "supports", "impulse", "moment")
"""Entries of the energy audit that are no causes of dissipation."""


class Scene(eqx.Module):
    """A robot and everything that acts on it. A part that is None is not modelled, and costs nothing.

    Raises `InputError` if the parts do not fit each other.
    """

    structure: Structure
    gravity: Scalar | None = eqx.field(converter=as_float_or_none, default=None)
    """g, m/s^2, against `up`, not negative; None: no gravity"""
    node_damping: PerNode | None = eqx.field(converter=as_float_or_none, default=None)
    """damping c of each node, N s/m"""
    ground: Ground | None = None
    friction: Friction | None = None
    gait: Gait | None = None
    up: Vector | None = eqx.field(converter=as_float_or_none, default=None)
    """(3,), unit vector against gravity; differs from z if the ground leans more than its incline; None: z"""
    shaking: SupportMotion | None = None
    """motion of the supports; None: they stay"""
    terms: tuple[Law, ...] = ()
    """your own laws: further terms of U and R (docs/extending.md)"""
    scales: Scales | None = None
    """scales that a rollout computes once for all steps; None: they are computed when needed"""
    loads: tuple[LoadCase, ...] = ()
    """load cases for statics; motions ignore them"""

    def __check_init__(self):
        check_fields(self)
        check_all_finite(self)
        nodes = len(self.structure.nodes)
        check_each("gravity", self.gravity, shape=(), least=0.0, unit="m/s^2")
        check_each("node_damping", self.node_damping, shape=(nodes,), least=0.0, unit="N s/m")
        check_unit_vector("up", self.up)
        for term in self.terms:
            _check_term(term)
            term.check(nodes)
        if self.friction is not None:
            if self.ground is None:
                raise InputError("friction needs a ground to act on; expected [ground] beside [friction]")
            for name, given in vars(self.friction).items():
                check_each(f"friction.{name}", given, shape=(nodes,) * np.ndim(given))
            if self.friction.impulsive != self.ground.impulsive:
                goes = "expected a cone with exact contact, smooth friction or the switch with penalty contact"
                raise InputError(f"friction.kind does not fit ground.contact: {goes}")
        check_load_cases(self.loads, nodes)
        check_slides(self)
        for law in self.constraints:
            if type(law) not in CONSTRAINTS_MET:
                known = ", ".join(kind.name for kind in CONSTRAINTS_MET)
                raise InputError(f"{law.name}: no method solves this constraint; expected one of {known}, or a force")
        if self.ground is not None and self.ground.balls is not None:
            self.ground.balls.check(nodes)
        if self.shaking is not None:
            self.shaking.check(self.structure)
        if self.gait is not None:
            check_fit(self.gait, self.structure)

    @property
    def laws(self) -> tuple[Law, ...]:
        """All laws of the scene, in the order of the sums U and R."""
        return self._laws_of(Law)

    @property
    def energy_terms(self) -> tuple[EnergyTerm, ...]:
        """The terms of U."""
        return self._laws_of(EnergyTerm)

    @property
    def dissipation_terms(self) -> tuple[DissipationTerm, ...]:
        """The terms of R."""
        return self._laws_of(DissipationTerm)

    @property
    def force_laws(self) -> tuple[ForceLaw, ...]:
        """The laws that give forces directly, without U or R."""
        return self._laws_of(ForceLaw)

    @property
    def constraints(self) -> tuple[Constraint, ...]:
        """The constraints, which complementarity stepping satisfies."""
        return self._laws_of(Constraint)

    def _laws_of(self, wanted: type) -> tuple[Any, ...]:
        """Those of a kind. No other is made: weights of bodies need one robot's arrays, and scenes may be of many."""
        found: list[Any] = [kind.of(self) for kind in LAWS_OF_STRUCTURES if issubclass(kind, wanted)]
        if self.ground is not None:
            found += [*self.ground.laws(), *([] if self.friction is None else [self.friction.law(self.ground)])]
        return tuple(law for law in (*found, *self.terms) if isinstance(law, wanted))

    @property
    def dissipates(self) -> bool:
        """Whether any force depends on velocity; impulses of exact contact are not forces."""
        return bool(self.dissipation_terms or self.force_laws)

    @property
    def constrained(self) -> bool:
        """Whether the scene has any `Constraint`: rigid struts or bodies, or exact contact."""
        return bool(self.constraints)

    def potential_energy(self, q: NodeVectors, t: Scalar, vectors: VectorsByKind | None = None) -> Scalar:
        """U(q, t) = U_struts + U_cables + U_gravity + U_contact + ..., J: the sum of the scene's terms.

        If `vectors` (the members' d at q) are given, U is a function of them too. Then dU/dq lacks the forces along the
        members, which are dU/d(vectors).
        """
        at = self.configuration(q, t, vectors)
        return sum((term.energy(at) for term in self.energy_terms), jnp.zeros((), q.dtype))

    def dissipation(
        self,
        v: NodeVectors,
        q: NodeVectors,
        t: Scalar,
        normal_force: PerNode | None,
        vectors: tuple[VectorsByKind, VectorsByKind] | None = None,
    ) -> Scalar:
        """R(v; q, t) = R_nodes + R_struts + R_cables + R_contact + R_friction + ..., W: the sum of the scene's terms.

        `normal_force` (N, per node) is a separate argument because friction's R holds it fixed. It depends on v too,
        and only the derivative at fixed F_n is the friction force. If `vectors` (d and d' of the members) are given,
        R is a function of d' too, as U is of d.
        """
        terms = self.dissipation_by_cause(v, q, t, normal_force, vectors)
        return sum(terms.values(), jnp.zeros((), v.dtype))

    def dissipation_by_cause(
        self,
        v: NodeVectors,
        q: NodeVectors,
        t: Scalar,
        normal_force: PerNode | None,
        vectors: tuple[VectorsByKind, VectorsByKind] | None = None,
    ) -> dict[str, Scalar]:
        """The terms of R, W, summed by cause."""
        found, motion = dict[str, Scalar](), self.motion(v, q, t, normal_force, vectors)
        for term in self.dissipation_terms:
            R = term.dissipation(motion)
            found[term.cause] = found[term.cause] + R if term.cause in found else R
        return found

    def configuration(self, q: NodeVectors, t: Scalar, vectors: VectorsByKind | None = None) -> Configuration:
        """The argument of the terms of U."""
        return Configuration(q, t, member_vectors(q, self.structure.kinds) if vectors is None else vectors, self)

    def motion(
        self,
        v: NodeVectors,
        q: NodeVectors,
        t: Scalar,
        normal_force: PerNode | None,
        vectors: tuple[VectorsByKind, VectorsByKind] | None = None,
    ) -> Motion:
        """The argument of the terms of R."""
        d, rates = vectors or (member_vectors(q, self.structure.kinds), member_vectors(v, self.structure.damped))
        return Motion(v, rates, normal_force, Configuration(q, t, d, self))

    def during(self, begin: Scalar | AnyArray, end: Scalar) -> "Scene":
        """The scene whose terms act with their mean from `begin` (a number, or one for each robot) to `end`, s."""
        if all(type(term).during is Law.during for term in self.terms):
            return self
        return eqx.tree_at(lambda scene: scene.terms, self, tuple(term.during(begin, end) for term in self.terms))

    def normal_force(self, q: NodeVectors, v: NodeVectors) -> PerNode | None:
        """F_n of penalty contact, N, if friction or one of your own terms may need it."""
        if self.ground is None or not (self.friction is not None or self.terms):
            return None
        return self.ground.normal_force(q, v)

    def _repr_html_(self) -> str:
        return of_report("notebook", "scene_html")(self)


@typed
def with_gait(scene: Scene, gait: Gait | None) -> Scene:
    """The scene with another gait, or with none.

    Raises `InputError` if the gait does not fit the structure, or was made for another robot. Gaits of the library and
    of searches know their robot.
    """
    if gait is not None and gait.robot is not None:
        check_robot(gait, scene.structure)
        gait = dataclasses.replace(gait, robot=None)  # so that all gaits of a robot share one program
    return dataclasses.replace(scene, gait=gait)


@typed
def with_terms(scene: Scene, *terms: Law) -> Scene:
    """The scene with your own laws added.

    Raises `InputError` if a law cannot act in the scene: it names a missing node, or does not return a single number.
    """
    more = dataclasses.replace(scene, terms=(*scene.terms, *terms))
    check_laws(more)
    return more


def check_laws(scene: Scene) -> None:
    """Raises `InputError` if a law beyond the library's usual ones cannot act in the scene."""
    check_own_laws([law for law in scene.laws if type(law) not in KNOWN_LAWS], scene)


Module = TypeVar("Module", bound=eqx.Module)


@typed
def as_dtype(scene: Module, dtype: str) -> Module:
    """The scene, or a policy, with every number as a JAX array of `dtype`."""
    return jax.tree.map(lambda x: jnp.asarray(x, dtype), hold_functions(scene))


def floats_as(tree: Any, dtype: str) -> Any:
    """The tree with its floating-point numbers as JAX arrays of `dtype`; integers, masks and random keys stay."""

    def cast(x):
        return jnp.asarray(x, dtype) if jnp.issubdtype(jnp.result_type(x), jnp.floating) else jnp.asarray(x)

    return jax.tree.map(cast, hold_functions(tree))


def with_scales(scene: Scene) -> Scene:
    """The scene with its `scales`, as the functions of `scales.py` then read them."""
    return scene if scene.scales is not None else dataclasses.replace(scene, scales=scales_of(scene))


def start_of(scene: Scene) -> State:
    """The structure's nodes at rest. Velocities are NumPy zeros, which stay known when JAX traces the rest."""
    return (q := scene.structure.nodes), np.zeros(q.shape, q.dtype)


@typed
def body_length(scene: Scene) -> Scalar:
    """Length of the longest strut in the given shape, m; without struts, of the longest cable.

    Raises `InputError` if there are no members.
    """
    members = scene.structure.struts or scene.structure.cables
    if members is None:
        raise InputError("the structure has no members; expected some, whose length is the body length")
    i, j = np.array(members.edges).T
    nodes = scene.structure.nodes
    return namespace_of(nodes).sqrt(((nodes[i] - nodes[j]) ** 2).sum(1).max())


def _check_term(term: Law) -> None:
    """Refuse laws that the motion or the energy audit would silently ignore."""
    if not isinstance(term, (EnergyTerm, DissipationTerm, ForceLaw, ExactStrutContact, Slides)):
        raise InputError(f"terms has {term!r}; expected an EnergyTerm, a DissipationTerm or a ForceLaw")
    if (cause := getattr(term, "cause", "")) in BOOKED_OTHERWISE:
        raise InputError(f"terms: {term.name!r} has cause {cause!r}, which the energy audit reserves; expected another")
