from .discretisation import discretise, integrate
from .dynamics import acceleration, centre_of_mass, smooth_force, vector_field
from .final_state import states_at
from .methods import Method, default_method, find_method, register_method
from .options import ResolvedOptions, resolve
from .rollout import RolledOut
from .simulate import velocities_midway
from .step_limits import StepLimit, default_step, limiting_part, standing, step_limit

__all__ = [
    "Method",
    "ResolvedOptions",
    "RolledOut",
    "StepLimit",
    "acceleration",
    "centre_of_mass",
    "default_method",
    "default_step",
    "discretise",
    "find_method",
    "integrate",
    "limiting_part",
    "register_method",
    "resolve",
    "smooth_force",
    "standing",
    "states_at",
    "step_limit",
    "vector_field",
    "velocities_midway",
]
