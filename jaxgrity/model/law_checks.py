"""Laws of one's own, tried on shapes alone before anything compiles: what they return, which nodes they name."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.functions import hold_functions
from jaxgrity.core.tracing import traced
from jaxgrity.core.types import AnyArray
from jaxgrity.model.laws import DissipationTerm, EnergyTerm, ForceLaw, Law

OUTSIDE = "out of bounds"
"""Part of NumPy's message where an array has no such row. JAX takes the last row without a message."""


def check_own_laws(laws: Sequence[Law], scene: Any) -> None:
    """Raises `InputError`, with the law's name, where one cannot act in the scene; a scene of traced numbers passes."""
    for law in laws:
        _check_static(law)  # of all first: an array in one law's static field makes trouble where others are tried
    for law in laws:
        _check_law(law, scene)


def _check_law(law: Law, scene: Any) -> None:
    if not isinstance(law, EnergyTerm | DissipationTerm | ForceLaw) or traced(scene):
        return
    number = jnp.result_type(float)
    shapes = jax.tree.map(lambda x: jax.ShapeDtypeStruct(np.shape(x), number), hold_functions((law, scene)))
    rows = jax.ShapeDtypeStruct(np.shape(scene.structure.nodes), number)
    value = _tried(law, _value, *shapes, rows, rows)
    expected, what = (rows.shape, "a force for each node") if isinstance(law, ForceLaw) else ((), "one number, a sum")
    if value.shape != expected:
        raise InputError(f"{_who(law)} gives an array of shape {value.shape}; expected {expected}, {what}")
    if not isinstance(law, ForceLaw):
        _tried(law, jax.grad(_value, (2, 3)), *shapes, rows, rows)
    _check_rows(law, shapes, np.zeros(rows.shape))


def _check_static(law: Law) -> None:
    """Raises `InputError` for a static field that JAX cannot compare: an array, or a list."""
    for field in dataclasses.fields(law):
        value = getattr(law, field.name)
        if not field.metadata.get("static") or _comparable(value):
            continue
        kind = "a list" if isinstance(value, list) else "an array"
        advice = "give a tuple of whole numbers" if _whole(value) else "leave static=True out, and give an array"
        raise InputError(f"{_who(law)}: its static field {field.name} has {kind}; {advice}")


def _comparable(value: Any) -> bool:
    if isinstance(value, tuple):
        return all(map(_comparable, value))
    return not isinstance(value, list | AnyArray)


def _value(law: Law, scene: Any, q: Any, v: Any) -> Any:
    """U, R or the forces."""
    if isinstance(law, EnergyTerm):
        return jnp.asarray(law.energy(scene.configuration(q, 0.0)))
    motion = scene.motion(v, q, 0.0, scene.normal_force(q, v))
    if isinstance(law, DissipationTerm):
        return jnp.asarray(law.dissipation(motion))
    assert isinstance(law, ForceLaw), "the only other kind of force"
    return jnp.asarray(law.force(motion, 0 * motion.v))


def _tried(law: Law, function: Callable, *given: Any) -> Any:
    try:
        return jax.eval_shape(function, *given)
    except Exception as error:
        raise _refusal(law, error) from error


def _check_rows(law: Law, shapes: tuple, known: np.ndarray) -> None:
    """Nodes that a law takes by `at.q[node]`: NumPy says where there is no such row, JAX takes the last one."""
    try:
        jax.eval_shape(lambda law, scene: _value(law, scene, known, known), *shapes)
    except Exception as error:  # of others, such as for `at.q.at`, which NumPy's arrays lack, nothing follows
        if isinstance(error, IndexError) and OUTSIDE in str(error):
            raise _refusal(law, error) from error


def _refusal(law: Law, error: Exception) -> InputError:
    first = str(error).strip().partition("\n")[0]
    what = first if isinstance(error, InputError | IndexError) else f"{type(error).__name__}: {first}"
    own = {x.name: getattr(law, x.name) for x in dataclasses.fields(law) if not x.metadata.get("static")}
    whole = [name for name, value in own.items() if _whole(value)]
    shapes = ", ".join(f"{name} {np.shape(value)}" for name, value in own.items() if eqx.is_array_like(value))
    advice = f"; declare {whole[0]}, which has whole numbers, as eqx.field(static=True)" if whole else ""
    if not advice and "shape" in what and shapes:
        advice = f"; its fields have the shapes {shapes}"
    return InputError(f"{_who(law)} cannot act in this scene: {what}{advice}")


def _whole(value: Any) -> bool:
    """Whether it is made of whole numbers alone, such as those of nodes."""
    leaves = jax.tree.leaves(value)
    return bool(leaves) and all(np.issubdtype(np.result_type(x), np.integer) for x in leaves if eqx.is_array_like(x))


def _who(law: Law) -> str:
    return f"{type(law).__name__} ({law.name!r})"
