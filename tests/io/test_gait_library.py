"""Gaits as files: what comes with the library loads, fits its scene and reaches what its record says; errors."""

import json
from dataclasses import replace

import equinox as eqx
import numpy as np
import pytest

from jaxgrity import (
    Gait,
    InputError,
    Overtone,
    SolverOptions,
    contact_twin,
    gait_facts,
    gait_names,
    gait_record,
    load_gait,
    load_scene,
    with_gait,
)
from jaxgrity.io.files import save_json
from jaxgrity.orbits import find_orbit
from jaxgrity.orbits.finding import shortest_watch


@pytest.mark.parametrize("name", gait_names())
def test_gaits_of_the_library_fit_their_scenes(name):
    """Each has a scene of the project, a number for each member, error bars, and the command that found it."""
    record, gait = gait_record(name), load_gait(name)
    scene = with_gait(load_scene(record["scene"]), gait)
    assert eqx.tree_equal(scene.gait, replace(gait, robot=None))
    steady = record["steady"]
    assert steady["settled"]
    assert steady["verified_for"] > 290
    assert steady["slowest_window"] > 0.9 * steady["speed"]
    assert steady["speed"] > 10 * steady["speed_error_bar"] > 0
    assert steady["multiplier"] < 1
    assert steady["returned"] > 0.9
    assert steady["spread"] < 0.1 * steady["body_length"]
    assert 0 < steady["cycle"]["work"] < steady["cycle"]["effort"]
    assert steady["robust"]["robots"] == steady["other_contact_model"]["robots"] == 128
    shares = [steady["robust"]["mean"], steady["other_contact_model"]["speed"]] / np.array(steady["speed"])
    level = scene.ground.incline == 0.0  # on slopes, some robots lose their heading on penalty contact
    assert (shares > (0.85 if level else 0.8)).all()
    for each in (steady["robust"], steady["other_contact_model"]):
        assert each["standard_deviation"] < (0.15 if level else 0.2) * steady["speed"]
    assert record["command"].startswith(("python experiments/gait_search.py", "jaxgrity search"))


@pytest.mark.slow
def test_a_gait_reaches_what_its_record_says():
    """Its speed in an orbit that is found anew, at a step of one's own."""
    record = gait_record("lasting")
    scene = with_gait(load_scene(record["scene"]), load_gait("lasting"))
    again = find_orbit(scene, 70.0, options=SolverOptions(dt=2.5e-3))
    assert abs(again.speed - record["steady"]["speed"]) <= record["steady"]["speed_error_bar"]


PERIODS = {
    "straight": (2, 2),
    "lasting": (2, 2),
    "brisk": (2, 2),
    "fast": (1, 1),
    "swift": (1, 1),
    "gentle": (1, 1),
    "thrifty": (4, 4),
    "cables": (1, 1),
    "left": (2, 2),
    "right": (2, 2),
    "uphill": (3, 2),
    "steep": (2, 1),
}
"""Periods per cycle on exact contact and on penalty contact: after fewer of them shapes differ by millimetres."""


@pytest.mark.campaign
@pytest.mark.parametrize("name", gait_names())
def test_gaits_of_the_library_return_after_as_few_periods_as_there_are(name):
    """On both contact models."""
    record, gait = gait_record(name), load_gait(name)
    own = with_gait(load_scene(record["scene"]), gait)
    found = [find_orbit(scene, max(90.0, shortest_watch(gait))) for scene in (own, contact_twin(own))]
    assert all(orbit.settled for orbit in found)
    assert tuple(orbit.periods for orbit in found) == PERIODS[name]
    assert record["steady"]["periods"] == PERIODS[name][0]


def test_a_gait_comes_back_from_its_file(tmp_path):
    """To the last digit, with start, ramp and overtones."""
    one = np.array([0.1, 0.2, 1 / 3])
    gait = Gait((0, 3, 7), one, one / 2, one + 1, 0.5, 2.0, (Overtone(one, 2 * one), Overtone(one / 7, one)))
    save_json(tmp_path / "gait.json", gait_facts(gait))
    again = load_gait(tmp_path / "gait.json")
    assert again.members == gait.members
    for part in ("phase", "amplitude", "frequency", "start", "ramp"):
        np.testing.assert_array_equal(getattr(again, part), getattr(gait, part))
    for old, new in zip(gait.overtones, again.overtones, strict=True):
        np.testing.assert_array_equal([new.size, new.phase], [old.size, old.phase])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda r: r.pop("phase"), "not a gait: 'phase'; expected what a search leaves"),
        (lambda r: r.update(phase=[0.0]), "phase = \\[0.0\\]: expected 2 finite numbers"),
        (lambda r: r.update(members=["a", "b"]), "not a gait"),
        (lambda r: r.update(start="late"), r"gait\.json: not a gait: could not convert"),
        (lambda r: r.update(scene=5), "scene = 5: expected a text"),
    ],
)
def test_what_is_no_gait_is_refused(tmp_path, change, words):
    """A missing key, a wrong number of phases, members and a start that are no numbers, a scene without a name."""
    record = gait_facts(Gait((0, 1), np.zeros(2), np.full(2, 0.5), np.ones(2)))
    change(record)
    save_json(tmp_path / "gait.json", record)
    with pytest.raises(InputError, match=words):
        load_gait(tmp_path / "gait.json")


def test_unknown_gaits_are_refused(tmp_path):
    """The names that there are stand in the error; a file that is no JSON is named."""
    with pytest.raises(InputError, match=r"gait '': unknown; expected a file, or one of .*lasting"):
        load_gait("")
    with pytest.raises(InputError, match=r"gait 'fly': unknown; expected a file, or one of .*lasting"):
        load_gait("fly")
    (tmp_path / "gait.json").write_text("{")
    with pytest.raises(InputError, match="not JSON"):
        load_gait(tmp_path / "gait.json")


def test_records_are_what_a_search_leaves():
    """Nothing in them is not finite, and no folder of a machine is in them."""
    for name in gait_names():
        text = json.dumps(gait_record(name))
        assert "NaN" not in text
        assert "--out" not in text
