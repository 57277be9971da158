from .equilibrium import RestingShape, equilibrium_near, resting_shape
from .form_finding import (
    Statics,
    equilibrium_matrix,
    group_average,
    nearest_tensegrity,
    prestress,
    prestress_stable,
    rest_lengths,
    shape_of_force_densities,
    statics_of,
    stress_matrix,
    super_stable,
)
from .inspection import StructureReport, inspect_structure, member_forces
from .load_reports import LoadEvent, LoadReport, load_report
from .prestressing import prestressed
from .responses import StaticResponse, static_response
from .settling import Settled, settled
from .sizing import LeastMass, least_mass
from .stiffness import sparse_mass_matrix, stiffness_matrix
from .topology import alike_members, form_of_topology
from .vibrations import Modes, vibration_modes

__all__ = [
    "LeastMass",
    "LoadEvent",
    "LoadReport",
    "Modes",
    "RestingShape",
    "Settled",
    "StaticResponse",
    "Statics",
    "StructureReport",
    "alike_members",
    "equilibrium_matrix",
    "equilibrium_near",
    "form_of_topology",
    "group_average",
    "inspect_structure",
    "least_mass",
    "load_report",
    "member_forces",
    "nearest_tensegrity",
    "prestress",
    "prestress_stable",
    "prestressed",
    "rest_lengths",
    "resting_shape",
    "settled",
    "shape_of_force_densities",
    "sparse_mass_matrix",
    "static_response",
    "statics_of",
    "stiffness_matrix",
    "stress_matrix",
    "super_stable",
    "vibration_modes",
]
