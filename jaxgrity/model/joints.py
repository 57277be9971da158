"""Bodies that share nodes: which of these are basic points of which body, and which are pinned."""

import itertools
from collections import Counter
from collections.abc import Callable, Sequence

from jaxgrity.core.errors import InputError
from jaxgrity.core.types import Supports
from jaxgrity.model.bodies import Bodies, Body, Joints


def joined_bodies(points: Sequence[Sequence[int]], fixed: Supports, make: Callable[[int, Joints], Body]) -> Bodies:
    """Bodies with these points, some of them fixed, made by `make(number, basic)`, as `rigid_body` takes `basic`.

    Those with most joints are made first: what is pinned to them becomes basic in others.
    """
    count, axes = Counter(k for own in points for k in own), dict(fixed)
    still = {k for k, held in axes.items() if len(held) == 3}
    joints = [[k for k in own if count[k] > 1 or k in axes] for own in points]
    pairs = Counter(pair for own in joints for pair in itertools.combinations(sorted(own), 2))
    hinges = tuple(pair for pair, bodies in pairs.items() if bodies > 1 or set(pair) <= still)
    made, first = dict[int, Body](), {*axes} - still  # without a mass of their own, they have to be basic points
    for number in sorted(range(len(points)), key=lambda k: -len(joints[k])):
        own = sorted(joints[number], key=lambda k: k not in first)
        made[number] = make(number, [*own, *(pair for pair in hinges if set(pair) <= set(own))])
        first |= {node for node, *_ in made[number].pinned}
    return tuple(made[number] for number in range(len(points)))


def check_bodies(bodies: Bodies, nodes: int, fixed: Supports) -> None:
    """Raises `InputError` for bodies with missing nodes, and for a carried point that is fixed or in another body.

    A node that is pinned to one body has to be fixed, or a basic point of another.
    """
    axes = dict(fixed)
    still = {k for k, held in axes.items() if len(held) == 3}
    joined, basic = Counter(k for body in bodies for k in body.points), {k for body in bodies for k in body.basic}
    for number, body in enumerate(bodies):
        if max(body.points) >= nodes:
            raise InputError(f"structure.bodies[{number}] has node {max(body.points)}; expected 0 to {nodes - 1}")
        if shared := sorted(k for k in body.carried if joined[k] > 1 or k in axes):
            raise InputError(
                f"structure.bodies[{number}]: node {shared[0]} is fixed, or a point of another body too, and follows "
                f"basic points here; expected rigid_body(..., basic=({shared[0]},))"
            )
        if loose := sorted({pin[0] for pin in body.pinned} - basic - still):
            raise InputError(
                f"structure.bodies[{number}]: node {loose[0]} is pinned, and is neither fixed along all axes nor a "
                "basic point of another body; expected it first in `basic` of another body"
            )
