"""Rigid struts, bodies and slides as stiff springs, whose forces and Hessians are computed as those of members."""

import dataclasses
from typing import ClassVar

import jax
import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from jaxgrity.core.errors import InputError
from jaxgrity.core.types import NodeVectors, Scalar
from jaxgrity.model.actuation import rest_length
from jaxgrity.model.ground import PenaltyGround
from jaxgrity.model.laws import Configuration, EnergyTerm
from jaxgrity.model.rigidity import linked
from jaxgrity.model.scene import Scene
from jaxgrity.model.slides import Slides
from jaxgrity.model.springs import STIFF, as_springs, stiffness_beside
from jaxgrity.model.structure import Structure, edge_lengths
from jaxgrity.statics.form_finding import equilibrium_matrix
from jaxgrity.statics.slide_springs import SlideSprings, across_lines, apart, springs_for
from jaxgrity.statics.stiffness import all_edges, coordinate_map, tangent_of

REDUNDANT = 1e-12
"""Weight of the squares of rigid members' forces beside those of the forces left at nodes, as a share of the largest:
it decides where forces are not unique."""
CORRECTIONS = 3
"""Number of solutions that take back what this weight costs."""


class _AsBuilt(EnergyTerm):
    """A term of U that sees the scene as it is built, without the springs that stand for bodies."""

    term: EnergyTerm
    built: Scene
    name: ClassVar[str] = "term of the scene as built"

    def energy(self, at: Configuration) -> Scalar:
        numbered = self.built.structure.numbered
        own = {kind: at.known[kind][: len(members.edges)] for kind, members, _ in numbered if kind in at.known}
        return self.term.energy(Configuration(at.q, at.t, own, self.built))


GIVES = 0.01
"""Share of its size by which a structure without springs would give way under all its forces, as if it had some: rigid
struts are far stiffer than that."""


def with_spring_struts(scene: Scene, loads: np.ndarray | None = None, times: float = STIFF) -> Scene:
    """The scene with stiff springs for rigid struts (`as_springs`) and slides. Raises `InputError` on exact contact.

    They are `times` as stiff as what is beside them (`stiffness_around`).
    """
    if scene.ground is not None and scene.ground.impulsive:
        raise InputError("statics needs forces, and exact contact has none; expected penalty contact, or no ground")
    if not linked(scene):
        return scene
    stiff = times * (stiffness_around(scene, loads) or 1.0)
    structure, first = as_springs(scene.structure, stiff)[0], scene.structure.first_cable
    more = structure.first_cable - first
    gait, terms = scene.gait, scene.terms
    if more:  # of bodies: cables have other numbers then, and the user's terms know none of these springs
        terms = tuple(
            _AsBuilt(term, scene) if isinstance(term, EnergyTerm) and not isinstance(term, SlideSprings) else term
            for term in terms
        )
    terms = tuple(springs_for(term, stiff) if isinstance(term, Slides) else term for term in terms)
    if more and gait is not None:
        moved = tuple(k if k < first else k + more for k in gait.members)
        gait = dataclasses.replace(gait, members=moved, robot=None)
    return dataclasses.replace(scene, structure=structure, gait=gait, terms=terms)


def stiffness_around(scene: Scene, loads: np.ndarray | None = None) -> float:
    """N/m, of what acts on rigid struts and bodies: the stiffest cable, without cables the stiffest strut.

    Without springs it is that of the ground and of further terms of U, and all forces over `GIVES` times the
    structure's size: its weight and load cases, or the given `loads`, N, where it has none. 0 where nothing acts.
    """
    structure, x = scene.structure, np.asarray(scene.structure.nodes, float)
    if beside := stiffness_beside(structure):
        return beside
    size = float(np.linalg.norm(np.ptp(x, axis=0)))
    cases = [np.asarray(case.force, float) for case in scene.loads] or ([] if loads is None else [loads])
    force = float(structure.mass) * float(scene.gravity or 0.0) + sum(float(np.abs(each).sum()) for each in cases)
    found = float(scene.ground.stiffness) if isinstance(scene.ground, PenaltyGround) else 0.0
    if any(isinstance(term, EnergyTerm) for term in scene.terms):
        here = tangent_of(scene)(x)
        found = max(found, float(np.abs(here.stiffness().diagonal()).max(initial=0)))
        force += float(np.abs(here.gradient).sum())
    return found + (force / (GIVES * size) if size else 0.0)


def bearing(scene: Scene, q: NodeVectors, loads: np.ndarray | None = None) -> Scene:
    """`with_spring_struts`, whose springs bear at `q` what all other forces leave to what is rigid.

    So the shape of a scene at rest is one of these springs too, without being compressed. Their forces are part of the
    tangent stiffness: by them bodies swing, and struts buckle.
    """
    springs, count = with_spring_struts(scene, loads), as_springs(scene.structure)[1]
    if not linked(scene):
        return springs
    x, held = np.asarray(q, float), apart(springs)[1]
    whole, free = coordinate_map(scene.structure)
    place, columns, across = whole[:, free], [], np.zeros((0, 3))
    if count:
        columns.append(equilibrium_matrix(x, all_edges(springs.structure)[: springs.structure.first_cable][-count:]))
    if held is not None:
        slopes, across = across_lines(held.slides, x)
        columns.append(slopes)
    pull = sp.csc_array(place.T @ sp.hstack(columns))  # of force densities
    left = -place.T @ tangent_of(springs)(x).gradient.ravel()
    density = _least_squares(pull, left)
    if count:
        springs = dataclasses.replace(springs, structure=_pulling(springs, x, density[:count]))
    if held is None:
        return springs
    each = density[count:, None] * across / float(held.stiffness)
    pulling = dataclasses.replace(held, offset=held.offset + each.reshape(-1, 2, 3).sum(1))
    return dataclasses.replace(springs, terms=tuple(pulling if term is held else term for term in springs.terms))


def _least_squares(pull: sp.csc_array, left: np.ndarray) -> np.ndarray:
    """The force densities, N/m, that leave least of the forces `left`, N; the smallest where they are not unique."""
    squares = sp.csc_array(pull.T @ pull)
    weight = REDUNDANT * float(squares.diagonal().max(initial=0)) or 1.0
    solve = spla.splu(sp.csc_matrix(squares + weight * sp.eye_array(squares.shape[0], format="csc"))).solve
    density = np.zeros(squares.shape[0])
    for _ in range(CORRECTIONS):
        density = density + solve(pull.T @ (left - pull @ density))
    return density


def _pulling(springs: Scene, x: np.ndarray, density: np.ndarray) -> Structure:
    """Its structure, whose last struts pull by these force densities more at `x`."""
    struts, count = springs.structure.struts, len(density)
    assert struts is not None, "the last of them are these springs"
    with jax.enable_x64(True):
        rest = np.array(rest_length(struts, springs.gait, 0.0, 0), float)
    longer = density * edge_lengths(x, struts.edges[-count:]) / np.asarray(struts.stiffness, float)[-count:]
    rest[-count:] -= longer
    # without a gait nothing moves them: so they share the compiled programs of `springs`
    stuck = struts.stuck if springs.gait is None else tuple(range(len(rest)))
    still = dataclasses.replace(struts, rest_length=rest, motors=(), stuck=stuck)
    return dataclasses.replace(springs.structure, struts=still)
