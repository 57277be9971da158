"""Actuators of the tendons of a MuJoCo model: servos that are springs, and forces."""

from typing import Any, NamedTuple

import lazy_loader
import numpy as np

from jaxgrity.formats.foreign import Losses, some_of
from jaxgrity.formats.mjcf_drag import is_drag
from jaxgrity.formats.mjcf_losses import name_of
from jaxgrity.formats.mjcf_members import STRONGEST

mujoco: Any = lazy_loader.load("mujoco")

LAGS = ("INTEGRATOR", "FILTER", "FILTEREXACT")
"""Kinds of actuators whose activation follows their control."""


class Driven(NamedTuple):
    """What an actuator makes of its tendon at the start's control (0 without a keyframe), or the nearest that it may
    have."""

    kind: str
    stiffness: float
    rest_length: float
    damping: float
    change: tuple[float, float]
    """as `Spring` has it"""
    largest: float = np.inf
    """as `Spring` has it"""


class Force(NamedTuple):
    """The force, N, of the actuators of a tendon that does not depend on its length; it pushes where it is positive."""

    low: float
    """that of the control that pulls most"""
    high: float
    now: float
    """that of the start's control"""
    damping: float = 0.0
    """N s/m, beside it"""


def actuators_of(model: Any, data: Any, losses: Losses) -> tuple[dict[int, Driven], dict[int, Force]]:
    """Of each tendon with an actuator that is a spring; and the forces of others.

    Actuators of other kinds than these and drags are lost.
    """
    found: dict[int, Driven] = {}
    forces: dict[int, Force] = {}
    still = []
    for a in range(model.nu):
        if model.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_SITE and is_drag(model, a):
            continue
        tendon, of_tendon = int(model.actuator_trnid[a, 0]), model.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_TENDON
        name = name_of(model, "actuator", a)
        force = _force(model, data, a)
        if force is not None and (of_tendon or not (force.now or force.damping)):
            _beside(model, a, name, losses)
            if of_tendon:
                forces[tendon] = Force(*(x + y for x, y in zip(forces.get(tendon, (0.0,) * 4), force)))
            if not (
                force.now
                or force.damping
                or (of_tendon and -np.inf < force.low < 0 and not model.tendon_stiffness[tendon])
            ):
                still.append(name)
            continue
        spring = _spring(model, data, a)
        if spring is not None and tendon in found:
            spring = in_parallel(found[tendon], spring)
        if spring is None or not (spring.rest_length > 0 or model.tendon_stiffness[tendon]):
            losses.lose("actuators", f"actuator {name}: {_why_not(model, data, a)}")
            continue
        found[tendon] = spring
        _beside(model, a, name, losses)
        _limit_beside(model, data, a, name, losses)
    if still:
        losses.note(f"{len(still)} actuators have no force at the start's controls, and are left out: {some_of(still)}")
    if found:
        losses.note(f"{len(found)} actuators are springs whose rest length their control changes; the gait is not read")
    return found, forces


def _force(model: Any, data: Any, a: int) -> Force | None:
    """The force of an actuator that depends on its control, and on the rate of its length; None for others.

    Forces of tendons that lag behind their controls are such where these are 0 at the start.
    """
    gain, bias, gear = (
        float(each[a, 0]) for each in (model.actuator_gainprm, model.actuator_biasprm, model.actuator_gear)
    )
    affine = model.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_AFFINE and not model.actuator_biasprm[a, 1]
    plain = affine or model.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_NONE
    kind, u = int(model.actuator_dyntype[a]), _input(model, data, a)
    lags = [int(getattr(mujoco.mjtDyn, f"mjDYN_{each}")) for each in LAGS]
    steady = kind == mujoco.mjtDyn.mjDYN_NONE or (kind in lags and not u)
    if model.actuator_gaintype[a] != mujoco.mjtGain.mjGAIN_FIXED or not (plain and steady):
        return None
    damping = -(gear**2) * float(model.actuator_biasprm[a, 2]) if affine else 0.0
    if damping < 0 or (damping and model.actuator_forcelimited[a]):
        return None
    ends = np.array([gain * x if gain else 0.0 for x in (*_controls(model, a), u)]) + (bias if affine else 0.0)
    if model.actuator_forcelimited[a]:
        ends = ends.clip(*model.actuator_forcerange[a])
    ends = gear * ends if gear else 0 * ends[2:].repeat(3)
    return Force(float(ends[:2].min()), float(ends[:2].max()), float(ends[2]) + 0.0, damping)


def _input(model: Any, data: Any, a: int) -> float:
    """The control of an actuator at the start, or its activation where it integrates controls. MuJoCo clips both."""
    if model.actuator_dyntype[a] == mujoco.mjtDyn.mjDYN_INTEGRATOR:
        u = float(data.act[model.actuator_actadr[a]])
    else:
        u = float(data.ctrl[a])
        u = float(np.clip(u, *model.actuator_ctrlrange[a])) if model.actuator_ctrllimited[a] else u
    return float(np.clip(u, *model.actuator_actrange[a])) if model.actuator_actlimited[a] else u


def _why_not(model: Any, data: Any, a: int) -> str:
    """Why an actuator is no spring here, and what may help."""
    servo = model.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_TENDON and model.actuator_biasprm[a, 1] < 0
    if servo and not model.actuator_ctrllimited[a] and not _input(model, data, a):
        return "has the rest length 0 at control 0; expected a ctrlrange above 0, or a keyframe with its control"
    if servo and np.sum(model.actuator_trnid[:, 0] == model.actuator_trnid[a, 0]) > 1:
        return "is one of several servos of its tendon, of which one only pulls"
    if model.actuator_gaintype[a] == mujoco.mjtGain.mjGAIN_FIXED and not model.actuator_biasprm[a, 1:3].any():
        return f"has a force of its own at its control {_input(model, data, a):g}; expected one along a tendon"
    return "no spring of a tendon that has a rest length at its control in the start"


def _spring(model: Any, data: Any, a: int) -> Driven | None:
    """The force gain u + b0 + b1 l + b2 l' as K (L - l) - c l' with K = -b1 and L = (b0 + gain u)/K."""
    gain, bias = model.actuator_gainprm[a], model.actuator_biasprm[a]
    of_tendon = model.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_TENDON and model.actuator_gear[a, 0] == 1
    fixed = model.actuator_gaintype[a] == mujoco.mjtGain.mjGAIN_FIXED
    affine = model.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_AFFINE
    K = float(-bias[1])
    if not (of_tendon and fixed and affine) or K <= 0 or bias[2] > 0:
        return None
    rest = float(bias[0] + gain[0] * _input(model, data, a)) / K
    # a tendon pulls where its force is negative
    least, most = model.actuator_forcerange[a].tolist() if model.actuator_forcelimited[a] else (-np.inf, np.inf)
    largest = -least if most <= 0 and least > -STRONGEST else np.inf
    ends = sorted((float(bias[0]) + (float(gain[0]) * u if gain[0] else 0.0)) / K for u in _controls(model, a))
    change = (ends[0] - rest, ends[1] - rest)
    return Driven("cable" if most <= 0 else "strut", K, rest, float(-bias[2]), change, largest)


def _controls(model: Any, a: int) -> tuple[float, float]:
    """The range of an actuator's control, or of its activation where that is limited."""
    if model.actuator_actlimited[a]:
        return tuple(model.actuator_actrange[a].tolist())
    integrates = model.actuator_dyntype[a] == mujoco.mjtDyn.mjDYN_INTEGRATOR
    limited = model.actuator_ctrllimited[a] and not integrates
    return tuple(model.actuator_ctrlrange[a].tolist()) if limited else (-np.inf, np.inf)


def _beside(model: Any, a: int, name: str, losses: Losses) -> None:
    """What an actuator has beside its force: lags, damping, inertia."""
    lags = [int(getattr(mujoco.mjtDyn, f"mjDYN_{kind}")) for kind in LAGS]
    if int(model.actuator_dyntype[a]) in lags:
        losses.note(f"actuator {name}: lags behind its control there; here a gait's rest lengths are followed at once")
    elif model.actuator_dyntype[a] != mujoco.mjtDyn.mjDYN_NONE:
        losses.lose("actuators", f"actuator {name}: a state of its own")
    if np.any(getattr(model, "actuator_delay", np.zeros(model.nu))[a]):
        losses.note(f"actuator {name}: is late there; here a gait's rest lengths are followed at once")
    for what in ("damping", "armature"):
        if np.any(getattr(model, f"actuator_{what}", np.zeros(model.nu))[a]):
            losses.lose("actuators", f"actuator {name}: {what} of its own")


def _limit_beside(model: Any, data: Any, a: int, name: str, losses: Losses) -> None:
    """The limit of the force of an actuator that is a spring."""
    pulls = model.actuator_forcelimited[a] and model.actuator_forcerange[a, 1] <= 0
    if pulls and model.actuator_biasprm[a, 2] and model.actuator_forcerange[a, 0] > -STRONGEST:
        losses.note(f"actuator {name}: its damping is a part of the force that is limited there, and beside it here")
    if model.actuator_forcelimited[a] and not pulls:
        low, high = model.actuator_forcerange[a]
        force = float(data.actuator_force[a])
        if force <= low or force >= high > 0:
            losses.lose("limits", f"actuator {name}: its force is limited to the {force:g} N of the start")
        elif low > -STRONGEST or high < STRONGEST:
            losses.note(f"actuator {name}: its force is limited to {low:g} to {high:g} N there, and not at all here")


def in_parallel(one: Driven, other: Driven) -> Driven | None:
    """Two springs of a tendon as one, if both push and pull in proportion to the length."""
    if {one.kind, other.kind} != {"strut"}:
        return None
    K = one.stiffness + other.stiffness
    parts = [(each.stiffness / K, each) for each in (one, other)]
    less, more = (sum(share * each.change[k] for share, each in parts) for k in range(2))
    rest = sum(share * each.rest_length for share, each in parts)
    return Driven("strut", K, rest, one.damping + other.damping, (less, more))
