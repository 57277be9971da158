"""Small motions about a state: the equations of motion, linearised, and the largest step that does not amplify them."""

import itertools
from typing import NamedTuple

import jax
import numpy as np
import scipy.sparse as sp

from jaxgrity.core.quick import compiled_quickly
from jaxgrity.core.tracing import evaluated
from jaxgrity.core.types import NodeVectors, State
from jaxgrity.model.inertia import independent_coordinates, mass_matrix
from jaxgrity.model.rigidity import rigid_pairs
from jaxgrity.model.scales import length_scale
from jaxgrity.model.scene import Scene, as_dtype
from jaxgrity.model.slides import Slides, known_lines, slides_of
from jaxgrity.stepping.dynamics import smooth_acceleration
from jaxgrity.stepping.methods import Method, amplification

GROWTH = 1e-3
"""Relative growth per step, beyond the true growth, that counts as stable. Tsit5 always amplifies undamped motions."""
INDEPENDENT = 1e-9
"""Relative strength below which a constraint follows from the others, as for redundant struts."""
WIDEST = 1e2
"""Largest step that is examined, as a multiple of the time scale of the fastest mode."""


class Linearised(NamedTuple):
    """Linearised motion y'' = -K y - C y' for q + B y, with the n coordinates y that constraints leave free."""

    stiffness: np.ndarray
    """(n, n), stiffness K, 1/s^2"""
    damping: np.ndarray
    """(n, n), damping C, 1/s"""
    basis: np.ndarray
    """(3 nodes, n), basis B: mass-normalised with constraints, otherwise the identity"""

    def modes(self) -> tuple[np.ndarray, np.ndarray]:
        """Eigenvalues of the motion, (2n,), 1/s, and their displacements, (3 nodes, 2n)."""
        n = len(self.stiffness)
        values, vectors = np.linalg.eig(np.block([[np.zeros((n, n)), np.eye(n)], [-self.stiffness, -self.damping]]))
        return values, self.basis @ vectors[:n]


def linearise(scene: Scene, state: State) -> Linearised:
    """The equations of motion, linearised about `state` = (positions, velocities) at t = 0, in float64.

    Rigid struts, slides, nodes on exact ground and nodes held by the cone are constraints. Motions against them are
    left out. The forces of struts turn with the struts, and those of slides with their lines. These forces are those
    that keep the constraints of a body at rest, J M^-1 (F + J' f) = 0, also where it is not in equilibrium. Force laws
    without a derivative (the Coulomb switch) are ignored.
    """
    with jax.enable_x64(True), evaluated():
        q, v = (np.asarray(x, float) for x in state)
        a, slopes = _derivatives(as_dtype(scene, "float64"), q, v)
    moves, place = independent_coordinates(scene.structure)
    onto = (lambda x: x @ place) if scene.structure.bodies else (lambda x: x[:, moves])
    stiffness, damping = (onto(-np.asarray(d).reshape(q.size, q.size)[moves]) for d in slopes)
    rows = onto(constraint_rows(scene, q).toarray())
    if not len(rows):
        return Linearised(stiffness, damping, place)
    with jax.enable_x64(True), evaluated():
        mass = onto(onto(np.asarray(mass_matrix(scene.structure))).T)
    root = np.linalg.cholesky(mass)
    sides, strengths, axes = np.linalg.svd(np.linalg.solve(root, rows.T).T)
    kept = int(np.sum(strengths > INDEPENDENT * strengths[0]))
    # J M^-1 J' f = -J a, the smallest of its solutions: nothing accelerates along a constraint
    along = (root.T @ np.asarray(a).ravel()[moves])[:, None]
    forces = -(sides[:, :kept] @ (axes[:kept] @ along / strengths[:kept, None]))[:, 0]
    stiffness = stiffness - np.linalg.solve(mass, onto(onto(turning(scene, q, forces).toarray()).T).T)
    basis = np.linalg.solve(root.T, axes[kept:].T)
    reduce = basis.T @ mass
    return Linearised(reduce @ stiffness @ basis, reduce @ damping @ basis, place @ basis)


@compiled_quickly
def _derivatives(scene: Scene, q: NodeVectors, v: NodeVectors):
    """Acceleration a, and da/dq and da/dv, (nodes, 3, nodes, 3) each."""
    a = lambda q, v: smooth_acceleration(scene, 0.0, q, v)  # noqa: E731
    return a(q, v), jax.jacfwd(a, (0, 1))(q, v)


def constraint_rows(scene: Scene, q: np.ndarray) -> sp.csr_array:
    """(constraints, 3 nodes): direction of each constraint, rigid struts first."""
    size = float(length_scale(scene))
    rows = [constraint.directions(q, size) for constraint in scene.constraints]
    return sp.csr_array(sp.vstack([sp.csr_array((0, q.size)), *rows]))


def turning(scene: Scene, q: np.ndarray, forces: np.ndarray) -> sp.coo_array:
    """(3 nodes, 3 nodes), change of the forces of rigid struts as they turn, (1 - u u^T) f / l, and of slides, N/m."""
    blocks, places = [np.zeros((0, 3, 3))], [np.zeros((0, 2), int)]
    for (i, j), force in zip(rigid_pairs(scene), forces):
        d = q[i] - q[j]
        across = force / np.linalg.norm(d) * (np.eye(3) - np.outer(d, d) / (d @ d))
        blocks.append(np.stack([across, across, -across, -across]))
        places.append(np.array([(i, i), (j, j), (i, j), (j, i)]))
    if (slides := slides_of(scene)) is not None:
        before = itertools.takewhile(lambda law: law is not slides, scene.constraints)
        first = sum(law.directions(q, float(length_scale(scene))).shape[0] for law in before)
        of_slides = _turning_slides(slides, q, forces[first:])
        blocks.append(of_slides[0])
        places.append(of_slides[1])
    rows, columns = np.concatenate(places).T[:, :, None, None] * 3 + np.indices((3, 3))[:, None]
    return sp.coo_array((np.concatenate(blocks).ravel(), (rows.ravel(), columns.ravel())), shape=(q.size, q.size))


def _turning_slides(slides: Slides, q: np.ndarray, forces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Blocks, N/m, and their nodes, of f times the second derivative of n·e: -(n c)(u e)^T f / |b| and its transpose.

    Here c are the weights of b, from one end of a line to the other.
    """
    lines = known_lines(slides, q)
    rows = forces[: len(lines.ends), None, None] / np.linalg.norm(lines.line, axis=1)[:, None, None]
    sides = rows * lines.across[:, :, None] * lines.along[:, None]
    each = np.einsum("ri,rj,rab->rijab", lines.ends, lines.weights, sides)
    blocks = -(each + each.transpose(0, 2, 1, 4, 3)).sum(0)
    found = np.argwhere(blocks.any((2, 3)))
    return blocks[tuple(found.T)], found


def largest_step(linear: Linearised, method: Method) -> float:
    """Largest step at which no motion grows more than `GROWTH` says, s; infinite where nothing drives it."""
    values = linear.modes()[0]
    if not (fastest := np.abs(values).max(initial=0)):
        return np.inf
    low, high = 1e-3 / fastest, WIDEST / fastest
    for _ in range(26):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if np.all(growth(linear, values, method, middle) <= 1 + GROWTH) else (low, middle)
    return float(low)


def growth(linear: Linearised, values: np.ndarray, method: Method, h: float) -> np.ndarray:
    """Growth of each mode per step beyond its true growth; with constraints, of each mode of the step."""
    if not method.constrained:
        return amplification(method, h * values) * np.exp(-h * np.maximum(values.real, 0))
    one = np.eye(len(linear.stiffness))
    kick, drag = -h * linear.stiffness, -h * linear.damping
    # w0 = v + kick q + drag v predicts w = v + kick q + drag (v + w0)/2
    from_q, from_v = kick + drag @ kick / 2, one + drag + drag @ drag / 2
    step = np.block([[one + h * from_q, h * from_v], [from_q, from_v]])
    return np.abs(np.linalg.eigvals(step)) * np.exp(-h * max(0, values.real.max()))
