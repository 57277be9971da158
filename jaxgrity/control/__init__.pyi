from .choices import GaitChoices, gait_choices
from .closed_loop import Drive, Loop, drive, loop_start, roll_on, simulate_policy
from .environments import Environment, EnvironmentState, Situation, environment
from .feedback import PhaseLocked, sure_footed
from .gym import GymnasiumEnvironment, GymnasiumVectorEnvironment
from .learned import Deployed, Learned, episode, load_policy, policy_names, save_policy, trials
from .learning import learn, learner
from .motor_limits import MotorLimits, contraction_reached
from .obstacles import Discs, WayMap, discs_of, gap, reach_of, room, way_map
from .plant import Plant, PlantState, actuate, observe, plant_of, plant_start, side_by_side
from .policies import OpenLoop, Policy
from .ppo import Learner, LearningConfig
from .predictive import Journey, lead_to
from .samples import CAUTIOUS, Sampling
from .sensors import Errors, Observation, Readings, Sensors, first_readings, measure, read
from .steering import Blend, Steered, centre_offsets
from .tasks import REACHED, TASKS, Task, find_task, ground_of, task_start

__all__ = [
    "CAUTIOUS",
    "REACHED",
    "TASKS",
    "Blend",
    "Deployed",
    "Discs",
    "Drive",
    "Environment",
    "EnvironmentState",
    "Errors",
    "GaitChoices",
    "GymnasiumEnvironment",
    "GymnasiumVectorEnvironment",
    "Journey",
    "Learned",
    "Learner",
    "LearningConfig",
    "Loop",
    "MotorLimits",
    "Observation",
    "OpenLoop",
    "PhaseLocked",
    "Plant",
    "PlantState",
    "Policy",
    "Readings",
    "Sampling",
    "Sensors",
    "Situation",
    "Steered",
    "Task",
    "WayMap",
    "actuate",
    "centre_offsets",
    "contraction_reached",
    "discs_of",
    "drive",
    "environment",
    "episode",
    "find_task",
    "first_readings",
    "gait_choices",
    "gap",
    "ground_of",
    "lead_to",
    "learn",
    "learner",
    "load_policy",
    "loop_start",
    "measure",
    "observe",
    "plant_of",
    "plant_start",
    "policy_names",
    "reach_of",
    "read",
    "roll_on",
    "room",
    "save_policy",
    "side_by_side",
    "simulate_policy",
    "sure_footed",
    "task_start",
    "trials",
    "way_map",
]
