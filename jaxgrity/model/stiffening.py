"""Cables whose force is a polynomial of their stretch."""

import dataclasses
from collections.abc import Sequence
from typing import ClassVar

import equinox as eqx
import numpy as np

from jaxgrity.core.arguments import check_each
from jaxgrity.core.primitives import inner, positive_part
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyRows, Scalar, as_float, as_float_or_none
from jaxgrity.model.clusters import in_series
from jaxgrity.model.force_laws import per_cable
from jaxgrity.model.laws import Configuration, EnergyTerm, member_names
from jaxgrity.model.structure import Members


class PolynomialStiffness(EnergyTerm):
    """What a force K x (1 + a x + b x^2) of cables adds to K x: U = sum K (a/3 x^3 + b/4 x^4), x = max(0, l - L(t)).

    If a cable's stiffness K changes, all of its force changes by the same factor, so a broken cable has none. Made by
    `polynomial_stiffness`.
    """

    quadratic: AnyRows = eqx.field(converter=as_float)
    """coefficient a of each cable, 1/m"""
    cubic: AnyRows = eqx.field(converter=as_float)
    """coefficient b of each cable, 1/m^2"""
    factors: AnyRows | None = eqx.field(converter=as_float_or_none, default=None)
    """factor of each cable's force, for reports; None: 1"""
    name: ClassVar[str] = "polynomial stiffness of cables"

    def __check_init__(self):
        check_each("quadratic", self.quadratic, least=0.0, unit="1/m")
        check_each("cubic", self.cubic, least=0.0, unit="1/m^2")
        check_each("polynomial_stiffness.factors", self.factors, least=0.0)

    def energy(self, at: Configuration) -> Scalar:
        cables = at.scene.structure.cables
        x = positive_part(at.stretch("cables"))
        factors = 1 if self.factors is None else self.factors
        weight = factors * in_series(cables.stiffness, cables.clusters)
        return inner(weight * (self.quadratic / 3 + self.cubic / 4 * x) * x, x * x)

    def parts(self, scene):
        return member_names("polynomial stiffness of cable", scene.structure.cables)

    def scaled(self, factors):
        return dataclasses.replace(self, factors=factors)


@typed
def polynomial_stiffness(
    cables: Members, quadratic: float | Sequence[float], cubic: float | Sequence[float] = 0.0
) -> PolynomialStiffness:
    """Cables that grow stiffer with their stretch x = l - L: they pull with K x (1 + a x + b x^2).

    A largest force (`force_limit`) limits K x alone; scene files refuse the two together.

    Args:
        cables: the cables, with their stiffness K.
        quadratic: coefficient a, 1/m; one number for all cables, or one per cable (segments of one cable count as one).
        cubic: coefficient b, 1/m^2; one number, or one per cable.

    Returns:
        The term, for `with_terms`.

    Raises:
        InputError: a negative coefficient, or a wrong number of them.

    Example:
        >>> scene = jaxgrity.load_scene("reference")
        >>> law = jaxgrity.model.polynomial_stiffness(scene.structure.cables, 2.0, 5.0)
        >>> stiffer = jaxgrity.with_terms(scene, law)
    """
    return PolynomialStiffness(per_cable(cables, quadratic, "quadratic"), per_cable(cables, cubic, "cubic"))


def polynomial_terms(terms: Sequence[object], count: int) -> np.ndarray:
    """(cables, 2): the coefficients a and b of each of `count` cables by all such laws among the `terms`; 0 without."""
    found = np.zeros((count, 2))
    for term in terms:
        if isinstance(term, PolynomialStiffness):
            found = found + np.stack([np.asarray(term.quadratic), np.asarray(term.cubic)], axis=1)
    return found
