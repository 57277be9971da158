"""The displacements of a structure under small loads, and the load factor at which a cable goes slack."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla
from jaxtyping import Float

from jaxgrity.core.arguments import check_each
from jaxgrity.core.errors import InputError
from jaxgrity.core.quick import compiled_quickly
from jaxgrity.core.tracing import refuse_traced
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, NodeVectors, PerMember
from jaxgrity.model.scene import Scene
from jaxgrity.model.springs import elastic_tensions
from jaxgrity.statics.spring_struts import bearing, with_spring_struts
from jaxgrity.statics.stiffness import motions_of, stiffness_matrix

Loads = Float[AnyArray, "_ 3"]
BALANCE = 1e-8
"""Share of the loads that may be left over where nothing holds the structure."""


class StaticResponse(NamedTuple):
    """The first-order change under loads."""

    displacement: NodeVectors
    """m; without any rigid motion that supports leave free"""
    force_change: PerMember
    """N, change of each member's tension, struts first"""
    compliance: float
    """m/N, f·u/f·f: displacement of the loaded nodes for each newton"""
    slack_margin: float
    """factor of the loads at which the first cable goes slack; infinite where they tighten all"""


@typed
def static_response(scene: Scene, q: NodeVectors, loads: Loads) -> StaticResponse:
    """K u = f about the equilibrium `q`, with the tangent stiffness K = d2U/dq2, prestress included.

    Args:
        scene: the members, rigid bodies and supports; slack cables do not resist.
        q: an equilibrium, m, as from `resting_shape`.
        loads: (nodes, 3), N. Where nothing resists rigid motions, they must balance each other.

    Returns:
        Displacements, changes of the members' forces, and the margin of the nearest cable to slack.

    Raises:
        InputError: the loads do not balance, or nothing resists them.

    Example:
        >>> scene = jaxgrity.load_scene("reference")
        >>> q = scene.structure.nodes
        >>> response = jaxgrity.statics.static_response(scene, q, q - q.mean(0))  # pulled apart from all sides
        >>> response.displacement.shape
        (12, 3)
    """
    refuse_traced((scene, q, loads), "static_response", "`equilibrium_near` has derivatives of a shape")
    q, f = np.asarray(q, float), np.asarray(loads, float)
    check_each("q", q, shape=np.shape(scene.structure.nodes))
    if f.shape != q.shape:
        raise InputError(f"loads has shape {f.shape}; expected {q.shape}, a force for each node")
    bad = "loads: expected finite numbers, and a load on a coordinate that no support holds"
    if not np.isfinite(f).all():
        raise InputError(bad)
    structure, springs = scene.structure, bearing(scene, q, f)
    K = stiffness_matrix(springs, q)
    place, rigid = motions_of(springs, q, K)
    K, pull = sp.csc_array(place.T @ K @ place), place.T @ f.ravel()
    if not pull.any():
        raise InputError(bad)
    if np.abs(rigid.T @ pull).max(initial=0) > BALANCE * np.linalg.norm(pull):
        raise InputError("loads: they do not balance; expected supports, or loads that do")
    size = float(K.diagonal().max(initial=1.0))
    bordered = sp.csc_matrix(sp.block_array([[K, size * rigid], [size * rigid.T, None]]) if rigid.size else K)
    loose = "loads: nothing resists them, since the structure has a loose mechanism; expected prestress"
    try:
        u = spla.splu(bordered).solve(np.r_[pull, np.zeros(rigid.shape[1])])[: len(pull)]
    except RuntimeError as error:  # exactly singular
        raise InputError(loose) from error
    if not np.linalg.norm(K @ u - pull) <= 1e-6 * np.linalg.norm(pull):
        raise InputError(loose)
    displacement = (place @ u).reshape(q.shape)
    tension, change = _both(scene, q, displacement, f)
    slackening = (np.arange(len(tension)) >= structure.first_cable) & (tension > 0) & (change < 0)
    margin = float((tension[slackening] / -change[slackening]).min(initial=np.inf))
    return StaticResponse(displacement, change, float(pull @ u / np.sum(f[structure.free] ** 2)), margin)


def tensions_at(scene: Scene, q: NodeVectors) -> np.ndarray:
    """The members' tensions at `q` and t = 0, N, struts first, from all of U; rigid struts as stiff springs."""
    return _both(scene, np.asarray(q, float), np.zeros(np.shape(q)))[0]


def _both(
    scene: Scene, q: np.ndarray, displacement: np.ndarray, loads: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """The members' tensions at `q` and t = 0, N, struts first, and their first-order change."""
    springs, first = with_spring_struts(scene, loads), scene.structure.first_cable
    with jax.enable_x64(True):
        by_kind = _along(springs, jnp.asarray(q), jnp.asarray(displacement))
    every = (np.concatenate([found[kind] for kind in springs.structure.kinds]) for found in by_kind)
    # after the struts come springs that stand for rigid bodies
    tension, change = (np.r_[each[:first], each[springs.structure.first_cable :]] for each in every)
    return tension, change


@compiled_quickly
def _along(scene: Scene, q: NodeVectors, displacement: NodeVectors) -> tuple:
    return jax.jvp(lambda x: elastic_tensions(scene, 0.0, x), (q,), (displacement,))
