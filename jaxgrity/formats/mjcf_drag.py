"""What slows down nodes of a MuJoCo model: slides with damping, and actuators that push against velocities of sites."""

from typing import Any

import lazy_loader
import numpy as np

from jaxgrity.formats.foreign import Losses
from jaxgrity.formats.mjcf_joints import outer_joints
from jaxgrity.formats.mjcf_losses import name_of

mujoco: Any = lazy_loader.load("mujoco")


def drag_of(model: Any, node: dict[int, int], count: int, losses: Losses) -> np.ndarray:
    """(count,), N s/m, of the nodes; `node` of each site that is one."""
    drag = np.zeros(count)
    for site, k in node.items():
        body = int(model.body_weldid[model.site_bodyid[site]])
        joints = outer_joints(model, body)
        if body and len(joints) and model.jnt_type[joints[0]] == mujoco.mjtJoint.mjJNT_SLIDE:
            each = model.dof_damping[model.jnt_dofadr[joints]]
            if np.ptp(each):
                losses.lose("damping", f"body {name_of(model, 'body', body)}: damping {each.tolist()} by axes")
            drag[k] = each.max()
    for site, c in _drag_of_sites(model, losses).items():
        if site in node:
            drag[node[site]] += c
        elif model.body_weldid[model.site_bodyid[site]]:
            losses.lose("damping", f"site {name_of(model, 'site', site)}: damping where no node is")
    return drag


def is_drag(model: Any, a: int) -> bool:
    """Whether it is a force against the velocity of a site along one axis, and nothing else."""
    gain, bias, gear = model.actuator_gainprm[a], model.actuator_biasprm[a], model.actuator_gear[a]
    affine = model.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_AFFINE
    free = not (gain[0] or bias[0] or bias[1] or model.actuator_forcelimited[a])
    return bool(affine and free and bias[2] < 0 and sorted(gear.tolist()) == [0, 0, 0, 0, 0, 1] and gear[:3].any())


def _drag_of_sites(model: Any, losses: Losses) -> dict[int, float]:
    """N s/m, of sites that actuators slow down alike along all three axes."""
    along: dict[int, list[float]] = {}
    for a in np.flatnonzero(model.actuator_trntype[: model.nu] == mujoco.mjtTrn.mjTRN_SITE):
        if is_drag(model, int(a)):
            each = along.setdefault(int(model.actuator_trnid[a, 0]), [0.0, 0.0, 0.0])
            each[int(np.argmax(model.actuator_gear[a, :3]))] -= float(model.actuator_biasprm[a, 2])
    for site, each in along.items():
        if max(each) != min(each):
            losses.lose("actuators", f"site {name_of(model, 'site', site)}: damping {each} N s/m along x, y and z")
    return {site: max(each) for site, each in along.items()}
