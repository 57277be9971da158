"""The energy balance of rollouts: closed to the error of the steps, with every part in its place."""

import equinox as eqx
import numpy as np
import pytest

from jaxgrity import Gait, Scene, SolverOptions, SwitchFriction, energy_audit, with_gait


def at_step(dt: float) -> SolverOptions:
    """Without the check whether the step is stable, which would compile a linearisation of every scene here."""
    return SolverOptions(dt=dt, any_step=True)


@pytest.fixture(scope="module")
def roll(reference):
    """Three seconds of the reference scene, two of them with its gait, at the step that the balance is judged at."""
    return energy_audit(reference, 3.0, options=at_step(1e-4))


@pytest.mark.slow
def test_the_balance_closes(roll):
    """To 1e-6 of the energy turned over, by RK4 at 1e-4 s with smooth friction, in every frame of drop, settling and
    roll, those at the ends of the gait's ramp included."""
    assert np.abs(roll.residual).max() < 1e-6 * roll.turned_over
    assert roll.turned_over > 10


@pytest.mark.slow
def test_every_part_has_its_place(roll):
    """All five causes take energy out and never put any in; the actuators work only once the gait has begun."""
    assert set(roll.dissipated) == {"nodes", "struts", "cables", "contact", "friction"}
    for cause, lost in roll.dissipated.items():
        assert lost[-1] > 1e-4, cause
        assert np.diff(lost).min() > -1e-9, cause
    assert np.all(roll.actuation[roll.times < 0.995] == 0)
    assert np.ptp(roll.actuation) > 1


@pytest.mark.slow
def test_the_residual_is_an_error_of_the_steps(reference):
    """It falls by far more than the step does: the forces of a drop have corners and jumps, but no more.

    In as many frames as the roll, whose program it shares; its gait has not begun.
    """
    coarse, fine = (energy_audit(reference, 0.5, options=at_step(dt), frame_rate=600.0) for dt in (8e-4, 1e-4))
    assert len(fine.times) == 301
    assert np.abs(fine.residual).max() < np.abs(coarse.residual).max() / 8
    assert np.all(fine.actuation == 0)


@pytest.mark.campaign
@pytest.mark.parametrize("method", ["rk4", "tsit5", "dopri8", "kvaerno5"])
def test_a_gait_that_begins_at_once_is_balanced(reference, method):
    """dU/dt jumps at t = 0, and the balance knows it, by every method that takes further equations."""
    flying = Scene(reference.structure, gait=eqx.tree_at(lambda g: g.start, reference.gait, np.asarray(0.0)))
    audit = energy_audit(flying, 0.2, options=SolverOptions(method=method, dt=2e-4, any_step=True))
    assert np.abs(audit.residual).max() < 1e-6 * audit.turned_over


@pytest.mark.slow
def test_a_motion_that_fails_is_said_to(reference):
    """With the moment from which numbers mean nothing; those before it are finite."""
    with pytest.warns(UserWarning, match="energy_audit: .* at .* s; numbers from then on mean nothing") as told:
        audit = energy_audit(reference, 0.5, options=at_step(0.1))
    when = next(
        float(str(w.message).split(" at ")[1].split(" s;")[0]) for w in told if "energy_audit" in str(w.message)
    )
    first = int(np.argmin(np.abs(audit.times - when)))
    assert 0 < first < len(audit.times)
    assert np.isfinite(audit.residual[:first]).all()


@pytest.mark.campaign
def test_a_conservative_scene_loses_nothing(reference):
    """Without damping, friction and gait there is no cause, and energy stays."""
    bare = with_gait(reference, None)
    bare = eqx.tree_at(
        lambda s: (
            s.friction, s.node_damping, s.ground.dissipation, s.structure.struts.damping, s.structure.cables.damping
        ),
        bare,
        (None,) * 5,
    )  # fmt: skip
    audit = energy_audit(bare, 0.5, options=at_step(5e-5))
    assert audit.dissipated == {}
    assert np.abs(audit.residual).max() < 1e-6 * audit.turned_over


@pytest.mark.campaign
def test_the_switch_is_in_the_balance(reference):
    """A force law without a dissipation function is audited by its power."""
    switch = SwitchFriction(0.5, 0.4, 1e-3)
    scene = eqx.tree_at(lambda s: s.friction, with_gait(reference, None), switch)
    audit = energy_audit(scene, 0.5, options=at_step(1e-4))
    assert audit.dissipated["friction"][-1] > 1e-3
    assert np.abs(audit.residual).max() < 1e-3 * audit.turned_over


@pytest.fixture(scope="module")
def exact_rolls(exact):
    """Three seconds of the scene with exact contact, coarse and fine."""
    return [energy_audit(exact, 3.0, options=at_step(dt), frame_rate=50 / 3) for dt in (4e-3, 1e-3)]


@pytest.mark.slow
def test_exact_contact_is_balanced_to_second_order(exact, exact_rolls):
    """Impacts, friction and the work of rigid struts included: on a drop, before the gait begins, and on a roll.

    Both have as many frames, and share a program.
    """
    drops = [energy_audit(exact, 0.5, options=at_step(dt)) for dt in (4e-3, 1e-3)]
    assert {len(audit.times) for audit in (*drops, *exact_rolls)} == {51}
    for audits in (drops, exact_rolls):
        residuals = []
        for audit in audits:
            residuals.append(np.abs(audit.residual).max() / audit.turned_over)
            for cause in ("impacts", "friction", "cables", "nodes"):
                assert audit.dissipated[cause][-1] > 0.05, cause
        assert residuals[0] < 1e-2
        assert residuals[1] < residuals[0] / 8


@pytest.mark.slow
def test_momentum_is_what_the_ground_and_gravity_give(roll, exact_rolls):
    """Members exert no net force and no net moment; what the balance lacks is rounding, or falls with the step."""
    assert roll.momentum_residual.max() < 1e-11
    assert roll.angular_residual.max() < 1e-6
    coarse, fine = (audit.momentum_residual.max() for audit in exact_rolls)
    assert fine < coarse / 3
    assert fine < 1e-3


def on_cables(exact, start: float):
    """The exact scene, its cables actuated from `start` (s) on, most of them not at an end of their strokes."""
    phases = 2 * np.pi * np.arange(24) / 24
    return with_gait(exact, Gait(tuple(range(6, 30)), phases, np.full(24, 0.15), np.full(24, 0.5), start, ramp=0.5))


@pytest.mark.campaign
def test_actuated_cables_are_balanced_wherever_in_a_step_their_gait_begins(exact):
    """On a step's end or half way between two: dU/dt jumps as the ramp begins, within the time that one step is for."""
    dt = 5e-3
    at_a_step, between = (
        energy_audit(on_cables(exact, start), 1.0, options=at_step(dt)) for start in (0.5, 0.5 + dt / 2)
    )
    assert min(np.ptp(audit.actuation) for audit in (at_a_step, between)) > 1
    for audit in (at_a_step, between):
        assert np.abs(audit.residual).max() < 5e-3
    assert np.abs(at_a_step.residual).max() < 3 * np.abs(between.residual).max()
