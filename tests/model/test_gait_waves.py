"""Waves that rotations map on themselves: those of known robots, and how such a robot moves."""

import dataclasses

import numpy as np
import pytest

from jaxgrity import Gait, Members, Structure, load_scene
from jaxgrity.model import image, symmetries, travelling_waves
from jaxgrity.structures import prism


def plain(geometry) -> Structure:
    """Of springs that are all alike."""
    struts, cables = geometry.struts, geometry.cables
    return Structure(
        geometry.nodes,
        np.ones(len(geometry.nodes)),
        Members(struts, np.full(len(struts), 1e4), np.ones(len(struts))),
        Members(cables, np.full(len(cables), 1e3), np.ones(len(cables))),
    )


def test_the_six_strut_robot_has_two():
    """Parallel struts together, the three directions a third of a period apart, one way round or the other."""
    structure = load_scene("reference").structure
    waves = travelling_waves(structure, tuple(range(6)))
    along = [np.argmax(np.abs(structure.nodes[j] - structure.nodes[i])) for i, j in structure.struts.edges]
    assert len(waves) == 2
    for wave in waves:
        assert set(wave.groups) == {0}
        assert len({(direction, shift) for direction, shift in zip(along, wave.shifts)}) == 3
        assert sorted(round(3 * shift) for shift in set(wave.shifts)) == [0, 1, 2]
    np.testing.assert_allclose(np.add(waves[0].shifts, waves[1].shifts) % 1, 0, atol=1e-12)


@pytest.mark.parametrize("members", [tuple(range(6)), tuple(range(6, 30))], ids=["struts", "cables"])
def test_every_rotation_shifts_time_alone(members):
    """The image of the gait has all phases shifted by the same angle; without the wave it has not."""
    structure, one = load_scene("reference").structure, np.ones(len(members))
    for wave in travelling_waves(structure, members):
        gait = Gait(members, 2 * np.pi * np.array(wave.shifts), 0.3 * one, one, 1.0, 1.0)
        angles = set()
        for rotation in symmetries(structure, mirrors=False):
            apart = np.asarray(image(gait, rotation).phase) - np.asarray(gait.phase)
            turns = (apart / (2 * np.pi) + 1e-9) % 1
            np.testing.assert_allclose(turns, turns[0], atol=1e-6)
            angles.add(round(3 * float(turns[0])))
        assert angles == {0, 1, 2}


def test_prisms_follow_their_axis():
    """Half turns about axes across it would keep each strut of three in step, so rotations about the axis alone count;
    of four struts those across alternate."""
    three = travelling_waves(plain(prism(3)), (0, 1, 2))
    assert sorted(wave.shifts for wave in three) == pytest.approx(np.array([(0, 1 / 3, 2 / 3), (0, 2 / 3, 1 / 3)]))
    assert [wave.shifts for wave in travelling_waves(plain(prism(4)), (0, 1, 2, 3))] == [(0, 0.5, 0, 0.5)]


def test_rotations_about_one_axis_leave_two_groups():
    """Of the six struts two groups of three follow each other; in step with each other they are waves of the whole."""
    structure = load_scene("reference").structure
    whole = {wave.shifts for wave in travelling_waves(structure, tuple(range(6)))}
    for wave in travelling_waves(structure, tuple(range(6)), one_axis=True):
        assert sorted(wave.groups) == [0, 0, 0, 1, 1, 1]
        lags = [np.round(np.array(wave.shifts) + np.array(wave.groups) * lag / 3, 9) % 1 for lag in range(3)]
        assert any(np.allclose(lag, shifts) for lag in lags for shifts in whole)


def test_without_rotations_there_is_none():
    """One heavy node leaves no rotation, nor does a gait of one strut."""
    structure = load_scene("reference").structure
    heavy = dataclasses.replace(structure, node_mass=np.r_[2 * structure.node_mass[0], structure.node_mass[1:]])
    assert travelling_waves(heavy, tuple(range(6))) == ()
    assert travelling_waves(structure, (0,)) == ()
