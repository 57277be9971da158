"""Actuators' energy and forces, and contact with the ground, summed step by step for a whole population."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.primitives import component, dot, edge_vectors, inverse, length, take_rows
from jaxgrity.core.types import AnyArray, PerActuator, PerGait, PerNode, Scalar, namespace_of
from jaxgrity.model.actuation import rest_length
from jaxgrity.model.balls import touching_velocities
from jaxgrity.model.pulleys import path_lengths
from jaxgrity.model.pulls import reeled_cables
from jaxgrity.model.rod_contact import strut_distances
from jaxgrity.model.scales import speed_scale, time_scale
from jaxgrity.model.scene import Scene
from jaxgrity.model.slides import slides_of
from jaxgrity.stepping.blocks import disjoint_groups
from jaxgrity.stepping.constraints import rigid_struts
from jaxgrity.stepping.dynamics import centre_of_mass, member_tensions
from jaxgrity.stepping.power import Step, step_work, strut_impulses, strut_tensions

SLIPPING = 0.02
"""Speed above which a touching node counts as slipping, m/s for a body of one metre."""
FORCE_WINDOW = 0.05
"""Time constant of the moving mean of actuator forces, s for a body of one metre. Rigid bodies pass impacts on as
impulses, which have no peak."""


class Metrics(NamedTuple):
    """Measurements of a rollout: sums and peaks over all steps from the time `since` on.

    In `Outcomes.metrics`, each array has a row for each robot in front. Forces, and so powers, are moving means with
    the time constant `FORCE_WINDOW`.
    """

    path: Scalar
    """m, length of the horizontal path of the centre of mass"""
    work: Scalar
    """J, done by the actuators less done on them, as in the energy audit"""
    effort: Scalar
    """J, done by the actuators of the gait and by motors, each by itself, without recovery"""
    contact: Scalar
    """s, time of contact, summed over the nodes"""
    slip: Scalar
    """s, time of contact with slip, summed over the nodes"""
    flight: Scalar
    """s, in which neither a node nor a strut touches the ground"""
    force: PerActuator
    """N, (actuators,), now; tension is positive"""
    peak_force: PerActuator
    """N, (actuators,)"""
    peak_rate: PerActuator
    """m/s, (actuators,), |dL/dt|"""
    peak_power: PerActuator
    """W, (actuators,), |force dL/dt|"""
    moved_x: Scalar
    """m, displacement of the centre of mass along x"""
    moved_y: Scalar
    """m, and along y"""
    moved_z: Scalar
    """m, and upwards"""
    rise: Scalar
    """m, the largest `moved_z` so far"""
    since: Scalar
    """s, the time from which everything is counted: the gait's start, or a later one"""


def initial_metrics(scene: Scene, since: Scalar | None = None) -> Metrics:
    """The metrics before the first step; `since`, s, is the gait's start by default.

    Raises `InputError` where the forces of actuators have no unique solution.
    """
    if scene.gait is None:
        raise InputError("the scene has no gait; expected one, whose actuators can be measured")
    check_told_apart(scene)
    zero = jnp.zeros_like(scene.structure.nodes[0, 0])
    none = jnp.zeros_like(scene.gait.phase)
    begins = jnp.asarray(scene.gait.start if since is None else since, zero.dtype)
    return Metrics(*[zero] * 6, *[none] * 4, *[zero] * 5)._replace(since=zero + begins)


def check_told_apart(scene: Scene) -> None:
    """Raise `InputError` where the forces of rigid struts at a node cannot be told apart."""
    struts = rigid_struts(scene)
    if struts is not None and len(disjoint_groups(struts.edges)) > 1:
        raise InputError(
            "rigid struts share nodes: their forces cannot be told apart; expected struts with a stiffness"
        )


def updated_metrics(scene: Scene, step: Step, so_far: Metrics) -> Metrics:
    """The metrics after one more step."""
    q0, q, h = step.before.motion[0], step.after.motion[0], step.h
    # a step counts that ends later than that, by more than rounding
    on = jnp.asarray(step.t0 + 0.999 * h > so_far.since).astype(q.dtype)
    work = step_work(scene, step)["actuation"]
    moved = on * (centre_of_mass(scene, q) - centre_of_mass(scene, q0))
    way, up = jnp.sqrt(moved[0] * moved[0] + moved[1] * moved[1]), so_far.moved_z + moved[2]
    touching, slipping = _contact(scene, step)
    along_struts = step.after.memory.impulses.along_struts if step.impulsive else None
    on_struts = jnp.any(strut_distances(scene, q) < 0) if along_struts is None else jnp.any(along_struts[:, 0] > 0)
    numbers = _members_that_move(scene)
    rates, worked_over = _lengthened(scene, step, numbers) / h, _lengthened(scene, step, numbers, impulses=True)
    tensions = actuator_tension(scene, step, numbers)
    rate, tension = (x[: len(so_far.force)] for x in (rates, tensions))
    force = so_far.force + jnp.minimum(1, h / (FORCE_WINDOW * time_scale(scene))) * (tension - so_far.force)
    return Metrics(
        path=so_far.path + way,
        work=so_far.work + on * work,
        effort=so_far.effort + on * jnp.sum(jnp.maximum(0, -tensions * worked_over), axis=0),
        contact=so_far.contact + on * h * jnp.sum(touching, axis=0),
        slip=so_far.slip + on * h * jnp.sum(touching * slipping, axis=0),
        flight=so_far.flight + on * h * (1 - jnp.maximum(jnp.max(touching, axis=0), on_struts)),
        force=force,
        peak_force=jnp.maximum(so_far.peak_force, on * jnp.abs(force)),
        peak_rate=jnp.maximum(so_far.peak_rate, on * jnp.abs(rate)),
        peak_power=jnp.maximum(so_far.peak_power, on * jnp.abs(force * rate)),
        moved_x=so_far.moved_x + moved[0],
        moved_y=so_far.moved_y + moved[1],
        moved_z=up,
        rise=jnp.maximum(so_far.rise, up),
        since=so_far.since,
    )


def _contact(scene: Scene, step: Step) -> tuple[PerNode, PerNode]:
    """For each node 1 where it touches the ground, and 1 where it slides."""
    ground, (q, v) = scene.ground, step.after.motion
    if ground is None:
        return jnp.zeros_like(q[:, 0]), jnp.zeros_like(q[:, 0])
    pressed = step.after.memory.impulses.normal if ground.impulsive else -ground.signed_distance(q)
    v = touching_velocities(ground, scene.structure.bodies, q, v)
    along = [component(v, tangent) for tangent in ground.frame(q).tangents]
    slowest = SLIPPING * speed_scale(scene)
    slipping = along[0] * along[0] + along[1] * along[1] > slowest * slowest
    return (pressed > 0).astype(q.dtype), slipping.astype(q.dtype)


def _members_that_move(scene: Scene) -> tuple[int, ...]:
    """Numbers of the members that the gait actuates, and after them of those with motors."""
    assert scene.gait is not None, "`initial_metrics` refuses a scene without a gait"
    return (*scene.gait.members, *scene.structure.driven)


def _lengthened(scene: Scene, step: Step, numbers: tuple[int, ...], impulses: bool = False) -> PerActuator:
    """m, by which some members lengthen in a step; with `impulses`, those that act by impulses in the time of one.

    An impulse stands between two steps, and works with the mean of the velocities of both: a strut that starts at
    once gives a node m dv^2/2, not m dv^2. A cable that is driven by force has no spring between it and its motor,
    which reels as much as the cable lengthens.
    """
    reeled = reeled_cables(scene)
    parts = []
    for members, rows, first in _by_kind(scene, numbers):
        between = impulses and members.rigid
        began = step.t0 - step.before.memory.step_size if between else step.t0
        change = rest_length(members, scene.gait, step.t0 + step.h, first) - rest_length(
            members, scene.gait, began, first
        )
        if reeled is not None and first == scene.structure.first_cable:
            places = step.before.motion[0], step.after.motion[0]
            before, after = (path_lengths(members, edge_vectors(q, members.edges), q) for q in places)
            change = jnp.where(reeled, after - before, change)
        parts.append(take_rows(change / 2 if between else change, rows))
    return _in_order(numbers, parts)


def cost_of_transport(scene: Scene, energy: Scalar | PerGait, distance: Scalar | PerGait) -> AnyArray:
    """energy / (m g distance), from J and m; infinite without gravity or distance."""
    done = distance * (0.0 if scene.gravity is None else scene.structure.mass * scene.gravity)
    xp = namespace_of(done)
    return xp.where(done == 0, xp.inf, energy / xp.where(done == 0, 1, done))


def actuator_tension(scene: Scene, step: Step, numbers: tuple[int, ...] | None = None) -> PerActuator:
    """N, of some members, by default of the gait's: `member_tensions` without dampers; of rigid struts from their
    impulses."""
    assert scene.gait is not None, "`initial_metrics` refuses a scene without a gait"
    numbers = scene.gait.members if numbers is None else numbers
    found = member_tensions(scene, step.t0 + step.h, step.after.motion[0])
    parts: list[AnyArray] = []
    for members, rows, _ in _by_kind(scene, numbers):
        if members.rigid and (scene.structure.bodies or slides_of(scene) is not None):
            # nodes of bodies also have the impulses that keep their shape, and slides have theirs
            tensions = strut_tensions(scene, step.before.motion[0], strut_impulses(scene, step))
            parts.append(take_rows(tensions, rows) / step.kick)
        elif members.rigid:
            edges = tuple(members.edges[k] for k in rows)
            vectors = edge_vectors(step.before.motion[0], edges)
            on_first = take_rows(strut_impulses(scene, step), tuple(i for i, _ in edges))
            parts.append(-dot(on_first, vectors) * inverse(length(vectors)) / step.kick)
        else:
            parts.append(take_rows(found["struts" if members is scene.structure.struts else "cables"], rows))
    return _in_order(numbers, parts)


def _by_kind(scene: Scene, numbers: tuple[int, ...]):
    """The members of each kind, those with the given numbers in ascending order, and the number of the first."""
    for _, members, first in scene.structure.numbered:
        if rows := tuple(k for k in range(len(members.edges)) if first + k in numbers):
            yield members, rows, first


def _in_order(numbers: tuple[int, ...], parts: list[AnyArray]) -> PerActuator:
    """Values of struts and of cables, joined in the order of the members' numbers."""
    joined = parts[0] if len(parts) == 1 else jnp.concatenate(parts)
    order = tuple(int(k) for k in np.argsort(np.argsort(numbers)))
    return joined if order == tuple(range(len(order))) else take_rows(joined, order)
