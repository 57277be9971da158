"""Inertia: the kinetic energy of nodes and of members with mass, the mass matrix, and how forces accelerate nodes.

A member of mass m moves as its ends say, v = (1 - s) v_p + s v_q at the fraction s of its length. That is exact for a
thin rigid rod, and the linear shape function of a bar element for one that stretches, whose mass stays even along it.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxgrity.core.dense import inverse_of
from jaxgrity.core.primitives import along, component, dot, inner, place_rows, respond, scale, take_rows
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, MassMatrix, Mobility, NodeVectors, Scalar
from jaxgrity.model.body_points import carrying, energy_of_bodies, following, independent_nodes, onto_basic
from jaxgrity.model.structure import Structure


@typed
def energy_of_motion(structure: Structure, v: NodeVectors) -> Scalar:
    """T = sum m_i/2 |v_i|^2 + sum m/6 (v_p·v_p + v_p·v_q + v_q·v_q), J, over the nodes and the members with mass.

    Bodies add what `energy_of_bodies` says.
    """
    T = inner(structure.node_mass, dot(v, v)) / 2
    for mass, edges in structure.rod_masses:
        first, second = (take_rows(v, ends) for ends in zip(*edges))
        T = T + inner(mass, dot(first, first) + dot(first, second) + dot(second, second)) / 6
    return T + energy_of_bodies(structure.bodies, v) if structure.bodies else T


@typed
def with_mass_at_ends(structure: Structure) -> Structure:
    """The structure with the mass of each member at its ends, half at each, so that all mass is at nodes.

    Masses and centres of mass stay. A rod of mass m and length L then has the moment of inertia m L^2/4 about its
    centre, in place of m L^2/12. On exact contact, sweeps then solve rods that share no node, several times faster.
    Rigid bodies stay as they are.

    Example:
        >>> rod = jaxgrity.Members(((0, 1),), None, [1.0], mass=[6.0])
        >>> structure = jaxgrity.Structure([[0, 0, 0], [1, 0, 0]], [0.0, 0.0], rod)
        >>> jaxgrity.model.with_mass_at_ends(structure).node_mass.tolist()
        [3.0, 3.0]
    """
    if not structure.rod_masses:
        return structure
    struts, cables = (
        None if each is None else dataclasses.replace(each, mass=None) for each in (structure.struts, structure.cables)
    )
    return dataclasses.replace(structure, node_mass=structure.mass_beside_bodies, struts=struts, cables=cables)


def rod_inertia(
    mass: Float[np.ndarray, " rods"],
    ends: Float[np.ndarray, "rods 2"],
    lengths: Float[np.ndarray, " rods"],
    mass_at_ends: bool = False,
) -> Float[np.ndarray, " rods"]:
    """(rods,), kg m^2, moment of inertia of rods and their end nodes, across the rod, about their centre of mass.

    Of a rod of mass m (kg) and length L (m) between nodes of masses a and b, `ends` (kg), with M = a + b + m: with the
    rod's own mass at its ends (`with_mass_at_ends`) it is (a + m/2) (b + m/2) / M L^2. Spread along the rod, it is
    m L^2/6 less.
    """
    first, second = (ends + mass[:, None] / 2).T
    whole = first * second / (first + second) * lengths**2
    return whole if mass_at_ends else whole - mass * lengths**2 / 6


@typed
def momenta(structure: Structure, v: NodeVectors) -> NodeVectors:
    """M v = dT/dv, (nodes, 3), kg m/s: each node's share of the momentum."""
    if structure.of_points:
        return scale(v, structure.node_mass)
    return jax.grad(energy_of_motion, argnums=1)(structure, v)


@typed
@jax.jit
def mass_matrix(structure: Structure) -> MassMatrix:
    """M = d2T/dv2, (3 nodes, 3 nodes), kg, in the order x, y, z of node 0, then of node 1; supports are not in it.

    Args:
        structure: nodes and members with their masses.

    Example:
        >>> rod = jaxgrity.Members(((0, 1),), None, [1.0], mass=[6.0])
        >>> jaxgrity.model.mass_matrix(jaxgrity.Structure([[0, 0, 0], [1, 0, 0]], [0.0, 0.0], rod))[::3, ::3].tolist()
        [[2.0, 1.0], [1.0, 2.0]]
    """
    mass = _mass_along_an_axis(structure)
    return jnp.kron(mass, jnp.eye(3, dtype=mass.dtype))


def _mass_along_an_axis(structure: Structure) -> AnyArray:
    """(nodes, nodes), kg: T is as much for the same velocities along x, y or z, and velocities along two of them add
    none."""
    x = jnp.asarray(structure.nodes)[:, 0]
    return jax.hessian(lambda v: energy_of_motion(structure, along(v, (1.0, 0.0, 0.0))))(jnp.zeros_like(x))


@typed
@jax.jit
def mobility(structure: Structure) -> Mobility:
    """a_ijk, 1/kg: how a force on node j along axis k accelerates node i; 0 wherever one of both is fixed along it.

    It is the inverse of the part of the mass matrix that belongs to the free coordinates. Points that follow others of
    their bodies move as these do, and pass on to them what acts on them.
    """
    own = independent_mobility(structure)
    if not structure.bodies:
        return own
    carry = carrying(structure.bodies, len(structure.nodes))
    return jnp.moveaxis(carry @ jnp.moveaxis(own, -1, 0) @ carry.T, 0, -1)


@jax.jit
def independent_mobility(structure: Structure) -> Mobility:
    """`mobility` of the independent nodes alone: the others follow them."""
    size, free = len(structure.nodes), structure.free
    if structure.of_points:
        own = jnp.where(free, structure.node_mass[:, None], 1)
        return jnp.eye(size, dtype=own.dtype)[:, :, None] * jnp.where(free, 1 / own, 0)
    mass = _mass_along_an_axis(structure)
    if structure.bodies:
        carry, free = carrying(structure.bodies, size), free[np.array(independent_nodes(structure.bodies, size))]
        mass = carry.T @ mass @ carry
    return jnp.moveaxis(_inverse_of_free(jnp.broadcast_to(mass, (3, *mass.shape)), free.T.astype(mass.dtype)), 0, -1)


def independent_coordinates(structure: Structure) -> tuple[np.ndarray, np.ndarray]:
    """The numbers of the coordinates that neither supports hold nor bodies carry, and how all coordinates follow them,
    (3 nodes, coordinates)."""
    size = len(structure.nodes)
    nodes = np.array(independent_nodes(structure.bodies, size))
    free = structure.free[nodes].ravel()
    place = np.kron(np.asarray(carrying(structure.bodies, size)), np.eye(3))[:, free]
    return (3 * nodes[:, None] + np.arange(3)).ravel()[free], place


def _inverse_of_free(mass: AnyArray, free: AnyArray) -> AnyArray:
    """For each of x, y and z the inverse of the part of a mass matrix that belongs to free coordinates, else 0."""
    both = free[:, :, None] * free[:, None]
    of_axes = mass * both + jnp.eye(free.shape[1], dtype=mass.dtype) * (1 - free)[:, None]
    weight = 1 / jnp.sqrt(jnp.diagonal(of_axes, axis1=1, axis2=2))
    weights = weight[:, :, None] * weight[:, None]
    return jax.vmap(inverse_of)(of_axes * weights) * weights * both


def with_mobility(structure: Structure) -> Structure:
    """The structure with its `mobility`, where that is more than 1/m_i, so that steps need not compute it."""
    own = independent_mobility(structure) if structure.needs_mobility else None
    return structure if own is None else dataclasses.replace(structure, mobility=own)


def accelerations(structure: Structure, force: NodeVectors) -> NodeVectors:
    """M^-1 F, (nodes, 3), m/s^2, of the free coordinates; 0 along those that are fixed."""
    if not structure.needs_mobility:
        return scale(force, 1 / structure.node_mass)
    own = independent_mobility(structure) if structure.mobility is None else structure.mobility
    if not structure.bodies:
        return respond(own, force)
    size, bodies = len(structure.nodes), structure.bodies
    nodes = independent_nodes(bodies, size)
    return following(bodies, place_rows(respond(own, take_rows(onto_basic(bodies, force), nodes)), nodes, size))


def borne_by_supports(structure: Structure, missing: NodeVectors) -> NodeVectors:
    """Forces of supports, (nodes, 3), N, from M a - F at all nodes: a support also bears what follows it."""
    return along_fixed(structure, onto_basic(structure.bodies, missing))


def along_fixed(structure: Structure, x: NodeVectors) -> NodeVectors:
    """The part of vectors at nodes that lies along fixed coordinates."""
    fixed = [(node, "xyz".index(axis)) for node, axes in structure.fixed for axis in axes]
    total: NodeVectors = jnp.zeros_like(x)
    for axis in range(3):
        rows = tuple(node for node, k in fixed if k == axis)
        if rows:
            unit = (float(axis == 0), float(axis == 1), float(axis == 2))
            total = total + place_rows(along(component(take_rows(x, rows), unit), unit), rows, x.shape[0])
    return total
