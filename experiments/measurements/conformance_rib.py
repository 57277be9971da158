"""The rib of a wing as a tensegrity: two struts cross in each bay, cables are the skin and the spars."""

from collections.abc import Iterator

import numpy as np
from measurements.conformance_loads import springs
from measurements.conformance_statics import CLOSED, Case

from jaxgrity import Scene, Structure
from jaxgrity.statics import prestressed, static_response, statics_of

RIB = "wing rib (NACA 2412)"
EA = 1e9
"""N, of all members. It is so much that the prestress, which is less than 1 N, does not stiffen the rib."""


def outline(at: np.ndarray, camber: float = 0.02, where: float = 0.4, thickness: float = 0.12) -> np.ndarray:
    """(2 stations, 3), m: points of a NACA profile of 1 m chord, below and above at each station in turn.

    The formulas are those of four digits: Jacobs, Ward and Pinkerton, NACA report 460 (1933).
    """
    front = at < where
    height = np.where(front, at * (2 * where - at), 1 - 2 * where + at * (2 * where - at))
    scale = camber / np.where(front, where, 1 - where) ** 2
    slope = np.arctan(2 * scale * (where - at))
    half = 5 * thickness * (0.2969 * np.sqrt(at) + at * (-0.126 + at * (-0.3516 + at * (0.2843 - 0.1015 * at))))
    sides = [[at - s * half * np.sin(slope), 0 * at, scale * height + s * half * np.cos(slope)] for s in (-1, 1)]
    return np.array(sides).transpose(2, 0, 1).reshape(-1, 3)


def stress_of_a_bay(corners: np.ndarray) -> dict[tuple[int, int], float]:
    """Force densities that balance in a quadrilateral with both diagonals: 1/(area on one side times the other)."""
    x, z = corners[:, 0], corners[:, 2]
    area = lambda i, j, k: (x[j] - x[i]) * (z[k] - z[i]) - (x[k] - x[i]) * (z[j] - z[i])  # noqa: E731
    pairs = {(i, j): [k for k in range(4) if k not in (i, j)] for i in range(4) for j in range(i + 1, 4)}
    return {(i, j): 1 / (area(i, j, k) * area(i, j, m)) for (i, j), (k, m) in pairs.items()}


def rib(lift: float = 1.0) -> Iterator[Case]:
    """Held at the front spar, and lifted by `lift` (N) at each upper node behind it.

    The force method, without any matrix of stiffness: with one diagonal of each bay cut, forces follow from sections;
    each bay has one stress that balances without loads, and these stresses close the cuts.
    """
    nodes = outline(np.linspace(0.1, 0.85, 6))
    bays = [(2 * k, 2 * k + 1, 2 * k + 2, 2 * k + 3) for k in range(5)]  # front below and above, rear below and above
    struts = [pair for a, b, c, d in bays for pair in ((a, d), (b, c))]
    cables = [pair for a, b, c, d in bays for pair in ((a, c), (b, d), (c, d))]
    edges = [*struts, *cables]
    length = np.linalg.norm(nodes[[i for i, _ in edges]] - nodes[[j for _, j in edges]], axis=1)
    number = {edge: k for k, edge in enumerate(edges)}
    supports = tuple((k, "xyz" if k < 2 else "y") for k in range(len(nodes)))
    fixed = np.array([["xyz".find(axis) >= 0 and axis in axes for axis in "xyz"] for _, axes in supports])

    alone = np.zeros((len(edges), len(bays)))
    for b, bay in enumerate(bays):
        for (i, j), density in stress_of_a_bay(nodes[list(bay)]).items():
            if (pair := (bay[i], bay[j])) in number:  # the spar between the supports is none
                alone[number[pair], b] = density * length[number[pair]]
    loads = np.zeros_like(nodes)
    loads[3::2, 2] = lift
    tip = np.zeros_like(nodes)
    tip[-1, 2] = 1.0
    cut, of_tip = (by_sections(nodes, bays, number, length, each) for each in (loads, tip))
    closing = np.linalg.solve(alone.T @ (alone * length[:, None]), -alone.T @ (cut * length))
    forces = cut + alone @ closing

    found = statics_of(nodes, tuple(edges), fixed)
    yield Case(f"{RIB}, states of self-stress", CLOSED, len(bays), found.self_stress.shape[1])
    members = [
        springs(part, EA / length[own], length[own])
        for part, own in ((struts, slice(len(struts))), (cables, slice(len(struts), None)))
    ]
    held = Structure(nodes, np.ones(len(nodes)), *members, fixed=supports)
    built = prestressed(held, 0.5, force_density=alone.sum(1) / length)
    response = static_response(Scene(built), nodes, loads)
    worst = int(np.abs(response.force_change - forces).argmax())
    name = f"{RIB} under 1 N on each upper node, the force that differs most"
    yield Case(name, CLOSED, forces[worst], float(response.force_change[worst]), "N")
    rise = float(of_tip @ (forces * length)) / EA
    name = f"{RIB} under 1 N on each upper node, rise of its rear end"
    yield Case(name, CLOSED, rise, float(response.displacement[-1, 2]), "m")


def by_sections(
    nodes: np.ndarray, bays: list, number: dict[tuple[int, int], int], length: np.ndarray, loads: np.ndarray
) -> np.ndarray:
    """Forces of members, N, with the second diagonal of each bay cut: what is behind a section balances."""
    forces, x = np.zeros(len(number)), nodes[:, [0, 2]]
    for a, b, c, d in reversed(bays):
        pairs = [(a, d), (a, c), (b, d)]
        behind = np.arange(len(nodes)) >= c
        # unit forces on what is behind by the three members that the section cuts, and their moments about the origin
        pull = np.array([(x[i] - x[j]) / length[number[i, j]] for i, j in pairs])
        arms = [turning(x[j], each) for (_, j), each in zip(pairs, pull)]
        outer = loads[behind][:, [0, 2]]
        moment = turning(x[behind], outer).sum()
        found = np.linalg.solve(np.vstack([pull.T, arms]), -np.r_[outer.sum(0), moment])
        forces[[number[pair] for pair in pairs]] = found
    for _, _, c, d in bays:  # the spar behind each bay, from its lower node along z
        meeting = [pair for pair in number if c in pair and pair != (c, d)]
        pulled = sum(forces[number[i, j]] * (x[i + j - c] - x[c]) / length[number[i, j]] for i, j in meeting)
        spar = (x[d] - x[c]) / length[number[c, d]]
        forces[number[c, d]] = -(pulled + loads[c, [0, 2]]) @ spar / (spar @ spar)
    return forces


def turning(x: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Moment about the origin of forces in a plane, N m."""
    return x[..., 0] * force[..., 1] - x[..., 1] * force[..., 0]
