"""Modal analysis: equilibrium shapes and natural frequencies from the Hessian of a potential energy, in float64."""

from collections.abc import Callable
from functools import lru_cache, partial

import equinox as eqx
import jax
import numpy as np

from jaxgrity.core.tracing import refuse_traced
from jaxgrity.core.types import AnyArray, MassMatrix, NodeVectors, PerNode, Scalar

Energy = Callable[[NodeVectors], Scalar]

ROUNDING = 1e-9
"""share of the largest squared frequency, below which one is an error of the shape and of arithmetic"""


def equilibrium(
    energy: Energy, start: NodeVectors, tolerance: float, iterations: int = 300, free: np.ndarray | None = None
) -> np.ndarray | None:
    """A shape near `start` in which every force -dU/dq is below `tolerance` (N); None where none is found.

    `free` (nodes, 3) says which coordinates may move; where not given, all.

    Newton's method on the energy's own Hessian, each eigenvalue replaced by its magnitude, so that it goes downhill,
    with zero modes left alone and the step halved until U falls (Nocedal and Wright 2006, section 3.4).
    """
    with jax.enable_x64(True):
        expansion = _expansion(energy)
        q = np.array(start, float)
        moves = np.flatnonzero(np.ones(q.size, bool) if free is None else free)
        for _ in range(iterations):
            before, gradient, hessian = (np.asarray(x) for x in expansion(q))
            force = -gradient.ravel()[moves]
            if np.abs(force).max() < tolerance:
                return q
            stiffness, modes = np.linalg.eigh(hessian.reshape(q.size, q.size)[np.ix_(moves, moves)])
            stiff = np.abs(stiffness) > 1e-9 * np.abs(stiffness).max()
            along = modes[:, stiff]
            step = np.zeros(q.shape)
            step.flat[moves] = along @ ((along.T @ force) / np.abs(stiffness[stiff]))
            factor = 1.0
            while factor > 1e-10 and float(expansion(q + factor * step)[0]) > before + 1e-12 * abs(before):
                factor /= 2
            q = q + factor * step
    return None


def natural_frequencies(
    energy: Energy, mass: PerNode | MassMatrix, q: NodeVectors, stiff_modes: int = 0, free: np.ndarray | None = None
) -> np.ndarray:
    """f = sqrt(eig(M^-1 d2U/dq2)) / 2 pi of the vibrations about `q`, Hz, ascending.

    `mass` is a number for each node, or the matrix M of `inertia.mass_matrix`. `free` (nodes, 3) says which coordinates
    may move; where not given, all. Left out are the rigid motions that these allow, and the `stiff_modes` highest,
    where springs stand for constraints. A direction in which U falls or stays the same (an unstable or floppy mode)
    counts as 0 Hz, and so does what only rounding makes different from that.
    """
    refuse_traced((energy, mass, q), "natural_frequencies", "take them of jax.hessian of the scene's potential_energy")
    with jax.enable_x64(True):
        hessian = np.asarray(_expansion(energy)(np.array(q, float))[2])
    moves = np.flatnonzero(np.ones(np.size(q), bool) if free is None else free)
    M = np.asarray(mass, float)
    M = (np.diag(np.repeat(M, 3)) if M.ndim == 1 else M)[np.ix_(moves, moves)]
    root = np.linalg.cholesky(M)
    half = np.linalg.solve(root, hessian.reshape(np.size(q), -1)[np.ix_(moves, moves)])
    scaled = np.linalg.solve(root, half.T)
    rigid = root.T @ _rigid_motions(np.asarray(q, float), moves)
    basis, size, _ = np.linalg.svd(rigid)
    vibrating = basis[:, np.sum(size > 1e-9 * size.max(initial=0)) :]
    squares = np.linalg.eigvalsh(vibrating.T @ scaled @ vibrating)
    real = squares[: squares.size - stiff_modes]
    if not real.size:
        return real
    rounding = max(ROUNDING * real[-1], 100 * np.finfo(float).eps * squares[-1])
    return np.sqrt(np.where(real > rounding, real, 0)) / (2 * np.pi)


def _expansion(energy: Energy) -> Callable:
    """U, dU/dq and d2U/dq2, as one program for the equilibrium and the frequencies of an energy.

    Where the energy is a module, its numbers are inputs of a program that all energies of its kind share.
    """
    return partial(_expanded, energy) if isinstance(energy, eqx.Module) else _expansion_of_one(energy)


@lru_cache(maxsize=1)
def _expansion_of_one(energy: Energy) -> Callable:
    return jax.jit(lambda q: _expanded(energy, q))


@eqx.filter_jit
def _expanded(energy: Energy, q: NodeVectors) -> tuple[Scalar, NodeVectors, AnyArray]:
    return energy(q), jax.grad(energy)(q), jax.hessian(energy)(q)


def _rigid_motions(q: np.ndarray, moves: np.ndarray) -> np.ndarray:
    """Translations and rotations that leave all other coordinates than `moves` where they are, as columns of those."""
    axes = np.eye(3)
    shifts = [np.tile(axis, (len(q), 1)) for axis in axes]
    turns = [np.cross(axis, q - q.mean(0)) for axis in axes]
    motions = np.stack([motion.ravel() for motion in shifts + turns], axis=1)
    held = np.delete(motions, moves, axis=0)
    if not held.size:
        return motions
    _, size, rows = np.linalg.svd(held)
    return (motions @ rows[np.sum(size > 1e-9 * size.max()) :].T)[moves]
