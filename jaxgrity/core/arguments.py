"""Checks of arguments: one rule, with one message, for each kind.

Only known numbers of NumPy or Python are checked: JAX's arrays may be traced.
"""

from typing import Any

import jax
import numpy as np

from jaxgrity.core.errors import InputError

UNIT_WITHIN = 1e-6
"""Largest difference of a unit vector's length from 1: ten times what rounding to float32 leaves."""


def is_number(value: Any) -> bool:
    """Whether it is one real number: no bool, text or list."""
    return isinstance(value, int | float | np.number | np.ndarray) and np.ndim(value) == 0 and _real(np.asarray(value))


def is_count(number: Any, least: int) -> bool:
    """Whether it is a whole number, no less than that."""
    return isinstance(number, int | np.integer) and not isinstance(number, bool) and int(number) >= least


def check_count(where: str, number: Any, least: int) -> int:
    """A whole number, at least `least`; else `InputError`."""
    if not is_count(number, least):
        raise InputError(f"{where} = {_plain(number)!r}: expected a whole number, at least {least}")
    return int(number)


def check_index(where: str, number: Any, count: int | None = None) -> int:
    """A whole number from 0 on, less than `count` where that is known; else `InputError`."""
    if not is_count(number, 0) or (count is not None and number >= count):
        most = "on" if count is None else f"to {count - 1}"
        raise InputError(f"{where} = {_plain(number)!r}: expected a whole number from 0 {most}")
    return int(number)


def check_indices(where: str, numbers: Any, count: int | None = None) -> tuple[int, ...]:
    """Whole numbers from 0 on, each once; else `InputError`."""
    if np.ndim(numbers) != 1 or isinstance(numbers, str):
        raise InputError(f"{where} = {numbers!r}: expected a list of whole numbers, such as (0, 1)")
    found = tuple(check_index(f"{where}[{k}]", number, count) for k, number in enumerate(numbers))
    if len(set(found)) < len(found):
        raise InputError(f"{where} = {list(found)}: expected each number once")
    return found


def known_ends(edges: Any, nodes: int) -> np.ndarray:
    """(members, 2), the nodes at both ends of each member; `InputError` for one that is not among so many nodes."""
    ends = as_table("edges", edges)
    if ends.size and ends.shape[1:] != (2,):
        raise InputError(f"edges have shape {ends.shape}; expected (members, 2), two nodes for each member")
    ends = ends.reshape(-1, 2)
    # a comparison with what is no number is false
    for k in np.flatnonzero(~((ends == np.floor(ends)) & (ends >= 0) & (ends < nodes)).all(1))[:1]:
        raise InputError(f"edges[{k}] = {np.asarray(edges)[k].tolist()}: expected two nodes from 0 to {nodes - 1}")
    return ends.astype(int)


def check_number(
    where: str, value: Any, *, above: float = -np.inf, least: float = -np.inf, most: float = np.inf, unit: str = ""
) -> float:
    """One finite number, above and within these bounds; else `InputError`, also where it is being traced."""
    if isinstance(value, jax.Array) and not isinstance(value, jax.core.Tracer):
        value = np.asarray(value)
    if not (is_number(value) and np.isfinite(value) and value > above and least <= value <= most):
        shown = f"{float(value):g}" if is_number(value) else repr(value)
        raise InputError(f"{where} = {shown}{unit and ' ' + unit}: expected {_within(above, least, most)}")
    return float(value)


def check_each(
    where: str,
    value: Any,
    *,
    shape: tuple[int, ...] | None = None,
    above: float = -np.inf,
    least: float = -np.inf,
    most: float = np.inf,
    unit: str = "",
) -> None:
    """Finite numbers of this shape, above and within these bounds, as far as known; else `InputError` with the first
    bad one. None, for what is not modelled, is fine.
    """
    if value is None:
        return
    if shape is not None and np.shape(value) != shape:
        raise InputError(f"{where} has shape {np.shape(value)}; expected {shape or 'one number'}")
    if isinstance(value, jax.Array):
        return
    check_finite(where, value)
    numbers = np.asarray(value)
    beyond = ~((numbers > above) & (numbers >= least) & (numbers <= most))
    if beyond.any():
        at = tuple(np.argwhere(beyond)[0].tolist())
        shown = f"{where}{_place(at)} = {numbers[at]:g}{unit and ' ' + unit}"
        raise InputError(f"{shown}: expected {_within(above, least, most)}")


def check_unit_vector(where: str, value: Any) -> None:
    """Three finite numbers of norm 1; else `InputError`. None is fine; JAX's arrays are not checked."""
    check_each(where, value, shape=(3,))
    if isinstance(value, np.ndarray) and abs(np.linalg.norm(value) - 1) > UNIT_WITHIN:
        raise InputError(f"{where} = {value.tolist()}: {np.linalg.norm(value):.6g} long; expected a unit vector")


def check_key(key: Any) -> None:
    """One random key; else `InputError`."""
    kind, shape = getattr(key, "dtype", np.dtype(int)), np.shape(key)
    made = jax.dtypes.issubdtype(kind, jax.dtypes.prng_key)
    if not ((made and shape == ()) or (kind == np.uint32 and shape == (2,))):
        raise InputError(f"key of type {kind} and shape {shape}: expected one key, such as jax.random.key(0)")


def as_table(where: str, rows: Any) -> np.ndarray:
    """Rows of numbers, all of one length; else `InputError`."""
    try:
        return np.asarray(rows, float)
    except (ValueError, TypeError) as error:
        raise InputError(f"{where}: expected rows of numbers, all of one length") from error


def check_finite(where: str, value: Any) -> None:
    """Finite numbers, as far as known; else `InputError` with the first bad one."""
    if isinstance(value, jax.Array) or np.all(np.isfinite(value)):
        return
    at = tuple(np.argwhere(~np.isfinite(value))[0].tolist())
    raise InputError(f"{where}{_place(at)} = {np.asarray(value)[at]}: expected a finite number")


def check_all_finite(tree: Any, where: str = "", *, on_devices: bool = False) -> None:
    """Only finite known numbers in a module; else `InputError` with the path to the first bad one.

    JAX's arrays are known too where nothing is traced; they are checked with `on_devices`.
    """
    for path, leaf in jax.tree_util.tree_leaves_with_path(tree):
        known = isinstance(leaf, np.ndarray | float)
        if on_devices and isinstance(leaf, jax.Array):
            known = not isinstance(leaf, jax.core.Tracer) and jax.numpy.issubdtype(leaf.dtype, jax.numpy.floating)
        if known and _real(np.asarray(leaf)):
            check_finite(f"{where}{jax.tree_util.keystr(path)}".removeprefix("."), np.asarray(leaf))


def _plain(value: Any) -> Any:
    """Python's number in place of NumPy's, whose text names its class."""
    return value.item() if isinstance(value, np.generic) else value


def _place(at: tuple[int, ...]) -> str:
    return f"[{', '.join(map(str, at))}]" if at else ""


def _within(above: float, least: float, most: float) -> str:
    """The expected range of a number, in words."""
    if above == 0 and most == np.inf:
        return "a positive number"
    low = f" above {above:g}" if above > -np.inf else f", at least {least:g}" if least > -np.inf else ""
    if most == np.inf:
        return f"a finite number{low}"
    return f"a number{low}, at most {most:g}" if above > -np.inf else f"a number from {least:g} to {most:g}"


def _real(value: np.ndarray) -> bool:
    return np.issubdtype(value.dtype, np.number) and not np.issubdtype(value.dtype, np.complexfloating)
