"""Shape aliases, all in one place. Everything is written for one robot; `jax.vmap` adds the population."""

import reprlib

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxgrity.core.errors import InputError

AnyArray = jax.Array | np.ndarray

Scalar = float | Float[AnyArray, ""]
Count = int | Int[AnyArray, ""]
"""Number of steps, of sweeps or of frames: an integer, or an input of a compiled program."""
PerNode = Float[AnyArray, " nodes"]
PerMember = Float[AnyArray, " members"]
PerRow = Float[AnyArray, "rows *population"]
"""One number per row of a block of nodes, or of struts."""
Rows = Float[AnyArray, "rows *xyz"]
AnyRows = Float[AnyArray, "members *xyz"]
PerActuator = Float[AnyArray, "*population actuators"]
NodeVectors = Float[AnyArray, "nodes 3"]
AnyPerNode = Float[AnyArray, "nodes *population"]
"""One number per node, of one robot or of many with the population last, as in the laws of a population's scene."""
AnyNodeVectors = Float[AnyArray, "nodes 3 *population"]
"""One vector per node, of one robot or of many with the population last."""
Mobility = Float[AnyArray, "nodes nodes 3"]
MassMatrix = Float[AnyArray, "coordinates coordinates"]
MemberVectors = Float[AnyArray, "members 3"]
AnyPerMember = Float[AnyArray, "members *population"]
AnyMemberVectors = Float[AnyArray, "members 3 *population"]
"""A number, or a vector, per member, of one robot or of many with the population last."""
Vector = Float[AnyArray, "3 *population"]
"""One vector, of one robot or of many with the population last."""
Times = Float[AnyArray, " frames"]
NodeHistory = Float[AnyArray, "frames nodes 3"]
Vectors = Float[AnyArray, "population 3"]
Paths = Float[AnyArray, "population points 3"]
Phases = Float[AnyArray, "population actuators"]
Table = Float[AnyArray, "_ _"]
PerGait = Float[AnyArray, " population"]
Failures = Int[AnyArray, " population"]
FinalPositions = Float[AnyArray, "population nodes 3"]
VectorsByKind = dict[str, Float[AnyArray, "_ 3"]]
"""One vector for each of the "struts" and each of the "cables", where a structure has them."""
Edges = tuple[tuple[int, int], ...]
Supports = tuple[tuple[int, str], ...]
"""Numbers of the fixed nodes, each with those of its coordinates "x", "y" and "z" that do not move."""
State = tuple[AnyArray, AnyArray]
"""Positions q (nodes, 3), m, and velocities v (nodes, 3), m/s."""


def namespace_of(array: object):
    """`jax.numpy` for JAX's arrays, NumPy for any other: with few numbers, it needs no compiled program."""
    return jnp if isinstance(array, jax.Array) else np


def as_float(x: object) -> AnyArray:
    """A float64 NumPy array, unless `x` is a JAX array already (it may carry a gradient).

    NumPy, so that a scene built before x64 is on loses no digits. Raises `InputError` for text, bools and other values
    that NumPy would convert to numbers.
    """
    if isinstance(x, jax.Array):
        return x
    try:
        found = np.asarray(x)
    except jax.errors.TracerArrayConversionError:  # a list of traced numbers
        return jnp.asarray(x)  # type: ignore[arg-type]
    except ValueError as error:  # rows of different lengths
        raise InputError(f"{reprlib.repr(x)}: {error}; expected numbers") from error
    if found.dtype.kind not in "fiu":
        raise InputError(f"{reprlib.repr(x)}: expected numbers")
    return found.astype(np.float64, copy=False)


def as_float_or_none(x: object) -> AnyArray | None:
    """`as_float`; None, for what is not modelled, stays None."""
    return None if x is None else as_float(x)
