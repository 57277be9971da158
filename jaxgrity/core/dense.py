"""Small dense systems, solved without starting a thread.

From some size on LAPACK starts threads. They spin while they wait for each other, which takes a hundred times as long
on busy cores (docs/performance.md). So larger matrices are eliminated in small blocks, for which LAPACK starts none;
products of blocks are JAX's own.

On CPUs JAX hands many systems at once to the same few threads that run its programs, and waits for them. Programs on
two devices then wait for each other for ever. So many systems are solved one after the other there, or, where they
come side by side (`side_by_side.py`), in vectors without LAPACK.
"""

import itertools
from functools import partial

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap

from jaxgrity.core.side_by_side import kept
from jaxgrity.core.types import AnyArray

BLOCK = 24
"""Rows of a block. OpenBLAS solves for 32 right-hand sides and more of 32 rows with threads."""
INVERTED_AT_ONCE = 30
"""Most rows of a matrix that LAPACK inverts in one thread."""
SOLVED_AT_ONCE = 96
"""Most rows with which LAPACK solves for one right-hand side in one thread."""
RIDGE = 1e-12
"""Added to the squares of a matrix whose columns have length one, so that columns that depend on others do no harm."""
ROUNDS = 8
"""Corrections of a least solution. They take the ridge's effect away where singular values are 1e-5 or more."""


@custom_vmap
def _lapack_inverse(matrix: AnyArray) -> AnyArray:
    return jnp.linalg.inv(matrix)


@_lapack_inverse.def_vmap
def _inverses(_: int, __: list[bool], matrices: AnyArray) -> tuple[AnyArray, bool]:
    one_by_one = partial(jax.lax.map, _lapack_inverse)
    return jax.lax.platform_dependent(matrices, cpu=one_by_one, default=jnp.linalg.inv), True


@custom_vmap
def _lapack_solution(matrix: AnyArray, right: AnyArray) -> AnyArray:
    return jnp.linalg.solve(matrix, right)


@_lapack_solution.def_vmap
def _solutions(count: int, batched: list[bool], matrices: AnyArray, rights: AnyArray) -> tuple[AnyArray, bool]:
    systems = [x if many else jnp.broadcast_to(x, (count, *x.shape)) for x, many in zip((matrices, rights), batched)]
    one_by_one = lambda *both: jax.lax.map(lambda each: _lapack_solution(*each), both)  # noqa: E731
    at_once = lambda many, right: jnp.linalg.solve(many, right[..., None])[..., 0]  # noqa: E731
    return jax.lax.platform_dependent(*systems, cpu=one_by_one, default=at_once), True


@jax.custom_jvp
def _small_inverse(matrix: AnyArray) -> AnyArray:
    return _lapack_inverse(matrix)


@_small_inverse.defjvp
def _derivative_of_inverse(matrices: tuple[AnyArray], changes: tuple[AnyArray]) -> tuple[AnyArray, AnyArray]:
    found = _small_inverse(*matrices)
    return found, -found @ changes[0] @ found


def inverse_of(matrix: AnyArray) -> AnyArray:
    """The inverse of a symmetric positive definite matrix, or of many side by side, (rows, rows, systems...)."""
    size = len(matrix)
    if matrix.ndim > 2:
        one = jnp.eye(size, dtype=matrix.dtype).reshape(size, size, *[1] * (matrix.ndim - 2))
        return _solved_side_by_side(matrix, jnp.broadcast_to(one, matrix.shape))
    if size <= INVERTED_AT_ONCE:
        return _small_inverse(matrix)
    # the matrix is definite, so that halves need no pivots
    half = size // 2
    # by the inverse of one half, and of what it leaves of the other
    first = inverse_of(matrix[:half, :half])
    across = first @ matrix[:half, half:]
    second = inverse_of(matrix[half:, half:] - matrix[half:, :half] @ across)
    corner = -across @ second
    return jnp.block([[first - corner @ across.T, corner], [corner.T, second]])


def solution(matrix: AnyArray, right: AnyArray) -> AnyArray:
    """x with matrix @ x = right, (rows,), or (rows, systems...) of many systems side by side.

    Pivots are chosen within blocks only; one round of refinement makes up for the lost accuracy.
    """
    if right.ndim > 1:
        return _solved_side_by_side(matrix, right[:, None])[:, 0]
    if len(matrix) <= SOLVED_AT_ONCE:
        solve = lambda _, b: _lapack_solution(matrix, b)  # noqa: E731
        transposed = lambda _, b: _lapack_solution(matrix.T, b)  # noqa: E731
        return jax.lax.custom_linear_solve(partial(jnp.matmul, matrix), right, solve, transposed)
    eliminated = _eliminated(matrix)
    x = _substituted(eliminated, right)
    return x + _substituted(eliminated, right - matrix @ x)


def _solved_side_by_side(matrices: AnyArray, rights: AnyArray) -> AnyArray:
    """x, (rows, columns, systems...), with matrices @ x = rights: Crout's elimination with the pivots of LAPACK.

    Rows stay in their places: weights, 1 for the pivot's row and 0 for others, pick it in each system. Quotients, and
    rows that are taken off in the next turn of the loop, keep XLA from computing anew for each use what is used often.
    """
    size, dtype = len(matrices), matrices.dtype
    numbers = jnp.arange(size).reshape(size, *[1] * (matrices.ndim - 2))

    def column(carry, k):
        rest, left, factors, own = carry
        rest = rest - factors[:, None] * own
        factors = left * rest[:, k]
        chosen, pivot = _largest(jnp.where(left > 0, jnp.abs(factors), -1), factors)
        at = kept((numbers == chosen).astype(dtype))
        own = sum(at[row] * rest[row] for row in range(size)) / pivot
        left = left * (1 - at)
        return (rest, left, left * factors, own), own

    both = jnp.concatenate([matrices, rights], axis=1)
    start = both, jnp.ones_like(rights[:, 0]), jnp.zeros_like(rights[:, 0]), jnp.zeros_like(both[0])
    upper = jax.lax.scan(column, start, jnp.arange(size))[1]

    def substituted(j, x):
        k = size - 1 - j
        return x - jnp.where(numbers[:, None] < k, upper[:, k][:, None] * x[k], 0)

    return jax.lax.fori_loop(0, size - 1, substituted, upper[:, size:])


def _largest(sizes: AnyArray, values: AnyArray) -> tuple[AnyArray, AnyArray]:
    """The number of the row, the first of equals, with the largest size in each system, and its value."""
    largest, chosen, value = sizes[0], jnp.zeros_like(sizes[0]), values[0]
    for row in range(1, len(sizes)):
        more = sizes[row] > largest
        largest, chosen = jnp.where(more, sizes[row], largest), jnp.where(more, row, chosen)
        value = jnp.where(more, values[row], value)
    return kept(chosen), kept(value)


def least_solution(matrix: AnyArray, right: AnyArray) -> AnyArray:
    """The least squares solution of matrix @ x = right, (columns,); of several a short one.

    It is linear in `right`, for derivatives in both modes, and starts no thread for many right-hand sides either. The
    matrix may be singular. Residuals have weights: the inverse lengths of rows.
    """
    if not matrix.shape[1]:
        return matrix.T @ right
    rows = _inverse_lengths(matrix.T)
    scaled = rows[:, None] * matrix
    columns = _inverse_lengths(scaled)
    scaled = scaled * columns
    ridge = max(RIDGE, 10 * float(jnp.finfo(matrix.dtype).eps))
    squared = _eliminated(scaled.T @ scaled + ridge * jnp.eye(matrix.shape[1], dtype=matrix.dtype))
    missed = rows * right
    x = _substituted(squared, missed @ scaled)
    for _ in range(ROUNDS):
        x = x + _substituted(squared, (missed - scaled @ x) @ scaled)
    return columns * x


def _inverse_lengths(matrix: AnyArray) -> AnyArray:
    """Of the columns, (columns,); 1 where one is zero."""
    squares = jax.lax.stop_gradient(jnp.sum(matrix * matrix, axis=0))
    return jnp.where(squares > 0, jax.lax.rsqrt(jnp.where(squares > 0, squares, 1)), 1)


def _blocks(size: int) -> list[slice]:
    count = -(-size // BLOCK)
    edges = [size * k // count for k in range(count + 1)]
    return [slice(*ends) for ends in itertools.pairwise(edges)]


def _eliminated(matrix: AnyArray) -> list[tuple[AnyArray, AnyArray, AnyArray]]:
    """For each block of rows: its inverse, the part right of it, and its factors in the rows below."""
    found, rest = [], matrix
    for block in _blocks(len(matrix)):
        size = block.stop - block.start
        own = _small_inverse(rest[:size, :size])
        right, below = rest[:size, size:], rest[size:, :size] @ own
        found.append((own, right, below))
        rest = rest[size:, size:] - below @ right
    return found


def _substituted(eliminated: list[tuple[AnyArray, AnyArray, AnyArray]], right: AnyArray) -> AnyArray:
    parts, rest = [], right
    for own, _, below in eliminated:
        part, rest = rest[: len(own)], rest[len(own) :]
        parts.append(part)
        rest = rest - below @ part
    # no rows yet, of the same type as the right side
    x = jax.lax.slice(right, (0,), (0,))
    for (own, across, _), part in zip(reversed(eliminated), reversed(parts)):
        x = jnp.concatenate([own @ (part - across @ x), x])
    return x
