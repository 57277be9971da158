"""A scene's other contact model: what it takes from the scene, and what it adds by rule."""

import dataclasses

import equinox as eqx
import jax
import numpy as np
import pytest

from jaxgrity import InputError, twin
from jaxgrity.model.friction import ConeFriction, SmoothFriction, SwitchFriction
from jaxgrity.model.contact_twin import exact_twin, penalty_twin


def changed(scene, *parts):
    """The scene with each (where, value) of `parts` put in."""
    for where, value in parts:
        scene = eqx.tree_at(where, scene, value, is_leaf=lambda x: x is None)
    return scene


def with_stuck(scene, **stuck):
    """The scene with one member of each kind stuck."""
    parts = {kind: dataclasses.replace(getattr(scene.structure, kind), stuck=(k,)) for kind, k in stuck.items()}
    return dataclasses.replace(scene, structure=dataclasses.replace(scene.structure, **parts))


def times(scene, factor: float):
    """The scene with all lengths times `factor`."""
    parts = lambda s: (s.structure.nodes, s.structure.struts.rest_length, s.structure.cables.rest_length)  # noqa: E731
    return changed(scene, (parts, tuple(factor * x for x in parts(scene))))


def test_exact_twin_of_the_reference_scene_is_the_exact_scene(reference, exact):
    """Every leaf, and everything that is static."""
    assert eqx.tree_equal(exact_twin(reference), exact)
    assert eqx.tree_equal(twin(reference), exact)


def test_penalty_twin_of_the_exact_scene_is_the_reference_scene(reference, exact):
    """The same parts, with numbers that differ by as much as those of the file were rounded: 1.9 %."""
    soft = twin(exact)
    assert jax.tree.structure(soft) == jax.tree.structure(reference)
    for mine, its in zip(jax.tree.leaves(soft), jax.tree.leaves(reference)):
        np.testing.assert_allclose(mine, its, rtol=0.02)


def test_a_twin_of_a_twin_is_of_the_first_kind(reference, exact):
    """Of the exact scene it is that scene again; of the reference scene, the penalty twin of the exact one."""
    assert eqx.tree_equal(twin(twin(exact)), exact)
    assert eqx.tree_equal(twin(twin(reference)), twin(exact))
    assert [s.constrained for s in (reference, twin(reference), exact, twin(exact))] == [False, True, True, False]


@pytest.mark.parametrize("name", ["reference", "exact"])
def test_a_twin_keeps_what_is_not_contact(name, request):
    """Pose, masses, cables, gravity, node damping, gait, slope, lean, what is stuck and rest lengths."""
    scene = with_stuck(request.getfixturevalue(name), struts=2, cables=5)
    shorter = 0.9 * scene.structure.struts.rest_length
    leaning = np.tile([0.1, 0.0, np.sqrt(0.99)], (12, 1))
    scene = changed(scene, (lambda s: s.structure.struts.rest_length, shorter), (lambda s: s.up, leaning))
    scene = dataclasses.replace(scene, ground=dataclasses.replace(scene.ground, incline=0.2))
    other = twin(scene)
    for part in ("gravity", "node_damping", "gait", "up"):
        assert eqx.tree_equal(getattr(other, part), getattr(scene, part)), part
    for part in ("nodes", "node_mass", "cables"):
        assert eqx.tree_equal(getattr(other.structure, part), getattr(scene.structure, part)), part
    assert other.ground.incline == 0.2
    assert (other.structure.struts.stuck, other.structure.cables.stuck) == ((2,), (5,))
    assert other.structure.struts.edges == scene.structure.struts.edges
    np.testing.assert_array_equal(other.structure.struts.rest_length, shorter)


def test_friction_becomes_the_other_models(reference, exact):
    """The switch gives its kinetic friction to the cone, and no friction stays none."""
    switch = changed(reference, (lambda s: s.friction, SwitchFriction(0.6, 0.4, 1e-3)))
    assert eqx.tree_equal(exact_twin(switch).friction, ConeFriction(0.4))
    slippery = changed(exact, (lambda s: s.friction.mu, 0.3))
    assert eqx.tree_equal(penalty_twin(slippery).friction, SmoothFriction(0.3, 0.01))
    for scene in (reference, exact):
        assert twin(changed(scene, (lambda s: s.friction, None))).friction is None


def test_parts_that_are_of_the_kind_already_stay(reference, exact):
    """Spring struts on exact ground, and rigid ones on penalty ground, are halfway to either twin."""
    halves = changed(reference, (lambda s: (s.ground, s.friction), (exact.ground, exact.friction)))
    assert eqx.tree_equal(exact_twin(halves), exact)
    soft = twin(halves)
    assert eqx.tree_equal(soft.structure.struts, reference.structure.struts)
    assert eqx.tree_equal(soft.ground, twin(exact).ground)
    aloft = changed(reference, (lambda s: (s.ground, s.friction), (None, None)))
    assert exact_twin(aloft).ground is None
    assert exact_twin(aloft).structure.struts.rigid


def test_stiffness_follows_weight_and_size(exact):
    """Three nodes that carry the weight sink by 2 mm for each metre of strut, and struts are twice as stiff."""
    soft = penalty_twin(times(exact, 3.0))
    assert float(soft.ground.stiffness) * 3 * 2e-3 * 3.0 == pytest.approx(6.0 * 9.81, rel=1e-12)
    np.testing.assert_allclose(soft.structure.struts.stiffness, 2 * soft.ground.stiffness, rtol=1e-15)
    np.testing.assert_allclose(soft.structure.struts.damping, 1.8e-3 * soft.structure.struts.stiffness, rtol=1e-15)


def test_a_weightless_scene_has_no_penalty_twin(exact):
    """Nothing says how stiff its ground should be."""
    with pytest.raises(InputError, match="gravity: not modelled; expected it"):
        penalty_twin(changed(exact, (lambda s: s.gravity, None)))
