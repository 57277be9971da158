"""The keys of structures in scene files: a table for each kind of the catalogue, and one for custom structures."""

from collections.abc import Callable
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from msgspec import Meta

from jaxgrity.core.types import Edges
from jaxgrity.io.table_types import NotNegative, Number, Pair, Positive, Share, Table
from jaxgrity.model.structure import check_edges
from jaxgrity.structures.balls import ball
from jaxgrity.structures.catalogue import icosahedron
from jaxgrity.structures.geometry import Geometry, RobotGeometry
from jaxgrity.structures.prisms import prism, three_strut_robot, tower
from jaxgrity.structures.robots import capped_robot, quadruped, superball
from jaxgrity.structures.spines import hinged_spine, planar_spine, tetrahedral_spine
from jaxgrity.structures.trusses import d_bar, grid, t_bar

Count = Annotated[int, Meta(ge=1, le=10_000)]
Formula = Callable[..., Geometry | RobotGeometry]


ELSEWHERE = 'to add nodes and cables to this kind, write [[added]]; to list all of them, kind = "custom"'
"""What to do in place of nodes, struts or cables among the keys of a kind."""


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
    elsewhere: ClassVar[dict[str, str]] = dict.fromkeys(("nodes", "struts", "cables"), ELSEWHERE)
    formula: ClassVar[Formula]
    """makes the geometry of the kind's own keys"""

    def own_keys(self) -> dict[str, Any]:
        """The keys of the kind alone, in order."""
        return {key: getattr(self, key) for key in self.__struct_fields__ if key not in _Shape.__struct_fields__}

    def geometry(self) -> Geometry | RobotGeometry:
        """Nodes (nodes, 3), m, struts and cables; of robots also bodies and balls."""
        return type(self).formula(*self.own_keys().values())


class IcosahedronTable(_Shape, tag="icosahedron", tag_field="kind"):
    strut_length: Positive = 1.0
    formula: ClassVar[Formula] = icosahedron


class PrismTable(_Shape, tag="prism", tag_field="kind"):
    struts: Count = 3
    radius: Positive = 0.3
    prism_height: Positive = 0.6
    upper_radius: Positive | None = None
    formula: ClassVar[Formula] = prism


class ThreeStrutTable(_Shape, tag="three_strut_robot", tag_field="kind"):
    strut_length: Positive = 1.0
    formula: ClassVar[Formula] = three_strut_robot


class TowerTable(_Shape, tag="tower", tag_field="kind"):
    struts: Count = 3
    stages: Count = 2
    overlap: Share = 0.3
    radius: Positive = 0.3
    stage_height: Positive = 0.6
    formula: ClassVar[Formula] = tower


class BallTable(_Shape, tag="ball", tag_field="kind"):
    struts: Count = 30
    strut_length: Positive = 1.0
    formula: ClassVar[Formula] = ball


class TetrahedralSpineTable(_Shape, tag="tetrahedral_spine", tag_field="kind"):
    vertebrae: Count = 3
    width: Positive = 0.3
    vertebra_height: Positive = 0.3
    spacing: Positive = 0.2
    formula: ClassVar[Formula] = tetrahedral_spine


class PlanarSpineTable(_Shape, tag="planar_spine", tag_field="kind"):
    vertebrae: Count = 3
    length: Positive = 0.3
    vertebra_height: Positive = 0.3
    spacing: Positive = 0.2
    formula: ClassVar[Formula] = planar_spine


class DBarTable(_Shape, tag="d_bar", tag_field="kind"):
    sides: Count = 3
    length: Positive = 1.0
    radius: Positive = 0.15
    formula: ClassVar[Formula] = d_bar


class TBarTable(_Shape, tag="t_bar", tag_field="kind"):
    sides: Count = 3
    length: Positive = 1.0
    radius: Positive = 0.15
    formula: ClassVar[Formula] = t_bar


class GridTable(_Shape, tag="grid", tag_field="kind"):
    rows: Count = 2
    columns: Count = 2
    side: Positive = 1.0
    thickness: Positive = 0.6
    formula: ClassVar[Formula] = grid


class HingedSpineTable(_Shape, tag="hinged_spine", tag_field="kind"):
    vertebrae: Count = 3
    vertebra_height: Positive = 0.1
    vertebra_mass: Positive = 0.1
    formula: ClassVar[Formula] = hinged_spine


class CappedTable(_Shape, tag="capped_robot", tag_field="kind"):
    strut_length: Positive = 1.0
    rod_mass: Positive = 0.4
    cap_mass: Positive = 0.1
    payload_mass: Positive = 1.0
    formula: ClassVar[Formula] = capped_robot


class SuperballTable(_Shape, tag="superball", tag_field="kind"):
    strut_length: Positive = 1.7
    rod_mass: Positive = 1.0
    cap_mass: Positive = 1.25
    formula: ClassVar[Formula] = superball


class QuadrupedTable(_Shape, tag="quadruped", tag_field="kind"):
    vertebrae: Count = 3
    width: Positive = 0.2
    vertebra_mass: Positive = 0.2
    leg_mass: Positive = 0.1
    formula: ClassVar[Formula] = quadruped


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
"""Tables of the kinds of structures that are made by formula, of struts and cables."""
RobotTable = HingedSpineTable | QuadrupedTable | CappedTable | SuperballTable
"""Tables of the kinds that have rigid bodies."""
StructureTable = CatalogueTable | RobotTable | CustomTable
"""Tables of all kinds of structures, which differ in their key `kind`."""
