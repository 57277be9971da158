from .closed_orbits import ClosedOrbit, closed_orbit
from .error_bars import OrbitErrorBars, orbit_error_bars, refined_orbit
from .finding import Orbit, find_orbit, restarted
from .multipliers import FloquetMultipliers, floquet_multipliers
from .one_cycle import OrbitCycle, orbit_cycle
from .orbit_gradient import GaitNumbers, SpeedGradient, speed_gradient
from .orbit_stability import Stability, stability
from .orbit_symmetry import Repetition, distance_from_orbit, repetition

__all__ = [
    "ClosedOrbit",
    "FloquetMultipliers",
    "GaitNumbers",
    "Orbit",
    "OrbitCycle",
    "OrbitErrorBars",
    "Repetition",
    "SpeedGradient",
    "Stability",
    "closed_orbit",
    "distance_from_orbit",
    "find_orbit",
    "floquet_multipliers",
    "orbit_cycle",
    "orbit_error_bars",
    "refined_orbit",
    "repetition",
    "restarted",
    "speed_gradient",
    "stability",
]
