"""jaxgrity: tensegrity robots, simulated differentiably, and the gaits that make them roll."""

from jaxgrity.actuation import Gait, random_phases
from jaxgrity.audit import energy_audit
from jaxgrity.diagnosis import Diagnosis, diagnose
from jaxgrity.diagnostics import sensitivity, verify
from jaxgrity.genome import Genome
from jaxgrity.library import gait_names, gait_record, load_gait
from jaxgrity.objectives import Fitness, Objective
from jaxgrity.population import Outcomes, gaits_of, one_gait, simulate_population
from jaxgrity.refine import Polishing, polish
from jaxgrity.rolling import rolling
from jaxgrity.scene import Scene, with_gait
from jaxgrity.scenefile import load_scene, parse_scene
from jaxgrity.search import Breeding, distinct, evolve
from jaxgrity.simulate import FAILURES, Trajectory, simulate
from jaxgrity.stability import stable_step, standing
from jaxgrity.structure import InputError, Members, Structure
from jaxgrity.symmetry import gene_permutations, standing_symmetries, symmetries
from jaxgrity.twin import twin
from jaxgrity.uncertainty import Differences, Uncertainty, differing, ensemble

__all__ = [
    "FAILURES",
    "Breeding",
    "Diagnosis",
    "Differences",
    "Fitness",
    "Gait",
    "Genome",
    "InputError",
    "Members",
    "Objective",
    "Outcomes",
    "Polishing",
    "Scene",
    "Structure",
    "Trajectory",
    "Uncertainty",
    "diagnose",
    "differing",
    "distinct",
    "energy_audit",
    "ensemble",
    "evolve",
    "gait_names",
    "gait_record",
    "gaits_of",
    "gene_permutations",
    "load_gait",
    "load_scene",
    "one_gait",
    "parse_scene",
    "polish",
    "random_phases",
    "rolling",
    "sensitivity",
    "simulate",
    "simulate_population",
    "stable_step",
    "standing",
    "standing_symmetries",
    "symmetries",
    "twin",
    "verify",
    "with_gait",
]
