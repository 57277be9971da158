"""Cables in files of differentiable engines, and the sites of rods at which they end."""

from typing import Any, NamedTuple

import numpy as np

from jaxgrity.core.errors import InputError, check_known
from jaxgrity.formats.engine_rods import Rod
from jaxgrity.formats.engine_tables import check_keys, name_in, number_in, table_of, taken, vector_of
from jaxgrity.formats.foreign import not_negative, positive, short

CABLE_TYPES = ("cable", "actuated_cable")
CABLE_KEYS = (
    *("name", "type", "stiffness", "damping", "rest_length", "end_pts"),
    *("init_act_length", "winch_r", "min_winch_r", "max_winch_r", "motor_speed"),
)
"""All keys of a cable. The last four say how fast a motor winds it, and move nothing by themselves."""


class EngineCable(NamedTuple):
    """A cable, in the file's unit of length."""

    name: str
    ends: tuple[str, str]
    """sites"""
    stiffness: float
    damping: float
    rest_length: float
    driven: bool
    """whether a motor winds it"""


Sites = list[dict[str, np.ndarray]]
"""Of each rod, the places of the sites at which cables end."""


def cable_of(given: Any, where: str) -> EngineCable:
    table = table_of(given, where)
    check_keys(table, CABLE_KEYS, where)
    name = name_in(table, "name", where)
    where = f"{where} ({name})"
    kind, ends = name_in(table, "type", where), taken(table, "end_pts", where)
    check_known(f"{where}.type", kind, CABLE_TYPES)
    if not isinstance(ends, list) or len(ends) != 2 or not all(isinstance(end, str) for end in ends):
        raise InputError(f"{where}.end_pts = {short(ends)}: expected the names of two sites")
    stiffness, rest = (number_in(table, key, where, positive) for key in ("stiffness", "rest_length"))
    driven = kind == "actuated_cable"
    wound = number_in(table, "init_act_length", where) if driven and "init_act_length" in table else 0.0
    if not rest > wound:
        raise InputError(f"{where}.init_act_length = {wound:g}: expected less than the rest length, {rest:g}")
    damping = number_in(table, "damping", where, not_negative)
    return EngineCable(name, (ends[0], ends[1]), stiffness, damping, rest - wound, driven)


def sites_of(rods: list[Rod], cables: list[EngineCable], sites: dict[str, Any]) -> Sites:
    """Refuses cables that the engines do not pull together."""
    owner: dict[str, int] = {}
    for k, rod in enumerate(rods):
        for site in rod.sites:
            if owner.setdefault(site, k) != k:
                raise InputError(f"site {site!r} belongs to {rods[owner[site]].name} and {rod.name}; expected one rod")
    found: Sites = [{} for _ in rods]
    for cable in cables:
        for end in cable.ends:
            if end not in owner:
                raise InputError(f"cable {cable.name} ends at {end!r}; expected a site in the list of a rod")
            found[owner[end]][end] = vector_of(taken(sites, end, "system_topology.sites"), f"site {end!r}")
        first, second = (owner[end] for end in cable.ends)
        if first == second:
            raise InputError(f"cable {cable.name} joins two sites of {rods[first].name}; expected those of two rods")
        if first > second:
            raise InputError(
                f"cable {cable.name} runs from {rods[first].name} back to {rods[second].name}, an earlier rod: the "
                "engines let it push; expected its end_pts in the order of the rods"
            )
    return found
