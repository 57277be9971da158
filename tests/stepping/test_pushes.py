"""Pushes shorter than a step: exact contact gives them their whole impulse, other methods take steps that see them."""

import dataclasses

import numpy as np
import pytest

from jaxgrity import (
    ExactGround,
    InputError,
    Members,
    Push,
    Scene,
    SolverOptions,
    Structure,
    energy_audit,
    rollout,
    simulate,
    with_terms,
)
from jaxgrity.stepping import resolve
from jaxgrity.trust.error_bars import timing_bar

FORCE, START = 50.0, 0.0503


def pushed(duration: float, exact: bool = True, start: float = START) -> Scene:
    """A mass of 1 kg on ice, or one of two on a slack cable."""
    push = Push((0,), [[FORCE, 0.0, 0.0]], start, duration, duration / 4)
    if exact:
        return with_terms(Scene(Structure([[0.0, 0, 0]], [1.0]), gravity=9.81, ground=ExactGround()), push)
    cable = Members(((0, 1),), [1.0], [9.0])
    return with_terms(Scene(Structure([[0.0, 0, 0], [1.0, 0, 0]], [1.0, 1.0], cables=cable)), push)


@pytest.mark.parametrize("start", [0.0, START, 0.0999])
def test_an_impulse_is_right_at_any_step(start):
    """F times (duration - ramp), where the push lies in one step, across two, and where the motion starts with it."""
    for duration in (1e-3, 4e-3, 3e-2):
        motion = simulate(pushed(duration, start=start), 0.2, options=SolverOptions(dt=1e-2), frame_rate=10.0)
        np.testing.assert_allclose(motion.velocities[-1, 0, 0], FORCE * 0.75 * duration, rtol=1e-12)


@pytest.mark.parametrize("start", [START, 0.0999])
def test_error_bars_know_when_steps_are_longer_than_a_push(start):
    """All of them may give it at the same time, so that none of them differs: the bar covers the way that it is off."""
    for duration in (1e-3, 4e-3):
        scene, options = pushed(duration, start=start), SolverOptions(dt=1e-2)
        motion = simulate(scene, 0.2, options=options, frame_rate=10.0)
        way = FORCE * 0.75 * duration * (0.2 - start - duration / 2)
        off = abs(float(motion.positions[-1, 0, 0]) - way)
        assert 0 < off <= timing_bar(scene, resolve(scene, 0.2, options))
    assert timing_bar(pushed(5e-2), resolve(scene, 0.2, options)) == 0


def test_pieces_share_a_push_between_them():
    """It lies across the end of the first: each gives its part, and the audit has all of its work."""
    scene = pushed(4e-3, start=0.098)
    options = resolve(scene, 0.2, SolverOptions(dt=1e-2))
    half = rollout(scene, np.array([0.0, 0.1]), options=options)
    rest = rollout(scene, np.array([0.1, 0.2]), start=(half.positions[-1], half.velocities[-1]), options=options)
    whole = rollout(scene, np.array([0.0, 0.2]), options=options)
    np.testing.assert_allclose(half.velocities[-1, 0, 0], FORCE * 0.75 * 4e-3 / 2, rtol=1e-12)
    np.testing.assert_allclose(rest.positions[-1], whole.positions[-1], rtol=1e-12)
    audit = energy_audit(scene, 0.2, options=options)
    np.testing.assert_allclose(audit.dissipated["push"][-1], -((FORCE * 3e-3) ** 2) / 2, rtol=1e-9)
    assert np.abs(audit.residual).max() < 1e-12


@pytest.mark.parametrize("method", ["rk4", pytest.param("tsit5", marks=pytest.mark.campaign)])
def test_other_methods_take_steps_that_see_it(method):
    """By default; a step that is given and would lose it is refused."""
    scene = pushed(1e-3, exact=False)
    motion = simulate(scene, 0.1, options=SolverOptions(method), frame_rate=10.0)
    np.testing.assert_allclose(motion.velocities[-1, 0, 0], FORCE * 0.75e-3, rtol=1e-4)
    with pytest.raises(InputError, match=r"dt = 0\.005 s: a push or .* expected at most 0\.00025 s"):
        resolve(scene, 0.1, SolverOptions(method, dt=5e-3))
    resolve(scene, 0.1, dataclasses.replace(SolverOptions(method, dt=5e-3), any_step=True))
