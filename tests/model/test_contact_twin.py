"""A scene's other contact model: what it takes from the scene, and what it adds by rule."""

import dataclasses

import equinox as eqx
import jax
import numpy as np
import pytest

from jaxgrity import (
    ExactGround,
    InputError,
    Scene,
    SolverOptions,
    Structure,
    parse_scene,
    scene_text,
    simulate,
    with_gait,
)
from jaxgrity.model.bodies import rigid_body
from jaxgrity.model.contact_twin import DEPTH, contact_twin, exact_twin, penalty_twin
from jaxgrity.model.friction import ConeFriction, SmoothFriction, SwitchFriction

COARSE = SolverOptions(dt=1e-3)


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
    assert eqx.tree_equal(contact_twin(reference), exact)


def test_penalty_twin_of_the_exact_scene_is_the_reference_scene(reference, exact):
    """The same parts, with numbers that differ by as much as those of the file were rounded: 1.9 %."""
    soft = contact_twin(exact)
    assert jax.tree.structure(soft) == jax.tree.structure(reference)
    for mine, its in zip(jax.tree.leaves(soft), jax.tree.leaves(reference)):
        np.testing.assert_allclose(mine, its, rtol=0.02)


def test_a_twin_of_a_twin_is_of_the_first_kind(reference, exact):
    """Of the exact scene it is that scene again; of the reference scene, the penalty twin of the exact one."""
    assert eqx.tree_equal(contact_twin(contact_twin(exact)), exact)
    assert eqx.tree_equal(contact_twin(contact_twin(reference)), contact_twin(exact))
    assert [s.constrained for s in (reference, contact_twin(reference), exact, contact_twin(exact))] == [
        False,
        True,
        True,
        False,
    ]


@pytest.mark.parametrize("name", ["reference", "exact"])
def test_a_twin_keeps_what_is_not_contact(name, request):
    """Pose, masses, cables, gravity, node damping, gait, slope, lean, what is stuck and rest lengths."""
    scene = with_stuck(request.getfixturevalue(name), struts=2, cables=5)
    leaning = np.array([0.1, 0.0, np.sqrt(0.99)])
    above_the_slope = scene.structure.nodes + np.array([0, 0, 1.0])
    scene = changed(scene, (lambda s: s.up, leaning), (lambda s: s.structure.nodes, above_the_slope))
    scene = dataclasses.replace(scene, ground=dataclasses.replace(scene.ground, incline=0.2))
    other = contact_twin(scene)
    for part in ("gravity", "node_damping", "gait", "up"):
        assert eqx.tree_equal(getattr(other, part), getattr(scene, part)), part
    for part in ("nodes", "node_mass", "cables"):
        assert eqx.tree_equal(getattr(other.structure, part), getattr(scene.structure, part)), part
    assert other.ground.incline == 0.2
    assert (other.structure.struts.stuck, other.structure.cables.stuck) == ((2,), (5,))
    assert other.structure.struts.edges == scene.structure.struts.edges
    np.testing.assert_array_equal(other.structure.struts.rest_length, scene.structure.struts.rest_length)


def test_a_scene_with_rigid_bodies_has_the_other_contact(reference, exact):
    """Bodies keep their shapes on both: a payload makes no penalty scene an exact one."""
    payload = rigid_body(exact.structure.nodes, (0, 1, 4, 5, 8), 2.0, [0.1, 0.1, 0.1])
    for scene, other in ((reference, exact), (exact, reference)):
        loaded = eqx.tree_at(lambda s: s.structure.bodies, scene, (payload,))
        twin = contact_twin(loaded)
        assert twin.ground.impulsive == other.ground.impulsive
        assert twin.structure.struts.rigid == other.structure.struts.rigid
        assert twin.structure.bodies == (payload,)


def test_the_twin_of_bodies_alone_has_the_stiffness_of_their_size():
    """As that of a strut between the same points; without bodies and members there is no size."""
    nodes = np.array([[0.0, 0, 0], [0.5, 0, 0], [0, 0.3, 0], [0, 0, 0.3]])
    body = rigid_body(nodes, range(4), 2.0, [0.05, 0.06, 0.07])
    scene = Scene(Structure(nodes, np.zeros(4), bodies=(body,)), 9.81, ground=ExactGround())
    twin = penalty_twin(scene)
    assert float(twin.ground.stiffness) == pytest.approx(2.0 * 9.81 / (3 * DEPTH * np.hypot(0.5, 0.3)), rel=1e-12)
    assert simulate(twin, 0.2).positions[-1, :, 2].min() > -4 * DEPTH
    alone = Scene(Structure(nodes, np.ones(4)), 9.81, ground=ExactGround())
    with pytest.raises(InputError, match="no members, and no bodies"):
        penalty_twin(alone)


def test_exact_twin_of_strained_struts_has_the_lengths_of_the_start(reference):
    """Springs under load are as long as they stand there; an unstrained one keeps its rest length to the last bit."""
    strained = np.array(reference.structure.struts.rest_length)
    strained[[1, 4]] *= 1.02, 0.9
    rigid = exact_twin(changed(reference, (lambda s: s.structure.struts.rest_length, strained))).structure.struts
    np.testing.assert_allclose(rigid.rest_length, np.ones(6), rtol=1e-12)
    others = [0, 2, 3, 5]
    np.testing.assert_array_equal(rigid.rest_length[others], reference.structure.struts.rest_length[others])


@pytest.mark.parametrize("incline", [0.0, 0.2])
def test_exact_twin_of_a_start_below_the_ground_touches_it(reference, incline):
    """It is lifted along the ground's normal, as a whole, by as much as its lowest node is below."""
    ground = dataclasses.replace(reference.ground, incline=incline)
    normal = np.array(ground.normal)
    height = (reference.structure.nodes @ normal).min()
    sunk = reference.structure.nodes - (height + 3e-3) * normal
    scene = changed(reference, (lambda s: s.ground, ground), (lambda s: s.structure.nodes, sunk))
    np.testing.assert_allclose(exact_twin(scene).structure.nodes, sunk + 3e-3 * normal, rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("damping = 36.0", "damping = 36.0\nprestrain = -0.02"),
        ("damping = 36.0", "damping = 36.0\nprestrain = [0.05, 0, -0.03, 0, 0, 0.1]"),
        ("height = 0.02", "height = -0.001"),
    ],
    ids=["compressed struts", "struts strained differently", "a start below the ground"],
)
@pytest.mark.slow
def test_every_penalty_scene_has_an_exact_twin_that_rolls_out(old, new):
    """Struts that start strained, and nodes that start in the ground, are no violation of the twin's constraints."""
    text = scene_text("reference")
    assert old in text
    scene = parse_scene(text.replace(old, new))
    assert not simulate(scene, 0.1, options=COARSE).failed
    motion = simulate(exact_twin(scene), 0.2, options=SolverOptions(dt=1e-2, strut_tolerance=1e-9))
    assert not motion.failed
    assert motion.positions[..., 2].min() > -1e-12


def test_supports_are_not_lifted_out_of_the_ground(reference):
    """They hold the robot where they are; a start above the ground, and supports that may rise, are no matter."""
    q = np.asarray(reference.structure.nodes)
    held = lambda depth, axes: dataclasses.replace(  # noqa: E731
        reference,
        structure=dataclasses.replace(
            reference.structure, nodes=q - [0, 0, q[:, 2].min() + depth], fixed=((int(q[:, 2].argmax()), axes),)
        ),
    )
    with pytest.raises(
        InputError, match=r"structure\.fixed: the start is 0.03 m in the ground, and supports cannot be"
    ):
        exact_twin(held(0.03, "xyz"))
    for depth, axes in ((-0.03, "xyz"), (0.03, "xy")):
        assert exact_twin(held(depth, axes)).structure.nodes[:, 2].min() == pytest.approx(max(0, -depth), abs=1e-4)


def test_friction_becomes_the_other_models(reference, exact):
    """The switch gives its kinetic friction to the cone, and no friction stays none."""
    switch = changed(reference, (lambda s: s.friction, SwitchFriction(0.6, 0.4, 1e-3)))
    assert eqx.tree_equal(exact_twin(switch).friction, ConeFriction(0.4))
    slippery = changed(exact, (lambda s: s.friction.mu, 0.3))
    assert eqx.tree_equal(penalty_twin(slippery).friction, SmoothFriction(0.3, 0.01))
    for scene in (reference, exact):
        assert contact_twin(changed(scene, (lambda s: s.friction, None))).friction is None


def test_parts_that_are_of_the_kind_already_stay(reference, exact):
    """Spring struts on exact ground, and rigid ones on penalty ground, are halfway to either twin."""
    halves = changed(reference, (lambda s: (s.ground, s.friction), (exact.ground, exact.friction)))
    assert eqx.tree_equal(exact_twin(halves), exact)
    soft = contact_twin(halves)
    assert eqx.tree_equal(soft.structure.struts, reference.structure.struts)
    assert eqx.tree_equal(soft.ground, contact_twin(exact).ground)
    aloft = changed(reference, (lambda s: (s.ground, s.friction), (None, None)))
    assert exact_twin(aloft).ground is None
    assert exact_twin(aloft).structure.struts.rigid


def test_stiffness_follows_weight_and_size(exact):
    """Three nodes that carry the weight sink by 2 mm for each metre of strut, and struts are twice as stiff."""
    soft = penalty_twin(times(exact, 3.0))
    assert float(soft.ground.stiffness) * 3 * 2e-3 * 3.0 == pytest.approx(6.0 * 9.81, rel=1e-12)
    np.testing.assert_allclose(soft.structure.struts.stiffness, 2 * soft.ground.stiffness, rtol=1e-15)
    relaxation = 1.8e-3 * np.sqrt(3.0)
    np.testing.assert_allclose(soft.structure.struts.damping, relaxation * soft.structure.struts.stiffness, rtol=1e-14)


def test_a_weightless_scene_has_no_penalty_twin(exact):
    """Nothing says how stiff its ground should be."""
    with pytest.raises(InputError, match="gravity: not modelled; expected \\[gravity\\]"):
        penalty_twin(changed(exact, (lambda s: s.gravity, None)))


def test_struts_in_motion_at_the_start_have_no_exact_twin(reference):
    """Each gait of a search would need a pose of its own to start from."""
    swinging = with_gait(reference, dataclasses.replace(reference.gait, start=-1.0))
    with pytest.raises(InputError, match=r"gait.start = -1: struts move at t = 0, .*; expected 0 or later"):
        exact_twin(swinging)
