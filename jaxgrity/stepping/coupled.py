"""One step of rigid struts and exact contact for any structure: shared nodes, rods with mass, supports, any masses.

All struts are solved together, and nodes that slide with them: each has two rows as those of struts, n·e/h in place of
|d| (`slides.py`), and n for a direction. The impulses f along them and the ground's impulses p give the velocities

    w = w0 + A (f + p),    f = J^T lambda,    |d(w)| = L/h,    d(w) = (x_i - x_j)/h + w_i - w_j,

with A the mobility of the nodes (`inertia.mobility`) and J the directions of the struts at the start of the step, as in
`constraints.py`. The struts' Delassus matrix J A J^T is factorised once; what is left, B = A - A J^T (J A J^T)^-1 J A,
couples the contacts, which `coupled_contacts.py` solves. Some rounds of both make up for the turning of struts within
the step. A strut may turn so far that no impulse along its direction at the start meets its length: for instance, when
a light node snaps through between heavy ones. Then directions at the end of the step take their place. Velocities are
projected on the constraints by iterations, as in Gauss and Newton's method. That has a solution, and loses some
energy.

On a CPU small problems are solved in vectors over many of them, the last axis of all arrays (`core/side_by_side.py`).

Derivatives are those of the solution (implicit function theorem), in forward and in reverse mode.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.dense import least_solution
from jaxgrity.core.side_by_side import alone_and_in_rows, applied, contracted, for_many, where_needed, while_any
from jaxgrity.core.types import AnyArray, AnyMemberVectors, AnyNodeVectors, AnyPerMember, AnyPerNode
from jaxgrity.stepping.coupled_contacts import NORMAL, ContactProblem, Factors, as_impulses, solve_nearest_contacts
from jaxgrity.stepping.coupled_problem import (
    Coupled,
    Elimination,
    acted_on,
    contact_of,
    eliminated,
    from_frames,
    in_frames,
    lengths_after,
    rate_to_length,
    response,
    scaled,
    stretch_after,
    strut_directions,
)
from jaxgrity.stepping.ground_response import without_offset

TURNING = 20
"""Most rounds in a step that use the struts' directions at its start."""
PROJECTIONS = 40
"""Most rounds after those, each with the struts' directions at the end of the step as it was found before."""
FEW = 4
"""Most contacts, and most nodes, of problems that a CPU solves side by side. LAPACK is faster at larger systems
(measured)."""
STEEPEST = 0.2
"""Smallest cosine of the angle between a strut's directions at the start and at the end of a step (here 78 degrees). Of
a strut that turns more, an impulse along its first direction changes the length too little."""


class Impulses(NamedTuple):
    """The impulses of one step, N s, and their error in the constraints."""

    velocity: AnyNodeVectors
    """w, m/s, after it, of the independent nodes"""
    struts: AnyMemberVectors
    """(struts, 3), along x, y and z, on the first end of each; the opposite on the second"""
    ground: AnyMemberVectors
    """p, along the ground's normal and tangents, of each contact: all nodes, or the balls, and struts"""
    error: AnyArray
    """m/s: the largest |w - w0 - A (f + p)|; contact and cone hold exactly"""
    stretch: AnyArray
    """the largest share of its length by which a strut is off"""


class _Found(NamedTuple):
    """The state of the rounds."""

    struts: AnyMemberVectors
    """(struts, 3), N s, on the first end of each"""
    pulls: AnyPerMember
    """the part of them along the directions of now: lambda, N s"""
    trial: AnyMemberVectors
    """z of the contacts, (contacts, 3)"""
    velocity: AnyNodeVectors
    """w, m/s"""
    error: AnyArray
    stretch: AnyArray
    along: AnyArray
    """the smallest cosine of the angles by which struts turn within the step"""


def solve_step(problem: Coupled, guess: AnyArray, near: AnyArray, side_by_side: bool = False) -> Impulses:
    """Impulses and velocities that meet all constraints of a step; `guess` is p of the last one, N s.

    Struts are linearised first about the velocities `near`, m/s. With `side_by_side` there are many problems of one
    shape, along the first axis of all arrays.

    Without a solution, the nearest ones, with their error.
    """
    complete: Callable = jax.vmap(_complete) if side_by_side else _complete
    search: Callable = jax.vmap(_search) if side_by_side else _search
    if jax.default_backend() == "cpu":
        if near.shape[-2] > FEW or problem.sliding is not None:
            # one robot after the other: side by side all iterate until the last is done, which costs more here
            search = jax.custom_batching.sequential_vmap(search)
        else:
            search = partial(_search_small, guess.shape[-2] > FEW and problem.contact is not None, side_by_side)
    # the search is not differentiated: `custom_root` takes the derivative at what it finds
    return complete(problem, *search(*jax.lax.stop_gradient((problem, guess, near))))


def _search_small(many_contacts: bool, side_by_side: bool, problem: Coupled, guess: AnyArray, near: AnyArray):
    """`_search` of few nodes, in vectors; with many contacts only while none of them presses.

    A body of many contacts is mostly in the air: a payload amid a robot's cables always is.
    """
    search = _search_in_vectors[side_by_side]
    if not many_contacts:
        return search(problem, guess, near)
    aloft = search(problem._replace(contact=None), guess, near)
    return _search_pressed[side_by_side](aloft, problem, guess, near)


def _search_rows(*problems):
    """`_search` of each row of all arrays, in vectors over the rows."""
    found = _search(*jax.tree.map(lambda x: jnp.moveaxis(x, 0, -1), problems))
    return jax.tree.map(lambda x: jnp.moveaxis(x, -1, 0), found)


def _search_if_pressed(aloft: Any, *problem):
    """`_search`, unless its result without contacts, `aloft`, is that with them."""
    return jax.lax.cond(_right_aloft(aloft, *problem), lambda: aloft, lambda: _search(*problem))


def _search_pressed_rows(aloft: Any, *problems):
    """`_search` of the rows in which a contact presses, one after the other: `aloft` has the result of the others."""
    right = jax.vmap(_right_aloft)(aloft, *problems)
    pressed = jnp.argsort(right)

    def searched(k, found):
        one = _search(*jax.tree.map(lambda x: x[pressed[k]], problems))
        return jax.tree.map(lambda rows, row: rows.at[pressed[k]].set(row), found, one)

    return jax.lax.fori_loop(0, jnp.sum(~right), searched, aloft)


def _right_aloft(aloft: Any, problem: Coupled, guess: AnyArray, near: AnyNodeVectors) -> AnyArray:
    """Whether the result without contacts meets them too: none presses, and all lengths are right."""
    found, _, root_mass = aloft
    assert problem.contact is not None, "without contacts, there is nothing to check"
    contact = scaled(problem.contact, root_mass)
    none = (as_impulses(contact, found.trial) == 0).all() & (found.trial[:, 0] + contact.closing <= 0).all()
    # a stretch that is not finite fails the comparison
    return none & (found.stretch <= jnp.finfo(near.dtype).eps ** 0.5)


def _complete(problem: Coupled, found: "_Found", u: AnyMemberVectors, root_mass: AnyPerNode) -> Impulses:
    """The solution with its derivatives, from what was found with the directions u of struts."""
    rest = found.struts - u * found.pulls[:, None]
    projected = jnp.any(jax.lax.stop_gradient(strut_directions(problem)) != u)

    def of_struts(pulls):
        return rest + jnp.where(projected, u, strut_directions(problem)) * pulls[:, None]

    def unmet(unknown):
        z, pulls = unknown
        w, p = contact_of(problem, root_mass, z)
        acted = acted_on(problem, of_struts(pulls), p)
        if problem.reach is None:
            missed = root_mass[:, None] * in_frames(problem, acted - w)
        else:
            missed, w = root_mass[:, None] * (in_frames(problem, acted) - w), acted
        return missed, pulls if problem.apart is None else lengths_after(problem, w) - problem.goal

    def solve_linear(linear, right):
        flat, restore = jax.flatten_util.ravel_pytree(right)
        matrix = jax.jacobian(lambda x: jax.flatten_util.ravel_pytree(linear(restore(x)))[0])(jnp.zeros_like(flat))
        return restore(least_solution(matrix, flat))

    z, pulls = jax.lax.custom_root(unmet, (found.trial, found.pulls), lambda _, found: found, solve_linear)
    w, p = contact_of(problem, root_mass, z)
    f = of_struts(pulls)
    w = w if problem.reach is None else acted_on(problem, f, p)
    return Impulses(w, f, p, found.error, found.stretch)


def _search(problem: Coupled, guess: AnyArray, near: AnyNodeVectors) -> tuple[_Found, AnyMemberVectors, AnyArray]:
    """The solution, the struts' directions u of the last round, and the roots of the masses that scale each contact."""
    (nodes, _, *many), dtype = problem.start.shape, problem.start.dtype
    free = response(problem, strut_directions(problem))[2]
    # scaled by what each node answers while struts keep their lengths, feet of a gramme and hulls of a kilogramme are
    # alike to Newton's method; a node that cannot move answers nothing, and gets a floor
    if problem.reach is not None:
        D = problem.reach.reshape(-1, *problem.A.shape[1:])
        own = jnp.sum(contracted("ik,kl->il", D, free) * D, axis=1).reshape(-1, 3, *many).mean(1)
    else:
        every = np.arange(3 * nodes)
        own = free[every, every].reshape(nodes, 3, *many).sum(1) / 3
    root_mass = 1 / jnp.sqrt(jnp.maximum(own, 1e-9 * jnp.maximum(own.max(axis=0, initial=0), jnp.finfo(dtype).tiny)))
    first = eliminated(problem, root_mass, strut_directions(problem))
    nothing = jnp.zeros_like(first.units)
    infinite, none = jnp.full(many, jnp.inf, dtype), jnp.zeros(many, int)
    trial = guess / root_mass[:, None]
    if problem.contact is not None:
        # so that P(z) are the impulses of the last step: at rest they are those of this one
        trial = trial - (problem.contact.closing * root_mass)[:, None] * for_many(NORMAL, infinite)
        trial = without_offset(scaled(problem.contact, root_mass), trial)
    start = _Found(nothing, nothing[:, 0], trial, near, infinite, infinite, jnp.ones(many, dtype))
    if problem.apart is None:
        return _round(problem, root_mass, first, start), first.units, root_mass
    fine, close = (jnp.finfo(dtype).eps ** power for power in (0.75, 0.5))

    def attempt(state):
        """Rounds with one choice of directions: many with those at the start, each with its own thereafter."""
        count, found, _ = state
        later = lambda: eliminated(problem, root_mass, strut_directions(problem, found.velocity))  # noqa: E731
        parts = where_needed(count > 0, later, first)
        most = jnp.where(count == 0, TURNING, 1)

        def unmet(inner):
            turned = (count == 0) & (inner[1].along < STEEPEST)
            return (inner[1].stretch > fine) & (inner[0] < most) & ~turned

        begun = found._replace(pulls=0 * found.pulls, stretch=infinite)
        found = while_any(unmet, lambda s: (s[0] + 1, _round(problem, root_mass, parts, s[1])), (none, begun))[1]
        # where the first directions led nowhere, projections begin anew, from the velocities `near`
        lost = (count == 0) & ~((found.stretch <= close) & (found.along > STEEPEST))
        return count + 1, jax.tree.map(lambda a, b: jnp.where(lost, a, b), start, found), parts.units

    # projections lose energy: what the first directions bring `close` is taken as it is. A robot that has failed, whose
    # stretch is NaN, ends the loop by itself
    def unmet(state):
        count, found, _ = state
        return (found.stretch > jnp.where(count == 1, close, fine)) & (count <= PROJECTIONS)

    _, found, u = while_any(unmet, attempt, (none, start, first.units))
    return found, u, root_mass


def _round(problem: Coupled, root_mass: AnyPerMember, parts: Elimination, found: _Found) -> _Found:
    """Struts to their lengths, linearised about the present velocities, and the contacts solved with them."""
    w, acted = found.velocity, acted_on(problem, found.struts, jnp.zeros_like(found.trial))
    base: AnyNodeVectors = acted
    wanted: AnyPerMember = jnp.zeros_like(found.pulls)
    if problem.apart is not None:
        rates = contracted("sk,k->s", parts.J, (w - acted).reshape(parts.J.shape[1:]))
        wanted = rate_to_length(problem, parts.units, w) + rates
        pulled = contracted("sk,s->k", parts.J, contracted("st,t->s", parts.inverse, wanted))
        base = acted + applied(problem.A, pulled.reshape(w.shape))
    scale = root_mass[:, None]
    b = scale * in_frames(problem, base)
    z: AnyMemberVectors = -b
    error: AnyArray = jnp.zeros_like(found.error)
    if problem.contact is not None:
        tolerance, enough = (jnp.finfo(b.dtype).eps ** power * problem.speed for power in (0.75, 0.6))
        contact = scaled(problem.contact, root_mass)
        start = as_impulses(contact, found.trial)
        start = start - b - (parts.G.applied(start) if isinstance(parts.G, Factors) else applied(parts.G, start))
        z, error = solve_nearest_contacts(ContactProblem(parts.G, b, contact, root_mass, tolerance, enough), start)
    w, p = contact_of(problem, root_mass, z)
    f, pulls = found.struts, found.pulls
    if problem.reach is not None:
        w = base + applied(problem.A, from_frames(problem, p))
    stretch: AnyArray = jnp.zeros_like(error)
    along = jnp.ones_like(error)
    if problem.apart is not None:
        reached = applied(problem.A, from_frames(problem, p)).reshape(parts.J.shape[1:])
        more = contracted("st,t->s", parts.inverse, wanted - contracted("sk,k->s", parts.J, reached))
        f, pulls = f + parts.units * more[:, None], pulls + more
        if problem.reach is not None:
            w = acted_on(problem, f, p)
        stretch = stretch_after(problem, w)
        along = jnp.min(jnp.sum(strut_directions(problem, w) * strut_directions(problem), axis=1), axis=0)
    return _Found(f, pulls, z, w, error, stretch, along)


_search_in_vectors = alone_and_in_rows(_search, _search_rows)
_search_pressed = alone_and_in_rows(_search_if_pressed, _search_pressed_rows)
