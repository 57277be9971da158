# The names that most users need, in groups; `jaxgrity/__init__.py` imports each when it is first used. The rooms
# (jaxgrity.control, .orbits, .statics, ...) have further names of their own.

from . import control as control
from . import formats as formats
from . import identification as identification
from . import model as model
from . import orbits as orbits
from . import populations as populations
from . import report as report
from . import search as search
from . import statics as statics
from . import stepping as stepping
from . import structures as structures
from .core import primitives
from .core.compiled import keep_compiled
from .core.display import with_error
from .core.errors import InputError
from .io.gait_library import gait_facts, gait_names, gait_record, load_gait
from .io.scene_files import load_scene, parse_scene, scene_names, scene_text
from .io.scene_writing import save_scene
from .model.actuation import Gait, Overtone, random_phases
from .model.contact_twin import contact_twin
from .model.external import Push, Wind, wind
from .model.force_laws import ForceLimit, ForceTable, force_limit, force_table
from .model.friction import ConeFriction, SmoothFriction, SwitchFriction
from .model.ground import ExactGround, PenaltyGround
from .model.height_fields import HeightFunction, HeightMap, HeightWaves, bumps, height_map
from .model.laws import (
    Configuration,
    Constraint,
    DissipationTerm,
    EnergyTerm,
    ForceLaw,
    Law,
    Motion,
    Symmetry,
    member_names,
    node_names,
    unchanged,
)
from .model.motors import Motor
from .model.rod_contact import RodContact, with_contact_along_struts
from .model.scene import Scene, as_dtype, with_gait, with_terms
from .model.shaking import Shaking, SupportMotion
from .model.solids import Box, Cylinder, Sphere, Stairs
from .model.structure import Members, Structure, edge_lengths
from .model.surface import Slope
from .model.unions import Union
from .populations.forces import Forces, forces_along, reactions
from .populations.metrics import Metrics
from .populations.motion_kinds import Rolling, rolling
from .populations.population import Outcomes, as_population, gaits_of, one_gait, simulate_population
from .populations.uncertainty import Differences, Uncertainty, differing, ensemble
from .search.genetic_algorithm import Evolution, GAConfig, evolve
from .search.genome import Genome
from .search.judging import Fitness
from .search.objectives import (
    ActuatorBounds,
    CostOfTransport,
    Direction,
    Distance,
    Objective,
    Speed,
    SteadyDirection,
    SteadySpeed,
    SteadyTurn,
    Straightness,
    register_objective,
)
from .search.pipeline import SearchResult, search_gaits
from .search.polish import Polished, polish
from .search.polish_config import PolishConfig
from .search.problem import SearchProblem
from .search.search_config import SearchConfig
from .statics.describe import describe
from .stepping.discretisation import FAILURES
from .stepping.final_state import final_state
from .stepping.methods import METHODS
from .stepping.options import SolverOptions
from .stepping.rollout import rollout
from .stepping.simulate import Trajectory, centre_path, simulate
from .stepping.step_limits import stable_step
from .trust.energy_audit import EnergyAudit, energy_audit
from .trust.error_bars import Verified, refinement_bar, verify
from .trust.sensitivity import Sensitivity, sensitivity
from .trust.trust_report import TrustReport, diagnose

__all__ = [  # noqa: RUF022 in groups
    # scenes: what is simulated
    "InputError",
    "Members",
    "Motor",
    "Scene",
    "Structure",
    "as_dtype",
    "edge_lengths",
    "contact_twin",
    "describe",
    "load_scene",
    "parse_scene",
    "save_scene",
    "scene_names",
    "scene_text",
    "with_gait",
    "with_terms",
    # gaits
    "Gait",
    "Overtone",
    "gait_facts",
    "gait_names",
    "gait_record",
    "load_gait",
    "random_phases",
    # the ground, and friction on it
    "Box",
    "ConeFriction",
    "Cylinder",
    "ExactGround",
    "HeightFunction",
    "HeightMap",
    "HeightWaves",
    "PenaltyGround",
    "Slope",
    "SmoothFriction",
    "Sphere",
    "Stairs",
    "SwitchFriction",
    "Union",
    "bumps",
    "height_map",
    # forces from outside, and members that are no springs
    "ForceLimit",
    "ForceTable",
    "Push",
    "RodContact",
    "Shaking",
    "SupportMotion",
    "Wind",
    "force_limit",
    "force_table",
    "wind",
    "with_contact_along_struts",
    # laws of one's own (docs/extending.md)
    "Configuration",
    "Constraint",
    "DissipationTerm",
    "EnergyTerm",
    "ForceLaw",
    "Law",
    "Motion",
    "Symmetry",
    "member_names",
    "node_names",
    "primitives",
    "unchanged",
    # rollouts
    "FAILURES",
    "METHODS",
    "Forces",
    "Rolling",
    "SolverOptions",
    "Trajectory",
    "centre_path",
    "final_state",
    "forces_along",
    "keep_compiled",
    "reactions",
    "rolling",
    "rollout",
    "simulate",
    "stable_step",
    # many robots in one call, and robots that differ
    "Differences",
    "Metrics",
    "Outcomes",
    "Uncertainty",
    "as_population",
    "differing",
    "ensemble",
    "gaits_of",
    "one_gait",
    "simulate_population",
    # how far to trust a number
    "EnergyAudit",
    "Sensitivity",
    "TrustReport",
    "Verified",
    "diagnose",
    "energy_audit",
    "refinement_bar",
    "sensitivity",
    "verify",
    "with_error",
    # search: gaits that roll
    "ActuatorBounds",
    "CostOfTransport",
    "Direction",
    "Distance",
    "Evolution",
    "Fitness",
    "GAConfig",
    "Genome",
    "Objective",
    "PolishConfig",
    "Polished",
    "SearchConfig",
    "SearchProblem",
    "SearchResult",
    "Speed",
    "SteadyDirection",
    "SteadySpeed",
    "SteadyTurn",
    "Straightness",
    "evolve",
    "polish",
    "register_objective",
    "search_gaits",
]
