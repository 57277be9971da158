"""NTRT's structure files put together: nodes, pairs, builders, and substructures with their bonds."""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from jaxgrity.core.errors import InputError
from jaxgrity.formats.foreign import MOST_NODES, finite, numbers, read_limited, short
from jaxgrity.formats.ntrt_builders import NTRT_BUILDERS, RIGID_BUILDERS, Builder, builder_of, read_builder
from jaxgrity.formats.yaml_text import parse_yaml, with_line

KEYS = ("nodes", "pair_groups", "builders", "substructures", "bond_groups")
"""Keys of a structure file."""
CHILD_KEYS = ("path", "rotation", "translation", "scale", "offset")
"""Keys of a structure within another one."""
MOST_FILES = 300
"""Most files read for one structure. A file that is read twice counts twice."""
DEEPEST = 20
"""Most levels of substructures within each other."""


@dataclass
class Pair:
    """Two nodes, and the tags by which a builder makes a rod or a string of them."""

    first: int
    second: int
    tags: frozenset[str]

    def joins(self, i: int, j: int) -> bool:
        return {self.first, self.second} == {i, j}


@dataclass
class Part:
    """A structure or a substructure; nodes by their numbers in the assembly."""

    tags: frozenset[str] = frozenset()
    """its own name: builders for it are for all within it"""
    nodes: dict[str, int] = field(default_factory=dict)
    children: "dict[str, Part]" = field(default_factory=dict)
    pairs: list[Pair] = field(default_factory=list)

    def parts(self) -> "Iterator[Part]":
        """This one and those within it, level by level."""
        queue = deque([self])
        while queue:
            part = queue.popleft()
            yield part
            queue.extend(part.children.values())

    def numbers(self) -> list[int]:
        """Of all nodes within it."""
        return [node for part in self.parts() for node in part.nodes.values()]

    def find_child(self, name: str, where: str) -> "Part":
        """The first substructure of that name, level by level; `a.b` is b within a."""
        found = self
        for step in name.split("."):
            child = next((each for part in found.parts() if (each := _named(part.children, step)) is not None), None)
            if child is None:
                raise InputError(f"{where}: there is no substructure {short(name)}")
            found = child
        return found

    def find_node(self, name: str, where: str) -> int:
        """The number of the first node of that name, level by level; `a.b` is node b within a."""
        inside, _, last = name.rpartition(".")
        place = self.find_child(inside, where) if inside else self
        node = next((each for part in place.parts() if (each := _named(part.nodes, last)) is not None), None)
        if node is None:
            raise InputError(f"{where}: there is no node {short(name)}")
        return node


@dataclass
class Assembly:
    """What is put together: all nodes, and the builders, of which the last that matches is taken."""

    x: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    """(nodes, 3), in the file's unit, y up"""
    builders: list[Builder] = field(default_factory=lambda: list(NTRT_BUILDERS))
    files: int = 0
    notes: list[str] = field(default_factory=list)

    def read(self, path: Path, above: tuple[Path, ...] = ()) -> Part:
        """The structure of a file and of the files that it names. Raises `InputError`, beginning with the file."""
        here = path.resolve()
        self.files += 1
        if here in above:
            raise InputError(f"{path}: is a substructure of itself; expected files that name each other in no circle")
        if len(above) > DEEPEST or self.files > MOST_FILES:
            raise InputError(f"{path}: expected at most {DEEPEST} levels of substructures, {MOST_FILES} in all")
        lines: dict[str, int] = {}
        try:
            text = parse_yaml(read_limited(path))
            lines, root = text.lines, table(text.value, "the file", KEYS)
            part = Part()
            self._add_children(part, table(root.get("substructures"), "substructures"), path, (*above, here))
            self._add_builders(table(root.get("builders"), "builders"))
            self._add_nodes(part, table(root.get("nodes"), "nodes"))
            for tags, pairs in table(root.get("pair_groups"), "pair_groups").items():
                part.pairs += self._pairs(part, part, frozenset(tags.split()), pairs, f"pair_groups.{tags}")
            for group in _bond_groups(table(root.get("bond_groups"), "bond_groups")):
                self._add_bonds(part, *group)
        except InputError as error:
            if str(error).startswith(f"{path}: "):
                raise
            raise InputError(f"{path}: {with_line(str(error), lines)}") from error
        return part

    def _add_builders(self, builders: dict[str, Any]) -> None:
        for tags, value in builders.items():
            given = table(value, f"builders.{tags}", ("class", "parameters"))
            parameters = table(given.get("parameters"), f"builders.{tags}.parameters")
            builder = read_builder(tags, given, parameters)
            self.builders = [each for each in self.builders if each != builder] + [builder]

    def _add_nodes(self, part: Part, nodes: dict[str, Any]) -> None:
        if len(self.x) + len(nodes) > MOST_NODES:
            raise InputError(f"nodes: more than {MOST_NODES} in all")
        rows = [numbers(xyz, 3, f"nodes.{name}") for name, xyz in nodes.items()]
        part.nodes = {name: len(self.x) + k for k, name in enumerate(nodes)}
        self.x = np.concatenate([self.x, np.reshape(rows, (-1, 3))])

    def _add_children(self, part: Part, children: dict[str, Any], path: Path, above: tuple[Path, ...]) -> None:
        """Read them, then turn all, then scale, offset and move each, as NTRT does."""
        tables = {name: table(given, f"substructures.{name}", CHILD_KEYS) for name, given in children.items()}
        for names, given in tables.items():
            for name in names.split("/") if "path" in given else []:
                part.children[name] = self.read(self._file(path, str(given["path"]), names), above)
                part.children[name].tags = frozenset(name.split())
        for names, given in tables.items():
            for name in names.split("/"):
                nodes = part.find_child(name, f"substructures.{names}").numbers()
                self._turn(nodes, given.get("rotation"), f"substructures.{names}.rotation")
        for names, given in tables.items():
            for order, name in enumerate(names.split("/")):
                where = f"substructures.{names}"
                nodes = part.find_child(name, where).numbers()
                if "scale" in given and nodes:
                    centre = self.x[nodes].mean(0)
                    self.x[nodes] = centre + finite(given["scale"], f"{where}.scale") * (self.x[nodes] - centre)
                for key, times in (("offset", order), ("translation", 1)):
                    if key in given:
                        self.x[nodes] += times * np.array(numbers(given[key], 3, f"{where}.{key}"))

    def _file(self, path: Path, named: str, child: str) -> Path:
        """Where a substructure's file is: as seen from the file that names it, or beside that file."""
        found = path.parent / named
        beside = path.parent / Path(named).name
        if not found.is_file() and beside.is_file():
            self.notes.append(f"{named} is not there; {beside.name}, beside the file, was taken for it")
            return beside
        if not found.is_file():
            raise InputError(f"substructures.{child}.path = {short(named)}: there is no such file")
        return found

    def _turn(self, nodes: list[int], given: Any, where: str) -> None:
        if given is None or not nodes:
            return
        rotation = table(given, where, ("axis", "angle", "reference"))
        if "axis" not in rotation or "angle" not in rotation:
            return  # which NTRT leaves as it is, too
        axis = np.array(numbers(rotation["axis"], 3, f"{where}.axis"))
        if not np.linalg.norm(axis) > 0:
            raise InputError(f"{where}.axis = {short(rotation['axis'])}: expected a direction")
        angle = np.deg2rad(finite(rotation["angle"], f"{where}.angle"))
        given_centre = rotation.get("reference")
        centre = (
            self.x[nodes].mean(0) if given_centre is None else np.array(numbers(given_centre, 3, f"{where}.reference"))
        )
        self._rotate(nodes, Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)), centre)

    def _rotate(self, nodes: list[int], rotation: Rotation, centre: np.ndarray) -> None:
        self.x[nodes] = centre + rotation.apply(self.x[nodes] - centre)

    def _pairs(self, first: Part, second: Part, tags: frozenset[str], pairs: Any, where: str) -> list[Pair]:
        return [
            Pair(first.find_node(a, f"{where}[{k}]"), second.find_node(b, f"{where}[{k}]"), tags)
            for k, (a, b) in enumerate(names(pairs, where))
        ]

    def _add_bonds(self, part: Part, bonds: str, tags: str, pairs: Any, where: str) -> None:
        """Pairs of nodes of two substructures have their names as tags too."""
        *children, kind = bonds.split("/")
        if len(children) < 2 or kind not in ("node_node", "node_edge"):
            raise InputError(f"{where}: expected two or more substructures, and node_node or node_edge")
        for one, other in pairwise(children):
            first, second, own = part.find_child(one, where), part.find_child(other, where), frozenset(tags.split())
            if kind == "node_node":
                named = own | {*one.split(), *other.split(), *f"{one}/{other}".split()}
                part.pairs += self._pairs(first, second, named, pairs, where)
            else:
                part.pairs += self._join_edges((first, second), own, names(pairs, where), where)

    def _join_edges(
        self, parts: tuple[Part, Part], tags: frozenset[str], pairs: list[tuple[str, str]], where: str
    ) -> list[Pair]:
        """Move the second part so that nodes meet the middles of edges; each edge then goes by way of its node."""
        if len(pairs) < 3:
            raise InputError(f"{where}: has {len(pairs)} bonds; expected at least 3")
        joints: list[tuple[int, int, int]] = []
        points: list[list[np.ndarray]] = [[], []]
        for pair in pairs:
            found = [[p.find_node(n, where) for n in end.split("/")] for p, end in zip(parts, pair, strict=True)]
            if sorted(map(len, found)) != [1, 2]:
                raise InputError(f"{where}: {list(pair)} are no node and an edge (node/node)")
            for side, ends in zip(points, found):
                side.append(self.x[ends].mean(0))
            (node,), (a, b) = sorted(found, key=len)
            joints.append((node, a, b))
        self._dock(parts[1].numbers(), np.array(points[0]), np.array(points[1]), where)
        ends = [node for node, _, _ in joints]
        for part in (p for whole in parts for p in whole.parts()):
            part.pairs = [pair for pair in part.pairs if not self._replaced(pair, joints, ends, where)]
        return [Pair(*way, tags) for node, a, b in joints for way in ((a, node), (node, b))]

    def _replaced(self, pair: Pair, joints: list[tuple[int, int, int]], ends: list[int], where: str) -> bool:
        edge = any(pair.joins(a, b) for _, a, b in joints)
        rod = builder_of(self.builders, pair.tags, frozenset(), (*RIGID_BUILDERS, "tgSphereInfo")) is not None
        if edge and rod:
            raise InputError(f"{where}: an edge is a rod; expected strings")
        return edge or (not rod and pair.first in ends and pair.second in ends)

    def _dock(self, nodes: list[int], target: np.ndarray, own: np.ndarray, where: str) -> None:
        """Turn and move `nodes` so that the plane of the points `own` meets that of `target`, and the first points."""
        normals = [np.cross(p[1] - p[0], p[2] - p[0]) for p in (target, own)]
        if min(np.linalg.norm(n) for n in normals) < 1e-9:
            raise InputError(f"{where}: the first three bonds lie on a line; expected a triangle")
        centre, goal = own.mean(0), target.mean(0)
        turn = shortest_rotation(normals[1], normals[0], own[1] - own[0])
        self._rotate(nodes, turn, centre)
        self.x[nodes] += goal - centre
        arm = turn.apply(own[0] - centre)
        self._rotate(nodes, shortest_rotation(arm, target[0] - goal, normals[0]), goal)


def shortest_rotation(start: np.ndarray, end: np.ndarray, fallback: np.ndarray) -> Rotation:
    """That which turns one direction into another; about `fallback` by 180 degrees where they are opposite."""
    a, b = (v / max(np.linalg.norm(v), 1e-300) for v in (start, end))
    axis = np.cross(a, b)
    if np.linalg.norm(axis) > 1e-9:
        return Rotation.from_rotvec(axis / np.linalg.norm(axis) * np.arctan2(np.linalg.norm(axis), a @ b))
    if a @ b >= 0:
        return Rotation.identity()
    return Rotation.from_rotvec(np.pi * fallback / np.linalg.norm(fallback))


def _named(found: dict[str, Any], name: str) -> Any:
    """What has this name, or else the first that has all of its words: names are tags. None where nothing has."""
    if name in found:
        return found[name]
    return next((each for key, each in found.items() if set(name.split()) <= set(key.split())), None)


def table(value: Any, where: str, known: tuple[str, ...] | None = None) -> dict[str, Any]:
    """A table of a YAML file; an empty one where nothing is given. Raises `InputError` where it is something else."""
    if value in (None, ""):
        return {}
    if not isinstance(value, dict) or not all(isinstance(key, str) for key in value):
        raise InputError(f"{where} = {short(value)}: expected a table")
    for key in value:
        if known is not None and key not in known:
            raise InputError(f"{where} has {short(key)}; expected one of {', '.join(known)}")
    return value


def names(value: Any, where: str) -> list[tuple[str, str]]:
    """A list of pairs of names. Raises `InputError` where it is something else."""
    if value in (None, ""):
        return []
    if not isinstance(value, list):
        raise InputError(f"{where} = {short(value)}: expected a list of pairs of names")
    for k, pair in enumerate(value):
        if not (isinstance(pair, list) and len(pair) == 2 and all(isinstance(name, str) for name in pair)):
            raise InputError(f"{where}[{k}] = {short(pair)}: expected two names")
    return [(pair[0], pair[1]) for pair in value]


def _bond_groups(groups: dict[str, Any]) -> Iterator[tuple[str, str, Any, str]]:
    """Bonds, tags, pairs and their place; tags may stand above bonds, or below them."""
    for outer, inside in groups.items():
        for inner, pairs in table(inside, f"bond_groups.{outer}").items():
            where = f"bond_groups.{outer}.{inner}"
            if ("/" in outer) == ("/" in inner):
                raise InputError(f"{where}: expected a tag and a bond (a/b/node_node)")
            yield (outer, inner, pairs, where) if "/" in outer else (inner, outer, pairs, where)
