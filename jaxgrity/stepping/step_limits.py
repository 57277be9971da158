"""The largest step that a method takes on a scene without blowing up, predicted from the linearised dynamics."""

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.tracing import evaluated
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, NodeVectors, Scalar, State
from jaxgrity.model.inertia import independent_coordinates, mass_matrix
from jaxgrity.model.laws import DissipationTerm, EnergyTerm, ForceTerm, named_parts
from jaxgrity.model.rigidity import held_edges
from jaxgrity.model.scales import length_scale, time_scale
from jaxgrity.model.scene import Scene, as_dtype, with_gait
from jaxgrity.model.structure import edge_lengths
from jaxgrity.stepping.dynamics import smooth_acceleration
from jaxgrity.stepping.methods import METHODS, Method, amplification, constrained_method, find_method

GROWTH = 1e-3
"""Relative growth in a step, beyond the true one, that counts as stable: Tsit5 amplifies undamped motions always."""
STANDS_ON = 3
"""Fewest nodes that carry a structure's weight on uneven ground, although only one touches as it is set down."""
LARGEST_STEP = 5e-3
"""Largest step that is chosen, s for a body of one metre: the time at which a contact begins is known to a step."""
INDEPENDENT = 1e-9
"""Constraints this much weaker than the strongest follow from the others: struts more than rigidity needs."""
WIDEST = 1e2
"""Largest step that is examined, as a multiple of the time scale of the fastest mode."""


class Linearised(NamedTuple):
    """y'' = -K y - C y' for small motions q + B y about a state: n coordinates y, as many as the constraints leave."""

    stiffness: np.ndarray
    """(n, n), K, 1/s^2"""
    damping: np.ndarray
    """(n, n), C, 1/s"""
    basis: np.ndarray
    """(3 nodes, n), B: mass-normalised where there are constraints, else the identity"""

    def modes(self) -> tuple[np.ndarray, np.ndarray]:
        """(2n,) eigenvalues, 1/s, of the motion, and (3 nodes, 2n) the displacements that go with them."""
        n = len(self.stiffness)
        values, vectors = np.linalg.eig(np.block([[np.zeros((n, n)), np.eye(n)], [-self.stiffness, -self.damping]]))
        return values, self.basis @ vectors[:n]


@typed
def standing(scene: Scene) -> State:
    """The structure at rest, undeformed, where its lowest nodes press on the ground by its weight, as it was posed.

    On exact ground they touch it; without ground, or on supports, the structure stays where it is.
    """
    q = np.asarray(scene.structure.nodes, float)
    if scene.ground is None or scene.structure.fixed:
        return q, 0 * q
    height, size = scene.ground.measured(q).distance, float(length_scale(scene))
    lowest = np.isclose(height, height.min(), atol=1e-6 * np.ptp(q, axis=0).max() + 1e-12 * size)
    weight = float(scene.structure.mass) * float(scene.gravity or 0.0)
    carrying = int(lowest.sum()) if scene.ground.surface is None else max(int(lowest.sum()), min(STANDS_ON, len(q)))
    depth = scene.ground.touching_depth(weight, carrying, size)
    return scene.ground.set_down(q, depth, size), 0 * q


def linearise(scene: Scene, state: State) -> Linearised:
    """The equations of motion, linearised about `state` = (positions, velocities) at t = 0, in float64.

    Rigid struts, nodes on exact ground and what the cone holds there are constraints: motions against them are left
    out, and the struts' forces turn with the struts. Laws of force that have no derivative (the Coulomb switch) count
    as absent.
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
    """a, and (da/dq, da/dv), (nodes, 3, nodes, 3) each."""
    a = lambda q, v: smooth_acceleration(scene, 0.0, q, v)  # noqa: E731
    return a(q, v), jax.jacfwd(a, (0, 1))(q, v)


def _constraints(scene: Scene, q: np.ndarray) -> np.ndarray:
    """(constraints, 3 nodes): the direction in which each holds; those of rigid struts come first."""
    size = float(length_scale(scene))
    rows = (constraint.directions(q, size).reshape(-1, q.size) for constraint in scene.constraints)
    return np.concatenate([np.zeros((0, q.size)), *rows])


def _turning(scene: Scene, q: np.ndarray, forces: np.ndarray) -> np.ndarray:
    """(3 nodes, 3 nodes), N/m: change of the rigid struts' forces as the struts turn, (1 - u u^T) f / l."""
    change = np.zeros((*q.shape, *q.shape))
    for (i, j), force in zip(held_edges(scene), forces):
        d = q[i] - q[j]
        across = force / np.linalg.norm(d) * (np.eye(3) - np.outer(d, d) / (d @ d))
        for a, b, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
            change[a, :, b] += sign * across
    return change.reshape(q.size, q.size)


@typed
def stable_step(scene: Scene, state: State, method: Method | str) -> float:
    """Largest step (s) at which no small motion about `state` grows by `GROWTH` a step more in `method` than in truth.

    Infinite for implicit methods. It speaks of small motions: smooth friction chatters beyond it, and blows up later.
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
        low, high = (middle, high) if np.all(_excess(linear, values, method, middle) <= 1 + GROWTH) else (low, middle)
    return float(low)


def _excess(linear: Linearised, values: np.ndarray, method: Method, h: float) -> np.ndarray:
    """By how much more than in truth one step multiplies each mode; with constraints, each mode of the step."""
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
    """The member, contact or damping with the largest share in the motion that limits `stable_step`, by name."""
    linear = linearise(scene, state)
    values, shapes = linear.modes()
    size = np.abs(values) if method.constrained else _excess(linear, values, method, 1.01 * _largest(linear, method))
    worst = np.argmax(size)
    q, v = (np.asarray(x, float) for x in state)
    shape = np.stack([shapes[:, worst].real, shapes[:, worst].imag]).reshape(2, *q.shape)
    with jax.enable_x64(True), evaluated():
        shares = part_shares(as_dtype(scene, "float64"), q, v, shape, np.asarray(np.abs(values[worst])))
    names = [x for law in scene.laws if isinstance(law, ForceTerm) for x in named_parts(law, scene)]
    return names[int(np.argmax(np.abs(np.concatenate(shares))))]


@eqx.filter_jit
def part_shares(scene: Scene, q: NodeVectors, v: NodeVectors, shape: AnyArray, rate: Scalar) -> list[AnyArray]:
    """For each term of U and R, the share of each of its parts in the motion `shape` (real and imaginary part).

    It is x·dF for the forces F of that part, with dF = dF/dq x + rate dF/dv x.
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
    """N, (nodes, 3), of one term of U or R."""
    scene, (q, t) = motion.at.scene, motion.at[:2]
    if isinstance(term, EnergyTerm):
        return -jax.grad(lambda q: term.energy(scene.configuration(q, t)))(q)
    assert isinstance(term, DissipationTerm), "a term whose force is a gradient is one of U or of R"
    return -jax.grad(lambda v: term.dissipation(scene.motion(v, q, t, motion.normal_force)))(motion.v)


def aloft(scene: Scene) -> tuple[Scene, State]:
    """The structure at rest and undeformed, away from any ground.

    It is lifted, so that the compiled program is that of the robot standing. Terms of one's own may depend on the
    place, and uneven ground may be anywhere: where there are some, the ground is taken away instead.
    """
    q = np.asarray(scene.structure.nodes, float)
    if scene.terms or (scene.ground is not None and scene.ground.surface is not None):
        return dataclasses.replace(scene, ground=None, friction=None), (q, 0 * q)
    return scene, (q + np.array([0.0, 0.0, 1e3 * float(length_scale(scene))]), 0 * q)


def all_taut(scene: Scene) -> Scene:
    """The scene without its gait, and with rest lengths shortened until no cable is slack in the structure's shape."""
    scene, cables = with_gait(scene, None), scene.structure.cables
    if cables is None:
        return scene
    lengths = edge_lengths(scene.structure.nodes, cables.edges)
    taut = np.minimum(np.asarray(cables.rest_length, float), (1 - 1e-9) * lengths)
    return eqx.tree_at(lambda s: s.structure.cables.rest_length, scene, taut)


def strictest(scene: Scene, method: Method) -> tuple[float, Scene, State]:
    """The smaller stable step (s) of the structure standing and aloft, all cables taut, and what it belongs to.

    Penalty contact and friction limit it standing; exact contact holds nodes, and so lets it stand at larger steps.
    Cables that are slack at first count, for in motion they may be taut.
    """
    return min(((stable_step(*case, method), *case) for case in _cases(scene)), key=lambda x: x[0])


def _cases(scene: Scene) -> list[tuple[Scene, State]]:
    """Standing and aloft, all cables taut."""
    return [(taut := all_taut(scene), standing(taut)), aloft(taut)]


class StepLimit(NamedTuple):
    """The largest fixed step that a scene allows a method."""

    step: float
    """s"""
    set_by: str
    """the member, contact or damping that sets it, by name"""


@typed
def step_limit(scene: Scene, method: Method | str) -> StepLimit:
    """The largest stable step of a scene, standing and aloft, and what sets it; infinite where nothing does.

    Args:
        scene: the scene to simulate.
        method: or its name.

    Raises:
        InputError: no method of this name.

    Example:
        >>> limit = jaxgrity.stepping.step_limit(jaxgrity.load_scene("exact"), "complementarity")
        >>> round(limit.step, 3), limit.set_by.split()[0]  # s, and "cable 2 (nodes 0, 8)" or one that is its image
        (0.036, 'cable')
    """
    step, taut, state = strictest(scene, method := find_method(method) if isinstance(method, str) else method)
    return StepLimit(step, limiting_part(taut, state, method) if np.isfinite(step) else "nothing")


@typed
def default_step(scene: Scene, method: Method) -> float:
    """The largest of 1, 2, 5 times a power of ten (s) up to 0.4 of the stable step, and up to `LARGEST_STEP`.

    Round, so that frames fall on steps: at another size, the same motion may get a step up to 2.5 times as small."""
    target = min(0.4 * strictest(scene, method)[0], LARGEST_STEP * float(time_scale(scene)))
    power = 10.0 ** np.floor(np.log10(target))
    return float(max(m * power for m in (1, 2, 5) if m * power <= target * (1 + 1e-9)))


def step_fault(scene: Scene, method: Method, dt: float) -> str:
    """What is wrong where a fixed step `dt` would blow up: the largest stable step and what sets it; else no words."""
    if method.implicit or all(_surely_stable(*case, method, dt) for case in _cases(scene)):
        return ""
    limit, taut, state = strictest(scene, method)
    words = (
        f"dt = {dt:g} s is too large for {method.name} on this scene; expected at most {limit:.3g} s, the largest "
        f"stable step, set by {limiting_part(taut, state, method)}"
    )
    return words if dt > limit else ""


def _surely_stable(scene: Scene, state: State, method: Method, dt: float) -> bool:
    """Whether `dt`, its half and its quarter are stable, and within `stable_step`'s range: a look, not a search."""
    linear = linearise(scene, state)
    values = linear.modes()[0]
    if not values.any():
        return True
    stable = all(np.all(_excess(linear, values, method, h) <= 1 + GROWTH) for h in (dt, dt / 2, dt / 4))
    return stable and bool(dt * np.abs(values).max() < WIDEST)


@typed
def default_method(scene: Scene) -> Method:
    """The first of the methods that meet constraints for scenes with rigid struts or exact contact, else the first."""
    return constrained_method() if scene.constrained else next(iter(METHODS.values()))
