"""The ground of a scene file's [ground] table."""

from pathlib import Path
from typing import Any

from jaxgrity.core.errors import InputError
from jaxgrity.io.scene_tables import GroundTable
from jaxgrity.model.balls import Balls
from jaxgrity.model.ground import ExactGround, Ground, PenaltyGround
from jaxgrity.model.structure import per_member
from jaxgrity.model.surface import Slope, Surface
from jaxgrity.model.unions import Union


def build_ground(table: GroundTable | None, folder: Path, balls: Balls | None) -> Ground | None:
    """The ground of a [ground] table; names of pictures are relative to the `folder`.

    Without a key of its own, the robot's `balls` touch it.

    Raises `InputError` for keys that contradict each other.
    """
    if table is None:
        return None
    incline, surface = table.incline, _surface(table, folder)
    if surface is not None and table.surface is None:
        incline = 0.0  # the plane is one of the surfaces then
    where: dict[str, Any] = {"surface": surface, "balls": _balls(table) or balls}
    if table.contact == "complementarity":
        if table.stiffness is not None or table.dissipation is not None:
            raise InputError(
                "ground.contact = 'complementarity' is no spring; expected neither stiffness nor dissipation"
            )
        return ExactGround(incline, table.restitution, **where)
    if table.stiffness is None:
        raise InputError("ground.stiffness: missing; expected a stiffness (N/m) for penalty contact")
    if table.restitution is not None:
        given = f"ground.restitution = {table.restitution}"
        raise InputError(f"{given} goes with contact = 'complementarity'; expected dissipation instead")
    return PenaltyGround(table.stiffness, table.dissipation or None, incline, **where)


def _balls(table: GroundTable) -> Balls | None:
    if table.balls is None:
        return None
    nodes = tuple(table.balls.nodes)
    return Balls(nodes, per_member(table.balls.radius, len(nodes), "ground.balls.radius"))


def _surface(table: GroundTable, folder: Path) -> Surface | None:
    """The surface in place of the plane, with its obstacles; None: the plane alone."""
    surface = None if table.surface is None else table.surface.surface(folder)
    if not table.obstacles:
        return surface
    return Union((surface or Slope(table.incline), *(obstacle.surface(folder) for obstacle in table.obstacles)))
