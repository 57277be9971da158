"""Shapes and force densities of a topology alone: which nodes struts and cables join, and nothing else."""

from collections import Counter
from collections.abc import Sequence

import numpy as np
import scipy

from jaxgrity.core.arguments import check_count, check_indices
from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import Edges
from jaxgrity.model.structure import Members, check_edges, edge_lengths
from jaxgrity.statics.form_finding import RANK, super_stable
from jaxgrity.statics.stiffness import incidence

NEWTON_STEPS = 50
"""Most Newton steps from one start. Where a form is near, fewer than ten reach it."""
ZERO_EIGENVALUE = 1e-14
"""Largest of the eigenvalues that are to be 0, as a share of the largest eigenvalue: rounding."""
SPREAD = 0.5
"""Standard deviation of the logarithms of force densities at random starts."""
APART = 1e-6
"""Smallest distance of two nodes, and smallest force density of a member, as a share of the largest."""


@typed
def form_of_topology(
    struts: Edges,
    cables: Edges,
    dimensions: int = 3,
    groups: Sequence[Sequence[int]] = (),
    starts: int = 20,
    seed: int = 0,
) -> tuple[np.ndarray, np.ndarray]:
    """A super-stable, free-standing shape of struts and cables that are given without coordinates.

    Cables have positive force densities q, struts negative ones. At each start the lowest eigenvalue of the stress
    matrix Omega is 0. Newton's method in log |q| then brings the d lowest ones to 0 (Friedland, Nocedal and Overton
    1987, doi:10.1137/0724043). There Omega has rank nodes - 1 - d and no negative eigenvalue. Its null vectors are the
    coordinates. Every affine map of the shape carries the same force densities.

    A topology has many forms. At the first start all cables have one force density, and all struts another. A form
    from there has all symmetries of the topology, to rounding. `groups` enforce them at every start.

    Args:
        struts: pairs of nodes, from 0.
        cables: likewise. They join all nodes into one net: otherwise a shift of one net has negative energy.
        dimensions: d, 3 in space and 2 in the plane z = 0.
        groups: lists of members with one force density each, struts first, then cables, such as `alike_members`.
        starts: most starts; all but the first are random.
        seed: of the random starts.

    Returns:
        The nodes, (nodes, 3), m; second moments about the centre are alike in all directions, struts of 1 m on average.
        Force densities (members,), N/m, of which the largest is 1.

    Raises:
        InputError: impossible members or groups, nodes that cables do not reach, or no form from any start.

    Example:
        >>> _, struts, cables = jaxgrity.structures.icosahedron()
        >>> nodes, q = jaxgrity.statics.form_of_topology(struts, cables)
        >>> f"{q[0]:.4f} {q[6]:.4f}"
        '-1.5000 1.0000'
    """
    edges, nodes = _checked(struts, cables, dimensions)
    check_count("starts", starts, 1)
    check_count("seed", seed, 0)
    member = _in_groups(groups, len(edges), len(struts))
    sign = np.repeat([-1.0, 1.0], [len(struts), len(cables)])
    C = incidence(edges, nodes).toarray()
    random, flaws, nearest = np.random.default_rng(seed), Counter[str](), np.inf
    for start in range(starts):
        p = random.normal(0.0, SPREAD, member.shape[1:]) * bool(start)
        q, off, x = _at_rank(C, sign, member, p, dimensions)
        x /= edge_lengths(x, struts).mean()
        flaw = _flaw(x, edges, q, off, dimensions)
        if flaw is None:
            return x, q / q.max()
        flaws[flaw] += 1
        nearest = min(nearest, off)
    counted = ", ".join(f"{count} {flaw}" for flaw, count in flaws.most_common())
    raise InputError(
        f"no super-stable form from {starts} starts: {counted}. An eigenvalue that must be 0 came "
        f"down to {nearest:.0e} of the largest one; expected other members, fewer groups or more starts"
    )


def alike_members(struts: Edges, cables: Edges) -> tuple[tuple[int, ...], ...]:
    """Members that symmetries of a topology map on each other, struts first: each is in one group.

    A symmetry renumbers nodes such that struts stay struts and cables stay cables. No coordinates are needed.
    """
    edges, nodes = _checked(struts, cables, dimensions=2)
    joined = np.zeros((nodes, nodes), int)
    for kind, part in ((1, struts), (2, cables)):
        for i, j in part:
            joined[i, j] = joined[j, i] = kind
    np.fill_diagonal(joined, -1)  # so that no node is the image of two
    number = {frozenset(edge): k for k, edge in enumerate(edges)}
    group = np.arange(len(edges))
    firsts: list[int] = []
    for k, edge in enumerate(edges):
        if group[k] < k:
            continue
        for ends in (turned for first in firsts for turned in (edges[first], edges[first][::-1])):
            image = _symmetry(joined, edge, ends)
            if image is not None:
                for m, (i, j) in enumerate(edges):
                    both = group[[m, number[frozenset((image[i], image[j]))]]]
                    group[np.isin(group, both)] = both.min()
                break
        else:
            firsts.append(k)
    return tuple(tuple(np.flatnonzero(group == first).tolist()) for first in firsts)


def _symmetry(joined: np.ndarray, edge: tuple[int, int], ends: tuple[int, int]) -> dict[int, int] | None:
    """A map of the nodes that keeps how they are `joined`, and takes `edge` to `ends`; None if there is none."""
    order = list(edge)
    for node in order:  # grows on the way: each later node is joined to an earlier one
        order += [new for new in np.flatnonzero(joined[node] > 0).tolist() if new not in order]
    partial: list[tuple[int, ...]] = [ends] if joined[edge] == joined[ends] else []
    while partial:
        images = partial.pop()
        if len(images) == len(order):
            return dict(zip(order, images))
        wanted = joined[order[len(images)], order[: len(images)]]
        partial += [(*images, int(new)) for new in np.flatnonzero((joined[:, images] == wanted).all(1))]
    return None


def _checked(struts: Edges, cables: Edges, dimensions: int) -> tuple[Edges, int]:
    """All members, and the number of nodes. Raises `InputError` where they cannot form a structure with a stress."""
    for kind, edges in (("struts", struts), ("cables", cables)):
        if not len(edges):
            raise InputError(f"{kind} = {edges!r}: expected at least one, as a stress needs struts and cables")
        Members(edges, None, np.ones(len(edges)))  # refuses what is no pair of nodes
    if dimensions not in (2, 3):
        raise InputError(f"dimensions = {dimensions!r}: expected 3 (space) or 2 (plane)")
    edges = tuple((int(i), int(j)) for i, j in (*struts, *cables))
    count = max(map(max, edges)) + 1
    check_edges(np.arange(count), struts, cables, "topology")
    if count < dimensions + 2:
        raise InputError(f"{count} nodes: expected at least {dimensions + 2}, as the stress matrix of fewer is 0")
    net = scipy.sparse.csgraph.connected_components(abs(incidence(cables, count)).T @ abs(incidence(cables, count)))[1]
    if net.any():
        raise InputError(
            f"cables do not lead from node 0 to node {np.flatnonzero(net)[0]}: expected one net of cables that joins "
            "all nodes, since no other form is super-stable"
        )
    return edges, count


def _in_groups(groups: Sequence[Sequence[int]], count: int, first: int) -> np.ndarray:
    """1 where a member belongs to a group, else 0 (members, groups). A member that no list names is its own group."""
    named = [check_indices(f"groups[{k}]", group, count) for k, group in enumerate(groups)]
    for k, group in enumerate(named):
        if len({member < first for member in group}) > 1:
            raise InputError(f"groups[{k}] = {list(group)}: expected struts alone (0 to {first - 1}), or cables alone")
    check_indices("groups, one after the other", [member for group in named for member in group])
    alone = sorted(set(range(count)).difference(*named))
    return np.stack([np.isin(np.arange(count), group) for group in (*named, *([k] for k in alone))], 1).astype(float)


def _at_rank(
    C: np.ndarray, sign: np.ndarray, member: np.ndarray, p: np.ndarray, dimensions: int
) -> tuple[np.ndarray, float, np.ndarray]:
    """From the logarithms `p` of the groups' force densities to some at which Omega's lowest eigenvalues are 0.

    V' Omega V with the eigenvectors V has a derivative also where eigenvalues are equal. Returns the force densities,
    the largest of these eigenvalues as a share of Omega's largest one, and nodes from V: node 0 on the x axis, node 1
    in the plane z = 0.
    """
    basis = scipy.linalg.null_space(np.ones((1, C.shape[1])))  # shapes about their centre
    C = C @ basis
    pull, push = (C.T @ (part[:, None] * C) for part in (np.exp(member @ p) * (sign == s) for s in (1, -1)))
    strongest = scipy.linalg.eigh(push, pull, eigvals_only=True)[-1]
    p = p - np.log(strongest) * (sign @ member < 0)  # the strongest struts at which no eigenvalue is negative
    a, b = np.triu_indices(dimensions)
    for _ in range(NEWTON_STEPS):
        q = sign * np.exp(member @ p)
        values, vectors = np.linalg.eigh(C.T @ (q[:, None] * C))
        chosen = _lowest(values, dimensions)
        lowest, off = vectors[:, chosen], np.abs(values[chosen]).max() / values[-1]
        if off <= ZERO_EIGENVALUE:
            break
        d = C @ lowest
        slope = (member.T @ (q[:, None] * d[:, a] * d[:, b])).T
        # all densities in proportion bring all eigenvalues to 0: their sum of logarithms stays
        step = np.linalg.lstsq(slope - slope.mean(1, keepdims=True), -slope.sum(1), RANK)[0]
        p = p + step / max(1, np.abs(step).max())
    # eigenvectors of equal eigenvalues come in no order
    upper = np.linalg.qr((basis @ lowest).T)[1]
    x = np.zeros((len(basis), 3))
    x[:, :dimensions] = (upper * np.where(np.diag(upper) < 0, -1, 1)[:, None]).T
    return q, float(off), x


def _lowest(values: np.ndarray, count: int) -> list[int]:
    """The lowest of ascending eigenvalues, without parts of equal ones: symmetry makes these 0 together."""
    chosen: list[int] = []
    for equal in np.split(np.arange(len(values)), np.flatnonzero(np.diff(values) > RANK * values[-1]) + 1):
        if len(chosen) + len(equal) <= count:
            chosen += equal.tolist()
    return chosen if len(chosen) == count else list(range(count))


def _flaw(x: np.ndarray, edges: Edges, q: np.ndarray, off: float, dimensions: int) -> str | None:
    """What is wrong with a form, in words that follow a number of starts; None if it is super-stable."""
    distance = scipy.spatial.distance.pdist(x)
    if not off <= ZERO_EIGENVALUE:
        return f"reached no stress matrix of rank nodes - {dimensions + 1}"
    if distance.min() <= APART * distance.max():
        return "put two nodes in one place"
    if np.abs(q).min() <= APART * np.abs(q).max():
        return "left a member without force"
    return None if super_stable(x, edges, q) else "had a lower rank, or can be deformed without changing a length"
