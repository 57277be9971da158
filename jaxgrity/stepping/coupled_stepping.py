"""Complementarity stepping with all struts and contacts solved together.

It is for scenes that sweeps cannot solve: those with rods with mass, rigid bodies, supports, balls on the ground, or
contact along or between struts. `options.py` also chooses it where sweeps may fail: if struts share nodes, or for very
unequal masses or high friction.

A step goes through these modules: `coupled_constraints.py` (constraints), `separate_parts.py` (parts of the structure),
`coupled_problem.py` (matrices), `coupled.py` (the solution), `coupled_contacts.py` (the contacts in it).
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.primitives import inverse
from jaxgrity.core.types import MemberVectors, NodeVectors, Scalar
from jaxgrity.model.scales import speed_scale
from jaxgrity.model.scene import Scene
from jaxgrity.model.shaking import moved_along
from jaxgrity.stepping.capsules import capsules_of, ends_of
from jaxgrity.stepping.complementarity import (
    LARGEST_LENGTH_ERROR,
    Complementarity,
    CoupledState,
    Lift,
    first_memory,
    kick_of,
    one_robot,
)
from jaxgrity.stepping.constraints import GroundImpulses
from jaxgrity.stepping.coupled import Impulses, solve_step
from jaxgrity.stepping.coupled_constraints import (
    Constraints,
    Known,
    constraints_of,
    contact_nodes,
    known_at,
    links_on_nodes,
    moving_nodes,
    velocities_of_all,
)
from jaxgrity.stepping.coupled_problem import lengths_after, problem_of
from jaxgrity.stepping.separate_parts import Alike, of_parts, put_together, separate_parts
from jaxgrity.stepping.strut_contacts import TouchingStruts, points_between, touching_struts

LARGEST_SPEED_ERROR = 1e-3
"""Largest difference, m/s for a body of one metre, between a velocity and the one that the impulses give, if struts and
contacts are solved together."""


class StepImpulses(NamedTuple):
    """The result of a step."""

    velocity: NodeVectors
    """m/s"""
    impulses: GroundImpulses
    """m/s: of the ground, over the mass that rests on each node"""
    struts: NodeVectors
    """N s"""
    error: Scalar
    """m/s: see `Impulses`"""
    stretch: Scalar
    """likewise"""
    off: Scalar
    """m, by which a strut is off its length, at most"""


def coupled_impulses(
    scene: Scene,
    times: tuple[Scalar, Scalar],
    q: NodeVectors,
    known: Known,
    start: NodeVectors,
    near: NodeVectors,
    last: GroundImpulses,
) -> StepImpulses:
    """Solve the step of `times` (its size h and its end, s) from `q`, m.

    `known`: see `known_at`; `start`: the velocities by forces alone; `near`: some near the solution; `last`: the
    ground's impulses of the last step.
    """
    h, _ = times
    mass, rows, nodes = scene.structure.borne_mass, contact_nodes(scene), moving_nodes(scene)
    constraints = constraints_of(scene, times, known, start)
    guess = jnp.stack([last.normal, *last.tangential], axis=1) * mass[:, None]
    guesses, along, struts = [guess[rows]], None, None
    if last.along_struts is not None:
        guesses.append(last.along_struts)
    if known.between is not None:
        guesses.append(last.between_struts[known.between])
    found = _solved(constraints, separate_parts(scene), jnp.concatenate(guesses), near[nodes])
    at_nodes, *others = jnp.split(found.ground, np.cumsum([len(each) for each in guesses])[:-1])
    if last.along_struts is not None:
        along = others[0]
    if known.between is not None:
        struts = jnp.zeros_like(last.between_struts).at[known.between].set(others[-1])
    exerted = at_nodes if len(rows) == len(q) else jnp.zeros_like(q).at[rows].set(at_nodes)
    p = exerted * inverse(mass)[:, None]
    off: Scalar = jnp.zeros_like(found.error)
    pulls: NodeVectors = jnp.zeros_like(q)
    if constraints.apart is not None:
        off = h * jnp.max(jnp.abs(lengths_after(constraints, found.velocity) - constraints.goal))
        pulls = links_on_nodes(scene, known.placed, found.struts)
    impulses = GroundImpulses(p[:, 0], (p[:, 1], p[:, 2]), along, struts)
    w = velocities_of_all(scene, h, q, known.placed, found.velocity)
    return StepImpulses(w, impulses, pulls, found.error, found.stretch, off)


def _solved(
    constraints: Constraints, parts: tuple[Alike, ...] | None, guess: MemberVectors, near: NodeVectors
) -> Impulses:
    """The solution of a step, of each kind of parts apart."""
    if parts is None:
        return solve_step(problem_of(constraints), guess, near)
    found = []
    # the cost of a factorisation grows with the cube of its size: many small ones cost less than one
    for alike in parts:
        problems = jax.vmap(problem_of)(of_parts(constraints, alike))
        found.append(solve_step(problems, guess[alike.contacts], near[alike.nodes], side_by_side=True))
    velocity, struts, ground, *errors = (list(each) for each in zip(*found))
    nodes, rows, contacts = (list(numbers) for numbers in zip(*parts))
    return Impulses(
        put_together(constraints.start, nodes, velocity),
        put_together(jnp.zeros((len(constraints.ends), 3), near.dtype), rows, struts),
        put_together(jnp.zeros_like(guess), contacts, ground),
        *(jnp.max(jnp.concatenate(error)) for error in errors),
    )


class CoupledImpulses(Complementarity):
    """Impulses of contacts and struts by Newton's method (`coupled.py`), without sweeps."""

    tolerance: Scalar | None = None
    lift: Lift = eqx.field(static=True, default=one_robot)

    def init(self, terms, t0, t1, y0, args):
        step_size, impulses, _ = first_memory(t0, t1, y0)
        none = lambda points: jnp.zeros_like(y0[1], shape=(points, *y0[1].shape[1:]))  # noqa: E731
        if (capsules := capsules_of(args)) is not None:
            impulses = impulses._replace(along_struts=none(len(ends_of(capsules)[0])))
        if points := points_between(args):
            impulses = impulses._replace(between_struts=none(points))
        return CoupledState(step_size, impulses, 0 * y0[1], jnp.zeros_like(y0[1][0, 0]))

    def velocity_after_impulses(self, field, ends, start, scene, memory):
        (q, v), (t0, t1) = start, ends
        h, (kick, acting) = t1 - t0, kick_of(scene, ends, memory)
        touching = TouchingStruts()
        if capsules_of(scene) is not None or points_between(scene):
            touching = self.lift(touching_struts, ("s", None, -1))(scene, h, start)
        known = self.lift(known_at, ("s", None, -1, -1))(scene, h, start, touching)

        def solved(carry, first):
            """The step with dampers at the mean of its first and last velocities, as far as these are known."""
            before, impulses = carry
            _, a = field(t0, (q, (v + before) / 2), acting)
            free = v + kick * a
            found = self._solved(scene, ends, q, known, free, jnp.where(first, free, before), impulses)
            return (found.velocity, found.impulses), found

        # robots that rest or slide need nearly the impulses of their last step: Newton's method begins there
        before = (v, memory.impulses)
        if scene.dissipates:
            # the first solution predicts the velocity, which is of second order. A loop, since to compile the solver
            # twice takes twice as long
            found = jax.tree.map(lambda x: x[-1], jax.lax.scan(solved, before, np.array([True, False]))[1])
        else:
            found = solved(before, True)[1]
        if touching.each_other is not None:
            found = found._replace(stretch=jnp.where(touching.each_other.missed, jnp.inf, found.stretch))
        return self._finished(scene, h, found, memory)

    def _solved(self, scene, ends, q, known, free, near, impulses):
        """One solution of the step between the `ends`, s, with the velocities `free` without impulses, m/s."""
        solve, (t0, t1) = self.lift(coupled_impulses, ("s", None, *[-1] * 5)), ends
        return solve(scene, (t1 - t0, t1), q, known, self._carried(scene, t0, t1, free), near, impulses)

    def _finished(self, scene, h, found, memory):
        """w, m/s, of a step of h (s), and its memory."""
        fastest = LARGEST_SPEED_ERROR * speed_scale(scene)
        met = (found.stretch <= LARGEST_LENGTH_ERROR) & (found.error <= fastest)
        if self.tolerance is not None:
            met = met & (found.off <= self.tolerance)
        # a step that is not solved ends this robot alone: its failure code reads NaN
        w = jnp.where(met, found.velocity, jnp.nan)
        taken = jnp.broadcast_to(h, jnp.shape(memory.step_size))
        return w, CoupledState(taken, found.impulses, found.struts, found.error)

    def _carried(self, scene, t0, t1, v):
        """Velocities with those of moving supports: their places after the step are known."""
        if scene.shaking is None:
            return v
        one = lambda scene, v: moved_along(scene.shaking, scene.structure, t0, t1, v)  # noqa: E731
        return self.lift(one, ("s", -1))(scene, v)
