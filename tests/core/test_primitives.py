"""The linear maps that U and R are made of: sums over members, rows taken and placed, for one robot and for many."""

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxgrity import InputError
from jaxgrity.core.primitives import accumulate, edge_vectors, place_rows, store_cotangent, take_rows
from jaxgrity.stepping.blocks import largest

NODES = 6
pairs = st.tuples(st.integers(0, NODES - 1), st.integers(0, NODES - 1)).filter(lambda pair: pair[0] != pair[1])


@pytest.mark.slow
@given(st.lists(pairs, min_size=1, max_size=12, unique=True), st.integers(0, 99))
def test_one_robot_and_a_population_sum_alike(edges, seed):
    """By the transpose of the difference."""
    edges = tuple(edges)
    f = np.random.default_rng(seed).normal(size=(len(edges), 3, 4))
    incidence = np.zeros((len(edges), NODES))
    for k, (i, j) in enumerate(edges):
        incidence[k, i], incidence[k, j] = 1, -1
    expected = np.einsum("en,ekp->nkp", incidence, f)
    many = jax.vmap(lambda f: accumulate(f, edges, NODES), in_axes=-1, out_axes=-1)(f)
    np.testing.assert_allclose(many, expected, atol=1e-14)
    np.testing.assert_allclose(accumulate(f[..., 0], edges, NODES), expected[..., 0], atol=1e-14)
    x = np.random.default_rng(seed).normal(size=(NODES, 3))
    np.testing.assert_allclose(edge_vectors(x, edges), incidence @ x, atol=1e-15)


@given(st.lists(st.integers(0, NODES - 1), min_size=1, max_size=9))
def test_rows_may_repeat(rows):
    """Taking a row twice gives both cotangents back to it, in order or not, for one robot and for a population."""
    rows = tuple(rows)
    chosen = np.zeros((len(rows), NODES))
    chosen[np.arange(len(rows)), rows] = 1
    x = np.random.default_rng(0).normal(size=(NODES, 3))
    y, back = jax.vjp(lambda x: take_rows(x, rows), x)
    np.testing.assert_array_equal(y, chosen @ x)
    np.testing.assert_allclose(back(y)[0], chosen.T @ chosen @ x, rtol=1e-14, atol=1e-14)


@pytest.mark.parametrize("kind", [tuple, list, np.array, jnp.array])
def test_rows_and_edges_may_be_arrays(kind):
    """Or lists, of whole numbers that are known."""
    x = np.random.default_rng(0).normal(size=(NODES, 3))
    np.testing.assert_array_equal(take_rows(x, kind([4, 0])), x[[4, 0]])
    np.testing.assert_array_equal(place_rows(x[:2], kind([4, 4]), NODES)[4], x[0] + x[1])
    np.testing.assert_array_equal(edge_vectors(x, kind([(4, 0), (1, 2)])), x[[4, 1]] - x[[0, 2]])
    with pytest.raises(InputError, match="there is no row 6; expected 0 to 5"):
        take_rows(x, kind([0, 6]))


@pytest.mark.parametrize("rows", [np.array([0.0]), np.array([[0, 1]]), np.array([True]), 0, (1.5,), (), []])
def test_rows_are_whole_numbers(rows):
    """At least one."""
    jaxtyping.config.update("jaxtyping_disable", True)  # of this test alone: conftest.py sets it anew for each
    for make in (lambda: take_rows(np.ones((NODES, 3)), rows), lambda: place_rows(np.ones((1, 3)), rows, NODES)):
        with pytest.raises(InputError, match=r"rows = .*: expected whole numbers, such as \(0, 1\)"):
            make()


@pytest.mark.parametrize(
    ("edges", "message"),
    [
        (((0, 6),), r"edges\[0\] = \[0, 6\]: expected two nodes from 0 to 5"),
        (((0, 1), (-1, 2)), r"edges\[1\] = \[-1, 2\]: expected two nodes from 0 to 5"),
        ([[0, 1.5]], r"edges\[0\] = \[0.0, 1.5\]: expected two nodes from 0 to 5"),
        (((0, 1, 2),), r"edges have shape \(1, 3\); expected \(members, 2\)"),
        ((), "edges: there are none; expected at least one"),
    ],
)
def test_edges_join_nodes_that_there_are(edges, message):
    jaxtyping.config.update("jaxtyping_disable", True)
    for make in (lambda: edge_vectors(np.ones((NODES, 3)), edges), lambda: accumulate(np.ones((1, 3)), edges, NODES)):
        with pytest.raises(InputError, match=message):
            make()


def test_what_is_placed_has_places():
    jaxtyping.config.update("jaxtyping_disable", True)
    for make, message in (
        (
            lambda: accumulate(np.ones((2, 3)), ((0, 1),), NODES),
            "accumulate has 2 vectors and 1 edges; expected as many",
        ),
        (lambda: accumulate(np.ones((1, 3)), ((0, 1),), 1.5), "nodes = 1.5: expected a whole number, at least 1"),
        (lambda: place_rows(np.ones((2, 3)), (1,), NODES), "place_rows has 2 rows for 1 places; expected as many"),
        (lambda: place_rows(np.ones((1, 3)), (0,), 2.5), "size = 2.5: expected a whole number, at least 1"),
    ):
        with pytest.raises(InputError, match=message):
            make()


def test_stored_cotangents_are_the_same():
    """To the bit, in both modes and in second derivatives, also where they are not finite; by a quotient."""
    x = jnp.array([1.5, -2.0, 1e300, 3e-310])
    cubes = lambda x: store_cotangent(x) ** 3  # noqa: E731
    y, back = jax.vjp(cubes, x)
    np.testing.assert_array_equal(y, x**3)
    for cotangent in (jnp.array([1.0, -0.3, 0.0, 1e10]), jnp.array([jnp.nan, jnp.inf, 1.0, -0.0])):
        np.testing.assert_array_equal(back(cotangent)[0], jax.vjp(lambda x: x**3, x)[1](cotangent)[0])
    compiled = jax.jit(jax.grad(lambda x: cubes(x).sum())).lower(x).compile().as_text()
    assert compiled.count(" divide(") == 1
    np.testing.assert_array_equal(jax.jvp(cubes, (x,), (y,))[1], 3 * x**2 * y)
    np.testing.assert_array_equal(jax.hessian(lambda x: cubes(x).sum())(x[:2]), jnp.diag(6 * x[:2]))


@pytest.mark.parametrize("count", [1, 2, 3, 5, 9])
def test_the_largest_of_some_numbers(count):
    """However many there are and wherever it is, for one robot and for many at once."""
    x = np.random.default_rng(0).normal(size=(count, 100))
    x[:, :3] = -1.0
    many = jax.jit(jax.vmap(largest, in_axes=-1, out_axes=-1))
    np.testing.assert_array_equal(many(x), x.max(0))
    one = jax.jit(largest)
    np.testing.assert_array_equal([one(column) for column in x.T[:20]], x.max(0)[:20])
