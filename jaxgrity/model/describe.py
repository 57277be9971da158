"""A scene in words: what is modelled and what is not, with the prestress and the natural frequencies that it has."""

from collections.abc import Sequence

import numpy as np

from jaxgrity.core.types import AnyArray
from jaxgrity.model.actuation import Gait
from jaxgrity.model.energy import CableSprings, StrutSprings
from jaxgrity.model.laws import Configuration, EnergyTerm, Law, SceneParts
from jaxgrity.model.modal import equilibrium, natural_frequencies
from jaxgrity.model.structure import Members, Structure, edge_lengths, member_vectors

STIFF = 1e5
"""how many times stiffer than cables the springs are that stand for rigid struts"""


def describe(scene: SceneParts, laws: Sequence[Law], known: Sequence[str]) -> str:
    """`Scene.describe`, of a scene in which the `laws` act; of the `known` ones, those that do not are named too."""
    modelled = list(dict.fromkeys(law.name for law in laws))
    absent = [name for name in known if name not in modelled]
    (absent if scene.gait is None else modelled).append("gait")
    lines = [
        ("modelled", ", ".join(modelled) or "-"),
        ("not modelled", ", ".join(absent) or "-"),
        ("nodes", f"{len(scene.structure.nodes)}, {float(scene.structure.mass):.4g} kg in all"),
        *_describe_members(scene.structure),
        *_describe_prestress(scene.structure),
        *_describe_gait(scene.gait),
    ]
    return "\n".join(f"{name:<20} {text}" for name, text in lines)


def _span(values: AnyArray, unit: str) -> str:
    low, high = float(np.min(values)), float(np.max(values))
    text = f"{low:.4g}" if np.isclose(low, high) else f"{low:.4g} to {high:.4g}"
    return f"{text} {unit}" if unit else text


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
        broken = [] if members.stiffness is None else np.flatnonzero(np.asarray(members.stiffness) == 0).tolist()
        parts += [f"{word} {list(which)}" for word, which in (("broken", broken), ("stuck", members.stuck)) if which]
        lines.append((name, ", ".join(parts)))
    return lines


def _describe_prestress(structure: Structure) -> list[tuple[str, str]]:
    if structure.member_count == 0:
        return []
    springs, stiff_modes = _as_springs(structure)
    terms: list[EnergyTerm] = []
    terms += [CableSprings(springs.cables, None, springs.first_cable)] if springs.cables is not None else []
    terms += [StrutSprings(springs.struts, None)] if springs.struts is not None else []

    def energy(q):
        at = Configuration(q, 0.0, member_vectors(q, springs.kinds), None)
        return sum(term.energy(at) for term in terms)

    kinds = [(name, m) for name, m in (("struts", springs.struts), ("cables", springs.cables)) if m is not None]
    tolerance = max(1e-10 * _strongest(structure), 100 * np.finfo(float).eps * _strongest(springs))
    found = equilibrium(energy, structure.nodes, tolerance)
    where = "" if found is not None else " (in the given shape: no equilibrium found)"
    shape = np.asarray(structure.nodes) if found is None else found
    forces = ", ".join(f"{name} {_span(_tension(m, shape, name == 'cables'), 'N')}" for name, m in kinds)
    lines = [("prestress", f"{forces} (tension positive){where}")]
    frequencies = natural_frequencies(energy, structure.node_mass, shape, stiff_modes)
    floppy, stiff = int(np.sum(frequencies == 0)), frequencies[frequencies > 0]
    texts = [f"{floppy} of 0 Hz (nothing resists the motion)"] if floppy else []
    texts += [_span(stiff, "Hz")] if stiff.size else []
    return lines + ([("natural frequencies", ", ".join(texts) + where)] if texts else [])


def _strongest(structure: Structure) -> float:
    """N: the largest force, K L, of any member that is a spring."""
    springs = [m for m in (structure.struts, structure.cables) if m is not None and m.stiffness is not None]
    return max((float(np.max(np.asarray(m.stiffness) * np.asarray(m.rest_length))) for m in springs), default=0.0)


def _as_springs(structure: Structure) -> tuple[Structure, int]:
    """The structure with rigid struts as very stiff springs, and how many there are: so many modes are not real."""
    struts, cables = structure.struts, structure.cables
    if struts is None or not struts.rigid:
        return structure, 0
    stiff = STIFF * float(np.max(cables.stiffness)) if cables is not None and cables.stiffness is not None else 1e8
    springs = Members(struts.edges, np.full(len(struts.edges), stiff), struts.rest_length)
    return Structure(structure.nodes, structure.node_mass, springs, cables), len(struts.edges)


def _tension(members: Members, shape: np.ndarray, only_pull: bool) -> np.ndarray:
    assert members.stiffness is not None, "rigid members are replaced by stiff springs before"
    stretch = edge_lengths(shape, members.edges) - np.asarray(members.rest_length)
    force = np.asarray(members.stiffness, float) * stretch
    return np.maximum(force, 0) if only_pull else force


def _describe_gait(gait: Gait | None) -> list[tuple[str, str]]:
    if gait is None:
        return []
    text = (
        f"{len(gait.members)} members, amplitude {_span(gait.amplitude, '')}, frequency {_span(gait.frequency, 'Hz')}, "
        f"from {float(gait.start):g} s, full after {float(gait.ramp):g} s more"
    )
    return [("gait", text)]
