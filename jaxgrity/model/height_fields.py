"""Ground whose height is a function of x and y: waves, random bumps, measured heights, a function of one's own."""

from collections.abc import Callable
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.arguments import as_table, check_count, check_each, check_finite, check_index, check_number
from jaxgrity.core.elementwise import clipped, sine
from jaxgrity.core.errors import InputError
from jaxgrity.core.primitives import population_last
from jaxgrity.core.types import AnyArray, as_float
from jaxgrity.model.surface import Surface


class HeightField(Surface):
    """f = z - h(x, y), with the `height` h that a subclass gives: a distance to first order near the ground alone."""

    smooth: ClassVar[bool] = True
    curved: ClassVar[bool] = True

    @property
    def level_is_distance(self):
        return False

    def level(self, x, y, z):
        return z - self.height(x, y)


class HeightFunction(HeightField):
    """f = z - h(x, y), for a smooth function h of arrays, element by element, written in `jax.numpy`."""

    function: Callable = eqx.field(static=True)
    """h, m"""

    def __check_init__(self):
        if not callable(self.function):
            raise InputError(f"heights = {self.function!r}: expected a function of x and y, m")

    def height(self, x, y):
        h = self.function(x, y)
        # a height that is no number has no slope either: else nodes would fall through it without a failure
        return h + 0 * (x - jax.lax.stop_gradient(x)) * jax.lax.stop_gradient(h)


class HeightWaves(HeightField):
    """f = z - sum a_k sin(2 pi (x cos(d_k) + y sin(d_k))/l_k + p_k)."""

    amplitude: AnyArray = eqx.field(converter=as_float)
    """a, (waves,), m"""
    length: AnyArray = eqx.field(converter=as_float)
    """l, (waves,), m"""
    direction: AnyArray = eqx.field(converter=as_float)
    """d, (waves,), rad, from x towards y"""
    phase: AnyArray = eqx.field(converter=as_float)
    """p, (waves,), rad"""

    def __check_init__(self):
        shapes = {name: np.shape(value) for name, value in vars(self).items()}
        if len(set(shapes.values())) > 1 or len(shapes["amplitude"]) != 1:
            raise InputError(f"waves: shapes {shapes}; expected one number a wave in each")
        if shapes["length"] == (0,):
            raise InputError("waves: there are none; expected one wave or more, or no surface for a plane")
        check_each("waves.length", self.length, above=0.0, unit="m")

    def height(self, x, y):
        found = 0 * x
        for a, length, d, p in zip(self.amplitude, self.length, self.direction, self.phase):
            rate = 2 * np.pi / length
            found = found + a * sine(rate * jnp.cos(d) * x + rate * jnp.sin(d) * y + p)
        return found


def bumps(deviation: float, length: float, seed: int, waves: int = 8) -> HeightWaves:
    """Random bumps: a sum of waves of equal heights, with random directions, phases and lengths.

    Args:
        deviation: standard deviation of the ground's height, m.
        length: typical distance from one bump to the next, m; waves are 0.7 to 1.5 times as long.
        seed: seed of the random number generator; another seed is another ground.
        waves: number of waves; each costs a sine for each node in each evaluation.

    Returns:
        The surface.

    Raises:
        InputError: a size that is not positive, or a count or a seed that is no whole number.

    Example:
        >>> ground = jaxgrity.PenaltyGround(1e4, 2.0, surface=jaxgrity.bumps(deviation=0.03, length=0.8, seed=0))
        >>> ground.height([0.0, 0.5], [0.0, 0.0]).shape  # m, at two places
        (2,)
    """
    for name, value in {"deviation": deviation, "length": length}.items():
        check_number(f"bumps.{name}", value, above=0.0)
    check_count("bumps.waves", waves, 1)
    check_index("bumps.seed", seed)
    draw = np.random.default_rng(seed)
    return HeightWaves(
        amplitude=np.full(waves, deviation * np.sqrt(2 / waves)),
        length=length * 0.7 * (1.5 / 0.7) ** draw.uniform(size=waves),
        # directions spread evenly, so that no ground is all furrows
        direction=np.pi * (np.arange(waves) + draw.uniform(size=waves)) / waves,
        phase=draw.uniform(0, 2 * np.pi, waves),
    )


class HeightMap(HeightField):
    """f = z - h(x, y), h a cubic spline through heights on a grid: slopes and curvatures are continuous.

    Beyond the grid its edge goes on, level. Made by `height_map`.
    """

    coefficients: AnyArray = eqx.field(converter=as_float)
    """(rows + 2, columns + 2), m, of the B-splines, rows along x, columns along y"""
    corner: AnyArray = eqx.field(converter=as_float)
    """(2,), m, x and y of the first row and column of heights"""
    spacing: AnyArray = eqx.field(converter=as_float)
    """(2,), m, between rows and between columns"""

    def __check_init__(self):
        if np.ndim(self.coefficients) != 2 or min(np.shape(self.coefficients)) < 6:
            shape = np.shape(self.coefficients)
            raise InputError(f"heights.coefficients has shape {shape}; expected a table, at least 6 by 6")
        check_each("heights.corner", self.corner, shape=(2,))
        check_each("heights.spacing", self.spacing, shape=(2,), above=0.0, unit="m")

    def height(self, x, y):
        rows, columns = self.coefficients.shape
        first, along_x = _cell((x - self.corner[0]) / self.spacing[0], rows - 2)
        second, along_y = _cell((y - self.corner[1]) / self.spacing[1], columns - 2)
        table = jnp.asarray(self.coefficients).reshape(-1)
        found = 0 * x
        for i, a in enumerate(along_x):
            for j, b in enumerate(along_y):
                found = found + a * b * population_last(table[(first + i) * columns + second + j])
        return found


def height_map(heights, size: tuple[float, float], centre: tuple[float, float] = (0.0, 0.0)) -> HeightMap:
    """Measured ground: the cubic spline through heights on a grid.

    Args:
        heights: (rows, columns), m, at least 4 of each; rows along x, columns along y.
        size: m, along x from the first row to the last, along y from the first column to the last.
        centre: m, x and y of the middle of the grid.

    Returns:
        The surface.

    Raises:
        InputError: where heights are no table, or too few, one is not finite, or a size not positive.

    Example:
        >>> ramp = jaxgrity.height_map([[0.0] * 5, [0.1] * 5, [0.2] * 5, [0.3] * 5], size=(3.0, 4.0))
        >>> ground = jaxgrity.ExactGround(surface=ramp)
        >>> ground.height([-1.5, -0.5], [0.0, 0.0]).round(6).tolist()  # m, in the first and in the second row
        [0.0, 0.1]
    """
    h, extent = as_table("heights", heights), np.asarray(size, float)
    if h.ndim != 2 or min(h.shape) < 4:
        raise InputError(f"heights has shape {h.shape}; expected a table, at least 4 by 4")
    check_finite("heights", h)
    check_each("centre", centre, shape=(2,))
    if extent.shape != (2,) or not np.all((extent > 0) & np.isfinite(extent)):
        raise InputError(f"size = {size}: expected two positive numbers, m")
    coefficients = _coefficients(_coefficients(h).T).T
    return HeightMap(coefficients, np.asarray(centre) - extent / 2, extent / (np.array(h.shape) - 1))


def _coefficients(values: np.ndarray) -> np.ndarray:
    """Of the cubic B-splines through values one apart, along the first axis, which gets two more.

    At both ends the third derivative goes on through the second value ("not a knot"), so that cubics, and with them
    straight ramps, are what they are up to the edge.
    """
    count = len(values)
    system = np.zeros((count + 2, count + 2))
    for shift, weight in enumerate((1, 4, 1)):
        system[np.arange(1, count + 1), np.arange(count) + shift] = weight / 6
    system[0, :5] = system[-1, -5:] = (1, -4, 6, -4, 1)
    ends = np.zeros((1, *values.shape[1:]))
    return np.linalg.solve(system, np.concatenate([ends, values, ends]))


def _cell(u: AnyArray, count: int) -> tuple[AnyArray, tuple[AnyArray, ...]]:
    """Of `count` points on a line, 1 apart: the first of four splines about `u`, and the four's weights."""
    u = clipped(u, 0.0, count - 1.0)
    cell = jnp.clip(jnp.floor(u), 0, count - 2)
    s = u - cell
    weights = (
        (1 - s) ** 3 / 6,
        (3 * s**3 - 6 * s**2 + 4) / 6,
        (-3 * s**3 + 3 * s**2 + 3 * s + 1) / 6,
        s**3 / 6,
    )
    return cell.astype(int), weights
