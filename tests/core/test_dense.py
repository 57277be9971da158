"""Least solutions against those by singular values, and derivatives that leave LAPACK's threads alone."""

import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrity import (
    ConeFriction,
    ExactGround,
    Members,
    Scene,
    SolverOptions,
    Structure,
    as_dtype,
    edge_lengths,
    rollout,
)
from jaxgrity.core.dense import INVERTED_AT_ONCE, inverse_of, least_solution, solution
from jaxgrity.stepping import resolve
from jaxgrity.structures import tetrahedral_spine


@pytest.mark.slow
@pytest.mark.parametrize(
    ("size", "rank", "condition"),
    [(20, 20, 1e3), (60, 45, 1e3), pytest.param(120, 120, 1e6, marks=pytest.mark.campaign)],
)
def test_least_solutions_are_those_by_singular_values(size, rank, condition):
    """Where columns depend on each other, what they make is the same; the transposed system likewise."""
    random = np.random.default_rng(0)
    left, right = (np.linalg.qr(random.normal(size=(size, size)))[0] for _ in range(2))
    values = np.where(np.arange(size) < rank, np.geomspace(1, 1 / condition, size), 0)
    matrix = (left * values) @ right.T
    for M, solve in (
        (matrix, lambda A, b: least_solution(A, b)),
        (matrix.T, lambda A, b: jax.linear_transpose(lambda c: least_solution(A, c), b)(b)[0]),
    ):
        wanted = M @ random.normal(size=size)
        found = jax.jit(solve)(matrix, wanted)
        np.testing.assert_allclose(M @ found, wanted, rtol=0, atol=1e-13)
        if rank == size:
            np.testing.assert_allclose(found, np.linalg.pinv(M, rcond=1e-12) @ wanted, rtol=0, atol=1e-8)


def end_of(scene, push):
    options = resolve(scene, 4e-3, SolverOptions(dt=2e-3, any_step=True, coupled=True))
    weights = jnp.cos(jnp.arange(scene.structure.nodes.size))

    def end(gravity):
        there = eqx.tree_at(lambda s: s.gravity, scene, gravity)
        start = (there.structure.nodes, jnp.broadcast_to(jnp.asarray(push), there.structure.nodes.shape))
        return weights @ rollout(there, np.array([0.0, 4e-3]), start=start, options=options).velocities[-1].ravel()

    return end


def standing(nodes, struts) -> Scene:
    nodes = np.asarray(nodes, float)
    members = Members(struts, None, edge_lengths(nodes, struts))
    structure = Structure(nodes, np.full(len(nodes), 0.1), members)
    return as_dtype(Scene(structure, 9.81, ground=ExactGround(), friction=ConeFriction(0.5)), "float64")


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="other devices solve many systems at once")
@pytest.mark.parametrize("solve", [lambda m, b: inverse_of(m) @ b, solution])
def test_many_systems_are_solved_one_by_one(solve):
    """JAX would hand them to threads that may all be waiting for the same: programs on two devices then never end."""
    rng = np.random.default_rng(0)
    matrices, rights = rng.normal(size=(5, 12, 12)) + 9 * np.eye(12), rng.normal(size=(5, 12))
    many = jax.jit(jax.vmap(solve))
    np.testing.assert_allclose(many(matrices, rights), [np.linalg.solve(*each) for each in zip(matrices, rights)])
    shared = jax.jit(jax.vmap(solve, in_axes=(None, 0)))(matrices[0], rights)
    np.testing.assert_allclose(shared, np.linalg.solve(matrices[0], rights.T).T)
    calls = [line for line in many.lower(matrices, rights).compile().as_text().splitlines() if '"lapack' in line]
    ranks = [shape.count(",") + 1 for line in calls for shape in re.findall(r"f64\[([\d,]+)\]", line)]
    assert ranks
    assert max(ranks) == 2


def test_derivatives_of_many_solutions_are_those_of_differences():
    """In both modes, and a second time."""
    rng = np.random.default_rng(1)
    matrices, rights = rng.normal(size=(3, 6, 6)) + 9 * np.eye(6), rng.normal(size=(3, 6))
    found = lambda m, b: jnp.sum(jnp.sin(solution(m, b))) + jnp.sum(jnp.cos(inverse_of(m)))  # noqa: E731
    known = lambda m, b: jnp.sum(jnp.sin(jnp.linalg.inv(m) @ b)) + jnp.sum(jnp.cos(jnp.linalg.inv(m)))  # noqa: E731
    for derivative in (jax.grad, jax.jacfwd, lambda f: jax.hessian(f, 1)):
        ours = jax.jit(jax.vmap(derivative(found)))(matrices, rights)
        of_each = jax.jit(derivative(known))
        theirs = np.stack([of_each(*each) for each in zip(matrices, rights)])
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-12)


@pytest.mark.campaign
def test_derivatives_solve_no_system_by_threads():
    """Of 48 nodes and 72 struts: each matrix that LAPACK gets, in either mode, is one it works on in one thread."""
    nodes, struts, _ = tetrahedral_spine(12)
    end = end_of(standing(nodes, struts), [0.0, 0.0, 0.0])
    for derivative in (jax.grad(end), lambda g: jax.jvp(end, (g,), (1.0,))):
        text = jax.jit(derivative).lower(9.81).as_text()
        sizes = []
        for line in text.splitlines():
            if "@lapack" in line:
                shape = re.search(r": \(tensor<([\dx]+)xf64>", line)
                sizes.append(max(int(n) for n in shape[1].split("x")[-2:]))
        assert sizes
        assert max(sizes) <= INVERTED_AT_ONCE


@pytest.mark.campaign
def test_derivatives_where_struts_are_redundant():
    """Ten struts between five nodes that slide on the ground: the tenth changes nothing of what the first nine do.

    Of the nine differences tell as much. The ten keep their lengths to 1e-8, and differences of them are that rough.
    """
    nodes = [[0, 0, 0], [1, 0, 0], [0.4, 1, 0], [0.5, 0.4, 1.0], [0.6, 0.5, 0.4]]
    struts = tuple((i, j) for i in range(5) for j in range(i))
    ten, nine = (end_of(standing(nodes, some), [1.0, 0.3, 0.0]) for some in (struts, struts[:-1]))
    known, h = jax.jit(nine), 0.1
    difference = (known(9.81 + h) - known(9.81 - h)) / (2 * h)
    assert abs(difference) > 1e-3
    end, derivative = jax.jit(jax.value_and_grad(ten))(9.81)
    assert float(known(9.81)) == pytest.approx(float(end), abs=1e-7)
    assert float(derivative) == pytest.approx(float(difference), rel=1e-6)
