"""Prestress for a given shape: the rest lengths at which all forces balance."""

import dataclasses

import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import PerMember
from jaxgrity.model.structure import Members, Structure, edge_lengths
from jaxgrity.statics.form_finding import prestress, rest_lengths
from jaxgrity.statics.stiffness import all_edges


@typed
def prestressed(structure: Structure, tension: float, force_density: PerMember | None = None) -> Structure:
    """The structure with the rest lengths at which its shape is in equilibrium without loads.

    L = l - f/K for springs, L = l for rigid struts, with the forces of `prestress`.

    Args:
        structure: its shape is kept, its rest lengths are replaced. Supports balance the forces on their nodes.
        tension: of the tightest cable, N.
        force_density: the self-stress, N/m, struts first; it is scaled. None: the one with the most even cables.

    Returns:
        The structure with its new rest lengths.

    Raises:
        InputError: no self-stress has every cable in tension, or a rest length would not be positive.

    Example:
        >>> scene = jaxgrity.load_scene("reference")
        >>> structure = jaxgrity.statics.prestressed(scene.structure, tension=100.0)
        >>> [f"{length:.4f}" for length in structure.cables.rest_length[:2]]
        ['0.4457', '0.4457']
    """
    if structure.cables is None or structure.cables.stiffness is None:
        raise InputError("prestress needs cables that are springs; expected a structure with cables")
    if structure.cables.clusters:
        clusters = [list(cluster) for cluster in structure.cables.clusters]
        raise InputError(f"clusters = {clusters}: prestress decides each segment's tension; expected rest lengths")
    struts, cables = (m.edges if m is not None else () for m in (structure.struts, structure.cables))
    nodes, edges = np.asarray(structure.nodes, float), all_edges(structure)
    if force_density is None:
        q = np.asarray(prestress(nodes, struts, cables, tension, structure.supported))
    else:
        forces = np.asarray(force_density, float) * edge_lengths(nodes, edges)
        q = np.asarray(force_density, float) * (tension / forces[len(struts) :].max())
    return dataclasses.replace(
        structure,
        struts=_at_rest(structure.struts, nodes, q[: len(struts)]),
        cables=_at_rest(structure.cables, nodes, q[len(struts) :]),
    )


def _at_rest(members: Members | None, nodes: np.ndarray, force_density: np.ndarray) -> Members | None:
    if members is None:
        return None
    if members.stiffness is None:
        return dataclasses.replace(members, rest_length=edge_lengths(nodes, members.edges))
    rest = rest_lengths(nodes, members.edges, np.asarray(members.stiffness, float), force_density)
    return dataclasses.replace(members, rest_length=rest)
