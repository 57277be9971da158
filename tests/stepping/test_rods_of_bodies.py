"""Rods of rigid bodies: capsules that roll and tip on edges and on each other, as closed forms and struts say."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrity
from jaxgrity import (
    Box,
    ConeFriction,
    ExactGround,
    InputError,
    Members,
    PenaltyGround,
    Push,
    Scene,
    SmoothFriction,
    SolverOptions,
    Structure,
    energy_audit,
    forces_along,
    simulate,
    with_contact_along_struts,
)
from jaxgrity.control import Discs, gap
from jaxgrity.io.scene_writing import scene_toml
from jaxgrity.model import exact_twin, penalty_twin, rigid_body, symmetries, with_contact_between_struts
from jaxgrity.model.rods import free_pairs, rods_of
from jaxgrity.model.strut_contact import strut_contact
from jaxgrity.populations import rod_depths
from jaxgrity.report.poses import robot_poses

G, R, MASS, SPEED = 9.81, 0.05, 2.0, 0.6
POST = Box((0.0, 0.0, 0.0), (0.2, 2.0, 0.6))
"""with edges along y, at z = 0.3"""
FRICTION = {"exact": ConeFriction(0.4), "penalty": SmoothFriction(0.4, 1e-3)}


def across_post(body: bool, friction=None) -> Scene:
    """A capsule of one metre, level along x, whose mass is at its ends: a body of two points, or a strut."""
    nodes = np.array([[-0.28, 0.0, 0.3 + R], [0.72, 0.0, 0.3 + R]])
    if body:
        rod = rigid_body(nodes, (0, 1), MASS, [0.0, 0.25 * MASS, 0.25 * MASS], rods=((0, 1),))
        structure = Structure(nodes, [0.0, 0.0], bodies=(rod,))
    else:
        structure = Structure(nodes, [MASS / 2] * 2, Members(((0, 1),), None, [1.0]))
    return with_contact_along_struts(Scene(structure, G, None, ExactGround(surface=POST), friction), 1, radius=R)


def log(z: float, first: int = 0) -> tuple[np.ndarray, jaxgrity.model.Body]:
    """A solid cylinder of one metre along x with its axis at z: both ends, and two points of its surface."""
    nodes = np.array([[-0.5, 0, z], [0.5, 0, z], [0, 0, z + R], [0, R, z]])
    own, turning = MASS * R**2 / 2, MASS * (3 * R**2 + 1) / 12
    every = np.concatenate([np.zeros((first, 3)), nodes])
    points = range(first, first + 4)
    return nodes, rigid_body(every, points, MASS, [own, turning, turning], [0.0, 0.0, z], rods=((first, first + 1),))


def on_post(contact: str) -> Scene:
    """The cylinder on the post, beside which both ends of it are in the air."""
    nodes, body = log(0.3 + R)
    ground = ExactGround(surface=POST) if contact == "exact" else PenaltyGround(2e5, 1.0, surface=POST)
    scene = Scene(Structure(nodes, np.zeros(4), bodies=(body,)), G, None, ground, FRICTION[contact])
    return with_contact_along_struts(scene, 1 if contact == "exact" else 3, radius=R)


def on_rails(contact: str) -> Scene:
    """The cylinder on two struts that are held, high above the ground."""
    nodes, body = log(1 + 2 * R, 4)
    rails = np.array([[-0.3, -1, 1], [-0.3, 1, 1], [0.3, -1, 1], [0.3, 1, 1]])
    stiffness = None if contact == "exact" else [1e5] * 2
    ground = ExactGround() if contact == "exact" else PenaltyGround(2e5, 1.0)
    structure = Structure(
        np.concatenate([rails, nodes]),
        np.r_[np.ones(4), np.zeros(4)],
        Members(((0, 1), (2, 3)), stiffness, [2.0] * 2),
        bodies=(body,),
        fixed=tuple((k, "xyz") for k in range(4)),
    )
    return with_contact_between_struts(Scene(structure, G, None, ground, FRICTION[contact]), R)


def pushed(scene: Scene) -> np.ndarray:
    """Velocities of a cylinder that begins to slide along y, m/s."""
    v = np.zeros(scene.structure.nodes.shape)
    v[-4:, 1] = SPEED
    return v


@pytest.mark.campaign
@pytest.mark.parametrize("friction", [None, 0.3])
def test_a_body_tips_over_an_edge_as_a_strut_does(friction):
    """To rounding; a strut is compared with its equations in `test_capsules.py`."""
    cone = None if friction is None else ConeFriction(friction)
    body, strut = (
        simulate(across_post(each, cone), 0.4, options=SolverOptions(dt=5e-3)).positions for each in (True, False)
    )
    assert body[-1, 0, 2] - body[-1, 1, 2] > 0.3
    np.testing.assert_allclose(body, strut, atol=1e-12)


@pytest.mark.parametrize(
    ("made", "contact"),
    [
        pytest.param(on_post, "exact", marks=pytest.mark.slow),
        *(pytest.param(*each, marks=pytest.mark.campaign) for each in ((on_rails, "exact"), (on_post, "penalty"))),
        pytest.param(on_rails, "penalty", marks=pytest.mark.campaign),
    ],
)
def test_a_cylinder_that_slides_begins_to_roll(made, contact):
    """At 2/3 of its speed: half of its mass counts once more as it turns, whatever it rolls on."""
    scene = made(contact)
    options = SolverOptions(dt=2e-3) if contact == "exact" else SolverOptions("rk4", dt=1e-4)
    motion = simulate(scene, 0.3, velocities=pushed(scene), options=options)
    ends = np.asarray(motion.positions)[:, -4:-2]
    speed = (ends[-1] - ends[-6])[:, 1] / (motion.times[-1] - motion.times[-6])
    np.testing.assert_allclose(speed, SPEED * 2 / 3, rtol=1e-9 if contact == "exact" else 3e-3)
    np.testing.assert_allclose(ends[..., 2], ends[0, 0, 2], atol=1e-9 if contact == "exact" else 1e-3)
    np.testing.assert_allclose(ends[..., 0], [[-0.5, 0.5]] * len(ends), atol=1e-9)


@pytest.mark.campaign
@pytest.mark.parametrize("made", [on_post, on_rails])
def test_friction_on_surfaces_is_booked_where_it_acts(made):
    """Of a cylinder that is pushed too hard to roll: by the slip of its surface. Momenta balance to rounding."""
    scene, push = made("exact"), 20.0
    first = len(scene.structure.nodes) - 4
    force = Push((first, first + 1), np.tile([0.0, MASS * push / 2, 0.0], (2, 1)), -1.0, 2.0)
    scene, options = replace(scene, terms=(force, *scene.terms)), SolverOptions(dt=2e-3)
    audit = energy_audit(scene, 0.2, options=options)
    # friction mu g turns it: its surface gets 2 mu g of its acceleration, its axis push - mu g
    slip = (push - 3 * 0.4 * G) * 0.2
    assert audit.dissipated["friction"][-1] == pytest.approx(0.4 * MASS * G * slip * 0.2 / 2, rel=2e-2)
    assert np.max(audit.momentum_residual) < 1e-10
    forces = forces_along(scene, simulate(scene, 0.2, options=options))
    carried = forces.ground if made is on_post else forces.between[:, 4:]
    np.testing.assert_allclose(carried[-2].sum(0), [0.0, -0.4 * MASS * G, MASS * G], atol=1e-6)


@pytest.mark.campaign
def test_derivatives_are_those_of_differences():
    """Of where the cylinder gets on the post, by its speed: it slides, then rolls."""
    scene = on_post("exact")
    options = jaxgrity.stepping.resolve(scene, 0.1, SolverOptions(dt=5e-3))
    v = jnp.asarray(pushed(scene))

    def place(factor):
        q, w = jaxgrity.final_state(scene, 0.1, options, (jnp.asarray(scene.structure.nodes), factor * v))
        return q[0, 1] + q[2, 1] + 0.1 * w[3, 2]

    slope = jax.jit(jax.value_and_grad(place))(1.0)[1]
    forward = jax.jit(lambda x: jax.jvp(place, (x,), (1.0,))[1])(1.0)
    low, high = (jax.jit(place)(1.0 + d) for d in (-1e-4, 1e-4))
    assert abs(slope) > 1e-2
    np.testing.assert_allclose([slope, forward], (high - low) / 2e-4, rtol=1e-5)


@pytest.mark.campaign
def test_it_rolls_as_in_mujoco():
    """The cylinder on the post, whose contacts are soft there."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option timestep="1e-4" cone="elliptic" impratio="100"/><worldbody>
        <geom type="box" size="0.1 1 0.3" friction="0.4" condim="3" solref="0.002 1"/>
        <body pos="0 0 {0.3 + R}"><freejoint/>
        <inertial pos="0 0 0" mass="{MASS}" diaginertia="{MASS * R**2 / 2} {MASS * (3 * R**2 + 1) / 12}
        {MASS * (3 * R**2 + 1) / 12}"/>
        <geom type="capsule" fromto="-0.5 0 0 0.5 0 0" size="{R}" friction="0.4" condim="3" solref="0.002 1"/>
        </body></worldbody></mujoco>"""
    )
    data = mujoco.MjData(model)
    data.qvel[1] = SPEED
    for _ in range(3000):
        mujoco.mj_step(model, data)
    motion = simulate(on_post("exact"), 0.3, velocities=pushed(on_post("exact")), options=SolverOptions(dt=2e-3))
    there, here = data.qpos[:3], np.asarray(motion.positions)[-1, :2].mean(0)
    assert here[1] > 0.11
    np.testing.assert_allclose(here, there, atol=1e-3)


def stacked() -> Structure:
    """Two cylinders without a common node, one with a second rod, and a strut from one of them to a further node."""
    (low, first), (high, _) = log(1.0), log(2.0)
    nodes = np.concatenate([low, high, [[0.0, 0.5, 1.0]]])
    moments = np.diag([1.0, 2.0, 2.0]) * 0.1
    second = rigid_body(nodes, range(4, 8), MASS, moments, [0.0, 0.0, 2.0], rods=((4, 5), (6, 7)))
    strut = Members(((3, 8),), None, [0.5 - R])
    return Structure(nodes, np.r_[np.zeros(8), 1.0], strut, bodies=(first, second))


def test_rods_count_on_after_struts():
    """By default those touch each other that no node or body joins; pairs may say otherwise."""
    structure = stacked()
    assert rods_of(structure) == ((3, 8), (0, 1), (4, 5), (6, 7))
    assert free_pairs(structure) == ((0, 2), (0, 3), (1, 2), (1, 3))
    scene = Scene(structure, G, None, ExactGround())
    assert strut_contact(with_contact_between_struts(scene, 0.01)).between.pairs == free_pairs(structure)
    asked = with_contact_between_struts(scene, 0.01, ((0, 1), (1, 3)))
    assert strut_contact(asked).between.ends == ((3, 0), (8, 1), (0, 6), (1, 7))
    for pair in ((2, 3), (1, 1), (0, 4)):
        with pytest.raises(InputError, match=r"expected two of 4 struts and rods of bodies, without a common node"):
            with_contact_between_struts(scene, 0.01, (pair,))
    with pytest.raises(InputError, match=r"struts = \[4\]: expected some of 4 struts and rods of bodies, each once"):
        with_contact_along_struts(scene, 1, (4,))


def test_impossible_rods_are_refused():
    """Where they are given, with the points of the body."""
    nodes, _ = log(1.0)
    for rods, said in ((((0, 4),), "expected two of the points"), (((0, 1), (1, 0)), "expected each pair once")):
        with pytest.raises(InputError, match=said):
            rigid_body(nodes, range(4), MASS, [0.1] * 3, rods=rods)


@pytest.mark.parametrize("soft", [False, True])
def test_files_have_rods_and_what_touches(soft):
    """Read and written, with the radii; without struts the contact has a table of its own."""
    scene = Scene(stacked(), G, None, ExactGround(), ConeFriction(0.4))
    scene = with_contact_between_struts(with_contact_along_struts(scene, 1, radius=0.02), [0.01, 0.02, 0.03, 0.04])
    if soft:
        scene = penalty_twin(scene)
    text = scene_toml(scene)
    assert "rods = [[4, 5], [6, 7]]" in text
    assert "[touching]" in text
    again = jaxgrity.parse_scene(text)
    assert [body.rods for body in again.structure.bodies] == [((0, 1),), ((4, 5), (6, 7))]
    assert strut_contact(again).between.ends == strut_contact(scene).between.ends
    np.testing.assert_array_equal(strut_contact(again).between.radius, strut_contact(scene).between.radius)
    assert jaxgrity.model.rod_contact.radii_along_struts(again) == dict.fromkeys(range(4), 0.02)
    with pytest.raises(InputError, match=r"bodies\[0\]: rods has \[0, 7\]"):
        jaxgrity.parse_scene(text.replace("rods = [[0, 1]]", "rods = [[0, 7]]"))
    both = text.replace("[struts]", "[struts]\ntouching = { radius = 0.01 }")
    with pytest.raises(InputError, match=r"touching: struts.touching is given too"):
        jaxgrity.parse_scene(both)


def test_twins_touch_along_the_same_rods():
    """Of bodies alone, on both contact models."""
    nodes, body = log(1.0)
    scene = Scene(Structure(nodes, np.zeros(4), Members(((0, 2),), [1e3], [0.5]), bodies=(body,)), G, None, None)
    scene = replace(scene, ground=PenaltyGround(1e5, 1.0), friction=SmoothFriction(0.4, 0.01))
    soft = with_contact_along_struts(scene, 3, (1,), radius=R)
    exact = exact_twin(soft)
    assert exact.ground.capsules.struts == (1,)
    assert exact.ground.capsules.ends == ((0,), (1,))
    np.testing.assert_array_equal(penalty_twin(exact).terms[0].points.radius, np.full(5, R))


def test_figures_and_distances_have_the_radius():
    """Of a rod with contact along it; the other lines of the body stay thin."""
    nodes, body = log(0.02)
    structure = Structure(nodes, np.zeros(4), cables=Members(((2, 3),), [1.0], [0.1]), bodies=(body,))
    scene = with_contact_along_struts(Scene(structure, G, None, ExactGround()), 1, radius=R)
    none = jnp.array(0)
    still = jaxgrity.Trajectory(
        np.array([0.0, 0.1]), nodes[None].repeat(2, 0), np.zeros((2, 4, 3)), none, none, none, "rk4", 1e-3, scene
    )
    np.testing.assert_allclose(rod_depths(scene, still), [R - 0.02])
    discs = Discs(np.array([[0.2, -0.3]]), np.array([0.1]))
    np.testing.assert_allclose(gap(discs, scene, nodes), 0.3 - 0.1 - R)
    assert "1 rods of bodies of radius 0.05 m" in jaxgrity.describe(scene)
    raised = replace(still, positions=still.positions + np.array([0.0, 0.0, 0.03]), method="complementarity")
    radii = robot_poses(scene, raised, 10.0).bodies.scale[0, :, 0]
    assert radii[0] == R
    assert (radii[1:] < R).all()


def test_symmetries_map_rods_on_rods():
    """A body keeps fewer of them if one of its lines may touch."""
    nodes = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 0.5]])
    body = lambda rods: rigid_body(nodes, range(5), MASS, [0.1, 0.1, 0.15], [0.0, 0.0, 0.1], (0, 1, 2, 4), rods)  # noqa: E731
    count = {rods: len(symmetries(Structure(nodes, np.zeros(5), bodies=(body(rods),)))) for rods in ((), ((0, 2),))}
    assert count[((0, 2),)] < count[()]
