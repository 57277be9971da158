"""URDF: MuJoCo reads it, and moves it as we do under the forces of the table beside it."""

import csv
import dataclasses
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from jaxgrity import InputError, Members, Motor, Scene, SolverOptions, Structure, load_scene, parse_scene, simulate
from jaxgrity.formats import save_urdf, write_any
from jaxgrity.model import body_moments, rigid_body

mujoco = pytest.importorskip("mujoco")

RODS = """
[structure]
kind = "prism"
mass = 0.6
[struts]
rigid = true
mass = 0.5
[cables]
stiffness = 400.0
damping = 3.0
prestrain = 0.2
[gravity]
"""
SPRUNG = RODS.replace("rigid = true\nmass = 0.5", "stiffness = 3e3\ndamping = 5.0")
FLOATS = ("x_m", "y_m", "z_m")


def springs_of(path: Path) -> list[dict[str, str]]:
    """The rows of the table beside a URDF."""
    return list(csv.DictReader(path.with_suffix(".springs.csv").read_text().splitlines()))


def vertebra_scene() -> Scene:
    """Two solid bodies of five points, a rod and a ball, held together by cables."""
    corners = np.array([[0.0, 0, 0], [0.4, 0, 0], [0, 0.3, 0], [0, 0, 0.5], [0.1, 0.1, 0.1]])
    nodes = np.concatenate([corners, corners @ np.diag([1, -1, 1]) + [0.1, 0, 0.6], [[0, 0, 2.0], [0, 0.4, 2.1]]])
    nodes = np.concatenate([nodes, [[0.5, 0.5, 1.0]]])
    inertia = np.array([[0.03, 0.002, -0.001], [0.002, 0.04, 0.003], [-0.001, 0.003, 0.05]])
    bodies = (
        rigid_body(nodes, range(5), 1.2, inertia, [0.1, 0.05, 0.2]),
        rigid_body(nodes, range(5, 10), 0.7, [0.03, 0.02, 0.015]),
        rigid_body(nodes, (10, 11), 0.4, 0.4 * 0.17 / 12 * (np.eye(3) - np.outer([0, 4, 1], [0, 4, 1]) / 17)),
    )
    edges = ((0, 5), (1, 6), (2, 7), (3, 5), (4, 12), (8, 10), (9, 11), (7, 12), (6, 10))
    length = np.linalg.norm(nodes[[i for i, _ in edges]] - nodes[[j for _, j in edges]], axis=1)
    cables = Members(edges, np.full(9, 40.0), 0.6 * length, damping=np.full(9, 0.5))
    mass = np.zeros(13)
    mass[12] = 0.3
    return Scene(Structure(nodes, mass, cables=cables, bodies=bodies), gravity=9.81)


def driven_by(rows: list[dict[str, str]]):
    """MuJoCo's passive forces, from the table alone: K (l - L) + c l' along each row, cables only while l > L."""

    def law(model, data):
        data.qfrc_passive[:] = 0
        for row in rows:
            ends = []
            for side in ("first", "second"):
                body = model.body(row[f"{side}_link"]).id
                turn = data.xmat[body].reshape(3, 3)
                at = data.xpos[body] + turn @ [float(row[f"{side}_{name}"]) for name in FLOATS]
                jacobian = np.zeros((3, model.nv))
                mujoco.mj_jac(model, data, jacobian, None, at, body)
                ends.append((at, jacobian))
            d, jacobian = ends[0][0] - ends[1][0], ends[0][1] - ends[1][1]
            stretch = np.linalg.norm(d) - float(row["rest_length_m"])
            u = d / np.linalg.norm(d)
            if row["kind"] == "strut" or stretch > 0:
                damping = float(row["damping_N_s_per_m"] or 0)
                pull = float(row["stiffness_N_per_m"]) * stretch + damping * (u @ jacobian @ data.qvel)
                data.qfrc_passive += -pull * u @ jacobian

    return law


@pytest.mark.slow
@pytest.mark.parametrize("make", ["rods", pytest.param("springs", marks=pytest.mark.campaign), "bodies"])
def test_mujoco_moves_the_robot_as_we_do(make, tmp_path):
    """Free flight of 0.05 s: centres of mass of all links, of the URDF in MuJoCo under the forces of the table."""
    scene = vertebra_scene() if make == "bodies" else parse_scene(RODS if make == "rods" else SPRUNG)
    path = tmp_path / "robot.urdf"
    save_urdf(scene, path)
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.timestep, model.opt.integrator = 5e-4, mujoco.mjtIntegrator.mjINT_RK4
    data = mujoco.MjData(model)
    assert model.nq == 7 * (model.nbody - 1)
    assert model.body_mass.sum() == pytest.approx(float(scene.structure.mass), rel=1e-12)
    mujoco.set_mjcb_passive(driven_by(springs_of(path)))
    try:
        for _ in range(100):
            mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
    finally:
        mujoco.set_mjcb_passive(None)
    ours = np.asarray(simulate(scene, 0.05, options=SolverOptions(method="rk4", dt=2e-4)).positions[-1])
    start, moved = np.asarray(scene.structure.nodes), 0.0
    for name, centre in centres(scene, model, ours).items():
        np.testing.assert_allclose(data.body(name).xpos, centre, atol=2e-7)
        moved = max(moved, np.linalg.norm(centre - centres(scene, model, start)[name]))
    assert moved > 0.01  # by gravity and cables


def centres(scene: Scene, model, q: np.ndarray) -> dict[str, np.ndarray]:
    """Centres of mass of the links, m: of bodies in their order, then of rods; a node's number is in its name."""
    struts = scene.structure.struts
    bodies = [body_moments(body, q)[1] for body in scene.structure.bodies]
    bodies += [q[list(edge)].mean(0) for edge in (struts.edges if struts is not None and struts.rigid else ())]
    names = [model.body(k).name for k in range(1, model.nbody)]
    return {name: bodies[int(name[4:])] if name.startswith("body") else q[int(name[4:])] for name in names}


def test_what_a_file_holds(tmp_path):
    """Inertia and frames in the file, spheres where nodes touch, and sentences on all that is left out."""
    scene = load_scene("exact")
    notes = write_any(scene, tmp_path / "robot.urdf")
    assert notes[0].startswith("cables and spring struts are in robot.springs.csv")
    assert "rigid struts that the gait moves keep their lengths there" in notes
    assert (
        "not written, since such a file holds the structure alone: gravity, damping of nodes, ground, friction, gait"
        in notes
    )
    root = ElementTree.parse(tmp_path / "robot.urdf").getroot()
    assert [link.get("name") for link in root.iter("link")] == ["world", *(f"body{k}" for k in range(6))]
    x, struts = np.asarray(scene.structure.nodes), scene.structure.struts.edges
    for link, joint, (i, j) in zip(root.findall("link")[1:], root.findall("joint"), struts):
        assert joint.get("type") == "floating"
        np.testing.assert_allclose(list(map(float, joint.find("origin").get("xyz").split())), (x[i] + x[j]) / 2)
        radii = [float(sphere.get("radius")) for sphere in link.iter("sphere")]
        assert radii == [1e-3, 1e-3]
        assert float(link.find("visual/geometry/cylinder").get("length")) == pytest.approx(1.0)
        roll, pitch, yaw = map(float, link.find("visual/origin").get("rpy").split())
        axis = [np.sin(pitch) * np.cos(yaw), np.sin(pitch) * np.sin(yaw), np.cos(pitch)]
        np.testing.assert_allclose(axis, x[j] - x[i], atol=1e-12)
        assert roll == 0
    rows = springs_of(tmp_path / "robot.urdf")
    assert [row["kind"] for row in rows] == ["cable"] * 24
    for row, (i, j) in zip(rows, scene.structure.cables.edges):
        assert {row["first_link"], row["second_link"]} <= {f"body{k}" for k in range(6)}
        ends = [np.array([float(row[f"{side}_{name}"]) for name in FLOATS]) for side in ("first", "second")]
        centres = [
            np.mean([x[n] for n in struts[int(row[f"{side}_link"][4:])]], axis=0) for side in ("first", "second")
        ]
        np.testing.assert_allclose(ends + np.array(centres), x[[i, j]], atol=1e-15)


def test_what_urdf_has_no_joint_for(tmp_path):
    """Two bodies at one node, a support that leaves an axis free, motors: refused with the node."""
    scene = vertebra_scene()
    x = scene.structure.nodes
    pair = (rigid_body(x, (*points, 0), 1.0, [1.0, 1, 1], basic=(0,)) for points in (range(1, 5), range(6, 10)))
    joined = dataclasses.replace(scene.structure, bodies=tuple(pair), node_mass=np.full(13, 0.1))
    guided = dataclasses.replace(scene.structure, fixed=((12, "xz"),))
    motor = Motor(member=0, times=[0.1, 0.2], lengths=[0.4, 0.3], rate=0.1)
    wound = dataclasses.replace(scene.structure, cables=dataclasses.replace(scene.structure.cables, motors=(motor,)))
    for structure, reason in (
        (joined, "node 0 belongs to body1 and to body0; URDF has no joint for this"),
        (guided, "node 12 belongs to node12 and to a support along xz; URDF has no joint"),
        (wound, r"members \[0\] have motors, which URDF lacks"),
    ):
        with pytest.raises(InputError, match=reason):
            save_urdf(Scene(structure), tmp_path / "robot.urdf")
    assert not list(tmp_path.iterdir())


def test_supports_are_points_of_the_world(tmp_path):
    """A node held in all directions is no link: its cables end in the frame of the world."""
    scene = vertebra_scene()
    held = dataclasses.replace(scene.structure, fixed=((12, "xyz"),))
    save_urdf(Scene(held), tmp_path / "robot.urdf")
    row = springs_of(tmp_path / "robot.urdf")[4]
    assert row["second_link"] == "world"
    assert [float(row[f"second_{name}"]) for name in FLOATS] == [0.5, 0.5, 1.0]
