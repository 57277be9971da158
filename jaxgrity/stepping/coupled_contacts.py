"""Contacts coupled by a matrix: impulses of Signorini's law and Coulomb's cone at all nodes at once.

Given G, b and c, find impulses p and velocities w with

    w = b + G p,    p_n >= 0,  w_n >= c,  one of them an equality,    |p_t| <= mu p_n, against the slip where less.

Both laws hold for every trial impulse z, with p = P(z) and w = P(z) - z (see `ground_response.py`), so z has to solve
H(z) = z - P(z) + b + G P(z) = 0. In most cases Newton's method solves this in a few iterations, with a generalised
derivative P' (Alart and Curnier 1991, doi:10.1016/0045-7825(91)90022-X). Otherwise the alternating direction method of
multipliers brings it near. It solves the cone's problem in which the slip w_t of the last iteration adds mu |w_t| to
w_n (de Saxce and Feng 1998, doi:10.1016/S0895-7177(98)00119-8). It splits this problem into a linear system, with the
matrix G + rho, and a projection on the cones. Masses do not matter in either method: G is scaled so that each node's
own block has the mean 1. So rho = 1 is a fair start, and z is in m/s times the root of the mass.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.dense import inverse_of, solution
from jaxgrity.core.side_by_side import applied, contracted, for_many, while_any
from jaxgrity.core.types import AnyArray, AnyNodeVectors, AnyPerNode
from jaxgrity.stepping.blocks import Components
from jaxgrity.stepping.ground_response import Contact, ground_impulse, without_offset

NORMAL = (1.0, 0.0, 0.0)
"""The direction of the normal in components along normal and tangents."""
NEWTON = 12
"""Most iterations of Newton's method in a row, before another method takes over."""
SPLITTINGS = 50
"""Iterations of the alternating direction method in a row, after Newton's method has failed twice."""
PENALTY_KEPT = 10
"""Iterations of that method between changes of its penalty: each change costs the inverse of a matrix."""
ROUNDS = 20
"""Most rounds of these methods, after Newton's method has failed for the first time."""
RIDGE, LEAST_RIDGE = 0.75, 1e-8
"""Power of the rounding error that is added to the diagonal of sticking contacts, and the least that is added. A body
that rests on more contacts than it has motions makes their matrix singular. With a smaller ridge Newton's steps lead
far away, a larger one costs iterations."""
DAMPED, EASED, LONG = 1e-3, 100.0, 2
"""Ridge after a step of damped iterations that did not go well; the factor by which it then grows further, or shrinks
after one that went well; and the number of lengths, the largest ones, at which a step did."""
NEAREST = 8
"""Number of contacts that a step of twice as many or more solves first: those nearest to the ground. Most robots stand
on fewer. A step with 20 contacts then costs a fifth (measured)."""
HALVINGS = 8
"""Number of lengths that are tried for a Newton step: the whole step, a half of it, a quarter, and so on."""


class Factors(NamedTuple):
    """G = D B D^T, which is multiplied out only where all contacts are unknowns: of others few columns are needed."""

    D: AnyArray
    """(3 contacts, 3 nodes)"""
    B: AnyArray
    """(3 nodes, 3 nodes), symmetric"""

    def columns(self, numbers: AnyArray) -> AnyArray:
        return self.D @ (self.B @ self.D[numbers].T)

    def applied(self, p: AnyNodeVectors) -> AnyNodeVectors:
        return (self.D @ (self.B @ (p.ravel() @ self.D))).reshape(p.shape)

    def whole(self) -> AnyArray:
        return self.D @ self.B @ self.D.T


class ContactProblem(NamedTuple):
    """The conditions on impulses at all nodes; vectors along normal and tangents, all scaled by masses."""

    G: Any
    """(3 nodes, 3 nodes), symmetric, positive semidefinite: the response to impulses; or its `Factors`"""
    b: AnyNodeVectors
    """velocities without impulses"""
    contact: Contact
    """c and mu of each node"""
    root_mass: AnyPerNode
    """by which velocities are multiplied here"""
    tolerance: AnyArray
    """of H, m/s, that Newton's method aims at"""
    enough: AnyArray
    """of H, m/s, that is good enough where it gets stuck: between very different masses rounding can be as much"""


class Solved(NamedTuple):
    """The solution."""

    trial: AnyNodeVectors
    """z"""
    error: AnyArray
    """the largest |H|, m/s: by how much the laws of motion are missed"""


def as_impulses(contact: Contact, z: AnyNodeVectors) -> AnyNodeVectors:
    """P(z): the impulses of both laws, from trial impulses."""
    p = ground_impulse(contact, Components(z[:, 0], z[:, 1], z[:, 2]))
    return jnp.stack(p.each, axis=1)


def missed(problem: ContactProblem, z: AnyNodeVectors) -> AnyNodeVectors:
    """H(z)."""
    p = as_impulses(problem.contact, z)
    return z - p + problem.b + applied(problem.G, p)


def solve_contacts(problem: ContactProblem, start: AnyNodeVectors) -> Solved:
    """Trial impulses near `start` that solve the problem; without a solution the best, with their error."""
    infinite = jnp.full(start.shape[2:], jnp.inf, start.dtype)
    p = as_impulses(problem.contact, start)
    splitting = _Splitting(p, 0 * p, jnp.ones_like(infinite))
    # the cone's problem is that of the slip against which friction acts
    moved = problem._replace(b=without_offset(problem.contact, problem.b))

    def unsolved(state):
        best, _, count = state
        # Newton's method aims at `tolerance`; a further round is worth its cost beyond `enough` alone
        missed = best.error > jnp.where(count == 0, problem.tolerance, problem.enough)
        # of a motion that is lost, whose numbers are not finite, no round makes one
        return missed & (count <= jnp.where((count > 0) & ~jnp.isfinite(best.error), 0, ROUNDS))

    def again(state):
        best, splitting, count = state
        # loops, for what is done in some rounds alone: a condition would do it in all, in a population
        splitting = _repeat(count == 2, 1, lambda s: _prepared(moved, s), splitting)
        splitting = _repeat(count > 1, SPLITTINGS // PENALTY_KEPT, lambda s: _split(moved, s), splitting)
        near = splitting.impulse - problem.b - applied(problem.G, splitting.impulse)
        # where plain iterations jump to and fro between corners of P, damped ones come nearer; and the reverse
        found = _newton(problem, jnp.where(count < 2, start, near), damped=count % 2 == 1)
        # neither method comes nearer in every round
        better = found.error < best.error
        best = jax.tree.map(lambda new, old: jnp.where(better, new, old), found, best)
        return best, splitting, count + 1

    none = jnp.zeros(infinite.shape, int)
    return while_any(unsolved, again, (Solved(start, infinite), splitting, none))[0]


def begins_with_nearest(contacts: int, *many: int) -> bool:
    """Whether the nearest contacts alone are the first unknowns, in one problem or in many."""
    # a condition under `jax.vmap` computes both: only on CPUs are large problems solved one by one
    return not many and contacts >= 2 * NEAREST and jax.default_backend() == "cpu"


def solve_nearest_contacts(problem: ContactProblem, start: AnyNodeVectors) -> Solved:
    """`solve_contacts` with `NEAREST` contacts as unknowns, wherever that solves the whole problem too.

    The others have no impulses. If one of them would end the step below the ground, or Newton's method fails, all
    contacts are unknowns. So they are from the first if more of them press at the start.
    """
    if not begins_with_nearest(len(start), *start.shape[2:]):
        return solve_contacts(problem, start)
    few = jnp.sum(start[:, 0] + problem.contact.closing > 0) <= NEAREST
    unsolved = Solved(start, jnp.full_like(problem.b[0, 0], jnp.inf)), jnp.array(False)
    found, whole = jax.lax.cond(few, lambda: _nearest_alone(problem, start), lambda: unsolved)
    G = problem.G
    return jax.lax.cond(
        whole,
        lambda: found,
        lambda: solve_contacts(problem._replace(G=G.whole() if isinstance(G, Factors) else G), start),
    )


def _nearest_alone(problem: ContactProblem, start: AnyNodeVectors) -> tuple[Solved, AnyArray]:
    """The solution with `NEAREST` contacts as unknowns, and whether it is that of the whole problem."""
    G, b, contact, root_mass, tolerance, enough = problem
    free = (b[:, 0] - contact.closing) / root_mass
    rows = jnp.argsort(jnp.where(start[:, 0] + contact.closing > 0, -jnp.inf, free))[:NEAREST]
    columns = (3 * rows[:, None] + np.arange(3)).ravel()
    near = jax.tree.map(lambda x: x[rows] if jnp.ndim(x) else x, contact)
    answers = G.columns(columns) if isinstance(G, Factors) else G[:, columns]
    few = ContactProblem(answers[columns], b[rows], near, root_mass[rows], tolerance, enough)
    found = solve_contacts(few, start[rows])
    without = -b - (answers @ as_impulses(near, found.trial).ravel()).reshape(b.shape)
    trial = jnp.asarray(without).at[rows].set(found.trial)
    pressed = (trial[:, 0] + contact.closing > 0).at[rows].set(False)
    return Solved(trial, found.error), (found.error <= enough) & ~jnp.any(pressed)


def _repeat(whether: AnyArray, times: int, step: Callable, state: "_Splitting") -> "_Splitting":
    last = jnp.where(whether, times, 0)
    return while_any(lambda c: c[0] < last, lambda c: (c[0] + 1, step(c[1])), (0 * last, state))[1]


def _newton(problem: ContactProblem, start: AnyNodeVectors, damped: AnyArray) -> Solved:
    """Newton's method on H, each step with the length of least |H|; the best of all points.

    If no length leaves less, the whole step is made: it often leads past a corner of P. In `damped` iterations none is
    made then, and after short steps a larger ridge turns the next one.
    """
    (nodes, _, *many), size = start.shape, 3 * len(start)
    one, each = for_many(np.eye(size), start[0, 0]), for_many(np.eye(nodes), start[0, 0])
    lengths = for_many(0.5 ** np.arange(HALVINGS), start)
    smallest = jnp.asarray(max(float(jnp.finfo(start.dtype).eps) ** RIDGE, LEAST_RIDGE), start.dtype)

    def error(z):
        return jnp.max(jnp.abs(missed(problem, z)) / problem.root_mass[:, None], axis=(0, 1))

    def rest(z):
        left = missed(problem, z)
        return contracted("na,na->", left, left)

    def going(state):
        best, *_, count = state
        return (best.error > problem.tolerance) & (count < NEWTON)

    def step(state):
        best, z, ridge, count = state
        left = missed(problem, z)
        slope = _slope(problem.contact, z)
        through = contracted("inb,nbc->inc", problem.G.reshape(size, nodes, 3, *many), slope).reshape(size, size, *many)
        blocks = (each[:, None, :, None] * slope[:, :, None]).reshape(size, size, *many)
        # where a node sticks P' = 1, and of its rows G alone is left, which may be singular: hence the ridge
        change = -solution(one - (1 - ridge) * blocks + through, left.reshape(size, *many)).reshape(z.shape)
        tries = z + change * lengths
        rests = jax.vmap(rest)(tries)
        least, z, well = rest(z), jnp.where(damped, z, tries[0]), ~damped
        for number, (tried, more) in enumerate(zip(tries, rests)):
            less = more < least
            z, least, well = (
                jnp.where(less, *x) for x in ((tried, z), (more, least), (~damped | (number < LONG), well))
            )
        now = Solved(z, error(z))
        best = jax.tree.map(lambda new, old: jnp.where(now.error < best.error, new, old), now, best)
        ridge = jnp.where(well, jnp.maximum(ridge / EASED, smallest), jnp.clip(EASED * ridge, DAMPED, 1))
        return best, z, ridge, count + 1

    first = Solved(start, error(start)), start, jnp.full(many, smallest), jnp.zeros(many, int)
    return while_any(going, step, first)[0]


def _slope(contact: Contact, z: AnyNodeVectors) -> AnyArray:
    """dP/dz, (nodes, 3, 3)."""
    units = jnp.broadcast_to(for_many(np.eye(3)[:, None], z[0, 0]), (3, *z.shape))
    along = jax.vmap(lambda unit: jax.jvp(lambda z: as_impulses(contact, z), (z,), (unit,))[1])(units)
    return jnp.moveaxis(along, 0, 2)


class _Splitting(NamedTuple):
    """The state of the alternating direction method."""

    impulse: AnyNodeVectors
    """p, in the cones"""
    slip: AnyNodeVectors
    """w + `_shift`, its multiplier"""
    rho: AnyArray
    """the penalty, a number"""


def _prepared(problem: ContactProblem, state: _Splitting) -> _Splitting:
    w = problem.b + applied(problem.G, state.impulse)
    return state._replace(slip=w + _shift(problem.contact, w), rho=jnp.ones_like(state.rho))


def _shift(contact: Contact, w: AnyNodeVectors) -> AnyNodeVectors:
    """mu |w_t| - c along the normals: with it, velocities are in the dual cone of the impulses'."""
    mu = _friction(contact)
    higher = mu * jnp.sqrt(w[:, 1] ** 2 + w[:, 2] ** 2) - contact.closing
    return higher[:, None] * for_many(NORMAL, w[0, 0])


def _friction(contact: Contact) -> AnyPerNode:
    return jnp.zeros_like(contact.closing) if contact.mu is None else contact.mu * jnp.ones_like(contact.closing)


def _split(problem: ContactProblem, state: _Splitting) -> _Splitting:
    """Some iterations: a linear system, a projection on the cones; then the penalty rho follows the errors of both."""
    rho, mu, dtype = state.rho, _friction(problem.contact), state.impulse.dtype
    # an inverse, not a factorisation: each of the iterations that share it is then one product
    inverse = inverse_of(problem.G + rho * for_many(np.eye(len(problem.G)), rho))

    def again(carry):
        p, w, _, count = carry
        goal = rho * p + w - problem.b - _shift(problem.contact, w)
        free = applied(inverse, goal)
        after = onto_cone(free - w / rho, mu)
        errors = jnp.stack([jnp.max(jnp.abs(x), axis=(0, 1)) for x in (free - after, after - p)])
        return after, w - rho * (free - after), rho * errors, count + 1

    first = (state.impulse, state.slip, jnp.zeros((2, *rho.shape), dtype), 0)
    p, w, (primal, dual), _ = jax.lax.while_loop(lambda carry: carry[3] < PENALTY_KEPT, again, first)
    # a larger rho brings the impulses to the cones sooner, a smaller one the motion to its law: neither may lag
    change = jnp.where(primal > 10 * dual, 3.0, jnp.where(dual > 10 * primal, 1 / 3, 1.0)).astype(dtype)
    return _Splitting(p, w, rho * change)


def onto_cone(x: AnyNodeVectors, mu: AnyPerNode) -> AnyNodeVectors:
    """The nearest points of the cones |p_t| <= mu p_n; components are along the normal first."""
    normal, across = x[:, 0], jnp.sqrt(x[:, 1] ** 2 + x[:, 2] ** 2)
    height = (mu * across + normal) / (mu * mu + 1)
    safe = jnp.where(across > 0, across, 1)
    surface = jnp.stack([height, mu * height * x[:, 1] / safe, mu * height * x[:, 2] / safe], axis=1)
    inside, apart = across <= mu * normal, mu * across <= -normal
    return jnp.where(inside[:, None], x, jnp.where(apart[:, None], 0, surface))
