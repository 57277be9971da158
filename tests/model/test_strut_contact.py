"""Struts that touch each other: nearest points, the laws of penalty contact, files, twins and refusals."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrity
from jaxgrity import (
    ConeFriction,
    Differences,
    ExactGround,
    Gait,
    InputError,
    Members,
    PenaltyGround,
    Scene,
    SmoothFriction,
    SolverOptions,
    Structure,
    SwitchFriction,
    energy_audit,
    simulate,
    with_gait,
)
from jaxgrity.io.scene_files import parse_scene
from jaxgrity.io.scene_writing import scene_toml
from jaxgrity.model import contact_twin as twins
from jaxgrity.model import exact_twin, standing_symmetries, with_contact_between_struts
from jaxgrity.model.strut_contact import strut_contact
from jaxgrity.model.strut_pairs import StrutPairs

R = 0.02


def pairs_of(ends: np.ndarray, radius: float = R) -> tuple[StrutPairs, np.ndarray]:
    """Pairs of struts with these ends, (pairs, 4, 3), m, and their nodes."""
    count = len(ends)
    numbers = tuple(tuple(range(k, 4 * count, 4)) for k in range(4))
    pairs = tuple((2 * k, 2 * k + 1) for k in range(count))
    return StrutPairs(pairs, numbers, np.full((count, 2), radius), np.ones(count)), ends.reshape(-1, 3)


def soft(friction=0.3, dissipation: float | None = 1.0, **keys) -> Scene:
    """Two spring rods of one metre, crossed and pressed 2 mm into each other, high above a ground."""
    nodes = np.array([[-0.5, 0.0, 5.0], [0.5, 0.0, 5.0], [0.1, -0.5, 5.038], [0.1, 0.5, 5.038]])
    struts = Members(((0, 1), (2, 3)), [1e4] * 2, [1.0] * 2)
    smooth = SmoothFriction(friction, 0.05) if friction else None
    high = nodes + np.array([[0.0, 0.0, 0.0]] * 2 + [[0.0, 0.0, 0.01]] * 2)
    scene = Scene(Structure(high, [1.0, 2.0, 0.5, 1.0], struts), None, None, PenaltyGround(2e4, dissipation), smooth)
    scene = with_contact_between_struts(scene, R, **keys)
    return replace(scene, structure=replace(scene.structure, nodes=nodes))


def test_nearest_points_of_segments():
    """No points of a fine grid are nearer; and parallel, collinear, crossing and touching segments."""
    rng = np.random.default_rng(0)
    ends = rng.normal(size=(60, 4, 3))
    ends[:10, 3] = ends[:10, 2] + 0.7 * (ends[:10, 1] - ends[:10, 0])
    ends[10:15, 2:] = ends[10:15, :2] * 2 + 3.0 * (ends[10:15, :1] - ends[10:15, 1:2])
    ends[15:20, 2] = 2 * (0.3 * ends[15:20, 0] + 0.7 * ends[15:20, 1]) - ends[15:20, 3]
    between, q = pairs_of(ends)
    share, normal, gap = jax.tree.map(np.asarray, jax.jit(lambda q: between.nearest(q))(q))
    (s, t), grid = share, np.linspace(0, 1, 201)
    along = lambda a, b, x: a + x[..., None] * (b - a)  # noqa: E731
    first = along(ends[:, None, 0], ends[:, None, 1], grid)
    second = along(ends[:, None, 2], ends[:, None, 3], grid)
    least = np.linalg.norm(first[:, :, None] - second[:, None], axis=-1).min((1, 2))
    found = along(ends[:, 0], ends[:, 1], s) - along(ends[:, 2], ends[:, 3], t)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), gap + 2 * R, atol=1e-12)
    assert ((s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)).all()
    assert (gap + 2 * R <= least + 1e-9).all()
    assert (gap + 2 * R >= least - 0.02).all()
    apart = gap + 2 * R > 1e-9
    np.testing.assert_allclose((gap[:, None] + 2 * R) * normal, found, atol=1e-12)
    assert apart.sum() == 55


def test_gradients_of_gaps_are_those_of_differences():
    """Of segments that cross, that end beside each other, and that are parallel. Where axes meet they are finite."""
    ends = np.array(
        [
            [[-0.5, 0.0, 0.0], [0.5, 0.1, 0.0], [0.1, -0.5, 0.04], [0.2, 0.5, 0.05]],
            [[-0.5, 0.0, 0.0], [0.5, 0.1, 0.0], [0.6, 0.12, 0.04], [1.2, 0.5, 0.05]],
            [[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0], [0.1, 0.03, 0.04], [0.9, 0.03, 0.04]],
        ]
    )
    between, q = pairs_of(ends)
    total = jax.jit(lambda q: (between.nearest(q).gap * jnp.array([1.0, 2.0, 3.0])).sum())
    slope, h = jax.grad(total)(jnp.asarray(q)), 1e-6
    away = np.random.default_rng(1).normal(size=q.shape)
    away[8:, 1:] = 0.0  # parallel segments that turn have a kink
    difference = (total(q + h * away) - total(q - h * away)) / (2 * h)
    np.testing.assert_allclose((slope * away).sum(), difference, rtol=1e-7)
    crossed, q = pairs_of(np.array([[[-0.5, 0, 0], [0.5, 0, 0], [0, -0.5, 0], [0, 0.5, 0]]], float))
    assert np.isfinite(jax.grad(lambda q: (crossed.nearest(q).gap ** 2).sum())(jnp.asarray(q))).all()


def test_forces_between_struts_are_opposite():
    """And without friction they have no moment; the elastic one is k_n times the depth."""
    scene = soft(friction=None, dissipation=None)
    q = jnp.asarray(scene.structure.nodes)
    law = scene.terms[0]
    force = -jax.grad(lambda q: law.energy(scene.configuration(q, 0.0)))(q)
    np.testing.assert_allclose(force[:2].sum(0), [0.0, 0.0, -2e4 * 0.002], atol=1e-8)
    np.testing.assert_allclose(force[:, 2], 40.0 * np.array([-0.4, -0.6, 0.5, 0.5]), atol=1e-8)
    np.testing.assert_allclose(force.sum(0), 0.0, atol=1e-10)
    np.testing.assert_allclose(jnp.cross(q, force).sum(0), 0.0, atol=1e-10)


@pytest.mark.campaign
def test_energy_and_momentum_are_accounted_for():
    """Of rods that push each other apart and slide."""
    scene = soft()
    pushed = replace(scene, terms=(*scene.terms, jaxgrity.Push((0, 1), [[0.0, 40.0, 40.0]] * 2, 0.0, 0.02)))
    audit = energy_audit(pushed, 0.05, options=SolverOptions("rk4", dt=1e-4))
    assert audit.dissipated["friction"][-1] > 1e-4
    assert audit.dissipated["contact"][-1] > 1e-4
    assert abs(audit.residual).max() < 1e-3 * audit.turned_over
    assert np.max(audit.momentum_residual) < 1e-6


@pytest.mark.campaign
def test_a_population_moves_as_each_robot_does():
    """With frictions of their own."""
    gait = Gait((0,), [0.0], [0.1], [2.0], start=0.0, ramp=0.1)
    scene = replace(soft(), gait=gait)
    gaits, mu = jaxgrity.gaits_of(gait, np.array([[0.5], [2.0]])), np.array([1.0, 0.2])
    options = SolverOptions("rk4", dt=2e-4)
    many = jaxgrity.simulate_population(scene, gaits, 0.05, options=options, differences=Differences(friction=mu))
    for k in range(2):
        one = with_gait(scene, jax.tree.map(lambda x, k=k: x[k] if np.ndim(x) else x, gaits))
        one = replace(one, friction=SmoothFriction(0.3 * mu[k], 0.05))
        alone = simulate(one, 0.05, options=options)
        np.testing.assert_allclose(many.positions[k], alone.positions[-1], atol=1e-9)


@pytest.mark.campaign
def test_files_and_twins_keep_it(exact):
    """The same pairs and radii on both models, and the same laws from a file."""
    radii = [0.01, 0.02, 0.01, 0.01, 0.01, 0.015]
    scene = with_contact_between_struts(exact, radii, ((0, 1), (4, 2)), 2)
    law = strut_contact(scene)
    assert law.at_once == 2
    np.testing.assert_array_equal(law.between.radius, [[0.01, 0.02], [0.01, 0.01]])
    soft = twins.contact_twin(scene)
    assert [term.name.split(" between")[0] for term in soft.terms] == [
        "penalty contact",
        "contact dissipation",
        "smooth friction",
    ]
    for each in (scene, soft):
        again = parse_scene(scene_toml(each))
        assert "[touching]" in scene_toml(each)
        found = strut_contact(again).between
        assert found.pairs == ((0, 1), (4, 2))
        np.testing.assert_array_equal(found.radius, law.between.radius)
        assert type(strut_contact(again)) is type(strut_contact(each))
    assert strut_contact(exact_twin(soft)).between.pairs == law.between.pairs
    assert "struts touch         2 pairs of radius 0.01 to 0.02 m" in jaxgrity.describe(scene)


def test_symmetries_are_those_without_it(exact):
    """Unless radii differ."""
    still = with_gait(exact, None)
    count = len(standing_symmetries(still))
    assert len(standing_symmetries(with_contact_between_struts(still, 0.01))) == count > 1
    unlike = with_contact_between_struts(still, [0.01] * 5 + [0.02])
    assert len(standing_symmetries(unlike)) < count


BARE = Scene(Structure(np.eye(4, 3), [1.0] * 4, Members(((0, 1), (2, 3)), [1e4] * 2, [1.0] * 2)))


@pytest.mark.parametrize(
    ("scene", "keys", "message"),
    [
        (BARE, {}, "contact between struts has the ground's stiffness; expected a ground, or no spring struts"),
        (
            replace(BARE, structure=replace(BARE.structure, struts=None)),
            {},
            "the scene's 0 have no two without a common",
        ),
        (None, {"radius": 0.0}, r"radius\[0\] = 0 m: expected a positive number"),
        (None, {"radius": [0.1]}, "radius has 1 numbers; expected one, or 6"),
        (
            None,
            {"pairs": ((0, 6),)},
            r"pairs has \[0, 6\]: expected two of 6 struts and rods of bodies, without",
        ),
        (None, {"pairs": ((0, 1), (1, 0))}, "expected at least one, and each once"),
        (None, {"at_once": 0}, "at_once = 0: expected a whole number, at least 1"),
        (None, {"radius": 0.3}, r"rods \d and \d start 0.\d+ m in each other; expected: beside each other"),
        (
            lambda: replace(soft(), terms=(), friction=SwitchFriction(0.4, 0.3, 0.01)),
            {},
            "friction: SwitchFriction between struts; expected smooth friction, or none",
        ),
        (soft, {}, "the scene has it already"),
    ],
)
def test_what_cannot_be_is_refused(exact, scene, keys, message):
    """In one line."""
    scene = exact if scene is None else scene() if callable(scene) else scene
    with pytest.raises(InputError, match=message):
        with_contact_between_struts(scene, **{"radius": R, **keys})


def test_motions_do_not_start_with_struts_in_each_other():
    """On exact contact."""
    nodes = np.array([[-0.5, 0.0, 1.0], [0.5, 0.0, 1.0], [0.1, -0.5, 1.1], [0.1, 0.5, 1.1]])
    struts = Members(((0, 1), (2, 3)), None, [1.0, 1.0])
    scene = Scene(Structure(nodes, [1.0] * 4, struts), None, None, ExactGround(), ConeFriction(0.3))
    scene = with_contact_between_struts(scene, R)
    with pytest.raises(InputError, match=r"rods 0 and 1 start 0.01 m in each other"):
        simulate(scene, 0.1, positions=nodes - np.array([[0.0, 0.0, 0.0]] * 2 + [[0.0, 0.0, 0.07]] * 2))
    with pytest.raises(InputError, match=r"coupled = False: sweeps handle no .* contact along or between struts"):
        simulate(scene, 0.1, options=SolverOptions(coupled=False))
