"""Modal analysis: equilibrium shapes and natural frequencies from the Hessian of a potential energy, in float64."""

import functools
from collections.abc import Callable

import jax
import numpy as np

from jaxgrity.core.types import NodeVectors, PerNode, Scalar

Energy = Callable[[NodeVectors], Scalar]

ROUNDING = 1e-9
"""share of the largest squared frequency, below which one is an error of the shape and of arithmetic"""


def equilibrium(energy: Energy, start: NodeVectors, tolerance: float, iterations: int = 100) -> np.ndarray | None:
    """A shape near `start` in which every force -dU/dq is below `tolerance` (N); None where none is found.

    Newton's method on the energy's own Hessian, each eigenvalue replaced by its magnitude, so that it goes downhill,
    with zero modes left alone and the step halved until U falls (Nocedal and Wright 2006, section 3.4).
    """
    with jax.enable_x64(True):
        expansion = _expansion(energy)
        q = np.array(start, float)
        for _ in range(iterations):
            before, gradient, hessian = (np.asarray(x) for x in expansion(q))
            force = -gradient.ravel()
            if np.abs(force).max() < tolerance:
                return q
            stiffness, modes = np.linalg.eigh(hessian.reshape(q.size, q.size))
            stiff = np.abs(stiffness) > 1e-9 * np.abs(stiffness).max()
            along = modes[:, stiff]
            step = (along @ ((along.T @ force) / np.abs(stiffness[stiff]))).reshape(q.shape)
            factor = 1.0
            while factor > 1e-10 and float(expansion(q + factor * step)[0]) > before + 1e-12 * abs(before):
                factor /= 2
            q = q + factor * step
    return None


def natural_frequencies(energy: Energy, node_mass: PerNode, q: NodeVectors, stiff_modes: int = 0) -> np.ndarray:
    """f = sqrt(eig(M^-1 d2U/dq2)) / 2 pi of the vibrations about `q`, Hz, ascending; its rigid motions left out.

    So are the `stiff_modes` highest, where springs stand for constraints. A direction in which U falls or stays the
    same (an unstable or floppy mode) counts as 0 Hz, and so does what only rounding makes different from that.
    """
    with jax.enable_x64(True):
        hessian = np.asarray(_expansion(energy)(np.array(q, float))[2])
    root_mass = np.sqrt(np.repeat(np.asarray(node_mass, float), 3))
    scaled = hessian.reshape(root_mass.size, -1) / np.outer(root_mass, root_mass)
    rigid = root_mass[:, None] * _rigid_motions(np.asarray(q, float))
    basis, size, _ = np.linalg.svd(rigid)
    free = basis[:, np.sum(size > 1e-9 * size[0]) :]
    squares = np.linalg.eigvalsh(free.T @ scaled @ free)
    real = squares[: squares.size - stiff_modes]
    if not real.size:
        return real
    rounding = max(ROUNDING * real[-1], 100 * np.finfo(float).eps * squares[-1])
    return np.sqrt(np.where(real > rounding, real, 0)) / (2 * np.pi)


@functools.lru_cache(maxsize=1)
def _expansion(energy: Energy) -> Callable:
    """U, dU/dq and d2U/dq2, as one program for the equilibrium and the frequencies of an energy."""
    return jax.jit(lambda q: (energy(q), jax.grad(energy)(q), jax.hessian(energy)(q)))


def _rigid_motions(q: np.ndarray) -> np.ndarray:
    """Three translations and three rotations about the centre, as columns (3 nodes, 6)."""
    axes = np.eye(3)
    moves = [np.tile(axis, (len(q), 1)) for axis in axes]
    turns = [np.cross(axis, q - q.mean(0)) for axis in axes]
    return np.stack([motion.ravel() for motion in moves + turns], axis=1)
