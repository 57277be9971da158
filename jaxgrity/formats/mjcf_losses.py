"""What a MuJoCo model has and a scene has not: named in a note, or refused unless the caller says to drop it."""

import contextlib
from collections.abc import Iterator, Sequence
from typing import Any

import lazy_loader
import numpy as np
from scipy.optimize import brentq

from jaxgrity.core.errors import InputError
from jaxgrity.formats.foreign import Losses

mujoco: Any = lazy_loader.load("mujoco")

DROPPABLE = {
    "contact": "what touches what, and where",
    "radius": "radii of what touches the plane, where they differ",
    "friction": "coefficients that have no counterpart, and dry friction of joints and tendons",
    "limits": "limits of tendons, joints and forces",
    "damping": "of ball joints and free bodies, and what is not in proportion to speed",
    "actuators": "those that are neither springs nor pulls of tendons",
    "air": "density, viscosity and wind",
    "forces": "springs of joints beside hinges, gravity compensation, armature, nonlinear springs, soft equalities",
}
"""What callers may drop although it changes the motion, with a description of each."""
REBOUND, REBOUND_NOTED = 0.25, 0.01
"""Largest shares of its speed that a contact gives back without a restitution of the ground, and without a note, up to
which shares also count as equal. MuJoCo's default is 0.14."""
CONTACT_TIME, RATIOS = 0.02, (1e-3, 1e3)
"""MuJoCo's default time constant of contact, s, and the damping ratios between which one is found for a restitution."""
SMALL = 0.02
"""Share of the robot's size below which notes omit arms of spinning and rolling friction and starts inside the plane.
Contact, `connect` and `weld` that give way by more than this share are lost."""
WATCHED, MOST_WATCHED = 1.0, 5000
"""How long, s, and for how many steps at most MuJoCo moves a robot to see what gives way, and which bodies touch."""


def name_of(model: Any, kind: str, number: int) -> str:
    """As errors name a part: by the name that the file gives it, or by its number."""
    return mujoco.mj_id2name(model, getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), number) or str(number)


@contextlib.contextmanager
def unlogged() -> Iterator[None]:
    """While MuJoCo's warnings go nowhere: else they are written to a file in the working folder."""
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(None)


def check_timestep(model: Any) -> None:
    """Refuse a step with which MuJoCo moves nothing."""
    if not model.opt.timestep > 0:
        raise InputError(f"option: timestep = {model.opt.timestep:g} s; expected a positive number")


def watched(data: Any) -> Iterator[Any]:
    """MuJoCo's data after each step of a while, from the start on, in which it moves the robot at constant controls."""
    model, moved = data.model, mujoco.MjData(data.model)
    moved.qpos[:], moved.ctrl[:], moved.act[:] = data.qpos, data.ctrl, data.act
    with unlogged():  # steps may be unstable
        for _ in range(min(MOST_WATCHED, round(WATCHED / model.opt.timestep))):
            mujoco.mj_step(model, moved)
            yield moved


def check_losses(model: Any, data: Any, losses: Losses) -> None:
    """Of options, bodies, joints and tendons. Contact and actuators are looked at where they are read."""
    _options(model, losses)
    _joints(model, losses)
    _tendons(model, losses)
    _limits(model, data, losses)
    if np.any(model.body_gravcomp):
        losses.lose("forces", f"body {_first(model, 'body', model.body_gravcomp)}: gravity compensation")
    if getattr(model, "nplastic", 0):
        losses.lose("forces", "plastic springs")


def _options(model: Any, losses: Losses) -> None:
    if model.opt.density or model.opt.viscosity:
        losses.lose("air", f"air of {model.opt.density:g} kg/m^3 and {model.opt.viscosity:g} Pa s")
    flags = mujoco.mjtDisableBit
    for name in ("SPRING", "DAMPER", "PASSIVE", "ACTUATION", "CONSTRAINT"):
        if model.opt.disableflags & int(getattr(flags, f"mjDSBL_{name}", 0)):
            raise InputError(f"option flag {name.lower()} is disabled; expected it to be enabled")
    if model.opt.disableactuator:
        losses.lose("actuators", "groups of actuators that are disabled")


def _joints(model: Any, losses: Losses) -> None:
    kinds = model.jnt_type[model.dof_jntid] if model.nv else np.zeros(0, int)
    slides, hinges = (kinds == kind for kind in (mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE))
    turns = ~(slides | hinges)
    springs, bent = (
        found[model.dof_jntid] if model.nv else np.zeros(0)
        for found in (_with_terms(model, "jnt_stiffness"), _terms(model, "jnt_stiffnesspoly"))
    )
    for kind, values, what in (
        ("damping", _with_terms(model, "dof_damping") * turns, "damping, and is neither a slide nor a hinge"),
        ("damping", _terms(model, "dof_dampingpoly") * ~turns, "damping that is not in proportion to speed"),
        ("friction", _dry(model, model.dof_frictionloss), "dry friction (frictionloss)"),
        ("forces", model.dof_armature, "armature"),
        ("forces", springs * ~hinges, "a spring, and is no hinge"),
        ("forces", bent * hinges, "a spring that is not linear"),
    ):
        if np.any(values):
            joint = int(model.dof_jntid[np.flatnonzero(values)[0]])
            losses.lose(kind, f"body {name_of(model, 'body', int(model.jnt_bodyid[joint]))}: its joint has {what}")


def _dry(model: Any, losses: np.ndarray) -> np.ndarray:
    """Dry friction, unless the model disables all of it."""
    return losses * (not model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS))


def _tendons(model: Any, losses: Losses) -> None:
    for kind, values, what in (
        ("limits", model.tendon_actfrclimited, "a limited force of its actuators"),
        ("friction", _dry(model, model.tendon_frictionloss), "dry friction (frictionloss)"),
        ("forces", getattr(model, "tendon_armature", np.zeros(model.ntendon)), "armature"),
        ("damping", _terms(model, "tendon_dampingpoly"), "damping that is not in proportion to speed"),
    ):
        if np.any(values):
            losses.lose(kind, f"tendon {_first(model, 'tendon', values)}: {what}")


def _limits(model: Any, data: Any, losses: Losses) -> None:
    """Loses ranges that tendons or joints reach while MuJoCo moves the robot for a while, or cannot: soft stops."""
    joints, tendons = (np.flatnonzero(limited).tolist() for limited in (model.jnt_limited, model.tendon_limited))
    reached, time, stable, kinds = set[tuple[int, int]](), 0.0, True, mujoco.mjtConstraint
    for moved in watched(data) if joints or tendons else ():
        reached |= set(zip(moved.efc_type.tolist(), moved.efc_id.tolist()))
        time, stable = moved.time, stable and moved.time > time  # where a motion is unstable, MuJoCo begins anew
    unreached = f"there, not reached within {time:.2g} s at constant controls, and not at all here"
    for j in joints:
        what = f"body {name_of(model, 'body', int(model.jnt_bodyid[j]))}: its joint has a limited range"
        if (int(kinds.mjCNSTR_LIMIT_JOINT), j) in reached or not stable:
            losses.lose("limits", what)
        else:
            losses.note(f"{what} {unreached}")
    for t in tendons:
        low, high = model.tendon_range[t]
        what = f"tendon {name_of(model, 'tendon', t)}: its length is limited to {low:g} to {high:g} m"
        if (int(kinds.mjCNSTR_LIMIT_TENDON), t) in reached or not stable:
            losses.lose("limits", what, "" if model.tendon_stiffness[t] else _as_spring(model, t))
        else:
            losses.note(f"{what} {unreached}")


def _as_spring(model: Any, tendon: int) -> str:
    """Words on the cable that stretches as much as a limited tendon when something hangs on it.

    MuJoCo's limit is no spring: its force follows from accelerations, too, as if it had a mass of its own, 1/R. So that
    cable has the same length at rest, and swings faster.
    """
    (period, ratio), most = _period(model.tendon_solref_lim[tendon]), float(model.tendon_solimp_lim[tendon][1])
    soft = max((1 - most) * float(model.tendon_invweight0[tendon]), 1e-300)
    K, c = 1 / (period**2 * soft), 2 * ratio / (period * soft)
    attributes = f'springlength="0 {model.tendon_range[tendon][1]:g}" stiffness="{K:.4g}" damping="{c:.4g}"'
    return f", a soft stop that resists accelerations, too; a cable that stretches alike at rest has {attributes}"


def check_spring(model: Any, geom: int, spring: Sequence[np.ndarray], deep: float, losses: Losses) -> float:
    """The share of its speed that a geom's contact with the plane gives back. Loses one pressed in by over `deep`, m.

    `spring` is the contact's `solref` and `solimp`. Exact contact is stiff. How deep it is pressed in is known within a
    factor of two: many contacts share a weight, and grow stiffer with depth.
    """
    (period, ratio), impedance = _period(spring[0]), float(spring[1][1])
    sinks = gravity_of(model) * (1 - impedance) * period**2
    if sinks > deep:
        name = f"geom {name_of(model, 'geom', geom)}"
        losses.lose("contact", f"{name}: its weight presses it some {sinks:.1g} m into the plane (solref, solimp)")
    return rebound(ratio)


def _period(solref: np.ndarray) -> tuple[float, float]:
    """The period, s, over 2 pi, and the damping ratio, of a contact."""
    time, ratio = solref.tolist()
    if time > 0:
        return time * ratio, ratio
    period = 1 / np.sqrt(max(-time, 1e-300))  # minus a stiffness, and minus a damping
    return period, -ratio / 2 * period


def bounces(solref: np.ndarray) -> bool:
    """Whether a contact gives back more than `REBOUND` times its speed."""
    return rebound(_period(solref)[1]) > REBOUND


def restitution_of(model: Any, back: dict[int, float], losses: Losses) -> float | None:
    """The ground's restitution, if geoms bounce with more than `REBOUND` times their speed: `back` of each.

    A ground has one restitution. Loses bounces of geoms that differ.
    """
    if max(back.values(), default=0.0) <= REBOUND:
        for share in back.values():
            if share > REBOUND_NOTED:
                what = f"contact bounces off the plane at {share:.2g} times its speed"
                losses.note(f"{what} there (solref), and not at all here")
        return None
    least, most = (choose(back, key=lambda geom: back[geom]) for choose in (min, max))
    name, other = (f"geom {name_of(model, 'geom', geom)}" for geom in (most, least))
    what = f"bounces off the plane at {back[most]:.2g} times its speed (solref)"
    if back[most] - back[least] > REBOUND_NOTED:
        losses.lose("contact", f"{name}: {what}, and {other} at {back[least]:.2g} times its speed")
        return None
    losses.note(f"contact {what}, which is the ground's restitution here")
    return back[most]


def contact_spring(restitution: float, time: float) -> list[float]:
    """The `solref` of contact that gives back such a share of its speed, as stiff as one with this time constant, s."""
    low, high = RATIOS
    ratio = float(brentq(lambda x: rebound(x) - float(np.clip(restitution, rebound(high), rebound(low))), low, high))
    return [-1 / time**2, -2 * ratio / time]


def lose_beside_sites(model: Any, geom: int, centre: np.ndarray, losses: Losses) -> None:
    """Loses what touches the plane about its `centre`, m, where no node is."""
    name, place = name_of(model, "geom", geom), centre.round(4).tolist()
    what = f"geom {name}: touches the plane where its body has no site"
    losses.lose("contact", what, f", about {place} m")


def lose_rims(model: Any, geom: int, radius: float, losses: Losses) -> None:
    """Loses the rims of a geom that is a cylinder."""
    if _is_cylinder(model, geom):
        name = name_of(model, "geom", geom)
        losses.lose("radius", f"geom {name}: the rims of a cylinder of {radius:g} m touch the plane")


def largest_first(model: Any, balls: list[Any]) -> list[Any]:
    """Balls of geoms by their radii; rims of cylinders come last."""
    return sorted(balls, key=lambda ball: (_is_cylinder(model, ball.geom), -ball.radius))


def _is_cylinder(model: Any, geom: int) -> bool:
    return bool(model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CYLINDER)


def rebound(ratio: float) -> float:
    """The share of its speed with which a mass leaves a damped spring that pushes and does not pull.

    It leaves where the force is 0, at the phase 2 acos(ratio) of the oscillation: before the spring has its length.
    """
    if abs(ratio - 1) < 1e-6:
        return float(np.exp(-2.0))
    phase = np.arccos(complex(ratio))
    return float(np.exp(-2 * ratio * phase / np.sin(phase)).real)


def gravity_of(model: Any) -> float:
    """m/s^2, 0 where it is disabled."""
    off = model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
    return 0.0 if off else float(np.linalg.norm(model.opt.gravity))


def _first(model: Any, kind: str, values: np.ndarray) -> str:
    return name_of(model, kind, int(np.flatnonzero(values)[0]))


def _terms(model: Any, name: str) -> np.ndarray:
    """Whether there are terms of higher order, one number each; versions of MuJoCo before 4 know none."""
    found = getattr(model, name, None)
    if found is None:
        found = getattr(model, name.removesuffix("poly"))
        return np.zeros(len(found))
    return np.abs(found).reshape(len(found), -1 if len(found) else 1).sum(1)


def _with_terms(model: Any, name: str) -> np.ndarray:
    """The coefficient of first order and those of higher ones, one number each, to compare with 0."""
    return np.abs(np.reshape(getattr(model, name), (-1,))) + _terms(model, f"{name}poly")
