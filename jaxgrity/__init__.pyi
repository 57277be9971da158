# The public interface of jaxgrity, in groups; `jaxgrity/__init__.py` imports each name when it is first used.

from .control.closed_loop import Drive, Loop, drive, loop_start, roll_on, simulate_policy
from .control.environment import Environment, EnvironmentState, Situation, environment
from .control.feedback import PhaseLocked, sure_footed
from .control.gait_choices import GaitChoices, gait_choices
from .control.gymnasium_adapter import GymnasiumEnvironment
from .control.motors import Motors, contraction_reached
from .control.obstacles import Discs, WayMap, discs_of, gap, room, way_map
from .control.plant import Plant, PlantState, actuate, observe, plant_of, plant_start, side_by_side
from .control.policies import OpenLoop, Policy
from .control.predictive import Journey, Sampling, costs, lead_to
from .control.sensors import Errors, Observation, Readings, Sensors, first_readings, measure, read
from .control.steering import Blend, Steered, centre_offsets
from .control.tasks import REACHED, TASKS, Task, find_task, ground_of, progressed, task_start
from .control.travel import Foresight, Travels, travel
from .core import primitives
from .core.display import with_error
from .core.errors import InputError
from .formats.conversion import FORMATS, Format, read_any, write_any
from .formats.foreign import Imported
from .formats.matlab import read_matlab, save_matlab
from .formats.meshes import save_mesh
from .formats.mjcf_plan import mjcf_controls
from .formats.mjcf_reading import read_mjcf
from .formats.mjcf_writing import MuJoCoModel, mujoco_model, save_mjcf
from .formats.ntrt import read_ntrt
from .formats.spreadsheets import read_tables, save_tables
from .formats.trajectories import save_trajectory
from .identification.identify import Estimate, Identified, identify, misfit_of, profile_likelihood
from .identification.measurements import MeasuredPoses, measured_poses, predicted
from .identification.motions import MeasuredMotion, Starts, measured_motion
from .identification.observations import (
    SeenAngles,
    SeenDistances,
    SeenPositions,
    SeenQuantity,
    SeenTensions,
    SeenTogether,
)
from .identification.parameters import Parameter, changed
from .identification.posterior import posterior_robots, uncertainty_of
from .identification.speed_forecast import SpeedForecast, speed_forecast, speed_slopes
from .io.gait_library import gait_facts, gait_names, gait_record, load_gait
from .io.scene_files import load_scene, parse_scene, scene_names, scene_text
from .io.scene_writing import save_scene
from .model.actuation import Command, Gait, Overtone, random_members, random_phases, rest_length
from .model.balls import ball
from .model.catalogue import icosahedron, rest_on_face
from .model.contact_twin import contact_twin, exact_twin, penalty_twin
from .model.equilibrium import RestingShape, equilibrium_near, resting_shape
from .model.example_scenes import prism_tower
from .model.external import Push, Wind, wind
from .model.force_laws import ForceLimit, ForceTable, force_limit, force_table
from .model.form_finding import (
    Statics,
    equilibrium_matrix,
    group_average,
    nearest_tensegrity,
    prestress,
    prestress_stable,
    rest_lengths,
    shape_of_force_densities,
    statics,
    stress_matrix,
    super_stable,
)
from .model.friction import ConeFriction, Friction, SmoothFriction, SwitchFriction
from .model.geometry import Geometry
from .model.ground import ExactGround, Ground, PenaltyGround
from .model.height_fields import HeightFunction, HeightMap, Waves, bumps, height_map
from .model.inertia import energy_of_motion, mass_matrix, mobility, momenta
from .model.inspection import StructureReport, inspect_structure, member_forces
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
from .model.motors import Motor
from .model.prestressed import prestressed
from .model.prisms import prism, three_strut_robot, tower
from .model.random_structures import random_tensegrity
from .model.rigid_body import end_positions, end_velocities, inertia, rigid_kinetic_energy
from .model.rod_contact import RodContact, with_contact_along_struts
from .model.scene import Scene, as_dtype, body_length, with_gait, with_terms
from .model.settled import Settled, settled
from .model.shaking import Shaking, SupportMotion
from .model.solids import Box, Cylinder, Sphere, Stairs
from .model.spines import planar_spine, tetrahedral_spine
from .model.static_response import StaticResponse, static_response
from .model.stiffness import sparse_mass_matrix, stiffness_matrix
from .model.structure import Members, Structure, edge_lengths
from .model.surface import Frame, Slope, Surface
from .model.symmetry import gene_permutations, image, standing_symmetries, symmetries
from .model.trusses import d_bar, grid, t_bar
from .model.unions import Union
from .model.vibrations import Modes, vibration_modes
from .model.waves import Wave, travelling_waves
from .report import plot, view
from .report.animation import animate
from .report.steady import steady_facts
from .report.view import Replay, Robot
from .rollout.clearance import rod_depths
from .rollout.forces import Forces, forces_along, reactions
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
from .search.judging import Fitness, Scores, influences, judge, standard_error, with_robots, without_measuring
from .search.models import Model, model_of, rough_step
from .search.objectives import (
    OBJECTIVES,
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
    find_objective,
    register_objective,
)
from .search.paths import path_bend
from .search.pipeline import Progress, SearchResult, search_gaits
from .search.polish import Polished, polish
from .search.polish_config import PolishConfig, check_polish
from .search.promotion import Agreement, Promoted
from .search.repertoire import Repertoire, RepertoireConfig, repertoire
from .search.robot_motions import RobotMotions, robot_motions
from .search.search_config import SearchConfig, ga_configs, search_problem
from .stepping.dynamics import acceleration, centre_of_mass, smooth_force, vector_field
from .stepping.final_state import final_state, states_at
from .stepping.integrate import FAILURES, discretise, integrate
from .stepping.methods import METHODS, Method, find_method, register_method
from .stepping.options import ResolvedOptions, SolverOptions, resolve
from .stepping.rollout import RolledOut, rollout
from .stepping.simulate import Trajectory, centre_path, simulate, velocities_midway
from .stepping.stability import (
    StepLimit,
    default_method,
    default_step,
    limiting_part,
    stable_step,
    standing,
    step_limit,
)
from .trust.closed_orbits import ClosedOrbit, closed_orbit
from .trust.energy_audit import EnergyAudit, energy_audit
from .trust.error_bars import Verified, refinement_bar, verify
from .trust.multipliers import FloquetMultipliers, floquet_multipliers
from .trust.orbit_cycle import OrbitCycle, orbit_cycle
from .trust.orbit_error_bars import OrbitErrorBars, orbit_error_bars, refined_orbit
from .trust.orbit_gradient import GaitNumbers, SpeedGradient, speed_gradient
from .trust.orbit_stability import Stability, stability
from .trust.orbit_symmetry import Repetition, distance_from_orbit, repetition
from .trust.orbits import Orbit, find_orbit, restarted
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
    "save_scene",
    "scene_names",
    "scene_text",
    "Gait",
    "Overtone",
    "random_members",
    "random_phases",
    "rest_length",
    "Settled",
    "settled",
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
    "Box",
    "Cylinder",
    "Frame",
    "HeightFunction",
    "HeightMap",
    "Slope",
    "Sphere",
    "Stairs",
    "Surface",
    "Union",
    "Waves",
    "Push",
    "Wind",
    "wind",
    "Shaking",
    "SupportMotion",
    "bumps",
    "height_map",
    "equilibrium",
    "natural_frequencies",
    "Scene",
    "as_dtype",
    "with_gait",
    "with_terms",
    "RodContact",
    "with_contact_along_struts",
    "Members",
    "Motor",
    "Structure",
    "ForceLimit",
    "ForceTable",
    "force_limit",
    "force_table",
    "edge_lengths",
    "energy_of_motion",
    "mass_matrix",
    "mobility",
    "momenta",
    "gene_permutations",
    "image",
    "standing_symmetries",
    "symmetries",
    "travelling_waves",
    # files of other programs
    "FORMATS",
    "Format",
    "Imported",
    "MuJoCoModel",
    "mjcf_controls",
    "mujoco_model",
    "read_any",
    "read_matlab",
    "read_mjcf",
    "read_ntrt",
    "read_tables",
    "save_matlab",
    "save_mesh",
    "save_mjcf",
    "save_tables",
    "save_trajectory",
    "write_any",
    # structures by formula
    "Geometry",
    "ball",
    "prism",
    "three_strut_robot",
    "tower",
    "random_tensegrity",
    "planar_spine",
    "tetrahedral_spine",
    "d_bar",
    "grid",
    "t_bar",
    # statics and vibrations: does it stand, how, and how stiffly
    "RestingShape",
    "equilibrium_near",
    "resting_shape",
    "Statics",
    "equilibrium_matrix",
    "group_average",
    "nearest_tensegrity",
    "prestress",
    "prestress_stable",
    "prestressed",
    "rest_lengths",
    "shape_of_force_densities",
    "statics",
    "stress_matrix",
    "super_stable",
    "StructureReport",
    "inspect_structure",
    "member_forces",
    "StaticResponse",
    "static_response",
    "sparse_mass_matrix",
    "stiffness_matrix",
    "Modes",
    "vibration_modes",
    # laws of one's own (docs/extending.md)
    "Configuration",
    "Constraint",
    "DissipationTerm",
    "EnergyTerm",
    "ForceLaw",
    "Law",
    "Motion",
    "Symmetry",
    "Wave",
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
    "Forces",
    "forces_along",
    "rod_depths",
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
    "velocities_midway",
    "final_state",
    "states_at",
    "RolledOut",
    "rollout",
    "simulate",
    "reactions",
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
    "ClosedOrbit",
    "closed_orbit",
    "FloquetMultipliers",
    "floquet_multipliers",
    "Orbit",
    "Stability",
    "find_orbit",
    "refined_orbit",
    "OrbitErrorBars",
    "orbit_error_bars",
    "restarted",
    "OrbitCycle",
    "orbit_cycle",
    "Repetition",
    "distance_from_orbit",
    "repetition",
    "stability",
    "GaitNumbers",
    "SpeedGradient",
    "speed_gradient",
    "Sensitivity",
    "sensitivity",
    "TrustReport",
    "diagnose",
    # identification: parameters from measurements, and how sure they are
    "Estimate",
    "Identified",
    "identify",
    "misfit_of",
    "profile_likelihood",
    "MeasuredMotion",
    "MeasuredPoses",
    "Starts",
    "measured_motion",
    "measured_poses",
    "predicted",
    "SeenQuantity",
    "SeenAngles",
    "SeenDistances",
    "SeenPositions",
    "SeenTensions",
    "SeenTogether",
    "Parameter",
    "changed",
    "posterior_robots",
    "uncertainty_of",
    "SpeedForecast",
    "speed_forecast",
    "speed_slopes",
    # control: feedback, steering, environments
    "Policy",
    "OpenLoop",
    "PhaseLocked",
    "sure_footed",
    "Steered",
    "Blend",
    "centre_offsets",
    "Command",
    "Errors",
    "Observation",
    "Readings",
    "Sensors",
    "first_readings",
    "measure",
    "read",
    "Motors",
    "contraction_reached",
    "Plant",
    "PlantState",
    "actuate",
    "observe",
    "plant_of",
    "plant_start",
    "side_by_side",
    "Drive",
    "Loop",
    "drive",
    "loop_start",
    "roll_on",
    "simulate_policy",
    "Journey",
    "costs",
    "Sampling",
    "lead_to",
    "Discs",
    "discs_of",
    "gap",
    "room",
    "WayMap",
    "way_map",
    "GaitChoices",
    "gait_choices",
    "Foresight",
    "Travels",
    "travel",
    "TASKS",
    "Task",
    "find_task",
    "progressed",
    "REACHED",
    "ground_of",
    "task_start",
    "Environment",
    "EnvironmentState",
    "Situation",
    "environment",
    "GymnasiumEnvironment",
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
    "Model",
    "model_of",
    "rough_step",
    "OBJECTIVES",
    "ActuatorBounds",
    "CostOfTransport",
    "Direction",
    "Distance",
    "Fitness",
    "Objective",
    "Scores",
    "Speed",
    "SteadyDirection",
    "SteadySpeed",
    "SteadyTurn",
    "Straightness",
    "body_length",
    "find_objective",
    "path_bend",
    "RobotMotions",
    "robot_motions",
    "steady_facts",
    "judge",
    "register_objective",
    "with_robots",
    "influences",
    "standard_error",
    "with_error",
    "without_measuring",
    "Agreement",
    "Promoted",
    "Progress",
    "SearchResult",
    "search_gaits",
    "Polished",
    "polish",
    "Repertoire",
    "RepertoireConfig",
    "repertoire",
    "PolishConfig",
    "check_polish",
    "SearchConfig",
    "ga_configs",
    "search_problem",
    # pictures
    "plot",
    "view",
    "Replay",
    "Robot",
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
