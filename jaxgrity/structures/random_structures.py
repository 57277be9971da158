"""Random structures by seed, for tests and studies: no two struts share a node, and all are stable under
self-stress."""

from itertools import combinations

import numpy as np
from scipy.spatial import Delaunay

from jaxgrity.core.arguments import check_count
from jaxgrity.core.errors import InputError
from jaxgrity.model.scene import Scene
from jaxgrity.model.structure import Members, Structure, edge_lengths
from jaxgrity.statics.equilibrium import resting_shape
from jaxgrity.structures.geometry import Geometry, at_least, check_positive

TRIES = 20
"""Most random draws for one seed until a structure stands."""
STRUT_STIFFNESS, CABLE_STIFFNESS = 1e3, 1.0
"""Stiffness of the springs with which the shape is found, N/m. Only their ratio matters."""
SHORT = 0.3
"""Rest lengths of cables while the shape is found, as a share of their lengths at the start."""
TAUT = 1e-3
"""Cables with less than this share of the largest tension are left out."""


def random_tensegrity(struts: int = 6, seed: int = 0, strut_length: float = 1.0) -> Geometry:
    """A random stable structure; each strut has its own two nodes.

    Nodes are drawn in a ball, paired by struts in turn, and joined by cables along the edges of their Delaunay
    tetrahedra. Short cables then pull the structure together until U has a minimum. Taut members carry a self-stress
    there; slack cables are removed. Struts may pass through each other.

    Args:
        struts: their number, at least 3.
        seed: of the draws; the same structure on every machine, to rounding.
        strut_length: m, approximately: struts are slightly compressed.

    Returns:
        Nodes, struts and cables; node 2k and node 2k + 1 are the ends of strut k.

    Raises:
        InputError: fewer than 3 struts, or no stable structure among the draws.

    Example:
        >>> geometry = jaxgrity.structures.random_tensegrity(struts=5, seed=1)
        >>> geometry.nodes.shape, geometry.struts[:2]
        ((10, 3), ((0, 1), (2, 3)))
    """
    at_least("struts", struts, 3)
    check_positive(strut_length=strut_length)
    random = np.random.default_rng(check_count("seed", seed, 0))
    for _ in range(TRIES):
        found = _pulled_together(random.normal(size=(2 * struts, 3)))
        if found is not None:
            return found._replace(nodes=found.nodes * strut_length)
    raise InputError(f"seed = {seed}: none of {TRIES} draws stands; expected another seed")


def _pulled_together(drawn: np.ndarray) -> Geometry | None:
    rods = tuple((k, k + 1) for k in range(0, len(drawn), 2))
    edges = {tuple(sorted(pair)) for cell in Delaunay(drawn).simplices.tolist() for pair in combinations(cell, 2)}
    cables = tuple(sorted(edges - set(rods)))
    tight = Members(cables, np.full(len(cables), CABLE_STIFFNESS), SHORT * edge_lengths(drawn, cables))
    stiff = Members(rods, np.full(len(rods), STRUT_STIFFNESS), np.ones(len(rods)))
    try:
        rest = resting_shape(Scene(Structure(drawn, np.ones(len(drawn)), stiff, tight)))
    except InputError:
        return None
    tension = edge_lengths(rest.q, cables) - tight.rest_length
    taut = tuple(edge for edge, force in zip(cables, tension) if force > TAUT * tension.max())
    held = min((sum(node in edge for edge in taut) for node in range(len(drawn))), default=0)
    # a node that three cables at least and a strut hold can be at rest in space
    return Geometry(np.asarray(rest.q), rods, taut) if rest.stable and held >= 3 else None
