"""Members by material and cross-section, against the formulas of a first course."""

import jax
import numpy as np
import pytest

from jaxgrity import InputError
from jaxgrity.model import MATERIALS, Material, sized_members

EDGES, LENGTHS = ((0, 1), (1, 2)), np.array([1.0, 2.0])


def test_a_tube_is_a_bar_without_its_core():
    """K = EA/L, m = density A L, N = stress A, and EI, each the difference between two solid bars."""
    steel = MATERIALS["steel"]
    tube = sized_members(EDGES, LENGTHS, "steel", diameter=0.03, wall=np.array([0.002, 0.004]))
    outer = sized_members(EDGES, LENGTHS, steel, diameter=0.03)
    core = sized_members(EDGES, LENGTHS, steel, diameter=np.array([0.026, 0.022]))
    for name in ("stiffness", "mass", "yield_force", "bending_stiffness"):
        np.testing.assert_allclose(getattr(tube, name), getattr(outer, name) - getattr(core, name), rtol=1e-12)
    A, second = np.pi * 0.015**2, np.pi * 0.015**4 / 4
    np.testing.assert_allclose(outer.stiffness, 210e9 * A / LENGTHS, rtol=1e-12)
    np.testing.assert_allclose(outer.mass, 7850 * A * LENGTHS, rtol=1e-12)
    np.testing.assert_allclose(outer.yield_force, 235e6 * A, rtol=1e-12)
    np.testing.assert_allclose(outer.bending_stiffness, 210e9 * second, rtol=1e-12)


def test_an_area_is_that_of_a_round_bar():
    """All numbers are those of its diameter; what a material does not say stays unknown."""
    bar = sized_members(EDGES, LENGTHS, Material(1e9), area=np.pi * 0.01**2)
    same = sized_members(EDGES, LENGTHS, Material(1e9), diameter=0.02)
    np.testing.assert_allclose(bar.stiffness, same.stiffness, rtol=1e-12)
    np.testing.assert_allclose(bar.bending_stiffness, same.bending_stiffness, rtol=1e-12)
    assert bar.mass is None
    assert bar.yield_force is None


@pytest.mark.parametrize(
    ("material", "section", "words"),
    [
        ("stel", {"area": 1e-4}, "material = 'stel': unknown; perhaps you meant steel; expected one of steel, alu"),
        ("steel", {}, "diameter: missing"),
        ("steel", {"area": 1e-4, "wall": 0.001}, "area: diameter or wall is given too"),
        ("steel", {"diameter": 0.01, "wall": 0.006}, "wall: 0.006 m at member 0; expected at most half"),
        ("steel", {"diameter": [0.01]}, "diameter has 1 numbers; expected one, or 2"),
        ("steel", {"area": -1.0}, r"area\[0\] = -1"),
        (Material(np.nan), {"area": 1e-4}, r"youngs_modulus\[0\] = nan"),
        (Material("1e9"), {"area": 1e-4}, "expected numbers"),
        (Material(1e9, 0.0), {"area": 1e-4}, r"density\[0\] = 0"),
    ],
)
def test_impossible_sizes_are_refused(material, section, words):
    with pytest.raises(InputError, match=words):
        sized_members(EDGES, LENGTHS, material, **section)


def test_sizes_have_derivatives():
    """Of tubes: A = pi (d - w) w, so dK/dd = E pi w/L and dK/dw = E pi (d - 2 w)/L; of one number for all, the sum."""

    def stiffness(d, w):
        return sized_members(((0, 1), (1, 2)), np.array([0.5, 2.0]), Material(70e9), diameter=d, wall=w).stiffness.sum()

    d, w, per_length = 0.03, 0.002, 70e9 * np.pi * (1 / 0.5 + 1 / 2.0)
    found = jax.jit(jax.grad(stiffness, (0, 1)))(d, w)
    np.testing.assert_allclose(found, [per_length * w, per_length * (d - 2 * w)], rtol=1e-12)
