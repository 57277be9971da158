"""Populations: right answers, the layout that makes them fast, failures as data."""

import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest

from jaxgrity import (
    ConeFriction,
    Differences,
    ExactGround,
    Gait,
    InputError,
    Members,
    Motor,
    Push,
    Scene,
    SolverOptions,
    Structure,
    Uncertainty,
    as_population,
    control,
    differing,
    ensemble,
    gaits_of,
    load_scene,
    one_gait,
    parse_scene,
    random_phases,
    scene_text,
    simulate,
    simulate_population,
    with_gait,
)
from jaxgrity.core.remembered import remembered
from jaxgrity.model.bodies import rigid_body
from jaxgrity.model.scene import as_dtype
from jaxgrity.populations import population, roll_out
from jaxgrity.populations.lanes import in_lanes, most_lanes, over_lanes
from jaxgrity.search.judging import masses_and_lengths
from jaxgrity.stepping import resolve
from jaxgrity.stepping.dynamics import vector_field
from jaxgrity.stepping.options import KEPT, options_anew
from jaxgrity.structures import prism_tower

AT_ONCE = SolverOptions(dt=1e-3, any_step=True)
"""a stable step that is not checked: nothing is compiled but the rollout"""
ANSWERS = json.loads((Path(__file__).parents[1] / "data" / "reference_answers.json").read_text())


@pytest.mark.slow
def test_agrees_with_an_independent_program(reference):
    """The frozen answers have nine digits; 1e-7 m is a hundred times what they leave open."""
    phases = np.array([row["phase"] for row in ANSWERS["gaits"]])
    gaits = gaits_of(reference.gait, phases)
    outcomes = simulate_population(reference, gaits, ANSWERS["duration"], options=SolverOptions(dt=ANSWERS["dt"]))
    expected = np.array([row["com_end"] for row in ANSWERS["gaits"]])
    np.testing.assert_allclose(outcomes.com_end, expected, rtol=0, atol=1e-7)


@pytest.fixture
def swimmer():
    """Three nodes in a row on two struts, in a medium: methods that choose their steps compile fast for it, and
    take the same ones to rounding."""
    nodes, edges, one = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), ((0, 1), (1, 2)), np.ones(2)
    structure = Structure(nodes, np.ones(3), Members(edges, 100 * one, one))
    gait = Gait((0, 1), 0 * one, 0.3 * one, one, start=0.0, ramp=0.5)
    return Scene(structure, node_damping=np.array([0.5, 1.0, 3.0]), gait=gait)


@pytest.mark.parametrize(
    ("method", "robot"),
    [
        pytest.param("rk4", "swimmer", marks=pytest.mark.slow),
        pytest.param("rk4", "reference", marks=pytest.mark.campaign),
        pytest.param("tsit5", "swimmer", marks=pytest.mark.slow),
        pytest.param("kvaerno3", "swimmer", marks=pytest.mark.campaign),
    ],
)
def test_each_member_is_the_rollout_of_its_own(request, method, robot):
    """Fixed steps take all robots at once, other methods go robot by robot: each agrees with `simulate`."""
    scene = eqx.tree_at(lambda s: s.gait.start, request.getfixturevalue(robot), np.asarray(0.0))
    phases = random_phases(3, len(scene.gait.members), seed=1)
    options = SolverOptions(method=method)
    outcomes = simulate_population(scene, gaits_of(scene.gait, phases), 0.1, options=options)
    assert np.ptp(outcomes.com_end, axis=0).max() > 1e-6
    for k, phase in enumerate(phases):
        own = eqx.tree_at(lambda s: s.gait.phase, scene, phase)
        trajectory = simulate(own, 0.1, options=options)
        mass = scene.structure.node_mass
        com = np.einsum("n,nk->k", mass, trajectory.positions[-1]) / mass.sum()
        np.testing.assert_allclose(outcomes.com_end[k], com, rtol=0, atol=1e-10)
        assert int(outcomes.steps[k]) == int(trajectory.steps)


@pytest.fixture
def plates():
    """A triangular plate on the ground, and one above it: three damped cables join them, which a gait shortens."""
    corners = np.array([[0.0, 0, 0], [0.4, 0, 0], [0, 0.3, 0]])
    nodes = np.concatenate([corners, corners + np.array([0, 0, 0.5])])
    bodies = tuple(rigid_body(nodes, points, 1.0, [0.01, 0.02, 0.03]) for points in ((0, 1, 2), (3, 4, 5)))
    cables = Members(((0, 3), (1, 4), (2, 5)), 20 * np.ones(3), 0.4 * np.ones(3), damping=2 * np.ones(3))
    structure = Structure(nodes, np.zeros(6), cables=cables, bodies=bodies)
    gait = Gait((0, 1, 2), np.zeros(3), 0.2 * np.ones(3), np.ones(3), start=0.0, ramp=0.02)
    return Scene(structure, gravity=9.81, ground=ExactGround(), friction=ConeFriction(0.5), gait=gait)


def test_many_robots_of_rigid_bodies_know_their_laws(plates):
    """Methods ask whether they dissipate. Weights of bodies need the arrays of one robot, without the axis of lanes."""
    answers = []
    rows = jax.tree.map(lambda x: jnp.stack([x, x], -1), plates.gait)
    jax.eval_shape(lambda gaits: answers.append(in_lanes(plates, gaits)[0].dissipates), rows)
    assert answers == [True]


def test_perturbed_robots_have_bodies_of_other_masses(plates):
    """Each body by a factor of its own, with its inertia; draws of other quantities stay as they are without bodies."""
    many, key = gaits_of(plates.gait, random_phases(2, 3, seed=1)), jax.random.key(3)
    _, found = ensemble(key, plates, many, Uncertainty(node_mass=0.2, friction=0.1), 40)
    assert found.body_mass.shape == (80, 2)
    assert abs(found.body_mass - 1).max() <= 0.2
    assert np.ptp(found.body_mass, axis=0).min() > 0.3
    assert abs(np.corrcoef(found.body_mass.T)[0, 1]) < 0.5
    np.testing.assert_allclose(found.body_mass[:20] + found.body_mass[20:40], 2.0)
    np.testing.assert_array_equal(found.body_mass[:40], found.body_mass[40:])
    _, without = ensemble(key, plates, many, Uncertainty(friction=0.1), 40)
    np.testing.assert_array_equal(found.friction, without.friction)
    mass, _ = masses_and_lengths(plates, many, found)
    np.testing.assert_allclose(mass, found.body_mass.sum(1), rtol=1e-12)
    one = differing(plates, Differences(body_mass=np.array([2.0, 0.5])))
    for body, own, factor in zip(one.structure.bodies, plates.structure.bodies, (2.0, 0.5)):
        np.testing.assert_allclose(body.matrix, factor * own.matrix, atol=1e-12)
        np.testing.assert_array_equal(body.lengths, own.lengths)
    with pytest.raises(InputError, match=r"differences.body_mass\[0\] = 0"):
        Differences(body_mass=np.array([0.0, 1.0]))
    with pytest.raises(InputError, match=r"differences.body_mass has shape \(2, 3\); expected \(2, 2\)"):
        Differences(body_mass=np.ones((2, 3))).check(plates, 2)


@pytest.mark.campaign
def test_rigid_bodies_side_by_side_end_where_each_ends_alone(plates):
    """While cables pull the upper plate down, and the lower one against the ground's friction."""
    phases, masses = random_phases(2, 3, seed=1), Differences(body_mass=np.array([[1.0, 1.3], [0.8, 1.1]]))
    many = gaits_of(plates.gait, phases)
    outcomes = simulate_population(plates, many, 0.1, options=AT_ONCE, with_metrics=True, differences=masses)
    assert np.ptp(outcomes.positions, axis=0).max() > 1e-4
    for k, phase in enumerate(phases):
        own = eqx.tree_at(lambda s: s.gait.phase, plates, phase)
        own = differing(own, Differences(body_mass=masses.body_mass[k]))
        alone = simulate(own, 0.1, frame_rate=10.0, options=AT_ONCE)
        np.testing.assert_allclose(outcomes.positions[k], alone.positions[-1], rtol=0, atol=1e-9)
    assert outcomes.metrics is not None


@pytest.mark.slow
def test_more_gaits_than_lanes_keep_their_order(swimmer):
    """Chunks and padding are invisible: 300 gaits give what two halves give."""
    phases = random_phases(300, 2, seed=2)
    options = SolverOptions("rk4", dt=1e-2, dtype="float32", any_step=True)
    assert most_lanes(swimmer, resolve(swimmer, 0.5, options)) < 150
    whole = simulate_population(swimmer, gaits_of(swimmer.gait, phases), 0.5, options=options)
    assert whole.com_end.shape == (300, 3)
    assert len(np.unique(whole.com_end[:, 0])) > 250
    for part in (slice(0, 150), slice(150, 300)):
        half = simulate_population(swimmer, gaits_of(swimmer.gait, phases[part]), 0.5, options=options)
        np.testing.assert_array_equal(whole.com_end[part], half.com_end)


def _primitives(jaxpr) -> list[str]:
    names = []
    for equation in jaxpr.eqns:
        names.append(equation.primitive.name)
        for value in equation.params.values():
            inner = getattr(value, "jaxpr", value)
            if hasattr(inner, "eqns"):
                names += _primitives(inner)
    return names


@pytest.mark.parametrize("members", ['"struts"', '"cables"', "[0, 3, 7, 20]"])
def test_the_population_stays_last_in_memory(members):
    """No transpose in the mapped vector field: the layout on which its speed rests (see `primitives.py`)."""
    reference_text = scene_text("reference")
    count = {'"struts"': 6, '"cables"': 24}.get(members, 4)
    text = reference_text.replace('members = "struts"', f"members = {members}")
    text = text.replace("phase = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]", f"phase = {[0.5] * count}")
    scene = as_dtype(parse_scene(text.replace("incline = 0.0", "incline = 0.1")), "float64")
    rows = jnp.ones((count, 8))
    mapped, axes = in_lanes(scene, _in_rows(scene.gait, rows))
    nodes = mapped.structure.nodes
    field = over_lanes(vector_field, (None, -1, axes))
    names = _primitives(jax.make_jaxpr(field)(1.5, (nodes, nodes), mapped).jaxpr)
    assert "edge_accumulate" in names
    assert "transpose" not in names


@pytest.mark.slow
@pytest.mark.parametrize(
    "surface",
    [
        'surface = { kind = "bumps", deviation = 0.02, length = 0.8, seed = 0 }',
        pytest.param(
            'surface = { kind = "stairs", rise = 0.1, run = 0.3, steps = 2, start = 0.5 }', marks=pytest.mark.campaign
        ),
        'obstacles = [{ kind = "box", centre = [2, 0, 0.2], size = [0.4, 0.4, 0.6] }]',
        pytest.param(
            'obstacles = [{ kind = "cylinder", start = [2, 0, -0.1], end = [2, 0, 1], radius = 0.3 }]',
            marks=pytest.mark.campaign,
        ),
    ],
)
def test_the_population_stays_last_in_memory_on_uneven_ground(surface):
    """Normals and distances are gradients of the surface, and forces gradients of those: none has a transpose."""
    text = scene_text("reference").replace("incline = 0.0", surface)
    scene = as_dtype(parse_scene(text), "float64")
    assert scene.ground.surface is not None
    mapped, axes = in_lanes(scene, _in_rows(scene.gait, jnp.ones((6, 8))))
    nodes = mapped.structure.nodes
    field = over_lanes(vector_field, (None, -1, axes))
    assert "transpose" not in _primitives(jax.make_jaxpr(field)(1.5, (nodes, nodes), mapped).jaxpr)


def test_float32_is_float32_throughout(reference):
    """With x64 switched on, a float32 rollout promotes nothing to float64."""
    scene = as_dtype(reference, "float32")
    rows = jnp.ones((6, 8), "float32")
    mapped, axes = in_lanes(scene, _in_rows(scene.gait, rows))
    nodes = mapped.structure.nodes
    field = over_lanes(vector_field, (None, -1, axes))
    assert "f64" not in str(jax.make_jaxpr(field)(jnp.float32(1.5), (nodes, nodes), mapped))


@pytest.mark.parametrize("platform", ["cpu", "cuda"])
@pytest.mark.parametrize("members", [(0, 1, 2, 3, 4, 5), (1, 7, 20)])
def test_no_scatter(reference, platform, members):
    """In the vector field of a population, lowered for each platform; neither has to be there."""
    some = np.full(len(members), 0.5)
    scene = as_dtype(with_gait(reference, Gait(members, some, some, some)), "float32")
    rows = jnp.ones((len(members), 8), "float32")
    mapped, axes = in_lanes(scene, _in_rows(scene.gait, rows))
    field = jax.jit(lambda q, s: over_lanes(vector_field, (None, -1, axes))(jnp.float32(1.5), (q, q), s))
    text = field.trace(mapped.structure.nodes, mapped).lower(lowering_platforms=(platform,)).as_text()
    assert "stablehlo.gather" in text
    assert "stablehlo.scatter" not in text


@pytest.mark.parametrize(
    ("struts", "dtype", "lanes"), [(6, "float32", 64), (6, "float64", 32), (600, "float32", 32), (120, "float32", 64)]
)
def test_chunks_shrink_as_structures_grow(struts, dtype, lanes):
    """So that what a core uses over and over stays in its cache."""
    scene = prism_tower(struts, exact=False)
    # not `resolve`: it would look for the stable step of 1200 nodes, which takes minutes
    assert most_lanes(scene, options_anew(scene, "rk4", 1e-4, dtype)) == lanes


@pytest.mark.slow
def test_a_failed_member_is_data_and_disturbs_no_other(reference):
    """One gait tears its robot apart; the others go where they go without it."""
    phases = random_phases(4, 6, seed=3)
    # an array of JAX is a search's own, and is not looked at
    violent = jnp.array([0.3, 0.3, 1e9, 0.3])[:, None] * jnp.ones((4, 6))
    start_now = eqx.tree_at(lambda s: s.gait.start, reference, 0.0)
    outcomes = simulate_population(
        start_now, gaits_of(start_now.gait, phases, amplitude=violent), 0.3, options=SolverOptions(dt=1e-3)
    )
    assert (np.asarray(outcomes.failure) != 0).tolist() == [False, False, True, False]
    assert np.isnan(outcomes.distance()).tolist() == [False, False, True, False]
    alone = simulate_population(start_now, gaits_of(start_now.gait, phases[3:]), 0.3, options=SolverOptions(dt=1e-3))
    np.testing.assert_allclose(outcomes.com_end[3], alone.com_end[0], rtol=0, atol=1e-12)


def tethered() -> Scene:
    """A rigid body on a cable that a gait shortens."""
    nodes = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [2, 1, 0]])
    body = rigid_body(nodes, range(4), 2.0, [0.3, 0.3, 0.3])
    cable = Members(((1, 4),), [50.0], [1.0])
    structure = Structure(nodes, np.zeros(5), cables=cable, fixed=((4, "xyz"),), bodies=(body,))
    return Scene(structure, gait=Gait((0,), [0.0], [0.1], [1.0]))


@pytest.mark.slow
def test_velocities_that_stretch_a_body_fail_without_impulses():
    """As `simulate` refuses them; the body that moves as a whole does not fail."""
    scene, rk4, v = tethered(), SolverOptions("rk4", dt=5e-3), np.zeros((2, 5, 3))
    v[0, :4], v[1, 1, 0] = [0.0, 0.5, 0.0], 0.5
    many = gaits_of(scene.gait, np.zeros((2, 1)))
    found = simulate_population(scene, many, 0.01, options=rk4, differences=Differences(velocities=v))
    assert np.asarray(found.failure).tolist() == [0, 1]
    plant = control.plant_of(scene, (0,), options=rk4)
    with pytest.raises(InputError, match=r"velocities: nodes \[1, 0\] move apart or together by 0.5 m/s"):
        control.plant_start(plant, jax.random.key(0), (scene.structure.nodes, v[1]))
    both = np.moveaxis(np.broadcast_to(scene.structure.nodes, v.shape), 0, -1), np.moveaxis(v, 0, -1)
    start = control.plant_start(control.side_by_side(plant, 2), jax.random.key(0), both)
    assert np.isnan(start.motion[1]).any((0, 1)).tolist() == [False, True]


@pytest.mark.slow
def test_amplitude_and_frequency_vary_too(swimmer):
    """A population of frequencies is the scenes with these frequencies."""
    phases, frequency = random_phases(2, 2, seed=4), np.array([[0.4] * 2, [0.7] * 2])
    amplitude = np.array([[0.1] * 2, [0.2] * 2])
    outcomes = simulate_population(swimmer, gaits_of(swimmer.gait, phases, amplitude, frequency), 0.5, options=AT_ONCE)
    for k in range(2):
        gait = Gait(swimmer.gait.members, phases[k], amplitude[k], frequency[k], 0.0, 0.5)
        trajectory = simulate(with_gait(swimmer, gait), 0.5, options=AT_ONCE)
        np.testing.assert_allclose(outcomes.com_end[k], trajectory.positions[-1].mean(0), rtol=0, atol=1e-10)


def test_robots_have_motors_and_pushes_at_once():
    """Cables stay slack, so the push alone moves the centre of mass: by its impulse over 6 kg, from its middle on."""
    cables = Members(((0, 1), (1, 2)), np.ones(2), np.full(2, 3.0), motors=(Motor(0, [0.01], [2.9], rate=1.0),))
    structure = Structure(np.eye(3), np.array([1.0, 2.0, 3.0]), cables=cables)
    push = Push((0,), np.array([[12.0, 0.0, -6.0]]), start=0.01, duration=0.02, ramp=0.01)
    scene = Scene(structure, gait=Gait((1,), [0.0], [0.1], [1.0]), terms=(push,))
    found = simulate_population(scene, gaits_of(scene.gait, np.zeros((2, 1))), 0.05, options=AT_ONCE)
    moved = np.array([2.0, 0.0, -1.0]) * 0.01 * (0.05 - 0.02)
    np.testing.assert_allclose(found.com_end - found.com_start, [moved, moved], rtol=1e-9, atol=1e-15)


def test_bad_gaits_are_refused(reference):
    """A wrong number of phases, and a scene that has no gait to vary."""
    with pytest.raises(InputError, match=r"phase has shape \(3, 5\); expected \(gaits, 6\)"):
        gaits_of(reference.gait, np.zeros((3, 5)))
    with pytest.raises(InputError, match="no gait"):
        gaits_of(with_gait(reference, None).gait, np.zeros((3, 6)))
    with pytest.raises(InputError, match="amplitude has 2 rows; expected 3"):
        gaits_of(reference.gait, np.zeros((3, 6)), amplitude=np.zeros((2, 6)))


@pytest.mark.parametrize(
    ("how", "message"),
    [
        (lambda: {"parts": 0}, "parts = 0: expected a whole number, at least 1"),
        (lambda: {"with_metrics": np.nan}, "with_metrics = nan: expected True, False, or a time, s, from 0"),
        (lambda: {"differences": Differences(friction=[1.0, 1.1])}, "friction: robots cannot differ in it, since the"),
        (
            lambda: {"differences": Differences(up=[[0, 0, 2.0], [0, 0, 1.0]])},
            "differences.up = .*: 2 long; expected a unit vector",
        ),
        (
            lambda: {"differences": Differences(terrain=np.zeros((2, 3)))},
            "differences.terrain: the scene's ground has no surface",
        ),
    ],
)
def test_what_would_mean_nothing_is_refused(reference, how, message, monkeypatch):
    """No part, gravity of another size, a plane that is moved along itself, and friction that there is not; before
    a step is chosen, which compiles."""
    gaits = gaits_of(reference.gait, np.zeros((2, 6)))
    scene = replace(reference, friction=None)
    monkeypatch.setattr(population, "resolve", lambda *_, **__: pytest.fail("a step is chosen"))
    with pytest.raises(InputError, match=message):
        simulate_population(scene, gaits, 1.0, **how())


def test_a_population_of_none_is_refused(reference):
    """As is one gait that is no population."""
    with pytest.raises(InputError, match="phase has no rows; expected at least one gait"):
        gaits_of(reference.gait, np.zeros((0, 6)))
    none = jax.tree.map(lambda x: np.zeros((0, 6)) if np.ndim(x) else x, reference.gait)
    with pytest.raises(InputError, match=r"gaits.phase has shape \(0, 6\); expected \(gaits, actuators\), one gait or"):
        simulate_population(reference, none, 1.0)
    for k in (3, -1):  # for both JAX would take the last one
        with pytest.raises(InputError, match=rf"k = .*{k}.*: expected a whole number from 0 to 2"):
            one_gait(gaits_of(reference.gait, np.zeros((3, 6))), k)
    with pytest.raises(InputError, match=r"gaits.phase has shape \(6,\); expected \(gaits, actuators\), one gait or"):
        one_gait(reference.gait, 0)
    single = r"gaits.phase has shape \(6,\); expected \(gaits, actuators\)"
    for ask in (
        lambda: simulate_population(reference, reference.gait, 1.0),
        lambda: roll_out(reference, reference.gait, 1.0, resolve(reference)),
        lambda: ensemble(jax.random.key(0), reference, reference.gait, Uncertainty(phase=0.1), 2),
    ):
        with pytest.raises(InputError, match=single):
            ask()
    many = gaits_of(reference.gait, np.zeros((3, 6)))
    with pytest.raises(InputError, match=r"gait.phase has shape \(3, 6\); expected \(actuators,\), one gait"):
        as_population(many)
    with pytest.raises(InputError, match=r"gaits.phase has shape \(3, 6\); expected \(6, robots\), as lanes_last"):
        in_lanes(reference, many)
    jaxtyping.config.update("jaxtyping_disable", True)  # its own refusal would come first
    with pytest.raises(InputError, match=r"phase has shape \(\); expected \(gaits, 6\)"):
        gaits_of(reference.gait, None)


@pytest.mark.slow
def test_gaits_take_the_place_of_the_scenes_own(swimmer):
    """With their members, start and ramp; the scene need not have a gait."""
    gaits = Gait((1,), np.array([[0.3], [2.0]]), np.full((2, 1), 0.3), np.full((2, 1), 1.5), 0.0, 0.2)
    still = with_gait(swimmer, None)
    for scene in (swimmer, still):
        outcomes = simulate_population(scene, gaits, 0.4, options=AT_ONCE)
        for k in range(2):
            alone = simulate(with_gait(swimmer, one_gait(gaits, k)), 0.4, options=AT_ONCE)
            np.testing.assert_allclose(outcomes.com_end[k], alone.positions[-1].mean(0), rtol=0, atol=1e-10)
    assert np.linalg.norm(outcomes.com_end[0] - outcomes.com_end[1]) > 1e-6


def test_a_gait_that_does_not_fit_is_refused(reference):
    """When it is put into a scene, by name."""
    for members, message in (((0, 99), "names member 99; expected 0 to 29"), ((3, 3), "expected each member once")):
        gait = Gait(members, np.zeros(2), np.zeros(2), np.zeros(2))
        with pytest.raises(InputError, match=message):
            with_gait(reference, gait)


@pytest.mark.slow
def test_what_gaits_share_is_prepared_once(swimmer, monkeypatch):
    """Other gaits and durations need nothing of it anew, another scene does; answers are those of rollouts alone."""
    prepared = []
    resolved = lambda *args, **named: prepared.append(args) or resolve(*args, **named)  # noqa: E731
    monkeypatch.setattr(population, "resolve", resolved)
    monkeypatch.setattr(population, "_common", remembered(KEPT)(population._common.__wrapped__))
    scenes = [eqx.tree_at(lambda s: s.node_damping, swimmer, factor * swimmer.node_damping) for factor in (1.5, 2.5)]
    for seed in range(3):
        gaits = gaits_of(swimmer.gait, random_phases(2, 2, seed))
        for scene in scenes:
            outcomes = simulate_population(scene, gaits, 0.2 + 0.1 * seed, options=AT_ONCE)
            alone = simulate(with_gait(scene, one_gait(gaits, 1)), 0.2 + 0.1 * seed, options=AT_ONCE)
            np.testing.assert_allclose(outcomes.positions[1], alone.positions[-1], rtol=0, atol=1e-10)
    assert len(prepared) == len(scenes)


@pytest.mark.campaign
def test_what_is_kept_is_as_it_was(swimmer, monkeypatch):
    """Of a call inside of a compiled function, and of arrays that are changed afterwards."""
    gaits = gaits_of(swimmer.gait, random_phases(2, 2, seed=0))

    def ends(phases):
        return simulate_population(swimmer, gaits_of(swimmer.gait, phases), 0.3, options=AT_ONCE).com_end

    monkeypatch.setattr(population, "_common", remembered(KEPT)(population._common.__wrapped__))
    compiled = jax.jit(ends)(gaits.phase)
    np.testing.assert_allclose(ends(gaits.phase), compiled, rtol=0, atol=1e-12)
    for method in ("rk4", "kvaerno3"):
        damping = np.array(swimmer.node_damping)
        scene = eqx.tree_at(lambda s: s.node_damping, swimmer, damping)
        options = SolverOptions(method, dt=0.05, any_step=True)
        first = simulate_population(scene, gaits, 0.3, options=options).com_end
        damping *= 4
        assert np.abs(simulate_population(scene, gaits, 0.3, options=options).com_end - first).max() > 1e-4
        np.testing.assert_array_equal(simulate_population(swimmer, gaits, 0.3, options=options).com_end, first)


@pytest.mark.parametrize(("start", "ramp"), [(-1.0, 1.0), (-0.1, 0.5)])
def test_a_gait_that_runs_at_the_start_is_refused_where_struts_are_rigid(exact, start, ramp):
    """They do not have the lengths then that the structure is posed with."""
    running = eqx.tree_at(lambda g: (g.start, g.ramp), exact.gait, (np.array(start), np.array(ramp)))
    with pytest.raises(InputError, match=r"strut 1 starts 1 m long; expected 0\.\d+ m, its rest length at t = 0"):
        simulate_population(exact, gaits_of(running, random_phases(2, 6, seed=0)), 0.1)


@pytest.mark.campaign
def test_gaits_that_run_at_the_start_go_on_from_a_pose_of_theirs(exact):
    """Rigid struts have the lengths of that moment, not those that they are built with."""
    gaits = gaits_of(exact.gait, random_phases(2, 6, seed=0))
    options = SolverOptions(dt=5e-3)
    for k in range(2):
        moved = simulate(with_gait(exact, one_gait(gaits, k)), 1.6, options=options)
        later = eqx.tree_at(lambda s: s.structure.nodes, exact, np.asarray(moved.positions[-1]))
        turned = one_gait(gaits, k).phase + 2 * np.pi * 1.6 * exact.gait.frequency
        running = Gait(exact.gait.members, turned, exact.gait.amplitude, exact.gait.frequency, -0.6, 1.0)
        outcomes = simulate_population(later, as_population(running), 0.1, options=options)
        alone = simulate(with_gait(later, running), 0.1, options=options)
        np.testing.assert_allclose(outcomes.positions[0], alone.positions[-1], rtol=0, atol=1e-10)


def _in_rows(gait, rows):
    """The gait with `rows`, lanes last, as its phases, amplitudes and frequencies."""
    return eqx.tree_at(lambda g: (g.phase, g.amplitude, g.frequency), gait, (rows, rows, rows))


@pytest.mark.campaign
@pytest.mark.parametrize("name", ["exact", "reference"])
def test_faster_rollouts_end_where_slower_ones_did(name):
    """16 gaits after 4 s in float64, against an earlier version of the library, which took twice the time."""
    ends = json.loads((Path(__file__).parents[1] / "data" / "earlier_rollouts.json").read_text())[name]
    scene = load_scene(name)
    gaits = gaits_of(scene.gait, random_phases(16, 6, seed=0))
    outcomes = simulate_population(scene, gaits, 4.0, options=SolverOptions(dtype="float64"))
    np.testing.assert_allclose(outcomes.com_end, ends, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ["exact", "reference"])
def test_no_operation_rounds_as_vectors_are_long(name, request):
    """XLA's `rsqrt` begins with an approximation, for which processors differ; roots and quotients are exact."""
    scene = as_dtype(request.getfixturevalue(name), "float32")
    mapped, axes = in_lanes(scene, _in_rows(scene.gait, jnp.ones((6, 64), "float32")))
    field = jax.jit(lambda q, s: over_lanes(vector_field, (None, -1, axes))(jnp.float32(1.5), (q, q), s))
    text = field.lower(mapped.structure.nodes, mapped).compile().as_text()
    assert "sqrt(" in text
    assert "rsqrt(" not in text


@pytest.mark.parametrize(("name", "dtype"), [("exact", "float32"), ("exact", "float64"), ("reference", "float32")])
@pytest.mark.campaign
def test_answers_do_not_depend_on_how_kernels_are_made(name, dtype):
    """Not on the length of vectors, to the last bit: with 64 gaits LLVM takes all the bits that it may, with fewer it
    may not. XLA's two ways of making kernels agree to rounding, as it grows in a second."""
    code = (
        "from jaxgrity.cli.script import configure; configure()\n"
        "from jaxgrity import SolverOptions, gaits_of, load_scene, random_phases, simulate_population\n"
        f"scene = load_scene({name!r})\n"
        "gaits = gaits_of(scene.gait, random_phases(64, 6, seed=0))\n"
        f"outcomes = simulate_population(scene, gaits, 1.0, options=SolverOptions(dtype={dtype!r}))\n"
        "print(outcomes.positions.__array__().tobytes().hex())\n"
    )

    def printed(flag: str) -> str:
        env = os.environ | {"XLA_FLAGS": flag}
        return subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True).stdout

    usual = printed("")
    assert len(usual) > 1000
    assert printed("--xla_cpu_prefer_vector_width=128") == usual
    places, others = (
        np.frombuffer(bytes.fromhex(x), dtype) for x in (usual, printed("--xla_cpu_use_fusion_emitters=true"))
    )
    np.testing.assert_allclose(places, others, rtol=0, atol=1e-3 if dtype == "float32" else 1e-10)


@pytest.mark.campaign
def test_a_sweep_computes_no_length_twice(exact):
    """Of 128 gaits: a root for each of 12 nodes and 6 struts, in both loops over sweeps.

    A root inside of a fusion is computed once for each number that comes out of it.
    """
    rows = gaits_of(exact.gait, np.zeros((128, 6)))
    options = resolve(exact, 1.0, SolverOptions(dt=5e-3, dtype="float32")).as_inputs()
    lowered = population.roll_out.lower(as_dtype(exact, "float32"), rows, np.asarray(1.0), options)
    program = lowered.compile().compiled.as_text()
    bodies = dict(re.findall(r"^%?([\w.\-]+) .*?\{\n(.*?)^\}", program, re.MULTILINE | re.DOTALL))

    def roots(body):
        taken = re.findall(r" = \w+\[([\d,]+)\]\S* (?:sqrt|fusion\(.*?calls=%?([\w.\-]+))", bodies[body])
        each = [len(re.findall(r" sqrt\(", bodies[fused])) if fused else 1 for _, fused in taken]
        return sum(n * np.prod([int(x) for x in shape.split(",")[:-1]]) for n, (shape, _) in zip(each, taken))

    assert [roots(body) for body in re.findall(r" while\(.*?body=%?([\w.\-]+)", program)][:2] == [18, 18]
