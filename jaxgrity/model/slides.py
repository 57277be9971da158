"""Nodes that slide without friction along a line: of a strut, rigid or not, or between two points of a rigid body.

A node at p slides along the line from a to b. With u along the line, and n_1 and n_2 across it,

    n_k·e = 0,    e = p - (1 - s) a - s b,    s = u·(p - a)/u·(b - a).

The forces are across the line, with the weights of e: they have neither a sum nor a moment, and do no work where the
node slides, or the line changes its length.
"""

from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.arguments import is_count
from jaxgrity.core.errors import InputError
from jaxgrity.core.tracing import evaluated
from jaxgrity.core.types import AnyArray, Edges, NodeVectors
from jaxgrity.model.laws import Constraint, rows_on_nodes
from jaxgrity.model.structure import Structure
from jaxgrity.model.surface import frame_about, frame_axes


class Slides(Constraint):
    """Nodes that slide without friction along lines through two other nodes: see docs/design.md.

    A line joins both ends of a strut, or two points of one rigid body. It has no ends: a node may slide beyond them.

    Raises `InputError` for nodes that are no whole numbers, or a slide that is given twice.

    Example:
        >>> nodes = [[0.0, 0, 1], [1, 0, 0], [0.25, 0, 0.75]]
        >>> rail = jaxgrity.Members(((0, 1),), [1e4], [2**0.5])
        >>> structure = jaxgrity.Structure(nodes, [0.0, 0.0, 1.0], rail, fixed=((0, "xyz"), (1, "xyz")))
        >>> scene = jaxgrity.Scene(structure, gravity=9.81, terms=(jaxgrity.model.Slides((2,), ((0, 1),)),))
        >>> motion = jaxgrity.simulate(scene, 0.2, options=jaxgrity.SolverOptions(dt=0.01))
        >>> round(float(motion.positions[-1, 2, 0]), 4)  # m: x falls by g/2 t^2/2 on the rail at 45 degrees
        0.3481
    """

    nodes: tuple[int, ...] = eqx.field(static=True, converter=tuple)
    """the nodes that slide"""
    along: Edges = eqx.field(static=True, converter=lambda pairs: tuple(map(tuple, pairs)))
    """the two nodes of each one's line"""
    name: ClassVar[str] = "sliding nodes"

    def __check_init__(self):
        if not self.nodes or len(self.nodes) != len(self.along) or any(len(pair) != 2 for pair in self.along):
            raise InputError(f"slides: nodes = {self.nodes}, along = {self.along}: expected two nodes for each node")
        for node, pair in zip(self.nodes, self.along):
            if not all(is_count(k, 0) for k in (node, *pair)) or len({node, *pair}) < 3:
                raise InputError(f"slides: node {node} along {list(pair)}: expected three different nodes, from 0 on")
        if len({(node, frozenset(pair)) for node, pair in zip(self.nodes, self.along)}) < len(self.nodes):
            raise InputError(f"slides: nodes = {self.nodes}, along = {self.along}: expected each slide once")

    def check(self, nodes):
        for k in (*self.nodes, *(k for pair in self.along for k in pair)):
            if k >= nodes:
                raise InputError(f"slides name node {k}; expected 0 to {nodes - 1}")

    def keeps(self, symmetry):
        slides = {(node, frozenset(pair)) for node, pair in zip(self.nodes, self.along)}
        moved = {(symmetry.nodes[k], frozenset(symmetry.nodes[end] for end in pair)) for k, pair in slides}
        return moved == slides

    def directions(self, q, size):
        lines = known_lines(self, q)
        nodes = np.array([(k, *pair) for k, pair in zip(self.nodes, self.along)]).repeat(2, axis=0)
        each = np.take_along_axis(lines.weights, nodes, axis=1)
        return rows_on_nodes(each[:, :, None] * lines.across[:, None], nodes, q.size)

    def offsets(self, q: NodeVectors) -> AnyArray:
        """(slides, 3), m: from its line to each node at `q`, across the line."""
        return off_line(*(q[np.array(nodes)] for nodes in (self.nodes, *zip(*self.along))))

    def gaps(self, q, t):
        off = self.offsets(q)
        return (off * off).sum(1) ** 0.5 if isinstance(q, np.ndarray) else jnp.sqrt((off * off).sum(1))

    def complaint(self, q, t, part):
        off, pair = self.gaps(np.asarray(q, float), t)[part], list(self.along[part])
        return f"node {self.nodes[part]} starts {off:.3g} m beside the line through nodes {pair}; expected on it"


class Lines(NamedTuple):
    """The constraints of sliding nodes at some place, two rows for each node: across·(weights @ q) = 0."""

    weights: AnyArray
    """(rows, nodes), of e"""
    across: AnyArray
    """(rows, 3), n_1 and n_2"""
    along: AnyArray
    """(rows, 3), u"""
    ends: np.ndarray
    """(rows, nodes), weights of b - a"""
    line: AnyArray
    """(rows, 3), m, b - a"""


def off_line(node: AnyArray, first: AnyArray, last: AnyArray) -> AnyArray:
    """(..., 3), m: from the line through two places to a third one, across the line."""
    line, to = last - first, node - first
    return to - ((line * to).sum(-1) / (line * line).sum(-1))[..., None] * line


def slides_of(scene: Any) -> Slides | None:
    """The sliding nodes of a scene."""
    return next((law for law in scene.terms if isinstance(law, Slides)), None)


def lines_at(slides: Slides, q: NodeVectors) -> Lines:
    """The constraints where nodes are at q, m."""
    (first, last), unit = map(list, zip(*slides.along)), np.eye(len(q), dtype=q.dtype)
    ends = unit[last] - unit[first]
    line = q[np.array(last)] - q[np.array(first)]
    size = jnp.sqrt(jnp.sum(line * line, axis=1, keepdims=True))
    u = line / size
    share = jnp.sum(u * (q[np.array(slides.nodes)] - q[np.array(first)]), axis=1, keepdims=True) / size
    weights = unit[list(slides.nodes)] - unit[first] - share * ends
    across = frame_axes(frame_about(u[:, 0], u[:, 1], u[:, 2]))[:, 1:].reshape(-1, 3)
    twice = np.arange(len(first)).repeat(2)
    return Lines(weights[twice], across, u[twice], ends[twice], line[twice])


def known_lines(slides: Slides, q: np.ndarray) -> Lines:
    """`lines_at` known positions q, m, as arrays of NumPy in float64."""
    with jax.enable_x64(True), evaluated():
        return Lines(*map(np.asarray, lines_at(slides, jnp.asarray(np.asarray(q, float)))))


def check_no_slides(scene: Any, what: str) -> None:
    """Raises `InputError` where nodes slide, which `what` does not know."""
    if (slides := slides_of(scene)) is not None:
        raise InputError(
            f"{what}: knows no sliding nodes yet, here {list(slides.nodes)}; expected a scene without [[slides]]: let "
            "their cables end at nodes of the lines instead"
        )


def check_slides(scene: Any) -> None:
    """Raises `InputError` for lines that neither a strut nor a rigid body has, and for nodes that cannot slide."""
    laws = [law for law in scene.terms if isinstance(law, Slides)]
    if len(laws) > 1:
        raise InputError(f"terms have {len(laws)} laws of sliding nodes; expected one with all of these nodes")
    for law in laws:
        for node, pair in zip(law.nodes, law.along):
            _check_line(scene.structure, node, pair)


def _check_line(structure: Structure, node: int, pair: tuple[int, int]) -> None:
    struts = () if structure.struts is None else structure.struts.edges
    bodies = [body.points for body in structure.bodies if set(pair) <= set(body.points)]
    where = f"slides: node {node} along {list(pair)}"
    if not bodies and not any({*pair} == {*edge} for edge in struts):
        raise InputError(
            f"{where}: no strut or rigid body joins nodes {list(pair)}; expected both ends of a strut, or two points "
            "of one body"
        )
    if any(node in points for points in bodies):
        raise InputError(f"{where}: all three are points of one rigid body, which cannot slide; expected another node")
