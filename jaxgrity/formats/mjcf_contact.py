"""What of a MuJoCo model touches its plane: radii, friction and places, as MuJoCo itself combines them."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import lazy_loader
import numpy as np
from scipy.optimize import nnls

from jaxgrity.formats.foreign import Losses, cone_of
from jaxgrity.formats.mjcf_losses import SMALL, largest_first, lose_beside_sites, lose_rims, name_of
from jaxgrity.formats.mjcf_touched import Touched, Touching, what_touches
from jaxgrity.model.balls import Balls
from jaxgrity.model.friction import ConeFriction
from jaxgrity.model.ground import ExactGround
from jaxgrity.model.surface import Surface

mujoco: Any = lazy_loader.load("mujoco")

SAME_PLACE = 1e-4
"""Largest difference of places, and of radii, that count as the same, as a share of the robot's size."""


class GroundFound(NamedTuple):
    """What of the model is ground; nothing where nothing touches a plane."""

    ground: ExactGround | None
    friction: ConeFriction | None
    lift: np.ndarray
    """(3,), m: shift of the nodes, which then touch a plane through the origin as their balls touched the model's"""
    more: np.ndarray = np.zeros((0, 3))
    """(k, 3), m: further nodes, at the centres of balls of rigid bodies, or so that these are not flat"""
    carrier: np.ndarray = np.zeros(0, int)
    """(k,), their bodies"""
    normal: np.ndarray | None = None
    """(3,), unit vector, of the plane, if any; the ground is level until it is turned"""
    along: Mapping[int, float] = MappingProxyType({})
    """radius, m, with MuJoCo's margin, of each geom that may touch the ground along its length"""
    turning: Mapping[int, int] = MappingProxyType({})
    """bodies of the balls at nodes"""
    solids: Mapping[int, Surface] = MappingProxyType({})
    """what else stands and is touched, by its geoms, as the model places it"""


def touched_plane(model: Any, data: Any, x: np.ndarray, carrier: np.ndarray, losses: Losses) -> GroundFound:
    """The plane, for nodes `x` (m) of the bodies `carrier`; friction and radii at each of them.

    Raises `InputError` where contact would be another one here, unless the caller drops it.
    """
    size, moving = float(np.ptp(x, axis=0).max()), carrier != 0
    touched = what_touches(model, data, size, losses)
    if touched.plane is None and not touched.solids:
        return GroundFound(None, None, np.zeros(3))
    at = _at_nodes(model, touched.balls, x, carrier, SAME_PLACE * size, losses)
    highest = max((m for _, m in at.values()), default=0.0)
    each = cone_of(np.array([at[k][1] if k in at else highest for k in range(len(x))]))
    if touched.solids:
        return _with_solids(model, data, x, at, touched, each, losses)
    radius = _one_radius([r for r, _ in at.values()], SAME_PLACE * size, losses)
    _only_nodes(model, touched.balls, x, np.where(moving, carrier, -1), set(at), (radius, SAME_PLACE * size), losses)
    assert touched.plane is not None, "beside no solids"
    n = normal_of(data, touched.plane)
    lift = lift_of(n, data.geom_xpos[touched.plane], radius, x[moving], size, losses)
    losses.note("contact is between nodes and the plane; it is exact, where MuJoCo's is soft")
    return GroundFound(ExactGround(restitution=touched.bounce), each, lift, normal=n)


def _with_solids(
    model: Any,
    data: Any,
    x: np.ndarray,
    at: dict[int, tuple[float, float]],
    touched: Touched,
    friction: ConeFriction,
    losses: Losses,
) -> GroundFound:
    """The plane, if any, and solids, which nodes `at` touch with radii of their own, and struts along their length."""
    size = float(np.ptp(x, axis=0).max())
    for ball in touched.balls:
        apart = np.linalg.norm(x[list(at)] - ball.centre, axis=1)
        if apart.min(initial=np.inf) > SAME_PLACE * size:
            lose_beside_sites(model, ball.geom, ball.centre, losses)
    if not at:
        return GroundFound(None, None, np.zeros(3))
    radius = np.array([r for r, _ in at.values()])
    lift, n = lift_of_balls(data, touched.plane, x[list(at)], radius, size, losses)
    losses.note("contact is exact, where MuJoCo's is soft; balls at the ends of struts slide or stick, and do not roll")
    ground = ExactGround(restitution=touched.bounce, balls=Balls(tuple(at), radius))
    along = {ball.geom: ball.radius for ball in touched.balls}
    return GroundFound(ground, friction, lift, normal=n, along=along, solids=touched.solids)


def normal_of(data: Any, plane: int) -> np.ndarray:
    """(3,), unit normal of a plane of the model."""
    return data.geom_xmat[plane].reshape(3, 3)[:, 2]


def lift_of_balls(
    data: Any, plane: int | None, x: np.ndarray, radius: np.ndarray, size: float, losses: Losses
) -> tuple[np.ndarray, np.ndarray | None]:
    """`GroundFound.lift` for balls at `x` (balls, 3), m, and the plane's normal: 0 and None without a plane."""
    if plane is None:
        return np.zeros(3), None
    n = normal_of(data, plane)
    return lift_of(n, data.geom_xpos[plane], 0.0, x - radius[:, None] * n, size, losses), n


def _at_nodes(
    model: Any, balls: list[Touching], x: np.ndarray, carrier: np.ndarray, within: float, losses: Losses
) -> dict[int, tuple[float, float]]:
    """Radius and mu at each node that is the centre of a ball: those of the largest one."""
    found: dict[int, tuple[float, float]] = {}
    for ball in largest_first(model, balls):
        own = np.flatnonzero(carrier == ball.body)
        if not len(own):
            continue
        node = int(own[np.argmin(np.linalg.norm(x[own] - ball.centre, axis=1))])
        if np.linalg.norm(x[node] - ball.centre) > within:
            continue
        if node in found:
            radius, mu = found[node]
            if abs(radius - ball.radius) <= within and mu != ball.mu:
                name = name_of(model, "geom", ball.geom)
                losses.lose("friction", f"geom {name}: friction {ball.mu:g}, where another geom has {mu:g}")
                found[node] = (radius, max(mu, ball.mu))
            if ball.radius <= radius + within:
                continue
        lose_rims(model, ball.geom, ball.radius, losses)
        found[node] = (ball.radius, ball.mu)
    return found


def _one_radius(radii: list[float], within: float, losses: Losses) -> float:
    if not radii:
        return 0.0
    if max(radii) - min(radii) > within:
        losses.lose("radius", f"nodes touch the plane with radii from {min(radii):g} to {max(radii):g} m")
    return max(radii)


def _only_nodes(
    model: Any,
    balls: list[Touching],
    x: np.ndarray,
    carrier: np.ndarray,
    at: set[int],
    sizes: tuple[float, float],
    losses: Losses,
) -> None:
    """Nothing but nodes touches the plane, and every node that can reach it does; `carrier` is -1 of what is fixed."""
    radius, within = sizes
    corners = {body: x[[k for k in at if carrier[k] == body]] for body in set(carrier.tolist())}
    for ball in balls:
        inside = ball.radius <= radius + within and is_within(corners.get(ball.body), ball.centre, within)
        if not inside:
            lose_beside_sites(model, ball.geom, ball.centre, losses)
    for node in np.flatnonzero(carrier != -1):
        if not is_within(corners[int(carrier[node])], x[node], within):
            name, place = name_of(model, "body", int(carrier[node])), x[node].round(4).tolist()
            losses.lose("contact", f"body {name}: its site at {place} m touches nothing, but nodes touch the plane")


def is_within(corners: np.ndarray | None, place: np.ndarray, within: float) -> bool:
    """Whether a place is in the convex hull of `corners`."""
    if corners is None or not len(corners):
        return False
    away = (corners - place).T
    scale = max(float(np.abs(away).max()), within)
    return bool(nnls(np.vstack([away / scale, np.ones(len(corners))]), np.r_[0, 0, 0, 1.0])[1] * scale <= 2 * within)


def lift_of(n: np.ndarray, plane: np.ndarray, radius: float, x: np.ndarray, size: float, losses: Losses) -> np.ndarray:
    level = float(n @ plane) + radius
    deep = level - float((x @ n).min())
    if deep > SMALL * size:
        losses.lose("contact", f"the robot starts {deep:.4g} m inside the plane, and is pushed out of it")
    elif deep > 1e-12:
        losses.note(f"the robot starts {deep:.4g} m inside the plane; here it starts on it")
    away = level - max(deep, 0.0)
    if radius > 0:
        losses.note(
            f"what touches the plane has a radius of {radius:.4g} m: the plane is so much higher here, and nodes slide "
            "or stick on it where their balls would roll"
        )
    if abs(away) > 1e-12:
        losses.note(f"nodes are moved by {away:.4g} m against the plane's normal, onto a plane through the origin")
    return away * n
