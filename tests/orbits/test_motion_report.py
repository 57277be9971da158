"""What a rollout comes to in words: standing, fallen over, rolling; settled, and when. Motions made by hand."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrity import Trajectory, load_gait, load_scene, simulate, with_gait
from jaxgrity.cli.simulate import conclusion
from jaxgrity.orbits.motion_report import motion_report

TIMES = np.linspace(0, 10, 501)
PERIOD = 2.0
"""s, of the gait of the scene "exact" """


def motion(positions, times=TIMES):
    q = np.asarray(positions, float)
    return Trajectory(times, q, np.gradient(q, times, axis=0), jnp.array(0), jnp.array(1), jnp.array(0), "made", None)


def turned(q, angle):
    """About a level axis through the lowest nodes' middle, m; set down on the ground again."""
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    q = q @ turn.T
    return q - [0, 0, q[:, 2].min()]


@pytest.fixture(scope="module")
def still(exact):
    """The robot without a gait, and its nodes as they stand."""
    return dataclasses.replace(exact, gait=None), turned(np.asarray(exact.structure.nodes), 0.0)


def test_a_robot_that_does_not_move_stands(still):
    """From the start on."""
    scene, q = still
    found = motion_report(scene, motion(np.tile(q, (501, 1, 1))))
    assert (found.kind, found.settled_after, found.periods) == ("stands", 0.0, 0)
    assert found.sentence() == "the robot stands; it is at rest after 0 s"


def test_a_robot_that_slides_on_is_not_at_rest(still):
    """Its shape stays as it is, and its place does not."""
    scene, q = still
    found = motion_report(scene, motion(q + TIMES[:, None, None] * [1.0, 0.0, 0.0]))
    assert (found.kind, found.settled_after) == ("slides", np.inf)


def test_a_robot_that_tips_once_fell_over(still):
    """Within a second, to another face; at rest since then. Later than half of the time it has not settled."""
    scene, q = still
    for begin, settled in ((1.0, True), (8.0, False)):
        angle = np.clip(TIMES - begin, 0, 1) * 1.2
        found = motion_report(scene, motion([turned(q, a) for a in angle]))
        assert np.isfinite(found.settled_after) == settled
        if settled:
            assert found.kind == "fell over"
            assert 1.5 < found.settled_after <= 2.0
        else:
            assert "has not settled after 10 s" in found.sentence()


def test_a_motion_that_repeats_after_two_periods_has_settled(exact):
    """It rolls on along x, with a shape that changes for some seconds more than it later does."""
    q = turned(np.asarray(exact.structure.nodes), 0.0)
    times = np.linspace(0, 24, 1201)
    once = [turned(q, np.pi / 2 * t / PERIOD) for t in times]
    swing = 1 + 0.1 * np.sin(np.pi * times / PERIOD) + 0.5 * np.clip(5 - times, 0, 1)
    path = np.stack([0.3 * times, 0 * times, 0 * times], 1)
    found = motion_report(exact, motion(np.array(once) * swing[:, None, None] + path[:, None], times))
    assert found.kind == "rolls"
    assert found.periods == 4  # a full turn
    assert 4.5 < found.settled_after < 5.0  # it still differs by less than a tenth of a body length
    assert found.sentence() == "the robot rolls; its motion has settled after 4.8 s, and repeats every 4 periods"
    short = motion_report(exact, motion((np.array(once) * swing[:, None, None] + path[:, None])[:401], times[:401]))
    assert not np.isfinite(short.settled_after)
    assert short.summary()["settled_after"] is None


def test_a_motion_that_ends_before_the_gait_is_in_full_swing_has_not_settled(exact):
    """Its gait is in full swing after 2 s."""
    times = TIMES[:80]
    found = motion_report(exact, motion(np.tile(np.asarray(exact.structure.nodes), (len(times), 1, 1)), times))
    assert (found.settled_after, found.periods) == (np.inf, 0)


def test_there_is_no_report_where_nothing_can_be_said(exact):
    """Of failed motions, and without ground."""
    q = np.tile(np.asarray(exact.structure.nodes), (501, 1, 1))
    failed = dataclasses.replace(motion(q), failure=jnp.array(1))
    assert motion_report(exact, failed) is None
    assert motion_report(dataclasses.replace(exact, ground=None, friction=None, gait=None), motion(q)) is None


def test_a_distance_that_means_nothing_is_said_to(still):
    """First of all, where the error bar is larger than the distance, or there is none; of a robot that stays, too."""
    scene, q = still
    stands = motion_report(scene, motion(np.tile(q, (501, 1, 1))))
    assert conclusion(2.07, 27.0, stands).startswith(
        "how far the robot moved is not known: 2.07 m at this time step, with an error bar of 27 m; take a smaller step"
    )
    assert conclusion(2.86e-16, 8e-16, None, True).startswith("moved less than a hundredth")
    assert conclusion(2.07, np.inf, None).startswith("do not trust the distance, since its error bar is unknown: moved")
    assert conclusion(2.07, 0.01, stands) == "moved 2.070 ± 0.01 m\nthe robot stands; it is at rest after 0 s"
    assert conclusion(2.07, None, None) == "moved 2.0700 m"
    assert conclusion(np.nan, np.inf, None) == "no distance: the simulation failed"


@pytest.mark.slow
def test_the_gait_that_is_shown_settles_while_one_looks():
    """In the 10 s of `simulate` it rolls, and settles; `lasting` does not if it starts at another phase of its wave."""
    scene, late = load_scene("exact"), dataclasses.replace(load_gait("lasting"), start=1.0, ramp=1.0)
    for gait, settles in ((load_gait("straight"), True), (load_gait("lasting"), True), (late, False)):
        moved = with_gait(scene, gait)
        found = motion_report(moved, simulate(moved, 10.0))
        assert np.isfinite(found.settled_after) == settles
        assert found.kind == "rolls"
