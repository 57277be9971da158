"""The keys of struts and cables."""

from typing import Annotated

from msgspec import Meta

from jaxgrity.io.table_types import NotNegative, Number, Positive, Table

Prestrain = Annotated[float, Meta(lt=1)]
Some = Annotated[list[float], Meta(min_length=1)]


class MotorTable(Table, kw_only=True):
    """A motor that winds a member to given rest lengths, one after the other."""

    member: Number
    times: Some
    lengths: Annotated[list[Positive], Meta(min_length=1)]
    rate: Positive
    lag: Positive | None = None
    smallest: Positive | None = None


class PulleyKeys(Table, kw_only=True):
    """A pulley between two successive cables of a cluster."""

    between: tuple[Number, Number]
    radius: Positive
    axis: tuple[float, float, float] | None = None
    axle: tuple[Number, Number] | None = None
    turns: Number = 0
    mu: NotNegative | None = None
    slip_speed: Positive | None = None
    drum: Number | None = None


class ForceKeys(Table):
    """The force of every cable, by its stretch."""

    stretch: Annotated[list[float], Meta(min_length=2)]
    force: Annotated[list[float], Meta(min_length=2)]


class _MembersTable(Table):
    """The common keys of struts and cables."""

    stiffness: Positive | list[Positive] | None = None
    mass: NotNegative | list[NotNegative] | None = None
    damping: NotNegative | list[NotNegative] | None = None
    prestrain: Prestrain | list[Prestrain] | None = None
    rest_length: Positive | list[Positive] | None = None
    stuck: list[Number] = []
    motors: list[MotorTable] = []
    material: str | None = None
    youngs_modulus: Positive | list[Positive] | None = None
    density: Positive | list[Positive] | None = None
    yield_stress: Positive | list[Positive] | None = None
    diameter: Positive | list[Positive] | None = None
    wall: Positive | list[Positive] | None = None
    area: Positive | list[Positive] | None = None
    yield_force: NotNegative | list[NotNegative] | None = None
    bending_stiffness: NotNegative | list[NotNegative] | None = None


class TouchingKeys(Table):
    """Contact of struts with each other: their radius, and which pairs may touch; by default all."""

    radius: Positive | list[Positive]
    pairs: Annotated[list[tuple[Number, Number]], Meta(min_length=1)] | None = None
    at_once: Annotated[int, Meta(ge=1)] | None = None


class StrutsTable(_MembersTable):
    rigid: bool = False
    touching: TouchingKeys | None = None


class CablesTable(_MembersTable):
    broken: list[Number] = []
    clusters: list[list[Number]] = []
    pulleys: list[PulleyKeys] = []
    force: ForceKeys | None = None
    largest_force: Positive | list[Positive] | None = None
    dead_band: NotNegative | list[NotNegative] | None = None
    damper: NotNegative | list[NotNegative] | None = None
    quadratic: NotNegative | list[NotNegative] | None = None
    cubic: NotNegative | list[NotNegative] | None = None
    pull: NotNegative | list[NotNegative] | None = None
    pull_slope: NotNegative | list[NotNegative] | None = None
