"""Perturbed robots: the quantities in which they differ, and random ensembles."""

from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxgrity.core import draws
from jaxgrity.core.arguments import check_count, check_each, check_key, check_number, check_unit_vector
from jaxgrity.core.errors import InputError
from jaxgrity.core.primitives import edge_vectors
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, as_float_or_none, namespace_of
from jaxgrity.model.actuation import Gait, waves_ahead
from jaxgrity.model.bodies import with_factors
from jaxgrity.model.force_laws import check_linear
from jaxgrity.model.pulleys import path_lengths
from jaxgrity.model.scene import Scene
from jaxgrity.model.structure import Structure
from jaxgrity.populations.other_ground import moved_ground, tilted_up

DIFFERING: dict[str, tuple[str, ...]] = {
    "friction": ("friction.mu", "friction.mu_static", "friction.mu_kinetic"),
    "cable_stiffness": ("structure.cables.stiffness",),
    "cable_damping": ("structure.cables.damping",),
    "cable_rest_length": ("structure.cables.rest_length",),
    "strut_rest_length": ("structure.struts.rest_length",),
    "node_mass": ("structure.node_mass",),
}
"""Parts of a scene that each of the `Differences` multiplies, if the scene has them."""

ROWS: dict[str, tuple] = {
    "friction": (),
    "strut_rest_length": ("struts",),
    "node_mass": ("nodes",),
    "body_mass": ("bodies",),
    "up": (3,),
    "terrain": (3,),
    "positions": ("nodes", 3),
    "velocities": ("nodes", 3),
}
"""The shape of a robot's row of each of the `Differences`; ("cables",) for others."""
PLACED = {"up": "up", "terrain": "ground.offset", "positions": "structure.nodes"}
"""Parts of a scene that other `Differences` replace."""
OF_NODES = {"body_mass": "node_mass"}
"""The `Differences` whose half-width is that of nodes."""


def _numbers() -> Any:
    return eqx.field(converter=as_float_or_none, default=None)


class Differences(eqx.Module):
    """Differences between the robots of a population, besides their gaits. None: no difference.

    Each array has one row per robot; for one robot, it is that row alone. Its numbers are factors of the scene's
    numbers, except in `up`, `terrain`, `positions` and `velocities`.
    """

    friction: Float[AnyArray, "*population"] | None = _numbers()
    """factor of mu; with the Coulomb switch, of both coefficients"""
    cable_stiffness: Float[AnyArray, "*population cables"] | None = _numbers()
    """factor of the stiffness; 0 for a broken cable, whose damping is then 0 too. A commanded pull stays"""
    cable_damping: Float[AnyArray, "*population cables"] | None = _numbers()
    cable_rest_length: Float[AnyArray, "*population cables"] | None = _numbers()
    node_mass: Float[AnyArray, "*population nodes"] | None = _numbers()
    up: Float[AnyArray, "*population 3"] | None = _numbers()
    """unit vector against gravity, for a different slope of the ground"""
    positions: Float[AnyArray, "*population nodes 3"] | None = _numbers()
    """positions of the nodes at the start, m"""
    velocities: Float[AnyArray, "*population nodes 3"] | None = _numbers()
    """velocities of the nodes at the start, m/s"""
    terrain: Float[AnyArray, "*population 3"] | None = _numbers()
    """shift of the ground's surface, m"""
    strut_rest_length: Float[AnyArray, "*population struts"] | None = _numbers()
    """factor of the rest length; with rigid struts, `positions` must fit it"""
    body_mass: Float[AnyArray, "*population bodies"] | None = _numbers()
    """factor of mass and inertia of each rigid body"""

    def __check_init__(self):
        for name in DIFFERING:
            check_each(f"differences.{name}", getattr(self, name), least=0.0)
        check_each("differences.body_mass", self.body_mass, above=0.0)
        for row in self.up.reshape(-1, 3) if isinstance(self.up, np.ndarray) and self.up.shape[-1:] == (3,) else ():
            check_unit_vector("differences.up", row)

    def check(self, scene: Scene, robots: int) -> None:
        """Raises `InputError` where these are not the differences of that number of robots of the scene."""
        structure = scene.structure
        sizes = {"nodes": len(structure.nodes), "bodies": len(structure.bodies), "struts": 0, "cables": 0}
        sizes |= {name: len(members.edges) for name, members, _ in structure.numbered}
        for name, value in vars(self).items():
            expected = (robots, *(sizes.get(size, size) for size in ROWS.get(name, ("cables",))))
            # a factor that is one number is common to all
            allowed = (expected, ()) if name in DIFFERING else (expected,)
            if value is not None and name in DIFFERING:
                _modelled(scene, name)
            if value is not None and np.shape(value) not in allowed:
                raise InputError(
                    f"differences.{name} has shape {np.shape(value)}; expected {expected}, a row for each robot"
                )
        if self.terrain is not None and getattr(scene.ground, "surface", None) is None:
            raise InputError("differences.terrain: the scene's ground has no surface to move; expected one")


@typed
def differing(scene: Scene, differences: Differences | None) -> Scene:
    """The scene of a perturbed robot, or of many if the arrays of both have lanes last.

    Raises `InputError` if the scene does not model a quantity that differs.
    """
    found: dict[str, Any] = {} if differences is None else vars(differences)
    for name, value in found.items():
        if value is None or name == "velocities":
            continue
        if name == "body_mass":
            bodies = tuple(with_factors(body, f, f) for body, f in zip(scene.structure.bodies, value))
            scene = eqx.tree_at(lambda s: s.structure.bodies, scene, bodies)
            continue
        if name in PLACED:
            scene = eqx.tree_at(partial(part_of, path=PLACED[name]), scene, value, is_leaf=lambda x: x is None)
            continue
        each = name == "friction" and jnp.ndim(value)  # one number, common to all robots, stays one
        factor = jnp.broadcast_to(value[None], (len(scene.structure.nodes), *value.shape)) if each else value
        for part in _modelled(scene, name):
            scene = eqx.tree_at(partial(part_of, path=part), scene, part_of(scene, part) * factor)
        if name == "cable_stiffness" and (damping := part_of(scene, "structure.cables.damping")) is not None:
            scene = eqx.tree_at(lambda s: s.structure.cables.damping, scene, damping * (value != 0))
    return scene


def _modelled(scene: Scene, name: str) -> list[str]:
    """Parts of the scene that one of the `Differences` multiplies. Raises `InputError` where there are none."""
    parts = [part for part in DIFFERING[name] if part_of(scene, part) is not None]
    if not parts:
        raise InputError(f"{name}: robots cannot differ in it, since the scene does not model it; expected it there")
    return parts


def part_of(scene: Any, path: str) -> Any:
    """The value at a path of stored fields and numbers, such as "structure.bodies.0.matrix"; None if one is missing."""
    for name in path.split("."):
        numbered = isinstance(scene, tuple) and name.isdecimal() and int(name) < len(scene)
        scene = scene[int(name)] if numbered else getattr(scene, "__dict__", {}).get(name)
    return scene


LESS_THAN = {"phase": np.pi / 2, "slope": np.pi / 2, "terrain": np.inf}
"""Upper limits of half-widths, rad or m. All other half-widths are fractions, and less than 1."""


class Uncertainty(eqx.Module):
    """Half-widths by which perturbed robots differ from the scene and its gait.

    Each quantity is uniform between minus and plus its half-width, so its standard deviation is the half-width over the
    root of 3.
    """

    phase: float = eqx.field(static=True, default=0.0)
    """half-width of the phase of each actuated member, rad; the shape of its wave is kept"""
    actuation: float = eqx.field(static=True, default=0.0)
    """half-width of the amplitude of each actuated member, as a fraction"""
    friction: float = eqx.field(static=True, default=0.0)
    """half-width of the friction coefficient, as a fraction; one value for all nodes of a robot"""
    cable_stiffness: float = eqx.field(static=True, default=0.0)
    """half-width of the cable stiffness, as a fraction; one value for all cables of a robot"""
    prestress: float = eqx.field(static=True, default=0.0)
    """half-width of the cable tension in the given shape, as a fraction; one value for all cables of a robot"""
    node_mass: float = eqx.field(static=True, default=0.0)
    """half-width of the mass of each node, and of mass and inertia of each rigid body, as a fraction; masses of members
    are exact"""
    slope: float = eqx.field(static=True, default=0.0)
    """largest extra slope of the ground, in a random direction, rad"""
    terrain: float = eqx.field(static=True, default=0.0)
    """half-width of the shift of uneven ground in x and in y, m; the ground also moves up or down to keep the start
    clear of it. If it exceeds the length of random bumps, each robot meets different ground"""

    def __check_init__(self):
        for name, value in vars(self).items():
            half_width = check_number(f"uncertainty.{name}", value, least=0.0)
            if not half_width < (most := LESS_THAN.get(name, 1)):
                expected = f"expected a half-width of at least 0 and below {most:.3g}"
                raise InputError(f"uncertainty.{name} = {value}: {expected}")

    @property
    def none(self) -> bool:
        """Whether nothing is uncertain."""
        return not any(vars(self).values())


@typed
def ensemble(
    key, scene: Scene, gaits: Gait, uncertainty: Uncertainty, count: int, common: bool = True
) -> tuple[Gait, Differences]:
    """Draw `count` perturbed robots for each of `gaits`. Row i*count + k of all results is robot k of gait i.

    `key` is a JAX random key. If `common`, all gaits get the same robots. Draws come in pairs of opposite signs: linear
    effects cancel from a mean. Raises `InputError` for less than one robot, a quantity that the scene lacks, amplitudes
    that may reach 1, terrain beside balls or contact along struts, prestress of nonlinear cables.
    """
    check_key(key)
    check_count("count", count, 1)
    check_many(gaits)
    asked = tuple(name for name, half_width in vars(uncertainty).items() if half_width)
    for name in [name for name in asked if name in DIFFERING]:
        _modelled(scene, name)
    dtype, (size, actuators) = gaits.phase.dtype, gaits.phase.shape
    rows = count if common else count * size
    between = _uniform(key, asked, actuators, scene.structure, -(-rows // 2), dtype)
    xp = namespace_of(gaits.phase)
    precise = float if xp is np else dtype  # NumPy rounds once, at the end

    def draw(name: str):
        half = np.asarray(getattr(uncertainty, OF_NODES.get(name, name)), dtype) * xp.asarray(between[name], precise)
        return xp.concatenate([half, -half])[:rows]

    def each(drawn):
        """A row of draws for each robot."""
        return xp.tile(drawn, (size if common else 1, *[1] * (drawn.ndim - 1)))

    many = jax.tree.map(lambda x: xp.repeat(x, count, axis=0) if np.ndim(x) else x, gaits)
    if uncertainty.phase:
        many = waves_ahead(many, each(draw("phase")))
    if uncertainty.actuation:
        check_strokes(gaits.amplitude, uncertainty)
        many = eqx.tree_at(lambda g: g.amplitude, many, many.amplitude * each((1 + draw("actuation")).astype(dtype)))
    if uncertainty.prestress:
        check_linear(scene, 1 + uncertainty.prestress, f"uncertainty.prestress = {uncertainty.prestress:g}")
    found = _differences(key, scene, {name: draw(name) for name in between}, dtype)
    return many, Differences(**{name: each(drawn) for name, drawn in found.items()})


def check_many(gaits: Gait) -> None:
    """Raises `InputError` for a single gait, or none, where a population of them is expected."""
    if len(shape := np.shape(gaits.phase)) != 2 or not shape[0]:
        raise InputError(f"gaits.phase has shape {shape}; expected (gaits, actuators), one gait or more")


def check_strokes(amplitude: AnyArray | float, uncertainty: Uncertainty) -> None:
    """Raises `InputError` if some robot's rest length may reach zero; amplitudes that are traced are not looked at."""
    most = 0.0 if isinstance(amplitude, jax.Array) else float(np.max(amplitude))
    if not most * (1 + uncertainty.actuation) < 1:
        raise InputError(
            f"amplitude = {most:g}: with uncertainty.actuation = {uncertainty.actuation:g} robots reach "
            f"{most * (1 + uncertainty.actuation):.3g}; expected less than 1, where a rest length is zero"
        )


def _differences(key, scene: Scene, drawn: dict[str, AnyArray], dtype: np.dtype) -> dict[str, AnyArray]:
    """The fields of `Differences` from the draws, a row for each robot."""
    found = {name: (1 + drawn[name]).astype(dtype) for name in drawn if name in ("friction", "node_mass", "body_mass")}
    if "cable_stiffness" in drawn:
        factors = (1 + drawn["cable_stiffness"]).astype(dtype)
        found["cable_stiffness"] = factors.repeat(len(part_of(scene, "structure.cables").edges), axis=1)
    if "prestress" in drawn:
        found["cable_rest_length"] = slackened(scene, drawn["prestress"].astype(dtype))
    if "slope" in drawn:
        if scene.up is not None:
            raise InputError("slope: scene.up leans already; expected a scene with ground.incline")
        found["up"] = tilted_up(jax.random.fold_in(_keys(key)["slope"], 1), drawn["slope"].astype(dtype))
    if "terrain" in drawn:
        found["terrain"] = moved_ground(scene, drawn["terrain"].astype(dtype))
    return found


def _keys(key) -> dict[str, AnyArray]:
    """One key for each possibly uncertain quantity, by name."""
    return dict(zip(vars(Uncertainty()), jax.random.split(key, len(vars(Uncertainty())))))


def _uniform(
    key, asked: tuple[str, ...], actuators: int, structure: Structure, pairs: int, dtype: np.dtype
) -> dict[str, Float[AnyArray, "pairs ..."]]:
    """Uniform numbers between -1 and 1 for some quantities, for each pair of robots."""
    numbers: dict[str, tuple[int, ...]] = {"phase": (actuators,), "actuation": (actuators,)}
    numbers |= {"cable_stiffness": (1,), "prestress": (1,), "friction": (), "slope": (), "terrain": (2,)}
    numbers |= {"node_mass": (len(structure.nodes),), "body_mass": (len(structure.bodies),)}
    keys = _keys(key)
    keys["body_mass"] = jax.random.fold_in(keys["node_mass"], 1)
    more = tuple(name for name, of in OF_NODES.items() if of in asked and structure.bodies)
    return {name: draws.uniform(keys[name], (pairs, *numbers[name]), dtype, -1.0, 1.0) for name in asked + more}


def slackened(scene: Scene, share: AnyArray) -> AnyArray:
    """(robots, cables), the factors of rest lengths that raise tensions in the built shape by a share (robots, 1)."""
    _modelled(scene, "cable_rest_length")
    cables, nodes = part_of(scene, "structure.cables"), jnp.asarray(scene.structure.nodes, share.dtype)
    return 1 - share * (path_lengths(cables, edge_vectors(nodes, cables.edges), nodes) / cables.rest_length - 1)
