"""The tables of a scene file: their keys, and the values of each."""

import math
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta

from jaxgrity.core.types import Edges
from jaxgrity.io.bodies import BodyTable
from jaxgrity.io.ground_tables import BoxTable, CylinderTable, SphereTable, SurfaceTable
from jaxgrity.io.member_tables import CablesTable, StrutsTable
from jaxgrity.io.table_types import NotNegative, Number, Pair, Positive, Seed, Share, Table
from jaxgrity.model.structure import check_edges
from jaxgrity.structures.balls import ball
from jaxgrity.structures.catalogue import icosahedron
from jaxgrity.structures.geometry import Geometry
from jaxgrity.structures.prisms import prism, three_strut_robot, tower
from jaxgrity.structures.spines import planar_spine, tetrahedral_spine
from jaxgrity.structures.trusses import d_bar, grid, t_bar

Count = Annotated[int, Meta(ge=1, le=10_000)]


class FixedAxes(Table):
    """A node that does not move along some axes: any of "x", "y" and "z", such as "xz"."""

    node: Number
    axes: str


class _Shape(Table, kw_only=True):
    """The common keys of structures, without custom ones, which need not be moved."""

    mass: Positive | None = None
    node_mass: list[NotNegative] | None = None
    fixed: list[Number | FixedAxes] = []
    pose: Literal["face", "strut"] = "strut"
    aligned: bool = False
    height: float = 0.0
    prestress: Positive | None = None


class IcosahedronTable(_Shape, tag="icosahedron", tag_field="kind"):
    strut_length: Positive = 1.0

    def geometry(self) -> tuple[np.ndarray, Edges, Edges]:
        """Nodes (nodes, 3), m, struts and cables."""
        return icosahedron(self.strut_length)


class PrismTable(_Shape, tag="prism", tag_field="kind"):
    struts: Count = 3
    radius: Positive = 0.3
    prism_height: Positive = 0.6
    upper_radius: Positive | None = None

    def geometry(self) -> Geometry:
        return prism(self.struts, self.radius, self.prism_height, self.upper_radius)


class ThreeStrutTable(_Shape, tag="three_strut_robot", tag_field="kind"):
    strut_length: Positive = 1.0

    def geometry(self) -> Geometry:
        return three_strut_robot(self.strut_length)


class TowerTable(_Shape, tag="tower", tag_field="kind"):
    struts: Count = 3
    stages: Count = 2
    overlap: Share = 0.3
    radius: Positive = 0.3
    stage_height: Positive = 0.6

    def geometry(self) -> Geometry:
        return tower(self.struts, self.stages, self.overlap, self.radius, self.stage_height)


class BallTable(_Shape, tag="ball", tag_field="kind"):
    struts: Count = 30
    strut_length: Positive = 1.0

    def geometry(self) -> Geometry:
        return ball(self.struts, self.strut_length)


class TetrahedralSpineTable(_Shape, tag="tetrahedral_spine", tag_field="kind"):
    vertebrae: Count = 3
    width: Positive = 0.3
    vertebra_height: Positive = 0.3
    spacing: Positive = 0.2

    def geometry(self) -> Geometry:
        return tetrahedral_spine(self.vertebrae, self.width, self.vertebra_height, self.spacing)


class PlanarSpineTable(_Shape, tag="planar_spine", tag_field="kind"):
    vertebrae: Count = 3
    length: Positive = 0.3
    vertebra_height: Positive = 0.3
    spacing: Positive = 0.2

    def geometry(self) -> Geometry:
        return planar_spine(self.vertebrae, self.length, self.vertebra_height, self.spacing)


class DBarTable(_Shape, tag="d_bar", tag_field="kind"):
    sides: Count = 3
    length: Positive = 1.0
    radius: Positive = 0.15

    def geometry(self) -> Geometry:
        return d_bar(self.sides, self.length, self.radius)


class TBarTable(_Shape, tag="t_bar", tag_field="kind"):
    sides: Count = 3
    length: Positive = 1.0
    radius: Positive = 0.15

    def geometry(self) -> Geometry:
        return t_bar(self.sides, self.length, self.radius)


class GridTable(_Shape, tag="grid", tag_field="kind"):
    rows: Count = 2
    columns: Count = 2
    side: Positive = 1.0
    thickness: Positive = 0.6

    def geometry(self) -> Geometry:
        return grid(self.rows, self.columns, self.side, self.thickness)


class CustomTable(Table, tag="custom", tag_field="kind"):
    nodes: Annotated[list[tuple[float, float, float]], Meta(min_length=1)]
    struts: list[Pair] = []
    cables: list[Pair] = []
    mass: Positive | None = None
    node_mass: list[NotNegative] | None = None
    fixed: list[Number | FixedAxes] = []
    pose: Literal["face", "strut"] = "strut"
    aligned: bool = False
    height: float | None = None
    prestress: Positive | None = None

    def geometry(self) -> tuple[np.ndarray, Edges, Edges]:
        """Nodes (nodes, 3), m, struts and cables."""
        nodes, struts, cables = np.array(self.nodes, float), tuple(self.struts), tuple(self.cables)
        check_edges(nodes, struts, cables)
        return nodes, struts, cables


CatalogueTable = (
    IcosahedronTable
    | PrismTable
    | ThreeStrutTable
    | TowerTable
    | BallTable
    | TetrahedralSpineTable
    | PlanarSpineTable
    | DBarTable
    | TBarTable
    | GridTable
)
"""Tables of the kinds of structures that are made by formula."""
StructureTable = CatalogueTable | CustomTable
"""Tables of all kinds of structures, which differ in their key `kind`."""


class GravityTable(Table):
    g: NotNegative = 9.81


class DampingTable(Table):
    node: NotNegative | list[NotNegative]


class BallsKeys(Table):
    """The nodes that touch the ground, and the radii of the balls about them."""

    nodes: Annotated[list[Number], Meta(min_length=1)]
    radius: NotNegative | list[NotNegative] = 0.0


class GroundTable(Table):
    contact: Literal["penalty", "complementarity"] = "penalty"
    incline: Annotated[float, Meta(gt=-math.pi / 2, lt=math.pi / 2)] = 0.0
    stiffness: Positive | None = None
    dissipation: NotNegative | None = None
    restitution: Annotated[float, Meta(ge=0, le=1)] | None = None
    balls: BallsKeys | None = None
    surface: SurfaceTable | None = None
    obstacles: list[BoxTable | SphereTable | CylinderTable] = []


class FrictionTable(Table):
    kind: Literal["smooth", "switch", "cone"] = "smooth"
    mu: NotNegative | None = None
    mu_static: NotNegative | None = None
    mu_kinetic: NotNegative | None = None
    slip_speed: Positive | None = None


class RandomMembers(Table):
    """About `random` of the members `of` one kind, drawn by `seed`."""

    random: Annotated[float, Meta(gt=0, le=1)]
    of: Literal["struts", "cables"] = "cables"
    seed: Seed = 0


class RandomPhases(Table):
    seed: Seed


class WindTable(Table):
    """Wind on every node, or on each with its own drag."""

    velocity: tuple[float, float, float]
    drag: NotNegative | list[NotNegative]


class PushTable(Table):
    """A push on each of the nodes, for a time."""

    nodes: Annotated[list[Number], Meta(min_length=1)]
    force: tuple[float, float, float]
    start: float
    duration: Positive
    ramp: Positive = 0.01


class LoadTable(Table):
    """A static force on each of the nodes; tables of one name are one load case."""

    name: str
    nodes: Annotated[list[Number], Meta(min_length=1)]
    force: tuple[float, float, float]


class ShakingTable(Table):
    """The motion of all supports: s(t) = amplitude sin(2 pi frequency (t - start)), with a smooth rise over `ramp`."""

    amplitude: tuple[float, float, float]
    frequency: Positive
    start: NotNegative = 0.0
    ramp: Positive = 1.0


class OvertoneTable(Table):
    """A sine of a multiple of the gait's frequency: sizes and phases, one each for each actuated member."""

    size: list[NotNegative]
    phase: list[float]


class GaitTable(Table, kw_only=True):
    members: Literal["struts", "cables"] | list[int] | RandomMembers = "struts"
    amplitude: Share | list[Share] = 0.3
    frequency: NotNegative | list[NotNegative] = 0.5
    phase: list[float] | RandomPhases
    start: float = 0.0
    ramp: Positive = 1.0
    overtones: list[OvertoneTable] = []


class SceneFile(Table):
    structure: StructureTable
    struts: StrutsTable | None = None
    cables: CablesTable | None = None
    gravity: GravityTable | None = None
    damping: DampingTable | None = None
    ground: GroundTable | None = None
    friction: FrictionTable | None = None
    wind: WindTable | None = None
    pushes: list[PushTable] = []
    shaking: ShakingTable | None = None
    bodies: list[BodyTable] = []
    gait: GaitTable | None = None
    loads: list[LoadTable] = []
