from .balls import ball
from .catalogue import icosahedron, rest_on_face
from .example_scenes import prism_tower
from .geometry import Geometry, RobotGeometry
from .prisms import prism, three_strut_robot, tower
from .random_structures import random_tensegrity
from .robots import capped_robot, quadruped, superball
from .spines import hinged_spine, planar_spine, tetrahedral_spine
from .trusses import d_bar, grid, t_bar

__all__ = [
    "Geometry",
    "RobotGeometry",
    "ball",
    "capped_robot",
    "d_bar",
    "grid",
    "hinged_spine",
    "icosahedron",
    "planar_spine",
    "prism",
    "prism_tower",
    "quadruped",
    "random_tensegrity",
    "rest_on_face",
    "superball",
    "t_bar",
    "tetrahedral_spine",
    "three_strut_robot",
    "tower",
]
