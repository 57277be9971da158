"""A scene in words: what is modelled and what is not, with the prestress and the natural frequencies that it has."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.types import AnyArray, NodeVectors, Scalar
from jaxgrity.model.actuation import Gait
from jaxgrity.model.energy import CableSprings, StrutSprings
from jaxgrity.model.inertia import mass_matrix
from jaxgrity.model.laws import Configuration, EnergyTerm, Law, SceneParts
from jaxgrity.model.modal import equilibrium, natural_frequencies
from jaxgrity.model.springs import as_springs, largest_force, spring_forces
from jaxgrity.model.structure import Members, Structure, edge_lengths, member_vectors


class SpringEnergy(eqx.Module):
    """U of the members' springs alone, J, as a function of the nodes' places."""

    springs: Structure

    def __call__(self, q: NodeVectors) -> Scalar:
        springs, at = self.springs, Configuration(q, 0.0, member_vectors(q, self.springs.kinds), None)
        terms: list[EnergyTerm] = []
        terms += [CableSprings(springs.cables, None, springs.first_cable)] if springs.cables is not None else []
        terms += [StrutSprings(springs.struts, None)] if springs.struts is not None else []
        return sum((term.energy(at) for term in terms), jnp.zeros(()))


def describe(scene: SceneParts, laws: Sequence[Law], known: Sequence[str]) -> str:
    """`Scene.describe`, of a scene in which the `laws` act; of the `known` ones, those that do not are named too."""
    modelled = list(dict.fromkeys(law.name for law in laws))
    absent = [name for name in known if name not in modelled]
    (absent if scene.gait is None else modelled).append("gait")
    lines = [
        ("modelled", ", ".join(modelled) or "-"),
        ("not modelled", ", ".join(absent) or "-"),
        ("nodes", f"{len(scene.structure.nodes)}, {float(scene.structure.mass):.4g} kg in all"),
        *_describe_ground(scene),
        *_describe_supports(scene),
        *_describe_members(scene.structure),
        *_describe_prestress(scene.structure),
        *_describe_gait(scene.gait),
    ]
    return "\n".join(f"{name:<20} {text}" for name, text in lines)


def _span(values: AnyArray, unit: str) -> str:
    low, high = float(np.min(values)), float(np.max(values))
    text = f"{low:.4g}" if np.isclose(low, high) else f"{low:.4g} to {high:.4g}"
    return f"{text} {unit}" if unit else text


def _describe_ground(scene: SceneParts) -> list[tuple[str, str]]:
    if scene.ground is None:
        return []
    if scene.ground.surface is not None:
        return [("ground", ", ".join(type(solid).__name__.lower() for solid in scene.ground.surface.solids))]
    incline = np.degrees(scene.ground.incline)
    return [("ground", f"plane that falls by {incline:.4g}° towards +x" if incline else "level plane")]


def _describe_supports(scene: SceneParts) -> list[tuple[str, str]]:
    fixed = [f"node {node}" + ("" if len(axes) == 3 else f" along {axes}") for node, axes in scene.structure.fixed]
    shaking = "; shaking" if scene.shaking is not None else ""
    return [("fixed", ", ".join(fixed) + shaking)] if fixed else []


def _describe_members(structure: Structure) -> list[tuple[str, str]]:
    lines = []
    for name, members in (("struts", structure.struts), ("cables", structure.cables)):
        if members is None:
            continue
        parts = [
            f"{len(members.edges)}",
            f"length {_span(edge_lengths(structure.nodes, members.edges), 'm')}",
            f"rest length {_span(members.rest_length, 'm')}",
            "rigid" if members.stiffness is None else f"stiffness {_span(members.stiffness, 'N/m')}",
        ]
        if members.damping is not None:
            parts.append(f"damping {_span(members.damping, 'N s/m')}")
        if members.mass is not None:
            parts.append(f"mass {_span(members.mass, 'kg')}")
        broken = [] if members.stiffness is None else np.flatnonzero(np.asarray(members.stiffness) == 0).tolist()
        motors = [motor.member for motor in members.motors]
        clusters = [list(cluster) for cluster in members.clusters]
        which = {"broken": broken, "stuck": members.stuck, "as one cable each": clusters, "with a motor": motors}
        parts += [f"{words} {list(numbers)}" for words, numbers in which.items() if numbers]
        lines.append((name, ", ".join(parts)))
    return lines


def _describe_prestress(structure: Structure) -> list[tuple[str, str]]:
    if structure.member_count == 0:
        return []
    springs, stiff_modes = as_springs(structure)
    energy = SpringEnergy(springs)
    kinds = [(name, m) for name, m in (("struts", springs.struts), ("cables", springs.cables)) if m is not None]
    tolerance = max(1e-10 * largest_force(structure), 100 * np.finfo(float).eps * largest_force(springs))
    found = equilibrium(energy, structure.nodes, tolerance, free=structure.free)
    where = "" if found is not None else " (in the given shape: no equilibrium found)"
    shape = np.asarray(structure.nodes) if found is None else found
    forces = ", ".join(f"{name} {_span(_tension(m, shape, name == 'cables'), 'N')}" for name, m in kinds)
    lines = [("prestress", f"{forces} (tension positive){where}")]
    with jax.enable_x64(True):
        mass = mass_matrix(structure) if structure.rod_masses else structure.node_mass
    frequencies = natural_frequencies(energy, mass, shape, stiff_modes, structure.free)
    floppy, stiff = int(np.sum(frequencies == 0)), frequencies[frequencies > 0]
    texts = [f"{floppy} of 0 Hz (nothing resists the motion)"] if floppy else []
    texts += [_span(stiff, "Hz")] if stiff.size else []
    return lines + ([("natural frequencies", ", ".join(texts) + where)] if texts else [])


def _tension(members: Members, shape: np.ndarray, only_pull: bool) -> np.ndarray:
    force = spring_forces(members, shape)
    return np.maximum(force, 0) if only_pull else force


def _describe_gait(gait: Gait | None) -> list[tuple[str, str]]:
    if gait is None:
        return []
    text = (
        f"{len(gait.members)} members, amplitude {_span(gait.amplitude, '')}, frequency {_span(gait.frequency, 'Hz')}, "
        f"from {float(gait.start):g} s, full after {float(gait.ramp):g} s more"
    )
    return [("gait", text)]
