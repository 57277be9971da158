"""MATLAB files by the names of the public toolboxes for tensegrity: TsgFEM, MOTES and STEDY."""

from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat, savemat

from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import Edges
from jaxgrity.formats.foreign import (
    LARGEST_FILE,
    LARGEST_NUMBER,
    MOST_NODES,
    STRUCTURE_ALONE,
    Imported,
    has_strength,
    refuse_bodies,
)
from jaxgrity.formats.matlab_elements import check_elements
from jaxgrity.io.files import write_whole
from jaxgrity.model.scene import Scene
from jaxgrity.model.structure import Members, Structure, check_edges, edge_lengths

AXES = ("X", "Y", "Z")
"""Names of the axes in the fields of a file."""
MOST_MEMBERS = 100_000
"""Most members of a structure in a file. A file with more does not describe a robot."""
LARGEST_MATRIX = 20_000_000
"""Most entries of a sparse matrix once it is dense."""


@typed
def save_matlab(scene: Scene, path: str | Path) -> tuple[str, ...]:
    """Write a structure as a MATLAB file, with the variables of TsgFEM, and those of MOTES beside them.

    - `N`: (3, nodes), m.
    - `C_b`, `C_s`: (members, nodes), with -1 and 1 at a member's first and second node.
    - `l0`, `EA` and `mass`: of bars, then strings. EA = K l0 is infinite for a rigid strut.
    - `s_0`, `k` and `c`: of strings. `c_b` and `m`: of bars.
    - `node_mass`: of nodes.
    - `pinned_X`, `pinned_Y`, `pinned_Z`: numbers of nodes from 1.

    Returns sentences on the parts of the scene that such a file cannot hold.
    """
    structure = scene.structure
    refuse_bodies(structure, "MATLAB files")
    kinds = {"b": structure.struts, "s": structure.cables}
    columns = {name: _columns(members) for name, members in kinds.items()}
    together = {key: np.concatenate([columns["b"][key], columns["s"][key]]) for key in ("l0", "EA", "mass", "c")}
    free = structure.free
    content = {
        "N": np.asarray(structure.nodes, float).T,
        **{f"C_{name}": _incidence(members, len(structure.nodes)) for name, members in kinds.items()},
        **{key: together[key][:, None] for key in ("l0", "EA", "mass")},
        "s_0": columns["s"]["l0"][None],
        "k": columns["s"]["k"][None],
        "c": columns["s"]["c"][None],
        "c_b": columns["b"]["c"][None],
        "m": columns["b"]["mass"][None],
        "node_mass": np.asarray(structure.node_mass, float)[:, None],
        **{f"pinned_{name}": np.flatnonzero(~free[:, axis])[:, None] + 1.0 for axis, name in enumerate(AXES)},
    }
    write_whole(path, lambda file: savemat(file, content, oned_as="column"))
    return beside_the_structure(scene)


def beside_the_structure(scene: Scene) -> tuple[str, ...]:
    """A sentence on what a scene has beside its structure's shape, masses and springs, if it has anything."""
    parts: dict[str, object] = {"gravity": scene.gravity, "damping of nodes": scene.node_damping}
    further = ", ".join(term.name for term in scene.terms)
    parts |= {
        "ground": scene.ground,
        "friction": scene.friction,
        "gait": scene.gait,
        f"further forces ({further})": further or None,
        "load cases": scene.loads or None,
        "motion of supports": scene.shaking,
        "motors": scene.structure.driven or None,
        "that members are stuck": any(each.stuck for each in scene.structure.members) or None,
        "strength of members": has_strength(scene.structure) or None,
    }
    cables = scene.structure.cables
    if cables is not None and cables.clusters:
        parts["that some cables run through several nodes"] = cables.clusters
        parts["over pulleys"] = cables.pulleys or None
    lost = [name for name, part in parts.items() if part is not None]
    return (f"not written, since such a file holds the structure alone: {', '.join(lost)}",) if lost else ()


@typed
def read_matlab(path: str | Path) -> Imported:
    """A structure from a MATLAB file (.mat, version 7 or older) with at least N, C_b and C_s.

    Rest lengths are `l0` (bars, then strings) or `s_0` (strings), otherwise the lengths of the shape. Stiffness is
    EA/l0 from `EA`, or from `E` and `A`. Otherwise it is `k` of strings. Bars without stiffness, or with an infinite
    one, are rigid. Masses are `mass` (bars, then strings), or `m` of bars. Masses of nodes are `node_mass` or `ms`.
    Variables may be fields of one struct.

    Raises:
        InputError: one line with the file, the variable and what was expected.
    """
    try:
        if Path(path).stat().st_size > LARGEST_FILE:
            raise InputError(f"has {Path(path).stat().st_size} bytes; expected at most {LARGEST_FILE}")
        return _imported(_loaded(path))
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _loaded(path: str | Path) -> dict[str, Any]:
    try:
        check_elements(Path(path).read_bytes())
        found = loadmat(path, squeeze_me=False, struct_as_record=False, verify_compressed_data_integrity=True)
    except (InputError, OSError):
        raise
    except Exception as error:
        # SciPy's reader raises errors of zlib, of NumPy and of its own on damaged files
        reason = " ".join(str(error).split())
        raise InputError(f"not a MATLAB file of version 7 or older, or a damaged one: {reason}") from error
    names = {name: value for name, value in found.items() if not name.startswith("__")}
    if "N" not in names:
        structs = [value for value in names.values() if isinstance(value, np.ndarray) and value.dtype == np.object_]
        fields = [vars(value.flat[0]) for value in structs if value.size == 1 and hasattr(value.flat[0], "_fieldnames")]
        names = next((each for each in fields if "N" in each), names)
    return names


def _imported(names: dict[str, Any]) -> Imported:
    nodes = _matrix(names, "N", (3, None)).T
    if not 0 < len(nodes) <= MOST_NODES:
        raise InputError(f"N has {len(nodes)} columns; expected 1 to {MOST_NODES}, one a node")
    bars, strings = (_edges(names, name, len(nodes)) for name in ("C_b", "C_s"))
    check_edges(nodes, bars, strings)
    b, count, notes = len(bars), len(bars) + len(strings), ["SI units; z is taken to be up; N has a column a node"]
    lengths = edge_lengths(nodes, (*bars, *strings)) if count else np.zeros(0)
    rest = _list(names, "l0", count)
    if rest is None:
        s_0 = _list(names, "s_0", count - b)
        rest = lengths if s_0 is None else np.r_[lengths[:b], s_0]
        notes.append("l0 is not given: bars, and strings without s_0, rest in this shape")
    if not np.all(rest > 0):
        raise InputError("l0: expected positive rest lengths")
    stiffness, c = _stiffness(names, rest, b), _list(names, "c", count - b)
    mass, node_mass = _masses(names, b, count, len(nodes), notes)
    rigid = not np.isfinite(stiffness[:b]).all() if b else False
    if rigid and np.isfinite(stiffness[:b]).any():
        raise InputError("EA: some bars are rigid (infinite) and some are not; expected one kind")
    if rigid:
        notes.append("bars are rigid, as no stiffness of theirs is given")
    structure = Structure(
        nodes,
        node_mass,
        _members(bars, None if rigid else stiffness[:b], rest[:b], mass[:b], None if rigid else _list(names, "c_b", b)),
        _members(strings, stiffness[b:], rest[b:], mass[b:], c),
        fixed=_pinned(names, len(nodes)),
    )
    return Imported(Scene(structure), (*notes, STRUCTURE_ALONE))


def _stiffness(names: dict[str, Any], rest: np.ndarray, b: int) -> np.ndarray:
    """Stiffness K of all members, N/m; infinite for bars that have none in the file."""
    EA = _list(names, "EA", len(rest), finite=False)
    if EA is None and {"E", "A"} <= set(names):
        E, A = (_list(names, name, len(rest)) for name in ("E", "A"))
        EA = None if E is None or A is None else E * A
    if EA is not None:
        K = EA / rest
    else:
        k = _list(names, "k", len(rest) - b)
        if k is None and len(rest) > b:
            raise InputError("EA: missing; expected EA, E and A, or k of strings")
        K = np.r_[np.full(b, np.inf), np.zeros(0) if k is None else k]
    if not np.all(K > 0) or not np.isfinite(K[b:]).all():
        raise InputError("EA: expected positive stiffness, finite for strings")
    return K


def _masses(names: dict[str, Any], b: int, count: int, nodes: int, notes: list[str]) -> tuple[np.ndarray, np.ndarray]:
    mass = _list(names, "mass", count)
    if mass is None:
        m = _list(names, "m", b)
        mass = np.r_[np.zeros(b) if m is None else m, np.zeros(count - b)]
    at_nodes = _list(names, "node_mass", nodes)
    if at_nodes is None:
        ms = _list(names, "ms", nodes)
        at_nodes = np.zeros(nodes) if ms is None else ms
    if np.any(mass < 0) or np.any(at_nodes < 0):
        raise InputError("mass: expected no negative number")
    if not mass.any() and not at_nodes.any():
        notes.append("no masses are given: 1 kg at each node")
        at_nodes = np.ones(nodes)
    return mass, at_nodes


def _members(
    edges: Edges, stiffness: np.ndarray | None, rest: np.ndarray, mass: np.ndarray, damping: np.ndarray | None
) -> Members | None:
    if not edges:
        return None
    c = damping if damping is not None and damping.any() else None
    return Members(edges, stiffness, rest, damping=c, mass=mass if mass.any() else None)


def _columns(members: Members | None) -> dict[str, np.ndarray]:
    """Of members of one kind: l0, k, EA, mass and c."""
    if members is None:
        return {name: np.zeros(0) for name in ("l0", "k", "EA", "mass", "c")}
    count, rest = len(members.edges), np.asarray(members.rest_length, float)
    k = np.full(count, np.inf) if members.stiffness is None else np.asarray(members.stiffness, float)
    other = {name: getattr(members, field) for name, field in (("mass", "mass"), ("c", "damping"))}
    given = {name: np.zeros(count) if value is None else np.asarray(value, float) for name, value in other.items()}
    return {"l0": rest, "k": k, "EA": k * rest, **given}


def _incidence(members: Members | None, nodes: int) -> np.ndarray:
    edges = members.edges if members is not None else ()
    C = np.zeros((len(edges), nodes))
    for k, (i, j) in enumerate(edges):
        C[k, i], C[k, j] = -1.0, 1.0
    return C


def _edges(names: dict[str, Any], name: str, nodes: int) -> Edges:
    """Rows of a connectivity matrix with -1 and 1, or pairs of numbers of nodes from 1."""
    C = names.get(name)
    C = np.zeros((0, nodes)) if C is None or getattr(C, "size", 1) == 0 else _matrix(names, name, (None, None))
    if C.shape[0] > MOST_MEMBERS:
        raise InputError(f"{name} has {C.shape[0]} rows; expected at most {MOST_MEMBERS}")
    if C.shape[1] == 2 and np.all(C >= 1):
        if np.any(np.round(C) != C) or np.any(nodes < C):
            raise InputError(f"{name}: expected numbers of nodes from 1 to {nodes}")
        return tuple((int(i) - 1, int(j) - 1) for i, j in C)
    ends = np.sort(C, axis=1)[:, [0, -1]] if C.shape[1] == nodes > 1 else None
    if ends is None or np.any(ends != [-1, 1]) or np.any(np.abs(C).sum(1) != 2):
        raise InputError(f"{name} has shape {C.shape}; expected a row a member, of {nodes} with one -1 and one 1")
    return tuple((int(i), int(j)) for i, j in zip(C.argmin(1), C.argmax(1)))


def _pinned(names: dict[str, Any], nodes: int) -> tuple[tuple[int, str], ...]:
    held: dict[int, str] = {}
    for axis in AXES:
        value = names.get(f"pinned_{axis}")
        if value is None or getattr(value, "size", 0) == 0:
            continue
        for number in np.ravel(_numeric(value, f"pinned_{axis}")):
            if not (number == round(number) and 1 <= number <= nodes):
                raise InputError(f"pinned_{axis} has {number:g}; expected numbers of nodes from 1 to {nodes}")
            held[int(number) - 1] = held.get(int(number) - 1, "") + axis.lower()
    return tuple(sorted(held.items()))


def _list(names: dict[str, Any], name: str, count: int, finite: bool = True) -> np.ndarray | None:
    """Numbers (count,), from a row, a column, or one number for all. None if the file has none."""
    if names.get(name) is None or getattr(names[name], "size", 0) == 0:
        return None
    found = np.ravel(_numeric(names[name], name))
    if found.size not in (1, count):
        raise InputError(f"{name} has {found.size} numbers; expected {count}, or one for all")
    if np.isnan(found).any() or (finite and not np.isfinite(found).all()):
        raise InputError(f"{name}: expected finite numbers")
    return np.broadcast_to(found, (count,)).copy()


def _matrix(names: dict[str, Any], name: str, shape: tuple[int | None, int | None]) -> np.ndarray:
    if name not in names:
        raise InputError(f"{name}: missing; expected a matrix")
    value = names[name]
    if np.prod(np.shape(value), dtype=float) > LARGEST_MATRIX:
        raise InputError(f"{name} has shape {np.shape(value)}; expected at most {LARGEST_MATRIX} entries")
    found = _numeric(value.toarray() if hasattr(value, "toarray") else value, name)
    if found.ndim != 2 or any(want not in (None, have) for want, have in zip(shape, found.shape)):
        wanted = " by ".join("any" if side is None else str(side) for side in shape)
        raise InputError(f"{name} has shape {found.shape}; expected {wanted}")
    if not np.isfinite(found).all():
        raise InputError(f"{name}: expected finite numbers")
    return found


def _numeric(value: Any, name: str) -> np.ndarray:
    array = np.asarray(value)
    if array.dtype.kind not in "biuf":
        raise InputError(f"{name}: expected real numbers")
    found = array.astype(float)
    if np.any(np.isfinite(found) & (np.abs(found) > LARGEST_NUMBER)):
        raise InputError(f"{name}: expected numbers of at most {LARGEST_NUMBER:g}")
    return found
