"""Long-run motion of perturbed robots: the speed of each, and the bend of its path."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from jaxgrity.core.arguments import check_count, check_number
from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import PerGait
from jaxgrity.model.scene import Scene, body_length
from jaxgrity.populations.population import as_population
from jaxgrity.populations.uncertainty import Uncertainty
from jaxgrity.search.judging import Fitness, ensembles_rolled_out, over_robots
from jaxgrity.search.models import model_of
from jaxgrity.search.objectives import SteadySpeed
from jaxgrity.search.paths import MOMENTS, SETTLING_SHARE, parts_of, path_bend, stays, steady_velocity, whole_cycles
from jaxgrity.stepping.options import Options


class RobotMotions(NamedTuple):
    """The motion of every robot after the first quarter of its rollout."""

    speed: PerGait
    """(robots,), m/s along the path of the centre of mass, as that of an orbit is; NaN where the rollout failed"""
    velocity: Float[np.ndarray, "robots 2"]
    """m/s, displacement over time: less than the speed where the path bends; NaN where the rollout failed"""
    bend: PerGait
    """(robots,), rad to the left in a body length of the path; NaN where the rollout failed, or the robot stays where
    it is (`STILL`)"""
    counted_from: float
    """s, the time from which motion counts"""

    def summary(self) -> dict[str, Any]:
        """Means and standard deviations, m/s (`over_robots`); of bends median and quartiles, None where all failed.

        Robots that failed are counted, and in no other number. Those that stay where they are have no bend: their
        number is "stay".
        """
        known = self.bend[np.isfinite(self.bend)]
        quartiles = np.quantile(known, (0.25, 0.5, 0.75)).tolist() if known.size else [None] * 3
        speed, moved = over_robots(self.speed), over_robots(np.hypot(*self.velocity.T))
        return {
            "speed": speed.pop("mean"),
            **speed,
            "displacement": moved["mean"],
            "displacement_standard_deviation": moved["standard_deviation"],
            "bend": quartiles[1],
            "bend_quartiles": quartiles[::2],
            "stay": int((np.isfinite(self.speed) & np.isnan(self.bend)).sum()),
            "counted_from": self.counted_from,
        }


@typed
def robot_motions(
    scene: Scene,
    uncertainty: Uncertainty,
    *,
    robots: int = 128,
    duration: float = 60.0,
    cycle: float | None = None,
    seed: int = 0,
    options: Options = None,
) -> RobotMotions:
    """Roll the scene's gait out on perturbed robots.

    Args:
        scene: with a gait.
        uncertainty: half-widths of the perturbations; draws come in pairs of opposite signs.
        robots: their number.
        duration: s, with the first quarter for settling; rounded up to whole cycles, and longer for a gait that is in
            full swing only after that quarter.
        cycle: s, of the gait's orbit, in which robots sway; by default a period of actuation.
        seed: seed of the draws.
        options: solver options; by default the scene's.

    Raises:
        InputError: no gait, no robots, no time, a scene without an uncertain quantity, or bad options (see `resolve`).

    Example:
        >>> scene = jaxgrity.with_gait(jaxgrity.load_scene("exact"), jaxgrity.load_gait("lasting"))
        >>> found = jaxgrity.search.robot_motions(scene, jaxgrity.Uncertainty(friction=0.2), robots=4, duration=20.0)
        >>> found.speed.shape, bool(found.speed.mean() > 0.5)  # m/s
        ((4,), True)
    """
    if scene.gait is None:
        raise InputError("robot motions: the scene has no gait; expected with_gait(scene, gait)")
    check_count("robots", robots, 1)
    check_count("seed", seed, 0)
    duration = max(
        check_number("duration", duration, above=0.0, unit="s"),
        float(scene.gait.start + scene.gait.ramp) / SETTLING_SHARE,
    )
    if cycle is None:
        parts, duration = parts_of(scene, scene.gait, duration)
    else:
        parts, duration = whole_cycles(scene, duration, check_number("cycle", cycle, above=0.0, unit="s"))
    model = model_of(scene, duration, options)
    fitness = Fitness(SteadySpeed(), uncertainty, robots)
    *_, outcomes = ensembles_rolled_out(
        jax.random.key(seed), model, as_population(scene.gait), duration, fitness, MOMENTS * parts, False
    )
    outcomes = jax.tree.map(lambda x: x[: fitness.rollouts], outcomes)
    held, size = np.asarray(outcomes.failure) == 0, float(body_length(scene))
    speed, bend = (np.asarray(each, float) for each in _path_bend(scene, outcomes, np.asarray(duration), MOMENTS))
    velocity = np.asarray(steady_velocity(outcomes, np.asarray(duration)), float)
    speed = np.where(held, size * speed, np.nan)
    return RobotMotions(speed, velocity, np.where(held & ~stays(scene, speed), bend, np.nan), SETTLING_SHARE * duration)


_path_bend = eqx.filter_jit(path_bend)
