"""Robots that differ from the model: speeds and bends of made-up motions, the same draws, and what is refused."""

import dataclasses

import jax
import numpy as np
import pytest

import jaxgrity
from jaxgrity.search import motions as module

KNOWN = jaxgrity.Uncertainty()
FRICTION = jaxgrity.Uncertainty(friction=0.3)


def arcs(turns, failure, sway=0.0, frequency=1.0, steep=0.0):
    """Outcomes of robots that go at a tenth of a metre a second along arcs, which turn by so many rad a second.

    They sway by so much, m, at a frequency, Hz, and fall at an angle, rad, towards x.
    """

    def rolled(key, model, gaits, duration, fitness, parts, with_metrics):
        times, turn = np.linspace(0, duration, parts + 1), np.array(turns)[:, None]
        bent = np.where(turn == 0, 1e-9, turn)
        path = 0.1 * np.stack([np.sin(bent * times), 1 - np.cos(bent * times), 0 * bent * times], -1) / bent[..., None]
        path = path + sway * np.sin(2 * np.pi * frequency * times + 1)[:, None]
        path = path * [np.cos(steep), 1, 0] - path[..., :1] * [0, 0, np.sin(steep)]
        failed = np.array(failure)
        path[failed != 0] = np.nan
        rest = {"positions": path[:, -1:], "steps": failed, "rejected": failed}
        return gaits, None, jaxgrity.Outcomes(com_path=path, failure=failed, metrics=None, method="", dt=None, **rest)

    return rolled


@pytest.mark.parametrize("duration", [24.0, 60.0, 300.0])
def test_speeds_are_those_along_paths(exact, monkeypatch, duration):
    """Straight on, on arcs to the left and to the right, of whole circles too; what failed has no speed and no bend."""
    turns = [0.0, 0.5, -0.1, 0.0]
    monkeypatch.setattr(module, "ensembles_rolled_out", arcs(turns, [0, 0, 0, 1]))
    scene = jaxgrity.with_gait(exact, jaxgrity.load_gait("lasting"))
    found = jaxgrity.search.robot_motions(scene, FRICTION, robots=4, duration=duration)
    size = float(jaxgrity.model.body_length(scene))
    np.testing.assert_allclose(found.speed, [0.1, 0.1, 0.1, np.nan], rtol=1e-6)
    np.testing.assert_allclose(found.bend, [0.0, 5.0 * size, -1.0 * size, np.nan], rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(np.hypot(*found.velocity.T)[[0, 3]], [0.1, np.nan], rtol=1e-6)
    _, whole = module.whole_cycles(scene, duration, float(1 / scene.gait.frequency[0]))
    assert duration <= whole < duration + 10.0
    assert found.counted_from == whole / 4
    turned = 0.5 * 0.75 * whole
    np.testing.assert_allclose(np.hypot(*found.velocity[1]), 0.1 * abs(np.sinc(turned / 2 / np.pi)), rtol=1e-5)
    facts = found.summary()
    assert facts["speed"] == pytest.approx(0.1)
    assert facts["bend"] == pytest.approx(0.0, abs=1e-7)
    assert facts["robots"] == 4


def test_a_late_gait_is_watched_in_full_swing(exact, monkeypatch):
    """Time in which the robot stands before its gait begins is no part of its speed."""
    gait = dataclasses.replace(jaxgrity.load_gait("lasting"), start=30.0, ramp=2.0)

    def late(key, model, gaits, duration, fitness, parts, with_metrics):
        gone = 0.1 * np.maximum(np.linspace(0, duration, parts + 1) - 32.0, 0)
        path, none = np.stack([gone, 0 * gone, 0 * gone], -1)[None], np.zeros(1, int)
        rest = {"positions": path[:, -1:], "steps": none, "rejected": none}
        return gaits, None, jaxgrity.Outcomes(com_path=path, failure=none, metrics=None, method="", dt=None, **rest)

    monkeypatch.setattr(module, "ensembles_rolled_out", late)
    found = jaxgrity.search.robot_motions(jaxgrity.with_gait(exact, gait), KNOWN, robots=1)
    np.testing.assert_allclose(found.speed, 0.1, rtol=1e-6)


def test_swaying_is_no_speed_and_a_slope_is_looked_at_along_it(exact, monkeypatch):
    """Of a robot that stays where it is, and of one that goes down a slope, both swaying by a decimetre in a cycle."""
    scene = jaxgrity.with_gait(exact, jaxgrity.load_gait("lasting"))
    frequency = float(scene.gait.frequency[0])
    for cycle in (None, 3 / frequency):
        swaying = arcs([0.0], [0], sway=0.1, frequency=frequency / (1 if cycle is None else 3), steep=0.3)
        monkeypatch.setattr(module, "ensembles_rolled_out", swaying)
        high = dataclasses.replace(scene.structure, nodes=scene.structure.nodes + np.array([0, 0, 1.0]))
        slope = dataclasses.replace(scene, structure=high, ground=dataclasses.replace(scene.ground, incline=0.3))
        found = jaxgrity.search.robot_motions(slope, FRICTION, robots=1, duration=24.0, cycle=cycle)
        np.testing.assert_allclose(found.speed, 0.1, rtol=1e-6)
        np.testing.assert_allclose(found.bend, 0, atol=1e-6)


@pytest.mark.parametrize("swings", [1, 2, 5])
def test_swaying_on_a_circle_is_no_speed(exact, monkeypatch, swings):
    """Towards the centre and away from it, so often in a cycle: at whatever moment of it one looks, by robots that are
    elsewhere in the cycle than others."""
    scene = jaxgrity.with_gait(exact, jaxgrity.load_gait("lasting"))
    cycle, phase = 4 / float(scene.gait.frequency[0]), np.linspace(0, 2 * np.pi, 5)[:, None]

    def rolled(key, model, gaits, duration, fitness, parts, with_metrics):
        times = np.linspace(0, duration, parts + 1)
        radius = 0.5 + 0.05 * np.sin(2 * np.pi * swings * times / cycle + phase)
        path = np.stack([radius * np.cos(0.2 * times), radius * np.sin(0.2 * times), 0 * radius], -1)
        none = np.zeros(5, int)
        rest = {"positions": path[:, -1:], "steps": none, "rejected": none}
        return gaits, None, jaxgrity.Outcomes(com_path=path, failure=none, metrics=None, method="", dt=None, **rest)

    monkeypatch.setattr(module, "ensembles_rolled_out", rolled)
    found = jaxgrity.search.robot_motions(scene, FRICTION, robots=5, duration=60.0, cycle=cycle)
    np.testing.assert_allclose(found.speed, 0.1, rtol=1e-6)
    np.testing.assert_allclose(found.bend, 2.0 * float(jaxgrity.model.body_length(scene)), rtol=1e-6)


def test_robots_that_stay_where_they_are_have_no_bend(exact, monkeypatch):
    """What their paths turn by in a body length is rounding; they are counted, and their speed counts."""
    known, scene = module.path_bend, jaxgrity.with_gait(exact, jaxgrity.load_gait("lasting"))
    monkeypatch.setattr(module, "ensembles_rolled_out", arcs([0.1, 0.0, 0.2, 0.1], [0, 0, 0, 1]))
    monkeypatch.setattr(
        module,
        "_path_bend",
        lambda *given: tuple(np.array(x) * f for x, f in zip(known(*given), ([1, 1e-3, 1, 1], [1, -1e9, 1, 1]))),
    )
    found = jaxgrity.search.robot_motions(scene, FRICTION, robots=4, duration=24.0)
    np.testing.assert_allclose(found.speed, [0.1, 1e-4, 0.1, np.nan], rtol=1e-6)
    np.testing.assert_array_equal(np.isnan(found.bend), [False, True, False, True])
    facts = found.summary()
    assert (facts["stay"], facts["failed"]) == (1, 1)
    assert facts["bend"] == pytest.approx(1.5 * float(jaxgrity.model.body_length(scene)))


def test_all_may_fail(exact, monkeypatch):
    """Then neither their speed nor their bend is known."""
    monkeypatch.setattr(module, "ensembles_rolled_out", arcs([0.1, 0.1], [2, 1]))
    scene = jaxgrity.with_gait(exact, jaxgrity.load_gait("lasting"))
    facts = jaxgrity.search.robot_motions(scene, FRICTION, robots=2, duration=24.0).summary()
    assert (facts["bend"], facts["bend_quartiles"], facts["failed"], facts["robots"]) == (None, [None, None], 2, 2)
    assert np.isnan([facts["speed"], facts["standard_deviation"], facts["displacement"]]).all()


def test_robots_that_failed_do_not_count_as_robots_that_stand(exact, monkeypatch):
    """They are counted, and left out of all means, as in a search's verdict; with them, the mean's error is lost."""
    monkeypatch.setattr(module, "ensembles_rolled_out", arcs([0.1, 0.1, 0.1, 0.1], [0, 0, 1, 0]))
    scene = jaxgrity.with_gait(exact, jaxgrity.load_gait("lasting"))
    found = jaxgrity.search.robot_motions(scene, FRICTION, robots=4, duration=24.0)
    whole, facts = found.speed[0], found.summary()
    np.testing.assert_array_equal(np.isnan(found.speed), [False, False, True, False])
    np.testing.assert_array_equal(np.isnan(found.velocity).any(1), [False, False, True, False])
    assert (facts["failed"], facts["robots"], facts["standard_error"]) == (1, 4, None)
    assert facts["speed"] == pytest.approx(whole)
    assert facts["standard_deviation"] < 1e-6 * whole
    assert 0 < facts["displacement"] <= whole * (1 + 1e-6)


def test_robots_differ_by_what_is_uncertain(swimmer):
    """Where nothing is, one robot says it all; the same seed draws the same robots."""
    options = jaxgrity.SolverOptions(dt=0.01, dtype="float32")
    draw = lambda uncertain, seed: jaxgrity.search.robot_motions(  # noqa: E731
        swimmer, uncertain, robots=4, duration=4.0, seed=seed, options=options
    )
    strokes = jaxgrity.Uncertainty(actuation=0.3)
    first, again, other = draw(strokes, 0), draw(strokes, 0), draw(strokes, 1)
    jax.tree.map(np.testing.assert_array_equal, first, again)
    assert len(set(first.speed)) == 4
    assert not np.array_equal(first.speed, other.speed)
    assert draw(KNOWN, 0).speed.shape == (1,)


@pytest.mark.parametrize(
    ("gait", "bad", "words"),
    [
        (None, {}, "the scene has no gait; expected with_gait"),
        ("lasting", {"robots": 0}, "robots = 0: expected a whole number, at least 1"),
        ("lasting", {"duration": 0.0}, "duration = 0 s: expected a positive number"),
        ("lasting", {"duration": np.nan}, "duration = nan s: expected a positive number"),
        ("lasting", {"seed": -1}, "seed = -1: expected a whole number, at least 0"),
    ],
)
def test_bad_input_is_one_line(exact, gait, bad, words):
    """No gait, no robots, no time."""
    scene = jaxgrity.with_gait(exact, None if gait is None else jaxgrity.load_gait(gait))
    with pytest.raises(jaxgrity.InputError, match=words):
        jaxgrity.search.robot_motions(scene, FRICTION, **bad)
