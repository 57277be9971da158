"""The few linear and bilinear maps of U and R, as JAX primitives that keep the population last.

JAX's own batching rules move a mapped axis to the front, where the inner loops over xyz and the gathers of a CPU
program cannot be vectorised. The primitives here have jvp, transpose and batching rules that leave it last in memory,
so that energies written for one robot stay fast under plain `jax.vmap(..., in_axes=-1, out_axes=-1)` and `jax.grad`.
Elementwise arithmetic keeps the layout as long as every operand has the population axis (`populations/lanes.py`).
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax.interpreters import ad

from jaxgrity.core.arguments import check_count
from jaxgrity.core.errors import InputError
from jaxgrity.core.making_primitives import linear_pair, primitive
from jaxgrity.core.typed import check_same_shape, known_edges, known_rows
from jaxgrity.core.types import (
    AnyArray,
    AnyMemberVectors,
    AnyPerMember,
    AnyRows,
    Edges,
    MemberVectors,
    Mobility,
    NodeVectors,
    PerMember,
    Rows,
    Scalar,
)


def _ends(edges: Edges) -> np.ndarray:
    return np.asarray(edges, int).reshape(-1, 2).T


def _difference(x, *, edges, nodes):
    i, j = _ends(edges)
    return x[i] - x[j]


def _accumulate(f, *, edges, nodes):
    given: list[list[tuple[int, int]]] = [[] for _ in range(nodes)]
    for k, (i, j) in enumerate(zip(*_ends(edges))):
        given[i].append((k, 1))
        given[j].append((k, -1))
    return _gather(f, given)


def _gather(x, given):
    """Row n of the result is the sum of sign·x[k] over the (k, sign) in given[n].

    No scatter: it is slow on GPUs, and splits a CPU's loop into several kernels. Every row has as many terms as the
    longest, so a hub of many members costs at all nodes.
    """
    most = max(map(len, given))
    table = np.array([rows + [(0, 0)] * (most - len(rows)) for rows in given]).swapaxes(0, 1)
    signs = table[..., 1].astype(x.dtype).reshape(most, len(given), *[1] * (x.ndim - 1))
    return sum(x[rows] * sign for rows, sign in zip(table[..., 0], signs))


def _component(x, *, direction):
    return sum(x[:, k] if n == 1 else n * x[:, k] for k, n in enumerate(direction) if n)


def _extend(s, *, direction):
    return s[:, None] * np.asarray(direction, s.dtype).reshape(1, 3, *[1] * (s.ndim - 1))


def _take(x, *, rows, size):
    return x[rows[0] : rows[-1] + 1] if _adjacent(rows) else x[np.asarray(rows)]


def _place(x, *, rows, size):
    if _adjacent(rows):
        return jnp.pad(x, [(rows[0], size - rows[-1] - 1)] + [(0, 0)] * (x.ndim - 1))
    given: list[list[tuple[int, int]]] = [[] for _ in range(size)]
    for k, row in enumerate(rows):
        given[row].append((k, 1))
    return _gather(x, given)


def _adjacent(rows):
    return rows == tuple(range(rows[0], rows[-1] + 1))


_difference_p = primitive("edge_difference", _difference)
_accumulate_p = primitive("edge_accumulate", _accumulate)
_component_p = primitive("component", _component)
_extend_p = primitive("extend", _extend)
_take_p = primitive("take_rows", _take)
_place_p = primitive("place_rows", _place)
_dot_p = primitive("dot", lambda a, b: a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2])
_scale_p = primitive("scale", lambda a, s: a * s[:, None])
_inner_p = primitive("inner", lambda a, b: jnp.sum(a * b, axis=0))
_weigh_p = primitive("weigh", lambda a, s: a * s)
_respond_p = primitive("respond", lambda a, f, *, of: jnp.sum(a * jnp.expand_dims(f, of), axis=1 - of))
_outer_p = primitive("outer", lambda a, b: a[:, None] * b[None])
_ones_p = primitive("ones", jnp.ones_like)
_lie_p = primitive("population_last", lambda x: x)
_same_p = primitive("same", lambda x: x)
_stored_p = primitive("stored", lambda x: x / (x == x).astype(x.dtype))

linear_pair(_difference_p, _accumulate_p)
linear_pair(_component_p, _extend_p)
linear_pair(_take_p, _place_p)
linear_pair(_lie_p, _lie_p)
linear_pair(_same_p, _stored_p)
ad.defbilinear(_dot_p, lambda ct, a, b: _scale_p.bind(b, ct), lambda ct, a, b: _scale_p.bind(a, ct))
ad.defbilinear(_scale_p, lambda ct, a, s: _scale_p.bind(ct, s), lambda ct, a, s: _dot_p.bind(ct, a))
ad.defbilinear(_inner_p, lambda ct, a, b: _weigh_p.bind(b, ct), lambda ct, a, b: _weigh_p.bind(a, ct))
ad.defbilinear(
    _respond_p,
    lambda ct, a, f, of: _outer_p.bind(*((ct, f) if of == 0 else (f, ct))),
    lambda ct, a, f, of: _respond_p.bind(a, ct, of=1 - of),
)
ad.defbilinear(_outer_p, lambda ct, a, b: _respond_p.bind(ct, b, of=0), lambda ct, a, b: _respond_p.bind(ct, a, of=1))
ad.defbilinear(_weigh_p, lambda ct, a, s: _weigh_p.bind(ct, s), lambda ct, a, s: _inner_p.bind(ct, a))


def edge_vectors(x: NodeVectors, edges: Edges | Sequence | AnyArray) -> MemberVectors:
    """x_i - x_j for each edge (i, j). Its transpose sums member forces onto the nodes."""
    return _difference_p.bind(x, edges=known_edges(edges, x.shape[0]), nodes=x.shape[0])


def accumulate(f: MemberVectors, edges: Edges | Sequence | AnyArray, nodes: int) -> NodeVectors:
    """The transpose of `edge_vectors`: adds f_k to the first node of edge k, and takes it from the second."""
    edges = known_edges(edges, check_count("nodes", nodes, 1))
    if len(edges) != len(f):
        raise InputError(f"primitives.accumulate has {len(f)} vectors and {len(edges)} edges; expected as many")
    return _accumulate_p.bind(f, edges=edges, nodes=nodes)


def component(x: NodeVectors, direction: tuple[float, float, float] | AnyArray) -> PerMember:
    """n·x for each row of `x`: along one direction n, a constant or an array (3,), or along one for each row."""
    if isinstance(direction, tuple):
        return _component_p.bind(x, direction=direction)
    if np.ndim(direction) == 1:
        direction = along(ones(component(x, (1.0, 0.0, 0.0))), direction)
    return dot(x, direction)


def along(s: PerMember, direction: tuple[float, float, float] | AnyArray) -> NodeVectors:
    """s n for each entry of `s`: along one direction n, a constant or an array (3,), or along one for each entry."""
    if isinstance(direction, tuple):
        return _extend_p.bind(s, direction=direction)
    return scale(direction, s) if direction.ndim == 2 else _outer_p.bind(s, direction)


def take_rows(x: AnyRows, rows: Sequence[int] | AnyArray) -> Rows:
    """The chosen rows of `x`, each as often as chosen."""
    return _take_p.bind(x, rows=known_rows(rows, x.shape[0]), size=x.shape[0])


def place_rows(x: Rows, rows: Sequence[int] | AnyArray, size: int) -> AnyRows:
    """The transpose of `take_rows`: `size` rows, each the sum of the rows of `x` placed there."""
    known = known_rows(rows, check_count("size", size, 1))
    if len(known) != len(x):
        raise InputError(f"primitives.place_rows has {len(x)} rows for {len(known)} places; expected as many")
    return _place_p.bind(x, rows=known, size=size)


def dot(a: AnyMemberVectors, b: AnyMemberVectors) -> AnyPerMember:
    """a·b, row by row."""
    check_same_shape("dot", a, b)
    return _dot_p.bind(a, b)


def scale(a: MemberVectors, s: PerMember) -> MemberVectors:
    """s a, row by row: vectors first, (n, 3), then a number for each, (n,)."""
    if np.ndim(a) != np.ndim(s) + 1 or np.shape(a)[:1] != np.shape(s)[:1]:
        raise InputError(f"primitives.scale has arrays {np.shape(a)}, {np.shape(s)}; expected (n, 3), then (n,)")
    return _scale_p.bind(a, s)


def inner(a: PerMember | Scalar, b: PerMember | Scalar) -> Scalar:
    """sum_k a_k b_k, the sum over members or nodes, from parts to an energy; one of them may be one number for all."""
    for one, each in ((a, b), (b, a)):
        if np.ndim(one) == 0 and np.ndim(each) == 1:
            return one * inner(ones(jnp.asarray(each)), each)
    check_same_shape("inner", a, b)
    return _inner_p.bind(a, b)


def ones(x: PerMember) -> PerMember:
    """1 for each entry of `x`, and for each robot where x differs: later operands of x keep its layout."""
    return _ones_p.bind(jax.lax.stop_gradient(x))


def population_last(x: AnyArray) -> AnyArray:
    """The same numbers with the population last, after an operation with a batching rule that moves it to the front."""
    return _lie_p.bind(x)


def store_cotangent(x: AnyArray) -> AnyArray:
    """x itself; in reverse mode its cotangent is stored, instead of computed anew for each use.

    It is divided by a 1 unknown to XLA, since XLA keeps quotients (see `over`).
    """
    return _same_p.bind(x)


def respond(a: Mobility, f: NodeVectors) -> NodeVectors:
    """sum_j a_ijk f_jk: a matrix for each of x, y and z, times the vectors of all nodes."""
    return _respond_p.bind(a, f, of=0)


@jax.custom_jvp
def half_squares(k: PerMember | Scalar, x: PerMember) -> Scalar:
    """sum k x^2/2 over members or nodes. Its derivative is one product, not two equal ones."""
    return inner(k * x, x) / 2


@half_squares.defjvp
def _half_squares_jvp(primals, tangents):
    (k, x), (k_dot, x_dot) = primals, tangents
    return half_squares(k, x), inner(k * x, x_dot) + inner(jnp.broadcast_to(k_dot, x.shape), x * x) / 2


# the rule of a bilinear map would make two products of x with its tangent
@jax.custom_jvp
def norm_squared(x: MemberVectors) -> PerMember:
    """|x|^2, row by row."""
    return dot(x, x)


@norm_squared.defjvp
def _norm_squared_jvp(primals, tangents):
    (x,), (x_dot,) = primals, tangents
    return norm_squared(x), dot(x + x, x_dot)


@jax.custom_jvp
def root(x: PerMember) -> PerMember:
    """The square root of x > 0. Its derivative is a quotient, kept by XLA (see `over`)."""
    return jnp.sqrt(x)


@root.defjvp
def _root_jvp(primals, tangents):
    (x,), (x_dot,) = primals, tangents
    value = root(x)
    return value, x_dot / (value + value)


@jax.custom_jvp
def length(d: AnyMemberVectors) -> AnyPerMember:
    """|d|, row by row. Its derivative at d = 0 is set to 0."""
    return jnp.sqrt(dot(d, d))


@length.defjvp
def _length_jvp(primals, tangents):
    (d,), (d_dot,) = primals, tangents
    value = length(d)
    return value, over(dot(d, d_dot), value)


def over(a: PerMember, b: PerMember) -> PerMember:
    """a/b, and a where b = 0, with finite derivatives there.

    A division, not a product with 1/b: XLA keeps a quotient, but computes a product anew for each use.
    """
    return a / (b + (b == 0).astype(b.dtype))


def inverse(x: PerMember) -> PerMember:
    """1/x for x > 0, and 0 at x = 0, with a finite derivative there."""
    positive = (x > 0).astype(x.dtype)
    return positive / (x + (1 - positive))


# JAX's rule for `maximum` chooses between arrays without the population axis, and moves it to the front
@jax.custom_jvp
def positive_part(x: AnyPerMember) -> AnyPerMember:
    """max(0, x), with derivative 0 at x = 0."""
    return jnp.maximum(x, 0)


@positive_part.defjvp
def _positive_part_jvp(primals, tangents):
    (x,), (x_dot,) = primals, tangents
    # what is not a number stays so: a slack cable would hide it
    return positive_part(x), (1 - jnp.greater_equal(0, x).astype(x.dtype)) * x_dot
