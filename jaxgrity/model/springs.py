"""Members as springs, rigid struts as very stiff ones, for equilibrium shapes, modes and members' forces."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.types import NodeVectors, Scalar
from jaxgrity.model.clusters import pull
from jaxgrity.model.structure import Members, Structure, edge_lengths

STIFF = 1e5
"""Stiffness of the springs that replace rigid struts, as a multiple of the cables' stiffness."""


def as_springs(structure: Structure) -> tuple[Structure, int]:
    """The structure with rigid struts as very stiff springs, and how many there are: so many modes are not real.

    Raises `InputError` where there are rigid bodies.
    """
    if structure.bodies:
        raise InputError("statics knows no rigid bodies yet; expected a structure without, or rods as struts")
    struts, cables = structure.struts, structure.cables
    if struts is None or not struts.rigid:
        return structure, 0
    stiff = STIFF * float(np.max(cables.stiffness)) if cables is not None and cables.stiffness is not None else 1e8
    springs = dataclasses.replace(struts, stiffness=np.full(len(struts.edges), stiff), damping=None)
    return dataclasses.replace(structure, struts=springs), len(struts.edges)


def spring_forces(members: Members, q: NodeVectors) -> np.ndarray:
    """K (l - L) of each member at `q`, N, tension positive: of cables too, which cannot push; in float64."""
    longer = edge_lengths(q, members.edges) - np.asarray(members.rest_length, float)
    with jax.enable_x64(True):
        return np.asarray(pull(np.asarray(members.stiffness, float), longer, members.clusters))


def largest_force(structure: Structure) -> float:
    """N: the largest force, K L, of any member that is a spring."""
    forces = (np.asarray(m.stiffness) * np.asarray(m.rest_length) for m in _springs(structure))
    return max((float(np.max(force)) for force in forces), default=0.0)


def largest_stiffness(structure: Structure) -> Scalar:
    """N/m: that of the stiffest member that is a spring; 1 where none is."""
    found = [jnp.max(jnp.asarray(m.stiffness)) for m in _springs(structure)]
    return jnp.max(jnp.stack(found)) if found else jnp.ones(())


def _springs(structure: Structure) -> list[Members]:
    return [m for m in (structure.struts, structure.cables) if m is not None and m.stiffness is not None]
