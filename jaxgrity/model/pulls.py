"""Cables that pull with a commanded force, whatever their length, such as those of motors that hold a torque."""

import dataclasses
from collections.abc import Sequence
from typing import ClassVar

import equinox as eqx
import numpy as np

from jaxgrity.core.arguments import check_each
from jaxgrity.core.primitives import inner, positive_part
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, AnyRows, Scalar, as_float, as_float_or_none
from jaxgrity.model.actuation import rest_length
from jaxgrity.model.clusters import added_up, cables_of, to_segments
from jaxgrity.model.laws import Configuration, EnergyTerm, member_names
from jaxgrity.model.scene import Scene
from jaxgrity.model.structure import Members, per_member


class CommandedPull(EnergyTerm):
    """A pull of each cable that does not depend on its length: U = sum max(0, P + s (L0 - L(t))) l.

    L0 is the rest length of the structure, and L(t) what a gait, a motor or a controller makes of it. So the command
    that shortens a spring sets a force here. It adds to the force of the cable's spring. Made by `commanded_pull`.
    """

    pull: AnyRows = eqx.field(converter=as_float)
    """pull P of each cable at its rest length L0, N"""
    slope: AnyRows = eqx.field(converter=as_float)
    """further pull s for each metre by which the command shortens the cable, N/m"""
    factors: AnyRows | None = eqx.field(converter=as_float_or_none, default=None)
    """factor of each cable's pull, for reports; None: 1"""
    name: ClassVar[str] = "commanded pull of cables"

    def __check_init__(self):
        check_each("pull", self.pull, least=0.0, unit="N")
        check_each("pull_slope", self.slope, least=0.0, unit="N/m")
        check_each("commanded_pull.factors", self.factors, least=0.0)

    def energy(self, at: Configuration) -> Scalar:
        structure = at.scene.structure
        cables = structure.cables
        shorter = cables.rest_length - rest_length(cables, at.scene.gait, at.t, structure.first_cable)
        pull = positive_part(self.pull + self.slope * added_up(shorter, cables.clusters))
        factors = 1 if self.factors is None else self.factors
        return inner(factors * pull, added_up(at.length("cables"), cables.clusters))

    def parts(self, scene):
        return member_names("commanded pull of cable", scene.structure.cables)

    def scaled(self, factors):
        return dataclasses.replace(self, factors=factors)


@typed
def commanded_pull(
    cables: Members, pull: float | Sequence[float], slope: float | Sequence[float] = 0.0
) -> CommandedPull:
    """Cables that pull with a force P + s (L0 - L(t)), whatever their length; a negative force is 0.

    A gait that shortens the rest length L0 by a share c changes the pull by s L0 c. With the slope F/L0, a share of 1
    is the force F. Give the cables no stiffness, unless they are to be springs, too.

    Args:
        cables: the cables that pull.
        pull: pull P at the rest length, N; one number for all cables, or one per cable (segments of one cable count as
            one).
        slope: further pull s per metre of commanded shortening, N/m; one number, or one per cable.

    Returns:
        The term, for `with_terms`.

    Raises:
        InputError: a negative pull or slope, or a wrong number of them.

    Example:
        >>> scene = jaxgrity.load_scene("reference")
        >>> driven = jaxgrity.with_terms(scene, jaxgrity.model.commanded_pull(scene.structure.cables, 5.0, 40.0))
    """
    count = len(cables_of(cables.clusters, len(cables.edges)))
    return CommandedPull(per_member(pull, count, "pull"), per_member(slope, count, "pull_slope"))


def reeled_cables(scene: Scene) -> AnyArray | None:
    """(cables,), whether a motor reels each cable: it has a commanded pull and no spring; None without such a law."""
    cables, laws = scene.structure.cables, [term for term in scene.terms if isinstance(term, CommandedPull)]
    if cables is None or not laws:
        return None
    pulls = [to_segments(law.pull + law.slope, cables.clusters, len(cables.edges)) for law in laws]
    return (sum(pulls[1:], pulls[0]) > 0) & (cables.stiffness == 0)


def forced_cables(scene: Scene) -> np.ndarray:
    """(cables, 2): pull P, N, and slope s, N/m, of each cable (segments of one cable count as one); 0 without a law."""
    cables = scene.structure.cables
    count = 0 if cables is None else len(cables_of(cables.clusters, len(cables.edges)))
    found = np.zeros((count, 2))
    for term in scene.terms:
        if isinstance(term, CommandedPull):
            found = found + np.stack([np.asarray(term.pull), np.asarray(term.slope)], axis=1)
    return found
