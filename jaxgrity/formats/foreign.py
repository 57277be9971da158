"""What all readers and writers of other programs' files have in common."""

import math
import re
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.io.files import read_text
from jaxgrity.model.friction import ConeFriction
from jaxgrity.model.scene import Scene
from jaxgrity.model.structure import Structure

LARGEST_FILE = 4_000_000
"""Largest text file that is read, bytes: a file beyond it does not describe a robot."""
MOST_NODES = 10_000
"""Most nodes of a structure that is read: beyond it a file does not describe a robot."""
LARGEST_NUMBER = 1e30
"""Largest size of a number that is read: single precision holds none beyond 3e38, and a robot has none like it."""

OF_A_PART = re.compile(r"((?:dropped: )?(?:actuator|body|geom|site|tendon) )(\S+)(: .*)", re.DOTALL)
"""Notes on one part, which has a name."""
STRUCTURE_ALONE = "the file holds no gravity, ground or gait: the scene has none until you add them"
"""Note on what was read from formats that describe a structure alone."""


class Imported(NamedTuple):
    """What was read."""

    scene: Scene
    notes: tuple[str, ...]
    """sentences: units, what was taken how, what was left out"""


class Losses:
    """Notes on what is read how, and what the caller gives up of what a scene does not have.

    As the context of the reading it refuses at the end: so one message names all that would be lost.
    """

    def __init__(self, drop: Collection[str], droppable: Collection[str], notes: list[str]):
        """Raises `InputError` where `drop` has a name that is not among the `droppable`."""
        unknown = drop if isinstance(drop, str) else sorted(set(drop) - set(droppable))
        if unknown:
            raise InputError(f"drop = {unknown!r}: expected a list of some of {', '.join(droppable)}")
        self.drop = frozenset(drop)
        self.notes = notes
        self.refused: dict[str, str] = {}
        """what would be lost of each kind that the caller does not drop: the first of it"""

    def note(self, sentence: str) -> None:
        """Keep a sentence, once."""
        if sentence not in self.notes:
            self.notes.append(sentence)

    def lose(self, kind: str, what: str, place: str = "") -> None:
        """Refuse the file, with the place, unless the caller drops things of this kind; then a note says so."""
        if kind in self.drop:
            self.note(f"dropped: {what}")
        else:
            self.refused.setdefault(kind, what + place)

    def __enter__(self) -> "Losses":
        return self

    def __exit__(self, _: Any, error: BaseException | None, __: Any) -> None:
        """Raises `InputError` where something is refused, also in place of one that may follow from going on."""
        if self.refused and (error is None or isinstance(error, ValueError)):
            what = "; ".join([*self.refused.values()][:3]) + "; ..." * (len(self.refused) > 3)
            how = f"drop={[*self.refused]}, or --drop {' '.join(self.refused)}, reads the model without"
            if isinstance(error, InputError):  # dropping alone may not do
                how = f"and then: {error}"
            raise InputError(f"{what}, which would be lost; {how}") from error


def together(notes: Sequence[str]) -> tuple[str, ...]:
    """The notes, in which parts of one kind of which the same is said share one sentence, at the place of the first."""
    said: dict[tuple[str, str], list[str]] = {}
    for note in notes:
        found = OF_A_PART.fullmatch(note)
        kind, name, what = found.groups() if found else ("", "", note)
        said.setdefault((kind, what), []).append(name)
    more = [f" and {len(names) - 1} more" if len(names) > 1 else "" for names in said.values()]
    return tuple(f"{kind}{names[0]}{others}{what}" for ((kind, what), names), others in zip(said.items(), more))


def read_limited(path: str | Path) -> str:
    """The text of a file. Raises `InputError` where it cannot be read, or is larger than a robot can be."""
    size = Path(path).stat().st_size if Path(path).is_file() else 0
    if size > LARGEST_FILE:
        raise InputError(f"{path}: has {size} bytes; expected at most {LARGEST_FILE}")
    return read_text(path)


def refuse_bodies(structure: Structure, what: str) -> None:
    """Raises `InputError` where a structure has rigid bodies, which files of this kind cannot hold."""
    if structure.bodies:
        found = f"{what} hold no rigid bodies, and this has {len(structure.bodies)}"
        raise InputError(f"{found}; expected a scene file (.toml), or MuJoCo (.xml)")


def has_strength(structure: Structure) -> bool:
    """Whether it is known what members bear. Scene files alone can say so."""
    return any(m.yield_force is not None or m.bending_stiffness is not None for m in structure.members)


def finite(value: Any, where: str) -> float:
    """A number that a file gives as text. Raises `InputError` where it is none, or not finite."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise InputError(f"{where} = {short(value)}: expected a number") from None
    if not math.isfinite(number):
        raise InputError(f"{where} = {short(value)}: expected a finite number")
    if abs(number) > LARGEST_NUMBER:
        raise InputError(f"{where} = {short(value)}: expected a number of at most {LARGEST_NUMBER:g}")
    return number


def not_negative(value: Any, where: str) -> float:
    """Likewise, and 0 or more."""
    number = finite(value, where)
    if number < 0:
        raise InputError(f"{where} = {short(value)}: expected no negative number")
    return number


def positive(value: Any, where: str) -> float:
    """Likewise, and more than 0."""
    number = finite(value, where)
    if not number > 0:
        raise InputError(f"{where} = {short(value)}: expected a positive number")
    return number


def numbers(values: Any, count: int | None, where: str) -> list[float]:
    """A list of numbers. Raises `InputError` where it is none, or has another length than `count` (None: any)."""
    if not isinstance(values, Sequence) or isinstance(values, str) or count not in (None, len(values)):
        raise InputError(f"{where} = {short(values)}: expected a list of {'' if count is None else f'{count} '}numbers")
    return [finite(value, f"{where}[{k}]") for k, value in enumerate(values)]


def short(value: Any) -> str:
    """A value as errors show it."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def cone_of(each: np.ndarray) -> ConeFriction:
    """Friction with a coefficient for each node; with a single one where all are equal."""
    return ConeFriction(each[0] if np.all(each == each[0]) else each)


def some_of(names: Sequence[str]) -> str:
    """The first five names."""
    return ", ".join(names[:5]) + "..." * (len(names) > 5)


def add_element(parent: ElementTree.Element, tag: str, **given: Any) -> ElementTree.Element:
    """A new element of an XML file, numbers to the last bit."""
    return ElementTree.SubElement(parent, tag, {name: _attribute(value) for name, value in given.items()})


def _attribute(value: Any) -> str:
    if isinstance(value, str):
        return value
    return " ".join(
        repr(float(x)) if isinstance(x, float) else str(x) for x in np.atleast_1d(np.asarray(value)).tolist()
    )
