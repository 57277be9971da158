"""What is never known exactly: draws, the scenes of robots that differ, and populations of them."""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrity import (
    ConeFriction,
    Differences,
    ExactGround,
    Gait,
    InputError,
    Overtone,
    Scene,
    Slope,
    SolverOptions,
    Structure,
    SwitchFriction,
    Uncertainty,
    differing,
    ensemble,
    gaits_of,
    one_gait,
    parse_scene,
    random_phases,
    scene_text,
    simulate,
    simulate_population,
    with_gait,
)
from jaxgrity.model import Balls
from jaxgrity.model.actuation import peak_rates
from jaxgrity.model.scene import as_dtype
from jaxgrity.model.structure import edge_lengths
from jaxgrity.populations.lanes import in_lanes, lanes_last, over_lanes
from jaxgrity.populations.population import as_population
from jaxgrity.stepping.dynamics import acceleration, vector_field

DOUBTS = Uncertainty(0.2, 0.1, 0.3, 0.15, 0.25, 0.05, 0.12)
"""a half-width of every kind"""
SHARES = ("friction", "cable_stiffness", "node_mass")
"""those of `Differences` that are drawn as such"""


draw = eqx.filter_jit(ensemble)


def gaits(scene, count: int):
    """Gaits with phases at random."""
    return gaits_of(scene.gait, random_phases(count, 6, seed=0))


COUNT = 1001
"""robots of each gait in an ensemble; their draws, for which a program is compiled, are the same in all tests"""


@pytest.fixture(scope="module")
def drawn(exact):
    """`drawn(...)`: by quantity, (2, COUNT, ...), what was drawn for two gaits, in half-widths.

    For the slope it is the angle, in its two horizontal directions.
    """
    given = gaits(exact, 2)
    stretch = edge_lengths(exact.structure.nodes, exact.structure.cables.edges) / exact.structure.cables.rest_length - 1

    @functools.cache
    def by_quantity(common: bool = True, seed: int = 0):
        many, found = draw(jax.random.key(seed), exact, given, DOUBTS, COUNT, common)
        lean = np.asarray(found.up)
        np.testing.assert_allclose(np.linalg.norm(lean, axis=1), 1, rtol=1e-14)
        each = {
            "phase": many.phase - np.repeat(given.phase, COUNT, axis=0),
            "actuation": many.amplitude / 0.3 - 1,
            "prestress": (1 - found.cable_rest_length) / stretch,
            "slope": lean[:, :2] * (np.arccos(lean[:, 2]) / np.linalg.norm(lean[:, :2], axis=1))[:, None],
            **{name: np.asarray(getattr(found, name)) - 1 for name in SHARES},
        }
        return {name: np.reshape(np.asarray(x), (2, COUNT, -1)) / getattr(DOUBTS, name) for name, x in each.items()}

    return by_quantity


def test_draws_stay_within_their_half_widths(drawn):
    """They fill them evenly: a uniform number's standard deviation is its half-width over root 3.

    Of the 501 that are drawn, the largest comes within 5 % of the half-width but for odds of 1e-11, and the standard
    deviation within 10 % of its own, which is five times what so many draws leave open.
    """
    for name, x in drawn().items():
        size = np.linalg.norm(x, axis=-1) if name == "slope" else np.abs(x)
        # an arc cosine near 1 has half the digits
        assert 0.95 < size.max() <= 1 + 1e-7, name
        if name != "slope":
            assert x.std() == pytest.approx(1 / np.sqrt(3), rel=0.1), name


def test_what_is_alike_is_alike(drawn):
    """Friction, stiffness and prestress are one number a robot; phases, strokes and masses one for each part."""
    shapes = {name: x.shape[-1] for name, x in drawn().items()}
    assert shapes == {
        "phase": 6, "actuation": 6, "prestress": 24, "slope": 2, "friction": 1, "cable_stiffness": 24, "node_mass": 12
    }  # fmt: skip
    for name, x in drawn().items():
        alike = name in ("prestress", "cable_stiffness", "friction")
        assert (np.ptp(x, axis=-1).max() < 1e-12) == alike, name


def test_draws_come_in_opposite_pairs(drawn):
    """In the ensemble of each gait where draws are common, but for an odd one out, else among all robots: what is
    linear in them cancels from a mean. The pairs themselves are different numbers."""
    for common in (True, False):
        for name, x in drawn(common).items():
            # an arc cosine near 1 has half the digits
            tolerance = {"rtol": 0, "atol": 1e-7 if name == "slope" else 1e-13, "err_msg": name}
            for robots in x if common else [x.reshape(2 * COUNT, -1)]:
                pairs, first = len(robots) // 2, -(-len(robots) // 2)
                np.testing.assert_allclose(robots[:pairs], -robots[first:], **tolerance)
                assert len(np.unique(np.round(np.abs(robots[:, 0]), 9))) == first, name


def test_uncertain_phases_leave_waves_their_shapes(exact):
    """A robot's wave is that of the gait, early or late: harmonics move alike in time, and its peak rate stays."""
    phase = np.linspace(0, 5, 6)
    overtones = (Overtone(np.full(6, 0.5), 2 * phase - 1.5), Overtone(np.linspace(0, 0.3, 6), 3 * phase + 1))
    gait = Gait(tuple(range(6)), phase, np.full(6, 0.3), np.full(6, 0.7), 1.0, 1.0, overtones)
    many, _ = draw(jax.random.key(0), exact, as_population(gait), Uncertainty(phase=0.2), 64)
    early = many.phase - phase
    assert np.abs(early).max() > 0.15
    for h, (own, given) in enumerate(zip(many.overtones, gait.overtones), start=2):
        np.testing.assert_allclose(own.phase - given.phase, h * early, rtol=0, atol=1e-12)
        np.testing.assert_array_equal(own.size, np.tile(given.size, (64, 1)))
    rates = peak_rates(many, np.ones(6))
    np.testing.assert_allclose(rates, np.tile(rates[0], (64, 1)), rtol=1e-9)


def test_common_draws_are_the_same_for_all_gaits(drawn):
    """And others are not; another key gives others, and each quantity has draws of its own."""
    for common in (True, False):
        first, other = drawn(common), drawn(common, seed=1)
        for name, x in first.items():
            # the phases' difference is rounded
            assert np.allclose(x[0], x[1], rtol=0, atol=1e-12) == common, name
            assert np.abs(x - other[name]).max() > 1e-3, name
        kinds = np.array([x[0, :, 0] for x in first.values()])
        # of 500 pairs of numbers that have nothing to do with each other, six times the standard deviation
        apart = np.corrcoef(kinds[:, : COUNT // 2]) - np.eye(len(kinds))
        assert np.abs(apart).max() < 6 / np.sqrt(COUNT // 2)


def test_a_key_repeats_its_draws(exact):
    """To the last bit."""
    first, again = (draw(jax.random.key(3), exact, gaits(exact, 2), DOUBTS, COUNT, True) for _ in range(2))
    assert eqx.tree_equal(first, again)


def test_what_is_known_does_not_differ(exact):
    """Gaits alone, where nothing else is uncertain; the arrays that all share are not repeated."""
    assert Uncertainty().none
    assert not Uncertainty(slope=1e-3).none
    many, found = ensemble(jax.random.key(0), exact, gaits(exact, 2), Uncertainty(phase=0.1), 3)
    assert all(value is None for value in vars(found).values())
    assert many.phase.shape == (6, 6)
    np.testing.assert_array_equal(many.amplitude, np.full((6, 6), 0.3))
    assert (many.start, many.ramp) == (exact.gait.start, exact.gait.ramp)


def test_prestress_changes_every_tension_by_its_share(exact, drawn):
    """In the shape as built, also where cables differ in length, stiffness and prestrain."""
    random = np.random.default_rng(0)
    built = edge_lengths(exact.structure.nodes, exact.structure.cables.edges)
    parts = lambda s: (s.structure.cables.rest_length, s.structure.cables.stiffness)  # noqa: E731
    scene = eqx.tree_at(parts, exact, (built * random.uniform(0.5, 0.95, 24), random.uniform(300, 900, 24)))
    _, found = draw(jax.random.key(0), scene, gaits(scene, 2), DOUBTS, COUNT, True)
    before = scene.structure.cables.stiffness * (built - scene.structure.cables.rest_length)
    for k in range(6):
        cables = differing(scene, Differences(cable_rest_length=found.cable_rest_length[k])).structure.cables
        changes = cables.stiffness * (built - cables.rest_length) / before - 1
        np.testing.assert_allclose(changes, 0.25 * drawn()["prestress"][0, k, 0], rtol=0, atol=1e-12)


def one_robot(seed: int = 0) -> Differences:
    """In what one robot differs: everything at once, one cable broken, ground that leans somewhere."""
    random = np.random.default_rng(seed)
    whole = np.ones(24)
    whole[7 + seed] = 0
    return Differences(
        np.asarray(0.7 + 0.1 * seed),
        whole * random.uniform(0.8, 1.2, 24),
        whole * random.uniform(0.5, 1.5, 24),
        random.uniform(0.95, 1.05, 24),
        random.uniform(0.9, 1.1, 12),
        np.array([np.sin(0.3) * np.cos(seed), np.sin(0.3) * np.sin(seed), np.cos(0.3)]),
    )


def test_a_robot_that_differs_has_its_own_scene(reference, exact):
    """Every factor where it belongs, the lean, and all else untouched; None differs in nothing."""
    one = one_robot()
    switch = eqx.tree_at(lambda s: s.friction, reference, SwitchFriction(0.6, 0.4, 1e-3))
    for scene in (reference, exact, switch):
        found, cables = differing(scene, one), scene.structure.cables
        mu = {"mu": 0.35} if scene is not switch else {"mu_static": 0.42, "mu_kinetic": 0.28}
        for name, value in mu.items():
            np.testing.assert_allclose(getattr(found.friction, name), np.full(12, value), rtol=1e-15)
        np.testing.assert_array_equal(found.structure.cables.stiffness, cables.stiffness * one.cable_stiffness)
        np.testing.assert_array_equal(found.structure.cables.damping, cables.damping * one.cable_damping)
        np.testing.assert_array_equal(found.structure.cables.rest_length, cables.rest_length * one.cable_rest_length)
        np.testing.assert_array_equal(found.structure.node_mass, scene.structure.node_mass * one.node_mass)
        np.testing.assert_array_equal(found.up, one.up)
        for part in ("ground", "gravity", "node_damping", "gait"):
            assert eqx.tree_equal(getattr(found, part), getattr(scene, part)), part
        assert eqx.tree_equal(found.structure.struts, scene.structure.struts)
        assert differing(scene, None) is scene
        assert eqx.tree_equal(differing(scene, Differences()), scene)


@pytest.mark.parametrize("name", ["reference", "exact"])
def test_a_broken_cable_is_that_of_a_scene_file(name, request):
    """Without stiffness it has no damping either, as `broken` says."""
    scene = request.getfixturevalue(name)
    whole = np.ones(24)
    whole[7] = 0
    text = scene_text(name).replace("[cables]", "[cables]\nbroken = [7]")
    for damping in (None, whole):
        found = differing(scene, Differences(cable_stiffness=whole, cable_damping=damping))
        assert eqx.tree_equal(found, parse_scene(text))


@pytest.mark.parametrize(
    ("name", "dt"),
    [
        pytest.param("exact", 1e-2, marks=pytest.mark.slow),
        pytest.param("reference", 1e-3, marks=pytest.mark.campaign),
    ],
)
def test_each_robot_is_the_rollout_of_its_own_scene(name, dt, request):
    """Robots that differ in everything at once: rounding alone tells them from `simulate`."""
    scene = request.getfixturevalue(name)
    scene = eqx.tree_at(lambda s: s.gait.start, scene, np.asarray(0.0))
    rows = jax.tree.map(lambda *x: np.stack(x), *(one_robot(k) for k in range(3)))
    three = gaits(scene, 3)
    outcomes = simulate_population(scene, three, 0.4, differences=rows, options=SolverOptions(dt=dt))
    ends = []
    for k in range(3):
        own = with_gait(differing(scene, jax.tree.map(lambda x, k=k: x[k], rows)), one_gait(three, k))
        ends.append(simulate(own, 0.4, frame_rate=1.0, options=SolverOptions(dt=dt, any_step=True)).positions[-1])
    np.testing.assert_allclose(outcomes.positions, ends, rtol=0, atol=1e-12)
    assert np.abs(ends[0] - ends[1]).max() > 1e-4
    assert np.asarray(outcomes.failure).tolist() == [0, 0, 0]


def test_robots_that_differ_stay_last_in_memory(reference):
    """No transpose and, in float32, no float64 in the mapped vector field, whatever differs."""
    rows = lanes_last(jax.tree.map(lambda x: np.stack([x] * 8).astype("float32"), one_robot()))
    scene = as_dtype(reference, "float32")
    mapped, axes = in_lanes(scene, lanes_last(jax.tree.map(lambda x: np.asarray(x, "float32"), gaits(scene, 8))), rows)
    nodes = mapped.structure.nodes
    text = str(jax.make_jaxpr(over_lanes(vector_field, (None, -1, axes)))(jnp.float32(1.5), (nodes, nodes), mapped))
    assert "edge_accumulate" in text
    assert "transpose" not in text
    assert "f64" not in text


@pytest.mark.parametrize("incline", [pytest.param(0.0, marks=pytest.mark.campaign), 0.2])
def test_to_lean_is_to_stand_on_a_slope(reference, incline):
    """Turned with the slope, forces on an incline are those on level ground that leans; on a slope, those on a steeper
    one: gravity, contact, friction and members, for nodes in the ground and above it, at any speed."""
    lean = 0.15
    turn = np.array([[np.cos(lean), 0, np.sin(lean)], [0, 1, 0], [-np.sin(lean), 0, np.cos(lean)]])
    ground = dataclasses.replace(reference.ground, incline=incline)
    first = dataclasses.replace(reference, ground=ground)
    steeper = dataclasses.replace(reference, ground=dataclasses.replace(ground, incline=incline + lean))
    leaning = differing(first, Differences(up=turn.T @ [0, 0, 1]))
    random = np.random.default_rng(0)
    q, v = reference.structure.nodes + random.normal(size=(12, 3)) * 0.03, random.normal(size=(12, 3))
    a, b = (eqx.filter_jit(acceleration)(s, 1.3, x @ r.T, y @ r.T) for s, r, x, y in
            ((leaning, np.eye(3), q, v), (steeper, turn, q, v)))  # fmt: skip
    assert np.abs(a - eqx.filter_jit(acceleration)(first, 1.3, q, v)).max() > 1
    # of hundreds of m/s^2
    np.testing.assert_allclose(b, a @ turn.T, rtol=0, atol=1e-11)


@pytest.mark.slow
def test_a_ball_on_leaning_ground_sticks_or_slides():
    """Within friction's cone it stays; beyond, it slides down the lean with g (sin - mu cos), which leapfrog knows."""
    structure = Structure(np.zeros((1, 3)), np.array([2.0]))
    scene = Scene(structure, gravity=9.81, ground=ExactGround(), friction=ConeFriction(0.5))
    for lean in (0.4, 0.6):
        down = np.array([np.cos(0.7), np.sin(0.7), 0])
        up = np.cos(lean) * np.array([0, 0, 1.0]) - np.sin(lean) * down
        ball = simulate(differing(scene, Differences(up=up)), 0.5, frame_rate=4.0, options=SolverOptions(dt=1e-2))
        slides = max(0, 9.81 * (np.sin(lean) - 0.5 * np.cos(lean)))
        expected = slides / 2 * np.asarray(ball.times)[:, None] ** 2 * down
        np.testing.assert_allclose(ball.positions[:, 0], expected, rtol=0, atol=1e-9)
        assert (slides > 0) == (lean == 0.6)


def test_robots_with_struts_of_other_lengths_keep_them(exact):
    """Rigid, and as long from the first step to the last as the robot's own differences say."""
    factors, ends = np.array([1.0, 0.9, 1.1]), np.array(exact.structure.struts.edges)
    nodes = np.asarray(exact.structure.nodes)
    positions = np.array([nodes.mean(0) + factor * (nodes - nodes.mean(0)) + [0, 0, 0.2] for factor in factors])
    differences = Differences(
        strut_rest_length=factors[:, None] * np.ones(6),
        cable_rest_length=factors[:, None] * np.ones(24),
        positions=positions,
    )
    still = gaits_of(exact.gait, np.zeros((3, 6)), amplitude=np.zeros((3, 6)))
    found = simulate_population(exact, still, 0.6, options=SolverOptions(dtype="float64"), differences=differences)
    q = np.asarray(found.positions)
    lengths = np.linalg.norm(q[:, ends[:, 0]] - q[:, ends[:, 1]], axis=2)
    np.testing.assert_array_equal(found.failure, 0)
    np.testing.assert_allclose(lengths, factors[:, None] * np.asarray(exact.structure.struts.rest_length), rtol=1e-9)


@pytest.mark.parametrize(
    ("part", "name"),
    [
        (lambda s: s.friction, "friction"),
        (lambda s: s.structure.cables, "cable_stiffness"),
        (lambda s: s.structure.cables, "cable_damping"),
        (lambda s: s.structure.cables, "cable_rest_length"),
        (lambda s: s.structure.struts, "strut_rest_length"),
        (lambda s: s.structure.cables.damping, "cable_damping"),
    ],
)
def test_what_a_scene_lacks_cannot_differ(exact, part, name):
    """Friction, cables, or their damping, that are not modelled."""
    scene = eqx.tree_at(part, exact, None)
    value = {"friction": np.asarray(1.1), "strut_rest_length": np.ones(6)}.get(name, np.ones(24))
    with pytest.raises(InputError, match=f"{name}: robots cannot differ in it, since the scene does not model it"):
        differing(scene, Differences(**{name: value}))


def test_draws_need_a_key(exact):
    """A seed is none."""
    with pytest.raises(InputError, match=r"key of type int64 and shape \(\): expected one key, such as jax.random.key"):
        ensemble(0, exact, gaits(exact, 1), Uncertainty(phase=0.1), 2)


def test_a_slope_is_not_added_to_another_one(exact):
    """Gravity that leans already would be put upright."""
    leaning = dataclasses.replace(exact, up=np.array([0.6, 0.0, 0.8]))
    with pytest.raises(InputError, match=r"slope: scene\.up leans already"):
        ensemble(jax.random.key(0), leaning, gaits(exact, 1), Uncertainty(slope=0.1), 2)


def test_no_robot_has_a_rest_length_below_zero(exact):
    """Uncertain amplitudes may not reach 1: such robots would roll out with members that push, or fail."""
    strong = dataclasses.replace(gaits(exact, 1), amplitude=np.full((1, 6), 0.9))
    assert ensemble(jax.random.key(0), exact, strong, Uncertainty(actuation=0.1), 8)[0].amplitude.max() < 1
    with pytest.raises(InputError, match=r"amplitude = 0\.9: with uncertainty\.actuation = 0\.3 robots reach 1\.17"):
        ensemble(jax.random.key(0), exact, strong, Uncertainty(actuation=0.3), 8)


@pytest.mark.parametrize("name", ["friction", "cable_stiffness", "prestress"])
def test_what_a_scene_lacks_cannot_be_uncertain(exact, name):
    """It is refused before anything is rolled out."""
    part = (lambda s: s.friction) if name == "friction" else (lambda s: s.structure.cables)
    scene = eqx.tree_at(part, exact, None)
    with pytest.raises(InputError, match=r"robots cannot differ in .*, since the scene"):
        ensemble(jax.random.key(0), scene, gaits(scene, 1), Uncertainty(**{name: 0.1}), 2)


@pytest.mark.parametrize(
    ("name", "value"),
    [("friction", -0.1), ("node_mass", 1.0), ("phase", 1.6), ("slope", np.pi / 2), ("prestress", np.nan)],
)
def test_bad_half_widths_are_refused(name, value):
    """Negative ones, shares of all there is, right angles."""
    with pytest.raises(
        InputError, match=rf"uncertainty\.{name} = .*: expected (a half-width of at least 0 and b|a finite)"
    ):
        Uncertainty(**{name: value})


def test_terrain_is_not_uncertain_beside_balls(exact):
    """Their robots would start in the ground."""
    ground = ExactGround(surface=Slope(0.1), balls=Balls((0,), np.array([0.05])))
    scene = dataclasses.replace(exact, ground=ground)
    with pytest.raises(InputError, match=r"^terrain: robots with balls would start in the ground"):
        ensemble(jax.random.key(0), scene, gaits(exact, 1), Uncertainty(terrain=0.1), 2)


@pytest.mark.parametrize("name", ["positions", "velocities", "up"])
def test_a_place_is_no_factor(exact, name):
    """One number for all coordinates is refused, as a factor would not be."""
    with pytest.raises(InputError, match=rf"differences.{name} has shape \(\); expected \(2, .*3\), a row for each"):
        Differences(**{name: np.array(1.0)}).check(exact, 2)
    common = Differences(friction=np.array(0.5))
    common.check(exact, 2)
    scene, axes = in_lanes(as_dtype(exact, "float64"), lanes_last(gaits(exact, 2)), common)
    assert (float(scene.friction.mu), axes.friction.mu) == (0.5 * float(exact.friction.mu), None)
