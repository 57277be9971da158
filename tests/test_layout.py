"""What is compiled: sums over members without scatters, chunks that fit the cache; and a tower of any size."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tower import tower

from jaxgrity.model.actuation import Gait
from jaxgrity.stepping.dynamics import vector_field
from jaxgrity.rollout.population import in_lanes, most_lanes, over_lanes
from jaxgrity.core.primitives import accumulate, edge_vectors, take_rows
from jaxgrity.model.scene import as_dtype, with_gait
from jaxgrity.stepping.simulate import settle, simulate
from jaxgrity.stepping.stability import default_method, default_step
from jaxgrity.model.structure import member_vectors, onto_nodes

NODES = 6
pairs = st.tuples(st.integers(0, NODES - 1), st.integers(0, NODES - 1)).filter(lambda pair: pair[0] != pair[1])


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


def test_forces_of_kinds_go_where_their_members_are(reference):
    """`onto_nodes` is the transpose of `member_vectors`, for struts and cables together."""
    kinds = reference.structure.kinds
    random = np.random.default_rng(0)
    x = random.normal(size=(12, 3))
    forces = {name: random.normal(size=(len(members.edges), 3)) for name, members in kinds.items()}
    stretched = member_vectors(x, kinds)
    work = sum(float(jnp.sum(forces[name] * stretched[name])) for name in kinds)
    np.testing.assert_allclose(float(jnp.sum(x * onto_nodes(forces, kinds, 12))), work, rtol=1e-13)


@pytest.mark.parametrize("platform", ["cpu", "cuda"])
@pytest.mark.parametrize("members", [(0, 1, 2, 3, 4, 5), (1, 7, 20)])
def test_no_scatter(reference, platform, members):
    """In the vector field of a population, lowered for each platform; neither has to be there."""
    some = np.ones(len(members))
    scene = as_dtype(with_gait(reference, Gait(members, some, some, some)), "float32")
    rows = jnp.ones((len(members), 8), "float32")
    mapped, axes = in_lanes(scene, _in_rows(scene.gait, rows))
    field = jax.jit(lambda q, s: over_lanes(vector_field, (None, -1, axes))(jnp.float32(1.5), (q, q), s))
    text = field.trace(mapped.structure.nodes, mapped).lower(lowering_platforms=(platform,)).as_text()
    assert "stablehlo.gather" in text
    assert "stablehlo.scatter" not in text


@pytest.mark.parametrize(("struts", "dtype", "lanes"), [(6, "float64", 128), (600, "float32", 32), (60, "float64", 64)])
def test_chunks_shrink_as_structures_grow(struts, dtype, lanes):
    scene = tower(struts, exact=False)
    assert most_lanes(scene, settle(scene, 1.0, "rk4", 1e-4, dtype, any_step=True)) == lanes


@pytest.mark.parametrize("exact", [False, True])
def test_tower_stands(exact):
    """Four prisms, for a second at the default step: nothing fails, and no strut changes by a tenth."""
    scene = tower(12, exact)
    trajectory = simulate(scene, 1.0, dt=default_step(scene, default_method(scene)))
    assert not trajectory.failed
    q, struts = np.asarray(trajectory.positions[-1]), scene.structure.struts
    lengths = np.linalg.norm([q[i] - q[j] for i, j in struts.edges], axis=1)
    assert np.all(np.abs(lengths / struts.rest_length - 1) < 0.1)
    assert q[:, 2].max() > 1.5


def _in_rows(gait, rows):
    """The gait with `rows`, lanes last, as its phases, amplitudes and frequencies."""
    return eqx.tree_at(lambda g: (g.phase, g.amplitude, g.frequency), gait, (rows, rows, rows))
