"""What a rollout costs its actuators, and how it meets the ground: summed up step by step, for a whole population."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxgrity.actuation import rest_length
from jaxgrity.audit import impulsive_work, powers, strut_impulses
from jaxgrity.constraints import groups
from jaxgrity.dynamics import centre_of_mass
from jaxgrity.ground import signed_distance
from jaxgrity.primitives import component, dot, edge_vectors, inverse, length, take_rows
from jaxgrity.scene import Scene
from jaxgrity.structure import InputError
from jaxgrity.types import AnyArray, PerActuator, Scalar

SLIP = 0.02
"""m/s, beyond which a touching node counts as slipping"""
WINDOW = 0.05
"""s, time constant of the moving mean of actuator forces: rigid bodies pass impacts on as impulses, without a peak"""


class Meters(NamedTuple):
    """Since the gait began; forces are moving means, with weights that fall by e in a `WINDOW`."""

    path: Scalar
    """m, the horizontal way that the centre of mass went"""
    work: Scalar
    """J, done by the actuators, as in the energy audit: less what was done on them"""
    effort: Scalar
    """J, done by the actuators, each by itself; they get nothing back where work is done on them"""
    contact: Scalar
    """s, summed over the nodes that touch the ground"""
    slip: Scalar
    """s, of them those that slip"""
    flight: Scalar
    """s, in which no node touches the ground"""
    force: PerActuator
    """N, (actuators,), now; tension is positive"""
    peak_force: PerActuator
    """N, (actuators,)"""
    peak_rate: PerActuator
    """m/s, (actuators,), |dL/dt|"""
    peak_power: PerActuator
    """W, (actuators,), |force dL/dt|"""


def nothing(scene: Scene) -> Meters:
    """Meters at the start. Raises `InputError` where forces cannot be told apart."""
    if scene.gait is None:
        raise InputError("the scene has no gait; expected one, whose actuators can be metered")
    struts = scene.structure.struts
    if struts is not None and struts.rigid and len(groups(struts.edges)) > 1:
        raise InputError(
            "rigid struts share nodes: their forces cannot be told apart; expected struts with a stiffness"
        )
    zero = jnp.zeros_like(scene.structure.nodes[0, 0])
    none = jnp.zeros_like(scene.gait.phase)
    return Meters(*[zero] * 6, *[none] * 4)


def read(scene: Scene, t0: Scalar, h: Scalar, start, end, before, after, held: Meters, *, impulsive: bool) -> Meters:
    """The meters after one more step from `start` to `end`; `before` and `after` are the solver's state around it.

    `impulsive`: the solver is complementarity stepping, whose impulses are in its state.
    """
    q0, (q, v) = start[0], end
    assert scene.gait is not None, "`nothing` refuses a scene without a gait"
    on = jnp.asarray(t0 >= scene.gait.start).astype(q.dtype)
    if impulsive:
        work: AnyArray = impulsive_work(scene, t0, h, start, end, before, after)["actuation"]
    else:
        work = h * jnp.asarray(powers(scene, t0 + h, q, v)["actuation"])
    moved = centre_of_mass(scene, q) - centre_of_mass(scene, q0)
    step = jnp.sqrt(moved[0] * moved[0] + moved[1] * moved[1])
    touching, slipping = _contact(scene, q, v, after if impulsive else None)
    rate = (_lengths(scene, t0 + h) - _lengths(scene, t0)) / h
    tension = _tension(scene, t0, h, start, end, before, after)
    force = held.force + jnp.minimum(1, h / WINDOW) * (tension - held.force)
    return Meters(
        held.path + on * step,
        held.work + work,
        held.effort + h * jnp.sum(jnp.maximum(0, -tension * rate), axis=0),
        held.contact + on * h * jnp.sum(touching, axis=0),
        held.slip + on * h * jnp.sum(touching * slipping, axis=0),
        held.flight + on * h * (1 - jnp.max(touching, axis=0)),
        force,
        jnp.maximum(held.peak_force, on * jnp.abs(force)),
        jnp.maximum(held.peak_rate, jnp.abs(rate)),
        jnp.maximum(held.peak_power, on * jnp.abs(force * rate)),
    )


def _contact(scene: Scene, q, v, after):
    """Per node 1 where it touches the ground, and 1 where it moves along it."""
    ground = scene.ground
    if ground is None:
        return jnp.zeros_like(q[:, 0]), jnp.zeros_like(q[:, 0])
    pressed = after[1][0] if ground.exact else -signed_distance(ground, q)
    along = [component(v, tangent) for tangent in ground.tangents]
    slipping = along[0] * along[0] + along[1] * along[1] > SLIP * SLIP
    return (pressed > 0).astype(q.dtype), slipping.astype(q.dtype)


def _lengths(scene: Scene, t: Scalar) -> PerActuator:
    """L(t) of the actuated members, m."""
    parts = []
    for members, rows, first in _actuated(scene):
        parts.append(take_rows(rest_length(members, scene.gait, t, first), rows))
    return _in_order(scene, parts)


def _tension(scene: Scene, t0: Scalar, h: Scalar, start, end, before, after) -> PerActuator:
    """Of the actuated members, N: of springs K (l - L), of cables if they pull, of rigid struts by their impulses."""
    q, parts = end[0], []
    for members, rows, first in _actuated(scene):
        edges = tuple(members.edges[k] for k in rows)
        if members.rigid:
            impulses = strut_impulses(scene, t0, h, start, end, before, after)
            vectors = edge_vectors(start[0], edges)
            on_first = take_rows(impulses, tuple(i for i, _ in edges))
            parts.append(-dot(on_first, vectors) * inverse(length(vectors)) / ((before[0] + h) / 2))
            continue
        stretch = length(edge_vectors(q, edges)) - take_rows(rest_length(members, scene.gait, t0 + h, first), rows)
        pull = take_rows(members.stiffness, rows) * stretch
        parts.append(pull if members is scene.structure.struts else jnp.maximum(pull, 0))
    return _in_order(scene, parts)


def _actuated(scene: Scene):
    """Members of each kind, which of them are actuated, in ascending order, and the number of the first."""
    structure, gait = scene.structure, scene.gait
    assert gait is not None, "`nothing` refuses a scene without a gait"
    for members, first in ((structure.struts, 0), (structure.cables, structure.first_cable)):
        if members is not None:
            rows = tuple(k for k in range(len(members.edges)) if first + k in gait.members)
            if rows:
                yield members, rows, first


def _in_order(scene: Scene, parts: list[AnyArray]) -> PerActuator:
    """Struts' and cables' numbers, joined, in the order in which the gait names the members."""
    joined = parts[0] if len(parts) == 1 else jnp.concatenate(parts)
    assert scene.gait is not None, "`nothing` refuses a scene without a gait"
    order = tuple(int(k) for k in np.argsort(np.argsort(scene.gait.members)))
    return joined if order == tuple(range(len(order))) else take_rows(joined, order)
