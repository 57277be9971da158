"""Sources and sinks of energy and momentum: the powers of forces, and the works of one step's impulses."""

from typing import cast

import jax
import jax.numpy as jnp

from jaxgrity.core.dense import least_solution
from jaxgrity.core.primitives import accumulate, dot, edge_vectors, inner, inverse, length, scale
from jaxgrity.core.types import Edges, NodeVectors, PerMember, PerNode, Scalar
from jaxgrity.model.actuation import rest_length
from jaxgrity.model.inertia import borne_by_supports, momenta
from jaxgrity.model.rigidity import linked, rigid_pairs
from jaxgrity.model.scales import length_scale
from jaxgrity.model.scene import Scene
from jaxgrity.model.slides import Slides, lines_at, slides_of
from jaxgrity.model.structure import Members
from jaxgrity.stepping.complementarity import CoupledState
from jaxgrity.stepping.constraints import exact_ground, rigid_struts
from jaxgrity.stepping.dynamics import acceleration, outside_force, smooth_force, support_forces, total_force
from jaxgrity.stepping.entering import frame_met
from jaxgrity.stepping.ground_impulses import on_nodes
from jaxgrity.stepping.loop import Step
from jaxgrity.stepping.strut_contacts import points_between, struts_on_nodes

SAME_FACE = 0.99
"""Smallest cosine of the angle (8 degrees) by which the normal turns in a step of a node that slides on along a curve.
What turns it by more is an edge or a valley, and an impact."""
BESIDE = 1e-3
"""Share of its speed with which a sliding node may meet a face that does not turn: rounding, and no impact."""

Work = dict[str, jax.Array]
"""J of the actuators and of each cause of dissipation; N s and N m s, (3,), of the forces from outside"""


def powers(scene: Scene, t: Scalar, q: NodeVectors, v: NodeVectors, pulled: NodeVectors | float = 0.0) -> Work:
    """W: of the actuators, dU/dt, and of each cause of dissipation in the scene, v·dR/dv.

    `pulled` are the forces of rigid struts and bodies on nodes (`rigid_forces`). Also "impulse" and "moment": the
    external force, N, and the external moment about the origin, N m.
    """
    normal_force = scene.normal_force(q, v)
    outside = outside_force(scene, t, q, v, normal_force)
    found = {"actuation": jax.grad(scene.potential_energy, argnums=1)(q, jnp.asarray(t, q.dtype))}
    found |= jax.jvp(lambda v_: scene.dissipation_by_cause(v_, q, t, normal_force), (v,), (v,))[1]
    if scene.force_laws:
        others, motion = smooth_force(scene, t, q, v, normal_force), scene.motion(v, q, t, normal_force)
        for law in scene.force_laws:
            force = law.force(motion, others)
            _book(found, law.cause, -inner(jnp.ones_like(v[:, 0]), dot(v, force)))
            outside = outside + force
    if scene.structure.fixed:
        reaction = support_forces(scene, t, q, v, pulled)
        outside = outside + reaction
        if scene.shaking is not None:
            _book(found, "supports", -inner(jnp.ones_like(v[:, 0]), dot(v, reaction)))
    turning = outside
    if scene.structure.cables is not None and scene.structure.cables.pulleys:  # whose mounts hold cables beside nodes
        turning = turning + smooth_force(scene, t, q, v, normal_force) - outside_force(scene, t, q, v, normal_force)
    return found | {"impulse": outside.sum(0), "moment": jnp.cross(q, turning).sum(0)}


def step_work(scene: Scene, step: Step) -> Work:
    """The gains of one step: by its impulses, or by the mean of the powers at both its ends."""
    if step.impulsive:
        return impulsive_work(scene, step)
    rates = powers(scene, step.t0, *step.before.motion), powers(scene, step.t0 + step.h, *step.after.motion)
    return jax.tree.map(lambda a, b: step.h / 2 * (a + b), *rates)


def impulsive_work(scene: Scene, step: Step) -> Work:
    """The gains of one step of complementarity stepping: each impulse times the mean of the velocities around it.

    Rigid struts do the work of the actuators that change their lengths. Their other work, that of slides, and the loss
    of a node that stays on a curved ground, is an error of the steps: "stepping".
    """
    (q, v), (_, w) = step.before.motion, step.after.motion
    mean = (v + w) / 2
    gained = jax.tree.map(lambda power: step.kick * power, powers(step.acting(scene), step.t0, q, mean))
    gained["actuation"] = _actuation(scene, step)
    ground, between = ground_impulses(scene, step), between_struts(scene, step)
    work = lambda force: inner(jnp.ones_like(v[:, 0]), dot(force, mean))  # noqa: E731
    if ground:
        staying = _staying(scene, step)
        arriving = ground[0] if staying is None else scale(ground[0], 1 - staying)
        _book(gained, "impacts", -work(arriving))
        if staying is not None:
            _book(gained, "stepping", -work(ground[0] - arriving))
        if scene.friction is not None:
            _book(gained, "friction", -work(ground[1] + ground[2]))
    if between:
        _book(gained, "impacts", -work(between[0]))
        if scene.friction is not None:
            _book(gained, "friction", -work(between[1] + between[2]))
    if linked(scene):
        done = strut_impulses(scene, step)
        given = _strut_actuation(scene, step, done)
        gained["actuation"] = gained["actuation"] + given
        _book(gained, "stepping", given - work(done))
    # of friction between struts a moment is left: it acts on their axes, and they do not turn about these
    outside: NodeVectors = sum((*ground, *between), jnp.zeros_like(q))
    if scene.structure.fixed:
        # those of the forces are among the powers already
        at_rest = step.kick * support_forces(step.acting(scene), step.t0, q, mean)
        outside = outside + support_impulses(scene, step) - at_rest
        if scene.shaking is not None:
            _book(gained, "supports", -work(support_impulses(scene, step) - at_rest))
    gained["impulse"] = gained["impulse"] + outside.sum(0)
    gained["moment"] = gained["moment"] + jnp.cross(q, outside).sum(0)
    return gained


def _book(work: Work, cause: str, lost) -> None:
    """Add a loss to a cause's losses."""
    work[cause] = work[cause] + lost if cause in work else lost


def _actuation(scene: Scene, step: Step) -> Scalar:
    """J: the integral of dU/dt at fixed q over the time of the kick; dU/dt may jump within it."""
    end = step.t0 + step.h / 2
    q = step.before.motion[0]
    return scene.potential_energy(q, end) - scene.potential_energy(q, end - step.kick)


def _strut_actuation(scene: Scene, step: Step, impulse: NodeVectors) -> Scalar:
    """J: of the tensions of rigid struts times their rates of shortening, in the mean of two steps."""
    struts, (t, h, before) = rigid_struts(scene), (step.t0, step.h, step.before.memory.step_size)
    if struts is None or (scene.gait is None and not struts.motors):
        return jnp.zeros_like(h)
    changed = rest_length(struts, scene.gait, t + h, 0) - rest_length(struts, scene.gait, t - before, 0)
    return -jnp.sum(strut_tensions(scene, step.before.motion[0], impulse) * changed, axis=0) / (h + before)


def _staying(scene: Scene, step: Step) -> PerNode | None:
    """1 for nodes that were on curved ground already and slide along it, else 0; None for a plane.

    A node on one face that runs into another arrives there. So does one that meets it faster than by the turning of the
    face in the step: an impact may take two steps.
    """
    ground = exact_ground(scene)
    if ground is None or ground.surface is None:
        return None
    (q, v), met = step.before.motion, frame_met(ground, length_scale(scene), step.h, step.before.motion)
    before, now = cast(NodeVectors, ground.frame(q).normal), cast(NodeVectors, met.normal)
    ahead = cast(NodeVectors, ground.frame(q + step.h * v).normal)
    turned, approach = length(ahead - before), -dot(v, now)
    slides = approach <= (2 * turned + BESIDE) * length(v)
    stays = (step.before.memory.impulses.normal > 0) & (dot(before, now) > SAME_FACE) & slides
    return stays.astype(step.before.motion[0].dtype)


def strut_tensions(scene: Scene, q: NodeVectors, impulse: NodeVectors) -> PerMember:
    """The `tensions` of rigid struts, N s; with those within rigid bodies, and slides, they make up the impulse."""
    struts = cast(Members, rigid_struts(scene))
    return tensions(rigid_pairs(scene), q, impulse, slides_of(scene))[: len(struts.edges)]


def tensions(edges: Edges, q: NodeVectors, impulse: NodeVectors, slides: Slides | None = None) -> PerMember:
    """The tensions T of struts, N s, with the sum J^T T on the nodes equal to the `impulse`, by least squares.

    Beside slides, the impulse is the sum of theirs and of those of struts.
    """
    nodes, d = q.shape[0], edge_vectors(q, edges)
    u = scale(d, inverse(length(d)))
    back = lambda T: -accumulate(scale(u, T), edges, nodes)  # noqa: E731
    pulls = lambda f: -dot(u, edge_vectors(f, edges))  # noqa: E731
    if slides is not None:
        lines = lines_at(slides, q)
        links = lambda f: jnp.concatenate([pulls(f), jnp.sum(lines.across * (lines.weights @ f), axis=1)])  # noqa: E731
        rows = jax.jacfwd(links)(jnp.zeros_like(q)).reshape(-1, q.size)
        return least_solution(rows @ rows.T, links(impulse))[: len(edges)]
    if len({node for edge in edges for node in edge}) == 2 * len(edges):
        return pulls(impulse) / 2
    return jax.scipy.sparse.linalg.cg(lambda T: pulls(back(T)), pulls(impulse), tol=1e-9, maxiter=4 * len(edges))[0]


def strut_impulses(scene: Scene, step: Step) -> NodeVectors:
    """N s, on each node, of its rigid struts in one step: the rest after forces and the ground."""
    if isinstance(step.after.memory, CoupledState):
        return step.after.memory.struts
    (q, v), (_, w) = step.before.motion, step.after.motion
    forces = step.kick * acceleration(step.acting(scene), step.t0, q, (v + w) / 2)
    impulses = momenta(scene.structure, w - v - forces)
    return impulses - sum(ground_impulses(scene, step), jnp.zeros_like(q))


def support_impulses(scene: Scene, step: Step) -> NodeVectors:
    """N s, on each node, of its support in one step of complementarity stepping: the rest after all else."""
    (q, v), (_, w) = step.before.motion, step.after.motion
    forces = step.kick * total_force(step.acting(scene), step.t0, q, (v + w) / 2)
    touched = *ground_impulses(scene, step), *between_struts(scene, step)
    others = sum(touched, forces + strut_impulses(scene, step))
    return borne_by_supports(scene.structure, momenta(scene.structure, w - v) - others)


def ground_impulses(scene: Scene, step: Step) -> list[NodeVectors]:
    """N s, of exact contact on each node, along the normal and the two tangents; of scenes that have it."""
    if exact_ground(scene) is None:
        return []
    return on_nodes(scene, step.h, step.before.motion, step.after.memory.impulses)


def between_struts(scene: Scene, step: Step) -> list[NodeVectors]:
    """The same of struts on each other, by exact contact; of scenes that have it."""
    if not points_between(scene):
        return []
    return struts_on_nodes(scene, step.h, step.before.motion, step.after.memory.impulses.between_struts)
