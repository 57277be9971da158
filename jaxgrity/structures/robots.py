"""Robots of rigid bodies: rods with end caps or spools, a payload, vertebrae with legs."""

from collections.abc import Iterable, Sequence

import numpy as np
import scipy

from jaxgrity.core.types import Edges
from jaxgrity.model.balls import Balls
from jaxgrity.model.bodies import Body, rigid_body
from jaxgrity.structures.catalogue import icosahedron
from jaxgrity.structures.geometry import RobotGeometry, at_least, check_positive
from jaxgrity.structures.spines import tetrahedral_spine

CAP = 0.03
"""Radius of a rod's spherical end caps, as a share of its length."""
SPOOL = 0.1
"""Distance of a spool from the rod's end, as a share of the rod's length."""
PAYLOAD, PULL = 0.08, 0.5
"""Radius of a payload, as a share of a rod's length, and tension of its cables, as a share of the other cables'."""
FOOT = 0.05
"""Radius of a quadruped's feet, as a share of a vertebra's width."""


Fixing = tuple[float, float]
"""Place at which a cable is fixed to a rod: its distance from the rod's end along the axis, and its distance from the
axis towards the other rod. Both are shares of the rod's length."""


def capped_robot(
    strut_length: float = 1.0, rod_mass: float = 0.4, cap_mass: float = 0.1, payload_mass: float = 1.0
) -> RobotGeometry:
    """Six rods with spherical end caps in 24 cables, and a payload that hangs in their middle in twelve more.

    A probe that carries its instruments inside (SunSpiral, Agogino and Atkinson 2015, "Super Ball Bot - structures for
    planetary landing and exploration", NIAC phase II report). A thin rod of `rod_mass` kg has two solid balls of
    `cap_mass` kg as caps, with a radius of 3 % of its length. Each of the 24 cables joins the rims of two caps, at the
    sides that face each other. The payload is a solid ball of `payload_mass` kg, with a radius of 8 % of a rod's
    length. Two cables run from the ends of each rod to the point of the payload that faces this rod. The distance
    between parallel rods is that at which the payload's cables have half the tension of the others. Nodes 0 to 11 are
    the rods' ends, in the order of `icosahedron`. Only the caps touch the ground. Raises `InputError` for sizes or
    masses that are not positive.
    """
    check_positive(payload_mass=payload_mass)
    return _six_rods(strut_length, rod_mass, cap_mass, (0.0, CAP), (0.0, CAP), payload_mass)


def superball(strut_length: float = 1.7, rod_mass: float = 1.0, cap_mass: float = 1.25) -> RobotGeometry:
    """Six rods that carry a motor with a spool for each of 24 cables, as on NASA's SUPERball v2.

    The idea, a motor at one end of each cable, is that of Vespignani, Friesen, SunSpiral and Bruce 2018, "Design of
    SUPERball v2, a compliant tensegrity robot for absorbing large impacts". Rods of 1.7 m are those of the model in
    Rible.jl, and the whole mass of 21 kg is that of the model in NASA's NTRT. We chose the rest. A thin rod of
    `rod_mass` kg has two solid balls of `cap_mass` kg as ends, motors included, with a radius of 3 % of its length.
    Spools are 10 % of the length from the ends, and their cables leave one ball's radius beside the axis. The other end
    of each cable is in the middle of a ball. The distance between parallel rods is that at which all cables have the
    same tension. Nodes 0 to 11 are the rods' ends, in the order of `icosahedron`, and each cable begins at its spool.
    Only the balls touch the ground. Raises `InputError` for sizes or masses that are not positive.
    """
    return _six_rods(strut_length, rod_mass, cap_mass, (SPOOL, CAP), (0.0, 0.0))


def quadruped(
    vertebrae: int = 3, width: float = 0.2, vertebra_mass: float = 0.2, leg_mass: float = 0.1
) -> RobotGeometry:
    """A tetrahedral spine along x, whose first and last vertebra stand on two stiff legs each.

    The idea is that of Laika (Sabelhaus et al. 2018, "Design, simulation, and testing of a flexible actuated spine for
    quadruped robots"). Its rotating vertebra is left out, and we chose sizes and masses. Vertebrae and cables are those
    of `tetrahedral_spine`, along x. A vertebra is `width` m wide and long: four thin rods from its middle to its
    corners, of together `vertebra_mass` kg. Legs are vertical thin rods of `leg_mass` kg and `width` m, from the
    lateral corners down. They end in feet, balls without mass whose radius is 5 % of the width. Only the feet touch the
    ground. Nodes 4k to 4k + 3 belong to vertebra k, and the last four are the feet. Raises `InputError` for fewer than
    two vertebrae, and for sizes or masses that are not positive.
    """
    at_least("vertebrae", vertebrae, 2)
    check_positive(width=width, vertebra_mass=vertebra_mass, leg_mass=leg_mass)
    upright, _, cables = tetrahedral_spine(vertebrae, width, width, width * 2 / 3)
    corners = upright[:, ::-1]
    sides = [2, 3, 4 * vertebrae - 2, 4 * vertebrae - 1]
    feet = corners[sides] - np.array([0, 0, width])
    nodes = np.concatenate([corners, feet])
    bodies = []
    for k in range(vertebrae):
        own = list(range(4 * k, 4 * k + 4))
        middle = nodes[own].mean(0)
        legs = [(side, len(corners) + j) for j, side in enumerate(sides) if side in own]
        rods = [(middle, nodes[i], vertebra_mass / 4) for i in own]
        rods += [(nodes[i], nodes[j], leg_mass) for i, j in legs]
        bodies.append(_body(nodes, [*own, *(foot for _, foot in legs)], rods))
    balls = Balls(tuple(range(len(corners), len(nodes))), np.full(4, FOOT * width))
    return RobotGeometry(nodes, (), cables, tuple(bodies), balls)


def _six_rods(
    length: float, rod_mass: float, cap_mass: float, start: Fixing, stop: Fixing, payload_mass: float = 0.0
) -> RobotGeometry:
    """The robot of six rods, whose cables are fixed to it as `start` and `stop` say."""
    check_positive(strut_length=length, rod_mass=rod_mass, cap_mass=cap_mass)
    pairs, ends, places = _balanced(start, stop, PULL if payload_mass else 0.0)
    nodes, cables, points = list(ends), [], [[2 * rod, 2 * rod + 1] for rod in range(6)]
    for pair, there in zip(pairs, places):
        cable = list(pair)
        for k, (_, beside) in enumerate((start, stop)):
            if beside:
                points[pair[k] // 2].append(len(nodes))
                cable[k] = len(nodes)
                nodes.append(there[k])
        cables.append((cable[0], cable[1]))
    if payload_mass:
        cables += [(i, len(nodes) + i // 2) for i in range(12)]
        points.append(list(range(len(nodes), len(nodes) + 6)))
        nodes += list(_facing(ends))
    x = np.array(nodes) * length
    rods = [(x[i], x[i + 1], rod_mass) for i in range(0, 12, 2)]
    bodies = [
        _body(x, own, [rod], [(end, cap_mass, CAP * length) for end in rod[:2]]) for own, rod in zip(points, rods)
    ]
    if payload_mass:
        bodies.append(_body(x, points[-1], [], [(np.zeros(3), payload_mass, PAYLOAD * length)]))
    return RobotGeometry(x, (), tuple(cables), tuple(bodies), Balls(tuple(range(12)), np.full(12, CAP * length)))


def _balanced(start: Fixing, stop: Fixing, pull: float) -> tuple[Edges, np.ndarray, np.ndarray]:
    """The pairs of ends that cables join, the ends, and both places of each cable (24, 2, 3), in lengths of a rod.

    By symmetry one force remains on each rod: the one away from the middle. The distance between parallel rods makes it
    zero if all cables have the tension 1, and those of the payload `pull`.
    """
    pattern, _, pairs = icosahedron()
    # each cable runs from a rod along x to one along z, from there to one along y, and from there to one along x
    pairs = tuple((i, j) if (i // 4 - j // 4) % 3 == 1 else (j, i) for i, j in pairs)
    first = np.array(pairs) < 2

    def placed(apart: float) -> tuple[np.ndarray, np.ndarray]:
        ends = pattern * np.where(np.abs(pattern) < 0.3, 2 * apart, 1)
        return ends, np.array([[_place(ends, i, j, start), _place(ends, j, i, stop)] for i, j in pairs])

    def outward(apart: float) -> float:
        ends, places = placed(apart)
        along, hung = places[:, 1] - places[:, 0], _facing(ends)[0] - ends[0]
        y = along[:, 1] / np.linalg.norm(along, axis=1)
        return y[first[:, 0]].sum() - y[first[:, 1]].sum() + 2 * pull * hung[1] / np.linalg.norm(hung)

    return (pairs, *placed(scipy.optimize.brentq(outward, 0.3, 0.7)))


def _facing(ends: np.ndarray) -> np.ndarray:
    """The points of the payload (6, 3) that face the rods."""
    middle = ends.reshape(6, 2, 3).mean(1)
    return PAYLOAD * middle / np.linalg.norm(middle, axis=1, keepdims=True)


def _place(ends: np.ndarray, i: int, j: int, fixing: Fixing) -> np.ndarray:
    """Where a cable to end j is fixed near end i."""
    inward, beside = fixing
    axis = np.eye(3)[i // 4]
    side = (ends[j] - ends[i]) * (1 - axis)
    return ends[i] * (1 - 2 * inward * axis) + beside * side / np.linalg.norm(side)


def _body(nodes: np.ndarray, points: Iterable[int], rods: Sequence[tuple], balls: Sequence[tuple] = ()) -> Body:
    """The body of thin rods (start, end, mass) and solid balls (centre, mass, radius)."""
    one = np.eye(3)
    parts = [(m, (a + b) / 2, m / 12 * ((b - a) @ (b - a) * one - np.outer(b - a, b - a))) for a, b, m in rods]
    parts += [(m, centre, 2 / 5 * m * radius**2 * one) for centre, m, radius in balls]
    mass = sum(m for m, _, _ in parts)
    middle = sum(m * centre for m, centre, _ in parts) / mass
    arms = [(m, centre - middle) for m, centre, _ in parts]
    inertia = sum(own for _, _, own in parts) + sum(m * (r @ r * one - np.outer(r, r)) for m, r in arms)
    return rigid_body(nodes, tuple(points), mass, inertia, middle)
