"""Names that stood at the top of the package in 0.2.0, and where their users find them. All of it goes with the next
release."""

_MOVED = """
acceleration actuate Agreement animate ball Blend body_length centre_of_mass centre_offsets changed check_polish
Checkpoint checkpointed_end ClimbStep closed_orbit ClosedOrbit Command contraction_reached d_bar default_method
default_step discretise discretise_lanes Discs discs_of distance_and_gradient distance_from_orbit distances distinct
Drive drive energy_of_motion Environment environment EnvironmentState equilibrium_matrix equilibrium_near Errors
Estimate evolve_through exact_twin fidelity_levels FidelityLevel final_verdict find_method find_objective find_orbit
find_task first_readings floquet_multipliers FloquetMultipliers Format FORMATS Frame Friction ga_configs gait_choices
GaitChoices GaitNumbers gap gene_permutations Generation Geometry grid Ground ground_of group_average
GymnasiumEnvironment icosahedron Identified identify image Imported in_lanes influences inspect_structure integrate
Journey judge judge_at lanes_last lead_to limiting_part load_states Loop loop_start mass_matrix measure measured_motion
measured_poses MeasuredMotion MeasuredPoses member_forces Method misfit_of mjcf_controls mobility model_of Modes
momenta mujoco_model MuJoCoModel nearest_tensegrity OBJECTIVES Observation observe open_checkpoint OpenLoop Orbit
orbit_cycle orbit_error_bars OrbitCycle OrbitErrorBars over_lanes Parameter path_bend penalty_twin PhaseLocked
planar_spine Plant plant_of plant_start PlantState plot Policy posterior_robots predicted prestress prestress_stable
prestressed prism prism_tower profile_likelihood Progress Promoted random_members random_tensegrity rank_correlation
REACHED read read_any read_matlab read_mjcf read_ntrt read_tables Readings refined_orbit register_method Repertoire
repertoire RepertoireConfig Repetition repetition Replay resolve ResolvedOptions rest_length rest_lengths rest_on_face
restarted resting_shape RestingShape Robot robot_motions RobotMotions rod_depths roll_on roll_out roll_out_lanes
RolledOut room rough_step Sampling save_matlab save_mesh save_mjcf save_tables save_trajectory Scores search_levels
search_problem SeenAngles SeenDistances SeenPositions SeenQuantity SeenTensions SeenTogether Sensors Settled settled
shape_of_force_densities side_by_side simulate_policy Situation smooth_force sparse_mass_matrix speed_forecast
speed_gradient speed_slopes SpeedForecast SpeedGradient Stability stability standard_error standing standing_symmetries
Starts states_at static_response StaticResponse Statics steady_facts Steered step_limit StepLimit stiffness_matrix
stress_matrix StructureReport super_stable sure_footed Surface symmetries t_bar Task task_start TASKS tetrahedral_spine
three_strut_robot tower travelling_waves uncertainty_of vector_field velocities_midway Verdict vibration_modes view
way_map WayMap with_robots write_any
"""
MOVED = frozenset(_MOVED.split())
"""Names that stand in a sub-package now."""
RENAMED = {
    "Model": "RolloutModel",
    "Motors": "MotorLimits",
    "SearchState": "EvolutionState",
    "Wave": "TravellingWave",
    "Waves": "HeightWaves",
    "without_measuring": "without_force_bounds",
}
"""Names that are others now, in a sub-package or at the top."""
REPLACED = {
    "Foresight": "control.Sampling",
    "Travels": "control.Journey",
    "end_positions": "final_state",
    "end_velocities": "final_state",
    "equilibrium": "statics.resting_shape",
    "natural_frequencies": "statics.vibration_modes",
    "travel": "control.lead_to",
}
"""What does the same now, but is called otherwise: nothing that could stand in for it."""
