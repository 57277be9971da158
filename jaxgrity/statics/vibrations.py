"""Small vibrations about an equilibrium: natural frequencies and modes, with supports, prestress and members' mass."""

from typing import NamedTuple

import numpy as np
import scipy.linalg
import scipy.sparse as sp
import scipy.sparse.linalg as spla
from jaxtyping import Float

from jaxgrity.core.arguments import check_count, check_each
from jaxgrity.core.tracing import refuse_traced
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, NodeVectors, PerRow, Times
from jaxgrity.model.scene import Scene
from jaxgrity.statics.stiffness import (
    free_coordinates,
    sparse_mass_matrix,
    stiffness_matrix,
    unresisted_motions,
    with_spring_struts,
)

ROUNDING = 1e-9
"""Squared frequencies below this share of the largest are errors of the shape and of arithmetic."""
DENSE = 900
"""Most coordinates for which all modes are computed at once. Beyond, a sparse solver finds the lowest alone."""
LOWEST = 30
"""Default number of lowest modes where not all are computed."""


class Modes(NamedTuple):
    """Natural vibrations q + a shapes[k] sin(2 pi frequency[k] t), the slowest first, without rigid motions."""

    frequency: PerRow
    """Hz; 0 for a motion without resistance, or a growing one about a shape that is no minimum"""
    shapes: Float[AnyArray, "rows nodes 3"]
    """m, each with a kinetic energy of 1 J at a rate of 1/s and factor sqrt(2): shape' M shape = 1 kg m^2"""
    growing: int
    """number of unstable modes: U falls in their direction"""

    def motion(self, q: NodeVectors, mode: int, amplitude: float, times: Times) -> Float[AnyArray, "frames nodes 3"]:
        """Positions (frames, nodes, 3), m, of one mode; the largest displacement of a node is `amplitude`, m.

        A mode of 0 Hz gets a period of 1 s.
        """
        shape = self.shapes[mode] / np.linalg.norm(self.shapes[mode], axis=1).max()
        rate = 2 * np.pi * (float(self.frequency[mode]) or 1.0)
        return np.asarray(q) + amplitude * np.sin(rate * np.asarray(times))[:, None, None] * shape


@typed
def vibration_modes(scene: Scene, q: NodeVectors | None = None, count: int | None = None) -> Modes:
    """The modes of K x = (2 pi f)^2 M x about `q`, with K = d2U/dq2 and the consistent mass matrix M.

    For many nodes a sparse solver finds only the lowest modes (shift and invert; ARPACK). Rigid motions that nothing
    resists are taken out beforehand, so that slow or unstable modes show. Rigid struts are stiff springs here: the
    modes that change their lengths are the highest, and have no meaning.

    Args:
        scene: members, supports and masses, at rest at `q` and t = 0. Damping is left out.
        q: an equilibrium, m, as from `resting_shape`; None: the structure's own shape.
        count: the number of lowest modes; None: all of a small structure, else `LOWEST`.

    Returns:
        Frequencies and shapes, in ascending order.

    Raises:
        InputError: the scene's ground is exact contact, which has no stiffness; `q` of another shape, or not finite; a
            `count` below 1.

    Example:
        >>> modes = jaxgrity.statics.vibration_modes(jaxgrity.load_scene("reference"), count=3)
        >>> modes.shapes.shape  # (modes, nodes, 3)
        (3, 12, 3)
    """
    refuse_traced((scene, q), "vibration_modes", "take eigenvalues of jax.hessian of the scene's potential_energy")
    scene = with_spring_struts(scene)
    q = np.asarray(scene.structure.nodes if q is None else q, float)
    check_each("q", q, shape=np.shape(scene.structure.nodes))
    if count is not None:
        check_count("count", count, 1)
    held = scene.structure.supported
    free = free_coordinates(len(q), held)
    K = stiffness_matrix(scene, q)[free][:, free]
    M = sparse_mass_matrix(scene.structure)[free][:, free]
    rigid = unresisted_motions(scene, q, K)
    real = free.size - rigid.shape[1]
    wanted = min(real, count if count is not None else (real if free.size <= DENSE else LOWEST))
    dense = free.size <= DENSE or wanted + rigid.shape[1] > free.size // 3
    squares, x, stiffest = (_all_modes if dense else _lowest_modes)(K, M, rigid, wanted)
    rounding = max(ROUNDING * squares.max(initial=0), 100 * np.finfo(float).eps * stiffest)
    shapes = np.zeros((len(squares), q.size))
    shapes[:, free] = x.T
    frequency = np.sqrt(np.where(squares > rounding, squares, 0)) / (2 * np.pi)
    return Modes(frequency, shapes.reshape(-1, *q.shape), int(np.sum(squares < -rounding)))


def _all_modes(K: sp.csc_array, M: sp.csc_array, rigid: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Squared frequencies, 1/s^2, modes as columns, and the largest squared frequency of all."""
    momentum = M @ rigid
    # motions without momentum: those that are orthogonal to rigid ones with respect to M
    basis = scipy.linalg.null_space(momentum.T) if rigid.shape[1] else np.eye(K.shape[0])
    squares, y = scipy.linalg.eigh(basis.T @ (K @ basis), basis.T @ (M @ basis))
    return squares[:count], basis @ y[:, :count], float(np.abs(squares).max(initial=0))


def _lowest_modes(
    K: sp.csc_array, M: sp.csc_array, rigid: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray, float]:
    """The same by shift and invert, among motions without momentum: R' M y = 0, R the rigid ones."""
    stiffest = float(spla.eigsh(K, k=1, M=M, which="LM", return_eigenvectors=False, tol=1e-3)[0])
    shift = -1e-7 * stiffest
    inverse = spla.splu(sp.csc_matrix(K - shift * M))
    momentum = M @ rigid
    pushed = inverse.solve(momentum)
    to_momentum, to_push = np.linalg.inv(rigid.T @ momentum), np.linalg.inv(momentum.T @ pushed)

    def solve(x: np.ndarray) -> np.ndarray:
        """y with (K - shift M) y = x + M R m; the multipliers m make the momentum of y zero."""
        # what is of the form M R m may be left out of x, and would only cost digits
        y = inverse.solve(x - momentum @ (to_momentum @ (rigid.T @ x)))
        return y - pushed @ (to_push @ (momentum.T @ y))

    operator = spla.LinearOperator(K.shape, matvec=solve, dtype=float)
    start = solve(np.ones(K.shape[0]))
    squares, x = spla.eigsh(K, k=count, M=M, sigma=shift, OPinv=operator, which="LM", v0=start)
    order = np.argsort(squares)
    return squares[order], x[:, order], stiffest
