"""Derivatives of a robot's steady speed in its gait: tangents carried along the orbit until they settle.

On an attracting orbit x* = P(x*, p) deviations shrink from cycle to cycle, and a tangent forgets its start. After a
cycle dx/dp is J dx/dp + dP/dp. Its limit is the derivative of the implicit function theorem, (I - J)^-1 dP/dp, in all
directions but the neutral ones: a shift along the ground and a turn about its normal. Those grow, and do not change the
speed. So nothing is solved and no gauge is fixed. There are as many tangents as the gait has numbers; the theorem needs
all of J.
"""

from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Float

from jaxgrity.core.arguments import check_count
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, Count, PerActuator, Scalar
from jaxgrity.model.actuation import Gait, Overtone
from jaxgrity.model.scales import speed_scale, time_scale
from jaxgrity.model.scene import Scene, as_dtype, with_gait
from jaxgrity.orbits.cycles import Plane, plane_of, turned_by, way_along
from jaxgrity.orbits.finding import FRAMES, Orbit, check_orbit, in_step, period_of, restarted
from jaxgrity.stepping.complementarity import ImpulseState
from jaxgrity.stepping.discretisation import discretise, with_scales_and_mobility
from jaxgrity.stepping.loop import Carried, carried_at, numbered, repeated
from jaxgrity.stepping.options import Options, ResolvedOptions, resolve

FEWEST_CYCLES, MOST_CYCLES = 3, 40
"""Fewest and most cycles through which tangents are carried: two cannot show whether they settle."""
SETTLED_TO = 1e-5
"""Largest change of any derivative over a cycle, as a share of the largest derivative, at which tangents have
settled."""
TINY = 1e-9
"""Size below which a derivative counts as zero, m/s or rad/s for a body of one metre. The derivative is that by a
number of the gait."""


class GaitNumbers(NamedTuple):
    """The numbers of a gait with one frequency, or derivatives in them."""

    phase: PerActuator
    """rad; of derivatives, per rad"""
    amplitude: PerActuator
    frequency: Scalar
    """Hz, common to all actuators"""
    overtones: tuple[Overtone, ...] = ()
    """sizes and phases (rad)"""


class SpeedGradient(NamedTuple):
    """Speed and turning of an orbit, and their derivatives in the gait's numbers."""

    speed: float
    """m/s, of the last cycle"""
    turning: float
    """rad/s about the ground's normal, positive to the left"""
    of_speed: GaitNumbers
    """d speed/d number"""
    of_turning: GaitNumbers
    """d turning/d number"""
    change: float
    """of any of these derivatives in the last cycle, as a share of the largest of its kind; at most `SETTLED_TO`
    where tangents have settled"""
    cycles: int
    """through which tangents were carried"""

    @property
    def settled(self) -> bool:
        """Whether the derivatives are those of an orbit. Without an attracting orbit, tangents never settle."""
        return bool(self.change <= SETTLED_TO)


@typed
def speed_gradient(
    scene: Scene, orbit: Orbit, *, options: Options = None, most_cycles: int = MOST_CYCLES
) -> SpeedGradient:
    """The derivatives of an orbit's speed and turning in phases, amplitudes, frequency and overtones of its gait.

    Tangents are carried from cycle to cycle, in forward mode, until they settle on those of the implicit function
    theorem (see the module). The number of steps in a cycle is held: a change of frequency changes the step with the
    period.

    The stepped motion is differentiated. With smooth laws (penalty contact, smooth friction) these are the derivatives
    of the orbit's speed, except at corners at single values of the numbers. With exact contact, touch-downs and ends of
    sticking fall on whole steps. Where one of them moves to another step the speed jumps, by about as much as one step
    changes; no derivative sees that (docs/gaits.md). Between two such values the speed is smooth, and these are its
    derivatives.

    Args:
        scene: a plane ground, and the gait of the orbit.
        orbit: as from `find_orbit`, by the same options.
        options: solver options with a fixed step; by default the scene's. The precision is float64.
        most_cycles: the limit; beyond it `SpeedGradient.settled` is false.

    Returns:
        Speed, turning and their derivatives; they are valid where `SpeedGradient.settled`.

    Raises:
        InputError: bad options (see `resolve`), a method that adapts its step, an orbit whose rollout failed, fewer
            than three cycles, a scene without a gait.

    Example:
        >>> scene = jaxgrity.with_gait(jaxgrity.load_scene("exact"), jaxgrity.load_gait("lasting"))
        >>> orbit = jaxgrity.orbits.find_orbit(scene, 80.0)
        >>> found = jaxgrity.orbits.speed_gradient(scene, orbit)
        >>> bool(abs(found.speed - orbit.speed) < 1e-6), found.of_speed.phase.shape  # m/s
        (True, (6,))
    """
    _checked(scene, orbit, most_cycles)
    at, unravel = ravel_pytree(numbers_of(check_orbit(scene, orbit)))
    found = derivatives_along(scene, orbit, np.eye(at.size), options=options, most_cycles=most_cycles)
    of_speed, of_turning = (jax.tree.map(np.asarray, unravel(jnp.asarray(column))) for column in found.rows.T)
    return SpeedGradient(*found.told, of_speed, of_turning, found.change, found.cycles)


class Derivatives(NamedTuple):
    """Speed and turning, and their derivatives along some directions."""

    told: tuple[float, float]
    """m/s and rad/s"""
    rows: Float[np.ndarray, "directions 2"]
    change: float
    """as `SpeedGradient.change`"""
    cycles: int

    @property
    def settled(self) -> bool:
        """As `SpeedGradient.settled`."""
        return bool(self.change <= SETTLED_TO)


def derivatives_along(
    scene: Scene,
    orbit: Orbit,
    directions: Float[AnyArray, "directions numbers"],
    *,
    options: Options,
    most_cycles: int,
) -> Derivatives:
    """`speed_gradient` along directions in the space of the gait's numbers, in the order of `GaitNumbers`.

    The cost is one tangent for each direction. Raises `InputError` as `speed_gradient` does.
    """
    plane, here = _checked(scene, orbit, most_cycles), restarted(scene, orbit)
    chosen = resolve(here, orbit.period, in_step(scene, orbit.period, options))
    assert chosen.dt is not None, "`in_step` gives a step"
    here, steps = as_dtype(here, "float64"), round(orbit.period / FRAMES / float(chosen.dt))
    frames = orbit.periods * FRAMES
    along, carried = jnp.asarray(directions, float), _first(here, chosen, orbit)
    tangents = jax.tree.map(lambda x: jnp.zeros((len(along), *x.shape)), eqx.filter(carried, eqx.is_inexact_array))
    places, rows = [(carried[0][0], tangents[0][0])], np.full((len(along), 2), np.nan)
    best, cycles = Derivatives((np.nan, np.nan), rows, np.inf, 0), 0
    units = np.array([float(speed_scale(here)), 1 / float(time_scale(here))])
    while cycles < most_cycles and not best.change <= SETTLED_TO:
        for k in range(frames):
            frame = np.asarray(k % FRAMES)  # an input: a number would be a program for each of them
            carried, tangents = _advanced(here, chosen.as_inputs(), steps, frame, carried, (along, tangents))
            # two cycles are kept below: turning is the angle from one to the same moment of the next
            places.append((carried[0][0], tangents[0][0]))
        cycles, last, places = cycles + 1, rows, places[-2 * frames - 1 :]
        if cycles > 1:
            told, rows = _mean_told(here, plane, along, places)
            change = _change(rows / units, last / units)
            # rounding takes over where an orbit repeats itself to the last digits: the best cycle counts
            best = Derivatives(told, rows, change, cycles) if change <= best.change else best
    return best._replace(cycles=cycles)


def _checked(scene: Scene, orbit: Orbit, most_cycles: int) -> Plane:
    """The plane of the scene. Raises `InputError` as `speed_gradient` does."""
    check_count("most_cycles", most_cycles, FEWEST_CYCLES)
    period_of(check_orbit(scene, orbit))
    return plane_of(scene)


def numbers_of(gait: Gait) -> GaitNumbers:
    """The gait's numbers, in float64."""
    found = GaitNumbers(gait.phase, gait.amplitude, jnp.ravel(gait.frequency)[0], gait.overtones)
    return jax.tree.map(lambda x: jnp.asarray(x, float), found)


def gait_with(gait: Gait, numbers: GaitNumbers) -> Gait:
    """The gait with these numbers."""
    frequency = numbers.frequency * jnp.ones_like(gait.phase)
    parts: dict[str, Any] = {"phase": numbers.phase, "amplitude": numbers.amplitude, "frequency": frequency}
    return replace(gait, **parts, overtones=numbers.overtones)


def _change(new: np.ndarray, old: np.ndarray) -> float:
    """The largest change of a derivative, as a share of the largest of its column; infinite where one is not finite."""
    if not (np.isfinite(new).all() and np.isfinite(old).all()):
        return float(np.inf)
    sizes = np.abs(new).max(0)
    return float(np.max(np.abs(new - old).max(0) / np.where(sizes > TINY, sizes, 1.0)))


def _first(scene: Scene, options: ResolvedOptions, orbit: Orbit) -> Carried:
    """The carry of the first step, from a point beside the orbit: the state, and the method's memory.

    Complementarity stepping begins with half a kick. In a motion that repeats itself to the last digit, the derivatives
    of nodes that just touch are rounding; on the way back to the orbit, tangents settle before that.
    """
    assert options.dt is not None, "`in_step` gives a step"
    q, v = orbit.state
    start = jnp.asarray(q, float), jnp.asarray(v, float)
    motion, memory = carried_at(discretise(options), with_scales_and_mobility(scene), 0.0, options.dt, start)
    if isinstance(memory, ImpulseState):
        memory = memory._replace(step_size=jnp.zeros_like(memory.step_size))
    return jax.tree.map(jnp.asarray, Carried(motion, memory))


@eqx.filter_jit
def _advanced(scene: Scene, options: ResolvedOptions, steps: int, frame: Count, carried, tangents):
    """The carry and its tangents along each direction, one frame later."""
    assert scene.gait is not None, "an orbit has a gait"
    at, unravel = ravel_pytree(numbers_of(scene.gait))
    moving, fixed = eqx.partition(carried, eqx.is_inexact_array)

    def after(numbers, moving):
        there = with_gait(scene, gait_with(scene.gait, unravel(numbers)))
        end = _rolled(there, options, steps, frame, eqx.combine(moving, fixed))
        return eqx.partition(end, eqx.is_inexact_array)

    def along(number, tangent):
        end, later, rest = jax.jvp(after, (at, moving), (number, tangent), has_aux=True)
        return end, rest, later

    end, rest, later = jax.vmap(along, out_axes=(None, None, 0))(*tangents)
    return eqx.combine(end, rest), later


def _rolled(scene: Scene, options: ResolvedOptions, steps: int, frame: Count, carried):
    """The carry after the steps of one of the `FRAMES` of a period."""
    assert scene.gait is not None, "an orbit has a gait"
    # traced: by way of the step's size the tangent of the frequency reaches every step
    h = 1 / (scene.gait.frequency[0] * steps * FRAMES)
    step = numbered(discretise(options), with_scales_and_mobility(scene), h)
    return repeated(step, carried, frame * steps + jnp.arange(steps, dtype=float))


def _mean_told(scene: Scene, plane: Plane, along: AnyArray, places: list) -> tuple[tuple[float, float], np.ndarray]:
    """Speed and turning, and their derivatives, (directions, 2), from the robot's places in the frames of two cycles.

    The turning is the mean over the cycles that begin with each of the periods, the speed that of the last cycle.
    """
    q, tangents = jax.tree.map(lambda *x: jnp.stack(x), *places)
    (speed, turning), rows = _told_rows(scene, plane.axes, plane.turns, along, q, tangents)
    return (float(speed), float(turning)), np.asarray(rows)


@eqx.filter_jit
def _told_rows(scene: Scene, axes: AnyArray, turns: bool, along: AnyArray, q, tangents):
    assert scene.gait is not None, "an orbit has a gait"
    at, unravel = ravel_pytree(numbers_of(scene.gait))
    share, frames = scene.structure.lumped_mass / scene.structure.mass, len(q) // 2

    def told(numbers, q):
        levelled, time = q @ axes, frames / FRAMES / unravel(numbers).frequency
        before, after = (levelled[k : k + frames : FRAMES] for k in (0, frames))
        turned = jnp.mean(jax.vmap(partial(turned_by, share))(before, after)) if turns else 0.0 * time
        path = jnp.einsum("n,fnk->fk", share, levelled[frames:])[:, :2]
        return jnp.stack([way_along(path, turned / frames) * frames / time, turned / time])

    def derivative(number, change):
        return jax.jvp(told, (at, q), (number, change))

    return jax.vmap(derivative, out_axes=(None, 0))(along, jnp.swapaxes(tangents, 0, 1))
