"""Tables, largest forces, dead bands, dampers beside cables: the force by hand, clusters, files, what is refused."""

import dataclasses
from typing import ClassVar

import equinox as eqx
import jax
import numpy as np
import pytest

from jaxgrity import (
    EnergyTerm,
    Gait,
    InputError,
    Members,
    Scene,
    SolverOptions,
    Structure,
    Uncertainty,
    as_population,
    describe,
    energy_audit,
    ensemble,
    force_limit,
    force_table,
    load_scene,
    parse_scene,
    primitives,
    save_scene,
    scene_text,
    with_terms,
)
from jaxgrity.model import Command, cable_dampers, commanded_pull, dead_band
from jaxgrity.statics import inspect_structure
from jaxgrity.stepping import step_limit

STRETCH, FORCE = [0.0, 0.01, 0.03, 0.05], [0.0, 6.0, 10.0, 30.0]
TABLE = scene_text("reference").replace("stiffness = 600.0", f"force = {{ stretch = {STRETCH}, force = {FORCE} }}")
LIMIT = scene_text("reference").replace("stiffness = 600.0", "stiffness = 600.0\nlargest_force = 100.0")
PULL = scene_text("reference").replace("stiffness = 600.0", "pull = 5.0\npull_slope = 40.0")
BAND = LIMIT.replace("largest_force", "damper = 2.0\ndead_band = 0.1\nlargest_force")


def pull_of(scene: Scene, stretch: np.ndarray) -> np.ndarray:
    """N, on the last node, which is moved along x."""

    @jax.jit
    @jax.vmap
    def force(s):
        q = scene.structure.nodes + np.zeros_like(scene.structure.nodes)
        return jax.grad(scene.potential_energy)(jax.numpy.asarray(q).at[-1, 0].add(s), 0.0)[-1, 0]

    return np.asarray(force(stretch))


def cord(segments: int = 1) -> Scene:
    """Cords of 600 N/m along x, slack up to 1 m each, as one cable."""
    nodes = np.arange(segments + 1.0)[:, None] * np.array([1.0, 0.0, 0.0])
    edges = tuple((k, k + 1) for k in range(segments))
    clusters = (tuple(range(segments)),) if segments > 1 else ()
    cables = Members(edges, np.full(segments, 600.0), np.ones(segments), clusters=clusters)
    return Scene(Structure(nodes, np.ones(segments + 1), None, cables))


@pytest.mark.parametrize("segments", [1, 2])
def test_the_force_is_that_of_the_table(segments):
    """Straight between entries, on beyond the last; two cords, one after the other, stretch twice as far."""
    scene = cord(segments)
    scene = with_terms(scene, force_table(scene.structure.cables, STRETCH, FORCE))
    s = np.array([-0.1, 0.004, 0.02, 0.044, 0.06])
    expected = np.interp(s, [*STRETCH, 0.07], [*FORCE, 50.0])
    np.testing.assert_allclose(pull_of(scene, segments * s), expected, atol=1e-9)


def test_a_straight_table_is_a_spring():
    """Two entries have one slope, which is the cables' stiffness."""
    scene = cord()
    straight = with_terms(scene, force_table(scene.structure.cables, [0.0, 0.05], [0.0, 30.0]))
    np.testing.assert_allclose(pull_of(straight, np.array([-0.1, 0.02, 0.1])), [0.0, 12.0, 60.0], atol=1e-12)


class Bumper(EnergyTerm):
    """Springs beside cables that begin to act at a stretch of 1 cm."""

    name: ClassVar[str] = "bumpers of cables"

    def energy(self, at):
        return primitives.half_squares(1e5, primitives.positive_part(at.stretch("cables") - 0.01))


@pytest.mark.parametrize("law", ["table of cables' forces", "largest force of cables", "bumpers of cables"])
def test_prestress_is_uncertain_only_where_cables_are_linear(law):
    """Built 5 mm long, from 600 N/m: up to 10 mm or 6 N any share will do, beyond it tensions do not scale."""
    scene = cord()
    cables = dataclasses.replace(scene.structure.cables, rest_length=np.full(1, 0.995))
    terms = (force_table(cables, STRETCH, FORCE), force_limit(cables, 6.0), Bumper())
    term = next(term for term in terms if term.name == law)
    stretched = dataclasses.replace(scene.structure, cables=cables)
    scene = Scene(stretched, gait=Gait((0,), [0.0], [0.3], [1.0], start=-5.0), terms=(term,))
    gaits = as_population(scene.gait)
    ensemble(jax.random.key(0), scene, gaits, Uncertainty(prestress=0.9), 2)
    built = eqx.tree_at(lambda s: s.structure.cables.rest_length, scene, np.full(1, 0.994))
    with pytest.raises(InputError, match=rf"prestress = 0\.9: stretched 1\.9 times as far as built, .*{law}"):
        ensemble(jax.random.key(0), built, gaits, Uncertainty(prestress=0.9), 2)


@pytest.mark.parametrize("segments", [1, 2])
def test_no_spring_pulls_with_more_than_the_largest_force(segments):
    scene = cord(segments)
    scene = with_terms(scene, force_limit(scene.structure.cables, 12.0))
    s = np.array([-0.1, 0.01, 0.019, 0.021, 0.3])
    np.testing.assert_allclose(pull_of(scene, segments * s), np.clip(600.0 * s, 0, 12.0), atol=1e-9)


@pytest.mark.parametrize("segments", [1, 2])
def test_cables_push_beyond_their_dead_band(segments):
    """And not within it; a band of the whole cable's rest length never pushes."""
    plain = cord(segments)
    s = np.array([-0.4, -0.21, -0.19, -0.1, 0.02])
    for width, push in ((segments * 0.2, np.minimum(0, s + 0.2)), (0.0, np.minimum(0, s)), (float(segments), 0 * s)):
        scene = with_terms(plain, dead_band(plain.structure.cables, width))
        np.testing.assert_allclose(pull_of(scene, segments * s), 600.0 * (push + np.maximum(0, s)), atol=1e-9)


@pytest.mark.parametrize("segments", [1, 2])
def test_a_damper_beside_a_cable_acts_while_it_is_slack_too(segments):
    """Against the rate at which the whole cable changes its length, and not across it."""
    scene = cord(segments)
    scene = with_terms(scene, cable_dampers(scene.structure.cables, 3.0))
    v = np.zeros((segments + 1, 3))
    v[0], v[-1] = [0.1, 0.4, 0.0], [0.5, 0.0, 0.7]
    for stretch in (-0.3, 0.3):
        q = np.array(scene.structure.nodes)
        q[-1, 0] += stretch
        force = -jax.grad(scene.dissipation)(v, q, 0.0, None)
        np.testing.assert_allclose(force[0], [3.0 * 0.4, 0, 0], atol=1e-12)
        np.testing.assert_allclose(force[-1], [-3.0 * 0.4, 0, 0], atol=1e-12)


@pytest.mark.parametrize("segments", [1, 2])
def test_a_commanded_pull_depends_on_the_command_alone(segments):
    """P + s L0 c at any length, where c is the share by which a command shortens the cable; it never pushes."""
    plain = cord(segments)
    plain = eqx.tree_at(lambda s: s.structure.cables.stiffness, plain, np.zeros(segments))
    plain = with_terms(plain, commanded_pull(plain.structure.cables, 5.0, 40.0))
    s, members = np.array([-0.3, 0.0, 0.4]), tuple(range(segments))
    np.testing.assert_allclose(pull_of(plain, segments * s), 5.0, atol=1e-12)
    for share in (0.25, -0.5):
        asked = Command(members, np.full(segments, share), np.zeros(segments), 0.0)
        scene = eqx.tree_at(lambda s: s.gait, plain, asked, is_leaf=lambda x: x is None)
        pull = max(0.0, 5.0 + 40.0 * segments * share)
        np.testing.assert_allclose(pull_of(scene, segments * s), pull, atol=1e-12)


def test_a_table_follows_the_stiffness_of_its_cables():
    """Of robots that differ: in a cable that is softer each force is smaller, in one that is broken there is none."""
    scene = cord(2)
    scene = with_terms(scene, force_table(scene.structure.cables, STRETCH, FORCE))
    s = np.array([0.004, 0.02, 0.06])
    for share in (0.5, 0.0):
        other = eqx.tree_at(lambda s: s.structure.cables.stiffness, scene, np.full(2, share * 600.0))
        np.testing.assert_allclose(
            pull_of(other, 2 * s), share * np.interp(s, [*STRETCH, 0.07], [*FORCE, 50.0]), atol=1e-9
        )


def lifted() -> Scene:
    """A weight of 1 kg hangs where the table's second slope begins, and is lifted up and down."""
    nodes = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -1.03]])
    cable = Members(((0, 1),), [600.0], [1.0])
    hung = Structure(nodes, [0.0, 1.0], None, cable, ((0, "xyz"),))
    scene = Scene(hung, 9.81, gait=Gait((0,), [0.0], [0.05], [1.0], ramp=0.5))
    return with_terms(scene, force_table(cable, STRETCH, FORCE))


def test_the_power_of_actuators_against_the_table_is_booked(booked):
    assert (abs(booked(lifted())["actuation"]) > 1e-2).sum() > 10


@pytest.mark.campaign
def test_actuators_work_against_the_table_in_the_balance():
    """Along a motion."""
    audit = energy_audit(lifted(), 1.0, options=SolverOptions("rk4", 1e-3), frame_rate=20.0)
    assert abs(audit.residual).max() < 1e-4 * audit.turned_over


def test_a_table_that_stiffens_asks_for_smaller_steps():
    """A cord that is stretched to where the table's last slope, 1000 N/m, holds, in place of 600 N/m."""
    plain = cord()
    plain = eqx.tree_at(lambda s: s.structure.nodes, plain, 1.06 * plain.structure.nodes)
    tabled = with_terms(plain, force_table(plain.structure.cables, STRETCH, FORCE))
    limits = [step_limit(scene, "rk4").step for scene in (plain, tabled)]
    np.testing.assert_allclose(limits[1] / limits[0], np.sqrt(0.6), rtol=1e-6)


@pytest.mark.parametrize("text", [TABLE, LIMIT, BAND, PULL], ids=["table", "limit", "band", "pull"])
def test_scene_files_have_them(text, tmp_path):
    scene = parse_scene(text)
    assert scene.terms[0].name in describe(scene)
    save_scene(scene, tmp_path / "robot.toml")
    again = load_scene(tmp_path / "robot.toml")
    q = scene.structure.nodes * 1.1
    energy = eqx.filter_jit(lambda scene: scene.potential_energy(q, 0.0))
    assert float(energy(again)) == float(energy(scene))
    assert eqx.tree_equal(again.terms, scene.terms)
    with pytest.raises(InputError, match="knows linear springs alone"):
        inspect_structure(scene)


def test_laws_that_do_not_act_leave_statics_as_they_are(reference):
    """As of servos whose limits are not reached; of what acts in a shape nearby, the report knows nothing."""
    cables = reference.structure.cables
    far = with_terms(reference, force_limit(cables, 1e4), dead_band(cables, 0.2))
    report = inspect_structure(far)
    plain = inspect_structure(reference)
    assert report.table() == plain.table()
    np.testing.assert_array_equal(report.forces, plain.forces)
    most = float(report.forces.max())
    with pytest.raises(InputError, match="largest force of cables: the report"):
        inspect_structure(with_terms(reference, force_limit(cables, most * (1 + 1e-6))))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "[0.0, 6.0",
            "[1.0, 6.0",
            "cables.force: stretch = .*: expected as many numbers in each, two at least, and both",
        ),
        ("10.0, 30.0", "10.0, 9.0", "a force that rises at first and never falls"),
        ("[0.0, 0.01", "[0.0, 0.04", "expected an ascending stretch"),
        ("force = {", "stiffness = 5.0\nforce = {", "expected no stiffness beside it"),
        ("force = {", "largest_force = 5.0\nforce = {", "expected no largest_force beside it"),
        ("[0.0, 6.0", "[0.0, 'x'", "not TOML|expected"),
    ],
)
def test_bad_tables_are_refused(old, new, words):
    with pytest.raises(InputError, match=words):
        parse_scene(TABLE.replace(old, new))
    with pytest.raises(InputError, match="the table's first slope"):
        force_table(load_scene("reference").structure.cables, [0.0, 1.0], [0.0, 5.0])
    with pytest.raises(InputError, match=r"largest_force\[\d+\] = -1 N: expected a positive number"):
        force_limit(load_scene("reference").structure.cables, -1.0)
    with pytest.raises(InputError, match=r"cables: dead_band has 2 numbers; expected one, or 24"):
        parse_scene(BAND.replace("dead_band = 0.1", "dead_band = [0.1, 0.2]"))
