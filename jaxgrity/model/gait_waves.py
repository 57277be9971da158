"""Waves of actuation: gaits that the rotations of a structure map on themselves, but for a shift of time.

Let a rotation g take actuator k to g(k). A gait whose phases have p_g(k) = p_k + s(g) for all k is mapped by g on
itself at another time. If that holds for all rotations, rotations map faces on faces with the same gait at another
moment. On a face about whose axis the structure turns into itself, members are then not all in step. The shifts s are a
homomorphism from the rotations to the circle: a character.
"""

from collections.abc import Sequence
from fractions import Fraction
from itertools import product
from typing import NamedTuple

from jaxgrity.core.typed import typed
from jaxgrity.model.structure import Structure
from jaxgrity.model.symmetry import gene_permutations, symmetries

Places = tuple[int, ...]
"""For each actuator, the place to which a rotation takes it."""


class TravellingWave(NamedTuple):
    """Which actuators follow each other, and when."""

    groups: tuple[int, ...]
    """(actuators,), the number of the group that each belongs to"""
    shifts: tuple[float, ...]
    """(actuators,), turns, in [0, 1), by which its phase is ahead of the first one's of its group"""


@typed
def travelling_waves(
    structure: Structure, members: tuple[int, ...], *, one_axis: bool = False
) -> tuple[TravellingWave, ...]:
    """The waves in which a structure's rotations have a gait's actuators follow each other.

    Where no wave suits all rotations, it is those about one axis, the first that has as many as any other. Waves that
    leave all members in step are left out: a robot on a face about whose axis they rotate could only bounce.

    Args:
        structure: nodes and members; its start decides the rotations.
        members: those that the gait actuates, in its order.
        one_axis: whether only rotations about one axis have to map the gait on itself. That leaves more groups, and a
            lag between them, with which a path may turn that a mirror image of the gait would keep straight.

    Returns:
        The waves, all with the same groups; none where the structure has no rotation that they could follow.

    Raises:
        InputError: positions do not decide the rotations (see `symmetries`).

    Example:
        >>> scene = jaxgrity.load_scene("reference")
        >>> waves = jaxgrity.model.travelling_waves(scene.structure, scene.gait.members)
        >>> [[round(3 * shift) for shift in wave.shifts] for wave in waves]  # in thirds of a period
        [[0, 0, 2, 2, 1, 1], [0, 0, 1, 1, 2, 2]]
    """
    rotations = symmetries(structure, mirrors=False)
    # gene_permutations has where values come from, which is the inverse rotation; all inverses are there too
    places = [found[0] for rotation in rotations if (found := gene_permutations(members, (rotation,)))]
    about_one_axis = sorted(((place,) for place in dict.fromkeys(places)), key=lambda p: -_order(p[0]))
    for generators in about_one_axis if one_axis else (_generators(places), *about_one_axis):
        waves = _waves(generators, len(members))
        if waves:
            return waves
    return ()


def _waves(generators: Sequence[Places], count: int) -> tuple[TravellingWave, ...]:
    """Those whose shifts are not all 0."""
    turns = [[Fraction(k, _order(each)) for k in range(_order(each))] for each in generators]
    found = (_wave(generators, shifts, count) for shifts in product(*turns) if any(shifts))
    return tuple(dict.fromkeys(wave for wave in found if wave is not None and any(wave.shifts)))


def _wave(generators: Sequence[Places], shifts: Sequence[Fraction], count: int) -> TravellingWave | None:
    """The phases that follow when each of the generators shifts them by so many turns; None where they contradict."""
    group, phase = [-1] * count, [Fraction(0)] * count
    for first in range(count):
        if group[first] >= 0:
            continue
        group[first], reached = first, [first]
        for k in reached:
            for places, shift in zip(generators, shifts):
                following, turn = places[k], (phase[k] + shift) % 1
                if group[following] < 0:
                    group[following], phase[following] = first, turn
                    reached.append(following)
                elif phase[following] != turn:
                    return None
    numbers = {first: number for number, first in enumerate(dict.fromkeys(group))}
    return TravellingWave(tuple(numbers[first] for first in group), tuple(float(turn) for turn in phase))


def _generators(elements: Sequence[Places]) -> list[Places]:
    """Few of the permutations of a group from which all the others follow."""
    found: list[Places] = []
    reached = {tuple(range(len(elements[0])))} if elements else set()
    for element in elements:
        if element in reached:
            continue
        found.append(element)
        new = list(reached)
        for known in new:
            for generator in found:
                following = tuple(generator[k] for k in known)
                if following not in reached:
                    reached.add(following)
                    new.append(following)
    return found


def _order(places: Places) -> int:
    """How often a permutation has to be applied until everything is in its place."""
    current, count = places, 1
    while current != tuple(range(len(places))):
        current, count = tuple(places[k] for k in current), count + 1
    return count
