from .actuation import Command, random_members, rest_length
from .balls import Balls
from .bodies import Body, body_moments, rigid_body
from .contact_twin import exact_twin, penalty_twin
from .force_laws import cable_dampers, dead_band
from .friction import Friction
from .gait_waves import TravellingWave, travelling_waves
from .ground import Ground
from .inertia import energy_of_motion, mass_matrix, mobility, momenta, with_mass_at_ends
from .load_cases import LoadCase
from .pulleys import Pulley
from .pulls import commanded_pull
from .scene import body_length
from .sizes import MATERIALS, Material, sized_members
from .slides import Slides
from .stiffening import polynomial_stiffness
from .strut_contact import with_contact_between_struts
from .surface import Frame, Surface
from .symmetry import gene_permutations, image, standing_symmetries, symmetries

__all__ = [
    "MATERIALS",
    "Balls",
    "Body",
    "Command",
    "Frame",
    "Friction",
    "Ground",
    "LoadCase",
    "Material",
    "Pulley",
    "Slides",
    "Surface",
    "TravellingWave",
    "body_length",
    "body_moments",
    "cable_dampers",
    "commanded_pull",
    "dead_band",
    "energy_of_motion",
    "exact_twin",
    "gene_permutations",
    "image",
    "mass_matrix",
    "mobility",
    "momenta",
    "penalty_twin",
    "polynomial_stiffness",
    "random_members",
    "rest_length",
    "rigid_body",
    "sized_members",
    "standing_symmetries",
    "symmetries",
    "travelling_waves",
    "with_contact_between_struts",
    "with_mass_at_ends",
]
