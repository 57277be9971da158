"""Systems side by side, in a last axis, against one after the other."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrity.core.dense import inverse_of, solution
from jaxgrity.core.side_by_side import applied, contracted, where_needed, while_any


def many_systems(size, condition):
    """(size, size, 5), with singular values down to 1/condition; the first has zeros where pivots would be."""
    rng = np.random.default_rng(size)
    sides = np.linalg.qr(rng.normal(size=(2, 5, size, size)))[0]
    found = sides[0] * np.geomspace(1, 1 / condition, size) @ sides[1]
    found[0] = np.roll(np.diag(np.geomspace(1, 1 / condition, size)), 1, axis=0)
    return np.moveaxis(found, 0, -1), rng.normal(size=(size, 5))


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize(("size", "condition"), [(1, 1), (6, 10), (6, 1e9), (12, 1e5)])
def test_solutions_side_by_side_are_as_accurate_as_one_by_one(size, condition, dtype):
    """What is left of the right side is rounding of matrix times solution, however badly the system is conditioned."""
    matrices, rights = (jnp.asarray(x, dtype) for x in many_systems(size, condition))
    found = np.asarray(jax.jit(solution)(matrices, rights))
    assert found.dtype == dtype
    for matrix, right, x in zip(np.moveaxis(np.asarray(matrices), -1, 0), np.asarray(rights).T, found.T):
        left = np.abs(matrix.astype(float) @ x - right)
        assert np.all(left <= 4 * size * np.finfo(dtype).eps * (np.abs(matrix).sum(1).max() * np.abs(x).max()))


def test_inverses_side_by_side_are_those_one_by_one():
    rng = np.random.default_rng(0)
    sides = rng.normal(size=(3, 6, 9))
    matrices = np.moveaxis(sides @ sides.swapaxes(1, 2), 0, -1)
    alone = np.stack([np.linalg.inv(matrix) for matrix in np.moveaxis(matrices, -1, 0)], -1)
    np.testing.assert_allclose(jax.jit(inverse_of)(jnp.asarray(matrices)), alone, rtol=1e-10)


def test_a_singular_system_harms_none_beside_it():
    matrices, rights = many_systems(6, 10)
    wanted = np.linalg.solve(matrices[..., 1], rights[:, 1])
    matrices[2, :, 0] = 0
    matrices[1, :, 2] = np.nan
    found = np.asarray(jax.jit(solution)(jnp.asarray(matrices), jnp.asarray(rights)))
    assert not np.isfinite(found[:, [0, 2]]).all(0).any()
    np.testing.assert_allclose(found[:, 1], wanted, rtol=1e-12)


@pytest.mark.parametrize(
    ("axes", "a", "b"),
    [
        ("ij,j->i", (3, 4), (4,)),
        ("ij,j->i", (2, 90), (90,)),
        ("ij,j->i", (2, 0), (0,)),
        ("iak,ikjl->iajl", (2, 3, 3), (2, 3, 2, 3)),
        ("iajl,jbl->iajb", (2, 3, 2, 3), (2, 3, 3)),
        ("bakj,kj->ba", (2, 3, 4, 3), (4, 3)),
        ("na,na->", (2, 3), (2, 3)),
    ],
)
def test_sums_of_products_side_by_side_are_those_one_by_one(axes, a, b):
    rng = np.random.default_rng(0)
    a, b = (jnp.asarray(rng.normal(size=(*shape, 5))) for shape in (a, b))
    alone = [np.einsum(axes, a[..., k], b[..., k]) for k in range(5)]
    np.testing.assert_allclose(contracted(axes, a, b), np.stack(alone, -1), rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(contracted(axes, a[..., 0], b[..., 0]), alone[0], rtol=1e-12, atol=1e-14)


def test_a_vector_in_rows_is_multiplied_in_rows():
    rng = np.random.default_rng(0)
    matrix, x = rng.normal(size=(6, 6, 5)), rng.normal(size=(2, 3, 5))
    wanted = np.einsum("ijn,jn->in", matrix, x.reshape(6, 5)).reshape(x.shape)
    np.testing.assert_allclose(applied(jnp.asarray(matrix), jnp.asarray(x)), wanted, rtol=1e-12)


def test_each_system_stays_once_it_is_done():
    """Also where further systems are mapped by JAX."""
    halved = lambda x: while_any(lambda x: x > 1, lambda x: x / 2, x)  # noqa: E731
    x = jnp.array([0.7, 3.0, 20.0])
    wanted = [0.7, 0.75, 0.625]
    np.testing.assert_array_equal(halved(x), wanted)
    np.testing.assert_array_equal(jax.vmap(halved)(x), wanted)
    np.testing.assert_array_equal(where_needed(x > 1, lambda: -x, x), [0.7, -3.0, -20.0])


def test_what_no_system_needs_is_not_computed():
    calls = []

    def compute():
        jax.debug.callback(lambda: calls.append(1))
        return jnp.zeros(3)

    jax.jit(lambda needed: where_needed(needed, compute, jnp.ones(3)))(jnp.zeros(3, bool))
    jax.effects_barrier()
    assert not calls
