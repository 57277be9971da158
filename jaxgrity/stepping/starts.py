"""Checks of a start: positions within the constraints, and velocities equal to the supports'."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.arguments import check_all_finite, check_finite
from jaxgrity.core.errors import InputError
from jaxgrity.core.remembered import remembered
from jaxgrity.core.tracing import evaluated, traced
from jaxgrity.core.types import AnyArray, Edges, NodeVectors, Scalar, State
from jaxgrity.model.body_points import carrying, independent_nodes
from jaxgrity.model.rigid_struts import LARGEST_GAP
from jaxgrity.model.rigidity import rigid_pairs
from jaxgrity.model.scales import length_scale, speed_scale
from jaxgrity.model.scene import Scene
from jaxgrity.model.shaking import slips
from jaxgrity.model.slides import Slides, lines_at, slides_of

LARGEST_SLIP = 1e-3
"""Largest velocity of a node relative to its shaken support at a start, as a share of the body's speed sqrt(g L)."""
ROUNDED = 16
"""Number of roundings of a node's position by which a start may be off."""
KEPT = 64
"""Number of starts that are remembered as possible: the check takes longer than a short rollout."""


@remembered(KEPT)
def check_start(scene: Scene, positions: NodeVectors | None = None, since: Scalar = 0.0) -> None:
    """Refuse a start, at `since` (s), that one step would have to move onto its constraints.

    Positions (nodes, 3), m, are by default the structure's own. Traced numbers are not checked: they get a failure code
    (`start_failure`). A scene with a known number that is not finite is refused too.
    """
    check_all_finite(scene, on_devices=True)
    if traced((scene, positions, since)):
        return
    q = np.asarray(scene.structure.nodes if positions is None else positions, float)
    check_finite("positions", q)
    for constraint in scene.constraints:
        gaps, allowed = np.asarray(constraint.gaps(q, since)), LARGEST_GAP + constraint.left_by_steps
        if gaps.size and not gaps.max() <= allowed * float(length_scale(scene)):
            raise InputError(constraint.complaint(q, float(since), int(gaps.argmax())))


def check_shapes(scene: Scene, start: State) -> State:
    """The start; refused if it is not positions and velocities with a row for each node, traced ones too."""
    expected = scene.structure.nodes.shape
    if not isinstance(start, tuple | list) or len(start) != 2:
        raise InputError(f"start: expected two arrays of shape {expected}, positions and velocities, as (q, v)")
    for name, given in zip(("positions", "velocities"), start):
        if np.shape(given) != expected:
            found = f"start: {name} have shape {np.shape(given)}"
            raise InputError(f"{found}; expected {expected}, a row for each node")
    return start


def check_known_velocities(scene: Scene, velocities: AnyArray, since: Scalar = 0.0) -> None:
    """Refuse known velocities (m/s), of one robot or of many, that differ from the supports'.

    Supports are at rest, or have the speed of their shaking at `since` (s). Points of rigid bodies follow the basic
    points. For one robot they must be finite; of many, a robot with others fails.
    """
    if traced((scene, velocities, since)):
        return
    if np.ndim(velocities) == 2:
        check_finite("velocities", np.asarray(velocities))
    if scene.structure.bodies:
        _check_bodies_move(scene, np.asarray(velocities, float))
    with evaluated():
        off = np.asarray(supports_slip(scene, np.asarray(velocities), since))
    if off.any():
        where = np.argwhere(off)[0]
        node, found = int(where[-2]), np.asarray(velocities)[tuple(where[:-1])]
        raise InputError(f"velocities[{node}] = {found}: {_expected(scene, since)} where the node is fixed")


def check_velocities(scene: Scene, start: State, since: Scalar, constrained: bool) -> None:
    """`check_known_velocities` of one robot's start; and refuse those that change lengths of rigid struts or bodies, or
    lead a sliding node away from its line.

    A `constrained` method takes these. Impulses correct such velocities in the first step. Frames of an earlier motion
    do have them: the impulses of the step after a frame are not in its velocities.
    """
    check_known_velocities(scene, start[1], since)
    if constrained or traced((scene, start, since)):
        return
    q, v = (np.asarray(x, float) for x in start)
    edges, slides, most = rigid_pairs(scene), slides_of(scene), LARGEST_SLIP * float(speed_scale(scene))
    if edges and (growing := np.asarray(_growing((q, v), edges))).max() > most:
        k = int(growing.argmax())
        raise InputError(
            f"velocities: nodes {list(edges[k])} move apart or together by {growing[k]:.3g} m/s, and their distance is "
            "constant; expected velocities that keep it, or method = 'complementarity'"
        )
    if slides is None:
        return
    with jax.enable_x64(True), evaluated():
        leaving = np.asarray(_leaving((jnp.asarray(q), jnp.asarray(v)), slides))
    leaving = np.linalg.norm(leaving.reshape(-1, 2), axis=1)
    if leaving.max() > most:
        k = int(leaving.argmax())
        raise InputError(
            f"velocities: node {slides.nodes[k]} moves {leaving[k]:.3g} m/s across the line through nodes "
            f"{list(slides.along[k])}, along which it slides; expected 0, or method = 'complementarity'"
        )


def velocities_stretch(scene: Scene, start: State) -> AnyArray:
    """Whether velocities lead rigid struts, bodies or sliding nodes off by more than `check_velocities` allows."""
    edges, slides, most = rigid_pairs(scene), slides_of(scene), LARGEST_SLIP * speed_scale(scene)
    found = jnp.any(_growing(start, edges) > most) if edges else jnp.zeros((), bool)
    return found if slides is None else found | jnp.any(_leaving(start, slides) > most)


def _growing(start: State, edges: Edges) -> AnyArray:
    """m/s, by which each distance between two nodes changes."""
    i, j = np.array(edges).T
    d, rates = (x[i] - x[j] for x in start)
    return abs((d * rates).sum(1)) / (d * d).sum(1) ** 0.5


def _leaving(start: State, slides: Slides) -> AnyArray:
    """m/s, of sliding nodes across their lines, two for each."""
    lines = lines_at(slides, start[0])
    return abs((lines.across * (lines.weights @ start[1])).sum(1))


def _check_bodies_move(scene: Scene, v: np.ndarray) -> None:
    bodies, size = scene.structure.bodies, len(scene.structure.nodes)
    carry, independent = np.asarray(carrying(bodies, size), float), np.array(independent_nodes(bodies, size))
    off = np.abs(v - carry @ v[..., independent, :]).max(-1).reshape(-1, size).max(0)
    if off.max() > LARGEST_SLIP * float(speed_scale(scene)):
        node = int(off.argmax())
        raise InputError(
            f"velocities[{node}]: {off[node]:.3g} m/s beside that of its rigid body; expected v + w x r, of one v "
            "and one w for each body"
        )


def supports_slip(scene: Scene, v: AnyArray, since: Scalar) -> AnyArray:
    """Where velocities (..., nodes, 3), m/s, of fixed coordinates differ from the supports' at `since`, s."""
    return slips(scene.shaking, scene.structure, since, v, LARGEST_SLIP * speed_scale(scene))


def _expected(scene: Scene, since: Scalar) -> str:
    if scene.shaking is None or not since:
        return "expected 0"
    speed = np.asarray(scene.shaking.velocity(jnp.asarray(since, float)))
    return f"expected the velocity of its support at {float(since):g} s, {speed},"


def start_failure(scene: Scene, q: NodeVectors, t: Scalar = 0.0):
    """6 where a start at `q` violates a constraint by more than `check_start` allows, plus rounding; else 0."""
    allowed = LARGEST_GAP * length_scale(scene) + ROUNDED * jnp.finfo(q.dtype).eps * jnp.max(jnp.abs(q))
    gaps = [
        jnp.max(constraint.gaps(jnp.asarray(q), t), initial=0) - constraint.left_by_steps * length_scale(scene)
        for constraint in scene.constraints
    ]
    return jnp.where(jnp.max(jnp.stack(gaps)) > allowed, 6, 0) if gaps else jnp.zeros((), int)
