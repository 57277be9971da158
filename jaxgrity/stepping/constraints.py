"""Strut lengths, Signorini's law and Coulomb's cone as constraints on a step's velocities, solved in closed form.

Sweeps over all of them (projected Gauss-Seidel) couple them. A strut's impulse includes the ground's response at both
its ends: so sweeps are Newton steps where each node belongs to one strut.
"""

from typing import Any, NamedTuple, cast

import jax.numpy as jnp

from jaxgrity.core.primitives import accumulate, edge_vectors, inverse, length, over, scale
from jaxgrity.core.types import MemberVectors, NodeVectors, PerMember, PerNode, PerRow, Scalar
from jaxgrity.model.actuation import rest_length
from jaxgrity.model.ground import ExactGround
from jaxgrity.model.scales import length_scale, speed_scale
from jaxgrity.model.scene import Scene
from jaxgrity.model.structure import Members
from jaxgrity.stepping.blocks import Blocks, Components, blocks, components_of, largest, rows_of, xyz
from jaxgrity.stepping.entering import closing_speed, where_met
from jaxgrity.stepping.ground_response import (
    SLOWEST,
    Contact,
    Timing,
    along_own_axes,
    answered,
    ground_impulse,
    velocity,
)

HELD = 1e-2
"""Share of its free response to an impulse below which a strut counts as held by the ground at both ends."""
Trials = tuple[Components, ...]
"""of each block, the nodes' trial impulses z, m/s (see `ground_response.py`): all that sweeps change"""


class GroundImpulses(NamedTuple):
    """The change of each node's velocity by the ground, m/s."""

    normal: PerNode
    """p_n >= 0, along the ground's normal"""
    tangential: tuple[PerNode, PerNode]
    """p_t, along its two tangents"""
    along_struts: Any = None
    """(points, 3), N s, along normal and tangents of points of struts (`capsules.py`); None: struts have none"""
    between_struts: Any = None
    """(points, 3), N s, likewise of struts on each other (`strut_contacts.py`)"""


class StepProblem(NamedTuple):
    """The constants of a step's sweeps; None for constraints that the scene does not have."""

    vectors: Components | None
    """(x_i - x_j)/h of the rigid struts at the start of the step, m/s"""
    pushes: tuple[tuple[Components, ...], ...]
    """for each group of struts and each block that it reaches, how nodes move by an impulse of 1 along struts, 1/kg"""
    lengths: PerMember | None
    """L(t1)/h of the rigid struts, m/s"""
    closing: tuple[PerRow, ...] | None
    """for each block, the normal velocity at which a node reaches the ground in this step, or leaves it, m/s"""
    axes: tuple[tuple[Components, Components, Components], ...] | None
    """for each block, normal and tangents of uneven ground where it is linearised"""
    timing: tuple[Timing, ...] | None = None
    """for each block, what the second order of contact adds (`timed_contact.py`)"""


class LengthError(NamedTuple):
    """The largest length error of the rigid struts at the end of the step."""

    largest: Scalar
    """m"""
    relative: Scalar
    """of the length of the strut that it is largest for, in proportion"""


def rigid_struts(scene: Scene) -> Members | None:
    """The scene's struts where they are constraints."""
    struts = scene.structure.struts
    return struts if struts is not None and struts.rigid else None


def exact_ground(scene: Scene) -> ExactGround | None:
    """The scene's ground where it is a constraint."""
    return cast(ExactGround, scene.ground) if scene.ground is not None and scene.ground.impulsive else None


def usual_sweeps(scene: Scene) -> int:
    """4 where each node belongs to one strut, so that sweeps are Newton steps; 16 where struts share nodes.

    After four sweeps the error of the constraints is rounding, for the robots of this library at their default steps.
    Struts flat on rough ground, very unequal masses and chains of struts need more: see `docs/schemes.md`.
    """
    return 16 if len(blocks_of(scene).groups) > 1 else 4


def blocks_of(scene: Scene) -> Blocks:
    """The layout of the scene's nodes in a step's sweeps."""
    struts = rigid_struts(scene)
    return blocks(struts.edges if struts is not None else (), scene.structure.nodes.shape[0])


def step_problem(scene: Scene, h: Scalar, t1: Scalar, q: NodeVectors, v: NodeVectors) -> StepProblem:
    """The problem of a step of size h (s) that ends at t1, from positions `q` (m) and velocities `v` (m/s)."""
    struts, ground, layout = rigid_struts(scene), exact_ground(scene), blocks_of(scene)
    vectors = lengths = closing = axes = None
    pushes: tuple[tuple[Components, ...], ...] = ()
    if struts is not None:
        apart = edge_vectors(q, struts.edges)
        directions = scale(apart, inverse(length(apart)))
        pushes = tuple(_push(scene, layout, group, directions) for group in layout.groups)
        # over h, as lengths are: a sweep then compares velocities, and multiplies nothing by h
        vectors = components_of(apart, ground) * (1 / h)
        lengths = rest_length(struts, scene.gait, t1, 0) / h
    if ground is not None:
        size = length_scale(scene)
        met = where_met(ground, size, h, q, v)
        closing = layout.numbers(closing_speed(ground, size, h, v, met))
        if ground.surface is not None:
            rows = cast(tuple[NodeVectors, ...], (met.frame.normal, *met.frame.tangents))
            axes = tuple(zip(*(layout.split(axis, ground) for axis in rows)))
    return StepProblem(vectors, pushes, lengths, closing, axes)


def _push(scene: Scene, layout: Blocks, group: tuple[int, ...], directions: MemberVectors) -> tuple[Components, ...]:
    """The motion of each block's nodes by an impulse of 1 along each strut of a group, without a response."""
    inverse_mass, ground = 1 / scene.structure.node_mass, exact_ground(scene)
    if layout.by_struts:
        first, second = layout.ends(layout.numbers(inverse_mass), group)
        along_strut = components_of(directions, ground)
        of_firsts = Components(*(layout.padded(part) for part in (along_strut * first).each))
        return of_firsts, along_strut * -second
    edges = tuple(layout.edges[k] for k in group)
    on_nodes = accumulate(rows_of(directions, group), edges, len(inverse_mass))
    return layout.split(scale(on_nodes, inverse_mass), ground)


def trials_of(scene: Scene, w: NodeVectors) -> Trials:
    """The state before the first sweep: velocities `w`, m/s, and no impulses of the ground."""
    # z = p - w (`ground_response.py`), and p = 0 so far
    return tuple(part * -1 for part in blocks_of(scene).split(w, exact_ground(scene)))


def with_change(scene: Scene, trials: Trials, change: NodeVectors) -> Trials:
    """The state with `change`, m/s, added to the velocities by another cause than the ground."""
    changes = blocks_of(scene).split(change, exact_ground(scene))
    return tuple(trial - one for trial, one in zip(trials, changes))


def velocities(scene: Scene, problem: StepProblem, trials: Trials) -> NodeVectors:
    """Of all nodes, m/s."""
    parts = tuple(map(velocity, contacts_of(scene, problem), trials))
    return xyz(blocks_of(scene).joined(parts), exact_ground(scene))


def impulses(scene: Scene, problem: StepProblem, trials: Trials) -> GroundImpulses:
    """The change of all nodes' velocities by the ground."""
    contacts = contacts_of(scene, problem)
    parts = map(ground_impulse, contacts, trials)
    p = blocks_of(scene).joined(tuple(map(along_own_axes, contacts, parts)))
    return GroundImpulses(p.normal, (p.first, p.second))


def sweep(scene: Scene, problem: StepProblem, trials: Trials) -> Trials:
    """One pass over all rigid struts, group by group, each to its length; the ground responds at once."""
    layout, contacts = blocks_of(scene), contacts_of(scene, problem)
    # group after group, each on what the last one left: struts that share a node would overshoot if met at once
    for group, push in zip(layout.groups, problem.pushes):
        s = layout.at_nodes(_to_length(_strut(layout, problem, contacts, group, push, trials)), group)
        trials = tuple(trial - one * size for trial, one, size in zip(trials, push, s))
    return trials


def contacts_of(scene: Scene, problem: StepProblem) -> tuple[Contact | None, ...]:
    """Of each block of nodes with the ground."""
    layout, friction = blocks_of(scene), scene.friction
    none: tuple = (None,) * len(layout.nodes)
    if problem.closing is None:
        return none
    mu = none if friction is None else layout.numbers(jnp.asarray(friction.sliding_mu))
    least = (SLOWEST * speed_scale(scene)) ** 2
    timing = none if problem.timing is None else problem.timing
    axes = none if problem.axes is None else problem.axes
    return tuple(
        Contact(closing, coefficient, own, least, when)
        for closing, coefficient, own, when in zip(problem.closing, mu, axes, timing, strict=True)
    )


def length_error(scene: Scene, h: Scalar, problem: StepProblem, trials: Trials) -> LengthError:
    """Of rigid struts, at the end of a step of size h (s)."""
    if problem.vectors is None or problem.lengths is None:
        none = jnp.zeros_like(trials[0].normal[0])
        return LengthError(none, none)
    layout = blocks_of(scene)
    w = tuple(map(velocity, contacts_of(scene, problem), trials))
    first, second = layout.ends(w, tuple(range(len(layout.edges))))
    d = problem.vectors + (first - second)
    off = jnp.abs(jnp.sqrt(d.dot(d)) - problem.lengths)
    return LengthError(h * largest(off), largest(off / problem.lengths))


def length_gap(scene: Scene, problem: StepProblem, trials: Trials) -> tuple[PerMember, PerMember]:
    """The length error of rigid struts without common nodes: F = (|d|^2 - (L/h)^2)/2, m^2/s^2.

    And its slope by an impulse along the strut, d·m, m^2/s^2 per N s, with d and m as in `_to_length`. Where the ground
    holds both ends, so that no impulse changes F, it is d·m of free ends.
    """
    layout = blocks_of(scene)
    strut = _strut(layout, problem, contacts_of(scene, problem), layout.groups[0], problem.pushes[0], trials)
    held = strut.moving.dot(strut.moving) == 0
    rate = jnp.where(held, strut.d.dot(strut.free), strut.d.dot(strut.moving))
    return (strut.d.dot(strut.d) - strut.goal * strut.goal) / 2, rate


def rates_at_impulses(
    problem: StepProblem, problem_rates: StepProblem, before: Trials, before_rates: Trials, after: Trials
) -> Trials:
    """The derivative of trial impulses z = z0 - S u at constant impulses S, N s: dz0 - S du, with u the pushes."""
    (pushes,), (push_rates,) = problem.pushes, problem_rates.pushes
    found = (
        rate - push_rate * ((z0 - z).dot(u) * inverse(u.dot(u)))
        for rate, push_rate, z, z0, u in zip(before_rates, push_rates, after, before, pushes)
    )
    return tuple(found)


def rates_at_lengths(
    scene: Scene, problem: StepProblem, partial: Trials, missed: PerMember, slope: PerMember
) -> Trials:
    """The derivative of trial impulses that keep struts at their lengths: `partial`, and -missed/slope along each.

    `missed` is the rate of `length_gap` at constant impulses, and `slope` its change by an impulse of 1.
    """
    (pushes,), layout = problem.pushes, blocks_of(scene)
    changes = layout.at_nodes(over(missed, slope), layout.groups[0])
    return tuple(rate + u * change for rate, u, change in zip(partial, pushes, changes))


class _Strut(NamedTuple):
    """Struts of a group in the middle of a sweep."""

    d: Components
    """(x_i - x_j)/h at the end of the step, m/s"""
    goal: PerMember
    """L/h, m/s"""
    free: Components
    """by how much an impulse of 1 along the strut would change d without the ground, 1/kg"""
    moving: Components
    """the same with what the ground answers"""


def _strut(
    layout: Blocks,
    problem: StepProblem,
    contacts: tuple[Contact | None, ...],
    group: tuple[int, ...],
    push: tuple[Components, ...],
    trials: Trials,
) -> _Strut:
    assert problem.vectors is not None, "`step_problem` sets it where struts are rigid"
    assert problem.lengths is not None, "`step_problem` sets it where struts are rigid"
    first, second = layout.ends(tuple(map(velocity, contacts, trials)), group)
    d, goal = rows_of(problem.vectors, group) + (first - second), rows_of(problem.lengths, group)
    first, second = layout.ends(push, group)
    free = first - second
    first, second = layout.ends(tuple(map(answered, contacts, trials, push)), group)
    return _Strut(d, goal, free, first - second)


def _to_length(struts: _Strut) -> PerMember:
    """Impulses along the struts of a group after which |d| = L/h at the end of the step, exactly, N s.

    With d = (x_i - x_j)/h at the end, and m its change by an impulse of 1 along the strut (with the ground's response),
    |d + s m| = L/h has the root s = (sqrt((d·m)^2 - m·m (d·d - (L/h)^2)) - d·m)/(m·m), also where forces alone would
    have turned the strut around. Where the ground holds both ends, m is as if they were free.
    """
    d, goal, free, moving = struts
    free_squared, moving_squared = free.dot(free), moving.dot(moving)
    moves = moving_squared > HELD * HELD * free_squared
    d_m = jnp.where(moves, d.dot(moving), d.dot(free))
    m_m = jnp.where(moves, moving_squared, free_squared)
    longer = d.dot(d) - goal * goal
    # below 0 no impulse reaches the length: a tiny number keeps the derivative of the root finite there
    under = d_m * d_m - m_m * longer
    towards = d_m > 0
    # |d·m| + sqrt(...), by which the root of either sign has a form that does not cancel; what takes the square root
    # once is one loop, where XLA would compute all that is before it once more for each use
    larger = jnp.where(towards, d_m, -d_m) + jnp.sqrt(jnp.maximum(under, jnp.finfo(under.dtype).tiny))
    return jnp.where(towards, -longer, larger) / jnp.where(towards, larger, m_m)
