"""A term that a scene does not have leaves no trace in the jaxpr of its vector field.

Each term has a mark: equations that only it adds, told by primitive, static parameters and shape. The mark must be
there in the scene with every term (else the test would look for the wrong thing) and gone without the term.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import equinox as eqx
import jax
import numpy as np
import pytest

from jaxgrity.model.actuation import Gait
from jaxgrity.model.friction import SmoothFriction, SwitchFriction
from jaxgrity.model.ground import PenaltyGround
from jaxgrity.model.scene import Scene
from jaxgrity.model.structure import Members, Structure
from jaxgrity.stepping.dynamics import vector_field

# Numbers of nodes, struts and cables differ, so that a shape says what an equation is about; the ground is inclined,
# so that its normal is not the direction of gravity.
NODES = np.random.default_rng(0).normal(size=(5, 3))
STRUTS = ((0, 1), (2, 3))
CABLES = ((0, 2), (1, 2), (3, 4))
UP = (0.0, 0.0, 1.0)
STRUT_SPRINGS = Members(STRUTS, np.ones(2), np.ones(2), np.ones(2))
CABLE_SPRINGS = Members(CABLES, np.ones(3), np.ones(3), np.ones(3))
GROUND = PenaltyGround(1e4, 2.0, 0.3)
SMOOTH, SWITCH = SmoothFriction(0.5, 0.01), SwitchFriction(0.6, 0.5, 0.01)


def full(**changes):
    """A scene with every term, smooth friction and a gait on both kinds of members, but for `changes`."""
    parts = dict(
        struts=STRUT_SPRINGS,
        cables=CABLE_SPRINGS,
        gravity=9.81,
        node_damping=np.ones(5),
        ground=GROUND,
        friction=SMOOTH,
        gait=Gait((1, 3), np.zeros(2), np.full(2, 0.5), np.ones(2)),
    )
    parts |= changes
    structure = Structure(NODES, np.ones(5), parts.pop("struts"), parts.pop("cables"))
    return Scene(structure, **parts)


def nothing(**parts):
    """Free point masses, and `parts`."""
    absent = dict.fromkeys(["struts", "cables", "gravity", "node_damping", "ground", "friction", "gait"])
    return full(**(absent | parts))


def undamped(members):
    return Members(members.edges, members.stiffness, members.rest_length)


@dataclass
class Equation:
    """One equation of a jaxpr: its primitive, its static parameters, the shapes of its operands, their use of v."""

    primitive: str
    params: dict
    shapes: list
    of_velocity: bool


def equations(scene: Scene) -> list[Equation]:
    """Every equation of the vector field, inner jaxprs included; the scene's numbers are inputs, not constants."""
    state = (np.asarray(scene.structure.nodes), np.zeros((5, 3)))
    closed = jax.make_jaxpr(vector_field)(np.asarray(0.0), state, scene)
    assert [x.aval.shape for x in closed.jaxpr.invars[:3]] == [(), (5, 3), (5, 3)]
    velocity = [k == 2 for k in range(len(closed.jaxpr.invars))]
    return list(_walk(closed.jaxpr, velocity))


def _walk(jaxpr, of_velocity: list[bool]) -> Iterator[Equation]:
    marked = {x for x, depends in zip(jaxpr.invars, of_velocity) if depends}
    for eqn in jaxpr.eqns:
        depends = [not hasattr(x, "val") and x in marked for x in eqn.invars]
        yield Equation(eqn.primitive.name, eqn.params, [x.aval.shape for x in eqn.invars], any(depends))
        for inner in _inner_jaxprs(eqn.params):
            same = len(inner.invars) == len(depends)
            yield from _walk(inner, depends if same else [any(depends)] * len(inner.invars))
        if any(depends):
            marked.update(eqn.outvars)


def _inner_jaxprs(params: dict) -> Iterator:
    for value in params.values():
        jaxpr = getattr(value, "jaxpr", value)
        if hasattr(jaxpr, "eqns"):
            yield jaxpr


def along(*directions):
    return lambda e: e.params.get("direction") in directions


def joins(edges):
    return lambda e: set(edges) <= set(e.params.get("edges", ()))


def rates(edges):
    return lambda e: joins(edges)(e) and e.primitive == "edge_difference" and e.of_velocity


ABSENT = {
    "struts": (full(struts=None, gait=None), joins(STRUTS)),
    "cables": (full(cables=None, gait=None), joins(CABLES)),
    "strut damping": (full(struts=undamped(STRUT_SPRINGS)), rates(STRUTS)),
    "cable damping": (full(cables=undamped(CABLE_SPRINGS)), rates(CABLES)),
    "gravity": (full(gravity=None), along(UP)),
    "node damping": (full(node_damping=None), lambda e: e.primitive == "dot" and (5, 3) in e.shapes),
    "contact": (full(ground=None, friction=None), along(GROUND.normal)),
    "contact dissipation": (
        full(ground=PenaltyGround(1e4, None, 0.3)),
        lambda e: along(GROUND.normal)(e) and e.primitive == "component" and e.of_velocity,
    ),
    "smooth friction": (full(friction=None), along(*GROUND.tangents)),
    "gait": (full(gait=None), lambda e: e.primitive in ("sin", "clamp")),
}


@pytest.mark.parametrize("term", ABSENT)
def test_absent_term_leaves_no_trace(term):
    without, is_mark = ABSENT[term]
    marks = [e for e in equations(full()) if is_mark(e)]
    left = [e for e in equations(without) if is_mark(e)]
    assert marks
    assert not left


@pytest.mark.parametrize("friction", [None, SMOOTH], ids=["no friction", "smooth friction"])
def test_absent_switch_leaves_no_trace(friction):
    def is_mark(e):
        return e.primitive in ("lt", "le") and e.of_velocity

    assert any(is_mark(e) for e in equations(full(friction=SWITCH)))
    assert not any(is_mark(e) for e in equations(full(friction=friction)))


def test_switch_without_smooth_friction_has_no_dissipation_function():
    """With the switch as its only term that resists motion, a scene evaluates no R: nothing sums over velocities."""

    def is_mark(e):
        return e.primitive == "inner" and e.of_velocity

    assert any(is_mark(e) for e in equations(nothing(ground=PenaltyGround(1e4), friction=SMOOTH)))
    assert not any(is_mark(e) for e in equations(nothing(ground=PenaltyGround(1e4), friction=SWITCH)))


TERMS = {
    "struts": (nothing(), nothing(struts=undamped(STRUT_SPRINGS))),
    "cables": (nothing(), nothing(cables=undamped(CABLE_SPRINGS))),
    "strut damping": (nothing(struts=undamped(STRUT_SPRINGS)), nothing(struts=STRUT_SPRINGS)),
    "cable damping": (nothing(cables=undamped(CABLE_SPRINGS)), nothing(cables=CABLE_SPRINGS)),
    "gravity": (nothing(), nothing(gravity=9.81)),
    "node damping": (nothing(), nothing(node_damping=np.ones(5))),
    "contact": (nothing(), nothing(ground=PenaltyGround(1e4))),
    "contact dissipation": (nothing(ground=PenaltyGround(1e4)), nothing(ground=PenaltyGround(1e4, 2.0))),
    "smooth friction": (nothing(ground=PenaltyGround(1e4)), nothing(ground=PenaltyGround(1e4), friction=SMOOTH)),
    "switch": (nothing(ground=PenaltyGround(1e4)), nothing(ground=PenaltyGround(1e4), friction=SWITCH)),
    "gait": (
        nothing(struts=undamped(STRUT_SPRINGS)),
        nothing(struts=undamped(STRUT_SPRINGS), gait=Gait((1,), np.zeros(1), np.full(1, 0.5), np.ones(1))),
    ),
}


@pytest.mark.parametrize("term", TERMS)
def test_term_adds_its_equations_and_takes_none_away(term):
    without, having = (Counter(e.primitive for e in equations(scene)) for scene in TERMS[term])
    # the zero force of a scene without any
    del without["broadcast_in_dim"], having["broadcast_in_dim"]
    assert having > without


CONSERVATIVE = ["struts", "cables", "gravity", "contact", "gait"]


@pytest.mark.parametrize("term", TERMS)
def test_velocity_enters_only_through_terms_that_resist_motion(term):
    without, having = TERMS[term]
    assert any(e.of_velocity for e in equations(having)) == (term not in CONSERVATIVE)
    if term in CONSERVATIVE:
        assert not any(e.of_velocity for e in equations(without))


def test_free_point_masses_compute_nothing():
    """No force: the program sets zero, negates it and divides by the masses."""
    found = Counter(e.primitive for e in equations(nothing()))
    assert found == Counter(["broadcast_in_dim", "neg", "div", "scale"])


def test_zero_is_not_absence():
    """The marks tell a term that is compiled in with a zero from one that is not: g = 0 leaves a trace."""
    scene = eqx.tree_at(lambda s: s.gravity, full(), np.asarray(0.0))
    assert any(ABSENT["gravity"][1](e) for e in equations(scene))
