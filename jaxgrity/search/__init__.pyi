from .checkpoint import Checkpoint, load_states, open_checkpoint
from .climb import ClimbStep
from .fidelity import (
    FidelityLevel,
    FidelityLevels,
    Verdict,
    evolve_through,
    fidelity_levels,
    final_verdict,
    judge_at,
    rank_correlation,
    search_levels,
)
from .genetic_algorithm import EvolutionState, Generation, distinct
from .gradients import checkpointed_end, distance_and_gradient, distances
from .judging import Judging, Scores, influences, judge, standard_error, with_robots, without_force_bounds
from .models import RolloutModel, model_of, rough_step
from .motions import RobotMotions, robot_motions
from .objectives import OBJECTIVES, JumpHeight, QuickStart, find_objective
from .pareto import ParetoFront, pareto_front
from .paths import path_bend
from .pipeline import Progress
from .polish_config import check_polish
from .promotion import Agreement, Promoted
from .repertoires import Repertoire, RepertoireConfig, repertoire
from .search_config import EvaluationConfig, ga_configs, search_problem
from .search_space import SearchSpace, genome_to_polish

__all__ = [
    "OBJECTIVES",
    "Agreement",
    "Checkpoint",
    "ClimbStep",
    "EvaluationConfig",
    "EvolutionState",
    "FidelityLevel",
    "FidelityLevels",
    "Generation",
    "Judging",
    "JumpHeight",
    "ParetoFront",
    "Progress",
    "Promoted",
    "QuickStart",
    "Repertoire",
    "RepertoireConfig",
    "RobotMotions",
    "RolloutModel",
    "Scores",
    "SearchSpace",
    "Verdict",
    "check_polish",
    "checkpointed_end",
    "distance_and_gradient",
    "distances",
    "distinct",
    "evolve_through",
    "fidelity_levels",
    "final_verdict",
    "find_objective",
    "ga_configs",
    "genome_to_polish",
    "influences",
    "judge",
    "judge_at",
    "load_states",
    "model_of",
    "open_checkpoint",
    "pareto_front",
    "path_bend",
    "rank_correlation",
    "repertoire",
    "robot_motions",
    "rough_step",
    "search_levels",
    "search_problem",
    "standard_error",
    "with_robots",
    "without_force_bounds",
]
