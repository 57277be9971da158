"""MuJoCo models whose tendons run over several sites: cables that slide over nodes, with the law that MuJoCo has."""

import dataclasses

import numpy as np
import pytest
from measurements.conformance import SPRINGS, by_both, flying

from jaxgrity import InputError, SolverOptions, parse_scene, scene_text, simulate
from jaxgrity.formats import mjcf_controls, mujoco_model, read_mjcf, save_mjcf

mujoco = pytest.importorskip("mujoco")

APART = 'contype="0" conaffinity="0"'
FREE = """<body name="{n}" pos="{x}" euler="{turn}"><freejoint/>{shape}<site name="{n}0" pos="0 0 -0.15"/>
<site name="{n}1" pos="0 0 0.15"/></body>"""
BOX = FREE.format(
    n="{n}",
    x="{x}",
    turn="{turn}",
    shape=f'<geom type="box" size="0.1 0.2 0.05" mass="2" {APART}/><site name="{{n}}2"/>',
)
BALL = f'<geom type="sphere" size="{{}}" pos="0 0 {{}}" mass="0.5" {APART}/>'
ROD, THICKER = (
    FREE.format(n="{n}", x="{x}", turn="{turn}", shape=BALL.format(radius, -0.15) + BALL.format(radius, 0.15))
    for radius in (1e-4, 1e-2)
)
POINT = (
    '<body name="{n}" pos="{x}">'
    + "".join(f'<joint type="slide" axis="{axis}"/>' for axis in ("1 0 0", "0 1 0", "0 0 1"))
    + f'<geom type="sphere" size="0.01" mass="0.4" {APART}/><site name="{{n}}0"/></body>'
)
WORLD = {"w": (0, 0, 3), "v": (2, 0, 0), "u": (-1, 2, 0), "t": (-1, -2, 0)}
"""Sites of the world, around the robot."""
SITES = "".join('<site name="{}" pos="{} {} {}"/>'.format(name, *x) for name, x in WORLD.items())
ROBOTS = {
    # a cable over four points, two of which another one meets
    "points": ({"a": POINT, "b": POINT}, ["w a0 b0 v", "u b0 t", "u a0", "t a0"], [3, 2, 1, 1]),
    # inside a body from one site to the next, and over the world from one site to the next
    "boxes": ({"a": BOX, "b": BOX}, ["w a0 a2 b1", "v b0 b2 a1 u", "t b2 a0", "a2 w u b1", "v a0"], [3, 4, 2, 3]),
    # over ends of rods, and along one of them
    "rods": ({"a": THICKER, "b": ROD}, ["w a0 a1 b1", "v b0 a1", "u b1", "t b0", "u a0", "t a1"], [3, 2, 1, 1]),
}  # fmt: skip


def model(bodies, paths, seed=0, shortened=0.3, last=""):
    """As MJCF, in random poses: every tendon pulls, with a random stiffness and damping."""
    rng = np.random.default_rng(seed)
    parts = ""
    for name, body in bodies.items():
        x, turn = ([*map(float, rng.uniform(-most, most, 3))] for most in (0.5, 90))
        parts += body.format(n=name, x="{} {} {}".format(*x), turn="{} {} {}".format(*turn))
    start = f"<mujoco><option timestep='1e-4' integrator='RK4'/><worldbody>{SITES}{parts}</worldbody><tendon>"
    sites = ["".join(f'<site site="{site}"/>' for site in path.split()) for path in paths]
    plain = start + "".join(f"<spatial>{each}</spatial>" for each in sites) + "</tendon></mujoco>"
    lengths = moved(plain, 0)[2]
    for k, each in enumerate(sites):
        law = (
            f'stiffness="{rng.uniform(40, 90)}" damping="{rng.uniform(1, 2)}" springlength="0 {shortened * lengths[k]}"'
        )
        start += f'<spatial name="t{k}" {law}>{each}</spatial>'
    return f"{start}</tendon>{last}</mujoco>"


def moved(text, steps):
    """Model, places of its sites, m, and lengths of its tendons, m, after so many steps of MuJoCo."""
    there = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(there)
    mujoco.mj_step(there, data, steps)
    mujoco.mj_forward(there, data)
    return there, data.site_xpos.copy(), data.ten_length.copy()


def found(folder, text, **how):
    (folder / "robot.xml").write_text(text)
    return read_mjcf(folder / "robot.xml", **how)


def whole_cables(cables):
    """Stiffness, rest length and damping of each cable: its segments are in series."""
    every = [k for cluster in cables.clusters for k in cluster]
    rows = [*cables.clusters, *((k,) for k in range(len(cables.edges)) if k not in every)]
    rows = [np.array(row) for row in sorted(rows, key=min)]
    K, c = ([1 / np.sum(1 / x[row]) for row in rows] for x in (cables.stiffness, cables.damping))
    return K, [cables.rest_length[row].sum() for row in rows], c, [len(row) for row in rows]


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("seed", range(3))
def test_tendons_over_several_sites_are_clusters(name, seed, tmp_path):
    """With the stiffness, the damping and the rest length of the tendon, over the nodes of its sites."""
    bodies, paths, segments = ROBOTS[name]
    text = model(bodies, paths, seed)
    there, sites, lengths = moved(text, 0)
    structure = found(tmp_path, text).scene.structure
    cables = structure.cables
    K, L, c, count = whole_cables(cables)
    np.testing.assert_allclose(K, there.tendon_stiffness, rtol=1e-12)
    np.testing.assert_allclose(c, there.tendon_damping, rtol=1e-12)
    np.testing.assert_allclose(L, there.tendon_lengthspring[:, 1], rtol=1e-12)
    assert count[: len(segments)] == segments
    nodes, first = np.asarray(structure.nodes), 0
    for path, length, many in zip(paths, lengths, count):
        along = [cables.edges[first][0], *(edge[1] for edge in cables.edges[first : first + many])]
        expected = sites[[there.site(site).id for site in path.split()]]
        np.testing.assert_allclose(nodes[along], expected, atol=1e-12)
        assert np.linalg.norm(np.diff(expected, axis=0), axis=1).sum() == pytest.approx(length)
        first += many


@pytest.mark.campaign
@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.campaign] * (n != "boxes")) for n in ROBOTS])
def test_they_move_as_in_mujoco(name, tmp_path):
    """Half a second in which no cable goes slack: within 1e-6 m, extrapolated from steps of 0.1 and 0.2 ms."""
    bodies, paths, _ = ROBOTS[name]
    text = model(bodies, paths)
    scene, _ = found(tmp_path, text)
    (there, start, _), (_, end, lengths) = moved(text, 0), moved(text, 5000)
    assert np.all(lengths > there.tendon_lengthspring[:, 1])
    assert np.abs(end - start).max() > 0.1
    nodes = np.asarray(scene.structure.nodes)
    own = [int(np.argmin(np.linalg.norm(nodes - x, axis=1))) for x in start]
    fine, coarse = (
        np.asarray(simulate(scene, 0.5, options=SolverOptions(dt=dt), frame_rate=2.0).positions[-1])[own]
        for dt in (1e-4, 2e-4)
    )
    np.testing.assert_allclose(fine, end, rtol=0, atol=1e-4)
    np.testing.assert_allclose(fine + (fine - coarse) / 3, end, rtol=0, atol=1e-6)


def test_segments_within_an_end_body_shorten_the_rest_length(tmp_path):
    """The cable ends where it leaves the body; one whose rest length is shorter than that segment keeps it."""
    text = model({"a": ROD, "b": ROD}, ["a0 a1 u", "v w b1", "b0 u", "t a1 a0"])
    cables = found(tmp_path, text).scene.structure.cables
    there = moved(text, 0)[0]
    whole, K = there.tendon_lengthspring[:, 1], there.tendon_stiffness
    assert whole[1] < np.sqrt(13)  # from v to w
    assert [list(cluster) for cluster in cables.clusters] == [[1, 2]]
    np.testing.assert_allclose(cables.rest_length[[0, 4]], whole[[0, 3]] - 0.3)
    np.testing.assert_allclose(cables.stiffness[[0, 4]], K[[0, 3]])
    assert cables.rest_length[1:3].sum() == pytest.approx(whole[1])


def test_actuators_of_such_tendons_are_springs(tmp_path):
    """A servo's stiffness, rest length at control 0 and damping are those of the whole cable."""
    law = 'gainprm="600" biastype="affine" biasprm="300 -600 -6" forcelimited="true" forcerange="-9000 0"'
    text = model(
        {"a": POINT, "b": POINT},
        ["w a0 b0 v", "u b0 t", "u a0"],
        last=f"<actuator><general tendon='t0' {law}/></actuator>",
    )
    start, _, rest = text.partition('name="t0" stiffness="')
    text = f'{start}name="t0" stiffness="0" {rest.partition(" ")[2]}'
    K, L, c, _ = whole_cables(found(tmp_path, text).scene.structure.cables)
    there = moved(text, 0)[0]
    assert (K[0], L[0], c[0]) == pytest.approx((600, 0.5, 6 + there.tendon_damping[0]))


PUSHING = model(*ROBOTS["points"][:2]).replace('springlength="0 ', 'springlength="')
A, B, U, W = (f'<site site="{site}"/>' for site in ("a0", "b0", "u", "w"))
REFUSED = {
    "a pulley": (A + B, A + '<pulley divisor="2"/>' + B, "tendon t0: expected two or more sites, without pulleys"),
    "a geom": (A + B, A + '<geom geom="g"/>' + B, "tendon t0: expected two or more sites, without pulleys and geoms"),
    "there and back": (B + '<site site="v"/>', W, "tendon t0: joins two sites that tendon t0 joins, too"),
    "side by side": (U + A, W + A, "tendon t2: joins two sites that tendon t0 joins, too; expected one of them"),
}  # fmt: skip


@pytest.mark.parametrize(("before", "after", "reason"), REFUSED.values(), ids=REFUSED)
def test_other_paths_are_refused(before, after, reason, tmp_path):
    """In one line: pulleys, what deflects a tendon, and two tendons, or parts of one, between the same two nodes."""
    text = model(*ROBOTS["points"][:2]).replace(before, after, 1).replace('mass="0.4"', 'mass="0.4" name="g"', 1)
    with pytest.raises(InputError) as caught:
        found(tmp_path, text)
    assert reason in str(caught.value)
    assert str(caught.value).isprintable()


def test_a_tendon_that_pushes_over_sites_is_a_cable_that_pushes(tmp_path):
    """Where nodes are points, without a dead band; beside free bodies one that is stretched does not push."""
    pushing = found(tmp_path, PUSHING).scene
    assert len(pushing.structure.cables.clusters) == 2
    np.testing.assert_array_equal(pushing.terms[0].width, 0.0)
    beside = model(*ROBOTS["rods"][:2]).replace('springlength="0 ', 'springlength="')
    scene, notes = found(tmp_path, beside)
    assert "6 tendons would push, too, if they went slack; here they are cables, which do not" in notes
    assert len(scene.structure.cables.clusters) == 2


CLUSTERS = ((0, 3), (22, 20, 1))


def test_clusters_are_written_and_read(tmp_path):
    """As one tendon each, whose law is that of the whole cable; what is read has this law again."""
    scene = parse_scene(scene_text("reference").replace("prestrain", "clusters = [[0, 3], [22, 20, 1]]\nprestrain", 1))
    written = save_mjcf(scene, tmp_path / "robot.xml")
    there, ours = mujoco.MjModel.from_xml_string(written.xml), scene.structure.cables
    assert there.ntendon == 6 + 21
    K, L, c, count = whole_cables(ours)
    assert sorted(count) == [1] * 19 + [2, 3]
    tendons = [there.tendon(f"cable{k}").id for k in (0, 1, 2)]
    np.testing.assert_array_equal(there.tendon_num[tendons], [3, 4, 2])
    np.testing.assert_allclose(there.tendon_stiffness[tendons], K[:3])
    np.testing.assert_allclose(there.tendon_lengthspring[tendons, 1], L[:3])
    again = read_mjcf(tmp_path / "robot.xml").scene.structure.cables
    for theirs, own in zip(whole_cables(again), (K, L, c, count)):
        np.testing.assert_allclose(theirs, own, rtol=1e-12)
    paths = {frozenset(ours.edges[k] for k in cluster) for cluster in ours.clusters}
    assert {frozenset(tuple(sorted(again.edges[k])) for k in cluster) for cluster in again.clusters} == paths


def test_a_gait_moves_such_a_cable_as_a_whole():
    """One actuator, by the sum of what its segments are shortened, and as far as their amplitudes allow."""
    text = scene_text("reference").replace("prestrain", "clusters = [[0, 3], [22, 20, 1]]\nprestrain", 1)
    text = text.replace('members = "struts"', "members = [6, 9, 7, 12]")
    text = text.replace("phase = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]", "phase = [0.0, 0.5, 2.0, 3.0]")
    scene = parse_scene(text)
    written = mujoco_model(scene)
    assert written.actuated == (6, 7, 12)
    there = mujoco.MjModel.from_xml_string(written.xml)
    assert (there.nu, there.ntendon) == (3, 27)
    times, rest = np.linspace(0, 6, 200), scene.structure.cables.rest_length
    alone = dataclasses.replace(scene.structure.cables, clusters=())
    apart = mjcf_controls(
        dataclasses.replace(scene, structure=dataclasses.replace(scene.structure, cables=alone)), times
    )
    controls = mjcf_controls(scene, times)
    np.testing.assert_allclose(controls, np.stack([apart[:, 0] + apart[:, 2], apart[:, 1], apart[:, 3]], 1))
    np.testing.assert_allclose(
        there.actuator_ctrlrange[:, 0], [-0.3 * (rest[0] + rest[3]), -0.3 * rest[1], -0.3 * rest[6]]
    )
    assert np.all(controls >= there.actuator_ctrlrange[:, 0] - 1e-12)


@pytest.mark.campaign
def test_clusters_fly_as_they_are_written():
    """RK4 at 1e-4 s in both, 0.5 s: within 1e-6 m."""
    scene = flying("icosahedron", SPRINGS)
    cables = dataclasses.replace(scene.structure.cables, clusters=CLUSTERS)
    scene = dataclasses.replace(scene, structure=dataclasses.replace(scene.structure, cables=cables))
    theirs, ours, _ = by_both(scene, 0.5, 1e-4, SolverOptions(method="rk4", dt=1e-4))
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-6)
    assert np.abs(ours - scene.structure.nodes).max() > 0.01
