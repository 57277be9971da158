"""The largest stable step of a method on a scene, predicted from the linearised dynamics."""

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.quick import compiled_quickly
from jaxgrity.core.tracing import evaluated
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, NodeVectors, Scalar, State
from jaxgrity.model.actuation import rest_length
from jaxgrity.model.body_points import independent_nodes
from jaxgrity.model.laws import DissipationTerm, EnergyTerm, ForceTerm, named_parts
from jaxgrity.model.pulleys import built_lengths
from jaxgrity.model.scales import length_scale, time_scale
from jaxgrity.model.scene import Scene, as_dtype, with_gait
from jaxgrity.stepping.leading_modes import leading_modes, surely_stable
from jaxgrity.stepping.linearised import GROWTH, WIDEST, Linearised, growth, largest_step, linearise
from jaxgrity.stepping.methods import Method, find_method
from jaxgrity.stepping.sparse_motion import SparseMotion, sparse_motion

STANDS_ON = 3
"""Smallest number of nodes that carry the weight on uneven ground, where only one touches at first."""
DENSE = 150
"""Most independent coordinates for which all motions are computed. Beyond, a sparse solver finds those that limit the
step."""
LARGEST_STEP = 5e-3
"""Largest default step, s for a body of one metre. The time of an impact is known only to a step."""


@typed
def standing(scene: Scene) -> State:
    """The undeformed structure at rest in its pose, with its lowest nodes pressed into the ground by its weight.

    On exact ground they touch it. Supports move along, and the lowest are of the nodes that may move. Without ground,
    and on supports over exact ground, the structure stays where it is.
    """
    q, loose = np.asarray(scene.structure.nodes, float), np.asarray(scene.structure.free.any(1))
    if scene.ground is None or (scene.structure.fixed and (scene.ground.impulsive or not loose.any())):
        return q, 0 * q
    # what is held may be lower, and never lands: it counts as the highest of the others
    given, q = q, np.where(loose[:, None], q, q[np.argmax(np.where(loose, q[:, 2], -np.inf))])
    height, size = scene.ground.measured(q).distance, float(length_scale(scene))
    lowest = np.isclose(height, height.min(), atol=1e-6 * np.ptp(q, axis=0).max() + 1e-12 * size)
    with evaluated():
        weight = float(scene.structure.mass) * float(scene.gravity or 0.0)
    carrying = int(lowest.sum()) if scene.ground.surface is None else max(int(lowest.sum()), min(STANDS_ON, len(q)))
    depth = scene.ground.touching_depth(weight, carrying, size)
    moved = scene.ground.set_down(q, depth, size)
    return (moved if loose.all() else given + (moved - q)[np.argmax(loose)]), 0 * q


@typed
def stable_step(scene: Scene, state: State, method: Method | str) -> float:
    """Largest stable step, s, for small motions about a state; infinite for implicit methods.

    At this step, small motions grow by at most `GROWTH` per step beyond their true growth. At a slightly larger step,
    smooth friction only chatters, and at a much larger one the motion blows up.

    Args:
        scene: the scene to simulate.
        state: positions q, m, and velocities v, m/s, (nodes, 3) each.
        method: a name, as in `METHODS`, or a `Method`.

    Raises:
        InputError: an unknown method.
    """
    method = find_method(method) if isinstance(method, str) else method
    return np.inf if method.implicit else largest_step(_limiting_motions(scene, state, method), method)


def _limiting_motions(scene: Scene, state: State, method: Method) -> Linearised:
    """The linearised motion, of large structures that in the span of the motions that limit the step."""
    motion = _sparse_if_large(scene, state)
    return linearise(scene, state) if motion is None else leading_modes(motion, method)


def _sparse_if_large(scene: Scene, state: State) -> SparseMotion | None:
    structure = scene.structure
    independent = independent_nodes(structure.bodies, len(structure.nodes))
    return sparse_motion(scene, state) if np.count_nonzero(structure.free[list(independent)]) > DENSE else None


@typed
def limiting_part(scene: Scene, state: State, method: Method) -> str:
    """Name of the member, contact or damper with the largest share in the motion that limits `stable_step`."""
    linear = _limiting_motions(scene, state, method)
    values, shapes = linear.modes()
    size = np.abs(values) if method.constrained else growth(linear, values, method, 1.01 * largest_step(linear, method))
    worst = np.argmax(size)
    q, v = (np.asarray(x, float) for x in state)
    shape = np.stack([shapes[:, worst].real, shapes[:, worst].imag]).reshape(2, *q.shape)
    with jax.enable_x64(True), evaluated():
        shares = part_shares(as_dtype(scene, "float64"), q, v, shape, np.asarray(np.abs(values[worst])))
    names = [x for law in scene.laws if isinstance(law, ForceTerm) for x in named_parts(law, scene)]
    return names[int(np.argmax(np.abs(np.concatenate(shares))))]


@compiled_quickly
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

        # all factors are 1: the derivative by a factor is the work of its part
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
    taut = np.minimum(rest_length(cables, None, 0.0, 0), (1 - 1e-9) * built_lengths(cables, scene.structure.nodes))
    return eqx.tree_at(lambda s: s.structure.cables, scene, dataclasses.replace(cables, rest_length=taut, motors=()))


def strictest(scene: Scene, method: Method, enough: float = np.inf) -> tuple[float, Scene, State]:
    """The smaller of the stable steps standing and aloft, s, with all cables taut, and its case; at most `enough`, s.

    Penalty contact and friction limit the standing robot. Exact contact holds nodes, and allows larger steps. Slack
    cables count as taut, since they may become taut.
    """
    cases = _cases(scene)
    if method.implicit:
        return enough, *cases[0]
    limit, strict = enough, cases[0]
    for case in cases:
        motion = _sparse_if_large(*case)
        # bounds are cheap; eigenvalues of large structures are sought only where the bounds cannot say
        if motion is not None and np.isfinite(limit) and surely_stable(motion, method, limit):
            continue
        found = largest_step(linearise(*case) if motion is None else leading_modes(motion, method), method)
        limit, strict = (found, case) if found < limit else (limit, strict)
    return limit, *strict


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
    most = _rounded(LARGEST_STEP * float(time_scale(scene)))
    return _rounded(0.4 * strictest(scene, method, most / 0.4)[0])


def _rounded(step: float) -> float:
    """The largest of 1, 2 and 5 times powers of ten that is at most `step`."""
    power = 10.0 ** np.floor(np.log10(step))
    return float(max(m * power for m in (1, 2, 5) if m * power <= step * (1 + 1e-9)))


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
    motion = _sparse_if_large(scene, state)
    if motion is not None:
        return surely_stable(motion, method, dt)
    linear = linearise(scene, state)
    values = linear.modes()[0]
    if not values.any():
        return True
    stable = all(np.all(growth(linear, values, method, h) <= 1 + GROWTH) for h in (dt, dt / 2, dt / 4))
    return stable and bool(dt * np.abs(values).max() < WIDEST)
