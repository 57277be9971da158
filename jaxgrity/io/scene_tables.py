"""The tables of a scene file: their keys, with what each may hold."""

import math
from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

from jaxgrity.core.types import Edges
from jaxgrity.model.catalogue import icosahedron
from jaxgrity.model.structure import check_edges

Positive = Annotated[float, Meta(gt=0)]
NotNegative = Annotated[float, Meta(ge=0)]
Share = Annotated[float, Meta(ge=0, lt=1)]
Seed = Annotated[int, Meta(ge=0)]
Number = Annotated[int, Meta(ge=0)]
Pair = tuple[int, int]


class _Table(msgspec.Struct, forbid_unknown_fields=True):
    pass


class IcosahedronTable(_Table, tag="icosahedron", tag_field="kind"):
    strut_length: Positive = 1.0
    mass: Positive | None = None
    node_mass: list[Positive] | None = None
    pose: Literal["face", "strut"] = "strut"
    aligned: bool = False
    height: float = 0.0

    def geometry(self) -> tuple[np.ndarray, Edges, Edges]:
        """Nodes (nodes, 3), m, struts and cables."""
        return icosahedron(self.strut_length)


class CustomTable(_Table, tag="custom", tag_field="kind"):
    nodes: Annotated[list[tuple[float, float, float]], Meta(min_length=1)]
    struts: list[Pair] = []
    cables: list[Pair] = []
    mass: Positive | None = None
    node_mass: list[Positive] | None = None
    pose: Literal["face", "strut"] = "strut"
    aligned: bool = False
    height: float | None = None

    def geometry(self) -> tuple[np.ndarray, Edges, Edges]:
        """Nodes (nodes, 3), m, struts and cables."""
        nodes, struts, cables = np.array(self.nodes, float), tuple(self.struts), tuple(self.cables)
        check_edges(nodes, struts, cables)
        return nodes, struts, cables


StructureTable = IcosahedronTable | CustomTable
"""the kinds of structures, told apart by their key `kind`"""


class StrutsTable(_Table):
    stiffness: Positive | list[Positive] | None = None
    rigid: bool = False
    damping: NotNegative | list[NotNegative] | None = None
    prestrain: Annotated[float, Meta(lt=1)] | list[Annotated[float, Meta(lt=1)]] | None = None
    rest_length: Positive | list[Positive] | None = None
    stuck: list[Number] = []


class CablesTable(_Table):
    stiffness: Positive | list[Positive]
    damping: NotNegative | list[NotNegative] | None = None
    prestrain: Annotated[float, Meta(lt=1)] | list[Annotated[float, Meta(lt=1)]] | None = None
    rest_length: Positive | list[Positive] | None = None
    stuck: list[Number] = []
    broken: list[Number] = []


class GravityTable(_Table):
    g: NotNegative = 9.81


class DampingTable(_Table):
    node: NotNegative | list[NotNegative]


class GroundTable(_Table):
    contact: Literal["penalty", "complementarity"] = "penalty"
    incline: Annotated[float, Meta(gt=-math.pi / 2, lt=math.pi / 2)] = 0.0
    stiffness: Positive | None = None
    dissipation: NotNegative | None = None
    restitution: Annotated[float, Meta(ge=0, le=1)] | None = None


class FrictionTable(_Table):
    kind: Literal["smooth", "switch", "cone"] = "smooth"
    mu: NotNegative | None = None
    mu_static: NotNegative | None = None
    mu_kinetic: NotNegative | None = None
    slip_speed: Positive | None = None


class RandomMembers(_Table):
    """About `random` of the members `of` one kind, drawn by `seed`."""

    random: Annotated[float, Meta(gt=0, le=1)]
    of: Literal["struts", "cables"] = "cables"
    seed: Seed = 0


class RandomPhases(_Table):
    seed: Seed


class GaitTable(_Table, kw_only=True):
    members: Literal["struts", "cables"] | list[int] | RandomMembers = "struts"
    amplitude: Share | list[Share] = 0.3
    frequency: NotNegative | list[NotNegative] = 0.5
    phase: list[float] | RandomPhases
    start: float = 0.0
    ramp: Positive = 1.0


class SceneFile(_Table):
    structure: StructureTable
    struts: StrutsTable | None = None
    cables: CablesTable | None = None
    gravity: GravityTable | None = None
    damping: DampingTable | None = None
    ground: GroundTable | None = None
    friction: FrictionTable | None = None
    gait: GaitTable | None = None
