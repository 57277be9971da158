"""jaxgrity: tensegrity robots, simulated differentiably, and the gaits that make them roll."""

from jaxgrity.actuation import Gait, random_phases
from jaxgrity.audit import energy_audit
from jaxgrity.diagnosis import Diagnosis, diagnose
from jaxgrity.diagnostics import sensitivity, verify
from jaxgrity.population import Outcomes, gaits_of, one_gait, simulate_population
from jaxgrity.refine import Polishing, polish
from jaxgrity.scene import Scene, with_gait
from jaxgrity.scenefile import load_scene, parse_scene
from jaxgrity.search import Breeding, Genome, distinct, evolve
from jaxgrity.simulate import FAILURES, Trajectory, simulate
from jaxgrity.stability import stable_step, standing
from jaxgrity.structure import InputError, Members, Structure

__all__ = [
    "FAILURES",
    "Breeding",
    "Diagnosis",
    "Gait",
    "Genome",
    "InputError",
    "Members",
    "Outcomes",
    "Polishing",
    "Scene",
    "Structure",
    "Trajectory",
    "diagnose",
    "distinct",
    "energy_audit",
    "evolve",
    "gaits_of",
    "load_scene",
    "one_gait",
    "parse_scene",
    "polish",
    "random_phases",
    "sensitivity",
    "simulate",
    "simulate_population",
    "stable_step",
    "standing",
    "verify",
    "with_gait",
]
