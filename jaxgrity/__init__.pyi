# The public interface of jaxgrity, in groups; `jaxgrity/__init__.py` imports each name when it is first used.

from .core import primitives
from .core.errors import InputError
from .io.gait_library import gait_facts, gait_names, gait_record, load_gait
from .io.scene_files import load_scene, parse_scene, scene_names, scene_text
from .model.actuation import Gait, Overtone, random_members, random_phases, rest_length
from .model.catalogue import icosahedron, rest_on_face
from .model.contact_twin import contact_twin, exact_twin, penalty_twin
from .model.example_scenes import prism_tower
from .model.friction import ConeFriction, Friction, SmoothFriction, SwitchFriction
from .model.ground import ExactGround, Ground, PenaltyGround
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
from .model.modal import equilibrium, natural_frequencies
from .model.rigid_body import end_positions, end_velocities, inertia, rigid_kinetic_energy
from .model.scene import Scene, as_dtype, with_gait, with_terms
from .model.structure import Members, Structure, edge_lengths
from .model.symmetry import gene_permutations, image, standing_symmetries, symmetries
from .report import plot
from .report.animation import animate
from .rollout.lanes import discretise_lanes, in_lanes, lanes_last, over_lanes, roll_out_lanes
from .rollout.metrics import Metrics
from .rollout.population import Outcomes, as_population, gaits_of, one_gait, roll_out, simulate_population
from .rollout.rolling import Rolling, rolling
from .rollout.uncertainty import Differences, Uncertainty, differing, ensemble
from .search.checkpoint import Checkpoint, load_states, open_checkpoint
from .search.climb import ClimbStep
from .search.fidelity import (
    FidelityLevel,
    Verdict,
    evolve_through,
    fidelity_levels,
    final_verdict,
    judge_at,
    rank_correlation,
    search_levels,
)
from .search.genetic_algorithm import Evolution, GAConfig, Generation, SearchProblem, SearchState, distinct, evolve
from .search.genome import Genome
from .search.gradients import checkpointed_end, distance_and_gradient, distances
from .search.objectives import (
    OBJECTIVES,
    ActuatorBounds,
    CostOfTransport,
    Direction,
    Distance,
    Fitness,
    Objective,
    Scores,
    Speed,
    Straightness,
    body_length,
    find_objective,
    judge,
    register_objective,
    with_robots,
)
from .search.pipeline import Agreement, Progress, SearchResult, search_gaits
from .search.polish import Polished, polish
from .search.polish_config import PolishConfig, check_polish
from .search.search_config import SearchConfig
from .stepping.dynamics import acceleration, centre_of_mass, smooth_force, vector_field
from .stepping.integrate import FAILURES, discretise, integrate
from .stepping.methods import METHODS, Method, find_method, register_method
from .stepping.options import ResolvedOptions, SolverOptions, resolve
from .stepping.simulate import Trajectory, centre_path, simulate
from .stepping.stability import (
    StepLimit,
    default_method,
    default_step,
    limiting_part,
    stable_step,
    standing,
    step_limit,
)
from .trust.energy_audit import EnergyAudit, energy_audit
from .trust.error_bars import Verified, refinement_bar, verify
from .trust.sensitivity import Sensitivity, sensitivity
from .trust.trust_report import TrustReport, diagnose

__all__ = [  # noqa: RUF022 in groups
    # scenes: what is simulated
    "InputError",
    "gait_facts",
    "gait_names",
    "gait_record",
    "load_gait",
    "load_scene",
    "parse_scene",
    "scene_names",
    "scene_text",
    "Gait",
    "Overtone",
    "random_members",
    "random_phases",
    "rest_length",
    "icosahedron",
    "prism_tower",
    "rest_on_face",
    "contact_twin",
    "exact_twin",
    "penalty_twin",
    "ConeFriction",
    "Friction",
    "SmoothFriction",
    "SwitchFriction",
    "ExactGround",
    "Ground",
    "PenaltyGround",
    "equilibrium",
    "natural_frequencies",
    "Scene",
    "as_dtype",
    "with_gait",
    "with_terms",
    "Members",
    "Structure",
    "edge_lengths",
    "gene_permutations",
    "image",
    "standing_symmetries",
    "symmetries",
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
    "Metrics",
    "Outcomes",
    "as_population",
    "gaits_of",
    "one_gait",
    "simulate_population",
    "Rolling",
    "rolling",
    "Differences",
    "Uncertainty",
    "differing",
    "ensemble",
    "FAILURES",
    "METHODS",
    "Method",
    "find_method",
    "register_method",
    "ResolvedOptions",
    "SolverOptions",
    "resolve",
    "Trajectory",
    "centre_path",
    "simulate",
    "StepLimit",
    "default_method",
    "default_step",
    "limiting_part",
    "stable_step",
    "standing",
    "step_limit",
    # how far to trust a number
    "EnergyAudit",
    "energy_audit",
    "Verified",
    "refinement_bar",
    "verify",
    "Sensitivity",
    "sensitivity",
    "TrustReport",
    "diagnose",
    # search: gaits that roll
    "Checkpoint",
    "load_states",
    "open_checkpoint",
    "ClimbStep",
    "FidelityLevel",
    "Verdict",
    "evolve_through",
    "fidelity_levels",
    "final_verdict",
    "judge_at",
    "rank_correlation",
    "search_levels",
    "Evolution",
    "GAConfig",
    "Generation",
    "SearchProblem",
    "SearchState",
    "distinct",
    "evolve",
    "Genome",
    "OBJECTIVES",
    "ActuatorBounds",
    "CostOfTransport",
    "Direction",
    "Distance",
    "Fitness",
    "Objective",
    "Scores",
    "Speed",
    "Straightness",
    "body_length",
    "find_objective",
    "judge",
    "register_objective",
    "with_robots",
    "Agreement",
    "Progress",
    "SearchResult",
    "search_gaits",
    "Polished",
    "polish",
    "PolishConfig",
    "check_polish",
    "SearchConfig",
    # pictures
    "plot",
    "animate",
    # for measurements of one's own
    "discretise_lanes",
    "in_lanes",
    "lanes_last",
    "over_lanes",
    "roll_out",
    "roll_out_lanes",
    "checkpointed_end",
    "distance_and_gradient",
    "distances",
    "end_positions",
    "end_velocities",
    "inertia",
    "rigid_kinetic_energy",
    "acceleration",
    "centre_of_mass",
    "smooth_force",
    "vector_field",
    "discretise",
    "integrate",
]
