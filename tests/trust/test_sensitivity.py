"""How strongly the centre of mass depends on the phases, and how far ahead gradients mean something."""

import numpy as np
import pytest

from jaxgrity import (
    ConeFriction,
    ExactGround,
    Members,
    Scene,
    Sensitivity,
    SolverOptions,
    Structure,
    gaits_of,
    sensitivity,
    simulate_population,
)
from jaxgrity.model import rigid_body

OPTIONS = SolverOptions(dt=1e-3)


@pytest.mark.slow
def test_sensitivity_is_the_derivative_of_the_path(reference):
    """Zero until the gait starts, then the norm of d com/d phase, here by central differences."""
    growth = sensitivity(reference, 2.0, options=OPTIONS)
    assert growth.norm[growth.times <= 1.0].max() == 0
    changes = 1e-5 * np.concatenate([np.eye(6), -np.eye(6)])
    gaits = gaits_of(reference.gait, np.asarray(reference.gait.phase) + changes)
    ends = np.asarray(simulate_population(reference, gaits, 2.0, options=OPTIONS).com_end)
    jacobian = (ends[:6] - ends[6:]) / 2e-5
    assert growth.norm[-1] == pytest.approx(np.linalg.norm(jacobian, 2), rel=1e-5)


def test_horizon_is_the_last_time_before_the_bound_is_passed():
    """Also where the norm falls again later, and where it is never passed, or at once."""
    growth = Sensitivity(np.arange(5.0), np.array([0.0, 1.0, 2.0, 9.0, 1.0]))
    assert growth.horizon(2.0) == 2.0
    assert growth.horizon(10.0) == 4.0
    assert growth.horizon(-1.0) == 0.0


def test_supports_are_not_disturbed():
    """A mass on a spring below a support: the sensitivity is that of the mass alone, by its swing and by its drift."""
    members = Members(((0, 1),), [40.0], [1.0])
    scene = Scene(Structure([[0.0, 0, 0], [0, 0, -1.0]], [3.0, 1.0], struts=members, fixed=((0, "xyz"),)))
    found = sensitivity(scene, 1.0, options=SolverOptions("rk4", dt=1e-3))
    np.testing.assert_allclose(found.norm, found.times / 4, rtol=1e-4, atol=1e-6)


@pytest.mark.campaign
def test_points_that_follow_a_body_are_not_disturbed():
    """A free body of four basic points and one that follows: its centre drifts as the basic points' shares of its mass
    say, since impulses within it keep its momentum."""
    nodes = np.array([[0.0, 0, 0], [0.5, 0, 0], [0, 0.4, 0], [0.1, 0.1, 0.2], [0, 0, 0.6]])
    body = rigid_body(nodes, range(5), 2.0, [0.05, 0.05, 0.04])
    scene = Scene(Structure(nodes, np.zeros(5), bodies=(body,)))
    found = sensitivity(scene, 0.2, options=SolverOptions(dt=5e-3))
    shares = np.asarray(body.matrix).sum(0) / 2.0
    np.testing.assert_allclose(found.norm, found.times * np.linalg.norm(shares), rtol=1e-9, atol=1e-12)


@pytest.mark.campaign
def test_random_directions_estimate_the_norm(monkeypatch):
    """Of a body that lands, where each step solves for all impulses at once: thousands of them are as good as all
    derivatives, and what is estimated says so."""
    corners = np.array([[0.0, 0, 0], [0.5, 0, 0], [0, 0.4, 0], [0.1, 0.1, 0.4]])
    body = rigid_body(corners, range(4), 2.0, [0.05, 0.05, 0.04])
    structure = Structure(corners + np.array([0, 0, 0.02]), np.zeros(4), bodies=(body,))
    scene = Scene(structure, gravity=9.81, ground=ExactGround(), friction=ConeFriction(0.5))
    options = SolverOptions(dt=5e-3)
    exact = sensitivity(scene, 0.3, options=options, frame_rate=10.0)
    assert exact.spread == 0
    monkeypatch.setattr("jaxgrity.trust.sensitivity.MOST_VARIED", 11)  # the velocities of four points are twelve
    monkeypatch.setattr("jaxgrity.trust.sensitivity.DIRECTIONS", 3200)
    found = sensitivity(scene, 0.3, options=options, frame_rate=10.0)
    assert found.spread == pytest.approx(1 / 80)
    np.testing.assert_allclose(found.norm, exact.norm, rtol=4 / 80)
    assert found.norm[-1] != exact.norm[-1]
