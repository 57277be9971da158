"""What loads do to a structure: displacements, forces, reactions, margins, and what fails first."""

from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from jaxgrity.core.arguments import check_number
from jaxgrity.core.display import in_digits
from jaxgrity.core.errors import InputError
from jaxgrity.core.tracing import refuse_traced
from jaxgrity.core.typed import typed
from jaxgrity.core.types import NodeVectors, PerMember
from jaxgrity.model.laws import EnergyTerm
from jaxgrity.model.load_cases import LoadCase, check_load_cases
from jaxgrity.model.scene import Scene
from jaxgrity.model.slides import Slides
from jaxgrity.model.structure import Structure
from jaxgrity.statics.equilibrium import resting_shape
from jaxgrity.statics.load_paths import LoadPath, PathPoint
from jaxgrity.statics.responses import static_response, tensions_at
from jaxgrity.statics.strength import force_words, strength_of

SLACK, YIELDS, BUCKLES = "goes slack", "yields", "buckles"
"""What happens to a member."""
SNAPS, DIVERGES = "snaps through", "loses its stability"
"""What happens to a structure: no equilibrium under more load is near, or the equilibria go on, but are unstable."""
FIRST_LOADS = 1e-3
"""Share of the loads under which a path begins where the structure without loads is loose."""
LEVEL = 1e-9
"""Relative rise of the load over the step in which stability is lost, up to which the load counts as at its peak."""


class LoadEvent(NamedTuple):
    """Something that happens as the loads grow."""

    factor: float
    """load factor at which it happens"""
    what: str
    """what happens: a member goes slack, yields or buckles, the structure snaps through or loses its stability"""
    where: int
    """number of the member, struts first; of the structure, the node that moves most"""

    def words(self, structure: Structure) -> str:
        """The event in words."""
        whole = self.what in (SNAPS, DIVERGES)
        who = f"the structure (most of all node {self.where})" if whole else _member(structure, self.where)
        return f"{who} {self.what} at {in_digits(self.factor, 4)} times the loads"


class LoadReport(NamedTuple):
    """The result of `load_report`."""

    name: str
    structure: Structure
    shape: NodeVectors
    """m, the equilibrium under the whole loads"""
    displacement: NodeVectors
    """m, from the shape at rest to `shape`"""
    forces: PerMember
    """N in `shape`, tension positive, struts first"""
    reactions: NodeVectors
    """N, forces of supports in `shape`"""
    margins: PerMember
    """strength of each member, its yield force or Euler's load, over its force in `shape`; infinite without either"""
    linear: tuple[LoadEvent, ...]
    """the first event of each kind by the response to small loads"""
    path: tuple[LoadEvent, ...]
    """the same along the equilibria under growing loads, and the loss of stability; the earliest first"""
    reached: float
    """load factor up to which equilibria were followed"""

    @property
    def slack(self) -> tuple[int, ...]:
        """Cables, from 0, without tension under the whole loads."""
        return tuple(np.flatnonzero(self.forces[self.structure.first_cable :] <= 0).tolist())

    def table(self) -> str:
        """The report in words, a line for each fact."""
        moved, held = (np.linalg.norm(x, axis=1) for x in (self.displacement, self.reactions))
        weakest = int(np.argmin(self.margins))
        known = bool(np.isfinite(self.margins[weakest]))
        lines = [
            ("load case", self.name),
            ("displacement", f"up to {in_digits(moved.max(), 4)} m (node {int(moved.argmax())})"),
            ("forces", force_words(self.structure, self.forces)),
            ("reactions", f"up to {in_digits(held.max(), 4)} N (node {int(held.argmax())})"),
            ("slack cables", ", ".join(map(str, self.slack)) or "none"),
            (
                "smallest margin",
                f"{in_digits(self.margins[weakest], 4)}, of {_member(self.structure, weakest)}" if known else "",
            ),
            *zip(["by small loads", *[""] * len(self.linear)], (event.words(self.structure) for event in self.linear)),
            *zip(["by growing loads", *[""] * len(self.path)], (event.words(self.structure) for event in self.path)),
            ("followed", f"up to {in_digits(self.reached, 4)} times the loads"),
        ]
        return "\n".join(f"{name:<20} {text}" for name, text in lines if text)

    def summary(self) -> dict[str, Any]:
        """The same as numbers, for JSON."""
        plain = {name: value for name, value in self._asdict().items() if name not in ("structure", "linear", "path")}
        events = {name: [event._asdict() for event in getattr(self, name)] for name in ("linear", "path")}
        return {**plain, "margins": [m if np.isfinite(m) else None for m in self.margins.tolist()], **events}


@typed
def load_report(scene: Scene, case: LoadCase | str, most: float = 10.0) -> LoadReport:
    """What a load case does to a structure, at small and at large displacement.

    The structure is at rest first, without ground, and with gravity where it has supports. Then the loads grow, up to
    `most` times the whole loads, or until the structure loses its stability. Members stay elastic throughout: beyond
    the first failure the path is that of stronger members of the same stiffness. A structure that snaps through before
    the whole loads act is reported where it lands. A structure that only the loads make taut begins under 0.001 of
    them.

    Args:
        scene: the structure, with supports that hold it. Members without strength do not fail.
        case: the loads, or the name of one of the scene's load cases.
        most: the load factor up to which equilibria are followed.

    Returns:
        Displacements, forces, reactions and margins under the whole loads, and the load factors of what happens first.

    Raises:
        InputError: an unknown case, a structure that does not resist every motion, or no equilibrium under the loads.

    Example:
        >>> import numpy as np
        >>> structure = jaxgrity.Structure([[0, 0, 0], [0, 0, 1.0]], [0, 0], fixed=((0, "xyz"), (1, "xy")),
        ...     struts=jaxgrity.model.sized_members(((0, 1),), np.ones(1), "steel", diameter=0.01))
        >>> down = jaxgrity.model.LoadCase("down", (1,), [[0, 0, -500.0]])
        >>> report = jaxgrity.statics.load_report(jaxgrity.Scene(structure), down)
        >>> report.linear[0].words(structure)
        'strut 0 buckles at 2.035 times the loads'
    """
    refuse_traced((scene, case), "load_report", "`equilibrium_near` has derivatives of a shape")
    check_number("most", most, least=1.0)
    case = _case(scene, case)
    structure, where = scene.structure, f"load case {case.name!r}"
    terms = tuple(term for term in scene.terms if isinstance(term, (EnergyTerm, Slides)))
    g = scene.gravity if structure.fixed else None
    alone = Scene(structure, gravity=g, up=scene.up, terms=terms, loads=(case,))
    loads = case.on_nodes(len(structure.nodes))
    try:
        rest = np.asarray(resting_shape(alone).q)
        path = _path(alone, rest, loads)
        change = static_response(alone, path.start.q, loads).force_change
        small = _small_events(structure, path.start, tensions_at(alone, path.start.q), change)
        points, events = _follow(alone, path, most)
        found = resting_shape(alone, _under_whole_loads(path, points).q, loads)
    except InputError as error:
        raise InputError(f"{where}: {error}") from error
    shape, forces = np.asarray(found.q), tensions_at(alone, found.q)
    margins = strength_of(structure, shape).margins(forces)
    reached = max(point.factor for point in points)
    return LoadReport(
        case.name, structure, shape, shape - rest, forces, found.reactions, margins, small, events, reached
    )


def _member(structure: Structure, number: int) -> str:
    first = structure.first_cable
    return f"strut {number}" if number < first else f"cable {number - first}"


def _case(scene: Scene, case: LoadCase | str) -> LoadCase:
    if isinstance(case, LoadCase):
        check_load_cases((case,), len(scene.structure.nodes))
        return case
    known = {each.name: each for each in scene.loads}
    if case not in known:
        expected = f"expected one of {', '.join(known)}" if known else "the scene has none; expected [[loads]] in it"
        raise InputError(f"case = {case!r}: unknown; {expected}")
    return known[case]


def _under_whole_loads(path: LoadPath, points: list[PathPoint]) -> PathPoint:
    """The point of the path at load factor 1, or the last one where it ends before."""
    for before, after in pairwise(points):
        if after.factor >= 1:
            return path.at(1.0, before, after)
    return points[-1]


def _path(scene: Scene, rest: np.ndarray, loads: np.ndarray) -> LoadPath:
    """The path from rest on, or from under a share of the loads where only these make the structure taut."""
    try:
        return LoadPath(scene, rest, loads)
    except InputError as error:
        try:
            return LoadPath(scene, resting_shape(scene, rest, FIRST_LOADS * loads).q, loads, FIRST_LOADS)
        except InputError:
            raise error from None


def _small_events(
    structure: Structure, start: PathPoint, tension: PerMember, change: PerMember
) -> tuple[LoadEvent, ...]:
    """The first event of each kind if forces change in proportion to the loads."""
    upper, lower, buckles = strength_of(structure, start.q)
    cables = np.arange(len(tension)) >= structure.first_cable
    floor = np.where(cables, 0.0, -lower)
    with np.errstate(divide="ignore", invalid="ignore"):
        up = np.where(change > 0, (upper - tension) / change, np.inf)
        down = np.where((change < 0) & (tension > floor), (floor - tension) / change, np.inf)
    up, down = np.where(tension > upper, 0, up), np.where(tension < floor, 0, down)  # what has failed before
    factors = {
        SLACK: np.where(cables, down, np.inf),
        YIELDS: np.minimum(up, np.where(cables | buckles, np.inf, down)),
        BUCKLES: np.where(cables | ~buckles, np.inf, down),
    }
    least = {what: start.factor + float(x.min()) for what, x in factors.items()}
    found = [LoadEvent(least[what], what, int(x.argmin())) for what, x in factors.items()]
    return tuple(sorted(event for event in found if np.isfinite(event.factor)))


def _within(happened: Callable[[PathPoint], dict[str, np.ndarray]], what: str, point: PathPoint) -> bool:
    return what in happened(point)


def _follow(scene: Scene, path: LoadPath, most: float) -> tuple[list[PathPoint], tuple[LoadEvent, ...]]:
    """Points of the path, and the first event of each kind, as far as `load_report` says."""
    structure = scene.structure
    cables = np.arange(structure.member_count) >= structure.first_cable
    tight = cables & (tensions_at(scene, path.start.q) > 0)

    def happened(point: PathPoint) -> dict[str, np.ndarray]:
        """The members that are slack, yield or buckle."""
        tension = tensions_at(scene, point.q)
        upper, lower, buckles = strength_of(structure, point.q)
        crushed = ~cables & (-tension > lower)
        found = {SLACK: tight & (tension <= 0), YIELDS: (tension > upper) | (crushed & ~buckles)}
        return {what: np.flatnonzero(x) for what, x in (found | {BUCKLES: crushed & buckles}).items() if x.any()}

    points: list[PathPoint] = []
    events: dict[str, LoadEvent] = {}
    for point in path.points():
        points.append(point)
        for what in happened(point).keys() - events.keys():
            has = partial(_within, happened, what)
            at = path.between(points[-2], point, has) if points[1:] else point
            events[what] = LoadEvent(at.factor, what, int(happened(at)[what][0]))
        if not point.stable:
            at = path.between(points[-2], point, lambda x: not x.stable)
            moved = np.linalg.norm(point.q - points[-2].q, axis=1)
            what = DIVERGES if point.factor > at.factor * (1 + LEVEL) else SNAPS
            events[what] = LoadEvent(at.factor, what, int(moved.argmax()))
            points[-1] = at
        if not point.stable or point.factor >= most:
            break
    return points, tuple(sorted(events.values()))
