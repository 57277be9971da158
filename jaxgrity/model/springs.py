"""Members' forces from U, and rigid struts as very stiff springs, for equilibrium shapes and modes."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.primitives import dot, inverse, length
from jaxgrity.core.types import NodeVectors, PerMember, Scalar, VectorsByKind
from jaxgrity.model.actuation import rest_length
from jaxgrity.model.body_points import body_pairs
from jaxgrity.model.clusters import pull
from jaxgrity.model.pulleys import built_lengths
from jaxgrity.model.scene import Scene
from jaxgrity.model.structure import Members, Structure, member_vectors

STIFF = 1e5
"""Stiffness of the springs that replace rigid struts, as a multiple of the stiffness beside them."""


def as_springs(structure: Structure, stiff: float | None = None) -> tuple[Structure, int]:
    """The structure with rigid struts as very stiff springs, and how many there are: so many modes are not real.

    Such springs, the last ones, join the basic points of rigid bodies too, which hold their shape. `stiff` is their
    stiffness, N/m: by default that for a structure on which nothing else acts.
    """
    struts = structure.struts
    if stiff is None:
        stiff = STIFF * (stiffness_beside(structure) or 1.0)
    count = 0
    if struts is not None and struts.rigid:
        count = len(struts.edges)
        struts = dataclasses.replace(struts, stiffness=np.full(count, stiff), damping=None)
    if structure.bodies:
        pairs, lengths = body_pairs(structure.bodies)
        K, L = np.full(len(pairs), stiff), np.asarray(lengths, float)
        count, more = count + len(lengths), Members(pairs, K, L)
        struts = more if struts is None else _with_more(struts, more)
    return dataclasses.replace(structure, struts=struts) if count else structure, count


def _with_more(struts: Members, more: Members) -> Members:
    """The struts, and springs without mass after them; their numbers and motors stay."""
    joined = {name: np.r_[getattr(struts, name), getattr(more, name)] for name in ("stiffness", "rest_length")}
    mass = None if struts.mass is None else np.r_[struts.mass, np.zeros(len(more.edges))]
    unused: dict[str, Any] = dict.fromkeys(("damping", "yield_force", "bending_stiffness"))
    return dataclasses.replace(struts, edges=(*struts.edges, *more.edges), **joined, mass=mass, **unused)


def elastic_tensions(scene: Scene, t: Scalar, q: NodeVectors) -> dict[str, PerMember]:
    """The tension of each member, N, by kind, from all of U at time t, s: gait, motors, tables, limits, own terms."""
    vectors = member_vectors(q, scene.structure.kinds)
    pulls = jax.grad(scene.potential_energy, argnums=2)(q, t, vectors)
    return along_members(scene.structure, pulls, vectors)


def along_members(structure: Structure, pulls: VectorsByKind, vectors: VectorsByKind) -> dict[str, PerMember]:
    """The tension of each member, N, that pulls its ends, N. A cable beside a pulley leans against its d."""
    found = {kind: dot(pulls[kind], d) * inverse(length(d)) for kind, d in vectors.items()}
    if structure.cables is not None and structure.cables.pulleys:
        found["cables"] = jnp.sign(found["cables"]) * length(pulls["cables"])
    return found


def spring_forces(members: Members, q: NodeVectors) -> np.ndarray:
    """K (l - L(0)) of linear springs at `q`, N, tension positive: of cables too, which cannot push; in float64.

    L(0) has what motors wound before t = 0. `elastic_tensions` knows all of U, and costs a compiled program.
    """
    with jax.enable_x64(True):
        longer = built_lengths(members, q) - np.asarray(rest_length(members, None, 0.0, 0), float)
        return np.asarray(pull(np.asarray(members.stiffness, float), longer, members.clusters))


def stiffness_beside(structure: Structure) -> float:
    """N/m, beside rigid struts and bodies: of the stiffest cable, without cables of the stiffest strut; 0 of none."""
    kinds = (structure.cables, structure.struts)
    found = (float(np.max(m.stiffness)) for m in kinds if m is not None and m.stiffness is not None)
    return next((each for each in found if each > 0), 0.0)


def largest_force(structure: Structure) -> float:
    """N: the largest force, K L, of any member that is a spring."""
    forces = (np.asarray(m.stiffness) * np.asarray(m.rest_length) for m in _springs(structure))
    return max((float(np.max(force)) for force in forces), default=0.0)


def largest_stiffness(structure: Structure) -> Scalar:
    """N/m: that of the stiffest member that is a spring; 1 where none is."""
    found = [jnp.max(jnp.asarray(m.stiffness)) for m in _springs(structure)]
    return jnp.max(jnp.stack(found)) if found else jnp.ones(())


def smallest_stiffness(structure: Structure) -> float:
    """N/m: that of the softest member that is a spring; 0 where none is."""
    found = np.concatenate([np.asarray(m.stiffness, float) for m in _springs(structure)] or [np.zeros(0)])
    return float(found[found > 0].min()) if np.any(found > 0) else 0.0


def _springs(structure: Structure) -> list[Members]:
    return [m for m in structure.members if m.stiffness is not None]
