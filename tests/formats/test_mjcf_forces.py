"""MuJoCo models whose actuators pull with a force: free flight as there, under controls too; written as they were."""

import dataclasses

import numpy as np
import pytest
from formats.test_mjcf_springs import POINT, PULLING, ends, found, largest_error, model

from jaxgrity import Gait, InputError, SolverOptions, describe, load_scene, save_scene, with_gait
from jaxgrity.formats import mjcf_controls, read_mjcf, save_mjcf
from jaxgrity.model import commanded_pull
from jaxgrity.model.pulls import CommandedPull, forced_cables

mujoco = pytest.importorskip("mujoco")

TENDONS = [
    ("w a0", 'damping="0.5"'),  # a motor alone
    ("w b0", ""),
    ("a0 b0", PULLING),  # a motor beside a spring that only pulls
    ("v a0", 'stiffness="60" springlength="1.2"'),  # and beside one that pushes, too
    ("u b0", PULLING),  # a motor along it, as a tendon of its own
    ("b0 u", ""),
    ("t b0 v", ""),  # over several sites
]
ACTUATORS = """<actuator><motor name="m0" tendon="t0" ctrlrange="-20 0"/>
<motor name="m1" tendon="t1" ctrlrange="0 1" gear="-30"/><motor name="m2" tendon="t2" ctrlrange="-9 9"/>
<motor name="m3" tendon="t3" ctrlrange="-9 9"/><motor name="m5" tendon="t5" ctrlrange="-40 0"/>
<general name="m6" tendon="t6" gainprm="2" biastype="affine" biasprm="-1 0 0" ctrlrange="-8 0" forcerange="-12 0"/>
<velocity name="m7" tendon="t0" kv="2" ctrlrange="-3 3"/></actuator>"""
KEY = '<keyframe><key name="up" qpos="0 0 0 0.1 -0.1 0.2" ctrl="-12 0.4 -3 5 -7 -3 -1"/></keyframe></mujoco>'
DRIVEN = model(POINT, TENDONS).replace("</mujoco>", ACTUATORS + KEY)


def test_forces_of_a_keyframe_pull_as_in_mujoco(tmp_path):
    """Along tendons without a spring, beside springs, and over several sites: 0.5 s within 1e-6 m."""
    scene, notes = found(tmp_path, DRIVEN, keyframe="up")
    pulls, slopes = forced_cables(scene).T
    np.testing.assert_allclose(pulls, [14, 12, 3, 7, 7])
    lengths = np.array([np.sum(scene.structure.cables.rest_length[list(k)]) for k in ((0,), (1,), (4, 5))])
    np.testing.assert_allclose(slopes[[0, 1, 4]] * lengths, [12, 18, 5])
    assert not slopes[2:4].any()
    np.testing.assert_allclose(scene.terms[-2].damping[:2], [2.5, 0])  # a velocity servo damps, too
    assert scene.structure.struts.rest_length[0] == pytest.approx(1.2 + 5 / 60)
    error, _ = largest_error(scene, ends(scene, SolverOptions(method="dopri8")), DRIVEN)
    assert error < 1e-6
    said = " ".join(notes)
    assert "controls set the pull of 4 members at any length: shortening by a share s adds s times up to 18 N" in said
    assert "[gait] members = [1, 2, 5, 6]" in said
    assert "left out" not in said


def test_forces_are_written_as_they_were(tmp_path):
    """For MuJoCo, and as scene files."""
    scene = found(tmp_path, DRIVEN, keyframe="up").scene
    assert save_mjcf(scene, tmp_path / "again.xml").notes == ()
    save_scene(scene, tmp_path / "robot.toml")
    for again in (read_mjcf(tmp_path / "again.xml").scene, load_scene(tmp_path / "robot.toml")):
        assert isinstance(again.terms[-1], CommandedPull)
        np.testing.assert_allclose(forced_cables(again), forced_cables(scene), rtol=1e-12)
        np.testing.assert_allclose(again.structure.cables.stiffness, scene.structure.cables.stiffness, rtol=1e-12)


def test_a_gait_drives_forces_as_controls_do_in_mujoco(tmp_path):
    """Of cables without springs: 0.5 s within 1e-6 m, both extrapolated over their steps."""
    text = model(POINT, [(path, 'damping="1"') for path in ("w a0", "w b0", "v a0", "u b0", "a0 b0")])
    motors = "".join(f'<motor tendon="t{k}" ctrlrange="-40 0"/>' for k in range(5))
    scene = found(tmp_path, text.replace("</mujoco>", f"<actuator>{motors}</actuator></mujoco>")).scene
    assert not forced_cables(scene)[:, 0].any()
    gait = Gait(tuple(range(5)), np.arange(5.0), np.full(5, 0.8), np.full(5, 2.0), 0.0, 0.5)
    scene = with_gait(scene, gait)
    ours = ends(scene, SolverOptions(method="dopri8"))
    theirs, start = [], np.asarray(scene.structure.nodes)
    for dt in (1e-4, 2e-4):
        written = save_mjcf(scene, tmp_path / "again.xml", timestep=dt)
        assert written.actuated == (0, 1, 2, 3, 4)
        there = mujoco.MjModel.from_xml_string(written.xml)
        data, steps = mujoco.MjData(there), round(0.5 / dt)
        controls = mjcf_controls(scene, (np.arange(steps) + 0.5) * dt)
        for row in controls:
            data.ctrl[:5] = row
            mujoco.mj_step(there, data)
        mujoco.mj_forward(there, data)
        theirs.append(np.stack([data.site(f"n{k}").xpos for k in range(len(start))]))
    assert np.abs(ours - start).max() > 0.5
    assert np.abs(ours - theirs[0] - (theirs[0] - theirs[1]) / 3).max() < 1e-6


def test_what_no_cable_can_do_is_refused(tmp_path):
    """Pushing, and a pull that no spring bears; a motor without a range cannot be driven, and is left out."""
    with pytest.raises(InputError, match=r"tendon t0: its actuators push with 2 N; a cable only pulls, which would be"):
        found(tmp_path, DRIVEN.replace('"-12 0.4', '"4 0.4').replace('ctrlrange="-20 0"', ""), keyframe="up")
    with pytest.raises(InputError, match="tendon t3: its actuators pull more than its spring can push"):
        found(tmp_path, DRIVEN.replace("-3 5 -7", "-3 -90 -7").replace("-9 9", "-99 9"), keyframe="up")
    said = " ".join(found(tmp_path, DRIVEN.replace('ctrlrange="-20 0"', "")).notes)
    assert "3 actuators have no force at the start's controls, and are left out: m0, m2, m3" in said
    with pytest.raises(InputError, match="no tendon has a spring, nor an actuator that is one or pulls; expected"):
        found(tmp_path, model(POINT, [("w a0", 'damping="1"'), ("w b0", "")]))


def test_cables_that_are_driven_by_force_are_described(tmp_path):
    """They are not broken; a law is refused that does not fit."""
    scene = found(tmp_path, DRIVEN, keyframe="up").scene
    assert "driven by force [0, 1, 2, 3, 4, 5]" in describe(scene)
    with pytest.raises(InputError, match=r"pull\[1\] = -1 N"):
        commanded_pull(scene.structure.cables, [1.0, -1.0, 0.0, 0.0, 0.0])
    loose = dataclasses.replace(scene, terms=scene.terms[:-1])
    assert "broken [0, 1, 4, 5]" in describe(loose)


def test_velocity_servos_of_joints_are_not_left_out(tmp_path):
    """They damp at control 0, which no scene holds."""
    named = DRIVEN.replace('<joint type="slide" axis="1 0 0"/>', '<joint name="j" type="slide" axis="1 0 0"/>', 1)
    servo = '<velocity name="v" joint="j" kv="2"/></actuator>'
    text = named.replace("</actuator>", servo).replace('-3 -1"/></key', '-3 -1 0"/></key')
    with pytest.raises(InputError, match="actuator v: no spring of a tendon that has a rest length at its control"):
        found(tmp_path, text)
