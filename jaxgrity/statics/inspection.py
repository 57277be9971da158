"""A structure's statics in one report: stress, mechanisms, stability, forces, margins to slack and buckling."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.display import in_digits
from jaxgrity.core.errors import InputError
from jaxgrity.core.tracing import evaluated, refuse_traced
from jaxgrity.core.typed import typed
from jaxgrity.core.types import Edges, NodeVectors, PerMember, PerRow
from jaxgrity.model.laws import EnergyTerm
from jaxgrity.model.scales import length_scale
from jaxgrity.model.scene import Scene, with_gait
from jaxgrity.model.slides import check_no_slides
from jaxgrity.model.springs import STIFF, as_springs, spring_forces, stiffness_beside
from jaxgrity.model.structure import Structure, edge_lengths
from jaxgrity.statics.equilibrium import resting_shape
from jaxgrity.statics.form_finding import Statics, prestress_stable, statics_of, super_stable
from jaxgrity.statics.spring_struts import with_spring_struts
from jaxgrity.statics.stiffness import all_edges
from jaxgrity.statics.strength import force_words, strength_of
from jaxgrity.statics.vibrations import vibration_modes

LARGEST = 1500
"""Most members for which self-stress and mechanisms are counted: that takes a dense matrix of their number."""
ZERO_SINGULAR = 1e-6
"""Singular values of A below this share of the largest count as zero, since shapes at rest are not exact."""
NOTHING = 1e-6
"""A member carries nothing below this share of the force that stretches the softest member to twice its length."""
NEAR = 1e-4
"""Distance from the shape, as a share of the robot's length, within which a law that does not act does no harm."""
OTHER_SHAPE = 0.05
"""Share of the structure's size by which nodes have to move for the shape at rest to be another than the given one."""
SHOWN = 5
"""Number of frequencies that the report names."""


class StructureReport(NamedTuple):
    """The result of `inspect_structure`."""

    structure: Structure
    shape: NodeVectors
    """m, the equilibrium that forces and frequencies belong to, or the given shape where none was found"""
    at_rest: bool
    """whether `shape` is an equilibrium"""
    stable: bool
    """whether it is a minimum of the potential energy"""
    moved: float
    """m, the largest distance of a node from where it was given, rigid motions and all"""
    forces: PerMember
    """N, tension positive, struts first"""
    statics: Statics | None
    """self-stress and mechanisms at `shape`; None where the structure is too large to count them, or a cable runs
    through several nodes"""
    prestress_stable: bool | None
    """whether the forces are a self-stress that stiffens every mechanism; None where they balance loads too, or there
    are neither forces nor mechanisms"""
    super_stable: bool | None
    """likewise: whether it is stable for any stiffness; None where there are rigid bodies"""
    frequencies: PerRow
    """Hz, the lowest, of vibrations about `shape`"""
    loose: int
    """number of motions without any resistance, besides rigid motions"""

    @property
    def slack(self) -> tuple[int, ...]:
        """Cables, from 0, without tension."""
        cables = self.structure.cables
        forces = self.forces[self.structure.first_cable :]
        return () if cables is None else tuple(np.flatnonzero(forces <= 0).tolist())

    @property
    def margins(self) -> PerMember:
        """Strength of each member, its yield force or Euler's load, over its force; infinite without either."""
        return strength_of(self.structure, self.shape).margins(self.forces)

    def table(self) -> str:
        """The report in words, a line for each fact."""
        lines = [(name, text) for name, text in self._lines() if text]
        return "\n".join(f"{name:<20} {text}" for name, text in lines)

    def summary(self) -> dict[str, Any]:
        """The same as numbers, for JSON."""
        counted, margin = self.statics, self.margins.min(initial=np.inf)
        return {
            "nodes": len(self.shape),
            "members": len(self.forces),
            "rank": counted.rank if counted else None,
            "states_of_self_stress": counted.self_stress.shape[1] if counted else None,
            "mechanisms": len(counted.mechanisms) if counted else None,
            "rigid_motions": counted.rigid if counted else None,
            "at_rest": self.at_rest,
            "stable": self.stable,
            "prestress_stable": self.prestress_stable,
            "super_stable": self.super_stable,
            "moved": self.moved,
            "shape": self.shape,
            "forces": self.forces,
            "slack_cables": list(self.slack),
            "smallest_margin": float(margin) if np.isfinite(margin) else None,
            "loose": self.loose,
            "frequencies": self.frequencies,
        }

    def _verdict(self, mechanisms: int) -> str:
        """Whether the structure keeps its shape by itself, without ground, in words."""
        if not self.at_rest:
            return "no: it finds no rest near the given shape"
        if self.loose:
            return "no: it can move, at least a little, without resistance"
        if not self.stable:
            return "no: a small push makes it leave this shape"
        if self.margins.min(initial=np.inf) < 1:
            return "no: a member yields or buckles"
        if self.moved > OTHER_SHAPE * float(np.ptp(self.shape, axis=0).max()):
            return "yes, but not the given shape"
        return "yes, by its prestress" if mechanisms and self.prestress_stable else "yes"

    def _lines(self) -> list[tuple[str, str]]:
        counted = self.statics
        states, loose = (counted.self_stress.shape[1], len(counted.mechanisms)) if counted else (0, 0)
        some = "mechanism" if loose == 1 else "mechanisms"
        static = f"rank {counted.rank}, {states} of self-stress, {loose} {some}" if counted else "not counted"
        given = f"nodes move by up to {self.moved:.3g} m from the given shape"
        where = f"{'stable' if self.stable else 'unstable'}; {given}"
        if not self.at_rest:
            where = "none found near the given shape"
        elif self.loose:
            where = f"neutral: {self.loose} ways to move meet no resistance; {given}"
            if not np.any(self.forces):
                where += "; no member carries force: give [cables] prestrain, or [structure] prestress"
        margin = self.margins.min(initial=np.inf)
        words = {True: "yes", False: "no", None: ""}
        lowest = ", ".join(in_digits(f, 4) for f in self.frequencies[:SHOWN])
        return [
            ("keeps its shape", self._verdict(loose)),
            ("states", static),
            ("equilibrium", where),
            ("forces", force_words(self.structure, self.forces)),
            ("slack cables", ", ".join(map(str, self.slack)) or "none"),
            ("smallest margin", in_digits(margin, 4) if np.isfinite(margin) else ""),
            ("prestress stable", words[self.prestress_stable]),
            ("super-stable", words[self.super_stable]),
            ("lowest frequencies", f"{lowest} Hz" if lowest else ""),
        ]


@typed
def inspect_structure(scene: Scene) -> StructureReport:
    """Settle a structure and report on its statics: self-stress, mechanisms, forces, stability, frequencies.

    The report is of the structure itself: without ground, and without gravity unless there are supports. A rigid strut
    is a very stiff spring here. A rigid body is one unit: its six equations of equilibrium count, and its motions.

    Args:
        scene: the structure, with the scene's gravity where it has supports.

    Returns:
        The report: `table()` in words, `summary()` in numbers.

    Raises:
        InputError: the structure has no members, or a potential beside their springs acts in this shape, such as a
            largest force that is reached.

    Example:
        >>> report = jaxgrity.statics.inspect_structure(jaxgrity.load_scene("reference"))
        >>> report.summary()["rank"], report.summary()["states_of_self_stress"], report.summary()["mechanisms"]
        (29, 1, 1)
    """
    structure, loaded = scene.structure, bool(scene.structure.fixed)
    if structure.member_count == 0:
        raise InputError("the structure has no members; expected [struts] or [cables] in a scene file, or both")
    check_no_slides(scene, "inspect_structure")
    given = np.asarray(structure.nodes, float)
    alone = Scene(structure, gravity=scene.gravity if loaded else None, up=scene.up)
    try:
        rest = resting_shape(alone)
        shape, stable, at_rest = np.asarray(rest.q), rest.stable, True
    except InputError:
        shape, stable, at_rest = given, False, False
    _check_linear(scene, shape)
    edges = all_edges(structure)
    springs = with_spring_struts(alone).structure
    forces = _that_count(structure, springs, _forces(structure, springs, shape))
    slides = structure.cables is not None and structure.cables.clusters
    countable = not slides and len(edges) <= LARGEST
    counted = statics_of(shape, edges, structure.supported, ZERO_SINGULAR, structure.bodies) if countable else None
    edges, density = _densities(structure, springs, shape, forces)
    stressed = counted if counted and at_rest and not loaded and (forces.any() or len(counted.mechanisms)) else None
    modes = vibration_modes(alone, shape)
    return StructureReport(
        structure=structure,
        shape=shape,
        at_rest=at_rest,
        stable=stable,
        moved=float(np.linalg.norm(shape - given, axis=1).max()),
        forces=forces,
        statics=counted,
        prestress_stable=prestress_stable(stressed.mechanisms, edges, density) if stressed else None,
        super_stable=super_stable(shape, edges, density) if stressed and not structure.bodies else None,
        frequencies=np.asarray(modes.frequency),
        loose=modes.zero,
    )


def _check_linear(scene: Scene, shape: NodeVectors) -> None:
    """Refuse potentials beside the springs that act in the shape, or near it."""
    q, size = np.asarray(shape, float), float(length_scale(scene))
    near = q + NEAR * size * np.random.default_rng(0).standard_normal(q.shape)
    still = with_gait(scene, None)
    for term in scene.terms:
        if not isinstance(term, EnergyTerm):
            continue
        with evaluated():
            force = jax.grad(lambda q, term=term: term.energy(still.configuration(q, 0.0)))
            acts = any(np.any(np.asarray(force(jnp.asarray(x)))) for x in (q, near))
        if acts:
            raise InputError(
                f"{term.name}: the report on a structure knows linear springs alone; expected a scene without, or "
                "`resting_shape` and `vibration_modes`, which know all of U; `jaxgrity simulate` shows how it settles"
            )


def _densities(
    structure: Structure, springs: Structure, shape: NodeVectors, forces: PerMember
) -> tuple[Edges, PerMember]:
    """The members and their force densities, N/m, and after them the pairs of nodes that keep rigid bodies in shape."""
    struts, first = springs.struts if structure.bodies else None, structure.first_cable
    held = () if struts is None else struts.edges[first:]
    edges = (*all_edges(structure), *held)
    inside = np.zeros(0) if struts is None else spring_forces(struts, shape)[first:]
    return edges, np.r_[forces, inside] / edge_lengths(shape, edges)


def _that_count(structure: Structure, springs: Structure, forces: PerMember) -> PerMember:
    """The forces; those below `NOTHING`, which are rounding, are 0. Beside real springs, rigid members do not count."""
    own, share = (structure, 1.0) if stiffness_beside(structure) else (springs, 1 / STIFF)
    kinds = [m for m in own.members if m.stiffness is not None]
    stretch = share * np.concatenate([(np.asarray(m.stiffness, float) * m.rest_length).ravel() for m in kinds])
    softest = stretch[stretch > 0].min(initial=np.inf)
    return np.where(np.abs(forces) > NOTHING * softest, forces, 0.0) if np.isfinite(softest) else forces


@typed
def member_forces(structure: Structure, q: NodeVectors) -> PerMember:
    """K (l - L) of each member at `q` and t = 0, N, tension positive, struts first; a slack cable has none.

    L has what motors wound before t = 0. Rigid struts count as very stiff springs: their compression in a shape at rest
    tells their force. All segments of a cable that runs through several nodes have its tension. Raises `InputError`
    where rigid struts have no springs beside them: `inspect_structure` and `load_report` know what loads them.
    """
    refuse_traced((structure, q), "member_forces", "take `jax.grad` of the scene's potential_energy")
    springs, stiff = as_springs(structure)
    if stiff and structure.member_count and not stiffness_beside(structure):
        raise InputError("member_forces: no spring loads the rigid struts; expected `inspect_structure` of the scene")
    return _forces(structure, springs, q)


def _forces(structure: Structure, springs: Structure, q: NodeVectors) -> PerMember:
    """The same, with `springs` in place of what is rigid."""
    # after the struts come springs that stand for rigid bodies
    found = [spring_forces(springs.struts, q)[: structure.first_cable]] if springs.struts is not None else []
    found += [np.maximum(spring_forces(springs.cables, q), 0)] if springs.cables is not None else []
    return np.concatenate(found)
