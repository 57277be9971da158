"""A scene in words: what is modelled and what is not, its prestress and its natural frequencies."""

import numpy as np

from jaxgrity.core.display import in_digits
from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray
from jaxgrity.model.actuation import Gait
from jaxgrity.model.clusters import cables_of
from jaxgrity.model.dissipation import CapstanFriction
from jaxgrity.model.friction import SwitchFriction
from jaxgrity.model.laws import EnergyTerm
from jaxgrity.model.pulleys import built_lengths
from jaxgrity.model.pulls import forced_cables
from jaxgrity.model.rigidity import linked
from jaxgrity.model.rod_contact import radii_along_struts
from jaxgrity.model.scene import KNOWN_FRICTIONS, KNOWN_LAWS, Scene
from jaxgrity.model.slides import slides_of
from jaxgrity.model.springs import as_springs, spring_forces
from jaxgrity.model.structure import Members, Structure
from jaxgrity.model.strut_contact import strut_contact
from jaxgrity.statics.equilibrium import resting_shape
from jaxgrity.statics.vibrations import frequency_range


@typed
def describe(scene: Scene) -> str:
    """A scene in words: effects modelled and left out, members, masses, prestress, natural frequencies.

    Prestress, and the lowest and highest natural frequency, are those of the structure alone, at rest without gravity,
    ground and gait.
    """
    modelled = list(dict.fromkeys(law.name for law in scene.laws))
    # few scenes have pulleys: that these have no friction says nothing of the others
    kinds = [kind for kind in (*KNOWN_LAWS, *KNOWN_FRICTIONS) if kind is not CapstanFriction]
    absent = [kind.name for kind in kinds if kind.name not in modelled]
    (absent if scene.gait is None else modelled).append("gait")
    lines = [
        ("modelled", ", ".join(modelled) or "-"),
        ("not modelled", ", ".join(absent) or "-"),
        ("nodes", f"{len(scene.structure.nodes)}, {in_digits(scene.structure.mass, 4)} kg in all"),
        *_describe_ground(scene),
        *_describe_strut_contact(scene),
        *_describe_friction(scene),
        *_describe_supports(scene),
        *_describe_members(scene),
        *_describe_bodies(scene.structure),
        *_describe_slides(scene),
        *_describe_prestress(scene),
        *_describe_gait(scene.gait),
        *(
            [("load cases", f"{', '.join(case.name for case in scene.loads)} (motions ignore them)")]
            if scene.loads
            else []
        ),
    ]
    return "\n".join(f"{name:<20} {text}" for name, text in lines)


def _span(values: AnyArray | list, unit: str) -> str:
    low, high = float(np.min(values)), float(np.max(values))
    text = " to ".join(in_digits(each, 4) for each in ((low,) if np.isclose(low, high, atol=0) else (low, high)))
    return f"{text} {unit}" if unit else text


def _describe_ground(scene: Scene) -> list[tuple[str, str]]:
    if scene.ground is None:
        return []
    if scene.ground.balls is not None:
        touch = [("touched by", f"{len(scene.ground.balls.nodes)} balls of {_span(scene.ground.balls.radius, 'm')}")]
    else:
        touch = []
    if radii := radii_along_struts(scene):
        struts = sum(k < scene.structure.first_cable for k in radii)
        kinds = {"struts": struts, "rods of bodies": len(radii) - struts}
        which = " and ".join(f"{count} {kind}" for kind, count in kinds.items() if count)
        touch.append(("contact along", f"{which} of radius {_span(list(radii.values()), 'm')}"))
    if scene.ground.surface is not None:
        return [*touch, ("ground", ", ".join(type(solid).__name__.lower() for solid in scene.ground.surface.solids))]
    incline = np.degrees(scene.ground.incline)
    return [*touch, ("ground", f"plane that falls by {incline:.4g}° towards +x" if incline else "level plane")]


def _describe_strut_contact(scene: Scene) -> list[tuple[str, str]]:
    if (law := strut_contact(scene)) is None:
        return []
    return [("struts touch", f"{len(law.between.pairs)} pairs of radius {_span(law.between.radius, 'm')}")]


def _describe_friction(scene: Scene) -> list[tuple[str, str]]:
    if not isinstance(scene.friction, SwitchFriction) or not linked(scene):
        return []
    speed = float(scene.friction.slip_speed)
    creep = f"nodes that should stick creep at up to {speed:g} m/s; spring struts, or exact contact, hold them"
    return [("friction", f"the switch does not know the forces of rigid struts and bodies: {creep}")]


def _describe_supports(scene: Scene) -> list[tuple[str, str]]:
    fixed = [f"node {node}" + ("" if len(axes) == 3 else f" along {axes}") for node, axes in scene.structure.fixed]
    shaking = "; shaking" if scene.shaking is not None else ""
    return [("fixed", ", ".join(fixed) + shaking)] if fixed else []


def _describe_members(scene: Scene) -> list[tuple[str, str]]:
    lines, structure = [], scene.structure
    for name, members, _ in structure.numbered:
        parts = [
            f"{len(members.edges)}",
            f"length {_span(built_lengths(members, structure.nodes), 'm')}",
            f"rest length {_span(members.rest_length, 'm')}",
            "rigid" if members.stiffness is None else f"stiffness {_span(members.stiffness, 'N/m')}",
        ]
        if members.damping is not None:
            parts.append(f"damping {_span(members.damping, 'N s/m')}")
        if members.mass is not None:
            parts.append(f"mass {_span(members.mass, 'kg')}")
        forced = _driven_by_force(scene) if name == "cables" else set[int]()
        slack = set() if members.stiffness is None else set(np.flatnonzero(np.asarray(members.stiffness) == 0).tolist())
        motors = [motor.member for motor in members.motors]
        clusters = [list(cluster) for cluster in members.clusters]
        which = {
            "broken": sorted(slack - forced),
            "driven by force": sorted(forced),
            "stuck": members.stuck,
            "as one cable each": clusters,
            "with a motor": motors,
        }
        which["over a pulley between"] = [list(pulley.between) for pulley in members.pulleys]
        parts += [f"{words} {list(numbers)}" for words, numbers in which.items() if numbers]
        lines.append((name, ", ".join(parts)))
    return lines


def _driven_by_force(scene: Scene) -> set[int]:
    """The cables with a commanded pull, all segments of those that run through several nodes."""
    cables = scene.structure.cables
    assert cables is not None, "the caller has looked"
    cords = cables_of(cables.clusters, len(cables.edges))
    return {k for cord, forced in zip(cords, np.any(forced_cables(scene), axis=1).tolist()) if forced for k in cord}


def _describe_bodies(structure: Structure) -> list[tuple[str, str]]:
    if not structure.bodies:
        return []
    points = _span([len(body.points) for body in structure.bodies], "")
    mass = _span([float(body.matrix.sum()) for body in structure.bodies], "kg")
    return [("rigid bodies", f"{len(structure.bodies)}, mass {mass}, {points} nodes each")]


def _describe_slides(scene: Scene) -> list[tuple[str, str]]:
    if (slides := slides_of(scene)) is None:
        return []
    each = (f"node {node} along {list(pair)}" for node, pair in zip(slides.nodes, slides.along))
    return [("sliding nodes", f"{len(slides.nodes)}: {', '.join(each)}")]


def _describe_prestress(scene: Scene) -> list[tuple[str, str]]:
    structure = scene.structure
    # `inspect` reports on bodies, and supports decide how many modes of slides are not real
    if structure.member_count == 0 or structure.bodies or slides_of(scene) is not None:
        return []
    if others := [term.name for term in scene.terms if isinstance(term, EnergyTerm)]:
        return [("prestress", f"not listed beside {', '.join(others)}; `resting_shape` knows all of U")]
    alone = Scene(structure)
    try:
        shape, where = np.asarray(resting_shape(alone).q), ""
    except InputError:
        shape, where = np.asarray(structure.nodes), " (in the given shape: no equilibrium found)"
    springs, stiff_modes = as_springs(structure)
    kinds = ((name, _tension(m, shape, name == "cables")) for name, m, _ in springs.numbered)
    forces = ", ".join(f"{name} {_span(tension, 'N')}" for name, tension in kinds)
    zero, *ends = frequency_range(alone, shape, stiff_modes)
    texts = [f"{zero} of 0 Hz (nothing resists the motion)"] if zero else []
    texts += [_span(ends, "Hz")] if np.all(np.isfinite(ends)) else []
    lines = [("prestress", f"{forces} (tension positive){where}")]
    lines += [("natural frequencies", ", ".join(texts) + where)] if texts else []
    left_out = {"gravity": scene.gravity, "ground": scene.ground, "gait": scene.gait}
    absent = [name for name, part in left_out.items() if part is not None]
    return lines + ([("both without", ", ".join(absent))] if absent else [])


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
