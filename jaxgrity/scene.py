"""A scene: the composition of a structure and of what acts on it, and the two scalar functions that it is."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.actuation import Gait
from jaxgrity.dissipation import dissipation_terms
from jaxgrity.energy import potential_energy
from jaxgrity.friction import ConeFriction, Friction, SmoothFriction, SwitchFriction
from jaxgrity.ground import Ground
from jaxgrity.structure import InputError, Members, Structure, edge_lengths
from jaxgrity.types import AnyArray, ByKind, NodeVectors, PerNode, Scalar, as_float_or_none
from jaxgrity.vibration import equilibrium, natural_frequencies


class Scene(eqx.Module):
    """What is simulated. A part that is None is not modelled, and leaves no trace in the compiled program.

    Raises `InputError` where the parts do not fit each other.
    """

    structure: Structure
    gravity: Scalar | None = eqx.field(converter=as_float_or_none, default=None)
    """g, m/s^2, along -z"""
    node_damping: PerNode | None = eqx.field(converter=as_float_or_none, default=None)
    """c, N s/m"""
    ground: Ground | None = None
    friction: Friction | None = None
    gait: Gait | None = None
    up: NodeVectors | None = eqx.field(converter=as_float_or_none, default=None)
    """unit vectors against gravity, a row a node, all alike, where the ground leans more than its file says; None: z"""

    def __check_init__(self):
        members = sum(len(m.edges) for m in (self.structure.struts, self.structure.cables) if m)
        if self.friction is not None and self.ground is None:
            raise InputError("friction needs a ground to act on; expected [ground] beside [friction]")
        if self.friction is not None and self.ground is not None:
            cone = isinstance(self.friction, ConeFriction)
            if cone != self.ground.exact:
                raise InputError(
                    "friction by a cone goes with exact contact (ground.contact = 'complementarity'), "
                    "smooth friction and the switch with penalty contact"
                )
        if self.gait is not None:
            if len(set(self.gait.members)) < len(self.gait.members):
                raise InputError(f"gait.members = {list(self.gait.members)}: expected each member once")
            for k in self.gait.members:
                if not 0 <= k < members:
                    known = f"0 to {members - 1}, struts first" if members else "no gait, since there are no members"
                    raise InputError(f"gait.members names member {k}; expected {known}")
            parts = {name: getattr(self.gait, name) for name in ("phase", "amplitude", "frequency")}
            for h, overtone in enumerate(self.gait.overtones, start=2):
                parts |= {f"overtone {h}, size": overtone.size, f"overtone {h}, phase": overtone.phase}
            for name, part in parts.items():
                shape = np.shape(part)
                if shape != (len(self.gait.members),):
                    raise InputError(
                        f"gait.{name} has shape {shape}; expected one number for each of the "
                        f"{len(self.gait.members)} actuated members"
                    )

    def potential_energy(self, q: NodeVectors, t: Scalar, vectors: ByKind | None = None) -> Scalar:
        """U(q, t), J; of q and the members' `vectors` where they are given (see `energy.potential_energy`)."""
        return potential_energy(q, t, self.structure, self.gait, self.gravity, self.ground, vectors, self.up)

    def dissipation(
        self,
        v: NodeVectors,
        q: NodeVectors,
        t: Scalar,
        normal_force: PerNode | None,
        vectors: tuple[ByKind, ByKind] | None = None,
    ) -> Scalar:
        """R(v; q, t), W, with friction's normal force held fixed; of the members' `vectors` too where given."""
        return sum(self.dissipation_terms(v, q, t, normal_force, vectors).values(), jnp.zeros((), v.dtype))

    def dissipation_terms(
        self,
        v: NodeVectors,
        q: NodeVectors,
        t: Scalar,
        normal_force: PerNode | None,
        vectors: tuple[ByKind, ByKind] | None = None,
    ) -> dict[str, Scalar]:
        """The terms of R by their causes, W."""
        smooth = self.friction if isinstance(self.friction, SmoothFriction) else None
        return dissipation_terms(
            v, q, t, self.structure, self.gait, self.node_damping, self.ground, smooth, normal_force, vectors
        )

    @property
    def dissipates(self) -> bool:
        """Whether any force of the scene depends on velocity; impulses of exact contact are not forces."""
        members = (self.structure.struts, self.structure.cables)
        return (
            self.node_damping is not None
            or any(m is not None and m.damping is not None for m in members)
            or (self.ground is not None and self.ground.dissipation is not None)
            or isinstance(self.friction, (SmoothFriction, SwitchFriction))
        )

    @property
    def constrained(self) -> bool:
        """Whether struts or contact are constraints, which only complementarity stepping can meet."""
        struts = self.structure.struts
        return (struts is not None and struts.rigid) or (self.ground is not None and self.ground.exact)

    def describe(self) -> str:
        """What is modelled and what is not, members, masses, prestress, lowest and highest natural frequency.

        Prestress and frequencies are those of the structure alone, in the shape it takes without gravity, ground
        and gait.
        """
        modelled = _terms(self)
        lines = [
            ("modelled", ", ".join(name for name, present in modelled if present) or "-"),
            ("not modelled", ", ".join(name for name, present in modelled if not present) or "-"),
            ("nodes", f"{len(self.structure.nodes)}, {float(self.structure.mass):.4g} kg in all"),
            *_describe_members(self.structure),
            *_describe_prestress(self.structure),
            *_describe_gait(self.gait),
        ]
        return "\n".join(f"{name:<20} {text}" for name, text in lines)


def with_gait(scene: Scene, gait: Gait | None) -> Scene:
    """The scene with another gait, or with none. Raises `InputError` where the gait does not fit the structure."""
    return dataclasses.replace(scene, gait=gait)


def as_dtype(scene: Scene, dtype: str) -> Scene:
    """The scene with every number as a JAX array of `dtype`."""
    return jax.tree.map(lambda x: jnp.asarray(x, dtype), scene)


def _terms(scene: Scene) -> list[tuple[str, bool]]:
    struts, cables = scene.structure.struts, scene.structure.cables
    return [
        ("strut springs", struts is not None and not struts.rigid),
        ("rigid struts", struts is not None and struts.rigid),
        ("cables (tension only)", cables is not None),
        ("strut damping", struts is not None and struts.damping is not None),
        ("cable damping", cables is not None and cables.damping is not None),
        ("gravity", scene.gravity is not None),
        ("node damping", scene.node_damping is not None),
        ("penalty contact", scene.ground is not None and not scene.ground.exact),
        ("exact contact", scene.ground is not None and scene.ground.exact),
        ("contact dissipation", scene.ground is not None and scene.ground.dissipation is not None),
        ("smooth friction", isinstance(scene.friction, SmoothFriction)),
        ("Coulomb switch", isinstance(scene.friction, SwitchFriction)),
        ("Coulomb cone", isinstance(scene.friction, ConeFriction)),
        ("gait", scene.gait is not None),
    ]


def _span(values: AnyArray, unit: str) -> str:
    low, high = float(np.min(values)), float(np.max(values))
    return f"{low:.4g} {unit}" if np.isclose(low, high) else f"{low:.4g} to {high:.4g} {unit}"


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
    if structure.struts is None and structure.cables is None:
        return []
    structure, constraints = _without_constraints(structure)

    def energy(q):
        return potential_energy(q, 0.0, structure, None, None, None)

    stiff = [np.asarray(m.stiffness) * np.asarray(m.rest_length) for m in (structure.struts, structure.cables) if m]
    shape = equilibrium(energy, structure.nodes, tolerance=1e-10 * float(np.max(np.concatenate(stiff))))
    where = "" if shape is not None else " (in the given shape: no equilibrium found)"
    shape = np.asarray(structure.nodes) if shape is None else shape
    forces = []
    for name, members in (("struts", structure.struts), ("cables", structure.cables)):
        if members is not None:
            force = _tension(members, shape, only_pull=name == "cables")
            forces.append(f"{name} {_span(force, 'N')}")
    frequencies = natural_frequencies(energy, structure.node_mass, shape)
    lines = [("prestress", ", ".join(forces) + " (tension positive)" + where)]
    frequencies = frequencies[: frequencies.size - constraints]
    if frequencies.size:
        lines.append(("natural frequencies", f"{frequencies[0]:.4g} to {frequencies[-1]:.4g} Hz" + where))
    return lines


def _without_constraints(structure: Structure) -> tuple[Structure, int]:
    """The structure with rigid struts as very stiff springs, and how many there are: so many modes are not real."""
    struts, cables = structure.struts, structure.cables
    if struts is None or not struts.rigid:
        return structure, 0
    stiff = 1e5 * float(np.max(cables.stiffness)) if cables is not None and cables.stiffness is not None else 1e8
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
    return [("gait", text.replace(" ,", ","))]
