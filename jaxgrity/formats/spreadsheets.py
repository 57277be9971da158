"""Structures as two tables (CSV), for spreadsheets and pandas: nodes, and members."""

import csv
import io
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray
from jaxgrity.formats.foreign import (
    MOST_NODES,
    STRUCTURE_ALONE,
    Imported,
    finite,
    not_negative,
    positive,
    read_limited,
    refuse_bodies,
    short,
)
from jaxgrity.formats.matlab import beside_the_structure
from jaxgrity.io.files import write_whole
from jaxgrity.model.scene import Scene
from jaxgrity.model.structure import Members, Structure, check_edges

NODES = ("x_m", "y_m", "z_m", "mass_kg", "fixed")
"""Columns of the table of nodes, with their units."""
MEMBERS = ("kind", "first", "second", "rest_length_m", "stiffness_N_per_m", "damping_N_s_per_m", "mass_kg")
"""Columns of the table of members, with their units."""
KINDS = ("strut", "cable")
"""Kinds of members."""
OF_A_ROW = re.compile(r"^structure\.(struts|cables|node_mass)\[(\d+)\]")
"""A part in messages of structures that has a line in a table."""


def table_paths(path: str | Path) -> tuple[Path, Path]:
    """The two files that `robot.csv`, or either of them, stands for: robot.nodes.csv and robot.members.csv."""
    path = Path(path)
    stem = path.name.removesuffix(".csv").removesuffix(".nodes").removesuffix(".members")
    return path.with_name(f"{stem}.nodes.csv"), path.with_name(f"{stem}.members.csv")


@typed
def save_tables(scene: Scene, path: str | Path) -> tuple[str, ...]:
    """Write a structure as two tables beside each other, every number to the last bit.

    `robot.nodes.csv` has a row for each node: x_m, y_m, z_m, mass_kg, and in `fixed` the axes along which it does not
    move. `robot.members.csv` has a row for each member, struts first: kind, the nodes that it joins (from 0),
    rest_length_m, stiffness_N_per_m (empty: rigid), damping_N_s_per_m and mass_kg.

    Returns sentences on what they do not hold.
    """
    structure, held = scene.structure, dict(scene.structure.fixed)
    refuse_bodies(structure, "tables")
    x, mass = np.asarray(structure.nodes, float), np.asarray(structure.node_mass, float)
    nodes = [[*map(repr, row), repr(m), held.get(k, "")] for k, (row, m) in enumerate(zip(x.tolist(), mass.tolist()))]
    rows = []
    for name, members, _ in structure.numbered:
        columns = members.rest_length, members.stiffness, members.damping, members.mass
        for k, edge in enumerate(members.edges):
            rows.append([name.removesuffix("s"), *map(str, edge), *(cell(column, k) for column in columns)])
    for place, head, content in zip(table_paths(path), (NODES, MEMBERS), (nodes, rows)):
        save_rows(place, head, content)
    return beside_the_structure(scene)


def save_rows(path: Path, head: Sequence[str], rows: Iterable[Sequence[str | float]]) -> None:
    """Write a table (CSV), which appears whole or not at all."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([head, *rows])
    write_whole(path, lambda file: file.write(text.getvalue().encode()))


def cell(column: AnyArray | None, k: int) -> str:
    """A member's number to the last bit; empty where its kind has none."""
    return "" if column is None else repr(float(column[k]))


@typed
def read_tables(path: str | Path, columns: Mapping[str, str] | None = None) -> Imported:
    """A structure from the two tables that `save_tables` writes; columns may be in any order.

    mass_kg, fixed, damping_N_s_per_m and mass_kg of members may be left out.

    Args:
        path: of the tables, `robot.csv` or the name of either file.
        columns: what your own names of columns mean, such as {"X": "x_m"}. "" leaves a column out. Units are those of
            `save_tables`.

    Raises:
        InputError: one line with the file, the row and what was expected.
    """
    first, second = table_paths(path)
    names = dict(columns or {})
    for name, meant in names.items():
        if meant not in ("", *NODES, *MEMBERS):
            raise InputError(f"columns[{name!r}] = {meant!r}: expected '', or one of {', '.join((*NODES, *MEMBERS))}")
    unused = set(names)
    nodes = _rows(first, NODES, ("x_m", "y_m", "z_m"), names, unused)
    if not nodes or len(nodes) > MOST_NODES:
        raise InputError(f"{first}: has {len(nodes)} nodes; expected 1 to {MOST_NODES}")
    x = np.array([[finite(row[axis], f"{where}.{axis}") for axis in NODES[:3]] for where, row in nodes])
    mass = np.array([not_negative(row.get("mass_kg") or 0, f"{where}.mass_kg") for where, row in nodes])
    fixed = tuple((k, axes) for k, (where, row) in enumerate(nodes) if (axes := _axes(row.get("fixed", ""), where)))
    kinds: dict[str, list] = {kind: [] for kind in KINDS}
    members = _rows(second, MEMBERS, MEMBERS[:4], names, unused)
    if unused:
        raise InputError(f"columns: neither {first.name} nor {second.name} has a column {sorted(unused)[0]!r}")
    for where, row in members:
        if row["kind"] not in kinds:
            raise InputError(f"{where}.kind = {short(row['kind'])}: expected strut or cable")
        kinds[row["kind"]].append((where, row))
    try:
        struts, cables = (_members(kinds[kind], kind) for kind in KINDS)
        check_edges(x, () if struts is None else struts.edges, () if cables is None else cables.edges)
        structure = Structure(x, mass, struts, cables, fixed=fixed)
    except InputError as error:
        rows = {"struts": kinds["strut"], "cables": kinds["cable"], "node_mass": nodes}
        message = OF_A_ROW.sub(lambda part: rows[part[1]][int(part[2])][0], str(error))
        known = message.startswith((f"{first}: ", f"{second}: "))
        raise InputError(message if known else f"{second}: {message}") from error
    return Imported(Scene(structure), ("SI units, z up; nodes count from 0", STRUCTURE_ALONE))


def _rows(
    path: Path, known: Sequence[str], needed: Sequence[str], names: Mapping[str, str], unused: set[str]
) -> list[tuple[str, dict[str, str]]]:
    """Where each row stands, and its cells by the names of their columns. Takes those that occur from `unused`."""
    try:
        table = list(csv.reader(io.StringIO(read_limited(path)), strict=True))
    except csv.Error as error:
        raise InputError(f"{path}: not CSV: {error}") from error
    head = [name.strip() for name in table[0]] if table else []
    unused.difference_update(head)
    head = [names.get(name, name) for name in head]
    for name in head:
        if (name or "" not in names.values()) and (name not in known or head.count(name) > 1):
            raise InputError(
                f"{path}: has a column {short(name)}; expected {', '.join(known)}, each once, or other names in columns"
            )
    missing = [name for name in needed if name not in head]
    if missing:
        raise InputError(f"{path}: has no column {missing[0]}; expected {', '.join(known)}")
    found = []
    for number, row in enumerate(table[1:], start=2):
        if row and len(row) != len(head):
            raise InputError(f"{path}: line {number} has {len(row)} cells; expected {len(head)}")
        if row:
            found.append((f"{path}: line {number}", dict(zip(head, row))))
    return found


def _members(rows: list[tuple[str, dict[str, str]]], kind: str) -> Members | None:
    if not rows:
        return None
    edges = tuple((_node(row["first"], where), _node(row["second"], where)) for where, row in rows)
    rest = np.array([positive(row["rest_length_m"], f"{where}.rest_length_m") for where, row in rows])
    rigid = [not row.get("stiffness_N_per_m", "").strip() for _, row in rows]
    if any(rigid) and (kind == "cable" or not all(rigid)):
        where = rows[rigid.index(True)][0]
        raise InputError(f"{where}.stiffness_N_per_m: missing; expected one for each cable, and for all struts or none")
    stiffness = None if rigid[0] else _column(rows, "stiffness_N_per_m")
    damping, mass = (_column(rows, name) for name in ("damping_N_s_per_m", "mass_kg"))
    if rigid[0] and damping.any():
        raise InputError("rigid struts have no damping; expected none")
    return Members(
        edges, stiffness, rest, damping=damping if damping.any() else None, mass=mass if mass.any() else None
    )


def _column(rows: list[tuple[str, dict[str, str]]], name: str) -> np.ndarray:
    return np.array([not_negative(row.get(name) or 0, f"{where}.{name}") for where, row in rows])


def _axes(text: str, where: str) -> str:
    if not set(axes := text.strip()) <= set("xyz"):
        raise InputError(f"{where}.fixed = {short(text)}: expected some of x, y and z, or nothing")
    return axes


def _node(text: str, where: str) -> int:
    if not text.strip().isdecimal() or len(text) > 9:
        raise InputError(f"{where} joins {short(text)}; expected the number of a node, from 0")
    return int(text)
