"""What is never known exactly: in what the robots of a population differ, and ensembles drawn from it."""

from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxgrity.core.errors import InputError
from jaxgrity.core.primitives import edge_vectors, length
from jaxgrity.core.types import AnyArray
from jaxgrity.model.actuation import Gait
from jaxgrity.model.scene import Scene

DIFFERING: dict[str, tuple[str, ...]] = {
    "friction": ("friction.mu", "friction.mu_static", "friction.mu_kinetic"),
    "cable_stiffness": ("structure.cables.stiffness",),
    "cable_damping": ("structure.cables.damping",),
    "cable_rest_length": ("structure.cables.rest_length",),
    "node_mass": ("structure.node_mass",),
}
"""the parts of a scene, those that it has, that each of the `Differences` is a factor of"""


class Differences(eqx.Module):
    """In what the robots of a population differ beside their gaits, a row of each array a robot; None: in nothing.

    All but `up` are factors of what the scene says. Without the population's axis: in what one robot differs from it.
    """

    friction: Float[AnyArray, "*population"] | None = None
    """of mu; of both, with the Coulomb switch"""
    cable_stiffness: Float[AnyArray, "*population cables"] | None = None
    """0 for a broken cable, as its damping"""
    cable_damping: Float[AnyArray, "*population cables"] | None = None
    cable_rest_length: Float[AnyArray, "*population cables"] | None = None
    node_mass: Float[AnyArray, "*population nodes"] | None = None
    up: Float[AnyArray, "*population 3"] | None = None
    """unit vector against gravity, where the ground leans more than the scene says"""


def differing(scene: Scene, differences: Differences | None) -> Scene:
    """The scene of a robot that differs; or of many, where the arrays of both have lanes last.

    Raises `InputError` where the scene lacks what should differ.
    """
    nodes = len(scene.structure.nodes)

    def of_nodes(x):
        return jnp.broadcast_to(x[None], (nodes, *jnp.shape(x)))

    found: dict[str, Any] = {} if differences is None else vars(differences)
    for name, value in found.items():
        if value is None:
            continue
        if name == "up":
            scene = eqx.tree_at(lambda s: s.up, scene, of_nodes(value), is_leaf=lambda x: x is None)
            continue
        parts = [part for part in DIFFERING[name] if _part(scene, part) is not None]
        if not parts:
            raise InputError(f"{name} is to differ, but the scene has none; expected a scene that models it")
        factor = of_nodes(value) if name == "friction" else value
        for part in parts:
            scene = eqx.tree_at(partial(_part, path=part), scene, _part(scene, part) * factor)
    return scene


def _part(scene: Scene, path: str) -> Any:
    """What is at the end of a path of attributes; None where it breaks off."""
    found: Any = scene
    for name in path.split("."):
        found = getattr(found, name, None)
    return found


class Uncertainty(eqx.Module):
    """Half-widths: each quantity is uniform within plus and minus so much of what the scene and the gait say.

    A uniform number has a standard deviation of its half-width over the root of 3.
    """

    phase: float = eqx.field(static=True, default=0.0)
    """rad, of each actuated member"""
    actuation: float = eqx.field(static=True, default=0.0)
    """share of the amplitude, of each actuated member"""
    friction: float = eqx.field(static=True, default=0.0)
    """share of mu, alike at all nodes"""
    cable_stiffness: float = eqx.field(static=True, default=0.0)
    """share, alike in all cables"""
    prestress: float = eqx.field(static=True, default=0.0)
    """share of the tension in the shape as built, alike in all cables, by their rest lengths"""
    node_mass: float = eqx.field(static=True, default=0.0)
    """share, of each node"""
    slope: float = eqx.field(static=True, default=0.0)
    """rad, by which the ground leans more than the scene says, in any direction"""

    def __check_init__(self):
        for name, value in vars(self).items():
            if not 0 <= value < (1 if name not in ("phase", "slope") else np.pi / 2):
                raise InputError(
                    f"uncertainty of {name} = {value}: expected a half-width, at least 0 and less than all"
                )

    @property
    def none(self) -> bool:
        """Whether everything is known."""
        return not any(vars(self).values())


def ensemble(
    key, scene: Scene, gaits: Gait, uncertainty: Uncertainty, count: int, common: bool = True
) -> tuple[Gait, Differences]:
    """`count` robots for each of `gaits`, whose numbers and gaits are drawn from `uncertainty`: row i*count + k is the
    k-th robot of gait i.

    All gaits meet the same draws where these are `common`, so that their means compare. Draws come in pairs of opposite
    signs, so that what is linear in them cancels from a mean. Raises `InputError` where the scene lacks what is
    uncertain.
    """
    dtype, (size, actuators) = gaits.phase.dtype, gaits.phase.shape
    keys = dict(zip(vars(uncertainty), jax.random.split(key, len(vars(uncertainty)))))
    rows = count if common else count * size

    def draw(name: str, *shape: int):
        half = jax.random.uniform(keys[name], (-(-rows // 2), *shape), dtype, -1, 1)
        return getattr(uncertainty, name) * jnp.concatenate([half, -half])[:rows]

    def each(drawn):
        """A row of draws for each robot."""
        return jnp.tile(drawn, (size if common else 1, *[1] * (drawn.ndim - 1)))

    many = jax.tree.map(lambda x: jnp.repeat(x, count, axis=0) if x.ndim else x, gaits)
    if uncertainty.phase:
        many = eqx.tree_at(lambda g: g.phase, many, many.phase + each(draw("phase", actuators)))
    if uncertainty.actuation:
        many = eqx.tree_at(lambda g: g.amplitude, many, many.amplitude * (1 + each(draw("actuation", actuators))))
    found = {}
    if uncertainty.friction:
        if scene.friction is None:
            raise InputError("friction is to differ, but the scene has none; expected a scene that models it")
        found["friction"] = 1 + draw("friction")
    if uncertainty.cable_stiffness or uncertainty.prestress:
        cables = _cables(scene)
        if uncertainty.cable_stiffness:
            found["cable_stiffness"] = 1 + draw("cable_stiffness", 1) * np.ones(len(cables.edges), dtype)
        if uncertainty.prestress:
            built = length(edge_vectors(jnp.asarray(scene.structure.nodes, dtype), cables.edges))
            found["cable_rest_length"] = 1 - draw("prestress", 1) * (built / cables.rest_length - 1)
    if uncertainty.node_mass:
        found["node_mass"] = 1 + draw("node_mass", len(scene.structure.nodes))
    if uncertainty.slope:
        heading = jax.random.uniform(jax.random.fold_in(keys["slope"], 1), (-(-rows // 2),), dtype, 0, 2 * jnp.pi)
        heading, lean = jnp.concatenate([heading, heading])[:rows], draw("slope")
        found["up"] = jnp.stack([jnp.sin(lean) * jnp.cos(heading), jnp.sin(lean) * jnp.sin(heading), jnp.cos(lean)], 1)
    return many, Differences(**{name: each(drawn) for name, drawn in found.items()})


def _cables(scene: Scene):
    if scene.structure.cables is None:
        raise InputError("cables are to differ, but the scene has none; expected a scene that models them")
    return scene.structure.cables
