"""Attraction of the gaits' orbits: a search prefers orbits to which disturbed robots return."""

import numpy as np
from jaxtyping import Float

from jaxgrity.model.actuation import Gait
from jaxgrity.model.scene import Scene, with_gait
from jaxgrity.orbits.finding import find_orbit, shortest_watch
from jaxgrity.orbits.orbit_stability import stability
from jaxgrity.populations.population import one_gait
from jaxgrity.stepping.methods import default_method
from jaxgrity.stepping.options import SolverOptions
from jaxgrity.stepping.step_limits import default_step


def orbit_multipliers(scene: Scene, gaits: Gait, dt: float) -> Float[np.ndarray, " gaits"]:
    """The largest multiplier of each gait's orbit (`stability`); infinite without an orbit.

    Steps are `dt` (s), or the scene's for a gait that needs smaller ones. Raises `InputError` as
    `find_orbit` does.
    """
    return np.array([_multiplier(with_gait(scene, one_gait(gaits, k)), dt) for k in range(len(gaits.phase))])


def multiplier_words(multiplier: float) -> str:
    """A Floquet multiplier with two digits, or with as many as tell it from 1, beyond which an orbit repels."""
    shown = (f"{multiplier:.{digits}g}" for digits in range(2, 17))
    return next((each for each in shown if float(each) != 1), "1")


def _multiplier(scene: Scene, dt: float) -> float:
    assert scene.gait is not None, "it was given"
    options = SolverOptions(dt=min(dt, default_step(scene, default_method(scene))))
    orbit = find_orbit(scene, shortest_watch(scene.gait), options=options)
    return stability(scene, orbit, options=options).largest if orbit.settled else np.inf
