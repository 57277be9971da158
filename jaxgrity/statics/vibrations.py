"""Small vibrations about an equilibrium: natural frequencies and modes, with supports, prestress and members' mass."""

from typing import NamedTuple

import numpy as np
import scipy.linalg
import scipy.sparse as sp
from jaxtyping import Float

from jaxgrity.core.arguments import check_count, check_each
from jaxgrity.core.tracing import refuse_traced
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, NodeVectors, PerRow, Times
from jaxgrity.model.scene import Scene
from jaxgrity.statics.spectrum import Spectrum
from jaxgrity.statics.spring_struts import bearing
from jaxgrity.statics.stiffness import motions_of, sparse_mass_matrix, stiffness_matrix

NO_FREQUENCY = 1e-9
"""Squared frequencies below this share of the largest are errors of the shape and of arithmetic."""
DENSE = 450
"""Most coordinates for which all modes are computed at once. Beyond, a sparse solver finds the lowest alone."""
BELOW = 1e-7
"""Shift below the lowest mode, as a share of the largest squared frequency, where no mode grows."""
EPS = float(np.finfo(float).eps)
"""Relative rounding of a number."""
LOWEST = 30
"""Default number of lowest modes where not all are computed."""


class Modes(NamedTuple):
    """Natural vibrations q + a shapes[k] sin(2 pi frequency[k] t), the slowest first, without rigid motions."""

    frequency: PerRow
    """Hz; 0 for a growing motion about a shape that is no minimum, and for one without resistance: its square is below
    1e-9 of the largest, as that of a slow pendulum of stiff members may be"""
    shapes: Float[AnyArray, "rows nodes 3"]
    """m, each with a kinetic energy of 1 J at a rate of 1/s and factor sqrt(2): shape' M shape = 1 kg m^2"""
    growing: int
    """number of unstable modes: U falls in their direction"""
    zero: int = 0
    """number of modes of 0 Hz, growing ones too, of all that the structure has"""

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
    resists are taken out beforehand, so that slow or unstable modes show. Rigid struts and slides are stiff springs
    here: the modes that stretch these are the highest, and have no meaning. Rigid bodies move and turn alone.

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
    q = np.asarray(scene.structure.nodes if q is None else q, float)
    check_each("q", q, shape=np.shape(scene.structure.nodes))
    if count is not None:
        check_count("count", count, 1)
    place, spectrum = _spectrum(scene, q)
    size = place.shape[1]
    real = size - spectrum.rigid.shape[1]
    wanted = min(real, count if count is not None else (real if size <= DENSE else LOWEST))
    dense = size <= DENSE or wanted + spectrum.rigid.shape[1] > size // 3
    squares, x, rounding, zero, growing = (_all_modes if dense else _lowest_modes)(spectrum, wanted)
    frequency = np.sqrt(np.where(squares > rounding, squares, 0)) / (2 * np.pi)
    return Modes(frequency, (place @ x).T.reshape(-1, *q.shape), growing, zero)


class FrequencyRange(NamedTuple):
    """The natural frequencies of a structure in three numbers."""

    zero: int
    """number of modes of 0 Hz"""
    lowest: float
    """Hz, of all other modes; NaN where there are none"""
    highest: float
    """Hz, likewise"""


def frequency_range(scene: Scene, q: NodeVectors, unreal: int) -> FrequencyRange:
    """What `vibration_modes` finds of a structure of any size; without the `unreal` highest modes, those of springs in
    the place of rigid struts."""
    place, spectrum = _spectrum(scene, np.asarray(q, float))
    real = place.shape[1] - spectrum.rigid.shape[1] - unreal
    if place.shape[1] <= DENSE:
        squares, _, rounding, _, _ = _all_modes(spectrum, real + unreal)
        found = np.sqrt(squares[:real][squares[:real] > rounding]) / (2 * np.pi)
        return FrequencyRange(real - len(found), *(map(float, (found[0], found[-1])) if len(found) else (np.nan,) * 2))
    rounding = NO_FREQUENCY * spectrum.stiffest()
    zero = min(spectrum.below(rounding), real)
    if zero == real:
        return FrequencyRange(zero, np.nan, np.nan)
    ends = spectrum.next_above(rounding), spectrum.last_below(real) if unreal else spectrum.largest()
    return FrequencyRange(zero, *(float(np.sqrt(square)) / (2 * np.pi) for square in ends))


def _spectrum(scene: Scene, q: np.ndarray) -> tuple[sp.csc_array, Spectrum]:
    """The free motions as columns, and stiffness, mass and rigid motions in these."""
    springs = bearing(scene, q)
    K, M = stiffness_matrix(springs, q), sparse_mass_matrix(springs.structure)
    place, rigid = motions_of(springs, q, K)
    return place, Spectrum(sp.csc_array(place.T @ K @ place), sp.csc_array(place.T @ M @ place), rigid)


Found = tuple[np.ndarray, np.ndarray, float, int, int]
"""Squared frequencies, 1/s^2, modes as columns, the square below which one is 0, numbers of zero and growing ones."""


def _all_modes(spectrum: Spectrum, count: int) -> Found:
    K, M, rigid = spectrum
    momentum = M @ rigid
    # motions without momentum: those that are orthogonal to rigid ones with respect to M
    basis = scipy.linalg.null_space(momentum.T) if rigid.shape[1] else np.eye(K.shape[0])
    squares, y = scipy.linalg.eigh(basis.T @ (K @ basis), basis.T @ (M @ basis))
    rounding = max(NO_FREQUENCY * squares[:count].max(initial=0), 100 * EPS * float(np.abs(squares).max(initial=0)))
    zero, growing = (int(np.sum(squares < side)) for side in (rounding, -rounding))
    return squares[:count], basis @ y[:, :count], rounding, zero, growing


def _lowest_modes(spectrum: Spectrum, count: int) -> Found:
    """The same by shift and invert, for a structure of any size."""
    stiffest, shift = spectrum.stiffest(), -BELOW
    while spectrum.below(shift * stiffest):  # the nearest to a shift below all are the lowest
        shift = 10 * shift
    many = spectrum.below(NO_FREQUENCY * stiffest) >= count
    squares, x = (spectrum.without_resistance if many else spectrum.lowest)(count, shift * stiffest)
    rounding = max(NO_FREQUENCY * squares.max(initial=0), 100 * EPS * stiffest)
    zero, growing = (int(np.sum(squares < side)) for side in (rounding, -rounding))
    # where these are all that was asked for, there may be more
    zero, growing = (
        spectrum.below(sign * NO_FREQUENCY * stiffest) if found == count else found
        for sign, found in ((1, zero), (-1, growing))
    )
    return squares, x, rounding, max(zero, growing), growing
