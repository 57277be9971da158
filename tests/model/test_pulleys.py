"""Cables over pulleys: lengths and forces by hand, Atwood's machine, friction as Euler and Eytelwein say, refusals."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrity import (
    ExactGround,
    Gait,
    InputError,
    Members,
    Scene,
    SolverOptions,
    Structure,
    describe,
    energy_audit,
    final_state,
    gaits_of,
    load_scene,
    parse_scene,
    save_scene,
    simulate,
    simulate_population,
)
from jaxgrity.formats import save_mjcf, save_urdf
from jaxgrity.model import Pulley, rigid_body
from jaxgrity.model.pulleys import CableRoute, built_lengths
from jaxgrity.stepping import resolve
from jaxgrity.stepping.dynamics import member_tensions, total_force

G = 9.81


def over(radius: float, nodes, stretch: float = 0.01, mass=(1.0, 0.5, 2.0), fixed=(), gravity=None, **more) -> Scene:
    """A cable from node 0 over a pulley at node 1 to node 2, of 2/3 kN/m, stretched by so much, m."""
    pulley = Pulley((0, 1), radius, **({"axis": (0.0, 1.0, 0.0)} | more))
    x, edges, clusters = np.array(nodes, float), ((0, 1), (2, 1)), ((0, 1),)
    rest = built_lengths(CableRoute(edges, clusters, (pulley,)), x) - stretch / 2
    cables = Members(edges, [2e3, 1e3], rest, clusters=clusters, pulleys=(pulley,))
    return Scene(Structure(x, np.array(mass, float), None, cables, fixed), gravity)


def atwood(radius: float, heavy: float = 2.0, tension: float = 4 / 3 * G, **more) -> Scene:
    """1 kg and some more on a cable over a drum that stands still; it starts at rest, under a tension."""
    nodes = [[-radius, 0, 4.0], [0, 0, 5.0], [radius, 0, 3.8]]
    fixed = ((1, "xyz"), (0, "xy"), (2, "xy"))
    return over(radius, nodes, tension / (2e3 / 3), (1.0, 0.0, heavy), fixed, G, **more)


def bent(angle: float, radius: float = 0.2, **more) -> Scene:
    """The cable from the left, and away at an angle below the horizontal, rad."""
    return over(radius, [[-1.0, 0, 0], [0, 0, 0], [1.5 * math.cos(angle), 0, -1.5 * math.sin(angle)]], **more)


energy_and_slope = jax.jit(lambda scene, q: jax.value_and_grad(scene.potential_energy)(q, 0.0))
tensions = jax.jit(lambda scene, q, v=None: member_tensions(scene, 0.0, q, v)["cables"])
forces = jax.jit(lambda scene, q, v: total_force(scene, 0.0, q, v))


def force_of(scene: Scene) -> np.ndarray:
    """At rest, from U."""
    return -np.asarray(energy_and_slope(scene, scene.structure.nodes)[1])


@pytest.mark.parametrize(("side", "sign"), [((0, 0, 1), -1), ((0, 0, -1), 1)], ids=["open", "crossed"])
def test_length_of_a_belt_over_two_circles_is_that_by_hand(side, sign):
    big, small, apart = 0.3, 0.1, 1.2
    pulleys = Pulley((0, 1), small, side), Pulley((1, 0), big, (0, 0, 2))
    belt = CableRoute(((0, 1), (1, 0)), ((0, 1),), pulleys)
    found = built_lengths(belt, np.array([[0, 0, 0.7], [apart, 0, 0.7]])).sum()
    lean = math.asin((big + sign * small) / apart)
    arcs = big * (math.pi + 2 * lean) + small * (math.pi + sign * 2 * lean)
    assert found == pytest.approx(2 * apart * math.cos(lean) + arcs, rel=1e-14)


def test_length_is_that_of_the_shortest_way_around_as_the_wrap_changes():
    """Two tangents and an arc; the straight line where that passes beside the pulley; once more around with a turn."""
    lean = math.asin(0.2) + math.asin(0.2 / 1.5)
    tangents = math.sqrt(1 - 0.04) + math.sqrt(1.5**2 - 0.04)
    for angle in (-0.4, -lean / 2, 0.0, 1.0, 3.0, 4.7):
        nodes = bent(angle).structure.nodes
        cable = bent(angle).structure.cables
        straight = np.linalg.norm(nodes[2] - nodes[0])
        by_hand = tangents + 0.2 * (angle + lean) if angle > -lean else straight
        assert built_lengths(cable, nodes).sum() == pytest.approx(by_hand, rel=1e-14)
        whole = dataclasses.replace(cable, pulleys=(Pulley((0, 1), 0.2, (0, 1, 0), turns=2),))
        assert built_lengths(whole, nodes).sum() == pytest.approx(tangents + 0.2 * (angle + lean + 4 * math.pi))
    # it leaves the pulley without a jump of length or force
    on, off = (force_of(bent(-lean + way)) for way in (1e-7, -1e-7))
    np.testing.assert_allclose(on, off, atol=1e-5)


@pytest.mark.parametrize("angle", [-0.5, 0.2, 1.5, 3.0])
def test_force_on_the_centre_is_that_of_both_tensions(angle):
    """2 T sin(wrap/2) towards the middle of the arc, none without an arc; each end is pulled along its tangent by T."""
    scene = bent(angle)
    tension, wrap = 2e3 / 3 * 0.01, max(0.0, angle + math.asin(0.2) + math.asin(0.2 / 1.5))
    force = force_of(scene)
    np.testing.assert_allclose(
        np.linalg.norm(force, axis=1), tension * np.array([1, 2 * math.sin(wrap / 2), 1]), atol=1e-9
    )
    np.testing.assert_allclose(force.sum(0), 0, atol=1e-9)
    np.testing.assert_allclose(np.cross(scene.structure.nodes, force).sum(0), 0, atol=1e-9)
    np.testing.assert_allclose(tensions(scene, scene.structure.nodes), tension, rtol=1e-9)
    for node, axis in ((0, 2), (1, 0), (1, 2), (2, 0)):
        push = 1e-6 * np.eye(9)[3 * node + axis].reshape(3, 3)
        before, after = (float(energy_and_slope(scene, scene.structure.nodes + way * push)[0]) for way in (-1, 1))
        assert force[node, axis] == pytest.approx((before - after) / 2e-6, abs=1e-6)


def bracket(mu: float | None = None) -> Scene:
    """A pulley in a body of five nodes, with its axle in the body; the cable's ends are off its plane."""
    x = np.array(
        [[-1.0, 0.2, 0.4], [0, 0, 0], [1.2, -0.1, -0.5], [0, -0.3, 0], [0, 0.3, 0], [0.3, 0, 0.1], [0.1, 0.1, 0.5]]
    )
    body = rigid_body(x, (1, 3, 4, 5, 6), 2.0, [0.1, 0.1, 0.1])
    slip = None if mu is None else 0.01
    pulley = Pulley((0, 1), 0.15, axle=(3, 4), mu=mu, slip_speed=slip, drum=None if mu is None else 5)
    rest = built_lengths(CableRoute(((0, 1), (1, 2)), ((0, 1),), (pulley,)), x) - 0.02
    cables = Members(((0, 1), (1, 2)), [2e3, 1e3], rest, [3.0, 2.0], clusters=((0, 1),), pulleys=(pulley,))
    return Scene(Structure(x, np.array([0.5, 0, 0.5, 0, 0, 0, 0]), None, cables, bodies=(body,)))


@pytest.mark.parametrize("mu", [None, 0.3])
def test_a_pulley_in_a_body_has_no_force_or_moment_from_outside(mu):
    """Also where the cable runs off its plane, and where it slides on the drum with friction."""
    scene = bracket(mu)
    v = np.random.default_rng(0).normal(size=(7, 3))
    force = np.asarray(forces(scene, scene.structure.nodes, v))
    assert np.linalg.norm(force, axis=1).max() > 1
    np.testing.assert_allclose(force.sum(0), 0, atol=1e-11)
    np.testing.assert_allclose(np.cross(scene.structure.nodes, force).sum(0), 0, atol=1e-11)


@pytest.mark.campaign
@pytest.mark.parametrize("mu", [pytest.param(None, marks=pytest.mark.campaign), 0.3])
def test_powers_of_cables_over_pulleys_are_booked(booked, mu):
    """Of dampers, whose rate is that of the length, and of friction, which never drives."""
    found = booked(bracket(mu), spread=0.005)
    assert (found["cables"] > 1e-3).all()
    if mu is not None:
        assert (found["pulleys"] > 1e-3).all()


@pytest.mark.slow
@pytest.mark.parametrize("radius", [pytest.param(0.05, marks=pytest.mark.campaign), 0.3])
@pytest.mark.parametrize("exact", [False, True], ids=["rk4", "exact"])
def test_weights_over_a_pulley_fall_as_atwood_says(radius, exact):
    """a = g (M - m)/(M + m), whatever the radius; on exact contact, too, whose ground is out of reach."""
    scene = dataclasses.replace(atwood(radius), ground=ExactGround() if exact else None)
    options = SolverOptions(dt=1e-3)
    end = simulate(scene, 0.3, options=options, frame_rate=10.0).positions[-1]
    fallen = G / 3 * 0.3**2 / 2
    np.testing.assert_allclose(end[:, 2], [4.0 + fallen, 5.0, 3.8 - fallen], atol=2e-3 if exact else 1e-6)


def swing(radius=0.1, gait: Gait | None = None, ground=None) -> Scene:
    """A weight on a pulley that rolls along a cable between two points: wrap and lengths change."""
    nodes = [[-1.0, 0, 5.0], [-0.5, 0, 4.2], [1.0, 0, 5.2]]
    fixed = ((0, "xyz"), (2, "xyz"), (1, "y"))
    scene = over(0.1, nodes, 0.005, (0, 0.5, 0), fixed, G, axis=(0, -2.0, 0))
    scene = eqx.tree_at(lambda s: s.structure.cables.pulleys[0].radius, scene, radius)
    return dataclasses.replace(scene, gait=gait, ground=ground)


@pytest.mark.campaign
@pytest.mark.parametrize(("ground", "share"), [(None, 1e-7), (ExactGround(), 1e-3)], ids=["rk4", "exact"])
def test_a_pulley_that_rolls_along_its_cable_keeps_energy(ground, share):
    audit = energy_audit(swing(ground=ground), 0.6, options=SolverOptions(dt=5e-4), frame_rate=20.0)
    assert audit.turned_over > 0.1
    assert abs(audit.residual).max() < share * audit.turned_over
    assert max(audit.momentum_residual.max(), audit.angular_residual.max()) < 1e-2 * share ** (1 / 3)


@pytest.mark.campaign
def test_derivative_in_the_radius_is_that_of_differences():
    options = resolve(swing(), 0.2, SolverOptions("rk4", 1e-3, any_step=True))

    def height(radius):
        return final_state(swing(radius), 0.2, options)[0][1, 2]

    differences = float(height(jnp.asarray(0.1001)) - height(jnp.asarray(0.0999))) / 2e-4
    assert abs(differences) > 1e-2
    assert float(jax.grad(height)(0.1)) == pytest.approx(differences, rel=1e-5)


@pytest.mark.campaign
def test_one_of_many_robots_with_pulleys_moves_as_it_does_alone():
    gait = Gait((0,), [0.0], [0.2], [1.0], ramp=0.2)
    scene, options = swing(gait=gait), SolverOptions("rk4", 1e-3, any_step=True)
    many = simulate_population(scene, gaits_of(gait, np.array([[0.0], [1.0]])), 0.3, options=options)
    alone = simulate(scene, 0.3, options=options)
    np.testing.assert_allclose(many.positions[0], alone.positions[-1], rtol=0, atol=1e-12)


def test_cables_slide_over_a_drum_as_euler_and_eytelwein_say():
    """The tensions differ by exp(mu angle), whichever way the cable slides; the friction's work is lost."""
    scene = atwood(0.1, mu=0.3, slip_speed=1e-3)
    q = scene.structure.nodes
    for speed in (1.0, -1.0):
        v = np.array([[0, 0, speed], [0, 0, 0], [0, 0, -speed]])
        before, after = np.asarray(tensions(scene, q, v))
        assert after / before == pytest.approx(math.exp(0.3 * math.pi * speed), rel=1e-5)
        assert before + after == pytest.approx(8 / 3 * G, rel=1e-9)
        moment = -0.1 * (after - before)  # of the weights; that of the drum is on its support
        found = np.cross(q, np.asarray(forces(scene, q, v) - forces(scene, q, 0 * v)))
        assert found.sum(0)[1] == pytest.approx(moment, rel=1e-9)


@pytest.mark.campaign
def test_friction_on_a_drum_holds_what_is_within_the_bound():
    """But for a creep below the slip speed; what is beyond falls by a = g (M - m e)/(M + m e), e = exp(mu pi)."""
    e, options = math.exp(0.3 * math.pi), SolverOptions("rk4", 2e-4, any_step=True)
    held = simulate(atwood(0.1, 2.0, 1.5 * G, mu=0.3, slip_speed=1e-3), 0.5, options=options).positions[-1]
    assert abs(held[2, 2] - 3.8) < 0.5 * 1e-3 + 1.5 * G / 2e3
    a = G * (5 - e) / (5 + e)
    slipping = atwood(0.1, 5.0, (G + a) * (1 + e) / 2, mu=0.3, slip_speed=1e-3)
    fallen = 3.8 - simulate(slipping, 0.3, options=options).positions[-1][2, 2]
    assert fallen == pytest.approx(a * 0.3**2 / 2, rel=0.02)


FILE = """
[structure]
kind = "custom"
nodes = [[-0.1, 0.0, 1.0], [0.0, 0.0, 2.0], [0.1, 0.0, 0.8]]
node_mass = [1.0, 0.0, 2.0]
cables = [[0, 1], [1, 2]]
fixed = [1]
[cables]
stiffness = 1000.0
prestrain = 0.01
clusters = [[0, 1]]
pulleys = [{ between = [0, 1], radius = 0.1, axis = [0.0, 1.0, 0.0], mu = 0.2, slip_speed = 0.01 }]
"""


def test_scene_files_have_pulleys(tmp_path):
    """Prestrain is that of the whole length, arcs too; reports and files without pulleys say so."""
    scene = parse_scene(FILE)
    assert sum(scene.structure.cables.rest_length) == pytest.approx(0.99 * (2.2 + 0.1 * math.pi), rel=1e-12)
    assert "over a pulley between [[0, 1]]" in describe(scene)
    assert "friction on pulleys" in describe(scene).splitlines()[0]
    save_scene(scene, tmp_path / "robot.toml")
    assert eqx.tree_equal(load_scene(tmp_path / "robot.toml").structure, scene.structure)
    for save in (save_mjcf, save_urdf):
        with pytest.raises(InputError, match=r"pulleys between cables \[\[0, 1\]\]: .*expected clusters without"):
            save(scene, tmp_path / "robot.xml")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("between = [0, 1]", "between = [1, 0]"), r"cables: pulley between \[1, 0\]: these do not follow each other"),
        (("radius = 0.1,", "radius = 1.1,"), "radius 1.1 m: no cable runs over it with the nodes as built"),
        (("axis = [0.0, 1.0, 0.0]", "axis = [0.0, 0.0, 0.0]"), r"axis = \[0.0, 0.0, 0.0\]: expected a direction"),
        (("axis = [0.0, 1.0, 0.0],", ""), "expected either an axis"),
        (("axis = [0.0, 1.0, 0.0]", "axle = [0, 9]"), "axle or drum has node 9; expected 0 to 2"),
        (("mu = 0.2,", ""), "mu and slip_speed belong together"),
        (("slip_speed = 0.01", "slip_speed = 0.01, drum = 1"), "drum = 1, its centre; expected another"),
    ],
)
def test_what_is_no_pulley_is_refused(change, words):
    with pytest.raises(InputError, match=words):
        parse_scene(FILE.replace(*change))


def test_pulleys_beside_each_other_have_parallel_axes_and_stay_wrapped():
    """Friction has a beginning and an end of the cable."""
    x, edges, clusters = np.array([[0, 0, 0], [1.0, 0, 0]]), ((0, 1), (1, 0)), ((0, 1),)
    one = Pulley((0, 1), 0.1, (0, 0, 1))
    for other, words in (
        (Pulley((1, 0), 0.1, (0, 1, 0)), "axes across each other"),
        (Pulley((1, 0), 1.5, (0, 0, 1)), r"radius 0.1 m: no cable runs"),
        (Pulley((1, 0), 0.1, (0, 0, 1), mu=0.1, slip_speed=0.1), "friction on a closed belt"),
        (Pulley((0, 1), 0.2, (0, 0, 1)), "expected one at most between two cables"),
    ):
        with pytest.raises(InputError, match=words):
            Structure(
                x, np.ones(2), None, Members(edges, np.ones(2), np.ones(2), clusters=clusters, pulleys=(one, other))
            )
