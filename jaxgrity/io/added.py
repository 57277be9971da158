"""Nodes on cables of their own, which a scene file adds to a structure of the catalogue: a payload, for example."""

from collections.abc import Collection, Sequence

import msgspec
import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.io.member_tables import CablesTable, Prestrain
from jaxgrity.io.structure_tables import CustomTable, StructureTable
from jaxgrity.io.table_types import NotNegative, Pair, Positive, Table
from jaxgrity.io.validation import shown
from jaxgrity.model.structure import Members, check_edges
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
            if table.mass is None:
                raise InputError(f"added[{k}].mass: missing; expected the mass of each node, kg")
            raise InputError(f"added[{k}].mass = {table.mass:g}: it adds no nodes; expected none")
        if not table.cables and (key := next((key for key in OWN if getattr(table, key) is not None), None)):
            raise InputError(f"added[{k}].{key} = {getattr(table, key):g}: it adds no cables; expected none")
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


def added_masses(
    tables: Sequence[AddedTable], count: int, cables: Members | None, held: Collection[int]
) -> list[float]:
    """The mass of each added node, kg; they are the last of `count` nodes.

    Raises `InputError` for one without mass that none of its cables bears either, unless it is `held` by a support.
    """
    each = [(k, float(table.mass or 0.0)) for k, table in enumerate(tables) for _ in table.nodes]
    heavy = {*held}
    if cables is not None and cables.mass is not None:
        heavy |= {node for edge, mass in zip(cables.edges, np.asarray(cables.mass)) if mass for node in edge}
    for node, (k, mass) in enumerate(each, count - len(each)):
        if not mass and node not in heavy:
            raise InputError(f"added[{k}].mass = 0: no cable of node {node} has mass either; expected some mass")
    return [mass for _, mass in each]


def with_own_numbers(cables: CablesTable | None, tables: Sequence[AddedTable], count: int) -> CablesTable | None:
    """The [cables] table with the numbers of added cables, which come after `count` others.

    Raises `InputError` without a [cables] table, or where its own number leaves no place for another.
    """
    changed: dict[str, list[float]] = {}
    total, start = count + sum(len(table.cables) for table in tables), count
    for k, table in enumerate(tables):
        if table.cables and cables is None:
            raise InputError(f"added[{k}].cables: there is no [cables] table; expected one, with a stiffness")
        for key in OWN:
            own = getattr(table, key)
            if own is not None and cables is not None:
                common = _common_number(cables, key, f"added[{k}].{key} = {own:g}")
                each = changed.setdefault(key, [common] * total)
                each[start : start + len(table.cables)] = [own] * len(table.cables)
        start += len(table.cables)
    return msgspec.structs.replace(cables, **changed) if cables is not None and changed else cables


def _common_number(cables: CablesTable, key: str, where: str) -> float:
    """The one number of all cables. Raises `InputError` where there is none."""
    common = getattr(cables, key)
    if isinstance(common, list):
        raise InputError(f"{where}: cables.{key} is a list of all cables; expected one number there")
    if common is None and key == "stiffness":
        raise InputError(f"{where}: cables.stiffness is missing; expected one number there")
    if key == "prestrain" and cables.rest_length is not None:
        raise InputError(f"{where}: cables.rest_length is given; expected cables.prestrain, or none")
    return 0.0 if common is None else common
