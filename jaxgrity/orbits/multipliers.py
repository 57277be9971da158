"""Floquet multipliers: eigenvalues of the derivative of the map from one cycle to the next."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Complex, Float

from jaxgrity.core.arguments import check_count
from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, State
from jaxgrity.model.scene import Scene, as_dtype
from jaxgrity.orbits.cycles import Plane, moved_onto, plane_of
from jaxgrity.orbits.finding import Orbit, in_step, period_of, restarted
from jaxgrity.stepping.discretisation import discretise, with_scales_and_mobility
from jaxgrity.stepping.loop import Carried, carried_at, numbered, repeated, state_of
from jaxgrity.stepping.options import Options, ResolvedOptions, resolve

NEUTRAL = ("shift x", "shift y", "turn")
"""Names of the neutral directions on a plane: along x (down a slope), along y, and about the vertical."""
THIN = 1e-9
"""Distance of nodes from one vertical line, as a fraction of its length, below which a turn is undefined."""


class FloquetMultipliers(NamedTuple):
    """Floquet multipliers of an orbit, per cycle."""

    neutral: dict[str, float]
    """multipliers of translation and yaw, by the names in `NEUTRAL` (no "turn" on a slope). They are 1 to rounding if
    the scene is the same at all places and headings"""
    others: Complex[np.ndarray, " others"]
    """all other multipliers, largest first; NaN if the derivative is not finite"""
    directions: Complex[np.ndarray, "others 2 nodes 3"]
    """their eigenvectors: deviations of positions, m, and velocities, m/s, of length 1, with centre and heading held"""
    residual: float
    """largest difference of a node's coordinate after the cycle, without the planar motion, m; it must be small for an
    orbit"""
    state: State
    """(q, v) at the beginning of the differentiated cycle"""

    @property
    def largest(self) -> float:
        """Size of the largest of the other multipliers."""
        return float(np.abs(self.others[0]))


@typed
def floquet_multipliers(
    scene: Scene, orbit: Orbit, *, options: Options = None, after: int | None = None
) -> FloquetMultipliers:
    """Floquet multipliers from the derivative of the map of the state (q, v) over one cycle.

    P(x) is the state after a cycle. G(x) is the shift and the turn that bring P(x) back to the place and the heading of
    the orbit's state x*. The map is R(x) = G(x) P(x), among states with this place and heading. DP is computed by
    tangents in forward mode, one for each coordinate of the state, through the same steps as a rollout's. DR follows
    from it, and has 6 eigenvalues for each node, less 3 (2 on a slope). The generators g of shifts and turns are left
    out. For them DP g(x) = g(P(x)) if the scene is symmetric; `neutral` shows how well this holds.

    The derivative is that of the stepped motion: contacts, sticking and taut cables are in each step as on the orbit.
    With exact contact and rigid struts, some (q, v) are impossible. The impulses of the first steps undo deviations
    that change a strut's length or move a touching node. So impossible deviations only add multipliers of 0. The
    stepped map has teeth, and its derivative is the slope of one tooth (docs/gait_records.md). For larger disturbances
    use `stability`.

    Args:
        scene: a scene on a plane, with the gait of the orbit.
        orbit: an orbit from `find_orbit` with the same options.
        options: solver options with a fixed step; by default the scene decides. The precision is float64.
        after: number of periods between the orbit's state and the beginning of the cycle; by default one cycle, so that
            the method's memory of its last step has settled.

    Returns:
        The multipliers, neutral and others separately.

    Raises:
        InputError: bad options (see `resolve`), or a method that adapts its step. An orbit whose rollout failed. A
            structure with supports, a scene without a gait, or a ground that is no plane. `after` below 0.

    Example:
        >>> scene = jaxgrity.with_gait(jaxgrity.load_scene("exact"), jaxgrity.load_gait("lasting"))
        >>> orbit = jaxgrity.orbits.find_orbit(scene, 80.0)
        >>> found = jaxgrity.orbits.floquet_multipliers(scene, orbit)
        >>> sorted(found.neutral), len(found.others), found.largest < 1
        (['shift x', 'shift y', 'turn'], 69, True)
    """
    period_of(scene.gait)
    if scene.structure.fixed:
        raise InputError("floquet_multipliers: the structure has supports, and moves nowhere; expected one without")
    if after is not None:
        check_count("after", after, 0)
    here, plane = restarted(scene, orbit), plane_of(scene)
    chosen = resolve(here, orbit.period, in_step(scene, orbit.period, options))
    assert chosen.dt is not None, "`in_step` gives a step"
    steps = round(orbit.period / float(chosen.dt))
    ahead = np.asarray(steps * (orbit.periods if after is None else after))
    start = np.asarray(orbit.state[0], float), np.asarray(orbit.state[1], float)
    found = _linearised(as_dtype(here, "float64"), chosen.as_inputs(), steps * orbit.periods, ahead, start, plane.axes)
    before, end, derivative = (np.asarray(x) for x in found)
    return _multipliers(np.asarray(scene.structure.lumped_mass, float), plane, before, end, derivative)


@eqx.filter_jit
def _linearised(
    scene: Scene, options: ResolvedOptions, steps: int, ahead: AnyArray, start: State, axes: AnyArray
) -> tuple[AnyArray, AnyArray, AnyArray]:
    """The states (2, nodes, 3) after `ahead` steps from the start and after `steps` more, in the plane's axes; and the
    derivative, (6 nodes, 6 nodes), of the one by the other."""
    scene, scheme, h = with_scales_and_mobility(scene), discretise(options), jnp.asarray(options.dt)

    step = numbered(scheme, scene, h)
    first = carried_at(scheme, scene, 0 * h, h, (jnp.asarray(start[0]), jnp.asarray(start[1])))
    there = jax.lax.fori_loop(0, ahead, lambda k, carried: step(carried, k.astype(float)), first)
    at, unravel = ravel_pytree(jnp.stack(state_of(scene, ahead * h, there)) @ axes)

    def after_a_cycle(x):
        numbers = ahead + jnp.arange(steps, dtype=float)
        q, v = unravel(x) @ axes.T
        # what the method remembers of its last step is held: deviations are those of q and v alone
        motion = carried_at(scheme, scene, ahead * h, h, (q, v)).motion
        carried = repeated(step, Carried(motion, there.memory), numbers)
        end = jnp.stack(state_of(scene, (ahead + steps) * h, carried)) @ axes
        return end.ravel(), end

    # forward mode: reverse mode would keep all steps of a cycle, for as many rows as there are columns here
    derivative, end = jax.jacfwd(after_a_cycle, has_aux=True)(at)
    return unravel(at), end, derivative


def _multipliers(
    mass: AnyArray, plane: Plane, before: AnyArray, end: AnyArray, derivative: AnyArray
) -> FloquetMultipliers:
    """Of a cycle from the state `before` to `end`, (2, nodes, 3) each, in the plane's axes."""
    if np.ptp(before[0][:, :2], axis=0).max() <= THIN * np.ptp(before[0], axis=0).max():
        plane = plane._replace(turns=False)
    moved, angle = moved_onto(mass, end[0], before[0], plane)
    c, s = np.cos(angle), np.sin(angle)
    back = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    # DR: the end is moved back, and then once more by as much as the deviation moves its centre and its heading
    turned = np.einsum("ab,nbx->nax", back, derivative.reshape(-1, 3, derivative.shape[1])).reshape(derivative.shape)
    shared, there = _generators(plane, before), _generators(plane, np.stack([moved, end[1] @ back.T]))
    fits = _fits(mass, plane, before[0])
    reduced = turned - there @ np.linalg.solve(fits @ there, fits @ turned)
    # a basis of the deviations that move neither the centre nor the heading: there R is a map into itself
    held = np.linalg.svd(fits)[2][len(fits) :].T
    values, vectors = _eigen(held.T @ reduced @ held)
    passed = np.linalg.lstsq(_generators(plane, end), derivative @ shared, rcond=None)[0]
    directions = (held @ vectors).T.reshape(-1, *before.shape) @ plane.axes.T
    residual = float(np.abs(moved - before[0]).max())
    state = before[0] @ plane.axes.T, before[1] @ plane.axes.T
    return FloquetMultipliers(dict(zip(NEUTRAL, np.diag(passed).tolist())), values, directions, residual, state)


def _eigen(matrix: AnyArray) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues, the largest first, and eigenvectors; NaN where the matrix is not finite."""
    if not np.isfinite(matrix).all():
        return np.full(len(matrix), np.nan + 0j), np.full(matrix.shape, np.nan + 0j)
    values, vectors = np.linalg.eig(matrix.astype(complex))
    order = np.argsort(-np.abs(values))
    return values[order], vectors[:, order]


def _generators(plane: Plane, state: AnyArray) -> Float[np.ndarray, "coordinates neutral"]:
    """How the state, (2, nodes, 3), in the plane's axes, changes with a shift, and with a turn about its centre."""
    (q, v), shifts = state, np.zeros((2, *state.shape))
    shifts[0, 0, :, 0] = shifts[1, 0, :, 1] = 1
    if not plane.turns:
        return shifts.reshape(2, -1).T
    away, up = q - q.mean(0), np.array([0.0, 0, 1])
    return np.stack([*shifts, np.stack([np.cross(up, away), np.cross(up, v)])]).reshape(3, -1).T


def _fits(mass: AnyArray, plane: Plane, q: AnyArray) -> Float[np.ndarray, "neutral coordinates"]:
    """Rows by which a deviation shifts the centre of mass and turns the robot, as `moved_onto` has it, of positions."""
    share, rows = mass / mass.sum(), np.zeros((3, 2, *q.shape))
    away = q - share @ q
    rows[0, 0, :, 0] = rows[1, 0, :, 1] = share
    rows[2, 0, :, 0], rows[2, 0, :, 1] = -share * away[:, 1], share * away[:, 0]
    return rows[: 3 if plane.turns else 2].reshape(-1, 2 * q.size)
