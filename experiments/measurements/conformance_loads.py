"""Loads, deployments and least masses that are known in closed form or from other programs."""

import dataclasses
from collections.abc import Iterator
from itertools import chain, pairwise

import numpy as np
from measurements.conformance_statics import CLOSED, MOTES, RODS, STATIC, TSGFEM, Case, published_tower
from scipy.optimize import fsolve, minimize_scalar

from jaxgrity import Members, Scene, Structure
from jaxgrity.model import LoadCase, Material, sized_members
from jaxgrity.statics import (
    LeastMass,
    least_mass,
    load_report,
    member_forces,
    resting_shape,
    static_response,
    statics_of,
)
from jaxgrity.structures import d_bar


def load_cases() -> Iterator[Case]:
    """All of them."""
    return chain(arches(), kresling(), dome(), cantilever(), half_t_bar(), deployed_tower(), least_masses())


def springs(edges: list, stiffness: np.ndarray | float, rest_length: np.ndarray | float) -> Members:
    """Members of given stiffness, N/m, and rest length, m."""
    each = np.ones(len(edges))
    return Members(tuple(map(tuple, edges)), stiffness * each, rest_length * each)


def arch(height: float, stiffness: float = 1e3) -> Scene:
    """Two struts from supports 2 m apart up to a node, which is loaded downwards (von Mises 1923)."""
    nodes = np.array([[-1.0, 0, 0], [1, 0, 0], [0, 0, height]])
    struts = springs([(0, 2), (1, 2)], stiffness, np.hypot(1, height))
    structure = Structure(nodes, np.ones(3), struts, fixed=((0, "xyz"), (1, "xyz"), (2, "y")))
    return Scene(structure, loads=(LoadCase("down", (2,), np.array([[0, 0, -1.0]])),))


def arches() -> Iterator[Case]:
    """The largest load: 2 K (L - l) z/l at l^3 = L b^2; a steep one gives way sideways before, where l^3 = L z^2."""
    for height in (0.1, 1.0, 3.0):
        L = np.hypot(1, height)
        # l^3 = L (l^2 - b^2) has two solutions; growing loads meet the longer one
        sideways = max(np.roots([1, -L, 0, L]).real)
        length, what = (L ** (1 / 3), "snaps through") if height < 2 else (sideways, "gives way sideways")
        z = np.sqrt(length**2 - 1)
        event = load_report(arch(height), "down", most=1e4).path[-1]
        yield Case(
            f"two-bar truss {height:g} times as high as half its span, load at which it {what}",
            CLOSED,
            2e3 * (L - length) * z / length,
            event.factor,
            "N",
        )


def kresling(n: int = 3, height: float = 0.6, turn: float = 0.8) -> Iterator[Case]:
    """A prism of struts with both diagonals of each side, as in Kresling's folds: pressed down, it turns and snaps.

    By symmetry its state is height, turn and radius of the upper polygon. At each height two equations give the other
    two, and the load; its first maximum is where the prism snaps through.
    """
    K, side, step = np.array([1e3, 1e3, 1e4]), 2 * np.sin(np.pi / n), 2 * np.pi / n
    angles = np.array([0.0, step])

    def lengths(z: float, turn: float, radius: float) -> np.ndarray:
        return np.r_[np.sqrt(z**2 + 1 + radius**2 - 2 * radius * np.cos(turn + angles)), side * radius]

    rest = lengths(height, turn, 1.0)

    def slopes(at: np.ndarray, z: float) -> list[float]:
        """Derivatives of the energy of a side by turn and radius, and the load on the prism, N."""
        length = lengths(z, *at)
        force, q = K * (length - rest), (K * (1 - rest / length))[:2]
        by_radius = q @ (at[1] - np.cos(at[0] + angles)) + force[2] * side
        return [at[1] * q @ np.sin(at[0] + angles), by_radius, -n * z * q.sum()]

    def load(z: float) -> float:
        at = fsolve(lambda at: slopes(at, z)[:2], (turn, 1.0), xtol=1e-13)
        return slopes(at, z)[2]

    most = load(minimize_scalar(lambda z: -load(z), (height / 4, height / 2, height)).x)
    each = np.arange(n)
    nodes = np.array(
        [[np.cos(a), np.sin(a), z] for z, first in ((0.0, 0.0), (height, turn)) for a in first + step * each]
    )
    struts = np.concatenate([np.stack(pair, 1) for pair in ((each, n + each), (each, n + (each + 1) % n))])
    struts = np.r_[struts, np.stack([n + each, n + (each + 1) % n], 1)].tolist()
    built = Structure(nodes, np.ones(2 * n), springs(struts, np.repeat(K, n), np.repeat(rest, n)))
    held = dataclasses.replace(built, fixed=tuple((k, "xyz") for k in range(n)))
    down = LoadCase("down", tuple(range(n, 2 * n)), np.tile([0, 0, -1.0 / n], (n, 1)))
    event = load_report(Scene(held), down, most=1e3).path[-1]
    name = "prism with both diagonals of each side (Kresling's fold), load at which it snaps through"
    yield Case(name, CLOSED, most, event.factor, "N")


def dome(n: int = 8) -> Iterator[Case]:
    """Geiger's cable dome: its ridges, diagonals, hoops and posts carry one stress, joint by joint from the middle."""
    r, top, bottom = np.array([0.0, 4, 8, 12]), np.array([3.0, 2.6, 1.6, 0]), np.array([1.0, 0.8, -0.6])
    around, each = 2 * np.pi * np.arange(n) / n, np.arange(n)
    # one node in the middle above and one below, n on each ring
    upper = [0 * each, *(1 + each + k * n for k in range(3))]
    lower = [0 * each + 3 * n + 1, *(3 * n + 2 + each + k * n for k in range(2))]
    nodes = np.zeros((5 * n + 2, 3))
    for numbers, heights in ((upper, top), (lower, bottom)):
        for ring, radius, z in zip(numbers, r, heights):
            nodes[ring] = np.stack([radius * np.cos(around), radius * np.sin(around), z + 0 * around], 1)

    step, in_hoop = np.diff(r), 2 * (1 - np.cos(2 * np.pi / n))
    ridge, diagonal = [1.0], [(top[0] - top[1]) / (top[1] - bottom[0])]
    post, hoop = [n * (top[1] - top[0]) / (top[0] - bottom[0])], []
    for k in (1, 2):
        ridge.append((ridge[-1] + diagonal[-1]) * step[k - 1] / step[k])
        up = ridge[k] * (top[k + 1] - top[k]) + ridge[k - 1] * (top[k - 1] - top[k])
        post.append((up + diagonal[k - 1] * (bottom[k - 1] - top[k])) / (top[k] - bottom[k]))
        diagonal.append(post[k] * (bottom[k] - top[k]) / (top[k + 1] - bottom[k]))
        hoop.append(diagonal[k] * step[k] / (r[k] * in_hoop))
    pairs = [*pairwise(upper), *zip(lower, upper[1:]), *zip(lower[1:], upper[1:])]
    pairs += [(ring, np.roll(ring, -1)) for ring in lower[1:]]
    edges = np.concatenate([np.stack(pair, 1) for pair in pairs])
    edges = ((3 * n + 1, 0), *map(tuple, edges.tolist()))
    theirs = np.r_[post[0], np.repeat([*ridge, *diagonal, *post[1:], *hoop], n)]
    fixed = np.zeros((len(nodes), 3), bool)
    fixed[upper[-1]] = True
    found = statics_of(nodes, edges, fixed).self_stress
    yield Case("cable dome (Geiger), states of self-stress", CLOSED, 1, found.shape[1])
    ours = found[:, 0] * (theirs[0] / found[0, 0])
    worst = int(np.abs(ours - theirs).argmax())
    yield Case("cable dome (Geiger), the force density that differs most", CLOSED, theirs[worst], ours[worst])


def truss(bays: int = 4, bay: float = 1.0, height: float = 0.8) -> Structure:
    """A cantilever of squares with one diagonal each, of steel tubes; nodes 2k below and 2k + 1 above."""
    nodes = np.array([[k * bay, 0, z] for k in range(bays + 1) for z in (0, height)])
    edges = [
        edge for k in range(0, 2 * bays, 2) for edge in ((k, k + 2), (k + 1, k + 3), (k + 1, k + 2), (k + 2, k + 3))
    ]
    lengths = np.linalg.norm(nodes[[i for i, _ in edges]] - nodes[[j for _, j in edges]], axis=1)
    struts = sized_members(tuple(edges), lengths, "steel", diameter=0.03, wall=0.002)
    supports = tuple((k, "xyz" if k < 2 else "y") for k in range(len(nodes)))
    return Structure(nodes, np.zeros(len(nodes)), struts, fixed=supports)


def cantilever() -> Iterator[Case]:
    """Forces by sections, the displacement of the tip by virtual work, and Euler's load of the lowest member."""
    bays, bay, height, load = 4, 1.0, 0.8, 100.0
    structure = truss(bays, bay, height)
    tip = np.zeros((len(structure.nodes), 3))
    tip[-1, 2] = -load
    found = static_response(Scene(structure), structure.nodes, tip)
    right = np.arange(bays, 0, -1.0)  # bays from the left end of each to the tip
    diagonal = np.hypot(bay, height)
    # of lower chords, upper chords, diagonals, posts, under a load of 1 N
    forces = -right * bay / height, (right - 1) * bay / height, right**0 * diagonal / height, -(right**0)
    lengths, EA = (bay, bay, diagonal, height), 210e9 * np.pi / 4 * (0.03**2 - 0.026**2)
    sag = load / EA * sum(float(np.sum(f**2) * length) for f, length in zip(forces, lengths))
    yield Case("cantilever truss, force of the lower chord", CLOSED, load * forces[0][0], found.force_change[0], "N")
    yield Case("cantilever truss, displacement of the tip", CLOSED, -sag, found.displacement[-1, 2], "m")
    euler = np.pi**2 * 210e9 * np.pi / 64 * (0.03**4 - 0.026**4) / bay**2
    first = load_report(Scene(structure), LoadCase("tip", (2 * bays + 1,), tip[-1:])).linear[0]
    yield Case(
        "cantilever truss, load at which its first strut buckles",
        CLOSED,
        euler / right[0] * height / bay,
        first.factor * load,
        "N",
    )


def half_t_bar() -> Iterator[Case]:
    """A strut between two cables, pulled aside until it leans by 7 degrees; one cable goes slack."""
    given, count = STATIC["half_t_bar"], 1
    rest, fixed = np.array(given["rest_length_m"]), tuple(map(tuple, given["fixed"]))
    K = np.array(given["EA_N"]) / rest
    struts, cables = (
        springs(given["struts"], K[:count], rest[:count]),
        springs(given["cables"], K[count:], rest[count:]),
    )
    structure = Structure(np.array(given["nodes_m"]), np.ones(4), struts, cables, fixed=fixed)
    case = LoadCase("aside", (given["loaded_node"],), np.array([given["load_N"]]))
    found = load_report(Scene(structure), case)
    end = found.shape[given["loaded_node"]]
    for axis in (0, 2):
        yield Case(f"half T-bar under 10 kN, {'xyz'[axis]} of its tip", TSGFEM, given["end_m"][axis], end[axis], "m")
    for k, name in enumerate(("strut", "tight cable", "slack cable")):
        yield Case(f"half T-bar under 10 kN, force of the {name}", TSGFEM, given["forces_N"][k], found.forces[k], "N")


def deployed_tower() -> Iterator[Case]:
    """Supports of the tower's top led up, a strut shortened and a load applied, all in ten steps."""
    given, built = STATIC["deployed_tower"], published_tower()
    EA, edges = np.array(RODS["tower"]["EA_N"]), built.struts.edges + built.cables.edges
    top, rest = given["raised_nodes"], np.array(RODS["tower"]["rest_length_m"])
    fixed = (*built.fixed, *((node, "z") for node in top))
    q, load = np.array(built.nodes), np.zeros((9, 3))
    for share in np.arange(1, 11) / 10:
        lengths = rest.copy()
        lengths[given["shortened_strut"]] -= share * given["shortened_m"]
        q[top, 2] = built.nodes[top, 2] + share * given["raised_m"]
        load[given["loaded_node"]] = share * np.array(given["load_N"])
        structure = Structure(built.nodes, np.ones(9), springs(edges, EA / lengths, lengths), fixed=fixed)
        q = np.array(resting_shape(Scene(structure), q, load).q)
    theirs, forces = np.array(given["end_m"]), np.array(given["forces_N"])
    worst = np.unravel_index(np.abs(q - theirs).argmax(), q.shape)
    yield Case("deployed tower, the coordinate that differs most", TSGFEM, float(theirs[worst]), float(q[worst]), "m")
    found = member_forces(structure, q)
    k = int(np.abs(found - forces).argmax())
    yield Case("deployed tower, the force that differs most", TSGFEM, float(forces[k]), float(found[k]), "N")


def least_masses() -> Iterator[Case]:
    """Least masses against yield and Euler's load."""
    given = STATIC["minimal_mass"]
    aluminium = Material(*(given[key] for key in ("youngs_modulus_Pa", "density_kg_m3", "yield_stress_Pa")))
    case = LoadCase("push", tuple(given["loaded_nodes"]), np.array(given["load_N"]))
    for key, name in (("d_bar", "D-bar"), ("t_bar", "T-bar")):
        found = least_of(given["nodes_m"], given[key]["struts"], given[key]["cables"], case, aluminium)
        yield Case(f"square {name}, least mass", MOTES, given[key]["mass_kg"], found.mass, "kg")
    push, length, angle = 1e3, 1.0, 0.4
    for sides in (2, 3, 5):
        nodes, struts, cables = d_bar(sides, length, length / 2 * np.tan(angle))
        ends = LoadCase("push", (0, 1), np.array([[0, 0, push], [0, 0, -push]]))
        found = least_of(nodes, struts, cables, ends, Material(60e9, 2700.0, 1e12), Material(60e9, 970.0, 1e9))
        bar = 2 * 2700 * length**2 * np.sqrt(push / (np.pi * 60e9))
        mass = bar * np.sqrt(sides) / (2 * np.cos(angle) ** 2.5) + 970 / 1e9 * push * length * np.tan(angle) ** 2
        yield Case(
            f"D-bar of {sides} sides and 0.4 rad, least mass",
            "closed form (Skelton and de Oliveira 2009)",
            mass,
            found.mass,
            "kg",
        )
    wall = [[0.0, y, 0] for y in np.linspace(-2, 2, 9)]
    load = LoadCase("down", (9,), np.array([[0, -1e3, 0]]))
    supports = (*((k, "xyz") for k in range(9)), (9, "z"))
    found = least_of(
        [*wall, [1.0, 0, 0]], [(k, 9) for k in range(9)], (), load, aluminium, fixed=supports, buckling=False
    )
    mass = 2 * 1e3 * 1.0 * 2700 / 110e6
    yield Case(
        "bracket on a wall, least mass of a choice of 9 bars", "closed form (Michell 1904)", mass, found.mass, "kg"
    )


def least_of(
    nodes: list, struts: list, cables: list, case: LoadCase, strut: Material, cable: Material | None = None, **given
) -> LeastMass:
    """The least mass of members between nodes, which have no mass."""
    members = [springs(edges, 1.0, 1.0) if len(edges) else None for edges in (struts, cables)]
    structure = Structure(np.array(nodes, float), np.ones(len(nodes)), *members, fixed=given.pop("fixed", ()))
    return least_mass(Scene(structure, loads=(case,)), strut, cable or strut, **given)
