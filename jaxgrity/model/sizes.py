"""Members by material and cross-section: their stiffness, mass and strength."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxgrity.core.arguments import check_each
from jaxgrity.core.errors import InputError, check_known
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, Edges, PerMember, as_float
from jaxgrity.model.structure import Members, per_member


class Material(NamedTuple):
    """A linear elastic material. Each number is one for all members, or one per member."""

    youngs_modulus: Any
    """Young's modulus E, Pa"""
    density: Any = None
    """kg/m^3; None: members have no mass"""
    yield_stress: Any = None
    """stress at which it yields, in tension and in compression, Pa; None: no limit"""


MATERIALS = {
    "steel": Material(210e9, 7850.0, 235e6),
    "aluminium": Material(70e9, 2700.0, 240e6),
    "steel_strand": Material(195e9, 7850.0, 1674e6),
    "uhmwpe": Material(109e9, 975.0, 3.3e9),
}
"""Materials by name, for first designs; use the numbers of your own product where you have them.

- steel: S235 (EN 1993-1-1, 3.2.6 and table 3.1).
- aluminium: EN AW-6061 T6 (EN 1999-1-1, 3.2.5 and table 3.2b).
- steel_strand: prestressing strand Y1860 by its metallic area (EN 1992-1-1, 3.3). The stress is the 0.1 % proof stress.
- uhmwpe: polyethylene yarn Dyneema SK75, lowest values of its maker's fact sheet (DSM, CIS YA100, 2010). The stress is
  that at which the yarn breaks; ropes have less.
"""


@typed
def sized_members(
    edges: Edges,
    rest_length: PerMember,
    material: Material | str,
    *,
    diameter: Any = None,
    wall: Any = None,
    area: Any = None,
) -> Members:
    """Members of a material and a cross-section: K = E A/L, m = density A L, yield force, and E I for Euler's load.

    Sizes may be traced by JAX, so that all of this has derivatives by them.

    Args:
        edges: the nodes at both ends of each member.
        rest_length: L of each member, m.
        material: a name in `MATERIALS`, or your own numbers.
        diameter: of round bars and tubes, m; one number, or one per member.
        wall: thickness of tubes, m; None: solid bars.
        area: in place of diameter and wall, m^2: then the section counts as a solid round one, I = A^2/(4 pi).

    Returns:
        The members; `dataclasses.replace` adds damping or motors.

    Raises:
        InputError: an unknown material, no section or two, or a number that is not positive.

    Example:
        >>> import numpy as np
        >>> tubes = jaxgrity.model.sized_members(((0, 1),), np.array([1.0]), "aluminium", diameter=0.02, wall=0.001)
        >>> f"{tubes.stiffness[0]:.4g} N/m, {tubes.mass[0]:.3g} kg"
        '4.178e+06 N/m, 0.161 kg'
    """
    material = material_of(material)
    count = len(edges)
    A, second = _section(count, diameter, wall, area)
    L = np.asarray(rest_length, float)
    check_each("rest_length", L, shape=(count,), above=0.0, unit="m")
    E, density, stress = (
        None if value is None else _each(name, value, count) for name, value in zip(Material._fields, material)
    )
    assert E is not None, "each material has a Young's modulus"
    return Members(
        edges=edges,
        stiffness=E * A / L,
        rest_length=L,
        mass=None if density is None else density * A * L,
        yield_force=None if stress is None else stress * A,
        bending_stiffness=E * second,
    )


def material_of(material: Material | str) -> Material:
    """The material, or that of this name; raises `InputError` for an unknown name."""
    if isinstance(material, Material):
        return material
    check_known("material", material, MATERIALS)
    return MATERIALS[material]


def _section(count: int, diameter: Any, wall: Any, area: Any) -> tuple[AnyArray, AnyArray]:
    """Area, m^2, and second moment of area, m^4, of each member."""
    if area is not None:
        if diameter is not None or wall is not None:
            raise InputError("area: diameter or wall is given too; expected area alone, or diameter and maybe wall")
        A = _each("area", area, count)
        return A, A**2 / (4 * np.pi)
    if diameter is None:
        raise InputError("diameter: missing; expected the diameter of each member (m), or its area (m^2)")
    outer = _each("diameter", diameter, count)
    inner: AnyArray = np.zeros(count)
    if wall is not None:
        inner = outer - 2 * _each("wall", wall, count)
        if isinstance(inner, np.ndarray) and np.any(inner < 0):
            k = int(np.argmin(inner))
            raise InputError(f"wall: {(outer - inner)[k] / 2:g} m at member {k}; expected at most half of the diameter")
    return np.pi / 4 * (outer**2 - inner**2), np.pi / 64 * (outer**4 - inner**4)


def _each(name: str, value: Any, count: int) -> AnyArray:
    """A positive number for each member, as far as known."""
    found = as_float(value)
    if isinstance(found, np.ndarray):
        found = per_member(found, count, name)
    elif not found.ndim:
        found = jnp.broadcast_to(found, (count,))
    check_each(name, found, shape=(count,), above=0.0)
    return found
