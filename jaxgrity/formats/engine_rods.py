"""Rods in files of differentiable engines: cylinders with end caps, motors and a housing, as masses and inertias."""

from typing import Any, NamedTuple

import numpy as np

from jaxgrity.core.errors import InputError, check_known
from jaxgrity.formats.engine_tables import check_keys, name_in, number_in, table_of, taken, vector_of
from jaxgrity.formats.foreign import Losses, finite, positive, short

PARTS = {
    "caps": ("sphere_mass", "sphere_radius"),
    "motors": ("motor_mass", "motor_length", "motor_radius", "motor_offset"),
    "housing": ("housing_mass", "housing_length"),
}
"""Numbers of each part that a rod may have beside its cylinder."""
ROD_TYPES = {
    "rod": (),
    "rod_sphere_end_caps": ("caps",),
    "rod_sphere_end_caps_motors": ("caps", "motors"),
    "multi_rod_sphere_end_caps_motors": ("caps", "motors"),
    "rod_housing_end_caps_motors": ("caps", "motors", "housing"),
}
"""Parts of a rod of each type."""
UNTYPED = "rod_sphere_end_caps_motors"
"""Type of a rod whose file names none: the engine with a network has no other."""
ROD_KEYS = (
    *("name", "rod_type", "shape", "end_pts", "linear_vel", "ang_vel", "quat", "radius", "mass", "sites", "fixed"),
    *("split_length", "inner_length"),
    *(key for keys in PARTS.values() for key in keys),
)
"""All keys of a rod."""
OFF_AXIS = 1e-3
"""Largest sine of the angle between a rod and the axis of its quaternion: files round both."""


class Rod(NamedTuple):
    """A rod, in the file's unit of length."""

    name: str
    ends: np.ndarray
    """(2, 3), the middles of its end caps"""
    mass: float
    """kg, of all parts"""
    along: float
    """moment of inertia about its axis, kg unit^2"""
    across: float
    """moment of inertia about each axis through its centre that is at right angles, kg unit^2"""
    radius: float
    """of what touches the ground at its ends"""
    sites: tuple[str, ...]
    fixed: bool

    @property
    def length(self) -> float:
        return float(np.linalg.norm(self.ends[1] - self.ends[0]))

    @property
    def axis(self) -> np.ndarray:
        return (self.ends[1] - self.ends[0]) / self.length


def rod_of(given: Any, where: str, losses: Losses) -> Rod:
    """A rod from its table at `where`. Raises `InputError` for what the engines cannot read."""
    table = table_of(given, where)
    check_keys(table, ROD_KEYS, where)
    name = name_in(table, "name", where)
    where = f"{where} ({name})"
    kind = name_in(table, "rod_type", where) if "rod_type" in table else UNTYPED
    check_known(f"{where}.rod_type", kind, ROD_TYPES)
    fixed, sites = table.get("fixed", False), taken(table, "sites", where)
    if not isinstance(fixed, bool):
        raise InputError(f"{where}.fixed = {short(fixed)}: expected true or false")
    if not isinstance(sites, list) or not all(isinstance(each, str) for each in sites):
        raise InputError(f"{where}.sites = {short(sites)}: expected a list of names")
    pair = taken(table, "end_pts", where)
    if not isinstance(pair, list) or len(pair) != 2:
        raise InputError(f"{where}.end_pts = {short(pair)}: expected two points")
    ends = np.stack([vector_of(point, f"{where}.end_pts[{k}]") for k, point in enumerate(pair)])
    if not np.linalg.norm(ends[1] - ends[0]) > 0:
        raise InputError(f"{where}.end_pts: both points are the same; expected a rod with a length")
    mass, along, across, radius = _moments(table, kind, ends, where, losses)
    rod = Rod(name, ends, mass, along, across, radius, tuple(sites), fixed)
    _check_start(table, rod, where, losses)
    return rod


def _moments(
    table: dict[str, Any], kind: str, ends: np.ndarray, where: str, losses: Losses
) -> tuple[float, float, float, float]:
    """Mass, inertia along and across, and the radius at the ends."""
    length = float(np.linalg.norm(ends[1] - ends[0]))
    m, r = (number_in(table, key, where, positive) for key in ("mass", "radius"))
    parts = {
        part: [number_in(table, key, where, finite if key == "motor_offset" else positive) for key in PARTS[part]]
        for part in ROD_TYPES[kind]
    }
    _check_split(table, length, where)
    mass, along, across = m, m * r**2 / 2, m * (length**2 / 12 + r**2 / 4)
    ball, thickest = r, r
    if "caps" in parts:
        cap, ball = parts["caps"]
        mass, along = mass + 2 * cap, along + 0.8 * cap * ball**2
        across += 2 * cap * (0.4 * ball**2 + length**2 / 4)
    for count, part in ((2, "motors"), (1, "housing")):
        if part in parts:
            own, long, *rest = parts[part]
            outer, offset = rest if rest else (parts["motors"][2], 0.0)
            # the engines take the length of a hollow cylinder for its radius, and the sum of its squared radii for its
            # length; what is read turns as it does there
            mass, along = mass + count * own, along + count * own * long**2 / 2
            across += count * own * ((outer**2 + r**2) ** 2 / 12 + long**2 / 4 + offset**2)
            thickest = max(thickest, outer)
            losses.note(
                "motors of rods have the inertia that the engines give them, with their length for their radius"
            )
    if not np.isfinite([mass, along, across]).all():
        raise InputError(f"{where}: its inertia is beyond all numbers; expected smaller masses and lengths")
    if "caps" not in parts or thickest > ball:
        what = f"{where}: rims of its cylinders, with a radius of {thickest:g}, touch the ground"
        losses.lose("radius", what)
    return mass, along, across, ball


def _check_split(table: dict[str, Any], length: float, where: str) -> None:
    """Refuses pieces of a rod that are so long that the engine gives it another mass."""
    for key in ("split_length", "inner_length"):
        if table.get(key) is not None:
            piece = number_in(table, key, where)
            if piece and (piece < 0 or length < 2 * piece):
                raise InputError(
                    f"{where}.{key} = {piece:g}: with less than two pieces of a rod of {length:g} the engine loses a "
                    "part of its mass; expected at most half of that, or 0"
                )


def _check_start(table: dict[str, Any], rod: Rod, where: str, losses: Losses) -> None:
    """Its velocity and its pose at the start."""
    for key in ("linear_vel", "ang_vel"):
        if np.any(velocity := vector_of(table.get(key, [0.0] * 3), f"{where}.{key}")):
            losses.lose("velocity", f"{where}.{key} = {velocity.tolist()}")
    if table.get("quat") is not None:
        w, x, y, z = q = vector_of(table["quat"], f"{where}.quat", 4)
        axis = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), w**2 + z**2 - x**2 - y**2])
        size = float(q @ q)
        if not (size > 0 and np.linalg.norm(np.cross(axis / size, rod.axis)) < OFF_AXIS and axis @ rod.axis > 0):
            raise InputError(
                f"{where}.quat = {q.tolist()}: turns z to {np.round(axis / (size or 1.0), 4).tolist()}, and not along "
                f"the rod, {np.round(rod.axis, 4).tolist()}; expected both alike, or no quat"
            )
