"""Equilibrium shapes and natural frequencies of springs, for which both are known in closed form."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrity import equilibrium, natural_frequencies

MASS = np.array([1.0, 2.0, 2.0])
STIFFNESS = 100.0


def chain(q):
    """U of two springs of 1 m, the first node tied to the second and this to the third."""
    lengths = jnp.linalg.norm(jnp.diff(q, axis=0), axis=1)
    return STIFFNESS / 2 * jnp.sum((lengths - 1) ** 2)


def straight(*x):
    return np.array([[value, 0.0, 0.0] for value in x])


def test_a_chain_vibrates_along_itself_and_floppily_across():
    """Two frequencies, by the roots of the characteristic polynomial; nothing resists bending it, in two directions."""
    found = natural_frequencies(chain, MASS, straight(0.0, 1.0, 2.0))
    inverse = np.diag(1 / MASS)
    matrix = STIFFNESS * inverse @ np.array([[1, -1, 0], [-1, 2, -1], [0, -1, 1]])
    expected = np.sqrt(np.sort(np.linalg.eigvals(matrix))[1:]) / (2 * np.pi)
    np.testing.assert_array_equal(found[:2], 0)
    np.testing.assert_allclose(found[2:], expected, rtol=1e-9)


def test_the_modes_of_stiff_springs_are_left_out():
    """Those highest of all."""
    all_of_them = natural_frequencies(chain, MASS, straight(0.0, 1.0, 2.0))
    np.testing.assert_array_equal(natural_frequencies(chain, MASS, straight(0.0, 1.0, 2.0), 1), all_of_them[:-1])


def test_the_equilibrium_is_where_no_force_is_left():
    """Springs relax to their lengths; where nothing does, there is none."""
    found = equilibrium(chain, straight(0.0, 0.7, 2.1), tolerance=1e-9)
    np.testing.assert_allclose(np.linalg.norm(np.diff(found, axis=0), axis=1), 1, rtol=1e-9)
    assert equilibrium(lambda q: jnp.sum(q), straight(0.0, 1.0), tolerance=1e-9) is None


@pytest.mark.parametrize("share", [1e-10, 1e-8])
def test_what_only_rounding_tells_from_zero_counts_as_zero(share):
    """A spring across the chain, weaker than the chain's by so much: below 1e-9 it cannot be told from rounding."""

    def held(q):
        return chain(q) + share * STIFFNESS / 2 * (q[1, 1] - (q[0, 1] + q[2, 1]) / 2) ** 2

    found = natural_frequencies(held, MASS, straight(0.0, 1.0, 2.0))
    assert (found[:2] > 0).tolist() == [False, share > 1e-9]
