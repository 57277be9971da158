"""Cross-sections of least mass that bear given loads: the plastic design of trusses, as a linear programme."""

import dataclasses
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float
from scipy.optimize import linprog

from jaxgrity.core.arguments import check_number
from jaxgrity.core.errors import InputError
from jaxgrity.core.tracing import refuse_traced
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, PerMember
from jaxgrity.model.body_points import lumped
from jaxgrity.model.energy import UP
from jaxgrity.model.scene import Scene
from jaxgrity.model.sizes import Material, material_of, sized_members
from jaxgrity.model.slides import check_no_slides
from jaxgrity.model.structure import Structure, edge_lengths
from jaxgrity.statics.form_finding import equilibrium_matrix
from jaxgrity.statics.stiffness import all_edges, free_motions, incidence

ROUNDS = 200
"""Most linear programmes."""
CONVERGED = 1e-10
"""Relative change of the mass between two rounds that ends them."""
SMALL = 1e-8
"""Smallest compression for which buckling is linearised, as a share of the largest load."""


class LeastMass(NamedTuple):
    """The result of `least_mass`."""

    scene: Scene
    materials: tuple[Material, Material]
    """of struts and of cables"""
    hollow: float
    """inner over outer diameter of struts"""
    area: PerMember
    """m^2, struts first; 0 where a member is not needed"""
    mass: float
    """kg, of all members"""
    forces: Float[AnyArray, "cases members"]
    """N, tension positive, in each load case"""
    rounds: int
    """number of linear programmes solved"""

    def structure(self, case: int = 0) -> Structure:
        """The structure with these sizes and without members of no area.

        Rest lengths L = l EA/(EA + N) are those at which the given shape is at rest under that load case. Raises
        `InputError` where a node is left without mass.
        """
        given = self.scene.structure
        found: dict[str, Any] = {}
        for kind, material, start in zip(("struts", "cables"), self.materials, (0, given.first_cable)):
            members = getattr(given, kind)
            if members is None:
                continue
            chosen = np.flatnonzero(self.area[start : start + len(members.edges)])
            A, N = self.area[start + chosen], self.forces[case, start + chosen]
            edges = tuple(members.edges[k] for k in chosen)
            EA = material.youngs_modulus * A
            outer = np.sqrt(4 * A / (np.pi * (1 - self.hollow**2)))
            section = {"diameter": outer, "wall": outer * (1 - self.hollow) / 2} if kind == "struts" else {"area": A}
            length = edge_lengths(given.nodes, edges)
            found[kind] = sized_members(edges, length * EA / (EA + N), material, **section) if edges else None
        return dataclasses.replace(given, **found)


@typed
def least_mass(
    scene: Scene,
    struts: Material | str,
    cables: Material | str,
    *,
    least_tension: float = 0.0,
    hollow: float = 0.0,
    buckling: bool = True,
) -> LeastMass:
    """The sizes with which a structure in its given shape bears each of its load cases with the least mass.

    Unknown are forces N that balance the loads in each case, and members' masses m: minimise sum m with
    m >= density l |N|/yield stress, and for struts in compression m >= density l^2 (|N|/(E k))^(1/2)/pi, Euler's load
    with I = k A^2. Without buckling this is a linear programme (Dorn, Gomory and Greenberg 1964; HiGHS). Buckling makes
    it concave. As in Nagase and Skelton 2014 (Minimal mass design of tensegrity structures) it is linearised about the
    last solution, and solved again until the mass stays. Each round lowers the mass; the end is a local minimum.
    Gravity acts on members' and nodes' masses where there are supports.

    This is plastic design: forces only have to balance. Where a structure is statically indeterminate, each load case
    may have its own self-stress, so several cases may need rest lengths that change. Stiffness and stability are left
    out; `load_report` tells them of the result. Rigid bodies bear any forces, and keep their masses.

    Args:
        scene: nodes, members, supports and load cases. Members may be many more than needed (a ground structure);
            their stiffness and mass do not count, nor do further terms of the scene.
        struts: material, with one number each.
        cables: likewise.
        least_tension: tension that every cable has in every case, N: prestress.
        hollow: inner over outer diameter of the struts' sections; 0: solid bars.
        buckling: whether struts are safe against Euler's load.

    Returns:
        Areas, mass and forces.

    Raises:
        InputError: no load cases, materials without density or yield stress, or loads that no forces balance.

    Example:
        >>> pole = jaxgrity.parse_scene('''
        ...     structure = { kind = "custom", nodes = [[0, 0, 0], [0, 0, 2]], struts = [[0, 1]], fixed = [0] }
        ...     struts = { material = "steel", area = 1e-4 }
        ...     loads = [{ name = "down", nodes = [1], force = [0, 0, -1000] }]''')
        >>> f"{jaxgrity.statics.least_mass(pole, 'steel', 'steel').mass:.2f} kg"
        '2.44 kg'
    """
    _check(scene, least_tension, hollow)
    materials = _complete("struts", struts), _complete("cables", cables)
    programme = _Programme(scene, materials, least_tension, hollow)
    rounds, last = 1, np.inf
    forces = programme.solve(None if not buckling else np.full(programme.forces_shape, programme.size))
    area = programme.area(forces, buckling)
    while buckling and rounds < ROUNDS and programme.mass(area) < last * (1 - CONVERGED):
        last, rounds = programme.mass(area), rounds + 1
        # the area against buckling is concave in the compression, so tangents ask for more: each round is safe, and no
        # heavier than the one before
        forces = programme.solve(np.maximum(-forces, SMALL * programme.size))
        area = programme.area(forces, buckling)
    return LeastMass(scene, materials, hollow, area, programme.mass(area), forces, rounds)


def _check(scene: Scene, least_tension: float, hollow: float) -> None:
    refuse_traced(scene, "least_mass", "its programme is solved outside of JAX")
    check_no_slides(scene, "least_mass")
    check_number("least_tension", least_tension, least=0.0, unit="N")
    if not check_number("hollow", hollow, least=0.0) < 1:
        raise InputError(f"hollow = {hollow:g}: expected a number from 0, below 1")
    if not any(np.any(case.force) for case in scene.loads):
        raise InputError("the scene has no loads; expected load cases ([[loads]] in a scene file)")
    if scene.structure.cables is not None and scene.structure.cables.clusters:
        raise InputError("least_mass: knows no cables through several nodes; expected a cable for each segment")


def _complete(name: str, given: Material | str) -> Material:
    material = material_of(given)
    for key, value in material._asdict().items():
        if value is None:
            raise InputError(f"{name}.{key}: missing; expected Young's modulus, density and yield stress")
        check_number(f"{name}.{key}", value, above=0.0)
    return material


class _Programme:
    """The linear programme: forces in tension and in compression in each case, and masses."""

    def __init__(self, scene: Scene, materials: tuple[Material, Material], least_tension: float, hollow: float):
        structure = scene.structure
        edges, nodes = all_edges(structure), np.asarray(structure.nodes, float)
        first, count = structure.first_cable, len(edges)
        # of a rigid body six sums of forces and moments count, of any other node each force
        balanced = free_motions(nodes, structure.supported, structure.bodies).T
        self.length = edge_lengths(nodes, edges)
        each = [np.where(np.arange(count) < first, *pair) for pair in zip(*materials)]
        self.E, self.density, self.stress = each
        shape = (1 + hollow**2) / (4 * np.pi * (1 - hollow**2))
        self.struts, self.slenderness = np.arange(count) < first, self.length / (np.pi * np.sqrt(self.E * shape))
        gravity = float(scene.gravity or 0.0) if structure.fixed else 0.0
        down = -gravity * np.asarray(UP if scene.up is None else scene.up, float)
        own = np.outer(structure.node_mass + np.asarray(lumped(structure.bodies, len(nodes))), down)
        self.pull = [balanced @ (case.on_nodes(len(nodes)) + own).ravel() for case in scene.loads]
        self.size = float(max(np.abs(pull).max(initial=0) for pull in self.pull))
        if not self.size:
            raise InputError("the loads act on supports alone; expected loads on coordinates that may move")
        self.balance = sp.csc_array(balanced @ equilibrium_matrix(nodes, edges) @ sp.diags_array(1 / self.length))
        halves = sp.csc_array(sp.kron(abs(incidence(edges, len(nodes))).T / 2, down[:, None]))
        self.weight = sp.csc_array(balanced @ halves)
        self.least = np.where(self.struts, 0.0, least_tension)
        self.forces_shape = (len(scene.loads), count)

    def area(self, forces: np.ndarray, buckling: bool) -> np.ndarray:
        """m^2, what each member needs for its largest force."""
        needed = np.abs(forces) / self.stress
        if buckling:
            needed = np.maximum(needed, self.slenderness * np.sqrt(np.maximum(-forces, 0)))
        largest = needed.max(0)
        return np.where(largest > SMALL * self.size / self.stress, largest, 0.0)

    def mass(self, area: np.ndarray) -> float:
        """kg."""
        return float(np.sum(self.density * area * self.length))

    def solve(self, about: np.ndarray | None) -> np.ndarray:
        """Forces (cases, members), N, of the programme with buckling linearised about compressions (cases, members), N.

        Its unknowns are tensions and compressions over `size` of each case, then masses over `unit`.
        """
        cases, count = self.forces_shape
        unit = float((self.density * self.length / self.stress).max()) * self.size
        each, none = sp.eye_array(count, format="csc"), sp.csc_array((count, count))
        per_newton = self.density * self.length / self.stress * self.size / unit
        blocks, right = [], []
        for case in range(cases):
            before, after = [none] * 2 * case, [none] * 2 * (cases - case - 1)
            blocks.append([*before, sp.diags_array(per_newton), sp.diags_array(per_newton), *after, -each])
            right.append(np.zeros(count))
            if about is not None:
                half = self.density * self.length * self.slenderness * np.sqrt(about[case]) / 2 / unit
                half = np.where(self.struts, half, 0.0)
                blocks.append([*before, none, sp.diags_array(half * self.size / about[case]), *after, -each])
                right.append(-half)
        balance = [sp.block_diag([sp.hstack([self.balance, -self.balance])] * cases)]
        weights = sp.vstack([self.weight] * cases) * (unit / self.size)
        compression = np.where(self.struts, np.inf, 0.0)
        lower = np.r_[np.tile(np.r_[self.least / self.size, np.zeros(count)], cases), np.zeros(count)]
        upper = np.r_[np.tile(np.r_[np.full(count, np.inf), compression], cases), np.full(count, np.inf)]
        found = linprog(
            np.r_[np.zeros(2 * cases * count), np.ones(count)],
            A_ub=sp.block_array(blocks, format="csc"),
            b_ub=np.concatenate(right),
            A_eq=sp.hstack([*balance, -weights], format="csc"),
            b_eq=np.concatenate(self.pull) / self.size,
            bounds=np.stack([lower, upper], axis=1),
        )
        if not found.success:
            why = found.message.split(".")[0]
            raise InputError(f"no forces balance the loads in the given shape: {why}; expected no loaded mechanism")
        both = found.x[: 2 * cases * count].reshape(cases, 2, count) * self.size
        return both[:, 0] - both[:, 1]
