"""Exact contact and rigid struts: Signorini's law, Coulomb's cone and strut lengths as constraints on each step.

The scheme is Moreau's and Jean's: forces act on the velocity, impulses then make it satisfy the constraints at the end
of the step. Each constraint is met in closed form, and sweeps over all of them (projected Gauss-Seidel) couple them.
M. Jean 1999, doi:10.1016/S0045-7825(98)00383-1; Stewart and Trinkle 1996.
"""

from collections.abc import Callable
from typing import Any, ClassVar

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.actuation import rest_length
from jaxgrity.friction import ConeFriction, Friction
from jaxgrity.ground import Ground, signed_distance
from jaxgrity.primitives import (
    accumulate,
    along,
    component,
    dot,
    edge_vectors,
    inverse,
    length,
    positive_part,
    scale,
    take_rows,
)
from jaxgrity.scene import Scene
from jaxgrity.structure import InputError, Members, edge_lengths
from jaxgrity.types import Edges, NodeVectors, PerNode, Scalar

SLOWEST = 1e-10
"""m/s, keeps the derivative of |v_t| finite at rest"""

FORETELLING_SWEEPS = 8
"""with which a step estimates its velocity, so that dissipative forces can be taken in its middle"""

MISSED = 1e-3
"""of its length, by which no strut may be off at the end of a step: more sweeps, or smaller steps, are needed there"""

VIOLATED = 1e-6
"""m, by which a start may violate the constraints"""

Impulses = tuple[PerNode, PerNode, PerNode]
"""change of a node's velocity along the ground's normal and its two tangents, m/s"""


def groups(edges: Edges) -> tuple[tuple[int, ...], ...]:
    """The rows of `edges` in groups whose members share no node, so that each group is met all at once."""
    rest, found = list(range(len(edges))), []
    while rest:
        used: set[int] = set()
        group = []
        for k in rest:
            if not used & set(edges[k]):
                group.append(k)
                used |= set(edges[k])
        rest = [k for k in rest if k not in group]
        found.append(tuple(group))
    return tuple(found)


def check_start(scene: Scene, q: np.ndarray) -> None:
    """Refuse a start from which one step would have to jump.

    Raises `InputError` where a node lies below exact ground, or a rigid strut does not have its length L(0).
    """
    struts, ground = scene.structure.struts, scene.ground
    if ground is not None and ground.exact:
        depth = -(q @ np.array(ground.normal))
        node = int(np.argmax(depth))
        if depth[node] > VIOLATED:
            raise InputError(
                f"node {node} starts {depth[node]:.3g} m below the ground; expected: on exact contact, on or above it"
            )
    if struts is not None and struts.rigid:
        lengths, wanted = edge_lengths(q, struts.edges), np.asarray(rest_length(struts, scene.gait, 0.0, 0))
        strut = int(np.argmax(np.abs(lengths - wanted)))
        if abs(lengths[strut] - wanted[strut]) > VIOLATED:
            raise InputError(
                f"strut {strut} starts {lengths[strut]:.6g} m long; expected {wanted[strut]:.6g} m, its rest length at "
                "t = 0, since it is rigid"
            )


def prepare(scene: Scene, h: Scalar, t1: Scalar, q: NodeVectors, v: NodeVectors) -> dict[str, Any]:
    """What stays the same through a step's sweeps: directions, lengths L(t1), the velocity that closes each gap."""
    problem: dict[str, Any] = {"inverse_mass": 1 / scene.structure.node_mass}
    struts, ground = scene.structure.struts, scene.ground
    if struts is not None and struts.rigid:
        vectors = edge_vectors(q, struts.edges)
        problem["vectors"], problem["directions"] = vectors, scale(vectors, inverse(length(vectors)))
        problem["lengths"] = rest_length(struts, scene.gait, t1, 0)
    if ground is not None and ground.exact:
        phi = signed_distance(ground, q)
        closing = -phi / h
        if ground.restitution is not None:
            approach = component(v, ground.normal)
            hits = ((phi + h * approach < 0) & (approach < 0)).astype(phi.dtype)
            closing = jnp.maximum(closing, -ground.restitution * approach * hits + closing * (1 - hits))
        problem["closing"] = closing
    return problem


def sweep(
    scene: Scene, h: Scalar, problem: dict[str, Any], w: NodeVectors, impulses: Impulses
) -> tuple[NodeVectors, Impulses]:
    """One pass over all constraints: each group of struts to its length, then every node onto ground and cone."""
    struts, ground = scene.structure.struts, scene.ground
    if struts is not None and struts.rigid:
        for rows in groups(struts.edges):
            w = _to_length(struts, h, problem, w, rows)
    if ground is not None and ground.exact:
        return _onto_ground(ground, scene.friction, problem, w, impulses)
    return w, impulses


def length_error(scene: Scene, h: Scalar, problem: dict[str, Any], w: NodeVectors) -> Scalar:
    """How far the rigid struts will be from their lengths at the end of the step, at most, m."""
    struts = scene.structure.struts
    if struts is None or not struts.rigid:
        return jnp.zeros_like(w[0, 0])
    return jnp.max(jnp.abs(length(problem["vectors"] + h * edge_vectors(w, struts.edges)) - problem["lengths"]))


def _to_length(
    struts: Members, h: Scalar, problem: dict[str, Any], w: NodeVectors, rows: tuple[int, ...]
) -> NodeVectors:
    """Impulses along the struts in `rows` after which |d| = L at the end of the step, exactly.

    With d = x_i - x_j at the end and u the direction at the start, |d + s u| = L has the root
    s = -d·u + sqrt((d·u)^2 - |d|^2 + L^2), which the nodes share by their inverse masses.
    """
    every = struts.edges
    edges = tuple(every[k] for k in rows)
    vectors, directions, lengths = problem["vectors"], problem["directions"], problem["lengths"]
    if len(rows) < len(every):
        vectors, directions, lengths = (take_rows(x, rows) for x in (vectors, directions, lengths))
    d = vectors + h * edge_vectors(w, edges)
    along_strut = dot(d, directions)
    under = along_strut * along_strut - dot(d, d) + lengths * lengths
    s = -along_strut + jnp.sqrt(jnp.maximum(under, jnp.finfo(under.dtype).tiny))
    mobility = [take_rows(problem["inverse_mass"], tuple(ends)) for ends in zip(*edges)]
    impulse = s / (h * (mobility[0] + mobility[1]))
    return w + scale(accumulate(scale(directions, impulse), edges, w.shape[0]), problem["inverse_mass"])


def _onto_ground(
    ground: Ground, friction: Friction | None, problem: dict[str, Any], w: NodeVectors, impulses: Impulses
) -> tuple[NodeVectors, Impulses]:
    """Signorini: p_n >= 0 and w_n >= -phi/h, one of them an equality. Coulomb: |p_t| <= mu p_n, sticking if it can."""
    normal, *tangential = impulses
    pressed = positive_part(normal + problem["closing"] - component(w, ground.normal))
    w = w + along(pressed - normal, ground.normal)
    if not isinstance(friction, ConeFriction):
        return w, (pressed, impulses[1], impulses[2])
    held = [p - component(w, tangent) for p, tangent in zip(tangential, ground.tangents)]
    needed = jnp.sqrt(held[0] * held[0] + held[1] * held[1] + SLOWEST * SLOWEST)
    share = jnp.minimum(1, friction.mu * pressed / needed)
    kept = [share * p for p in held]
    for new, old, tangent in zip(kept, tangential, ground.tangents):
        w = w + along(new - old, tangent)
    return w, (pressed, kept[0], kept[1])


class Complementarity(diffrax.AbstractSolver):
    """A leapfrog with constraints: v lives in the middle of the steps, and forces act on it at the nodes' positions.

    From q at t0 and v in the middle of the last step, of size h0:

        w = v + (h0 + h)/2 M^-1 F(q, (v + w)/2, t0) + impulses,    q1 = q + h w.

    The first step starts from v at t0 (h0 = 0). Dissipative forces need w: sweeps with F(q, v, t0) foretell it, the
    last ones use what they foretold. The order is 2 where nothing begins or ends to touch, stick or slip, and 1 there.

    The last thing that a sweep does is to put every node on or above the ground, so no node is ever below a plane at
    the end of a step. Each sweep about halves what is left of the error in strut lengths. A robot whose struts are off
    by more than `MISSED` of their lengths, or by more than the tolerance, at the end of a step gets NaN.
    """

    sweeps: int = eqx.field(static=True, default=16)
    """over all constraints, in a step; the most there are where a tolerance is given"""
    tolerance: float | None = eqx.field(static=True, default=None)
    """m: sweeps end where every strut has its length within this. None: after all sweeps"""
    prepare: Callable = eqx.field(static=True, default=prepare)
    """as the function of this module, or mapped over a population"""
    sweep: Callable = eqx.field(static=True, default=sweep)
    """likewise"""
    length_error: Callable = eqx.field(static=True, default=length_error)
    """likewise"""
    term_structure: ClassVar = diffrax.AbstractTerm
    interpolation_cls: ClassVar[Callable] = diffrax.LocalLinearInterpolation

    def order(self, terms):
        return 1

    def init(self, terms, t0, t1, y0, args):
        none = jnp.zeros_like(y0[0][:, 0])
        return jnp.zeros_like(t1 - t0), (none, none, none)

    def step(self, terms, t0, t1, y0, args, solver_state, made_jump):
        (q, v), h = y0, t1 - t0
        kick = (solver_state[0] + h) / 2
        none = jnp.zeros_like(q[:, 0])
        problem = self.prepare(args, h, t1, q, v)

        def constrain(w, impulses, sweeps, tolerance=None):
            return self._constrain(args, h, problem, (w, impulses), sweeps, tolerance)

        _, a = terms.vf(t0, y0, args)
        w, impulses = v + kick * a, (none, none, none)
        if args.dissipates:
            w, impulses = constrain(w, impulses, FORETELLING_SWEEPS)
            _, corrected = terms.vf(t0, (q, (v + w) / 2), args)
            w = w + kick * (corrected - a)
        w, impulses = constrain(w, impulses, self.sweeps, self.tolerance)
        if "lengths" in problem:
            allowed = MISSED * problem["lengths"].min(0) if self.tolerance is None else self.tolerance
            w = jnp.where(self.length_error(args, h, problem, w) <= allowed, w, jnp.nan)
        y1 = (q + h * w, w)
        return y1, None, {"y0": y0, "y1": y1}, (h, impulses), diffrax.RESULTS.successful

    def _constrain(self, scene, h, problem, state, sweeps, tolerance):
        """`state` = (w, impulses) after so many sweeps, or after as many as the tolerance needs."""

        # rolled up, and outside the map over a population: unrolled sweeps, or mapped loops, are many times slower
        if tolerance is None:
            return jax.lax.fori_loop(0, sweeps, lambda _, s: self.sweep(scene, h, problem, *s), state)

        def off(state):
            return self.length_error(scene, h, problem, state[0])

        def short_of(carry):
            done, state = carry
            return (done < sweeps) & jnp.any(off(state) > tolerance)

        def again(carry):
            return carry[0] + 1, self.sweep(scene, h, problem, *carry[1])

        return jax.lax.while_loop(short_of, again, (0, state))[1]

    def func(self, terms, t0, y0, args):
        return terms.vf(t0, y0, args)
