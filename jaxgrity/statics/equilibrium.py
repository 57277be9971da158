"""The resting shape of a structure, a minimum of U under loads and supports, and its derivatives."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
import scipy.sparse as sp

from jaxgrity.core.arguments import check_each
from jaxgrity.core.display import in_digits
from jaxgrity.core.errors import InputError
from jaxgrity.core.primitives import edge_vectors, length
from jaxgrity.core.tracing import refuse_traced
from jaxgrity.core.typed import typed
from jaxgrity.core.types import NodeVectors
from jaxgrity.model.body_points import following, independent_nodes
from jaxgrity.model.rigidity import linked, rigid_lengths, rigid_pairs
from jaxgrity.model.scene import Scene
from jaxgrity.model.slides import lines_at, slides_of
from jaxgrity.model.springs import largest_force, largest_stiffness, smallest_stiffness
from jaxgrity.statics.spring_struts import stiffness_around, with_spring_struts
from jaxgrity.statics.stiffness import coordinate_map, factor_if_definite, free_coordinates, tangent_of

ITERATIONS = 500
"""Most iterations of the solver, after which a shape counts as not found."""
PATIENCE = 30
"""Most steps with rigid struts from where they are given; from there on by way of struts that give way."""
GIVING = 100.0
"""Stiffness of springs in place of rigid struts, as a multiple of what is beside them (`stiffness_around`)."""
SMALLEST_SHIFT, LARGEST_SHIFT = 1e-12, 1e6
"""Limits of the shift of the stiffness matrix, as shares of its largest diagonal entry."""
RESISTANCE = 1e-8
"""Smallest shift as a share of the softest member's stiffness. It limits motions that no member resists: rounding of
the forces moves nodes too little to tighten slack cables."""


class RestingShape(NamedTuple):
    """Where `resting_shape` ended."""

    q: NodeVectors
    """m"""
    residual: float
    """N, the largest component of force on a coordinate that no support holds"""
    stable: bool
    """whether U rises in every direction, or stays the same to rounding: a minimum, not a saddle"""
    reactions: NodeVectors
    """N, forces of supports; 0 at free coordinates"""
    steps: int


@typed
def resting_shape(
    scene: Scene, start: NodeVectors | None = None, loads: NodeVectors | None = None, tolerance: float | None = None
) -> RestingShape:
    """A minimum of U(q, 0) - sum f·x near `start`: the shape under given rest lengths, loads and supports.

    Newton's method with the sparse tangent stiffness, shifted until it is positive definite and U falls: the damping of
    Levenberg and Marquardt (Nocedal and Wright 2006, section 3.4). So it ends in a minimum, not in a saddle. A
    structure of thousands of members takes seconds.

    Args:
        scene: what acts; the gait at t = 0. Rigid struts, bodies and slides become very stiff springs.
            Supports hold their coordinates where they start.
        start: positions to start from, m; None: the structure's own.
        loads: (nodes, 3), constant forces, N; None: none.
        tolerance: N, the largest force left; None: 1e-11 of the largest force of any member.

    Returns:
        The shape, the forces left, the supports' reactions, and whether the equilibrium is stable.

    Raises:
        InputError: no equilibrium is found, as for a robot in free fall; or an array has another shape, or is not
            finite; or a tolerance is not positive.

    Example:
        >>> scene = jaxgrity.load_scene("reference")
        >>> jaxgrity.statics.resting_shape(scene).stable
        True
    """
    refuse_traced((scene, start, loads), "resting_shape", "`equilibrium_near` has derivatives of what this finds")
    q = np.array(scene.structure.nodes if start is None else start, float)
    pull = np.zeros(q.shape) if loads is None else np.asarray(loads, float)
    for name, given in (("start", q), ("loads", pull)):
        check_each(name, given, shape=np.shape(scene.structure.nodes))
    springs = with_spring_struts(scene, pull)
    check_each("tolerance", tolerance, shape=(), above=0.0, unit="N")
    whole, free = coordinate_map(scene.structure)
    limit = max(1e-11 * largest_force(scene.structure), 100 * np.finfo(float).eps * largest_force(springs.structure))
    limit = limit if tolerance is None else tolerance

    least = RESISTANCE * smallest_stiffness(springs.structure)
    place, descent = whole[:, free], _descent_of(springs, whole, free, pull)
    given, softer = (whole @ q.ravel()).reshape(q.shape), _softer(scene, pull)
    first = ITERATIONS if softer is None else min(PATIENCE, ITERATIONS)
    here, steps = _descend(descent, place, given, (limit, least), first)
    if steps == first and softer is not None:
        here, some = _descend(_descent_of(softer, whole, free, pull), place, given, (limit, least), ITERATIONS)
        here, more = _descend(descent, place, here.q, (limit, least), ITERATIONS)
        steps += some + more
    if not here.residual <= limit:
        raise InputError(f"no equilibrium near the start: {in_digits(here.residual)} N are left after {steps} steps")
    reactions = -here.force
    reactions[free] = 0
    K = here.stiffness()
    stable = factor_if_definite(_shifted(K, 1e-9 * _size(K))) is not None
    return RestingShape(here.q, here.residual, stable, reactions.reshape(q.shape), steps)


@typed
def equilibrium_near(scene: Scene, shape: NodeVectors, loads: NodeVectors | None = None) -> NodeVectors:
    """The equilibrium close to `shape`, m, differentiable with respect to `loads`, N, and everything in the scene.

    A stationary point of U(q, 0) - sum f·x + sum lambda c, with a multiplier for every rigid strut, and every pair of
    points that a rigid body keeps apart, whose c is l - L, and two for every sliding node, whose c are its distances
    from its line. Other points of bodies follow. Newton's method (optimistix) finds it, and the derivatives are those
    of the implicit function theorem: dq/dp = -K^-1 d2U/dq dp without multipliers. Where rigid motions make K singular,
    the least squares solution is taken. `shape` comes from `resting_shape` and is held constant; so are supported
    coordinates. NaN where Newton's method does not converge. K is dense: some hundred nodes at most. float64 is needed.
    """
    near, bodies = jax.lax.stop_gradient(jnp.asarray(shape)), scene.structure.bodies
    follow = np.isin(np.arange(len(near)), independent_nodes(bodies, len(near)), invert=True)
    free = free_coordinates(len(near), scene.structure.supported | follow[:, None])
    # U by the largest stiffness: one tolerance in metres then suits soft cables and stiff struts
    size = jax.lax.stop_gradient(largest_stiffness(scene.structure))

    def placed(x, bodies):
        return following(bodies, near.ravel().at[free].set(x[: len(free)]).reshape(near.shape))

    pairs, slides = rigid_pairs(scene), slides_of(scene)
    across = None if slides is None else lines_at(slides, near).across.reshape(-1, 2, 3)

    def lagrangian(x, given):
        (scene, pull), multiplier = given, x[len(free) :]
        q = placed(x, scene.structure.bodies)
        work = 0.0 if pull is None else jnp.sum(pull * q)
        energy = (scene.potential_energy(q, 0.0) - work) / size
        gaps = []
        if pairs:
            gaps.append(length(edge_vectors(q, pairs)) - rigid_lengths(scene, 0.0))
        if slides is not None:
            gaps.append(jnp.einsum("skx,sx->sk", across, slides.offsets(q)).ravel())
        return energy + multiplier @ jnp.concatenate(gaps) if gaps else energy

    multipliers = len(pairs) + (0 if slides is None else 2 * len(slides.nodes))
    start = jnp.concatenate([near.ravel()[free], jnp.zeros(multipliers)])
    least_squares = lx.SVD(rcond=1e-9)
    solver: optx.Newton = optx.Newton(rtol=1e-9, atol=1e-9, linear_solver=least_squares)
    adjoint = optx.ImplicitAdjoint(linear_solver=least_squares)
    found: optx.Solution = optx.root_find(
        jax.grad(lagrangian), solver, start, (scene, loads), adjoint=adjoint, throw=False, max_steps=50
    )
    return jnp.where(found.result == optx.RESULTS.successful, placed(found.value, bodies), jnp.nan)


class _Here(NamedTuple):
    """A shape on the way down."""

    q: np.ndarray
    energy: float
    """U less the loads' work, J"""
    force: np.ndarray
    """(3 nodes,), that of independent nodes, N; along free coordinates it has to vanish"""
    free: np.ndarray
    """(coordinates,), that along the free ones"""
    stiffness: Callable[[], sp.csc_array]
    """gives K of the free coordinates, N/m"""

    @property
    def residual(self) -> float:
        return float(np.abs(self.free).max(initial=0))


def _descent_of(
    springs: Scene, whole: sp.csc_array, free: np.ndarray, pull: np.ndarray
) -> Callable[[np.ndarray], _Here]:
    """The map from shapes to what is known there."""
    tangent, place = tangent_of(springs), whole[:, free]
    all_free = (place != sp.eye_array(*place.shape)).nnz == 0

    def at(q: np.ndarray) -> _Here:
        here = tangent(q)
        force = whole.T @ (pull - here.gradient).ravel()

        def stiffness() -> sp.csc_array:
            K = here.stiffness()
            return K if all_free else sp.csc_array(place.T @ K @ place)

        return _Here(q, here.energy - float(np.sum(pull * q)), force, force[free], stiffness)

    return at


def _softer(scene: Scene, loads: np.ndarray) -> Scene | None:
    """The scene with rigid struts and bodies as springs that give way, from whose shape the stiff ones are near.

    None where there are no such struts, or nothing pulls.
    """
    if not (linked(scene) and stiffness_around(scene, loads)):
        return None
    return with_spring_struts(scene, loads, GIVING)


def _descend(
    at: Callable[[np.ndarray], _Here], place: sp.csc_array, start: np.ndarray, limits: tuple[float, float], most: int
) -> tuple[_Here, int]:
    """At most so many shifted Newton steps downhill, until no force is above the limit and a step hardly lowers them.

    `place`: the map from free coordinates to all; `limits`: the largest force, N, and the smallest shift, N/m.
    """
    (limit, least), here, shift, last = limits, at(start), 1e-4, 0.0
    for step in range(most):
        if here.residual <= limit and here.residual >= last / 10:
            return here, step
        last, K = here.residual, here.stiffness()
        size = max(_size(K), least / RESISTANCE)  # where nothing resists, a step is as long as the softest member says
        shift = max(shift, least / size)
        while shift <= LARGEST_SHIFT:
            factor = factor_if_definite(_shifted(K, shift * size))
            if factor is not None:
                new = at(here.q + (place @ factor.solve(here.free)).reshape(here.q.shape))
                # near the end the energy cannot tell, but the forces can
                smaller = new.residual < here.residual and new.energy <= here.energy + 1e-12 * abs(here.energy)
                if new.energy < here.energy or smaller:
                    break
            shift = 10 * shift
        else:
            return here, step
        here, shift = new, max(shift / 30, SMALLEST_SHIFT)
    return here, most


def _size(K: sp.csc_array) -> float:
    """The largest diagonal entry, N/m."""
    return max(float(K.diagonal().max(initial=0)), np.finfo(float).tiny)


def _shifted(K: sp.csc_array, shift: float) -> sp.csc_array:
    """K + shift 1, N/m."""
    diagonal = np.flatnonzero(K.indices == np.repeat(np.arange(K.shape[0]), np.diff(K.indptr)))
    if len(diagonal) < K.shape[0]:
        return sp.csc_array(K + shift * sp.eye_array(K.shape[0], format="csc"))
    data = K.data.copy()
    data[diagonal] += shift
    return sp.csc_array((data, K.indices, K.indptr), shape=K.shape)
