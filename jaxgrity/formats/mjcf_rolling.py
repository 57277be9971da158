"""What of the rigid bodies of a MuJoCo model touches its plane: balls with radii of their own, which roll."""

from typing import Any

import numpy as np

from jaxgrity.formats.compounds import spanning_points
from jaxgrity.formats.foreign import Losses, cone_of
from jaxgrity.formats.mjcf_bodies import inertia_of
from jaxgrity.formats.mjcf_contact import (
    SAME_PLACE,
    GroundFound,
    is_within,
    lift_of_balls,
)
from jaxgrity.formats.mjcf_joints import Shared, own_nodes
from jaxgrity.formats.mjcf_losses import largest_first, lose_beside_sites, lose_rims
from jaxgrity.formats.mjcf_touched import Touching, rod_geoms, what_touches
from jaxgrity.model.balls import Balls
from jaxgrity.model.bodies import FLAT
from jaxgrity.model.ground import ExactGround


def touched_by_balls(
    model: Any, data: Any, at: tuple[np.ndarray, np.ndarray], shared: list[Shared], many: list[int], losses: Losses
) -> GroundFound:
    """The plane, for the nodes and bodies `at`, of which `many` become rigid bodies: balls with radii of their own.

    Raises as `touched_plane` does.
    """
    x, carrier = at
    size = float(np.ptp(x, axis=0).max())
    within = SAME_PLACE * size
    touched = what_touches(model, data, size, losses)
    found: dict[int, Touching] = {}
    known = {*carrier.tolist(), *many} - {0}
    balls = [ball for ball in touched.balls if ball.body in known]
    for ball in _outermost(model, balls, within, not touched.solids, losses):
        own = own_nodes(carrier, shared, ball.body)
        node = int(own[np.argmin(np.linalg.norm(x[own] - ball.centre, axis=1))])
        if np.linalg.norm(x[node] - ball.centre) > within:
            if ball.body not in many:
                lose_beside_sites(model, ball.geom, ball.centre, losses)
                continue
            node, x, carrier = len(x), np.r_[x, ball.centre[None]], np.r_[carrier, ball.body]
        found[node] = ball
    rods = rod_geoms(model, data).values()
    for body in many:
        # a flat body has its points in its plane
        extents = np.linalg.eigvalsh(inertia_of(model, data, body)[2])
        if extents[0] <= FLAT * extents[-1]:
            continue
        # rods begin and end at nodes
        for end in (end for rod in rods if rod.body == body for end in rod.ends):
            if np.linalg.norm(x[own_nodes(carrier, shared, body)] - end, axis=1).min(initial=np.inf) > within:
                x, carrier = np.r_[x, end[None]], np.r_[carrier, body]
        more = spanning_points(x[own_nodes(carrier, shared, body)])
        x, carrier = np.r_[x, more], np.r_[carrier, np.full(len(more), body)]
    more, bodies = x[len(at[0]) :], carrier[len(at[0]) :]
    if not found:
        return GroundFound(None, None, np.zeros(3), more, bodies)
    radius = np.array([ball.radius for ball in found.values()])
    lift, n = lift_of_balls(data, touched.plane, x[list(found)], radius, size, losses)
    sizes = " to ".join(dict.fromkeys(f"{each:.4g}" for each in (radius.min(), radius.max())))
    losses.note(f"{len(found)} balls of {sizes} m touch the {'ground' if touched.solids else 'plane'}, and roll on it")
    losses.note("contact is exact, where MuJoCo's is soft")
    each = np.full(len(x), max(ball.mu for ball in found.values()))
    each[list(found)] = [ball.mu for ball in found.values()]
    ground = ExactGround(restitution=touched.bounce, balls=Balls(tuple(found), radius))
    along = {ball.geom: ball.radius for ball in balls if touched.solids or ball.body in many}
    turning = {node: ball.body for node, ball in found.items()}
    return GroundFound(ground, cone_of(each), lift, more, bodies, n, along, turning, touched.solids)


def _outermost(model: Any, balls: list[Touching], within: float, plane: bool, losses: Losses) -> list[Touching]:
    """The balls that no others of their bodies enclose: on a plane, all of these together; else, those of one geom."""
    kept: list[Touching] = []
    for ball in largest_first(model, balls):
        larger = [k for k in kept if k.body == ball.body and k.radius >= ball.radius - within]
        groups = [larger] if plane else [[k for k in larger if k.geom == geom] for geom in {k.geom for k in larger}]
        if any(is_within(np.array([k.centre for k in each]), ball.centre, within) for each in groups if each):
            continue
        lose_rims(model, ball.geom, ball.radius, losses)
        kept.append(ball)
    return kept
