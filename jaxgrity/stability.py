"""The largest step that a method takes on a scene without blowing up, predicted from the linearised dynamics."""

import equinox as eqx
import jax
import numpy as np

from jaxgrity.dynamics import acceleration
from jaxgrity.friction import SmoothFriction
from jaxgrity.methods import METHODS, Method, amplification
from jaxgrity.scene import Scene, as_dtype
from jaxgrity.structure import InputError
from jaxgrity.types import NodeVectors


def linearised(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """da/dq (1/s^2) and da/dv (1/s), both (3 nodes, 3 nodes), where the structure stands on the ground at rest.

    The structure is moved, undeformed, to where its lowest nodes press on the ground by its weight, so that the
    stiffness and damping of penalty contact and smooth friction count. The Coulomb switch, which has no derivative, and
    constraints are left out.
    """
    q = np.asarray(scene.structure.nodes, float)
    if scene.ground is not None and scene.ground.stiffness is not None:
        q = _standing(scene, scene.ground.normal, float(scene.ground.stiffness), q)
    if not isinstance(scene.friction, SmoothFriction):
        scene = eqx.tree_at(lambda s: s.friction, scene, None, is_leaf=lambda x: x is None)
    with jax.enable_x64(True):
        derivatives = _linearise(as_dtype(scene, "float64"), q, 0 * q)
    stiffness, damping = (np.asarray(d).reshape(q.size, q.size) for d in derivatives)
    return stiffness, damping


def spectrum(scene: Scene) -> np.ndarray:
    """Eigenvalues (1/s) of the linearised equations of motion."""
    stiffness, damping = linearised(scene)
    n = len(stiffness)
    return np.linalg.eigvals(np.block([[np.zeros((n, n)), np.eye(n)], [stiffness, damping]]))


@eqx.filter_jit
def _linearise(scene: Scene, q: NodeVectors, v: NodeVectors):
    """da/dq and da/dv, (nodes, 3, nodes, 3) each."""
    return jax.jacfwd(lambda q, v: acceleration(scene, 0.0, q, v), (0, 1))(q, v)


def _standing(scene: Scene, normal: tuple, stiffness: float, q: np.ndarray) -> np.ndarray:
    height = q @ np.array(normal)
    lowest = np.isclose(height, height.min(), atol=1e-6 * np.ptp(q, axis=0).max() + 1e-12)
    weight = float(scene.structure.mass) * float(scene.gravity or 0.0)
    depth = weight / stiffness / lowest.sum() + 1e-12
    return q - (height.min() + depth) * np.array(normal)


def stable_step(scene: Scene, method: Method) -> float:
    """Largest step (s) at which no mode of `spectrum(scene)` grows faster in `method` than it does in truth.

    Infinite for implicit methods, which are stable at any step. For complementarity stepping, whose constraints are
    implicit, only the forces count: h^2 k + 2 h c < 4 with the largest eigenvalues k of M^-1 K and c of M^-1 C.
    """
    if method.implicit:
        return np.inf
    if method.constrained:
        k, c = (max(0.0, float(np.linalg.eigvals(-x).real.max())) for x in linearised(scene))
        return 4 / (c + np.sqrt(c * c + 4 * k)) if k or c else np.inf
    modes = spectrum(scene)
    fastest = np.abs(modes).max()
    if fastest == 0:
        return np.inf

    def stable(h: float) -> bool:
        allowed = np.exp(h * np.maximum(modes.real, 0)) * (1 + 1e-6)
        return bool(np.all(amplification(method, h * modes) <= allowed))

    low, high = 1e-3 / fastest, 1e2 / fastest
    for _ in range(60):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return float(low)


def default_step(scene: Scene, method: Method) -> float:
    """The largest of 1, 2, 5 times a power of ten (s) that is at most 0.4 of the stable step, and 10 ms at most."""
    target = min(0.4 * stable_step(scene, method), 1e-2)
    power = 10.0 ** np.floor(np.log10(target))
    return float(max(m * power for m in (1, 2, 5) if m * power <= target * (1 + 1e-9)))


def check_step(scene: Scene, method: Method, dt: float) -> None:
    """Raises `InputError`, naming the largest stable step, where a fixed step `dt` would blow up."""
    limit = stable_step(scene, method)
    if dt > limit:
        raise InputError(
            f"dt = {dt:g} s is too large for {method.name} on this scene; expected at most {limit:.3g} s, "
            "the largest stable step"
        )


def default_method(scene: Scene) -> Method:
    """Complementarity stepping for scenes with rigid struts or exact contact, RK4 for all others."""
    return METHODS["complementarity" if scene.constrained else "rk4"]
