"""Arguments of a wrong class, refused in one line by public functions."""

import dataclasses
import functools
import inspect
import os
import reprlib
import types
import typing
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from jaxgrity.core.arguments import known_ends
from jaxgrity.core.errors import InputError, check_known
from jaxgrity.core.tracing import traced
from jaxgrity.core.types import Edges

PACKAGE = __name__.partition(".")[0]
"""Name of this package, by which its own classes are known."""
WORDS = {"str": "text", "Path": "a path", "float": "a number", "int": "a whole number", "bool": "True or False"}
"""Words for Python's classes in messages about arguments of the wrong kind."""
MADE_BY = {
    "Scene": "jaxgrity.load_scene(name or path) makes one",
    "Gait": "jaxgrity.load_gait(name or path) makes one, jaxgrity.gaits_of(gait, phases) one of many",
    "Trajectory": "jaxgrity.simulate(scene, duration) makes one",
    "SolverOptions": "pass jaxgrity.SolverOptions(method=..., dt=...)",
    "ResolvedOptions": "jaxgrity.stepping.resolve(scene, duration, options) makes one",
    "Orbit": "jaxgrity.orbits.find_orbit(scene) makes one",
    "Plant": "jaxgrity.control.plant_of(scene, members, ...) makes one",
    "Environment": "jaxgrity.control.environment(task, ...) makes one",
    "SearchConfig": "pass jaxgrity.SearchConfig(space=..., evaluation=..., ...)",
    "Objective": "jaxgrity.SteadySpeed() is one",
    "ActuatorBounds": "pass jaxgrity.ActuatorBounds(rate=..., power=...)",
    "SearchProblem": "jaxgrity.search.search_problem(scene, config) makes one",
}
"""Advice in messages about an argument of the wrong kind, by the name of the class that the function takes."""
READ_BY = {"Scene": "load_scene", "Gait": "load_gait"}
"""Names of the functions of `jaxgrity` that read an object from a file, by the name of its class."""

Function = TypeVar("Function", bound=Callable)


def typed(function: Function) -> Function:
    """The function with checks of its arguments' classes, from its signature.

    Checked are objects of this package, files, text and numbers; arrays have checks of their own.
    """
    signature = inspect.signature(function)
    where = function.__qualname__.removesuffix(".__init__").rpartition(".")[2]
    kinds = {name: found for name, given in signature.parameters.items() if (found := kinds_of(given.annotation))}
    places = [name for name, given in signature.parameters.items() if given.kind != inspect.Parameter.KEYWORD_ONLY]
    starred = next((n for n, given in signature.parameters.items() if given.kind == given.VAR_POSITIONAL), None)

    def named(given: tuple, by_name: dict[str, Any]) -> Iterator[tuple[str, Any]]:
        for k, value in enumerate(given):
            yield (places[k] if k < len(places) else starred or ""), value
        yield from by_name.items()

    @functools.wraps(function)
    def refusing(*given: Any, **by_name: Any) -> Any:
        # at every call: a few microseconds (docs/performance.md)
        for name, value in named(given, by_name):
            if name in kinds and not _fits(value, kinds[name]):
                others = {other: x for other, x in named(given, by_name) if other != name}
                raise InputError(f"{where}: {_refusal(name, value, kinds[name], others)}")
        return function(*given, **by_name)

    return typing.cast(Function, refusing)


def _takes_arrays(annotation: Any) -> bool:
    return any(hasattr(kind, "array_type") for kind in (annotation, *typing.get_args(annotation)))


def kinds_of(annotation: Any) -> tuple[type, ...]:
    """The checkable classes of a parameter: ours, files, text, None and numbers."""
    if isinstance(annotation, TypeVar):
        annotation = annotation.__bound__
    union = isinstance(annotation, types.UnionType) or typing.get_origin(annotation) is typing.Union
    kinds = typing.get_args(annotation) if union else (annotation,)
    if float in kinds or int in kinds:
        kinds = tuple(kind for kind in kinds if not hasattr(kind, "array_type"))  # `Scalar`: arrays are numbers too
    return kinds if all(_known(kind) for kind in kinds) else ()


def _known(kind: Any) -> bool:
    if not inspect.isclass(kind) or getattr(kind, "_is_protocol", False):
        return False
    ours = any(base.__module__.partition(".")[0] in (PACKAGE, "equinox") for base in kind.__mro__)
    return ours or kind in (str, Path, types.NoneType, float, int, bool)


def _fits(value: Any, kinds: tuple[type, ...]) -> bool:
    if isinstance(value, kinds):
        return True
    single = hasattr(value, "__float__") and not getattr(value, "ndim", 0)
    number = single and any(kind in (float, int, bool) for kind in kinds)
    if isinstance(value, float | np.floating) and int in kinds and float not in kinds and not value.is_integer():
        return False
    return number or (Path in kinds and isinstance(value, os.PathLike))


def _refusal(name: str, value: Any, kinds: tuple[type, ...], others: dict[str, Any]) -> str:
    names = [kind.__name__ for kind in kinds if kind is not types.NoneType]
    wanted = [
        WORDS.get(kind, f"{_article(kind)} {kind}") for kind in names if kind != "ResolvedOptions" or len(names) == 1
    ]
    wanted += ["None"] * (types.NoneType in kinds)
    advice = "".join(f"; {words}" for words in _advice(value, kinds, others))
    return f"{name} is {_shown(value)}; expected {' or '.join(wanted)}{advice}"


def check_fields(module: Any) -> None:
    """Raises `InputError` for a field with a value of another class, or none of its words: for `__check_init__`."""
    for field in dataclasses.fields(module):
        value, kinds = getattr(module, field.name), kinds_of(field.type)
        if typing.get_origin(field.type) is typing.Literal:
            check_known(field.name, value, typing.get_args(field.type))
        row = getattr(value, "ndim", 0) and _takes_arrays(field.type)  # of several at once, as `vmap` takes them
        if not row and not _fits(value, kinds or (object,)):
            raise InputError(f"{type(module).__name__}: {_refusal(field.name, value, kinds, {})}")


def _advice(value: Any, kinds: tuple[type, ...], others: dict[str, Any]) -> Iterator[str]:
    """Advice for the message, at most once."""
    ours = [kind for kind in kinds if kind.__module__.partition(".")[0] == PACKAGE]
    swapped = [other for other, x in others.items() if ours and isinstance(x, tuple(ours))]
    held = [part for part in _parts(value) if ours and isinstance(getattr(value, part), tuple(ours))]
    if not ours:
        return
    first = ours[0].__name__
    if swapped:
        yield f"one was given as {swapped[0]}"
    elif held:
        yield f"pass its {held[0]}"
    elif isinstance(value, str | os.PathLike) and first in READ_BY:
        yield f"pass jaxgrity.{READ_BY[first]}({os.fspath(value)!r})"
    elif isinstance(value, dict) and dataclasses.is_dataclass(ours[0]):
        yield f"pass {first}({', '.join(f'{key}={_shown(x)}' for key, x in value.items())})"
    elif first in MADE_BY:
        yield MADE_BY[first]


def _parts(value: Any) -> list[str]:
    known = dataclasses.is_dataclass(value) and not inspect.isclass(value)
    return [field.name for field in dataclasses.fields(value) if hasattr(value, field.name)] if known else []


def _shown(value: Any) -> str:
    """A short value as it is, the shape of an array, the class of anything else."""
    if inspect.isclass(value):
        return f"the class {value.__name__} itself"
    if value is None or isinstance(value, str | os.PathLike | dict | int | float):
        return reprlib.repr(os.fspath(value) if isinstance(value, os.PathLike) else value)
    if getattr(value, "ndim", 0):
        return f"an array of shape {np.shape(value)}"
    return f"{_article(type(value).__name__)} {type(value).__name__}"


def _article(word: str) -> str:
    return "an" if word.startswith((*"AEIOaeio", "Unc")) else "a"


def known_rows(rows: Any, size: int) -> tuple[int, ...]:
    """The numbers of nodes or members as a tuple, as a primitive needs them.

    Raises `InputError` for missing rows, of which JAX would take the last one, and for what is no list of numbers.
    """
    _refuse_traced_rows(rows)
    listed = np.asarray(rows)
    if listed.ndim != 1 or not listed.size or not np.issubdtype(listed.dtype, np.integer):
        raise InputError(f"rows = {reprlib.repr(listed.tolist())}: expected whole numbers, such as (0, 1)")
    rows = tuple(listed.tolist())
    if outside := [row for row in rows if not 0 <= row < size]:
        raise InputError(f"there is no row {outside[0]}; expected 0 to {size - 1}")
    return rows


def known_edges(edges: Any, nodes: int) -> Edges:
    """Pairs of nodes as a tuple, as a primitive needs them. Raises `InputError` as `known_ends` does, or for none."""
    _refuse_traced_rows(edges)
    if not len(found := known_ends(edges, nodes)):
        raise InputError("edges: there are none; expected at least one, or no term where there are no members")
    return tuple((i, j) for i, j in found.tolist())


def _refuse_traced_rows(rows: Any) -> None:
    if traced(rows):
        raise InputError("its numbers of nodes or members are traced; expected them in a static field")


def check_same_shape(name: str, a: Any, b: Any) -> None:
    """Raises `InputError` where two arrays differ in shape, for a function of `primitives` of this name."""
    if np.shape(a) != np.shape(b):
        raise InputError(f"primitives.{name} has arrays of shapes {np.shape(a)} and {np.shape(b)}; expected one shape")
