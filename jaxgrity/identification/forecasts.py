"""The speed of a gait on an identified robot, with its uncertainty, and what to measure next."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxgrity.core.display import in_digits
from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray
from jaxgrity.identification.fits import Identified
from jaxgrity.identification.parameters import Parameter, changed
from jaxgrity.identification.posterior import deviates, robots_at
from jaxgrity.model.actuation import Gait
from jaxgrity.model.scene import Scene, with_gait
from jaxgrity.orbits.closed_orbits import closed_orbit
from jaxgrity.orbits.cycles import plane_of, way_along
from jaxgrity.orbits.finding import Orbit, find_orbit, in_step, restarted
from jaxgrity.populations.population import gaits_of, simulate_population
from jaxgrity.populations.uncertainty import Differences
from jaxgrity.stepping.options import Options, ResolvedOptions, resolve

SETTLING, WATCHED = 8, 4
"""Number of cycles in which robots settle, and number of cycles over which their speed is measured."""
PLACES = 24
"""Most points per cycle through which a robot's path is followed."""
FEWEST = 5
"""Fewest robots for which correlations are computed."""
ROLLING = 0.85
"""A robot rolls if it reaches this share of the most probable robot's speed."""
LINEAR = 0.8
"""Smallest share of the variance that a linear function must explain before its slopes are used."""


class SpeedForecast(NamedTuple):
    """The steady speed of a gait over the robots plausible after measurements."""

    orbit: Orbit
    """of the most probable robot"""
    names: tuple[str, ...]
    """of the parameters"""
    slopes: Float[np.ndarray, " parameters"] | None
    """m/s, d speed/d z, z in plausible spreads; None with exact contact, where an orbit has no such derivative"""
    gradient_deviation: float | None
    """m/s, sqrt(s'Cs): the standard deviation of the speed by the slopes s and the covariance C of z"""
    gradient_shares: Float[np.ndarray, " parameters"] | None
    """from the slopes, the share of the speed's variance removed by exact knowledge of a parameter"""
    deviations: Float[np.ndarray, "robots parameters"]
    """of the robots' z from those of the most probable one"""
    speeds: Float[np.ndarray, " robots"]
    """m/s; 0 where a rollout failed"""

    @property
    def mean(self) -> float:
        """m/s, over the robots."""
        return float(self.speeds.mean())

    @property
    def standard_deviation(self) -> float:
        """m/s, of the robots' speeds."""
        return float(self.speeds.std(ddof=1))

    @property
    def rolling(self) -> float:
        """Share of the robots above `ROLLING` of the most probable one's speed."""
        return float((self.speeds >= ROLLING * self.orbit.speed).mean())

    @property
    def shares(self) -> np.ndarray:
        """(parameters,), as `gradient_shares`, from the robots alone: squared correlations of speed and z.

        Without correlation such a number is about 1/n over n robots.
        """
        z, v = self.deviations - self.deviations.mean(0), self.speeds - self.speeds.mean()
        sizes = np.sum(z**2, axis=0) * np.sum(v**2)
        return np.divide((z.T @ v) ** 2, sizes, out=np.zeros(z.shape[1]), where=sizes > 0)

    @property
    def explained(self) -> float:
        """Share of the variance over the robots explained by a linear function of all z: near 1, the shares are
        complete."""
        columns = np.column_stack([np.ones(len(self.speeds)), self.deviations])
        left = self.speeds - columns @ np.linalg.lstsq(columns, self.speeds, rcond=None)[0]
        return float(1 - left.var() / self.speeds.var()) if self.speeds.var() > 0 else 1.0

    def summary(self) -> str:
        """The speed, and what to measure next, the most useful first."""
        shares = self.shares
        if self.gradient_shares is not None and self.explained >= LINEAR:
            shares = self.gradient_shares
        lines = [
            f"{in_digits(self.mean, 4)} m/s (standard deviation {in_digits(self.standard_deviation, 2)}) over "
            f"{len(self.speeds)} robots, of which {self.rolling:.0%} roll; "
            f"the most probable one: {in_digits(self.orbit.speed, 4)} m/s"
        ]
        for k in np.argsort(-shares):
            lines.append(f"{self.names[k]}, known exactly: variance of the speed down by {shares[k]:.0%}")
        return "\n".join(lines)


@typed
def speed_forecast(
    key: jax.Array,
    found: Identified,
    gait: Gait | None = None,
    *,
    robots: int = 128,
    duration: float = 80.0,
    options: Options = None,
    on_progress: Callable[[int, int], object] = lambda done, total: None,
) -> SpeedForecast:
    """The spread of a gait's steady speed over robots plausible after measurements, and what to measure next.

    With C the covariance of the z and s = d speed/d z on the orbit, the speed's variance is s'Cs. Exact knowledge of
    parameter k lowers it by (s'C e_k)^2/C_kk, since correlated parameters become known with it. The shares are that
    over s'Cs; a further measurement of variance C_kk brings half of it. The same shares follow without derivatives from
    robots that begin on the most probable one's orbit. The slopes are those of that orbit alone: where robots fall off
    it, the shares over the robots count (`SpeedForecast.explained`).

    Args:
        key: of the robots.
        found: from `identify` with a `Scene`, for parameters in which robots of a population can differ.
        gait: of one frequency; by default the scene's own.
        robots: the number of draws.
        duration: s, of the most probable robot's rollout, to find its orbit.
        options: solver options with a fixed step; by default the scene's.
        on_progress: called with the numbers of finished and of all stages, at first and after each of the three.

    Returns:
        Speeds, slopes and shares.

    Raises:
        InputError: no such gait, a gait without an orbit, fewer than 5 robots, lengths of rigid struts among the
            parameters, or as `posterior_robots` and `find_orbit`.
    """
    if robots < FEWEST:
        raise InputError(f"robots = {robots}: expected at least {FEWEST}, to see how they differ")
    scene = found.scene if gait is None else with_gait(found.scene, gait)
    if not isinstance(scene, Scene):
        raise InputError(f"found: the scene is a {type(scene).__name__}; expected what identify made of a Scene")
    drawn = deviates(key, found, robots)
    differences = robots_at(found, drawn)
    if differences.strut_rest_length is not None and scene.structure.struts.rigid:  # type: ignore[union-attr]
        found_in = "structure.struts.rest_length: rigid struts of other lengths cannot start on the same orbit"
        raise InputError(f"{found_in}; expected struts as springs, or a fit without it")
    on_progress(0, 3)
    orbit = find_orbit(scene, duration, options=options)
    on_progress(1, 3)
    if not orbit.settled:
        raise InputError(f"gait: in {duration:g} s it settles on no orbit; expected one that lasts, or more time")
    slopes, deviation, shares = None, None, None
    if not scene.constrained:
        slopes = speed_slopes(scene, found.parameters, orbit, options=options)
        variance, pulls = slopes @ found.covariance @ slopes, found.covariance @ slopes
        deviation, shares = float(np.sqrt(variance)), pulls**2 / np.diag(found.covariance) / max(variance, 1e-300)
    on_progress(2, 3)
    speeds = speeds_of_robots(scene, orbit, differences, robots, options=options)
    on_progress(3, 3)
    return SpeedForecast(orbit, tuple(p.name for p in found.parameters), slopes, deviation, shares, drawn, speeds)


@typed
def speed_slopes(
    scene: Scene, parameters: tuple[Parameter, ...], orbit: Orbit, *, options: Options = None
) -> Float[np.ndarray, " parameters"]:
    """d speed/d z of an orbit, m/s per plausible spread, by the implicit function theorem (`closed_orbit`).

    Args:
        scene: with penalty contact, and the gait of the orbit.
        parameters: of the scene, which is z = 0.
        orbit: as from `find_orbit`, by the same options.
        options: as for `find_orbit`.

    Raises:
        InputError: rigid struts or exact contact; as `closed_orbit`; or an orbit that Newton's method does not close.
    """
    if scene.constrained:
        raise InputError("speed_slopes: the scene has rigid struts or exact contact; expected `penalty_twin(scene)`")
    resolved = resolve(scene, orbit.period, in_step(scene, orbit.period, options))
    slopes = np.asarray(_speed_slopes(scene, parameters, orbit, resolved))
    if not np.isfinite(slopes).all():
        raise InputError("orbit: Newton's method does not close it; expected one that a cycle maps on itself")
    return slopes


@eqx.filter_jit
def _speed_slopes(scene: Scene, parameters: tuple[Parameter, ...], orbit: Orbit, options: ResolvedOptions) -> AnyArray:
    def speed(z):
        return closed_orbit(changed(scene, parameters, z), orbit, options).speed

    return jax.jacfwd(speed)(jnp.zeros(len(parameters)))


def speeds_of_robots(
    scene: Scene, orbit: Orbit, differences: Differences, robots: int, *, options: Options
) -> Float[np.ndarray, " robots"]:
    """Steady speeds, m/s, of perturbed robots from the scene's orbit; 0 where a rollout fails.

    Over `WATCHED` cycles, after `SETTLING` cycles, along a line or about the centre of a turn, as for an orbit.
    """
    here, chosen = restarted(scene, orbit), in_step(scene, orbit.period, options)
    assert here.gait is not None, "an orbit has a gait"
    gaits = gaits_of(here.gait, np.repeat(np.asarray(here.gait.phase)[None], robots, axis=0))
    begun: Any = np.repeat(np.asarray(orbit.state[1])[None], robots, axis=0)
    differences = eqx.tree_at(lambda d: d.velocities, differences, begun, is_leaf=lambda x: x is None)
    assert chosen.dt is not None, "`in_step` gives a step"
    cycles, places = SETTLING + WATCHED, _places(round(orbit.cycle / float(chosen.dt)))
    outcomes = simulate_population(
        here, gaits, cycles * orbit.cycle, options=chosen, differences=differences, parts=cycles * places
    )
    paths = (np.asarray(outcomes.com_path, float)[:, SETTLING * places :] @ plane_of(scene).axes)[:, :, :2]
    return np.where(np.asarray(outcomes.failure) == 0, steady_speeds(paths, places, orbit.cycle), 0.0)


def steady_speeds(paths: Float[np.ndarray, "robots places 2"], each: int, cycle: float) -> Float[np.ndarray, " robots"]:
    """m/s, from places, m, `each` of them in a cycle of that many seconds."""
    x, y = np.diff(paths[:, ::each], axis=1).T
    along = x + 1j * y
    # places as complex numbers: the angle of this sum is the turn per cycle, in which long ways count for more
    turned = np.angle((along[1:] * np.conj(along[:-1])).sum(0))
    ways = [way_along(path, angle / each) for path, angle in zip(paths, turned)]
    return np.array(ways, float) * each / cycle


def _places(steps: int) -> int:
    """The number of samples in a cycle of some steps: up to `PLACES`, a whole number of steps apart."""
    return max(count for count in range(1, PLACES + 1) if steps % count == 0)
