"""Recorded motions as tables (CSV or JSON): times, where nodes were seen, and commands of actuated members."""

import csv
import io
import json
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxgrity.core.arguments import check_each
from jaxgrity.core.display import in_digits
from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import NodeHistory, Times
from jaxgrity.identification.measurements import SCALE
from jaxgrity.io.files import read_text
from jaxgrity.model.actuation import Commands, rest_lengths_along
from jaxgrity.model.scene import Scene
from jaxgrity.model.structure import Structure, edge_lengths

COLUMN = re.compile(r"([xyz]|rest length |contraction )(0|[1-9]\d{0,8})")
"""A column's name: a coordinate, and the number of a node; or a command, and the number of a member."""
COLUMNS = "t, x0, y0, z0, ..., rest length 3 or contraction 3"
"""The columns that there are, for messages."""
ROD_END = re.compile(r"rod_(\w{1,20})_end_pt([12])")
"""The key of a rod's end in a frame of JSON: the name of the rod, and which end."""
FEWEST_FRAMES = 3
"""Fewest frames of a recording: a velocity is a difference of two, and another one is there to compare."""
STRETCH = 1.5
"""Largest ratio of a strut's recorded length to its rest length, or the other way: beyond it the unit or the numbers
of the nodes are others. Struts of the icosahedron are 1.6 times as long as its other distances."""
Table = Float[np.ndarray, "rows columns"]


class Recording(NamedTuple):
    """A recorded motion, from the first frame in which every node was seen."""

    times: Times
    """(frames,), s, on the clock of the scene's gait"""
    positions: NodeHistory
    """(frames, nodes, 3), m; NaN where a node was not seen"""
    commands: Commands | None = None
    """recorded commands; None: the scene's gait runs"""

    def part(self, frames: slice) -> "Recording":
        """Some of its frames, with all commands."""
        return Recording(self.times[frames], self.positions[frames], self.commands)

    def known(self, structure: Structure) -> Bool[np.ndarray, "frames nodes"]:
        """Whether a node was seen, or a support holds it."""
        return np.asarray((np.isfinite(self.positions) | ~structure.free).all(2))

    def filled(self, structure: Structure) -> Float[np.ndarray, "frames nodes 3"]:
        """(frames, nodes, 3), m: gaps filled along straight lines, and supports at their places."""
        flat = np.array(np.where(structure.free, self.positions, structure.nodes)).reshape(len(self.times), -1)
        for column in flat.T:
            seen = np.isfinite(column)
            column[:] = np.interp(self.times, self.times[seen], column[seen])
        return flat.reshape(self.positions.shape)


@typed
def read_recording(path: str | Path, scene: Scene, unit: float = 1.0) -> Recording:
    """A recorded motion of a scene's robot from a table: CSV with a header, or JSON (.json).

    Columns: `t` (s); `x0`, `y0`, `z0` (m) of node 0, and so on, z up, empty where a node was not seen; and commands
    of members, struts first, on straight lines between the rows: `rest length 3` (m), or `contraction 3`, a fraction
    of the member's rest length in the scene. Columns may be in any order. Supports may be left out. Frames before the
    first one in which every node was seen are left out.

    JSON is a list of frames, as Chen and others publish for their robots (`processed_data.json`). Each frame has a
    `time` (s), and of each rod both ends, such as `rod_01_end_pt1`: three coordinates, or null. The rods in the order
    of their numbers have the nodes 0 and 1, 2 and 3, and so on; rods with names come as in the first frame. Other keys
    are left out.

    Args:
        path: of the file.
        scene: the robot, whose nodes and members the columns number.
        unit: of all lengths in the file, m.

    Raises:
        InputError: one line with the file, the line or column, what it has, and what was expected.
    """
    check_each("unit", unit, shape=(), above=0.0, unit="m")
    clock, found, table, lines = _read(path, scene.structure)
    times, positions = table[:, clock], np.full((len(table), *scene.structure.nodes.shape), np.nan)
    for k, line in enumerate(lines):
        if not np.isfinite(times[k]):
            raise InputError(f"{path}: {line} has no t; expected the time of each row, s")
        if k and not times[k] > times[k - 1]:
            raise InputError(f"{path}: {line} has t = {times[k]:g} after {times[k - 1]:g}; expected later times")
    for (kind, number), column in found.items():
        if kind in "xyz":
            positions[:, number, "xyz".index(kind)] = unit * table[:, column]
    first = _first_whole(path, Recording(times, positions).known(scene.structure))
    if len(table) - first < FEWEST_FRAMES:
        seen = f"{len(table) - first} rows from the first one with every node on"
        raise InputError(f"{path}: has {seen}; expected at least {FEWEST_FRAMES}")
    asked = {key: column for key, column in found.items() if key[0] not in "xyz"}
    commands = _commands(path, asked, (times, table, lines), scene.structure, unit) if asked else None
    recording = Recording(times[first:], positions[first:], commands)
    _check_first_pose(path, scene, recording)
    return recording


def _read(path: str | Path, structure: Structure) -> tuple[int, dict[tuple[str, int], int], Table, list[str]]:
    """The places of the times and of other columns, the numbers, NaN where there is none, and where each row stands.

    Names are checked first: with another separator, they are wrong too, and say it better than the numbers.
    """
    names, rows = (_json_rows if str(path).endswith(".json") else _csv_rows)(path)
    found = _columns(path, names, structure)
    table = np.empty((len(rows), len(names)))
    for place, (line, row) in zip(table, rows):
        if len(row) != len(names):
            raise InputError(f"{path}: {line} has {len(row)} cells; expected {len(names)}, one for each column")
        for k, (name, cell) in enumerate(zip(names, row)):
            place[k] = _number(cell, f"{path}: {line} has {name} =")
    return names.index("t"), found, table, [line for line, _ in rows]


def _csv_rows(path: str | Path) -> tuple[list[str], list[tuple[str, list[str]]]]:
    """Names of columns; and of each row where it stands, and its cells."""
    reader = csv.reader(io.StringIO(read_text(path)), strict=True)
    try:
        rows = [(f"line {reader.line_num}", [cell.strip() for cell in row]) for row in reader if row]
    except csv.Error as error:
        raise InputError(f"{path}: not CSV: {error}") from error
    if not rows:
        raise InputError(f"{path}: is empty; expected a header with columns {COLUMNS}")
    (_, names), *rows = rows
    return names, rows


def _json_rows(path: str | Path) -> tuple[list[str], list[tuple[str, list[str]]]]:
    """The same of a list of frames that have a time, and both ends of each rod."""
    try:
        frames = json.loads(read_text(path))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not JSON: {error}") from error
    if not (isinstance(frames, list) and frames and all(isinstance(frame, dict) for frame in frames)):
        raise InputError(f"{path}: expected a list of frames, each with its time and the ends of the rods")
    rods = list(dict.fromkeys(match[1] for match in map(ROD_END.fullmatch, frames[0]) if match))
    rods = sorted(rods, key=int) if all(map(str.isdecimal, rods)) else rods
    ends = [f"rod_{rod}_end_pt{end}" for rod in rods for end in "12"]
    rows = []
    for number, frame in enumerate(frames):
        row = [_cell(frame.get("time"))]
        for end in ends:
            place = [None] * 3 if frame.get(end) is None else frame[end]
            if not (isinstance(place, list) and len(place) == 3):
                raise InputError(f"{path}: frame {number} has {end} = {place!r:.60}; expected three coordinates")
            row += map(_cell, place)
        rows.append((f"frame {number}", row))
    return ["t", *(f"{axis}{node}" for node in range(len(ends)) for axis in "xyz")], rows


def _cell(value: object) -> str:
    """A value of JSON as a cell of a table: nothing where it is null."""
    return "" if value is None else str(value)


def _number(cell: str, where: str) -> float:
    try:
        number = float(cell or "nan")
    except ValueError:
        number = np.inf
    if np.isinf(number):
        raise InputError(f"{where} {cell[:60]!r}; expected a finite number, or an empty cell where nothing was seen")
    return number


def _columns(path: str | Path, names: list[str], structure: Structure) -> dict[tuple[str, int], int]:
    """The places of the columns, by what and of which node or member they are."""
    found: dict[tuple[str, int], int] = {}
    if "t" not in names:
        raise InputError(f"{path}: has no column t; expected columns {COLUMNS}")
    for k, name in enumerate(names):
        match = COLUMN.fullmatch(name)
        if names.count(name) > 1 or not (match or name == "t"):
            raise InputError(f"{path}: has a column {name[:60]!r}; expected columns {COLUMNS}, each once")
        if not match:
            continue
        kind, number = match[1].strip(), int(match[2])
        what, count = ("node", len(structure.nodes)) if kind in "xyz" else ("member", structure.member_count)
        if number >= count:
            known = f"numbers from 0 to {count - 1}" if count else "none, since there are no members"
            raise InputError(f"{path}: has a column {name!r}; expected {known}, as the scene has {count} {what}s")
        found[kind, number] = k
    if len(found) == sum(kind not in "xyz" for kind, _ in found):
        raise InputError(f"{path}: has no places of nodes; expected columns {COLUMNS}")
    for kind, number in found:
        missing = [f"{axis}{number}" for axis in "xyz" if kind in "xyz" and (axis, number) not in found]
        if missing:
            raise InputError(
                f"{path}: has {kind}{number} and no {missing[0]}; expected all three coordinates of a node"
            )
    return found


def _first_whole(path: str | Path, each: Bool[np.ndarray, "rows nodes"]) -> int:
    """The first row in which every node is known."""
    never = np.flatnonzero(~each.any(0))
    if never.size:
        raise InputError(
            f"{path}: never has node {never[0]}; expected x{never[0]}, y{never[0]}, z{never[0]} in some rows"
        )
    whole = np.flatnonzero(each.all(1))
    if not whole.size:
        best = int(each.sum(1).argmax())
        lacks = f"no row has every node (the fullest lacks node {int(np.flatnonzero(~each[best])[0])})"
        raise InputError(f"{path}: {lacks}; expected one, from which the simulation can start")
    return int(whole[0])


def _commands(
    path: str | Path,
    asked: dict[tuple[str, int], int],
    rows: tuple[Times, Table, list[str]],
    structure: Structure,
    unit: float,
) -> Commands:
    """The contractions of the commanded members."""
    times, table, lines = rows
    members = tuple(number for _, number in asked)
    lengths = np.concatenate([np.asarray(each.rest_length, float) for each in structure.members])
    contractions = []
    for (kind, number), column in asked.items():
        if members.count(number) > 1:
            raise InputError(
                f"{path}: has both commands of member {number}; expected its rest length or its contraction"
            )
        if number in structure.driven:
            raise InputError(
                f"{path}: has a column '{kind} {number}'; expected none, since the scene has a motor there"
            )
        values = table[:, column]
        share = 1 - unit * values / lengths[number] if kind == "rest length" else values
        wrong = np.flatnonzero(~(share < 1))
        if wrong.size:
            given = "nothing" if np.isnan(values[wrong[0]]) else f"{values[wrong[0]]:g}"
            expected = "a positive length" if kind == "rest length" else "a fraction below 1"
            where = f"{path}: {lines[wrong[0]]} has {kind} {number} = {given}"
            raise InputError(f"{where}; expected {expected} in each row")
        contractions.append(share)
    return Commands(members, times, np.stack(contractions, axis=1))


def _check_first_pose(path: str | Path, scene: Scene, recording: Recording) -> None:
    """Refuse places in another unit, or of other nodes."""
    expected = "expected metres, or the file's unit (--unit), and the scene's numbers of nodes"
    structure, t = scene.structure, float(recording.times[0])
    q = recording.filled(structure)[0]
    gait = recording.commands or scene.gait
    if structure.struts is not None:
        rest = np.asarray(rest_lengths_along(structure.struts, gait, recording.times[:1], 0)[0], float)
        found = edge_lengths(q, structure.struts.edges)
        ratio = np.maximum(found / rest, rest / np.maximum(found, np.finfo(float).tiny))
        k = int(ratio.argmax())
        if not ratio[k] <= STRETCH:
            ends = " and ".join(map(str, structure.struts.edges[k]))
            long, there = in_digits(found[k]), in_digits(rest[k])
            what = f"strut {k} (nodes {ends}) is {long} m long at {t:g} s, and {there} m in the scene"
            raise InputError(f"{path}: {what}; {expected}")
    theirs, ours = (float(np.linalg.norm(x - np.mean(x, axis=0))) for x in (q, np.asarray(structure.nodes, float)))
    if ours > 0 and not 1 / SCALE < theirs / ours < SCALE:
        what = f"at {t:g} s the robot is {in_digits(theirs / ours, 2)} times as large as the scene"
        raise InputError(f"{path}: {what}; {expected}")
