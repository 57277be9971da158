"""Prestress for a given shape: the rest lengths at which all forces balance."""

import dataclasses

import numpy as np

from jaxgrity.core.arguments import check_number
from jaxgrity.core.display import in_digits
from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import PerMember
from jaxgrity.model.structure import Members, Structure, edge_lengths
from jaxgrity.statics.form_finding import prestress, rest_lengths
from jaxgrity.statics.stiffness import all_edges, incidence

BALANCED = 1e-4
"""Largest force left at a node, as a share of the largest in a member, that a table's digits explain."""


@typed
def prestressed(structure: Structure, tension: float, force_density: PerMember | None = None) -> Structure:
    """The structure with the rest lengths at which its shape is in equilibrium without loads.

    L = l - f/K for springs, L = l for rigid struts, with the forces of `prestress`.

    Args:
        structure: its shape is kept, its rest lengths are replaced. Supports balance the forces on their nodes,
            and rigid bodies carry forces that balance on them.
        tension: of the tightest cable, N.
        force_density: the self-stress, N/m, struts first; it is scaled. None: the one with the most even cables.

    Returns:
        The structure with its new rest lengths.

    Raises:
        InputError: no self-stress has every cable in tension, forces that do not balance, a tension that is not
            positive, or a rest length that would not be.

    Example:
        >>> scene = jaxgrity.load_scene("reference")
        >>> structure = jaxgrity.statics.prestressed(scene.structure, tension=100.0)
        >>> [f"{length:.4f}" for length in structure.cables.rest_length[:2]]
        ['0.4457', '0.4457']
    """
    check_number("tension", tension, above=0.0, unit="N")
    if structure.cables is None or structure.cables.stiffness is None:
        raise InputError("prestress needs cables that are springs; expected a structure with cables")
    if structure.cables.clusters:
        clusters = [list(cluster) for cluster in structure.cables.clusters]
        raise InputError(f"clusters = {clusters}: prestress decides each segment's tension; expected rest lengths")
    struts, cables = (m.edges if m is not None else () for m in (structure.struts, structure.cables))
    nodes, edges = np.asarray(structure.nodes, float), all_edges(structure)
    if force_density is None:
        q = np.asarray(prestress(nodes, struts, cables, tension, structure.supported, structure.bodies))
    else:
        q = np.asarray(force_density, float)
        forces = q * edge_lengths(nodes, edges)
        _check_balance(structure, q, forces)
        q = q * (tension / forces[len(struts) :].max())
    return dataclasses.replace(
        structure,
        struts=_at_rest(structure.struts, nodes, q[: len(struts)]),
        cables=_at_rest(structure.cables, nodes, q[len(struts) :]),
    )


def _check_balance(structure: Structure, q: np.ndarray, forces: np.ndarray) -> None:
    C, nodes = incidence(all_edges(structure), len(structure.nodes)), np.asarray(structure.nodes, float)
    left = (C.T @ (q[:, None] * (C @ nodes)))[np.asarray(structure.free)]
    slack = np.flatnonzero(forces[structure.first_cable :] <= 0)
    if slack.size:
        raise InputError(f"force_density: cable {slack[0]} would push; expected positive numbers for cables")
    if not np.abs(left).max(initial=0) <= BALANCED * np.abs(forces).max():
        raise InputError(
            f"force_density: {in_digits(np.abs(left).max())} N are left at a node; expected forces that balance"
        )


def _at_rest(members: Members | None, nodes: np.ndarray, force_density: np.ndarray) -> Members | None:
    if members is None:
        return None
    if members.stiffness is None:
        return dataclasses.replace(members, rest_length=edge_lengths(nodes, members.edges))
    rest = rest_lengths(nodes, members.edges, np.asarray(members.stiffness, float), force_density)
    return dataclasses.replace(members, rest_length=rest)
