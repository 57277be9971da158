"""JSON files of differentiable engines: masses by hand, motion by the engines' equations, every refusal one line."""

import copy
import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxgrity import InputError, SolverOptions, load_scene, simulate
from jaxgrity.cli.convert import main
from jaxgrity.cli.settings import ConvertSettings
from jaxgrity.formats import read_any, read_engine, write_any
from jaxgrity.model import body_moments

PRISM = json.loads((Path(__file__).parents[1] / "data" / "engine" / "prism.json").read_text())
"""A robot of three rods in a file of the engine by formulas."""
NETWORK = {"rolling_friction": 1.0}
"""Contact of the engine with a network: rods do not spin."""
SIDE = [0.0, 0.0, 0.09]
"""m, from the ends of rods to sites beside their axes"""


def robot_of(content: dict) -> dict:
    return content["tensegrity_robot_config"]


def changed(*changes) -> dict:
    """The prism with other values: (place, value), where a place is names and numbers joined by dots."""
    content = copy.deepcopy(PRISM)
    for place, value in changes:
        at = content if place.split(".")[0] in content else robot_of(content)
        *path, last = (int(part) if part.isdecimal() else part for part in place.split("."))
        for part in path:
            at = at[part]
        if value is None:
            del at[last]
        else:
            at[last] = value
    return content


def written(folder, content) -> Path:
    path = folder / "robot.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def read(folder, *changes, **how):
    return read_engine(written(folder, changed(*changes)), **how)


def refusal(folder, content, **how) -> str:
    """What a user reads of a file that is refused: one line that starts with the file."""
    path = written(folder, content)
    with pytest.raises(InputError) as caught:
        read_engine(path, **how)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert message.isprintable(), message
    return message.removeprefix(f"{path}: ")


def rod_by_hand(rod: dict) -> tuple[float, float, float]:
    """Mass, kg, and inertia along and across, kg m^2: two balls and two motors on a cylinder.

    The engines compute a motor's inertia with its length as radius, and its squared radii as length.
    """
    length = math.dist(*rod["end_pts"])
    m, r, b, s = (rod[key] for key in ("mass", "radius", "sphere_mass", "sphere_radius"))
    w, long, wide, off = (rod[f"motor_{key}"] for key in ("mass", "length", "radius", "offset"))
    along = m * r**2 / 2 + 2 * 0.4 * b * s**2 + 2 * w * long**2 / 2
    across = m * (3 * r**2 + length**2) / 12 + 2 * b * (0.4 * s**2 + (length / 2) ** 2)
    across += 2 * w * ((wide**2 + r**2) ** 2 / 12 + long**2 / 4 + off**2)
    return m + 2 * b + 2 * w, along, across


def test_masses_and_cables_are_those_of_the_engines(tmp_path):
    """Of each rod in its pose; rest lengths are shorter by what motors have wound; dampers are beside the cables."""
    scene, notes = read(tmp_path)
    structure = scene.structure
    for body, rod in zip(structure.bodies, robot_of(PRISM)["rods"], strict=True):
        mass, along, across = rod_by_hand(rod)
        ends = np.array(rod["end_pts"])
        axis = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        found = body_moments(body, structure.nodes)
        assert found[0] == pytest.approx(mass, rel=1e-12)
        np.testing.assert_allclose(found[1], ends.mean(0), atol=1e-12)
        expected = across * np.eye(3) + (along - across) * np.outer(axis, axis)
        np.testing.assert_allclose(found[2], expected, atol=1e-12)
    np.testing.assert_allclose(structure.cables.rest_length, [0.75] * 5 + [0.9] + [0.6] * 3)
    np.testing.assert_array_equal(structure.cables.stiffness, [800.0] * 6 + [400.0] * 3)
    assert structure.cables.damping is None
    np.testing.assert_array_equal(scene.terms[0].damping, [12.0] * 6 + [9.0] * 3)
    np.testing.assert_array_equal(scene.ground.balls.radius, 0.1)
    np.testing.assert_array_equal(structure.nodes[np.array(scene.ground.balls.nodes)][::2, 2], 0.1)
    assert (float(scene.friction.mu), scene.ground.restitution, float(scene.gravity)) == (0.8, None, 9.81)
    assert "motors wind 6 cables" in notes[4]
    assert notes[4].endswith("[gait] members = [0, 1, 2, 3, 4, 5]")


def moved(content: dict, seconds: float) -> np.ndarray:
    """(rods, 2, 3), m: ends of rods after a free flight by the engines' equations, with the torque of spin.

    A rod has a place, a direction and a spin. A cable pulls with K max(0, l - L) + c l'.
    """
    robot = robot_of(content)
    rods, sites = robot["rods"], robot["system_topology"]["sites"]
    ends = np.array([rod["end_pts"] for rod in rods])
    mass, along, across = np.array([rod_by_hand(rod) for rod in rods]).T
    owner = {site: k for k, rod in enumerate(rods) for site in rod["sites"]}
    axis0 = (ends[:, 1] - ends[:, 0]) / np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)[:, None]
    frames0 = np.stack([np.linalg.svd(a[None])[2].T for a in axis0])  # columns: the axis, and two across
    frames0 *= np.sign(np.linalg.det(frames0))[:, None, None]
    half = np.einsum("rij,ri->rj", frames0, ends[:, 1] - ends.mean(1))
    moments = np.stack([along, across, across], axis=1)
    strings = [
        (
            *(owner[end] for end in cable["end_pts"]),
            *(frames0[owner[end]].T @ (np.array(sites[end]) - ends[owner[end]].mean(0)) for end in cable["end_pts"]),
            *(cable[key] for key in ("stiffness", "damping")),
            cable["rest_length"] - cable.get("init_act_length", 0.0),
        )
        for cable in robot["springs"]
    ]

    def rates(_, state):
        x, v, w = (state[9 * len(rods) :].reshape(3, -1, 3))[[0, 1, 2]]
        turn = state[: 9 * len(rods)].reshape(-1, 3, 3)
        force, torque = mass[:, None] * [0, 0, -9.81], np.zeros_like(x)
        for i, j, p, q, K, c, L in strings:
            a, b = turn[i] @ p, turn[j] @ q
            d = x[j] + b - x[i] - a
            length = np.linalg.norm(d)
            rate = d / length @ (v[j] + np.cross(w[j], b) - v[i] - np.cross(w[i], a))
            pull = (K * max(0.0, length - L) + c * rate) * d / length
            force[i] += pull
            force[j] -= pull
            torque[i] += np.cross(a, pull)
            torque[j] -= np.cross(b, pull)
        inertia = np.einsum("rij,rj,rkj->rik", turn, moments, turn)
        spun = np.cross(w, np.einsum("rij,rj->ri", inertia, w))
        turned = np.linalg.solve(inertia, (torque - spun)[..., None])[..., 0]
        return np.concatenate(
            [
                np.cross(w[:, None], turn.swapaxes(1, 2)).swapaxes(1, 2).ravel(),
                *map(np.ravel, (v, force / mass[:, None], turned)),
            ]
        )

    start = np.concatenate([frames0.ravel(), ends.mean(1).ravel(), np.zeros(6 * len(rods))])
    state = solve_ivp(rates, (0, seconds), start, "DOP853", rtol=1e-10, atol=1e-12, max_step=2e-3).y[:, -1]
    turn = state[: 9 * len(rods)].reshape(-1, 3, 3)
    centre, reach = state[9 * len(rods) :].reshape(3, -1, 3)[0], np.einsum("rij,rj->ri", turn, half)
    return np.stack([centre - reach, centre + reach], axis=1)


@pytest.mark.parametrize(
    "where",
    [
        pytest.param("ends", marks=pytest.mark.campaign),
        pytest.param("beside", marks=pytest.mark.slow),
        pytest.param("network", marks=pytest.mark.campaign),
    ],
)
def test_a_free_flight_is_that_of_the_engines_equations(tmp_path, where):
    """Within a micrometre after half a second: with sites at the ends, beside the axes, and for rods that do not spin.

    One cable is slack at the start, and its damper acts.
    """
    content = changed()
    if where == "beside":
        places = robot_of(content)["system_topology"]["sites"]
        for site in places:
            places[site] = (np.array(places[site]) + np.array(SIDE) * (1 if site[0] == "a" else -1)).tolist()
    if where == "network":
        content["contact_params"] |= NETWORK
    scene = read_engine(written(tmp_path, content)).scene
    assert len(scene.structure.bodies[0].basic) == (2 if where == "network" else 4)
    lifted = type(scene)(scene.structure, scene.gravity, terms=scene.terms)
    options = SolverOptions(method="rk4", dt=2e-4)
    ours = np.asarray(simulate(lifted, 0.5, options=options, frame_rate=2.0).positions[-1])
    found = ours[np.array(scene.ground.balls.nodes)].reshape(-1, 2, 3)
    theirs = moved(content, 0.5)
    assert np.abs(theirs[:, :, 2] - np.array([rod["end_pts"] for rod in robot_of(content)["rods"]])[:, :, 2]).max() > 1
    np.testing.assert_allclose(found, theirs, rtol=0, atol=1e-6)


def test_the_unit_of_length_scales_lengths_alone(tmp_path):
    """Masses, stiffness and damping stay, and gravity is in units of length, too: the motion is the same."""
    (metres, _), (small, notes) = (read(tmp_path, unit=unit) for unit in (1.0, 0.1))
    np.testing.assert_allclose(small.structure.nodes, 0.1 * np.asarray(metres.structure.nodes))
    np.testing.assert_allclose(
        small.structure.cables.rest_length, 0.1 * np.asarray(metres.structure.cables.rest_length)
    )
    np.testing.assert_array_equal(small.structure.cables.stiffness, metres.structure.cables.stiffness)
    for one, other in zip(small.structure.bodies, metres.structure.bodies):
        inertias = (body_moments(body, scene.structure.nodes)[2] for body, scene in ((one, small), (other, metres)))
        np.testing.assert_allclose(next(inertias), 0.01 * next(inertias), atol=1e-15)
    assert float(small.gravity) == pytest.approx(0.981)
    assert notes[0] == "one unit of length is 0.1 m, kg and s are as they are, z is up, gravity is 0.981 m/s^2"


def test_rods_of_all_types(tmp_path):
    """Without motors they are lighter; a housing is a third motor in the middle; pieces of a rod weigh what it does."""
    plain = [(f"rods.{k}.rod_type", "rod_sphere_end_caps") for k in range(3)]
    assert float(read(tmp_path, *plain).scene.structure.mass) == pytest.approx(3 * 2.5)
    housed = [
        change
        for k in range(3)
        for change in (
            (f"rods.{k}.rod_type", "rod_housing_end_caps_motors"),
            (f"rods.{k}.housing_mass", 0.4),
            (f"rods.{k}.housing_length", 0.3),
        )
    ]
    structures = [read(tmp_path, *changes).scene.structure for changes in ((), housed)]
    masses, inertias = zip(*((s.mass, np.trace(body_moments(s.bodies[0], s.nodes)[2])) for s in structures))
    assert masses[1] - masses[0] == pytest.approx(3 * 0.4)
    more = 0.4 * (0.3**2 / 2 + 2 * ((0.08**2 + 0.02**2) ** 2 / 12 + 0.3**2 / 4))
    assert inertias[1] - inertias[0] == pytest.approx(more)
    assert float(read(tmp_path, ("rods.0.split_length", 0.5)).scene.structure.mass) == pytest.approx(3 * 3.7)
    bare = [(f"rods.{k}.rod_type", "rod") for k in range(3)]
    assert "rods[0] (rod0): rims of its cylinders" in refusal(tmp_path, changed(*bare))
    assert float(read(tmp_path, *bare, drop=["radius"]).scene.structure.mass) == pytest.approx(3 * 1.5)


def test_files_of_the_engine_with_a_network(tmp_path):
    """Other names of tables, rods without a type, and rods that do not spin about their axes: two points each."""
    content = changed()
    robot = content.pop("tensegrity_robot_config")
    robot["cables"] = robot.pop("springs")
    for rod in robot["rods"]:
        del rod["rod_type"]
    content |= {"tensegrity_cfg": robot, "latent_dim": 256}
    content["contact_params"] |= NETWORK
    path = written(tmp_path, content)
    scene, notes = read_any(path)
    assert (len(scene.structure.nodes), len(scene.structure.cables.edges)) == (6, 9)
    assert any("rods do not turn about their axes" in note for note in notes)
    content["tensegrity_cfg"]["system_topology"]["sites"]["a0"] = [0.5, 0.05, 0.1]
    said = refusal(tmp_path, content)
    assert "rolling_friction = 1 takes this share of rods' spin" in said
    assert "site a0 is beside its rod's axis" in said
    found = read_engine(written(tmp_path, content), drop=["rolling"])
    assert len(found.scene.structure.bodies[0].basic) == 4
    assert any(note.startswith("dropped: contact_params.rolling_friction") for note in found.notes)


def test_fixed_rods_are_supports(tmp_path):
    """Their nodes do not move, and they have no body."""
    structure = read(tmp_path, ("rods.1.fixed", True)).scene.structure
    assert (len(structure.bodies), len(structure.fixed)) == (2, 2)
    assert {axes for _, axes in structure.fixed} == {"xyz"}
    assert "all rods are fixed" in refusal(tmp_path, changed(*((f"rods.{k}.fixed", True) for k in range(3))))


def test_a_start_inside_the_ground(tmp_path):
    """A little: the robot is raised; deep: the engine pushes it out, which is refused."""
    slightly = [(f"rods.{k}.sphere_radius", 0.101) for k in range(3)]
    found = read(tmp_path, *slightly)
    assert any("starts 0.001 m inside the ground; here the robot starts on it" in note for note in found.notes)
    caps = np.array(found.scene.ground.balls.nodes)
    np.testing.assert_allclose(found.scene.structure.nodes[caps, 2].min(), 0.101)
    deep = [(f"rods.{k}.sphere_radius", 0.2) for k in range(3)]
    assert "rod0 starts 0.1 m inside the ground, and is pushed out of it" in refusal(tmp_path, changed(*deep))
    assert "dropped: rod0 starts 0.1 m" in "; ".join(read(tmp_path, *deep, drop=["contact"]).notes)


REFUSED = {
    "text for a number": (("rods.0.mass", "1.5"), "rods[0] (rod0).mass = '1.5': expected a number"),
    "truth for a number": (("springs.0.stiffness", True), "springs[0] (cable0).stiffness = True: expected a number"),
    "no mass": (("rods.0.mass", None), "rods[0] (rod0).mass is missing"),
    "negative": (("rods.0.radius", -1), "rods[0] (rod0).radius = -1.0: expected a positive number"),
    "huge": (("rods.0.mass", 1e300), "rods[0] (rod0).mass = 1e+300: expected a number of at most 1e+30"),
    "type": (("rods.0.rod_type", "rodd"), "rods[0] (rod0).rod_type = 'rodd': unknown"),
    "key": (("rods.0.sphere_mas", 1), "rods[0].'sphere_mas': unknown; perhaps you meant sphere_mass"),
    "cable type": (("springs.0.type", "spring"), "springs[0] (cable0).type = 'spring': unknown"),
    "site": (("springs.0.end_pts", ["a0", "a9"]), "cable cable0 ends at 'a9'; expected a site in the list of a rod"),
    "same rod": (("springs.0.end_pts", ["a0", "b0"]), "cable cable0 joins two sites of rod0"),
    "order": (("springs.0.end_pts", ["a1", "a0"]), "cable cable0 runs from rod1 back to rod0, an earlier rod"),
    "wound": (("springs.0.init_act_length", 0.9), "springs[0] (cable0).init_act_length = 0.9: expected less than"),
    "moving": (("rods.0.linear_vel", [0, 1, 0]), "rods[0] (rod0).linear_vel = [0.0, 1.0, 0.0], which would be lost"),
    "quaternion": (("rods.0.quat", [1, 0, 0, 0]), "rods[0] (rod0).quat = [1.0, 0.0, 0.0, 0.0]: turns z to"),
    "gravity": (("gravity", [0, 1, -9]), "gravity = [0.0, 1.0, -9.0]: expected it along -z"),
    "pieces": (("rods.0.split_length", 0.9), "rods[0] (rod0).split_length = 0.9: with less than two pieces"),
    "point": (("rods.0.end_pts", [[0, 0, 1], [0, 0, 1]]), "rods[0] (rod0).end_pts: both points are the same"),
    "names": (("rods.0.name", "rod1"), "'rod1' is the name of 2 parts"),
    "owners": (("rods.0.sites", ["a0", "b0", "a1"]), "site 'a1' belongs to rod0 and rod1; expected one rod"),
    "no cables": (("springs", []), "tensegrity_robot_config.springs = []: expected a list of at least one"),
    "restitution": (("contact_params.restitution", -0.2), "contact_params.restitution = -0.2, which is not from 0"),
    "thick": (("rods.0.motor_radius", 0.2), "rods[0] (rod0): rims of its cylinders, with a radius of 0.2, touch"),
}  # fmt: skip


@pytest.mark.parametrize(("change", "said"), REFUSED.values(), ids=REFUSED)
def test_each_refusal_names_the_place(tmp_path, change, said):
    """In one line, with the value and what to do."""
    assert refusal(tmp_path, changed(change)).startswith(said)


def test_other_json_is_no_robot(tmp_path):
    """Cut off, another object, a list, nested without end, a number of thousands of digits."""
    text = json.dumps(PRISM)
    assert refusal(tmp_path, text[: len(text) // 2]).startswith("not JSON: ")
    expected = "holds no robot of a differentiable engine; expected a table tensegrity_robot_config or tensegrity_cfg"
    assert refusal(tmp_path, {"rods": []}) == expected
    assert refusal(tmp_path, "[1]") == expected
    assert "nested too deeply" in refusal(tmp_path, "[" * 100_000)
    digits = text.replace('"mass": 1.5', f'"mass": {"9" * 5000}', 1)
    assert "mass = inf: expected a finite number" in refusal(tmp_path, digits)


def test_the_command_converts_it(tmp_path, capsys):
    """To a scene file that is the same scene; nothing writes such files."""
    path = written(tmp_path, PRISM)
    main(ConvertSettings(str(path), tmp_path / "robot.toml", unit=0.1))
    said = capsys.readouterr().out
    assert "3 rigid bodies, 0 struts, 9 cables, 11.1 kg" in said
    assert "one unit of length is 0.1 m" in said
    scene = load_scene(tmp_path / "robot.toml")
    for body, other in zip(scene.structure.bodies, read_engine(path, 0.1).scene.structure.bodies, strict=True):
        np.testing.assert_allclose(body.matrix, other.matrix, atol=1e-12)
    with pytest.raises(InputError, match=r"x\.json: a robot of a differentiable engine .* is not written"):
        main(ConvertSettings(str(path), Path("x.json")))
    with pytest.raises(InputError, match="is not written"):
        write_any(scene, "x.json")
    moving = written(tmp_path, changed(("rods.0.ang_vel", [0, 0, 1])))
    with pytest.raises(InputError, match="--drop velocity"):
        main(ConvertSettings(str(moving), tmp_path / "robot.toml"))
    main(ConvertSettings(str(moving), tmp_path / "robot.toml", drop=("velocity",)))
    assert "dropped: rods[0] (rod0).ang_vel = [0.0, 0.0, 1.0]" in capsys.readouterr().out
