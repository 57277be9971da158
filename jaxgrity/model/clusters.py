"""Clustered cables: several segments that are one cable, which slides without friction over the nodes between them.

Such a cable has one length, the sum of its segments', one rest length, likewise, and one tension. Segments are springs
in series, and so are their dampers. Clusters are tuples of the numbers of their segments; a segment that belongs to
none is a cable by itself. N. Bel Hadj Ali, L. Rhode-Barbarigos and I. F. C. Smith 2011,
doi:10.1016/j.ijsolstr.2010.10.029.
"""

from jaxgrity.core.errors import InputError
from jaxgrity.core.primitives import inverse, place_rows, take_rows
from jaxgrity.core.types import Edges, PerMember, PerRow

Clusters = tuple[tuple[int, ...], ...]


def cables_of(clusters: Clusters, segments: int) -> Clusters:
    """The segments of every cable, in the order of their first segments."""
    alone = set(range(segments)) - {k for cluster in clusters for k in cluster}
    return tuple(sorted((*clusters, *((k,) for k in alone)), key=min))


def added_up(x: PerMember, clusters: Clusters) -> PerRow:
    """For each cable the sum over its segments."""
    if not clusters:
        return x
    rows, count = _cable_numbers(clusters, len(x))
    return place_rows(x, rows, count)


def in_series(k: PerMember, clusters: Clusters) -> PerRow:
    """For each cable 1/sum(1/k) over its segments, stiffness or damping; 0 where one of them has none."""
    if not clusters:
        return k
    rows, count = _cable_numbers(clusters, len(k))
    none = place_rows((k == 0).astype(k.dtype), rows, count)
    return inverse(place_rows(inverse(k), rows, count)) * (none == 0).astype(k.dtype)


def to_segments(x: PerRow, clusters: Clusters, segments: int) -> PerMember:
    """For each segment what its cable has, such as the tension."""
    return take_rows(x, _cable_numbers(clusters, segments)[0]) if clusters else x


def pull(stiffness: PerMember, stretch: PerMember, clusters: Clusters) -> PerMember:
    """K (l - L), N, of each segment: what its whole cable pulls with, or would push with if it could."""
    if not clusters:
        return stiffness * stretch
    return to_segments(in_series(stiffness, clusters) * added_up(stretch, clusters), clusters, len(stretch))


def check_clusters(clusters: Clusters, edges: Edges) -> None:
    """Raises `InputError` where segments are not there, are in two cables, or do not follow each other node by node."""
    every = [k for cluster in clusters for k in cluster]
    if len(set(every)) < len(every) or not all(0 <= k < len(edges) for k in every):
        raise InputError(f"clusters = {[list(c) for c in clusters]}: expected members from 0 to {len(edges) - 1}, once")
    for cluster in clusters:
        if len(cluster) < 2 or not nodes_along(tuple(edges[k] for k in cluster)):
            joined = ", ".join(f"{k} joins {list(edges[k])}" for k in cluster)
            raise InputError(f"clusters: {joined}; expected two or more members, each from where the last one ends")


def nodes_along(segments: Edges) -> tuple[int, ...]:
    """The nodes that a cable meets, one after the other; none where its segments do not follow each other."""
    first, *others = segments
    path: tuple[int, ...]
    for path in (first, first[::-1]):
        for edge in others:
            if path[-1] not in edge:
                break
            path = (*path, edge[0] if path[-1] == edge[1] else edge[1])
        else:
            return path
    return ()


def _cable_numbers(clusters: Clusters, segments: int) -> tuple[tuple[int, ...], int]:
    """Which cable each segment belongs to, and how many cables there are."""
    cables = cables_of(clusters, segments)
    number = {k: cable for cable, parts in enumerate(cables) for k in parts}
    return tuple(number[k] for k in range(segments)), len(cables)
