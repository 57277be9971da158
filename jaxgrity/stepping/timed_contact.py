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

from jaxgrity.core.primitives import component, store_cotangent
from jaxgrity.core.types import AnyArray, NodeVectors, PerNode, PerRow, Scalar, State
from jaxgrity.model.ground import ExactGround
from jaxgrity.model.scales import length_scale, speed_scale
from jaxgrity.model.scene import Scene
from jaxgrity.stepping.blocks import Components
from jaxgrity.stepping.complementarity import TimedState, first_memory, kick_of
from jaxgrity.stepping.constraints import (
    StepProblem,
    Trials,
    blocks_of,
    contacts_of,
    exact_ground,
    step_problem,
    trials_of,
    usual_sweeps,
    velocities,
)
from jaxgrity.stepping.entering import Met, depth_inside, landings, where_met
from jaxgrity.stepping.ground_response import SLOWEST, Timing, velocity
from jaxgrity.stepping.swept import SweptImpulses

FULL = 1.5
"""Time from the start of a step in which a node lands to the middle of the next step, in steps."""


def untimed(scene: Scene, coupled: bool) -> str | None:
    """What of a scene has no landings at their own time; None: nothing."""
    if coupled or len(blocks_of(scene).groups) > 1:
        return "this scene's struts and contacts are solved together"
    ground = exact_ground(scene)
    return (
        "bounces (restitution) have no second half" if ground is not None and ground.restitution is not None else None
    )


class TimedImpulses(SweptImpulses):
    """Impulses by sweeps, with landings at their own time and friction against the mean velocity."""

    def init(self, terms, t0, t1, y0, args):
        step_size, impulses = first_memory(t0, t1, y0)
        return TimedState(step_size, impulses, jnp.zeros_like(impulses.normal))

    def velocity_after_impulses(self, field, ends, start, scene, memory):
        if exact_ground(scene) is None or scene.friction is None:
            w, after = super().velocity_after_impulses(field, ends, start, scene, memory)
            return w, TimedState(*after, memory.landed)
        (q, v), (t0, t1) = start, ends
        h, (kick, acting) = t1 - t0, kick_of(scene, ends, memory)
        accelerated = lambda v: store_cotangent(field(t0, (q, v), acting)[1])  # noqa: E731
        problem = self.lift(step_problem, ("s", None, None, -1, -1))(scene, h, t1, q, v)
        early = self.lift(shares_before_landing, ("s", None, -1))(scene, h, start)
        first = jax.tree.map(
            store_cotangent, self.lift(landing_problem, ("s", None, -1, -1, -1))(scene, h, start, problem, early)
        )
        a = accelerated(v)
        # no forces yet on struts that landed in the last step
        trials = self.lift(trials_of, ("s", -1))(scene, v)
        trials = self.lift(kicked, ("s", -1, -1, -1, -1))(scene, trials, kick * a, 0 * a, memory.landed)
        trials = self._constrain(scene, h, first, trials, usual_sweeps(scene), converged=False)
        guess = self.lift(velocities, ("s", -1, -1))(scene, first, trials)
        corrected = accelerated((v + guess) / 2) if scene.dissipates else a
        last = self.lift(sliding_problem, ("s", None, -1, -1, -1, -1))(scene, h, start, first, guess, memory[1:])
        trials = self.lift(after_landing, ("s", -1, -1, -1))(scene, first, trials, memory.landed)
        trials = self.lift(kicked, ("s", -1, -1, -1, -1))(
            scene, trials, kick * (corrected - a), kick * corrected, memory.landed
        )
        w, after = self._finished(scene, h, last, trials, memory)
        pressed = after.impulses.normal > 0
        return w, TimedState(*after, jnp.where(pressed, early, 0))


def shares_before_landing(scene: Scene, h: Scalar, start: State) -> PerNode:
    """The share of a step of h (s) before each node lands at its velocity; 1 if it does not, 0 if it touches already.

    `start` is (q, v), m and m/s.
    """
    met, deep = _met(scene, h, start)
    gap, approach, _ = landings(_ground(scene), length_scale(scene), h, start[1], met)
    way = jnp.maximum(jnp.maximum(-h * approach, gap), deep)
    return jnp.where(gap > deep, gap / way, 0)


def landing_problem(scene: Scene, h: Scalar, start: State, problem: StepProblem, early: PerNode) -> StepProblem:
    """The problem of a step in which nodes slide on before they land, after the share `early` of it."""
    v, met = start[1], _met(scene, h, start)[0]
    offset = tuple(early * component(v, t) for t in met.frame.tangents)
    return problem._replace(timing=_timing(scene, offset, jnp.ones_like(early)))


def sliding_problem(
    scene: Scene, h: Scalar, start: State, problem: StepProblem, guess: NodeVectors, memory: tuple
) -> StepProblem:
    """The problem with friction against the mean of v and w on nodes that slid, from a `guess` of w, m/s.

    `memory` has the impulses of the last step, and the shares of it before nodes landed. A node that a landing stopped
    slides from the landing on.
    """
    v, (before, landed) = start[1], memory
    met, deep = _met(scene, h, start)
    touching = met.distance <= deep
    least = (SLOWEST * speed_scale(scene)) ** 2
    old, new = (tuple(component(x, t) for t in met.frame.tangents) for x in (v, guess))
    speeds = [jnp.sqrt(x * x + y * y + least) for x, y in (old, new)]
    slid = touching & (before.normal > 0) & (landed == 0)
    mean = jnp.where(slid, -jnp.minimum(1, speeds[1] / speeds[0]), shares_before_landing(scene, h, start))
    stopped = touching & (landed > 0) & (new[0] == 0) & (new[1] == 0)
    return problem._replace(timing=_timing(scene, tuple(mean * x for x in old), jnp.where(stopped, FULL - landed, 1)))


def after_landing(scene: Scene, problem: StepProblem, trials: Trials, landed: PerNode) -> Trials:
    """Trial impulses without the ground's impulses on struts that `landed` in the last step: they are paid."""
    parts = zip(contacts_of(scene, problem), trials, _hit(scene, landed))
    return tuple(_chosen(hit, velocity(contact, trial) * -1, trial) for contact, trial, hit in parts)


def kicked(scene: Scene, trials: Trials, change: NodeVectors, on_landed: NodeVectors, landed: PerNode) -> Trials:
    """Trial impulses after the `change` of velocities, m/s; `on_landed` on struts that landed in the last step."""
    layout, ground = blocks_of(scene), exact_ground(scene)
    parts = zip(trials, layout.split(change, ground), layout.split(on_landed, ground), _hit(scene, landed))
    return tuple(trial - _chosen(hit, there, here) for trial, here, there, hit in parts)


def _hit(scene: Scene, landed: PerNode) -> tuple[AnyArray, ...]:
    """For each block whether a node of the node's strut landed."""
    layout = blocks_of(scene)
    marks = layout.numbers(landed)
    if layout.by_struts:
        both = marks[0] + marks[1]
        marks = (both, both, *marks[2:])
    return tuple(mark > 0 for mark in marks)


def _chosen(which: AnyArray, one: Components, other: Components) -> Components:
    return Components(*(jnp.where(which, a, b) for a, b in zip(one.each, other.each)))


def _timing(scene: Scene, offset: tuple[PerRow, ...], sliding: PerNode) -> tuple[Timing, ...]:
    layout = blocks_of(scene)
    parts = zip(*(layout.numbers(x) for x in (*offset, sliding)))
    return tuple(Timing((first, second), share) for first, second, share in parts)


def _ground(scene: Scene) -> ExactGround:
    return cast(ExactGround, exact_ground(scene))


def _met(scene: Scene, h: Scalar, start: State) -> tuple[Met, Scalar]:
    """The ground that each node meets, and the depth from which on it touches, m."""
    size = length_scale(scene)
    return where_met(_ground(scene), size, h, *start), depth_inside(size, start[0].dtype)
