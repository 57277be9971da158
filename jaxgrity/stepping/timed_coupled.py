"""Landings at their own time, and friction in the middle of the step, with struts and contacts solved together.

The shares of landings and the timing of friction are those of `timed_contact.py`. In place of each strut stands what
moves as one: struts that share nodes, rods with mass, a rigid body (`hit_by_landings`).
"""

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.primitives import scale
from jaxgrity.core.types import NodeVectors, PerNode, Scalar, State
from jaxgrity.model.scene import Scene
from jaxgrity.stepping.complementarity import kick_of
from jaxgrity.stepping.constraints import exact_ground
from jaxgrity.stepping.coupled_constraints import Known, contact_nodes, known_at, moving_nodes
from jaxgrity.stepping.coupled_stepping import CoupledImpulses, StepImpulses
from jaxgrity.stepping.separate_parts import hit_by_landings
from jaxgrity.stepping.strut_contacts import TouchingStruts
from jaxgrity.stepping.timed_contact import (
    Slips,
    shares_before_landing,
    timing_before_landings,
    timing_of_slides,
)


class TimedCoupledImpulses(CoupledImpulses):
    """Impulses by a coupled solve, with landings at their own time and friction against the mean velocity."""

    def init(self, terms, t0, t1, y0, args):
        first = super().init(terms, t0, t1, y0, args)
        return first._replace(landed=jnp.zeros_like(first.impulses.normal))

    def velocity_after_impulses(self, field, ends, start, scene, memory):
        if exact_ground(scene) is None or scene.friction is None:
            w, after = super().velocity_after_impulses(field, ends, start, scene, memory)
            return w, after._replace(landed=memory.landed)
        (q, v), (t0, t1) = start, ends
        h, (kick, acting) = t1 - t0, kick_of(scene, ends, memory)
        known = self.lift(known_at, ("s", None, -1, -1))(scene, h, start, TouchingStruts())
        hit = self.lift(hit_by_landings, ("s", -1))(scene, memory.landed)
        timed = self.lift(with_timing, ("s", None, *[-1] * 4, None))
        free = self.lift(by_forces, (*[-1] * 4, None))

        def solved(carry, last):
            """The first round without forces on what has landed, and the last with the rest of the step's."""
            guess, impulses = carry
            _, a = field(t0, (q, (v + guess) / 2), acting)
            there = timed(scene, h, start, known, guess, (memory.impulses.normal, memory.landed), last)
            begun = free(v, guess, kick * a, hit, last)
            found = self._solved(scene, ends, q, there, begun, jnp.where(last, guess, begun), impulses)
            return (found.velocity, found.impulses), found

        rounds = jax.lax.scan(solved, (v, memory.impulses), np.array([False, True]))[1]
        found = self.lift(with_first_round, (-1, -1))(rounds, hit)
        w, after = self._finished(scene, h, found, memory)
        early = self.lift(shares_of_nodes, ("s", None, -1))(scene, h, start)
        return w, after._replace(landed=jnp.where(after.impulses.normal > 0, early, 0))


def by_forces(v: NodeVectors, guess: NodeVectors, gained: NodeVectors, hit: PerNode, last: Scalar) -> NodeVectors:
    """Velocities without impulses (m/s) in a round: v and what forces add, `gained`.

    Nodes that are `hit` have v alone in the first round, and in the `last` one what it led to, `guess`, and all forces.
    """
    return v + scale(guess - v, last * hit) + scale(gained, 1 - (1 - last) * hit)


def with_timing(
    scene: Scene,
    h: Scalar,
    start: State,
    known: Known,
    guess: NodeVectors,
    last: tuple[PerNode, PerNode],
    final: Scalar,
) -> Known:
    """What is known of a step, with the timing of its contacts in the first or the `final` round.

    `guess` is a prediction of w, m/s. `last` has the normal impulses of the last step, and the shares of it before
    nodes landed.
    """
    rows, contact = contact_nodes(scene), known.contact
    assert contact is not None, "a scene without exact ground takes the plain method"
    old, new = (_slips(scene, known, velocities) for velocities in (start[1], guess))
    before = timing_before_landings(scene, h, start, old)
    after = timing_of_slides(scene, h, start, (old, new), (last[0][rows], last[1][rows]))
    timing = jax.tree.map(lambda a, b: jnp.where(final, b, a), before, after)
    timing = timing._replace(mass=jnp.asarray(scene.structure.borne_mass)[rows])
    return known._replace(contact=contact._replace(timing=timing))


def _slips(scene: Scene, known: Known, velocities: NodeVectors) -> Slips:
    """m/s, of each contact along its tangents."""
    moving = velocities[moving_nodes(scene)]
    of_contacts = moving[:, None] if known.weights is None else jnp.einsum("can,nk->cak", known.weights, moving)
    along = jnp.sum(known.frame * of_contacts, axis=2)
    return along[:, 1], along[:, 2]


def with_first_round(rounds: StepImpulses, hit: PerNode) -> StepImpulses:
    """The last of two rounds, with the impulses of the first one on nodes that are `hit`."""
    first, last = jax.tree.map(lambda x: x[0], rounds), jax.tree.map(lambda x: x[1], rounds)
    return last._replace(
        impulses=jax.tree.map(lambda a, b: hit * a + b, first.impulses, last.impulses),
        struts=scale(first.struts, hit) + last.struts,
        error=jnp.maximum(last.error, jnp.where(jnp.any(hit > 0), first.error, 0)),
    )


def shares_of_nodes(scene: Scene, h: Scalar, start: State) -> PerNode:
    """`shares_before_landing` of all nodes: 0 for those that pass through the ground."""
    shares, rows = shares_before_landing(scene, h, start), contact_nodes(scene)
    return shares if len(rows) == len(start[0]) else jnp.zeros_like(start[0][:, 0]).at[rows].set(shares)
