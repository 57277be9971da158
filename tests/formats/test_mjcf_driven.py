"""Models that are written for MuJoCo, driven by a gait on the ground: what is written moves as here."""

import pytest
from studies.driven_in_mujoco import ROBOTS, compared

pytest.importorskip("mujoco")


@pytest.mark.campaign
@pytest.mark.parametrize("robot", ROBOTS)
def test_both_agree_within_their_errors_if_contact_is_the_same(robot):
    """Two seconds on ground without friction, by the scene's spring in both: within twice the errors of their steps.

    MuJoCo's own contact is another law: docs/conformance.md says how far apart robots are then.
    """
    found = compared(robot, "the same", 2.0)
    assert found["moved"] > 0.1
    assert max(found["ours"], found["theirs"]) < 0.01 * found["moved"]
    assert found["apart"] < 2 * (found["ours"] + found["theirs"])
