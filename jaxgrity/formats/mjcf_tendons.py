"""Tendons and actuators of a MuJoCo model as members."""

from typing import Any, NamedTuple

import lazy_loader
import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.formats.foreign import LARGEST_NUMBER, Losses, some_of
from jaxgrity.formats.mjcf_drag import is_drag
from jaxgrity.formats.mjcf_losses import name_of, watched
from jaxgrity.model.force_laws import cable_dampers, dead_band, force_limit
from jaxgrity.model.laws import Law
from jaxgrity.model.structure import Members

mujoco: Any = lazy_loader.load("mujoco")


NO_LIMIT = 1e6
"""Limit of an actuator's force, N, beyond which it counts as none: no cable of a robot reaches it."""


class Spring(NamedTuple):
    """A tendon, as a member."""

    name: str
    kind: str
    """strut: it pushes, too; cable: it does not"""
    path: tuple[int, ...]
    """sites, later nodes, over which it slides between the first and the last"""
    stiffness: float
    rest_length: float
    damping: float
    change: tuple[float, float] = (0.0, 0.0)
    """m, from the rest length to the shortest and to the longest that controls make it"""
    dead_band: float = np.inf
    """m, below the rest length, within which a cable is slack; then it pushes"""
    damper: float = 0.0
    """N s/m, of a cable, which acts while it is slack, too"""
    largest: float = np.inf
    """N, at which a cable's motor pays out"""


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


def springs_of(model: Any, data: Any, losses: Losses) -> list[Spring]:
    """Kind, sites, K (N/m), L (m) and c (N s/m) of each spatial tendon that is a spring or has an actuator."""
    if not model.ntendon:
        raise InputError("has no tendons; expected spatial tendons between sites")
    driven, pulled = _actuators(model, data, losses)
    found, idle = [], []
    for t in range(model.ntendon):
        name, path = name_of(model, "tendon", t), _path(model, t)
        K, c = float(model.tendon_stiffness[t]), float(model.tendon_damping[t])
        low, high = model.tendon_lengthspring[t]
        if t in driven:
            kind = "strut" if low == high else "cable"
            own = Driven(kind, K, float(low), 0.0, (0.0, 0.0)) if K else None
            found.append(_servo(name, path, driven[t], own, c))
        elif not K and not c:
            idle.append(name)
        elif not K:
            found.append(Spring(name, "cable", path, 0.0, float(high or data.ten_length[t]), 0.0, damper=c))
        else:
            # a force moves the end of a taut spring as another rest length does
            less, more = (float(max(force / K, -high)) for force in pulled.get(t, (0.0, 0.0)))
            kind = "strut" if low == high else "cable"
            spring = Spring(name, kind, path, K, float(high), c, (less, more))
            found.append(spring if low in (0, high) else pushing_cable(spring, float(high - low)))
    if not any(spring.stiffness for spring in found):
        raise InputError(
            "no tendon has a spring, nor a servo that is one at the start's controls; expected stiffness and "
            "springlength, or a servo with a rest length (position, general)"
        )
    found = _slack_dampers(model, data, found)
    if idle:
        losses.note(f"{len(idle)} tendons without a spring are left out: {some_of(idle)}")
    if any(spring.kind == "cable" and spring.damping for spring in found):
        losses.note("the damping of tendons acts there while they are slack, too; here while they pull")
    return found


def _slack_dampers(model: Any, data: Any, springs: list[Spring]) -> list[Spring]:
    """The springs; cables that go slack while MuJoCo moves the robot have dampers, which act then, as they do there."""
    number = {name_of(model, "tendon", t): t for t in range(model.ntendon)}
    damped = {number[each.name]: each for each in springs if each.kind == "cable" and each.damping}
    rows, rest = [*damped], np.array([each.rest_length for each in damped.values()])
    slack = data.ten_length[rows] < rest
    for moved in watched(data) if damped and not slack.all() else ():
        slack |= moved.ten_length[rows] < rest
    for t, each in [pair for pair, loose in zip(damped.items(), slack) if loose]:
        c = float(model.tendon_damping[t])
        damped[t] = each._replace(damping=max(each.damping - c, 0.0), damper=c)
    return [damped.get(number[each.name], each) for each in springs]


def _servo(name: str, path: tuple[int, ...], servo: Driven, spring: Driven | None, damping: float) -> Spring:
    """A tendon with a servo, and maybe with a spring of its own."""
    both = servo if spring is None else _in_parallel(servo, spring)
    if both is None:
        raise InputError(
            f"tendon {name}: has a spring and a servo, of which one only pulls; expected one of them, or both to push "
            "and pull: one springlength, and no forcerange"
        )
    less, more = (max(x, -both.rest_length) for x in both.change)
    c = both.damping + damping
    return Spring(name, both.kind, path, both.stiffness, both.rest_length, c, (less, more), largest=both.largest)


def _in_parallel(one: Driven, other: Driven) -> Driven | None:
    """Two springs of a tendon as one, if both push and pull in proportion to the length."""
    if {one.kind, other.kind} != {"strut"}:
        return None
    K = one.stiffness + other.stiffness
    parts = [(each.stiffness / K, each) for each in (one, other)]
    less, more = (sum(share * each.change[k] for share, each in parts) for k in range(2))
    rest = sum(share * each.rest_length for share, each in parts)
    return Driven("strut", K, rest, one.damping + other.damping, (less, more))


def pushing_cable(spring: Spring, dead_band: float) -> Spring:
    """A cable in place of a spring that pushes and pulls: it pushes beyond a dead band, m, and is always damped."""
    return spring._replace(kind="cable", dead_band=dead_band, damping=0.0, damper=spring.damping)


def with_dampers_beside(springs: list[Spring]) -> list[Spring]:
    """The springs, without the dampers that run along one of them: these are beside it."""
    alone = {min(each.path, each.path[::-1]): each for each in springs if not each.stiffness}
    found = []
    for each in springs:
        beside = alone.pop(min(each.path, each.path[::-1]), None) if each.stiffness else None
        if beside is not None and each.kind == "cable":
            each = each._replace(damper=each.damper + beside.damper)
        elif beside is not None:
            each = each._replace(damping=each.damping + beside.damper)
        found.append(each)
    return [each for each in found if each.stiffness or each in alone.values()]


def laws_of(springs: list[Spring], cables: Members | None, notes: list[str]) -> tuple[Law, ...]:
    """Of cables whose motors yield, or that push beyond a dead band, and of dampers beside them."""
    if cables is None:
        return ()
    bands, dampers = zip(*((min(each.dead_band, each.rest_length), each.damper) for each in springs))
    if pushing := sum(band < each.rest_length for band, each in zip(bands, springs)):
        notes.append(f"{pushing} tendons are cables that push when they are short, as springs there do")
    if alone := [each.name for each in springs if not each.stiffness]:
        notes.append(f"{len(alone)} tendons without a spring are dampers: {some_of(alone)}")
    largest = [min(each.largest, LARGEST_NUMBER) for each in springs]
    laws: list[Law] = [force_limit(cables, largest)] if min(largest) < LARGEST_NUMBER else []
    laws += [dead_band(cables, bands)] if pushing else []
    return (*laws, cable_dampers(cables, dampers)) if any(dampers) else tuple(laws)


def _path(model: Any, tendon: int) -> tuple[int, ...]:
    first, count = model.tendon_adr[tendon], model.tendon_num[tendon]
    wraps = range(first, first + count)
    if count < 2 or any(model.wrap_type[w] != mujoco.mjtWrap.mjWRAP_SITE for w in wraps):
        name = name_of(model, "tendon", tendon)
        raise InputError(f"tendon {name}: expected two or more sites, without pulleys and geoms between them")
    return tuple(int(model.wrap_objid[w]) for w in wraps)


def _actuators(model: Any, data: Any, losses: Losses) -> tuple[dict[int, Driven], dict[int, tuple[float, float]]]:
    """Of each tendon with an actuator that is a spring; and the range of the force, N, of others, which push.

    Actuators of other kinds than these and drags are lost.
    """
    found: dict[int, Driven] = {}
    pulled: dict[int, tuple[float, float]] = {}
    still = []
    for a in range(model.nu):
        if model.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_SITE and is_drag(model, a):
            continue
        tendon = int(model.actuator_trnid[a, 0])
        name = name_of(model, "actuator", a)
        spring = _spring(model, data, a)
        if _is_still(model, a) and not _input(model, data, a):
            still.append(name)
            if model.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_TENDON:
                low, high = pulled.get(tendon, (0.0, 0.0))
                more = _forces(model, a)
                pulled[tendon] = (low + more[0], high + more[1])
            continue
        if spring is not None and tendon in found:
            spring = _in_parallel(found[tendon], spring)
        if spring is None or not (spring.rest_length > 0 or model.tendon_stiffness[tendon]):
            losses.lose("actuators", f"actuator {name}: {_why_not(model, data, a)}")
            continue
        found[tendon] = spring
        _beside(model, data, a, name, losses)
    if still:
        losses.note(f"{len(still)} actuators have no force at the start's controls, and are left out: {some_of(still)}")
    if found:
        losses.note(f"{len(found)} actuators are springs whose rest length their control changes; the gait is not read")
    return found, pulled


def _is_still(model: Any, a: int) -> bool:
    """Whether an actuator's force is in proportion to its control, and this may be 0."""
    low, high = model.actuator_ctrlrange[a] if model.actuator_ctrllimited[a] else (0.0, 0.0)
    fixed = model.actuator_gaintype[a] == mujoco.mjtGain.mjGAIN_FIXED
    free = model.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_NONE
    lags = [getattr(mujoco.mjtDyn, f"mjDYN_{kind}") for kind in ("NONE", "INTEGRATOR", "FILTER", "FILTEREXACT")]
    return bool(fixed and free and low <= 0 <= high and model.actuator_dyntype[a] in [int(kind) for kind in lags])


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
    if _is_still(model, a):
        return f"has a force of its own at its control {_input(model, data, a):g} in the keyframe"
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
    largest = -least if most <= 0 and least > -NO_LIMIT else np.inf
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


def _forces(model: Any, a: int) -> tuple[float, float]:
    """The range of the force, N, with which an actuator that is still at control 0 pushes along its tendon."""
    gain, gear = float(model.actuator_gainprm[a, 0]), float(model.actuator_gear[a, 0])
    ends = np.array([u * gain if gain else 0.0 for u in _controls(model, a)])
    if model.actuator_forcelimited[a]:
        ends = ends.clip(*model.actuator_forcerange[a])
    low, high = sorted((gear * ends).tolist()) if gear else (0.0, 0.0)
    return low, high


def _beside(model: Any, data: Any, a: int, name: str, losses: Losses) -> None:
    """What an actuator has beside its spring: lags, limits of its force, inertia."""
    lags = [int(getattr(mujoco.mjtDyn, f"mjDYN_{kind}")) for kind in ("INTEGRATOR", "FILTER", "FILTEREXACT")]
    if int(model.actuator_dyntype[a]) in lags:
        losses.note(f"actuator {name}: lags behind its control there; here a gait's rest lengths are followed at once")
    elif model.actuator_dyntype[a] != mujoco.mjtDyn.mjDYN_NONE:
        losses.lose("actuators", f"actuator {name}: a state of its own")
    if np.any(getattr(model, "actuator_delay", np.zeros(model.nu))[a]):
        losses.note(f"actuator {name}: is late there; here a gait's rest lengths are followed at once")
    pulls = model.actuator_forcelimited[a] and model.actuator_forcerange[a, 1] <= 0
    if pulls and model.actuator_biasprm[a, 2] and model.actuator_forcerange[a, 0] > -NO_LIMIT:
        losses.note(f"actuator {name}: its damping is a part of the force that is limited there, and beside it here")
    for what in ("damping", "armature"):
        if np.any(getattr(model, f"actuator_{what}", np.zeros(model.nu))[a]):
            losses.lose("actuators", f"actuator {name}: {what} of its own")
    if model.actuator_forcelimited[a] and not pulls:
        low, high = model.actuator_forcerange[a]
        force = float(data.actuator_force[a])
        if force <= low or force >= high > 0:
            losses.lose("limits", f"actuator {name}: its force is limited to the {force:g} N of the start")
        elif low > -NO_LIMIT or high < NO_LIMIT:
            losses.note(f"actuator {name}: its force is limited to {low:g} to {high:g} N there, and not at all here")
