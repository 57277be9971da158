"""Nodes on cables of their own, which a scene file adds to a structure of the catalogue: a payload, for example."""

from collections.abc import Sequence

import msgspec
import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.io.member_tables import CablesTable, Prestrain
from jaxgrity.io.structure_tables import CustomTable, StructureTable
from jaxgrity.io.table_types import NotNegative, Pair, Positive, Table
from jaxgrity.io.validation import shown
from jaxgrity.model.structure import check_edges
from jaxgrity.structures.geometry import RobotGeometry

OWN = ("stiffness", "damping", "prestrain")
"""Keys of [cables] for which a group of added cables may have a number of its own."""


class AddedTable(Table, kw_only=True):
    """Nodes and cables beside those of the structure's kind. Their numbers go on from those before."""

    nodes: list[tuple[float, float, float]] = []
    """m, from the mean of the kind's nodes, before the robot is turned (`pose`) and moved (`height`)"""
    mass: NotNegative | None = None
    """kg, of each of these nodes"""
    cables: list[Pair] = []
    stiffness: Positive | None = None
    damping: NotNegative | None = None
    prestrain: Prestrain | None = None


def with_added_parts(tables: Sequence[AddedTable], structure: StructureTable, robot: RobotGeometry) -> RobotGeometry:
    """The geometry with the nodes and cables of all tables.

    Raises `InputError` for a custom structure, nodes without masses, and cables between nodes that are missing or
    joined already.
    """
    if tables and isinstance(structure, CustomTable):
        raise InputError('added: structure.kind = "custom" lists all of its nodes and cables; expected these there')
    nodes, cables, middle = robot.nodes, tuple(robot.cables), np.mean(robot.nodes, axis=0)
    for k, table in enumerate(tables):
        if not (table.nodes or table.cables):
            raise InputError(f"added[{k}]: adds nothing; expected nodes, cables or both")
        if bool(table.nodes) != (table.mass is not None):
            expected = "expected the mass of each node, kg" if table.nodes else "it adds no nodes; expected none"
            raise InputError(f"added[{k}].mass{_given(table.mass)}: {expected}")
        if table.nodes:
            nodes = np.concatenate([nodes, middle + np.array(table.nodes, float)])
        check_edges(nodes, (), tuple(table.cables), f"added[{k}]")
        taken = {frozenset(pair) for pair in (*robot.struts, *cables)}
        for c, pair in enumerate(table.cables):
            if frozenset(pair) in taken:
                joined = f"added[{k}].cables[{c}] = {shown(list(pair))}: a member joins these nodes already"
                raise InputError(f"{joined}; expected one member per pair")
        cables = (*cables, *table.cables)
    return robot._replace(nodes=nodes, cables=cables)


def added_masses(tables: Sequence[AddedTable]) -> list[float]:
    """The mass of each added node, kg."""
    return [float(table.mass or 0.0) for table in tables for _ in table.nodes]


def with_own_numbers(cables: CablesTable | None, tables: Sequence[AddedTable], count: int) -> CablesTable | None:
    """The [cables] table with the numbers of added cables, which come after `count` others.

    Raises `InputError` without a [cables] table, or where a list of it, or its lack of a number, leaves no place.
    """
    changed: dict[str, list[float]] = {}
    for k, table in enumerate(tables):
        if table.cables and cables is None:
            raise InputError(f"added[{k}].cables: there is no [cables] table; expected one, with a stiffness")
        for key in OWN:
            own = getattr(table, key)
            if own is None or cables is None:
                continue
            common = getattr(cables, key)
            if isinstance(common, list) or (common is None and key == "stiffness"):
                has = "is a list of all cables" if common else "is missing"
                raise InputError(f"added[{k}].{key}{_given(own)}: cables.{key} {has}; expected one number there")
            start = count + sum(len(before.cables) for before in tables[:k])
            total = count + sum(len(each.cables) for each in tables)
            each = changed.setdefault(key, [0.0 if common is None else common] * total)
            each[start : start + len(table.cables)] = [own] * len(table.cables)
    return cables if cables is None or not changed else msgspec.structs.replace(cables, **changed)


def _given(value: float | None) -> str:
    return "" if value is None else f" = {shown(value)}"
