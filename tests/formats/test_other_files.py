"""MATLAB, CSV, meshes, motions and the command that converts: what is written is read, by others too."""

import dataclasses
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import numpy as np
import pytest
from scipy.io import loadmat, savemat

from jaxgrity import InputError, load_scene, parse_scene, scene_text, simulate
from jaxgrity.cli.convert import ConvertSettings, ends_words, main
from jaxgrity.formats import (
    FORMATS,
    load_trajectory,
    read_any,
    read_matlab,
    read_tables,
    save_matlab,
    save_mesh,
    save_tables,
    save_trajectory,
    write_any,
)
from jaxgrity.io.files import save_arrays
from jaxgrity.io.scene_writing import scene_toml
from jaxgrity.model import LoadCase

PRISM = """
[structure]
kind = "prism"
node_mass = [1, 2, 3, 4, 5, 0]
fixed = [1, { node = 2, axes = "xz" }]
[struts]
mass = [0.1, 0.2, 0.3]
stiffness = 2e4
damping = 3
[cables]
stiffness = [1e3, 2e3, 3e3, 1e3, 2e3, 3e3, 1e3, 2e3, 3e3]
prestrain = 0.1
"""
RIGID = PRISM.replace("stiffness = 2e4\ndamping = 3", "rigid = true")


def assert_alike(first, second, rtol: float) -> None:
    """Two structures, to rounding."""
    np.testing.assert_allclose(first.nodes, second.nodes, rtol=rtol)
    np.testing.assert_allclose(first.node_mass, second.node_mass, rtol=rtol)
    assert first.fixed == second.fixed
    for kind in ("struts", "cables"):
        ours, theirs = getattr(first, kind), getattr(second, kind)
        assert ours.edges == theirs.edges
        for name in ("stiffness", "rest_length", "damping", "mass"):
            values = getattr(ours, name), getattr(theirs, name)
            assert (values[0] is None) == (values[1] is None), name
            if values[0] is not None:
                np.testing.assert_allclose(*values, rtol=rtol)


@pytest.mark.parametrize("text", [PRISM, RIGID], ids=["springs", "rigid"])
def test_matlab_there_and_back(text, tmp_path):
    """All of a structure; K = EA/l0 to rounding."""
    scene = parse_scene(text)
    save_matlab(scene, tmp_path / "robot.mat")
    assert_alike(read_matlab(tmp_path / "robot.mat").scene.structure, scene.structure, 1e-15)


def test_matlab_files_have_the_names_of_the_toolboxes(tmp_path):
    """N by columns, C_b and C_s by rows with -1 and 1, EA = K l0 of bars, then strings; supports from 1."""
    structure = parse_scene(PRISM).structure
    notes = save_matlab(load_scene("reference"), tmp_path / "other.mat")
    assert "gravity, damping of nodes, ground, friction, gait" in notes[0]
    save_matlab(parse_scene(PRISM), tmp_path / "robot.mat")
    found = loadmat(tmp_path / "robot.mat")
    np.testing.assert_array_equal(found["N"], structure.nodes.T)
    directions = found["N"] @ found["C_s"].T
    i, j = np.array(structure.cables.edges).T
    np.testing.assert_allclose(directions, (structure.nodes[j] - structure.nodes[i]).T)
    assert found["C_b"].shape == (3, 6)
    np.testing.assert_allclose(found["EA"][:3, 0], 2e4 * structure.struts.rest_length)
    np.testing.assert_allclose(found["EA"][3:, 0], structure.cables.stiffness * structure.cables.rest_length)
    np.testing.assert_allclose(found["s_0"][0], structure.cables.rest_length)
    np.testing.assert_array_equal(found["mass"][:3, 0], [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(found["pinned_X"][:, 0], [2, 3])
    np.testing.assert_array_equal(found["pinned_Y"][:, 0], [2])


def test_matlab_files_of_motes_and_of_tsgfem(tmp_path):
    """A structure with N, C_b, C_s, s_0 and k, bars rigid with masses m; or E and A, and pairs of numbers from 1."""
    N = np.array([[0.0, 1, 0.5], [0, 0, 1], [0, 0, 0]])
    motes = {"N": N, "C_b": [[-1, 1, 0]], "C_s": [[0, -1, 1], [1, 0, -1]], "s_0": [0.9, 1.0], "k": 50.0, "m": 2.0}
    savemat(tmp_path / "motes.mat", {"prism": motes | {"ms": 0.5, "c": 3.0}})
    scene, notes = read_matlab(tmp_path / "motes.mat")
    assert scene.structure.struts.edges == ((0, 1),)
    assert scene.structure.cables.edges == ((1, 2), (2, 0))
    assert scene.structure.struts.rigid
    assert scene.structure.struts.mass.tolist() == [2.0]
    assert scene.structure.cables.stiffness.tolist() == [50.0, 50.0]
    assert scene.structure.cables.damping.tolist() == [3.0, 3.0]
    assert scene.structure.node_mass.tolist() == [0.5, 0.5, 0.5]
    assert "bars are rigid, as no stiffness of theirs is given" in notes
    assert "the file holds no gravity, ground or gait: the scene has none until you add them" in notes
    tsgfem = {
        "N": N,
        "C_b": [[1, 2]],
        "C_s": [[2, 3], [3, 1]],
        "l0": [1.0, 1.0, 1.1],
        "E": 2e9,
        "A": [1e-4, 1e-6, 2e-6],
    }
    savemat(tmp_path / "tsgfem.mat", tsgfem | {"mass": [1.0, 0.1, 0.1]})
    structure = read_matlab(tmp_path / "tsgfem.mat").scene.structure
    assert structure.cables.edges == ((1, 2), (2, 0))
    np.testing.assert_allclose(structure.struts.stiffness, 2e5)
    np.testing.assert_allclose(structure.cables.stiffness, [2e3, 4e3 / 1.1])


@pytest.mark.parametrize(
    ("content", "reason"),
    {
        "no N": ({"C_b": [[-1, 1]]}, "N: missing; expected a matrix"),
        "two rows": ({"N": np.zeros((2, 3))}, "N has shape (2, 3); expected 3 by any"),
        "words": ({"N": "abc"}, "N: expected real numbers"),
        "NaN": ({"N": [[np.nan], [0], [0]]}, "N: expected finite numbers"),
        "ends": ({"N": np.eye(3), "C_b": [[1, 1, 0]]}, "C_b has shape (1, 3); expected a row a member"),
        "beyond": ({"N": np.eye(3), "C_b": [[1, 9]]}, "C_b: expected numbers of nodes from 1 to 3"),
        "no EA": ({"N": np.eye(3), "C_s": [[1, 2]]}, "EA: missing; expected EA, E and A, or k of strings"),
        "many": ({"N": np.eye(3), "C_s": [[1, 2]], "l0": [1, 2]}, "l0 has 2 numbers; expected 1, or one for all"),
        "negative": ({"N": np.eye(3), "C_s": [[1, 2]], "k": -1}, "EA: expected positive stiffness"),
        "pinned": ({"N": np.eye(3), "pinned_X": [4]}, "pinned_X has 4; expected numbers of nodes from 1 to 3"),
    }.values(),
)
def test_matlab_refusals(content, reason, tmp_path):
    """In one line, with the file and the variable."""
    savemat(tmp_path / "robot.mat", content)
    with pytest.raises(InputError) as caught:
        read_matlab(tmp_path / "robot.mat")
    assert str(caught.value).startswith(f"{tmp_path}/robot.mat: {reason}")


@pytest.mark.parametrize("text", [PRISM, RIGID], ids=["springs", "rigid"])
def test_tables_there_and_back(text, tmp_path):
    """To the last bit, from either file's name or their common one; pandas reads them, too."""
    scene = parse_scene(text)
    assert save_tables(scene, tmp_path / "robot.csv") == ()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["robot.members.csv", "robot.nodes.csv"]
    for name in ("robot.csv", "robot.nodes.csv", "robot.members.csv"):
        found = read_tables(tmp_path / name)
        assert_alike(found.scene.structure, scene.structure, 0)
        assert "the file holds no gravity, ground or gait: the scene has none until you add them" in found.notes
    pandas = pytest.importorskip("pandas")
    members = pandas.read_csv(tmp_path / "robot.members.csv")
    assert members.groupby("kind").size().to_dict() == {"cable": 9, "strut": 3}
    # some versions of pandas read numbers but for their last bit
    np.testing.assert_allclose(members["rest_length_m"][3:], scene.structure.cables.rest_length, rtol=1e-15)


@pytest.mark.parametrize(
    ("nodes", "members", "reason"),
    [
        ("x_m,y_m\n0,0\n", "", "robot.nodes.csv: has no column z_m"),
        ("x_m,y_m,z_m,colour\n", "", "robot.nodes.csv: has a column 'colour'"),
        ("x_m,y_m,z_m\n0,0\n", "", "robot.nodes.csv: line 2 has 2 cells; expected 3"),
        ("x_m,y_m,z_m\n0,0,inf\n", "", "robot.nodes.csv: line 2.z_m = 'inf': expected a finite number"),
        ("x_m,y_m,z_m,mass_kg\n0,0,0,1\n", "rope,0,1,1,1\n", "line 2.kind = 'rope': expected strut or cable"),
        (
            "x_m,y_m,z_m,mass_kg\n0,0,0,1\n1,0,0,1\n0,1,0,1\n",
            "cable,0,1,1,1\nstrut,0,2,1,1\ncable,1,7,1,1\n",
            "robot.members.csv: line 4 = [1, 7]: there is no node 7; expected 0 to 2",
        ),
        (
            "x_m,y_m,z_m,mass_kg\n0,0,0,1\n1,0,0,0\n",
            "cable,0,1,1,1\n",
            "robot.nodes.csv: line 3 = 0: no member there has mass either; expected some mass",
        ),
        (
            "x_m,y_m,z_m,mass_kg,fixed\n0,0,0,1,\n1,0,0,1,xq\n",
            "cable,0,1,1,1\n",
            "robot.nodes.csv: line 3.fixed = 'xq': expected some of x, y and z, or nothing",
        ),
        ("x_m,y_m,z_m,mass_kg\n0,0,0,1\n", "cable,0,-1,1,1\n", "line 2 joins '-1'; expected the number of a node"),
        ("x_m,y_m,z_m,mass_kg\n0,0,0,1\n1,0,0,1\n", "cable,0,1,1,\n", "stiffness_N_per_m: missing"),
        ("x_m,y_m,z_m,mass_kg\n0,0,0,1\n1,0,0,1\n", "cable,0,1,0,1\n", "rest_length_m = '0': expected a positive"),
        ('x_m,y_m,z_m\n"0,0', "", "robot.nodes.csv: not CSV: unexpected end of data"),
    ],
)
def test_tables_refusals(nodes, members, reason, tmp_path):
    """With the file, the line and the column."""
    (tmp_path / "robot.nodes.csv").write_text(nodes)
    (tmp_path / "robot.members.csv").write_text("kind,first,second,rest_length_m,stiffness_N_per_m\n" + members)
    with pytest.raises(InputError) as caught:
        read_tables(tmp_path / "robot.csv")
    assert reason in str(caught.value)
    assert str(caught.value).isprintable()


def renamed(tmp_path):
    """A robot's tables with other names of columns, and one more column."""
    scene = parse_scene(PRISM)
    save_tables(scene, tmp_path / "robot.csv")
    nodes = tmp_path / "robot.nodes.csv"
    head, *rows = nodes.read_text().splitlines()
    assert head == "x_m,y_m,z_m,mass_kg,fixed"
    nodes.write_text("\n".join(["X,Y,z_m,weight [kg],fixed,colour", *(f"{row},red" for row in rows)]))
    return scene


COLUMNS = {"X": "x_m", "Y": "y_m", "weight [kg]": "mass_kg", "colour": ""}


def test_tables_with_names_of_the_user(tmp_path):
    """Columns that are named are those of the library, and one without a name is left out."""
    scene = renamed(tmp_path)
    found = read_tables(tmp_path / "robot.csv", COLUMNS)
    assert_alike(found.scene.structure, scene.structure, 0)
    columns = tuple(f"{name}={meant}" for name, meant in COLUMNS.items())
    main(ConvertSettings(str(tmp_path / "robot.csv"), tmp_path / "robot.toml", columns=columns))
    assert_alike(load_scene(tmp_path / "robot.toml").structure, scene.structure, 0)


@pytest.mark.parametrize(
    ("columns", "reason"),
    [
        ({}, "robot.nodes.csv: has a column 'X'; expected x_m, y_m, z_m, mass_kg, fixed, each once, or other names"),
        (COLUMNS | {"Z": "z_m"}, "columns: neither robot.nodes.csv nor robot.members.csv has a column 'Z'"),
        (COLUMNS | {"X": "x_mm"}, r"columns\['X'\] = 'x_mm': expected '', or one of x_m, y_m"),
        (COLUMNS | {"X": "y_m"}, "robot.nodes.csv: has a column 'y_m'; expected x_m"),
        (COLUMNS | {"X": ""}, "robot.nodes.csv: has no column x_m"),
    ],
)
def test_names_of_columns_that_are_refused(columns, reason, tmp_path):
    """In one line, with the name."""
    renamed(tmp_path)
    with pytest.raises(InputError, match=reason):
        read_tables(tmp_path / "robot.csv", columns)


def test_meshes_have_the_shape(reference, tmp_path):
    """A GLB with struts and cables apart, y up; an OBJ, z up: as wide as the robot and its bars."""
    trimesh = pytest.importorskip("trimesh")
    for ending, up in (("glb", 1), ("obj", 2)):
        save_mesh(reference, tmp_path / f"robot.{ending}")
        found = trimesh.load(tmp_path / f"robot.{ending}", force="scene")
        nodes = reference.structure.nodes
        assert found.bounds[1, up] == pytest.approx(nodes[:, 2].max(), abs=0.02)
        np.testing.assert_allclose(np.sort(found.extents), np.sort(np.ptp(nodes, axis=0)), atol=0.03)
    assert set(trimesh.load(tmp_path / "robot.glb").geometry) == {"struts", "cables"}
    with pytest.raises(InputError, match=r"robot\.stl: unknown ending of a mesh; expected \.glb or \.obj"):
        save_mesh(reference, tmp_path / "robot.stl")


def test_motions_with_units(reference, tmp_path):
    """netCDF that xarray opens, with dimensions, coordinates and units; npz and CSV hold the same numbers."""
    motion = simulate(reference, 0.02)
    for ending in ("nc", "npz", "csv"):
        save_trajectory(motion, tmp_path / f"motion.{ending}")
    again = load_trajectory(tmp_path / "motion.npz")
    jax.tree.map(np.testing.assert_array_equal, replace(again, scene=None), replace(motion, scene=None))
    assert scene_toml(again.scene) == scene_toml(reference)
    table = np.loadtxt(tmp_path / "motion.csv", delimiter=",", skiprows=1)
    np.testing.assert_array_equal(table[:, 2:5].reshape(3, 12, 3), motion.positions)
    np.testing.assert_array_equal(table[:, 5:].reshape(3, 12, 3), motion.velocities)
    xarray = pytest.importorskip("xarray")
    with xarray.open_dataset(tmp_path / "motion.nc", decode_times=False) as data:
        assert data.position.dims == ("time", "node", "axis")
        assert (data.position.units, data.velocity.units, data.time.units) == ("m", "m s-1", "s")
        np.testing.assert_array_equal(data.position, motion.positions)
        np.testing.assert_array_equal(data.velocity.sel(node=2), motion.velocities[:, 2])
        np.testing.assert_array_equal(data.position.sel(axis=b"z")[:, 0], motion.positions[:, 0, 2])
    with pytest.raises(InputError, match=r"motion.mp3: unknown ending; expected one of .npz, .csv, .nc"):
        save_trajectory(motion, tmp_path / "motion.mp3")
    with pytest.raises(InputError, match=r"motion.csv: no motion that save_trajectory wrote as .npz"):
        load_trajectory(tmp_path / "motion.csv")


def test_an_array_alone_is_no_motion(tmp_path):
    """NumPy reads such a file, too."""
    np.save(tmp_path / "array.npy", np.zeros((3, 3)))
    with pytest.raises(InputError, match=r"array.npy: no motion that save_trajectory wrote as .npz"):
        load_trajectory(tmp_path / "array.npy")


def test_a_motion_whose_numbers_are_overwritten_is_refused(tmp_path):
    """Not only a file that ends too soon: what was compressed cannot be read any more."""
    path = tmp_path / "motion.npz"
    save_arrays(path, times=np.random.default_rng(0).random(100))
    whole = path.read_bytes()
    first = whole.index(b"times.npy") + len("times.npy") + 20  # beyond the header of a large file
    path.write_bytes(whole[:first] + b"\xff" * 8 + whole[first + 8 :])
    with pytest.raises(InputError, match=r"motion.npz: no motion that .* \(Error -3 while decompressing"):
        load_trajectory(path)


@pytest.mark.parametrize("ending", [".toml", ".yaml", ".csv", ".mat", ".xml"])
def test_a_missing_file_is_named_once(ending, tmp_path):
    if ending == ".xml":
        pytest.importorskip("mujoco")
    with pytest.raises(InputError) as refused:
        read_any(tmp_path / f"missing{ending}")
    assert str(refused.value).count(str(tmp_path)) == 1


def test_every_kind_of_file_by_its_ending(tmp_path):
    """What can be both written and read comes back; the rest is refused with the endings that can."""
    scene = parse_scene(PRISM.replace("mass = [0.1, 0.2, 0.3]\n", "").replace("5, 0]", "5, 6]"))
    # NTRT's hold rods without supports alone: see test_ntrt_writing.py
    both = [each.endings[0] for each in FORMATS if each.read and each.write and ".yaml" not in each.endings]
    assert set(both) >= {".toml", ".mat", ".csv", ".xml"}
    for ending in both:
        write_any(scene, tmp_path / f"robot{ending}")
        found = read_any(tmp_path / f"robot{ending}").scene.structure
        # what a support carries is not moved, and has no mass in a MuJoCo model
        weighed = dataclasses.replace(found, node_mass=np.where(scene.structure.free.any(1), found.node_mass, 2.0))
        assert_alike(weighed, scene.structure, 1e-9)
    with pytest.raises(InputError, match=r"robot.glb: a mesh is not read; expected .toml, .yaml"):
        read_any(tmp_path / "robot.glb")
    with pytest.raises(InputError, match=r"robot.txt: unknown ending; expected .toml"):
        read_any(tmp_path / "robot.txt")


def test_the_command_says_what_was_read_and_what_is_lost(tmp_path, capsys):
    """From NTRT, in another unit, to a scene file, and on to a file that holds the structure alone."""
    source = Path(__file__).parents[1] / "data" / "ntrt" / "prism.yaml"
    main(ConvertSettings(str(source), tmp_path / "robot.toml", unit=1.0))
    assert "30 nodes, 3 rigid bodies, 0 struts, 9 cables, 1.807 kg" in capsys.readouterr().out
    main(ConvertSettings(str(source), tmp_path / "robot.toml", unit=1.0, drop=("radius",)))
    said = capsys.readouterr().out
    assert "6 nodes, 3 struts, 9 cables, 1.807 kg" in said
    assert "one unit of length is 1 m" in said
    assert "the ends of rods and boxes touch the ground as points" in said
    chosen = 'the file names no actuators. For a search, add a [gait] and choose them: [gait] members = "cables"\n'
    assert said.endswith(f"robot.toml\n  nothing is lost\n  {chosen}")
    main(ConvertSettings(str(tmp_path / "robot.toml"), tmp_path / "robot.mat"))
    said = capsys.readouterr().out
    assert "such a file holds the structure alone: gravity, ground, friction" in said
    assert "[gait] members" not in said  # such a file holds none
    with pytest.raises(InputError, match=r"x.doc: unknown ending"):
        main(ConvertSettings("reference", Path("x.doc")))
    with pytest.raises(
        InputError, match=r"--unit 0.001: robot.mat is read in metres; expected --unit with NTRT \(.yaml\)"
    ):
        main(ConvertSettings("robot.mat", tmp_path / "robot.toml", unit=1e-3))
    with pytest.raises(InputError, match=r"--columns X=x_m: expected --columns with tables \(.csv\) alone"):
        main(ConvertSettings("robot.mat", tmp_path / "robot.toml", columns=("X=x_m",)))
    with pytest.raises(InputError, match=r"--keyframe up: expected --keyframe with MuJoCo models \(.xml\) alone"):
        main(ConvertSettings(str(source), tmp_path / "robot.toml", keyframe="up"))
    with pytest.raises(InputError, match=r"--drop radius: exact is read whole; expected --drop with NTRT and JSON"):
        main(ConvertSettings("exact", tmp_path / "robot.toml", drop=("radius",)))


def test_the_command_puts_mass_at_the_ends(tmp_path, capsys):
    """Of rods, with the moments of inertia before and after; there must be some."""
    text = scene_text("exact").replace("mass = 6.0\n", "").replace("[struts]", "[struts]\nmass = 1.5")
    (tmp_path / "rods.toml").write_text(text)
    rods = load_scene(tmp_path / "rods.toml")
    assert rods.structure.mass == pytest.approx(9.0)
    main(ConvertSettings(str(tmp_path / "rods.toml"), tmp_path / "light.toml", mass_at_ends=True))
    said = capsys.readouterr().out
    assert "[gait] members" not in said  # the scene has a gait
    assert "6 struts have their mass at their ends now. The heaviest has 1.5 kg with its ends, and a moment of" in said
    assert "a moment of inertia of 0.375 kg m^2 about its centre of mass in place of 0.125\n" in said
    light = load_scene(tmp_path / "light.toml").structure
    np.testing.assert_allclose(light.node_mass, 0.75)
    assert light.struts.mass is None
    heavier = rods.structure.node_mass + np.array([1.0, 3.0] * 6)  # the centre is at 3.75/5.5 of a rod of 1 m
    told = ends_words(eqx.tree_at(lambda s: s.structure.node_mass, rods, heavier), "rods.toml")
    before, at = 1.5 / 12, 3.75 / 5.5
    before += 1.5 * (at - 0.5) ** 2 + 1.0 * at**2 + 3.0 * (1 - at) ** 2
    assert f"5.5 kg with its ends, and a moment of inertia of {1.75 * 3.75 / 5.5:.3g} kg m^2" in told
    assert told.endswith(f"in place of {before:.3g}")
    with pytest.raises(InputError, match=r"--mass-at-ends: no member of .*light.toml has a mass of its own; expected"):
        main(ConvertSettings(str(tmp_path / "light.toml"), tmp_path / "again.toml", mass_at_ends=True))


def test_the_command_settles(tmp_path, capsys):
    """A robot that is at rest does not move."""
    main(ConvertSettings("reference", tmp_path / "robot.toml", settle=True))
    assert "settled: nodes moved by up to" in capsys.readouterr().out
    before, after = load_scene("reference").structure, load_scene(tmp_path / "robot.toml").structure
    shrunk = np.ptp(after.nodes, axis=0) / np.ptp(before.nodes, axis=0)
    np.testing.assert_allclose(shrunk, shrunk.mean(), rtol=1e-9)  # struts give way, all alike
    assert 0.98 < shrunk.mean() < 0.99
    assert after.cables.edges == before.cables.edges


@pytest.mark.parametrize("name", ["robot.csv", "robot.mat", "robot.urdf", "robot.xml"])
def test_load_cases_are_named_among_what_is_lost(name, tmp_path):
    """Since files of other programs hold none."""
    scene = replace(load_scene("reference"), loads=(LoadCase("down", (0,), [[0.0, 0.0, -1.0]]),))
    assert any("load cases" in note for note in write_any(scene, tmp_path / name))
    assert not any("load cases" in note for note in write_any(replace(scene, loads=()), tmp_path / name))


LIMITED = """
[structure]
kind = "prism"
mass = 1.0
[struts]
material = "steel"
diameter = 0.01
[cables]
stiffness = 1e3
prestrain = 0.1
stuck = [2]
largest_force = 90.0
"""


@pytest.mark.parametrize("name", ["robot.csv", "robot.mat", "robot.urdf", "robot.yaml", "robot.xml"])
def test_laws_and_strength_are_named_among_what_is_lost(name, tmp_path):
    """By their names, since files of other programs hold stiffness and mass alone."""
    scene = parse_scene(LIMITED)
    said = " ".join(write_any(scene, tmp_path / name))
    lost = ["largest force of cables", "strength of members", "that members are stuck"]
    if name == "robot.xml":  # which holds largest forces, and has no gait, and so no members that are stuck
        lost = lost[1:2]
        assert "largest force" not in said
    assert all(part in said for part in lost)
    cables = replace(scene.structure.cables, stuck=())
    plain = replace(scene.structure, cables=cables, struts=replace(scene.structure.struts, **dict.fromkeys(STRENGTH)))
    said = " ".join(write_any(replace(scene, structure=plain, terms=()), tmp_path / name))
    assert not any(part in said for part in lost)


STRENGTH = ("yield_force", "bending_stiffness")
