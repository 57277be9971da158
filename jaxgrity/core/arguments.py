"""One rule for each kind of argument: what is refused, and in which words.

Only known numbers are looked at, and only those that NumPy or Python hold: JAX's arrays may be traced.
"""

from typing import Any

import jax
import numpy as np

from jaxgrity.core.errors import InputError


def is_number(value: Any) -> bool:
    """Whether it is one real number: no truth value, no text, no list."""
    return isinstance(value, int | float | np.number | np.ndarray) and np.ndim(value) == 0 and _real(np.asarray(value))


def is_count(number: Any, least: int) -> bool:
    """Whether it is a whole number, no less than that."""
    return isinstance(number, int | np.integer) and not isinstance(number, bool) and int(number) >= least


def check_count(where: str, number: Any, least: int) -> int:
    """A whole number, at least `least`; else `InputError`."""
    if not is_count(number, least):
        raise InputError(f"{where} = {number!r}: expected a whole number, at least {least}")
    return int(number)


def check_index(where: str, number: Any, count: int | None = None) -> int:
    """A whole number from 0 on, less than `count` where that is known; else `InputError`."""
    if not is_count(number, 0) or (count is not None and number >= count):
        most = "on" if count is None else f"to {count - 1}"
        raise InputError(f"{where} = {number!r}: expected a whole number from 0 {most}")
    return int(number)


def check_indices(where: str, numbers: Any, count: int | None = None) -> tuple[int, ...]:
    """Whole numbers from 0 on, each once; else `InputError`."""
    if np.ndim(numbers) != 1 or isinstance(numbers, str):
        raise InputError(f"{where} = {numbers!r}: expected a list of whole numbers, such as (0, 1)")
    found = tuple(check_index(f"{where}[{k}]", number, count) for k, number in enumerate(numbers))
    if len(set(found)) < len(found):
        raise InputError(f"{where} = {list(found)}: expected each number once")
    return found


def check_number(where: str, value: Any, *, above: float = -np.inf, least: float = -np.inf, unit: str = "") -> float:
    """One finite number, above and at least these bounds; else `InputError`."""
    if not (is_number(value) and np.isfinite(value) and value > above and value >= least):
        shown = f"{float(value):g}" if is_number(value) else repr(value)
        expected = f"a finite number{f', at least {least:g}' if least > -np.inf else ''}"
        if above > -np.inf:
            expected = f"a finite number above {above:g}" if above else "a positive number"
        raise InputError(f"{where} = {shown}{unit and ' ' + unit}: expected {expected}")
    return float(value)


def check_vector(where: str, value: Any, size: int = 3) -> None:
    """So many finite numbers; else `InputError`. What is traced is not looked at, but for its shape."""
    if np.shape(value) != (size,):
        raise InputError(f"{where} has shape {np.shape(value)}; expected ({size},)")
    check_finite(where, value)


def check_scalar(where: str, value: Any) -> None:
    """One finite number, or one that is traced; else `InputError`."""
    if np.shape(value) != ():
        raise InputError(f"{where} has shape {np.shape(value)}; expected one number")
    check_finite(where, value)


def as_table(where: str, rows: Any) -> np.ndarray:
    """Rows of numbers, all of one length; else `InputError`."""
    try:
        return np.asarray(rows, float)
    except (ValueError, TypeError) as error:
        raise InputError(f"{where}: expected rows of numbers, all of one length") from error


def check_finite(where: str, value: Any) -> None:
    """Finite numbers, as far as they are known; else `InputError` with the first that is not."""
    if isinstance(value, jax.Array) or np.all(np.isfinite(value)):
        return
    at = tuple(np.argwhere(~np.isfinite(value))[0].tolist())
    place = f"[{', '.join(map(str, at))}]" if at else ""
    raise InputError(f"{where}{place} = {np.asarray(value)[at]}: expected a finite number")


def check_all_finite(tree: Any, where: str = "", *, on_devices: bool = False) -> None:
    """All known numbers of a module are finite; else `InputError` with the path to the first that is not.

    JAX's arrays are known too where nothing of them is traced; they are looked at where `on_devices` says so.
    """
    for path, leaf in jax.tree_util.tree_leaves_with_path(tree):
        known = isinstance(leaf, np.ndarray | float)
        if on_devices and isinstance(leaf, jax.Array):
            known = not isinstance(leaf, jax.core.Tracer) and jax.numpy.issubdtype(leaf.dtype, jax.numpy.floating)
        if known and _real(np.asarray(leaf)):
            check_finite(f"{where}{jax.tree_util.keystr(path)}".removeprefix("."), np.asarray(leaf))


def _real(value: np.ndarray) -> bool:
    return np.issubdtype(value.dtype, np.number) and not np.issubdtype(value.dtype, np.complexfloating)
