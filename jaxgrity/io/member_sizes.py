"""Sizes of struts and cables in a scene file, in place of stiffness and mass."""

import dataclasses

import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.types import Edges, PerMember
from jaxgrity.io.member_tables import CablesTable, StrutsTable
from jaxgrity.io.validation import shown
from jaxgrity.model.sizes import Material, material_of, sized_members
from jaxgrity.model.structure import Members, edge_lengths

NUMBERS = ("youngs_modulus", "density", "yield_stress")
"""Keys of what a material is."""
SECTION = ("diameter", "wall", "area")
"""Keys of a cross-section."""
SIZES = ("material", *NUMBERS, *SECTION)
"""Keys of sizes. Numbers of the material's own replace those of its name."""


def has_sizes(table: StrutsTable | CablesTable | None) -> bool:
    """Whether members have sizes in place of a stiffness."""
    return table is not None and any(getattr(table, key) is not None for key in SIZES)


def members_of_sizes(table: StrutsTable | CablesTable, edges: Edges, rest_length: PerMember, kind: str) -> Members:
    """The members with stiffness, mass and strength from the sizes in their table.

    Raises `InputError` where sizes are incomplete, or something that follows from them is given too.
    """
    given = {key: value for key in SIZES if (value := getattr(table, key)) is not None}
    numbers = {key: given[key] for key in NUMBERS if key in given}
    material = Material(**({"youngs_modulus": None} | numbers))
    if "material" in given:
        try:
            material = material_of(given["material"])._replace(**numbers)
        except InputError as error:
            raise InputError(f"{kind}.{error}") from error
    if material.youngs_modulus is None:
        raise InputError(f"{kind}.material: missing; expected a material, or youngs_modulus (Pa), beside {min(given)}")
    follows = {"stiffness": True, "mass": material.density is not None, "force": True, "bending_stiffness": True}
    follows["yield_force"] = material.yield_stress is not None
    for key in (key for key, known in follows.items() if known):
        if (value := getattr(table, key, None)) is not None:
            told = f"{kind}.{key}{'' if key == 'force' else f' = {shown(value)}'}"
            raise InputError(f"{told}: it follows from {min(given)}; expected one of them")
    try:
        found = sized_members(edges, rest_length, material, **{key: given[key] for key in SECTION if key in given})
    except InputError as error:
        raise InputError(f"{kind}.{error}") from error
    return dataclasses.replace(found, stiffness=None) if getattr(table, "rigid", False) else found


def with_sizes_kept(members: Members, nodes: np.ndarray) -> Members:
    """Members whose sizes gave K = EA/l at `nodes`, m, and whose rest lengths then changed: with E A, mass per length
    and forces kept.

    N = EA (l - L)/L = K (l - L') has L = l EA/(EA + N).
    """
    if members.stiffness is None:
        return members
    length = edge_lengths(nodes, members.edges)
    EA = np.asarray(members.stiffness) * length
    rest = length * EA / (EA + EA / length * (length - np.asarray(members.rest_length)))
    mass = None if members.mass is None else np.asarray(members.mass) * rest / length
    return dataclasses.replace(members, rest_length=rest, stiffness=EA / rest, mass=mass)
