"""jaxgrity: tensegrity robots, simulated differentiably, and the gaits that make them roll."""

from jaxgrity.core.errors import InputError
from jaxgrity.io.gait_library import gait_names, gait_record, load_gait
from jaxgrity.io.scene_files import load_scene, parse_scene, scene_names
from jaxgrity.model.actuation import Gait, Overtone, random_phases
from jaxgrity.model.contact_twin import contact_twin, exact_twin, penalty_twin
from jaxgrity.model.friction import ConeFriction, Friction, SmoothFriction, SwitchFriction
from jaxgrity.model.ground import ExactGround, Ground, PenaltyGround
from jaxgrity.model.scene import Scene, with_gait, with_terms
from jaxgrity.model.structure import Members, Structure
from jaxgrity.rollout.population import Outcomes, gaits_of, one_gait, simulate_population
from jaxgrity.stepping.integrate import FAILURES
from jaxgrity.stepping.options import SolverOptions, resolve
from jaxgrity.stepping.simulate import Trajectory, centre_path, simulate
from jaxgrity.stepping.stability import stable_step, standing
from jaxgrity.trust.energy_audit import energy_audit
from jaxgrity.trust.error_bars import verify
from jaxgrity.trust.sensitivity import sensitivity
from jaxgrity.trust.trust_report import diagnose
