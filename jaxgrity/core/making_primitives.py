"""How primitives are made whose mapped axis stays last: see `primitives.py`."""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

SHAPES = 4096
"""Number of shapes that each primitive remembers: finding one takes a trace, and a program asks for it many times."""


def primitive(name: str, implementation: Callable) -> Primitive:
    """A primitive that is evaluated as `implementation` says, also with the population last in all arrays."""
    primitive = Primitive(name)
    primitive.def_impl(implementation)

    @functools.lru_cache(SHAPES)
    def found(arrays, x64, **static):
        shapes = [jax.ShapeDtypeStruct(*array) for array in arrays]
        out = jax.eval_shape(lambda *xs: implementation(*xs, **static), *shapes)
        return jax.core.ShapedArray(out.shape, out.dtype)

    def abstract(*arrays, **static):
        return found(tuple((a.shape, a.dtype) for a in arrays), bool(jax.config.jax_enable_x64), **static)  # type: ignore[attr-defined]

    def batch(arrays, axes, **static):
        size = next(a.shape[axis] for a, axis in zip(arrays, axes) if axis is not None)
        # all operands get the axis: implementations count axes from the front, and one without it would not line up
        last = [
            jnp.broadcast_to(a[..., None], (*a.shape, size)) if axis is None else jnp.moveaxis(a, axis, -1)
            for a, axis in zip(arrays, axes)
        ]
        out = primitive.bind(*last, **static)
        return out, out.ndim - 1

    primitive.def_abstract_eval(abstract)
    batching.primitive_batchers[primitive] = batch
    mlir.register_lowering(primitive, mlir.lower_fun(implementation, multiple_results=False))
    return primitive


def linear_pair(forward: Primitive, transposed: Primitive) -> None:
    """Each is the transpose of the other."""
    ad.deflinear2(forward, lambda ct, _, **static: [transposed.bind(ct, **static)])
    ad.deflinear2(transposed, lambda ct, _, **static: [forward.bind(ct, **static)])
