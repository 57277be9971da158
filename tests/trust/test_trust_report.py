"""One call that says how far a rollout can be trusted."""

import json
from dataclasses import replace

import numpy as np
import pytest

from jaxgrity import InputError, Members, Scene, SolverOptions, Structure, diagnose, energy_audit, simulate
from jaxgrity.io.files import save_json
from jaxgrity.stepping.dynamics import momentum
from jaxgrity.trust import trust_report
from jaxgrity.trust.trust_report import _strut_strain


@pytest.fixture(scope="module")
def roll(reference):
    return diagnose(reference, 2.5)


@pytest.mark.campaign
def test_the_error_bar_covers_the_error(reference, roll):
    """Of the centre of mass, at every frame, against a step 16 times smaller."""
    truth = simulate(reference, 2.5, options=SolverOptions(dt=roll.trajectory.dt / 16))
    off = np.linalg.norm((truth.positions - roll.trajectory.positions).mean(1), axis=1)
    assert np.all(off <= roll.error_bars + 1e-15)
    assert roll.error_bar < 1e-2


def test_the_strain_of_springs_counts_in_every_frame():
    """A strut of 1 kg ends and 1000 N/m whose ends part at 1 m/s: 1 m/s sqrt(m/2k) = 22 mm."""
    nodes = np.array([[0.0, 0, 0], [1.0, 0, 0]])
    scene = Scene(Structure(nodes, [1.0, 1.0], Members(((0, 1),), [1000.0], [1.0])))
    apart = np.array([[-0.5, 0, 0], [0.5, 0, 0]])
    moved = simulate(scene, 0.503, velocities=apart, options=SolverOptions("rk4", dt=2e-3))
    assert _strut_strain(scene, moved) == pytest.approx(np.sqrt(1 / 2000), rel=3e-2)  # frames miss the peak


@pytest.mark.slow
def test_the_summary_says_it_all_and_goes_into_json(roll, tmp_path):
    """Every line of the table has its number; nothing in it is missing or infinite."""
    save_json(tmp_path / "diagnosis.json", roll.summary())
    found = json.loads((tmp_path / "diagnosis.json").read_text())
    assert found["outcome"] == "succeeded"
    assert 0 < found["penetration"] < 0.02
    assert 0 < found["strut_strain"] < 0.05
    assert found["energy"]["residual"] < 1e-3 * found["energy"]["turned_over"]
    assert found["momentum_residual"] < 1e-10
    assert found["sensitivity"] > 0
    assert 1.0 < found["predictable_up_to"] <= 2.5
    for line in ("error bar", "energy residual", "momentum residual", "penetration", "strut strain", "predictable"):
        assert line in roll.table()
    works = [np.full_like(roll.audit.actuation, work) for work in (-2.0, 2.0)]
    signed = [roll._replace(audit=roll.audit._replace(actuation=work)).table() for work in works]
    assert "-2 J (negative: members did work on them), kinetic" in signed[0]
    assert "actuators 2 J, kinetic" in signed[1]
    assert "random directions" not in roll.table()
    estimated = roll._replace(sensitivity=roll.sensitivity._replace(spread=0.125))
    assert " m/rad (estimated by random directions, standard deviation 12%), growing" in estimated.table()
    assert estimated.summary()["sensitivity_spread"] == 0.125


@pytest.fixture(scope="module")
def falling():
    """Two nodes, without a gait: the scene, and its diagnosis in float64."""
    scene = Scene(Structure(np.array([[0.1, 0.2, 1.0], [1.3, 0, 1.1]]), np.array([1.0, 3.0])), gravity=9.81)
    return scene, diagnose(scene, 0.3, options=SolverOptions(dt=1e-3))


@pytest.mark.campaign
def test_float32_is_held_against_float64(falling):
    """The bar of a rollout in float32 includes its rounding."""
    scene, double = falling
    single = diagnose(scene, 0.3, options=SolverOptions(dt=1e-3, dtype="float32"))
    assert single.error_bar > 1e-8
    assert double.error_bar < 1e-12


@pytest.mark.slow
def test_a_rollout_without_a_gait_is_asked_for_its_start(falling):
    """Two free nodes: d com / d v0 = t times the share of each in the mass."""
    _, found = falling
    assert found.sensitivity.unit == "m/(m/s)"
    expected = np.hypot(1 / 4, 3 / 4) * np.asarray(found.sensitivity.times)
    np.testing.assert_allclose(found.sensitivity.norm, expected, atol=1e-9)
    assert found.sensitivity.times[-1] == pytest.approx(0.3)


@pytest.mark.slow
def test_a_motion_that_was_made_is_not_made_again(falling, monkeypatch):
    """The report is the same, from rollouts at smaller steps alone; a motion of other arguments is refused."""
    scene, found = falling
    options, steps = SolverOptions(dt=1e-3), []

    def counted(*given, options, **how):
        steps.append(float(options.dt))
        return simulate(*given, options=options, **how)

    monkeypatch.setattr(trust_report, "simulate", counted)
    motion = simulate(scene, 0.3, options=options)
    again = diagnose(scene, 0.3, options=options, motion=motion)
    assert (again.trajectory is motion, steps) == (True, [5e-4, 2.5e-4])
    assert again.summary() == found.summary()
    thrown = simulate(scene, 0.3, options=options, velocities=np.ones((2, 3)))
    others = {
        "times": motion,
        "dt": simulate(scene, 0.2, options=SolverOptions(dt=5e-4)),
        "scene": replace(motion, scene=None),
        "start": thrown,
    }
    for what, other in others.items():
        with pytest.raises(InputError, match=f"motion: it has another {what}; expected"):
            diagnose(scene, 0.3 if other is thrown else 0.2, options=options, motion=other)


@pytest.mark.slow
def test_a_failed_rollout_is_diagnosed_as_one(reference):
    """An infinite bar, no audit, and the reason."""
    torn = diagnose(reference, 0.5, options=SolverOptions(dt=0.1, any_step=True))
    assert torn.error_bar == np.inf
    assert torn.audit is None
    assert torn.horizon < 0.5
    assert torn.summary()["outcome"] != "succeeded"
    table = torn.table()
    assert "error bar of the centre of mass  not known, since a rollout failed" in table
    assert "inf" not in table


@pytest.mark.slow
def test_exact_contact_is_diagnosed_too(exact):
    """Nothing penetrates, struts keep their lengths, and the balance includes impacts."""
    found = diagnose(exact, 2.0).summary()
    assert found["penetration"] < 1e-12
    assert found["strut_strain"] < 1e-6
    assert set(found["energy"]["dissipated"]) == {"nodes", "cables", "impacts", "friction", "stepping"}


@pytest.mark.campaign
@pytest.mark.parametrize("name", ["exact", "reference"])
def test_members_exert_no_net_force(request, name):
    """Where nothing acts from outside, the momentum residual is the momentum, and that stays zero."""
    scene = request.getfixturevalue(name)
    floating, options = Scene(scene.structure, gait=scene.gait), SolverOptions(dt=1e-3, any_step=True)
    assert energy_audit(floating, 2.0, options=options).momentum_residual.max() < 1e-10
    end = momentum(floating, simulate(floating, 2.0, options=options).velocities[-1])
    assert np.abs(end).max() < 1e-10


@pytest.mark.slow
def test_rollouts_by_verlet_are_balanced():
    """Two nodes on an undamped strut: energy stays to second order of the step."""
    strut = Members(((0, 1),), np.array([100.0]), np.array([0.8]))
    scene = Scene(Structure(np.array([[0.0, 0, 0], [1.0, 0, 0]]), np.ones(2), strut))
    coarse, fine = (
        np.abs(energy_audit(scene, 2.0, options=SolverOptions(method="verlet", dt=h)).residual).max()
        for h in (2e-2, 1e-2)
    )
    assert 3.5 < coarse / fine < 4.5
