"""Complementarity stepping whose contacts are of second order: landings at their own time, friction in the middle.

The plain scheme closes the gap of a node that lands by a normal velocity, so that its impulse acts on positions from
the time of the landing on. Friction knows of no such time there, and three errors are of first order. Here

- a node that lands slides up to its landing, after the share s of its step: friction acts against w_t - s v_t,
- friction on a node that slid before acts against the mean of old and new velocity,
- a landing has its second half in the next step. That half is found first, without forces. Else its large normal
  impulse would let friction hold the node against the forces too, for the whole step.
"""

from typing import cast

import jax
import jax.numpy as jnp

from jaxgrity.core.primitives import component, scale, store_cotangent
from jaxgrity.core.types import AnyArray, NodeVectors, PerNode, Scalar, State
from jaxgrity.model.ground import ExactGround
from jaxgrity.model.scales import length_scale, speed_scale
from jaxgrity.model.scene import Scene
from jaxgrity.model.slides import slides_of
from jaxgrity.stepping.blocks import Components
from jaxgrity.stepping.capsules import capsules_of
from jaxgrity.stepping.complementarity import kick_of
from jaxgrity.stepping.constraints import (
    GroundImpulses,
    StepProblem,
    Trials,
    blocks_of,
    contacts_of,
    exact_ground,
    impulses,
    step_problem,
    trials_of,
    usual_sweeps,
    velocities,
    with_change,
)
from jaxgrity.stepping.entering import Met, contacts_met, depth_inside, landings
from jaxgrity.stepping.ground_response import SLOWEST, Timing, velocity
from jaxgrity.stepping.separate_parts import hit_by_landings
from jaxgrity.stepping.strut_contacts import points_between
from jaxgrity.stepping.swept import SweptImpulses

FULL = 1.5
"""Time from the start of a step in which a node lands to the middle of the next step, in steps."""
STILL = 0.5
"""Power of the rounding error: this share of the speed of a body is the fastest slip of a node that sticks."""
Slips = tuple[PerNode, PerNode]
"""m/s, of each contact along both tangents of the ground"""


def untimed(scene: Scene, coupled: bool) -> str | None:
    """What of a scene has no landings at their own time; None: nothing."""
    if capsules_of(scene) is not None or points_between(scene):
        return "contact along struts, or between them, has no landings at its own time"
    if slides_of(scene) is not None:
        return "landings of nodes that slide along rods have no time of their own"
    if not coupled and len(blocks_of(scene).groups) > 1:
        return "sweeps over struts that share nodes have no landings at their own time"
    ground = exact_ground(scene)
    return (
        "bounces (restitution) have no second half" if ground is not None and ground.restitution is not None else None
    )


class TimedImpulses(SweptImpulses):
    """Impulses by sweeps, with landings at their own time and friction against the mean velocity."""

    def init(self, terms, t0, t1, y0, args):
        first = super().init(terms, t0, t1, y0, args)
        return first._replace(landed=jnp.zeros_like(first.impulses.normal))

    def velocity_after_impulses(self, field, ends, start, scene, memory):
        if exact_ground(scene) is None or scene.friction is None:
            w, after = super().velocity_after_impulses(field, ends, start, scene, memory)
            return w, after._replace(landed=memory.landed)
        (q, v), (t0, t1) = start, ends
        h, (kick, acting) = t1 - t0, kick_of(scene, ends, memory)
        accelerated = lambda v: store_cotangent(field(t0, (q, v), acting)[1])  # noqa: E731
        problem = self.lift(step_problem, ("s", None, None, -1, -1))(scene, h, t1, q, v)
        first = jax.tree.map(store_cotangent, self.lift(landing_problem, ("s", None, -1, -1))(scene, h, start, problem))
        a, hit = accelerated(v), self.lift(hit_by_landings, ("s", -1))(scene, memory.landed)
        kicks = self.lift(kicked, ("s", -1, -1, -1, -1))
        # no forces yet on struts that landed in the last step
        trials = kicks(scene, self.lift(trials_of, ("s", -1))(scene, v), kick * a, 0 * a, hit)
        trials = self._constrain(scene, h, first, trials, usual_sweeps(scene), converged=False)
        guess = self.lift(velocities, ("s", -1, -1))(scene, first, trials)
        corrected = accelerated((v + guess) / 2) if scene.dissipates else a
        before = memory.impulses.normal, memory.landed
        last = self.lift(sliding_problem, ("s", None, -1, -1, -1, -1))(scene, h, start, first, guess, before)
        paid, trials = (
            self.lift(each, ("s", -1, -1, -1))(scene, first, trials, hit) for each in (paid_at_landings, after_landing)
        )
        trials = kicks(scene, trials, kick * (corrected - a), kick * corrected, hit)
        w, after = self._finished(scene, h, last, trials, memory)
        after = after._replace(impulses=jax.tree.map(jnp.add, after.impulses, paid))
        early = self.lift(shares_before_landing, ("s", None, -1))(scene, h, start)
        return w, after._replace(landed=jnp.where(after.impulses.normal > 0, early, 0))


def shares_before_landing(scene: Scene, h: Scalar, start: State) -> PerNode:
    """The share of a step of h (s) before each contact lands at its velocity; 1 if it does not, 0 if it touches
    already.

    `start` is (q, v), m and m/s. All nodes are contacts, or the balls.
    """
    (met, v), deep = _met(scene, h, start)
    gap, approach, _ = landings(_ground(scene), length_scale(scene), h, v, met)
    way = jnp.maximum(jnp.maximum(-h * approach, gap), deep)
    return jnp.where(gap > deep, gap / way, 0)


def timing_before_landings(scene: Scene, h: Scalar, start: State, old: Slips) -> Timing:
    """The timing of a step in which contacts slide on at their `old` slips, m/s, before they land."""
    early = shares_before_landing(scene, h, start)
    return Timing((early * old[0], early * old[1]), jnp.ones_like(early))


def timing_of_slides(
    scene: Scene, h: Scalar, start: State, slips: tuple[Slips, Slips], last: tuple[PerNode, PerNode]
) -> Timing:
    """The timing with friction against the mean of old and new slip, m/s, on contacts that slid before.

    `slips` are those of v, and of a prediction of w. `last` has the normal impulses of the last step, and the shares of
    it before contacts landed. A contact that a landing stopped slides from the landing on.
    """
    (met, _), deep = _met(scene, h, start)
    (old, new), (pressed, landed), touching = slips, last, met.distance <= deep
    size, eps = speed_scale(scene), float(jnp.finfo(start[0].dtype).eps)
    least = (SLOWEST * size) ** 2
    speeds = [jnp.sqrt(x * x + y * y + least) for x, y in (old, new)]
    slid = touching & (pressed > 0) & (landed == 0)
    mean = jnp.where(slid, -jnp.minimum(1, speeds[1] / speeds[0]), shares_before_landing(scene, h, start))
    stopped = touching & (landed > 0) & (speeds[1] <= eps**STILL * size)
    return Timing((mean * old[0], mean * old[1]), jnp.where(stopped, FULL - landed, 1))


def landing_problem(scene: Scene, h: Scalar, start: State, problem: StepProblem) -> StepProblem:
    """The problem of a step from `start` in which nodes slide on before they land."""
    (old,) = _slips(scene, h, start, start[1])
    return problem._replace(timing=_in_blocks(scene, timing_before_landings(scene, h, start, old)))


def sliding_problem(
    scene: Scene, h: Scalar, start: State, problem: StepProblem, guess: NodeVectors, last: tuple[PerNode, PerNode]
) -> StepProblem:
    """The problem with friction against the mean of v and w on nodes that slid, from a `guess` of w, m/s.

    `last`: see `timing_of_slides`.
    """
    old, new = _slips(scene, h, start, start[1], guess)
    return problem._replace(timing=_in_blocks(scene, timing_of_slides(scene, h, start, (old, new), last)))


def after_landing(scene: Scene, problem: StepProblem, trials: Trials, hit: PerNode) -> Trials:
    """Trial impulses without the ground's impulses on nodes that are `hit` (`hit_by_landings`): they are paid."""
    parts = zip(contacts_of(scene, problem), trials, blocks_of(scene).numbers(hit))
    return tuple(_chosen(which > 0, velocity(contact, trial) * -1, trial) for contact, trial, which in parts)


def kicked(scene: Scene, trials: Trials, change: NodeVectors, on_hit: NodeVectors, hit: PerNode) -> Trials:
    """Trial impulses after the `change` of velocities, m/s; `on_hit` on nodes that are `hit`."""
    return with_change(scene, trials, scale(change, 1 - hit) + scale(on_hit, hit))


def paid_at_landings(scene: Scene, problem: StepProblem, trials: Trials, hit: PerNode) -> GroundImpulses:
    """The ground's impulses on nodes that are `hit`."""
    return jax.tree.map(lambda p: hit * p, impulses(scene, problem, trials))


def _chosen(which: AnyArray, one: Components, other: Components) -> Components:
    return Components(*(jnp.where(which, a, b) for a, b in zip(one.each, other.each)))


def _slips(scene: Scene, h: Scalar, start: State, *velocities: NodeVectors) -> list[Slips]:
    """m/s, along both tangents of the ground that each node meets in a step from `start`."""
    tangents = _met(scene, h, start)[0][0].frame.tangents
    return [(component(v, tangents[0]), component(v, tangents[1])) for v in velocities]


def _in_blocks(scene: Scene, timing: Timing) -> tuple[Timing, ...]:
    """The timing of each block of nodes."""
    numbers = blocks_of(scene).numbers
    parts = zip(*map(numbers, (*timing.offset, timing.sliding)))
    return tuple(Timing((first, second), share) for first, second, share in parts)


def _ground(scene: Scene) -> ExactGround:
    return cast(ExactGround, exact_ground(scene))


def _met(scene: Scene, h: Scalar, start: State) -> tuple[tuple[Met, NodeVectors], Scalar]:
    """The ground that each contact meets, and its velocity, m/s; and the depth from which on it touches, m."""
    size = length_scale(scene)
    return contacts_met(_ground(scene), size, h, start), depth_inside(size, start[0].dtype)
