"""Scenes with rigid bodies as MuJoCo models: they move there as here, and are read again as the same bodies."""

import dataclasses

import numpy as np
import pytest
from measurements.conformance import by_both

from jaxgrity import InputError, Members, Scene, SolverOptions, Structure, edge_lengths, parse_scene, simulate
from jaxgrity.formats import mujoco_model, read_mjcf, save_mjcf
from jaxgrity.model import body_moments, rigid_body

mujoco = pytest.importorskip("mujoco")
run_once = pytest.importorskip("measurements.mujoco_peer").run_once

SPIN = np.array([1.0, 2.0, 3.0])
"""rad/s, of the bodies that turn at the start"""
SOLID = np.array([[0.0, 0, 0], [0.4, 0, 0], [0, 0.3, 0], [0, 0, 0.5], [0.1, 0.1, 0.1]])
FULL = np.array([[0.03, 0.002, -0.001], [0.002, 0.04, 0.003], [-0.001, 0.003, 0.05]])
ROBOT = """
[structure]
kind = "{kind}"
prestress = {tension}
[cables]
stiffness = 2000.0
damping = 20.0
[gravity]
[damping]
node = 0.5
"""
GROUND = """
[ground]
contact = "complementarity"
[friction]
kind = "cone"
mu = 0.5
"""
GAIT = """
[gait]
members = "cables"
amplitude = 0.2
frequency = 1.3
phase = { seed = 1 }
ramp = 0.1
"""


def in_cables(nodes: np.ndarray, bodies: tuple, edges: tuple, mass: np.ndarray, **more) -> Scene:
    """Bodies in cables, stretched to 1.6 of their rest lengths. Dampers would act there on slack ones, too."""
    count = len(edges)
    cables = Members(edges, np.full(count, 20.0), edge_lengths(nodes, edges) / 1.6)
    return Scene(Structure(nodes, mass, cables=cables, bodies=bodies, **more), gravity=9.81)


def apart() -> Scene:
    """A solid body, a plate, a rod and a ball, no two of which share a node; two nodes have mass of their own."""
    plate, rod = np.array([[0.9, 0, 0], [1.2, 0, 0], [0.9, 0.3, 0.4]]), [[0, 0, 1.0], [0, 0.4, 1.1]]
    nodes = np.concatenate([SOLID, rod, plate, [[1.0, 1, 1]]])
    across = np.array([0, 0.8, -0.6])
    bodies = (
        rigid_body(nodes, range(5), 1.2, FULL, [0.1, 0.05, 0.2]),
        rigid_body(nodes, (5, 6), 0.4, 0.4 * 0.17 / 12 * (np.eye(3) - np.outer([0, 4, 1], [0, 4, 1]) / 17)),
        rigid_body(nodes, (7, 8, 9), 0.6, 0.01 * np.eye(3) + 0.01 * np.outer(across, across)),
    )
    mass = np.zeros(11)
    mass[[3, 10]] = 0.2, 0.3
    return in_cables(nodes, bodies, ((0, 5), (2, 6), (4, 10), (6, 10), (1, 7), (8, 10), (9, 6), (3, 9)), mass)


def joined(closed: bool = False) -> Scene:
    """A body hangs from a support; on it a rod by a ball joint, and a plate by a hinge, with cables between them.

    `closed`: the rod's other end belongs to the plate, too, and a ball hangs in its place.
    """
    more, end = np.array([[0.6, 0.1, 0.1], [0.0, 0.3, -0.6], [-0.5, -0.5, 0.3]]), 5 if closed else 6
    nodes = np.concatenate([SOLID, more[[1, 0, 2]] if closed else more])
    across = np.cross(nodes[4] - nodes[1], nodes[5] - nodes[1])
    across /= np.linalg.norm(across)
    bodies = (
        rigid_body(nodes, range(5), 1.2, FULL, [0.1, 0.05, 0.2], basic=(1, 2, 3, 4)),
        rigid_body(nodes, (1, 4, 5), 0.7, 0.02 * np.eye(3) + 0.02 * np.outer(across, across)),
        rigid_body(nodes, (2, end), 0.3, [0.009, 0.009, 0]),
    )
    mass = np.zeros(8)
    mass[6] = 0.1 if closed else 0
    return in_cables(nodes, bodies, ((0, 5), (7, 4), (6, 3), (7, 6)), mass, fixed=((3, "xyz"), (7, "xyz")))


def spinning(scene: Scene, model, data) -> np.ndarray:
    """m/s: velocities of the nodes, of free bodies that turn as `SPIN` says. MuJoCo's `data` gets the same.

    A rod does not turn about its own line, about which it has some inertia there.
    """
    x, v = np.asarray(scene.structure.nodes), np.zeros((len(scene.structure.nodes), 3))
    for number, body in enumerate(scene.structure.bodies):
        own = list(body.points)
        along = x[own[0]] - x[own[1]]
        spin = SPIN - (SPIN @ along / (along @ along) * along if len(own) == 2 else 0)
        v[own] = np.cross(spin, x[own] - model.body(f"body{number}").pos)
        first = model.jnt_dofadr[model.body(f"body{number}").jntadr[0]]
        data.qvel[first + 3 : first + 6] = spin
    return v


@pytest.mark.slow
def test_free_flight_of_turning_bodies_agrees():
    """RK4 in both, 0.5 s: within 1e-6 m, with the mass of MuJoCo's model as that of the scene."""
    scene = apart()
    model = mujoco.MjModel.from_xml_string(mujoco_model(scene, 1e-4).xml)
    data = mujoco.MjData(model)
    start = spinning(scene, model, data)
    mujoco.mj_step(model, data, 5000)
    mujoco.mj_kinematics(model, data)
    theirs = data.site_xpos[[model.site(f"n{k}").id for k in range(11)]]
    options = SolverOptions(method="rk4", dt=1e-4)
    ours = simulate(scene, 0.5, options=options, frame_rate=2.0, velocities=start).positions[-1]
    assert model.body_mass.sum() == pytest.approx(float(scene.structure.mass), rel=1e-12)
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-6)
    assert np.linalg.norm(ours - scene.structure.nodes, axis=1).min() > 0.1


@pytest.mark.slow
@pytest.mark.parametrize(("closed", "within"), [(False, 1e-6), (True, 1e-3)], ids=["a tree", "a loop"])
def test_joints_and_supports_are_those_of_the_scene(closed, within):
    """Ball joints and hinges of a tree are exact there; a loop gives way, and a note says so."""
    scene = joined(closed)
    written = mujoco_model(scene)
    model = mujoco.MjModel.from_xml_string(written.xml)
    kinds = [mujoco.mjtJoint(int(kind)).name for kind in model.jnt_type]
    assert kinds[:3] == ["mjJNT_BALL", "mjJNT_HINGE", "mjJNT_BALL"]
    assert model.neq == int(closed)
    assert ("1 points of joints close loops, and give way there a little" in written.notes) == closed
    theirs, _ = run_once(scene, 0.5, 1e-4)
    options = SolverOptions(method="rk4", dt=1e-4)
    ours = np.asarray(simulate(scene, 0.5, options=options, frame_rate=2.0).positions[-1])
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=within)
    assert np.linalg.norm(ours - scene.structure.nodes, axis=1).max() > 0.2


@pytest.mark.campaign
def test_a_gait_drives_hinges_as_in_the_scene():
    """Two cables beside each hinge, which do not go slack: within 1e-6 m after 0.5 s, where it is bent.

    MuJoCo holds a control for a whole step, so that its steps are small here.
    """
    scene = parse_scene(ROBOT.format(kind="hinged_spine", tension=20) + GAIT)
    theirs, ours, _ = by_both(scene, 0.5, 2e-5, SolverOptions(method="rk4", dt=1e-4))
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-6)
    moved = ours - scene.structure.nodes
    assert np.linalg.norm(moved - moved.mean(0), axis=1).max() > 5e-4


@pytest.mark.campaign
@pytest.mark.parametrize("kind", ["quadruped", pytest.param("capped_robot", marks=pytest.mark.campaign)])
def test_settled_heights_agree(kind):
    """The middle of the nodes at rest: within the penetration of MuJoCo's contact."""
    pose = 'pose = "face"\n' if kind == "capped_robot" else ""
    text = ROBOT.format(kind=kind, tension=60).replace("[cables]", pose + "height = 0.01\n[cables]") + GROUND
    theirs, ours, deepest = by_both(parse_scene(text), 2.0, 5e-4)
    assert 0 < deepest < 5e-3
    assert ours[:, 2].mean() == pytest.approx(theirs[:, 2].mean(), abs=deepest + 1e-4)


READ = {
    "apart": apart,
    "joined": joined,
    "hinged_spine": lambda: parse_scene(ROBOT.format(kind="hinged_spine", tension=60)),
    "quadruped": lambda: parse_scene(ROBOT.format(kind="quadruped", tension=60) + GROUND),
    "superball": lambda: parse_scene(ROBOT.format(kind="superball", tension=60) + GROUND),
}


@pytest.mark.slow
@pytest.mark.parametrize("make", READ.values(), ids=READ)
def test_what_is_written_is_read(make, tmp_path):
    """The same nodes, bodies, joints, supports, cables and balls, which MuJoCo moves alike.

    A free rod is read as a strut, whose masses are fitted to those of a rod with a thickness.
    """
    within = 1e-5 if make is apart else 1e-9
    scene = make()
    save_mjcf(scene, tmp_path / "robot.xml")
    again = read_mjcf(tmp_path / "robot.xml").scene
    ours, theirs, count = scene.structure, again.structure, len(scene.structure.nodes)
    np.testing.assert_allclose(theirs.nodes[:count], ours.nodes, atol=1e-12)
    assert theirs.fixed == ours.fixed
    assert theirs.cables.edges == ours.cables.edges
    for name in ("rest_length", "stiffness"):
        np.testing.assert_allclose(getattr(theirs.cables, name), getattr(ours.cables, name), rtol=1e-12)
    assert float(theirs.mass) == pytest.approx(float(ours.mass), rel=within)
    solid = [body for body in ours.bodies if len(body.basic) > 2 or scene.structure.fixed]
    assert len(theirs.bodies) == len(solid)
    for body, same in zip(solid, theirs.bodies):
        assert set(body.points) <= set(same.points)
        if not np.any(ours.node_mass[list(body.points)]):
            for own, read in zip(body_moments(body, ours.nodes), body_moments(same, theirs.nodes)):
                # that of a rod about its own line is made up
                np.testing.assert_allclose(read, own, atol=(1e-3 if len(body.basic) == 2 else 1e-9) * np.abs(own).max())
    if scene.ground is not None:
        assert again.ground.balls.nodes == scene.ground.balls.nodes
        np.testing.assert_allclose(again.ground.balls.radius, scene.ground.balls.radius, rtol=1e-9)
    (first, _), (second, _) = (run_once(each, 0.2, 2e-4) for each in (scene, again))
    np.testing.assert_allclose(second[:count], first, atol=within)


def test_what_mujoco_cannot_hold_is_refused():
    """A support along some axes, of a body; its node is named. One of a single node becomes slides."""
    scene = joined()
    guided = dataclasses.replace(scene.structure, fixed=((3, "xz"), (7, "xyz")))
    with pytest.raises(InputError, match="node 3 belongs to a rigid body, and a support holds it along xz alone"):
        mujoco_model(Scene(guided))
    alone = dataclasses.replace(apart().structure, fixed=((10, "xz"),))
    assert mujoco.MjModel.from_xml_string(mujoco_model(Scene(alone)).xml).nv == 3 * 6 + 1
