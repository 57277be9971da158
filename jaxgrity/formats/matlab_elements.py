"""MATLAB files looked through before SciPy reads them: its reader trusts kinds and sizes, and wrong ones end Python."""

import struct
import zlib
from collections.abc import Iterator

import numpy as np

from jaxgrity.core.errors import InputError

MATRIX, COMPRESSED = 14, 15
"""Numbers by which a file marks variables, and packed ones."""
BYTES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8, MATRIX: 1, COMPRESSED: 1, 16: 1, 17: 2, 18: 4}
"""Bytes of one number of each kind of element."""
CELL, STRUCT, CHAR, SPARSE, LAST_NUMERIC = 1, 2, 4, 5, 15
"""Classes of variables; objects (3) and functions are not read."""
LARGEST_UNPACKED = 200_000_000
"""Largest size of a packed variable once it is unpacked, bytes."""
DEEPEST_STRUCT = 20
"""Most levels of structures and cells within each other."""


def check_elements(data: bytes) -> None:
    """Raises `InputError` where a variable is cut off, unpacks to more than a robot can be, or has no possible form."""
    order, total = "<" if data[126:128] == b"IM" else ">", 0
    for kind, body in _elements(data[128:], order, aligned=False):
        if kind == COMPRESSED:
            unpacker = zlib.decompressobj()
            body = unpacker.decompress(body, LARGEST_UNPACKED)
            total += len(body)
            if unpacker.unconsumed_tail or total > LARGEST_UNPACKED:
                raise InputError(f"unpacks to more than {LARGEST_UNPACKED} bytes; expected a robot's file")
            _check_all(body, order, 0)
        elif kind == MATRIX:
            _check_matrix(body, order, 0)
        else:
            raise InputError(f"begins a variable with kind {kind}; expected {MATRIX} or {COMPRESSED}")


def _elements(data: bytes, order: str, aligned: bool = True) -> Iterator[tuple[int, bytes]]:
    """Kind and content of each element."""
    place = 0
    while place + 8 <= len(data):
        kind, size = struct.unpack_from(f"{order}II", data, place)
        begin = place + 8
        if kind >> 16:  # up to four bytes, which stand in the place of the size
            kind, size, begin = kind & 0xFFFF, kind >> 16, place + 4
            place += 8
        else:
            place = begin + size + (-size % 8 if aligned else 0)
        body = data[begin : begin + size]
        if kind not in BYTES or len(body) < size or size % BYTES[kind]:
            raise InputError(f"has an element of kind {kind} and {size} bytes, of which {len(body)} are there")
        yield kind, body


def _check_all(data: bytes, order: str, depth: int) -> None:
    for kind, body in _elements(data, order):
        if kind != MATRIX:
            raise InputError(f"has kind {kind} in the place of a variable; expected {MATRIX}")
        _check_matrix(body, order, depth)


def _check_matrix(data: bytes, order: str, depth: int) -> None:
    """Of one variable: its class, and as much content as its size says. One without content is empty."""
    if not data:
        return
    parts = list(_elements(data, order))
    if (
        depth > DEEPEST_STRUCT
        or len(parts) < 3
        or [kind for kind, _ in parts[:3]] != [6, 5, 1]
        or len(parts[0][1]) != 8
    ):
        raise InputError("has a variable without class, size and name")
    number = int(np.frombuffer(parts[0][1], f"{order}u4")[0]) & 0xFF
    size = np.frombuffer(parts[1][1], f"{order}i4").astype(int)
    count, rest = float(np.prod(size, dtype=float)), parts[3:]
    if len(size) < 2 or np.any(size < 0):
        raise InputError(f"has a variable of size {size.tolist()}")
    if number in (CELL, STRUCT):
        fields = 1
        if number == STRUCT:
            fields = _fields(rest, order)
            rest = rest[2:]
        if len(rest) != count * fields or any(kind != MATRIX for kind, _ in rest):
            raise InputError(f"has a structure of {count:g} times {fields} variables, of which {len(rest)} are there")
        for _, body in rest:
            _check_matrix(body, order, depth + 1)
    elif number == SPARSE:
        _check_sparse(rest, size, order)
    elif number == CHAR or SPARSE < number <= LAST_NUMERIC:
        wrong = [len(body) for kind, body in rest if kind in (MATRIX, COMPRESSED) or len(body) != count * BYTES[kind]]
        if len(rest) not in (1, 2) or (wrong and number != CHAR):
            raise InputError(f"has a variable of size {size.tolist()} with other content")
    else:
        raise InputError(f"has a variable of class {number}; expected numbers, text, structures or cells")


def _fields(rest: list[tuple[int, bytes]], order: str) -> int:
    if len(rest) < 2 or rest[0][0] != 5 or len(rest[0][1]) != 4 or rest[1][0] != 1:
        raise InputError("has a structure without names of its fields")
    length = int(np.frombuffer(rest[0][1], f"{order}i4")[0])
    if length < 1 or len(rest[1][1]) % length:
        raise InputError(f"has a structure whose fields have names of {length} bytes")
    return len(rest[1][1]) // length


def _check_sparse(rest: list[tuple[int, bytes]], size: np.ndarray, order: str) -> None:
    if len(rest) < 3 or [kind for kind, _ in rest[:2]] != [5, 5] or len(size) != 2:
        raise InputError("has a sparse matrix without rows and columns")
    rows, starts = (np.frombuffer(body, f"{order}i4").astype(int) for _, body in rest[:2])
    there = len(rest[2][1]) // BYTES[rest[2][0]]
    ordered = len(starts) == size[1] + 1 and starts[0] == 0 and np.all(np.diff(starts) >= 0)
    if not ordered or starts[-1] > min(len(rows), there) or np.any(rows < 0) or np.any(rows >= max(size[0], 1)):
        raise InputError(f"has a sparse matrix of size {size.tolist()} with entries elsewhere")
