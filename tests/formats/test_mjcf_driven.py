"""Models that are written for MuJoCo, driven by a gait on the ground: what is written moves as here."""

import pytest
from studies.driven_in_mujoco import CAPPED, ROBOTS, at_rest, compared, in_the_air

pytest.importorskip("mujoco")


@pytest.mark.campaign
@pytest.mark.parametrize("robot", ROBOTS)
def test_both_agree_within_their_errors_if_contact_is_the_same(robot):
    """Two seconds on ground without friction, by the scene's spring in both: within the errors of their steps.

    MuJoCo's own contact is another law: docs/conformance.md says how far apart robots are then.
    """
    found = compared(robot, "the same", 2.0)
    assert found["moved"] > 0.03
    assert max(found["ours"], found["theirs"]) < 0.01 * found["moved"]
    assert found["apart"] < 1.2 * (found["ours"] + found["theirs"])


@pytest.mark.campaign
@pytest.mark.parametrize("robot", CAPPED)
def test_robots_with_end_caps_fly_and_settle_alike(robot):
    """After 0.5 s in the air within 1e-6 m; at rest, mean heights differ by no more than MuJoCo's balls sink in."""
    flown, rested = in_the_air(robot), at_rest(robot)
    assert flown["changed"] > 2e-3
    assert flown["flight"] < 1e-6
    assert 0 < rested["height"] - rested["their_height"] < 1.01 * rested["depth"]
    assert rested["depth"] < 2e-3 * rested["height"]
