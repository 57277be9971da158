"""The tables of a scene file: their keys, and the values of each."""

import math
from typing import Annotated, Literal

from msgspec import Meta

from jaxgrity.io.added import AddedTable
from jaxgrity.io.bodies import BodyTable, HingeTable, SlideTable
from jaxgrity.io.ground_tables import ObstacleTable, SurfaceTable
from jaxgrity.io.member_tables import CablesTable, StrutsTable, TouchingKeys
from jaxgrity.io.structure_tables import StructureTable
from jaxgrity.io.table_types import NotNegative, Number, Positive, Seed, Share, Table


class GravityTable(Table):
    g: NotNegative = 9.81


class DampingTable(Table):
    node: NotNegative | list[NotNegative]


class BallsKeys(Table):
    """The nodes that touch the ground, and the radii of the balls about them."""

    nodes: Annotated[list[Number], Meta(min_length=1)]
    radius: NotNegative | list[NotNegative] = 0.0


class AlongStrutsKeys(Table):
    """Contact along struts and rods of bodies: points or parts of each, by default of all of them, and their radius."""

    count: Annotated[int, Meta(ge=1, le=1000)]
    struts: Annotated[list[Number], Meta(min_length=1)] | None = None
    radius: NotNegative | list[NotNegative] = 0.0


class GroundTable(Table):
    contact: Literal["penalty", "complementarity"] = "penalty"
    incline: Annotated[float, Meta(gt=-math.pi / 2, lt=math.pi / 2)] = 0.0
    stiffness: Positive | None = None
    dissipation: NotNegative | None = None
    restitution: Annotated[float, Meta(ge=0, le=1)] | None = None
    balls: BallsKeys | None = None
    along_struts: AlongStrutsKeys | None = None
    surface: SurfaceTable | None = None
    obstacles: list[ObstacleTable] = []


class FrictionTable(Table):
    kind: Literal["smooth", "switch", "cone"] = "smooth"
    mu: NotNegative | list[NotNegative] | None = None
    mu_static: NotNegative | list[NotNegative] | None = None
    mu_kinetic: NotNegative | list[NotNegative] | None = None
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
    slides: list[SlideTable] = []
    added: list[AddedTable] = []
    hinges: list[HingeTable] = []
    gait: GaitTable | None = None
    loads: list[LoadTable] = []
    touching: TouchingKeys | None = None
