"""Derivatives of rollouts: forward mode, reverse mode and differences agree for every array of a scene."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrity import (
    Members,
    PenaltyGround,
    Scene,
    SmoothFriction,
    SolverOptions,
    Structure,
    final_state,
    resolve,
)

DURATION = 0.02
SLIDING = np.array([0.6, 0.3, 0.0])
"""m/s: nodes on the ground slide all the time, and none begins or ceases to"""


def on_the_ground() -> Scene:
    """A tetrahedron of rods that slides on three feet."""
    turn = 2 * np.pi / 3 * np.arange(3)
    feet = np.stack([0.5 * np.cos(turn), 0.5 * np.sin(turn), 0 * turn], axis=1)
    nodes = np.vstack([feet, [[0.05, 0.02, 0.7]]])
    lengths, feet_of = np.linalg.norm(feet - nodes[3], axis=1), ((0, 3), (1, 3), (2, 3))
    struts = Members(feet_of, np.full(3, 5e3), lengths, damping=np.full(3, 20.0))
    cables = Members(((0, 1), (1, 2), (2, 0)), np.full(3, 300.0), np.full(3, 0.8), damping=np.full(3, 4.0))
    structure = Structure(nodes - np.array([0, 0, 2e-3]), np.array([0.5, 0.6, 0.7, 1.0]), struts, cables)
    ground, friction = PenaltyGround(1e4, 2.0), SmoothFriction(0.4, 0.05)
    return Scene(structure, gravity=9.81, node_damping=np.full(4, 0.3), ground=ground, friction=friction)


CASES = {"sliding on springs": (lambda: on_the_ground(), 5e-4)}


def leaves_of(scene: Scene, start: tuple) -> dict:
    """Every array of floating-point numbers, of the scene and of the start, by its path."""
    paths = jax.tree_util.tree_flatten_with_path((scene, start))[0]
    return {jax.tree_util.keystr(path): np.asarray(leaf, float) for path, leaf in paths}


@pytest.fixture(scope="module", params=CASES.values(), ids=CASES)
def derivatives(request):
    """(forward, reverse, differences), each a number a leaf, m and m/s per relative change, by a random direction."""
    make, dt = request.param
    scene = make()
    q = np.asarray(scene.structure.nodes)
    v = np.where(scene.structure.free, SLIDING, 0.0)
    start, random = (q, v), np.random.default_rng(1)
    options = resolve(scene, DURATION, SolverOptions(dt=dt, any_step=True))
    leaves, tree = jax.tree.flatten((scene, start))
    directions = [random.normal(size=np.shape(x)) * np.maximum(np.abs(x), 1e-2) for x in leaves]
    weights = [random.normal(size=q.shape) for _ in range(2)]
    # supports hold their nodes, and rigid struts their lengths: such starts vary as the scene allows
    held = [np.broadcast_to(scene.structure.free, q.shape) if np.shape(x) == q.shape else 1.0 for x in leaves]

    def f(c):
        moved = [x + c[k] * d * mask for k, (x, d, mask) in enumerate(zip(leaves, directions, held))]
        there, begin = jax.tree.unflatten(tree, moved)
        return sum(jnp.sum(w * x) for w, x in zip(weights, final_state(there, DURATION, options, begin)))

    at, f = jnp.zeros(len(leaves)), jax.jit(f)
    h = 2e-5
    differences = [(8 * (f(at.at[k].set(h)) - f(at.at[k].set(-h))) - f(at.at[k].set(2 * h)) + f(at.at[k].set(-2 * h)))
                   / (12 * h) for k in range(len(leaves))]  # fmt: skip
    names = list(leaves_of(scene, start))
    return names, np.asarray(jax.jit(jax.jacfwd(f))(at)), np.asarray(jax.jit(jax.grad(f))(at)), np.array(differences)


@pytest.mark.slow
def test_forward_and_reverse_mode_agree_with_differences_for_every_leaf(derivatives):
    """To 1e-6, of the derivative where that is above 1; and most leaves matter at all."""
    names, forward, reverse, differences = derivatives
    for name, *each in zip(names, forward, reverse, differences):
        np.testing.assert_allclose(each[1], each[0], rtol=1e-8, atol=1e-8, err_msg=name)
        np.testing.assert_allclose(each[2], each[0], rtol=1e-6, atol=1e-6, err_msg=name)
    assert np.mean(forward != 0) > 0.5
