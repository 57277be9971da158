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


class ForceKeys(Table):
    """The force of every cable, by its stretch."""

    stretch: Annotated[list[float], Meta(min_length=2)]
    force: Annotated[list[float], Meta(min_length=2)]


class StrutsTable(Table):
    stiffness: Positive | list[Positive] | None = None
    mass: NotNegative | list[NotNegative] | None = None
    rigid: bool = False
    damping: NotNegative | list[NotNegative] | None = None
    prestrain: Prestrain | list[Prestrain] | None = None
    rest_length: Positive | list[Positive] | None = None
    stuck: list[Number] = []
    motors: list[MotorTable] = []


class CablesTable(Table):
    stiffness: Positive | list[Positive] | None = None
    mass: NotNegative | list[NotNegative] | None = None
    damping: NotNegative | list[NotNegative] | None = None
    prestrain: Prestrain | list[Prestrain] | None = None
    rest_length: Positive | list[Positive] | None = None
    stuck: list[Number] = []
    broken: list[Number] = []
    clusters: list[list[Number]] = []
    motors: list[MotorTable] = []
    force: ForceKeys | None = None
    largest_force: Positive | list[Positive] | None = None
