"""How the ground of perturbed robots leans, and where it is: random slopes and shifts."""

import jax.numpy as jnp
import numpy as np

from jaxgrity.core import draws
from jaxgrity.core.errors import InputError
from jaxgrity.core.types import AnyArray
from jaxgrity.model.rod_contact import radii_along_struts
from jaxgrity.model.scene import Scene


def tilted_up(key, lean: AnyArray) -> AnyArray:
    """(robots, 3): unit vectors against gravity, tilted by an angle (robots,), rad; a pair leans in one direction."""
    heading = draws.uniform(key, (-(-len(lean) // 2),), lean.dtype, 0.0, 2 * np.pi)
    heading = jnp.concatenate([heading, heading])[: len(lean)]
    return jnp.stack([jnp.sin(lean) * jnp.cos(heading), jnp.sin(lean) * jnp.sin(heading), jnp.cos(lean)], 1)


def moved_ground(scene: Scene, moved: AnyArray) -> AnyArray:
    """(robots, 3), m: the surface's place, moved by (robots, 2), and up or down: starts stay as high above it."""
    ground = scene.ground
    if ground is None or ground.surface is None:
        raise InputError("terrain: robots cannot differ in it, since there is a plane or no ground; expected a surface")
    if ground.balls is not None or radii_along_struts(scene):
        what = "balls" if ground.balls is not None else "contact along struts"
        raise InputError(f"terrain: robots with {what} would start in the ground; expected terrain = 0, or no {what}")
    own = jnp.asarray(np.zeros(3) if ground.offset is None else ground.offset, moved.dtype)
    x, y, z = jnp.asarray(scene.structure.nodes, moved.dtype).T - own[:, None]
    above, there = (z - ground.surface.height(*at) for at in ((x, y), (x - moved[:, :1], y - moved[:, 1:])))
    return own + jnp.concatenate([moved, (there.min(1) - above.min())[:, None]], axis=1)
