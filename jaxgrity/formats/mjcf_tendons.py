"""Tendons and actuators of a MuJoCo model as members."""

from typing import Any, NamedTuple

import lazy_loader
import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.formats.foreign import LARGEST_NUMBER, Losses, some_of
from jaxgrity.formats.mjcf_actuators import Driven, Force, actuators_of, in_parallel
from jaxgrity.formats.mjcf_losses import name_of, watched
from jaxgrity.model.force_laws import cable_dampers, dead_band, force_limit
from jaxgrity.model.laws import Law
from jaxgrity.model.pulls import commanded_pull
from jaxgrity.model.stiffening import polynomial_stiffness
from jaxgrity.model.structure import Members

mujoco: Any = lazy_loader.load("mujoco")


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
    bends: tuple[float, float] = (0.0, 0.0)
    """1/m and 1/m^2, of a cable that pulls with K x (1 + a x + b x^2) at the stretch x"""
    damper: float = 0.0
    """N s/m, of a cable, which acts while it is slack, too"""
    largest: float = np.inf
    """N, at which a cable's motor pays out"""
    pull: float = 0.0
    """N, of a cable, whatever its length"""
    reach: float = 0.0
    """N, by which controls can raise the pull of a cable without a spring"""

    @property
    def acts(self) -> bool:
        """Whether it is more than a damper."""
        return bool(self.stiffness or self.pull or self.reach)


def springs_of(model: Any, data: Any, losses: Losses) -> list[Spring]:
    """Kind, sites, K (N/m), L (m) and c (N s/m) of each spatial tendon that is a spring or has an actuator."""
    if not model.ntendon:
        raise InputError("has no tendons; expected spatial tendons between sites")
    driven, forces = actuators_of(model, data, losses)
    found, idle = [], []
    for t in range(model.ntendon):
        name, path = name_of(model, "tendon", t), _path(model, t)
        K, c = float(model.tendon_stiffness[t]), float(model.tendon_damping[t])
        low, high = model.tendon_lengthspring[t]
        if t in driven:
            kind = "strut" if low == high else "cable"
            own = Driven(kind, K, float(low), 0.0, (0.0, 0.0)) if K else None
            spring = _servo(name, path, driven[t], own, c)
        elif not K:
            spring = Spring(name, "cable", path, 0.0, float(high or data.ten_length[t]), 0.0, damper=c)
        else:
            spring = Spring(name, "strut" if low == high else "cable", path, K, float(high), c)
            spring = spring if low in (0, high) else pushing_cable(spring, float(high - low))
        spring = spring._replace(bends=_bends(model, t, spring, t in driven or t in forces, losses))
        spring = _with_force(spring, forces[t], losses) if t in forces else spring
        if spring.acts or spring.damper:
            found.append(spring)
        else:
            idle.append(name)
    if not any(spring.acts for spring in found):
        raise InputError(
            "no tendon has a spring, nor an actuator that is one or pulls; expected stiffness and springlength, "
            "a servo with a rest length at the start's controls (position, general), or a motor with a ctrlrange"
        )
    found = _slack_dampers(model, data, found)
    if idle:
        losses.note(f"{len(idle)} tendons without a spring are left out: {some_of(idle)}")
    if any(spring.kind == "cable" and spring.damping for spring in found):
        losses.note("the damping of tendons acts there while they are slack, too; here while they pull")
    return found


def _bends(model: Any, t: int, spring: Spring, actuated: bool, losses: Losses) -> tuple[float, float]:
    """The terms of higher order of a tendon's spring, as shares of its stiffness. Loses those that no cable has."""
    higher = np.zeros(2) if not hasattr(model, "tendon_stiffnesspoly") else model.tendon_stiffnesspoly[t]
    if not np.any(higher):
        return 0.0, 0.0
    alone = spring.kind == "cable" and spring.stiffness > 0 and not actuated and not np.isfinite(spring.dead_band)
    if alone and len(higher) == 2 and higher.min() >= 0:
        return float(higher[0] / spring.stiffness), float(higher[1] / spring.stiffness)
    what = "a spring that is not linear, and pushes, softens, has no first term or an actuator"
    losses.lose("forces", f"tendon {spring.name}: {what}")
    return 0.0, 0.0


def _with_force(spring: Spring, force: Force, losses: Losses) -> Spring:
    """A tendon with forces that do not depend on its length.

    They move the end of a spring that is taut, or pushes too, as another rest length does.
    """
    K, pull, c = spring.stiffness, max(0.0, -force.now), force.damping
    if c and spring.kind == "strut":
        spring = spring._replace(damping=spring.damping + c)
    elif c:
        spring = spring._replace(damper=spring.damper + c)
    less, more = force.low - force.now, force.high - force.now
    if spring.kind == "strut":
        rest = spring.rest_length + force.now / K
        if rest > 0:
            spring = spring._replace(rest_length=rest)
        else:
            losses.lose("actuators", f"tendon {spring.name}: its actuators pull more than its spring can push")
    elif force.now > 0:
        losses.lose("actuators", f"tendon {spring.name}: its actuators push with {force.now:g} N; a cable only pulls")
    else:
        spring = spring._replace(pull=pull)
    if K:
        least, (short, long) = -spring.rest_length, spring.change
        return spring._replace(change=(float(max(short + less / K, least)), float(max(long + more / K, least))))
    spring = spring._replace(reach=-less if np.isfinite(less) else pull)
    if spring.acts and force.high > 0:
        losses.note(f"tendon {spring.name}: some controls push there; here it is a cable, which only pulls")
    return spring


def _slack_dampers(model: Any, data: Any, springs: list[Spring]) -> list[Spring]:
    """The springs; cables that go slack while MuJoCo moves the robot have dampers, which act then, as they do there."""
    damped = {each.name: each for each in springs if each.kind == "cable" and each.damping}
    number = _numbers(model)
    for name in slack(model, data, {name: each.rest_length for name, each in damped.items()}):
        each, c = damped[name], float(model.tendon_damping[number[name]])
        damped[name] = each._replace(damping=max(each.damping - c, 0.0), damper=each.damper + c)
    return [damped.get(each.name, each) for each in springs]


def _numbers(model: Any) -> dict[str, int]:
    """The number of each tendon, by the name that notes give it."""
    return {name_of(model, "tendon", t): t for t in range(model.ntendon)}


def slack(model: Any, data: Any, rest_length: dict[str, float]) -> set[str]:
    """The tendons that are shorter than these rest lengths, m, at the start, or while MuJoCo moves the robot."""
    number = _numbers(model)
    rows, rest = [number[name] for name in rest_length], np.array([*rest_length.values()])
    short = data.ten_length[rows] < rest
    for moved in watched(data) if len(rows) and not short.all() else ():
        short |= moved.ten_length[rows] < rest
    return {name for name, loose in zip(rest_length, short) if loose}


def _servo(name: str, path: tuple[int, ...], servo: Driven, spring: Driven | None, damping: float) -> Spring:
    """A tendon with a servo, and maybe with a spring of its own."""
    both = servo if spring is None else in_parallel(servo, spring)
    if both is None:
        raise InputError(
            f"tendon {name}: has a spring and a servo, of which one only pulls; expected one of them, or both to push "
            "and pull: one springlength, and no forcerange"
        )
    less, more = (max(x, -both.rest_length) for x in both.change)
    c = both.damping + damping
    return Spring(name, both.kind, path, both.stiffness, both.rest_length, c, (less, more), largest=both.largest)


def pushing_cable(spring: Spring, dead_band: float) -> Spring:
    """A cable in place of a spring that pushes and pulls: it pushes beyond a dead band, m, and is always damped."""
    return spring._replace(kind="cable", dead_band=dead_band, damping=0.0, damper=spring.damping)


def with_others_beside(springs: list[Spring]) -> list[Spring]:
    """The springs, without the dampers and forces that run along another one: these are beside it."""
    along: dict[tuple[int, ...], list[Spring]] = {}
    for each in sorted(springs, key=lambda each: not each.stiffness):
        along.setdefault(min(each.path, each.path[::-1]), []).append(each)
    kept, beside = dict[str, Spring](), set[str]()
    for first, *others in along.values():
        for other in others:
            if not other.stiffness:
                first = _beside(kept.get(first.name, first), other)
                beside.add(other.name)
        kept[first.name] = first
    return [kept.get(each.name, each) for each in springs if each.name not in beside]


def _beside(spring: Spring, other: Spring) -> Spring:
    """A spring, or a tendon without one, beside which another one damps or pulls."""
    K, (less, more) = spring.stiffness, spring.change
    if K:
        spring = spring._replace(change=(max(less - other.reach / K, -spring.rest_length), more + other.pull / K))
    else:
        spring = spring._replace(reach=spring.reach + other.reach)
    if spring.kind == "cable":
        return spring._replace(damper=spring.damper + other.damper, pull=spring.pull + other.pull)
    return spring._replace(damping=spring.damping + other.damper, rest_length=spring.rest_length - other.pull / K)


def laws_of(springs: list[Spring], cables: Members | None, notes: list[str]) -> tuple[Law, ...]:
    """Of cables whose motors yield, or that push beyond a dead band, of dampers beside them, and of forces."""
    if cables is None:
        return ()
    bands, dampers = zip(*((min(each.dead_band, each.rest_length), each.damper) for each in springs))
    if pushing := sum(band < each.rest_length for band, each in zip(bands, springs)):
        notes.append(f"{pushing} tendons are cables that push when they are short, as springs there do")
    if alone := [each.name for each in springs if not each.acts]:
        notes.append(f"{len(alone)} tendons without a spring are dampers: {some_of(alone)}")
    largest = [min(each.largest, LARGEST_NUMBER) for each in springs]
    pulls, slopes = zip(*((each.pull, each.reach / each.rest_length) for each in springs))
    laws: list[Law] = [force_limit(cables, largest)] if min(largest) < LARGEST_NUMBER else []
    laws += [dead_band(cables, bands)] if pushing else []
    laws += [cable_dampers(cables, dampers)] if any(dampers) else []
    laws += [commanded_pull(cables, pulls, slopes)] if any(pulls) or any(slopes) else []
    quadratic, cubic = zip(*(each.bends for each in springs))
    return (*laws, polynomial_stiffness(cables, quadratic, cubic)) if any(quadratic) or any(cubic) else tuple(laws)


def _path(model: Any, tendon: int) -> tuple[int, ...]:
    first, count = model.tendon_adr[tendon], model.tendon_num[tendon]
    wraps = range(first, first + count)
    if count < 2 or any(model.wrap_type[w] != mujoco.mjtWrap.mjWRAP_SITE for w in wraps):
        name = name_of(model, "tendon", tendon)
        raise InputError(f"tendon {name}: expected two or more sites, without pulleys and geoms between them")
    return tuple(int(model.wrap_objid[w]) for w in wraps)
