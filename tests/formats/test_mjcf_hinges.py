"""Springs and dampers of MuJoCo's hinges: free flight as there; written as they were."""

import dataclasses

import equinox as eqx
import numpy as np
import pytest
from formats.test_mjcf_springs import ends, found, moved

from jaxgrity import InputError, SolverOptions, load_scene, save_scene
from jaxgrity.formats import save_mjcf
from jaxgrity.model.hinges import HingeDampers, HingeSprings

pytest.importorskip("mujoco")

BOX = '<geom type="box" size="0.1 0.2 0.05" mass="2" contype="0" conaffinity="0"/>'
SITES = (
    '<site name="{n}0" pos="0.1 0.2 0.05"/><site name="{n}1" pos="-0.1 0.1 -0.05"/><site name="{n}2" pos="0 -0.2 0"/>'
)
HINGE = '<joint type="hinge" axis="0.2 1 0.3" pos="0 0.1 -0.1" {}/>'
CABLES = ("w a0", "v a1", "u b0", "a2 b2", "v b1")


def hinged(law, free=True):
    """A body in the world or free, and one on it by a hinge, on cables."""
    sites = '<site name="w" pos="0 0 3"/><site name="v" pos="2 0 0"/><site name="u" pos="-1 2 0"/>'
    inner = f'<body name="b" pos="0.1 0.3 -0.3" euler="10 0 40">{HINGE.format(law)}{BOX}{SITES.format(n="b")}</body>'
    joint = "<freejoint/>" if free else HINGE.format(law)
    outer = f'<body name="a" pos="0.1 0.2 0.3" euler="20 30 40">{joint}{BOX}{SITES.format(n="a")}{inner}</body>'
    tendons = "".join(
        f'<spatial stiffness="60" damping="1" springlength="0 0.2"><site site="{p.split()[0]}"/>'
        f'<site site="{p.split()[1]}"/></spatial>'
        for p in CABLES
    )
    options = "<option timestep='1e-4' integrator='RK4'/>"
    return f"<mujoco>{options}<worldbody>{sites}{outer}</worldbody><tendon>{tendons}</tendon></mujoco>"


def apart(scene, text):
    """The largest distance, m, from where MuJoCo has the sites after 0.5 s, extrapolated over two steps."""
    start, end, _ = moved(text, 5000)
    off = np.linalg.norm(np.asarray(scene.structure.nodes) - start[:, None], axis=2)
    assert (off.min(1) < 1e-12).all()
    assert np.abs(end - start).max() > 0.1
    fine, coarse = (ends(scene, SolverOptions(dt=dt)) for dt in (2e-4, 4e-4))
    ours = fine + (fine - coarse) / 3
    return np.abs(ours[off.argmin(1)] - end).max()


LAW = 'stiffness="3" damping="0.2" springref="40"'


@pytest.mark.parametrize(
    "free", [pytest.param(True, marks=pytest.mark.campaign), pytest.param(False, marks=pytest.mark.campaign)]
)
def test_hinges_with_springs_move_as_in_mujoco(free, tmp_path):
    """Between free bodies, and to the world: 0.5 s within 1e-6 m. Without the springs they move elsewhere."""
    text = hinged(LAW, free)
    scene, notes = found(tmp_path, text)
    assert [type(term) for term in scene.terms[-2:]] == [HingeSprings, HingeDampers]
    assert len(scene.terms[-1].nodes) == 2 - free
    assert f"{2 - free} hinges have springs or dampers" in notes
    assert apart(scene, text) < 1e-6
    assert np.abs(moved(text, 5000)[1] - moved(hinged("", free), 5000)[1]).max() > 1e-2


@pytest.mark.parametrize("free", [True, False])
def test_hinges_are_written_as_they_were(free, tmp_path):
    """For MuJoCo, also where a law names the parts the other way round, and in scene files."""
    text = hinged(LAW, free)
    scene, _ = found(tmp_path, text)
    springs = scene.terms[-2]
    turned = HingeSprings([nodes[::-1] for nodes in springs.nodes], springs.stiffness, springs.rest_angle)
    swapped = [(b, p, q, a) for a, p, q, b in springs.nodes]
    mirrored = HingeSprings(swapped, springs.stiffness, -springs.rest_angle)
    start, end, _ = moved(text, 5000)
    for law in (springs, turned, mirrored):
        there = dataclasses.replace(scene, terms=(*scene.terms[:-2], law, scene.terms[-1]))
        written = save_mjcf(there, tmp_path / "again.xml", timestep=1e-4)
        assert not [note for note in written.notes if "left out" in note]
        first, last, _ = moved(written.xml, 5000)
        off = np.linalg.norm(first - start[:, None], axis=2)
        assert off.min(1).max() < 1e-9
        assert np.abs(last[off.argmin(1)] - end).max() < 1e-6
    save_scene(scene, tmp_path / "robot.toml")
    assert eqx.tree_equal(load_scene(tmp_path / "robot.toml").terms, scene.terms)


def test_what_hinges_cannot_be_is_refused(tmp_path):
    """A spring that is wound by more than half a turn; joints that are no hinges."""
    with pytest.raises(InputError, match="line 1: body b: the spring of its joint is wound by more than half a turn"):
        found(tmp_path, hinged('stiffness="3" springref="200"'))
    ball = hinged(LAW).replace('type="hinge"', 'type="ball"')
    with pytest.raises(InputError, match="line 1: body b: its joint has damping, and is neither a slide nor a hinge"):
        found(tmp_path, ball)
    with pytest.raises(InputError, match=r"hinges: nodes = \[0, 1, 1, 2\]: expected four different nodes"):
        HingeSprings(((0, 1, 1, 2),), [1.0], [0.0])
