"""The largest stable step of a method on a scene, predicted from the linearised dynamics."""

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.tracing import evaluated
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, NodeVectors, Scalar, State
from jaxgrity.model.actuation import rest_length
from jaxgrity.model.inertia import independent_coordinates, mass_matrix
from jaxgrity.model.laws import DissipationTerm, EnergyTerm, ForceTerm, named_parts
from jaxgrity.model.rigidity import rigid_pairs
from jaxgrity.model.scales import length_scale, time_scale
from jaxgrity.model.scene import Scene, as_dtype, with_gait
from jaxgrity.model.structure import edge_lengths
from jaxgrity.stepping.dynamics import smooth_acceleration
from jaxgrity.stepping.methods import Method, amplification, find_method

GROWTH = 1e-3
"""Relative growth per step, beyond the true growth, that counts as stable. Tsit5 always amplifies undamped motions."""
STANDS_ON = 3
"""Smallest number of nodes that carry the weight on uneven ground, where only one touches at first."""
LARGEST_STEP = 5e-3
"""Largest default step, s for a body of one metre. The time of an impact is known only to a step."""
INDEPENDENT = 1e-9
"""Relative strength below which a constraint follows from the others, as for redundant struts."""
WIDEST = 1e2
"""Largest step that is examined, as a multiple of the time scale of the fastest mode."""


class Linearised(NamedTuple):
    """Linearised motion y'' = -K y - C y' for q + B y, with the n coordinates y that constraints leave free."""

    stiffness: np.ndarray
    """(n, n), stiffness K, 1/s^2"""
    damping: np.ndarray
    """(n, n), damping C, 1/s"""
    basis: np.ndarray
    """(3 nodes, n), basis B: mass-normalised with constraints, otherwise the identity"""

    def modes(self) -> tuple[np.ndarray, np.ndarray]:
        """Eigenvalues of the motion, (2n,), 1/s, and their displacements, (3 nodes, 2n)."""
        n = len(self.stiffness)
        values, vectors = np.linalg.eig(np.block([[np.zeros((n, n)), np.eye(n)], [-self.stiffness, -self.damping]]))
        return values, self.basis @ vectors[:n]


@typed
def standing(scene: Scene) -> State:
    """The undeformed structure at rest in its pose, with its lowest nodes pressed into the ground by its weight.

    On exact ground they touch it. Without ground, or on supports, the structure stays where it is.
    """
    q = np.asarray(scene.structure.nodes, float)
    if scene.ground is None or scene.structure.fixed:
        return q, 0 * q
    height, size = scene.ground.measured(q).distance, float(length_scale(scene))
    lowest = np.isclose(height, height.min(), atol=1e-6 * np.ptp(q, axis=0).max() + 1e-12 * size)
    with evaluated():
        weight = float(scene.structure.mass) * float(scene.gravity or 0.0)
    carrying = int(lowest.sum()) if scene.ground.surface is None else max(int(lowest.sum()), min(STANDS_ON, len(q)))
    depth = scene.ground.touching_depth(weight, carrying, size)
    return scene.ground.set_down(q, depth, size), 0 * q


def linearise(scene: Scene, state: State) -> Linearised:
    """The equations of motion, linearised about `state` = (positions, velocities) at t = 0, in float64.

    Rigid struts, nodes on exact ground and nodes held by the cone are constraints. Motions against them are left out,
    and the forces of struts turn with the struts. Force laws without a derivative (the Coulomb switch) are ignored.
    """
    with jax.enable_x64(True), evaluated():
        q, v = (np.asarray(x, float) for x in state)
        a, slopes = _derivatives(as_dtype(scene, "float64"), q, v)
    moves, place = independent_coordinates(scene.structure)
    onto = (lambda x: x @ place) if scene.structure.bodies else (lambda x: x[:, moves])
    stiffness, damping = (onto(-np.asarray(d).reshape(q.size, q.size)[moves]) for d in slopes)
    rows = onto(_constraints(scene, q))
    if not len(rows):
        return Linearised(stiffness, damping, place)
    with jax.enable_x64(True), evaluated():
        mass = onto(onto(np.asarray(mass_matrix(scene.structure))).T)
    forces = np.linalg.lstsq(rows.T, -mass @ np.asarray(a).ravel()[moves], rcond=INDEPENDENT)[0]
    stiffness = stiffness - np.linalg.solve(mass, onto(onto(_turning(scene, q, forces)).T).T)
    root = np.linalg.cholesky(mass)
    _, strengths, axes = np.linalg.svd(np.linalg.solve(root, rows.T).T)
    basis = np.linalg.solve(root.T, axes[np.sum(strengths > INDEPENDENT * strengths[0]) :].T)
    reduce = basis.T @ mass
    return Linearised(reduce @ stiffness @ basis, reduce @ damping @ basis, place @ basis)


@eqx.filter_jit
def _derivatives(scene: Scene, q: NodeVectors, v: NodeVectors):
    """Acceleration a, and da/dq and da/dv, (nodes, 3, nodes, 3) each."""
    a = lambda q, v: smooth_acceleration(scene, 0.0, q, v)  # noqa: E731
    return a(q, v), jax.jacfwd(a, (0, 1))(q, v)


def _constraints(scene: Scene, q: np.ndarray) -> np.ndarray:
    """(constraints, 3 nodes): direction of each constraint, rigid struts first."""
    size = float(length_scale(scene))
    rows = (constraint.directions(q, size).reshape(-1, q.size) for constraint in scene.constraints)
    return np.concatenate([np.zeros((0, q.size)), *rows])


def _turning(scene: Scene, q: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """(3 nodes, 3 nodes), change of the rigid struts' forces as they turn, (1 - u u^T) f / l, N/m."""
    change = np.zeros((*q.shape, *q.shape))
    for (i, j), force in zip(rigid_pairs(scene), forces):
        d = q[i] - q[j]
        across = force / np.linalg.norm(d) * (np.eye(3) - np.outer(d, d) / (d @ d))
        for a, b, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
            change[a, :, b] += sign * across
    return change.reshape(q.size, q.size)


@typed
def stable_step(scene: Scene, state: State, method: Method | str) -> float:
    """Largest step at which no small motion about `state` grows more than its true growth plus `GROWTH` per step, s.

    It is infinite for implicit methods. It holds for small motions: beyond it smooth friction first chatters, and blows
    up later.
    """
    method = find_method(method) if isinstance(method, str) else method
    return np.inf if method.implicit else _largest(linearise(scene, state), method)


def _largest(linear: Linearised, method: Method) -> float:
    values = linear.modes()[0]
    if not (fastest := np.abs(values).max(initial=0)):
        return np.inf
    low, high = 1e-3 / fastest, WIDEST / fastest
    for _ in range(26):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if np.all(_growth(linear, values, method, middle) <= 1 + GROWTH) else (low, middle)
    return float(low)


def _growth(linear: Linearised, values: np.ndarray, method: Method, h: float) -> np.ndarray:
    """Growth of each mode per step beyond its true growth; with constraints, of each mode of the step."""
    if not method.constrained:
        return amplification(method, h * values) * np.exp(-h * np.maximum(values.real, 0))
    one = np.eye(len(linear.stiffness))
    kick, drag = -h * linear.stiffness, -h * linear.damping
    # w0 = v + kick q + drag v predicts w = v + kick q + drag (v + w0)/2
    from_q, from_v = kick + drag @ kick / 2, one + drag + drag @ drag / 2
    step = np.block([[one + h * from_q, h * from_v], [from_q, from_v]])
    return np.abs(np.linalg.eigvals(step)) * np.exp(-h * max(0, values.real.max()))


@typed
def limiting_part(scene: Scene, state: State, method: Method) -> str:
    """Name of the member, contact or damper with the largest share in the motion that limits `stable_step`."""
    linear = linearise(scene, state)
    values, shapes = linear.modes()
    size = np.abs(values) if method.constrained else _growth(linear, values, method, 1.01 * _largest(linear, method))
    worst = np.argmax(size)
    q, v = (np.asarray(x, float) for x in state)
    shape = np.stack([shapes[:, worst].real, shapes[:, worst].imag]).reshape(2, *q.shape)
    with jax.enable_x64(True), evaluated():
        shares = part_shares(as_dtype(scene, "float64"), q, v, shape, np.asarray(np.abs(values[worst])))
    names = [x for law in scene.laws if isinstance(law, ForceTerm) for x in named_parts(law, scene)]
    return names[int(np.argmax(np.abs(np.concatenate(shares))))]


@eqx.filter_jit
def part_shares(scene: Scene, q: NodeVectors, v: NodeVectors, shape: AnyArray, rate: Scalar) -> list[AnyArray]:
    """Share of each part of each term of U and R in the motion `shape` (real and imaginary part).

    It is x·dF with the forces F of the part and dF = dF/dq x + rate dF/dv x.
    """

    def share(term: ForceTerm):
        def work(factors):
            def force(q, v):
                motion = scene.motion(v, q, 0.0, scene.normal_force(q, v))
                scaled = term.scaled(factors)
                return factors[:, None] * _force(term, motion) if scaled is None else _force(scaled, motion)

            return jnp.sum(jax.vmap(lambda x: x * jax.jvp(force, (q, v), (x, rate * x))[1])(shape))

        return jax.grad(work)(jnp.ones(len(named_parts(term, scene))))

    return [share(law) for law in scene.laws if isinstance(law, ForceTerm)]


def _force(term: ForceTerm, motion):
    """(nodes, 3), forces of one term of U or R, N."""
    scene, (q, t) = motion.at.scene, motion.at[:2]
    if isinstance(term, EnergyTerm):
        return -jax.grad(lambda q: term.energy(scene.configuration(q, t)))(q)
    assert isinstance(term, DissipationTerm), "a term whose force is a gradient is one of U or of R"
    return -jax.grad(lambda v: term.dissipation(scene.motion(v, q, t, motion.normal_force)))(motion.v)


def aloft(scene: Scene) -> tuple[Scene, State]:
    """The undeformed structure at rest, away from the ground.

    It is lifted, so it shares the compiled program of the standing robot. If the scene has your own terms, which may
    depend on the place, or uneven ground, the ground is removed instead.
    """
    q = np.asarray(scene.structure.nodes, float)
    if scene.terms or (scene.ground is not None and scene.ground.surface is not None):
        return dataclasses.replace(scene, ground=None, friction=None), (q, 0 * q)
    return scene, (q + np.array([0.0, 0.0, 1e3 * float(length_scale(scene))]), 0 * q)


def all_taut(scene: Scene) -> Scene:
    """The scene without gait and cables' motors, with rest lengths at t = 0 shortened until no cable is slack."""
    scene, cables = with_gait(scene, None), scene.structure.cables
    if cables is None:
        return scene
    taut = np.minimum(rest_length(cables, None, 0.0, 0), (1 - 1e-9) * edge_lengths(scene.structure.nodes, cables.edges))
    return eqx.tree_at(lambda s: s.structure.cables, scene, dataclasses.replace(cables, rest_length=taut, motors=()))


def strictest(scene: Scene, method: Method) -> tuple[float, Scene, State]:
    """The smaller of the stable steps standing and aloft, s, with all cables taut, and its case.

    Penalty contact and friction limit the standing robot. Exact contact holds nodes, and allows larger steps. Slack
    cables count as taut, since they may become taut.
    """
    return min(((stable_step(*case, method), *case) for case in _cases(scene)), key=lambda x: x[0])


def _cases(scene: Scene) -> list[tuple[Scene, State]]:
    """Standing and aloft, all cables taut."""
    return [(taut := all_taut(scene), standing(taut)), aloft(taut)]


class StepLimit(NamedTuple):
    """The largest fixed step that a scene allows a method."""

    step: float
    """largest stable step, s"""
    set_by: str
    """name of the member, contact or damper that limits it"""


@typed
def step_limit(scene: Scene, method: Method | str) -> StepLimit:
    """The largest stable step of a scene, standing and aloft, and the part that limits it.

    Args:
        scene: the scene to simulate.
        method: a method, or its name.

    Raises:
        InputError: an unknown method.

    Example:
        >>> limit = jaxgrity.stepping.step_limit(jaxgrity.load_scene("exact"), "complementarity")
        >>> round(limit.step, 3), limit.set_by.split()[0]  # s, and "cable 2 (nodes 0, 8)" or one that is its image
        (0.036, 'cable')
    """
    step, taut, state = strictest(scene, method := find_method(method) if isinstance(method, str) else method)
    return StepLimit(step, limiting_part(taut, state, method) if np.isfinite(step) else "nothing")


@typed
def default_step(scene: Scene, method: Method) -> float:
    """The default step: 1, 2 or 5 times a power of ten, s, at most 0.4 of the stable step and `LARGEST_STEP`.

    It is round so that frames fall on steps. A scaled copy of a robot may get a step up to 2.5 times smaller."""
    target = min(0.4 * strictest(scene, method)[0], LARGEST_STEP * float(time_scale(scene)))
    power = 10.0 ** np.floor(np.log10(target))
    return float(max(m * power for m in (1, 2, 5) if m * power <= target * (1 + 1e-9)))


def step_fault(scene: Scene, method: Method, dt: float) -> str:
    """Message for a fixed step `dt` that would blow up, with the largest stable step; empty if `dt` is stable."""
    if method.implicit or all(_surely_stable(*case, method, dt) for case in _cases(scene)):
        return ""
    limit, taut, state = strictest(scene, method)
    words = (
        f"dt = {dt:g} s is too large for {method.name} on this scene; expected at most {limit:.3g} s, the largest "
        f"stable step, set by {limiting_part(taut, state, method)}"
    )
    return words if dt > limit else ""


def _surely_stable(scene: Scene, state: State, method: Method, dt: float) -> bool:
    """Whether `dt`, its half and its quarter are stable and in the range of `stable_step`: a quick check."""
    linear = linearise(scene, state)
    values = linear.modes()[0]
    if not values.any():
        return True
    stable = all(np.all(_growth(linear, values, method, h) <= 1 + GROWTH) for h in (dt, dt / 2, dt / 4))
    return stable and bool(dt * np.abs(values).max() < WIDEST)
