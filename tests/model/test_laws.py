"""The laws of a scene: all that there are can act and are listed, and all else that is known follows from the list."""

import dataclasses
import inspect
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrity import (
    METHODS,
    ConeFriction,
    DissipationTerm,
    EnergyTerm,
    ExactGround,
    ForceLaw,
    ForceLimit,
    ForceTable,
    InputError,
    Law,
    Push,
    Scene,
    SolverOptions,
    Structure,
    SwitchFriction,
    Wind,
    describe,
    energy_audit,
    force_limit,
    force_table,
    simulate,
    wind,
    with_contact_along_struts,
    with_gait,
    with_terms,
)
from jaxgrity.model import (
    Friction,
    Ground,
    Pulley,
    cable_dampers,
    commanded_pull,
    dead_band,
    polynomial_stiffness,
    rigid_body,
    standing_symmetries,
    symmetries,
    with_contact_between_struts,
)
from jaxgrity.model.dissipation import CapstanFriction
from jaxgrity.model.force_laws import CableDampers, DeadBand
from jaxgrity.model.friction import CoulombCone
from jaxgrity.model.hinges import HingeDampers, HingeSprings
from jaxgrity.model.law_symmetry import looks_alike
from jaxgrity.model.laws import Constraint
from jaxgrity.model.pulls import CommandedPull
from jaxgrity.model.rod_contact import ALONG_STRUTS
from jaxgrity.model.scene import KNOWN_FRICTIONS, KNOWN_LAWS
from jaxgrity.model.slides import Slides
from jaxgrity.model.stiffening import PolynomialStiffness
from jaxgrity.model.strut_contact import BETWEEN_STRUTS
from jaxgrity.stepping import limiting_part, standing
from jaxgrity.stepping.step_limits import part_shares
from jaxgrity.structures import prism_tower


def concrete(interface: type) -> set[type]:
    """The classes of the library that implement an interface, but for what a module or statics keeps to itself."""
    found, left = set(), [interface]
    while left:
        kind = left.pop()
        left += kind.__subclasses__()
        module, name = kind.__module__, kind.__name__
        known = module.startswith("jaxgrity.") and not module.startswith("jaxgrity.statics.") and name[0] != "_"
        if known and not inspect.isabstract(kind) and not _lacks_attributes(kind):
            found.add(kind)
    return found


def _lacks_attributes(kind: type) -> bool:
    """Whether class attributes that an interface asks for are not there."""
    return any("AbstractClassVar" in str(getattr(base, "__annotations__", {}).get(name)) and not hasattr(kind, name)
               for base in kind.__mro__ for name in getattr(base, "__annotations__", {}))  # fmt: skip


@pytest.fixture(scope="module")
def scenes(reference, exact):
    """Between them they have everything."""
    switch = eqx.tree_at(lambda s: s.friction, reference, SwitchFriction(0.6, 0.4, 1e-3))
    hinges = ((0, 4, 5, 8), (1, 2, 3, 9))
    hinged = with_terms(exact, HingeSprings(hinges, [1.0, 2.0], [0.1, 0.2]), HingeDampers(hinges, [0.1, 0.1]))
    pushed = with_terms(exact, wind([2.0, 0, 0], 0.01, 12), Push((0,), [[1.0, 0, 0]], 0.1, 0.1))
    cables = exact.structure.cables
    laced = with_terms(exact, force_table(cables, [0.0, 0.1, 0.2], [0.0, 60.0, 180.0]), force_limit(cables, 200.0))
    laced = with_terms(laced, dead_band(cables, 0.1), cable_dampers(cables, 1.0), commanded_pull(cables, 5.0, 9.0))
    laced = with_terms(laced, polynomial_stiffness(cables, 2.0, 5.0))
    payload = rigid_body(exact.structure.nodes, (0, 1, 4, 5, 8), 2.0, [0.1, 0.1, 0.1])
    loaded = eqx.tree_at(lambda s: s.structure.bodies, exact, (payload,))
    touching = with_contact_between_struts(with_contact_along_struts(reference, 2), 0.01)
    sliding = with_terms(reference, Slides((2,), ((0, 1),)))
    pulley = Pulley((0, 16), 0.01, (0.0, 0.0, 1.0), mu=0.3, slip_speed=0.01)
    over = dataclasses.replace(reference.structure.cables, clusters=((0, 16),), pulleys=(pulley,))
    rough = eqx.tree_at(lambda s: s.structure.cables, reference, over)
    return (
        sliding,
        hinged,
        reference,
        exact,
        switch,
        pushed,
        laced,
        touching,
        rough,
        with_contact_between_struts(loaded, 0.01),
    )


def test_every_law_of_the_library_is_known():
    """To `describe`, which names those that do not act: each that ground and structure have, and each of friction.

    Forces from outside, contact between nodes, and laws of cables that take another one's place are known where they
    act.
    """
    laws = concrete(Law)
    assert len(laws) > 10
    pairs = *ALONG_STRUTS, *BETWEEN_STRUTS
    known = {
        *KNOWN_LAWS,
        Wind,
        Push,
        ForceTable,
        ForceLimit,
        DeadBand,
        CableDampers,
        CommandedPull,
        PolynomialStiffness,
    }
    known |= {Slides, HingeSprings, HingeDampers, *pairs}
    assert {law for law in laws if law not in known and law.name not in {f.name for f in KNOWN_FRICTIONS}} == set()
    assert set(KNOWN_LAWS) <= laws
    assert concrete(Friction) == set(KNOWN_FRICTIONS)
    assert len({law.name for law in laws}) == len(laws)


def test_every_law_of_the_library_acts_somewhere(scenes):
    """A law that no scene brings in is dead; one that acts is of the library."""
    assert {type(law) for scene in scenes for law in scene.laws} == concrete(Law)
    assert {type(scene.ground) for scene in scenes} == concrete(Ground)
    assert {type(scene.friction) for scene in scenes} == concrete(Friction)


@pytest.mark.slow
def test_scenes_describe_every_law_that_acts(scenes):
    """Under "modelled", and all others under "not modelled", but for friction on pulleys, which few scenes have."""
    names = {kind.name for kind in (*KNOWN_LAWS, *KNOWN_FRICTIONS) if kind is not CapstanFriction}
    for scene in scenes:
        lines = describe(scene).splitlines()
        modelled, absent = (set(line[20:].strip().split(", ")) for line in lines[:2])
        acting = {law.name for law in scene.laws}
        assert modelled == acting | {"gait"}
        assert absent == names - acting


class WindDrag(DissipationTerm):
    """R = sum c/2 |v - w|^2: the air moves at w, and drags the nodes along."""

    coefficient: np.ndarray
    wind: tuple[float, float, float] = eqx.field(static=True, default=(0.0, 0.0, 0.0))
    name: ClassVar[str] = "wind drag"
    cause: ClassVar[str] = "wind"

    def dissipation(self, motion):
        through_air = motion.v - jnp.asarray(self.wind)
        return jnp.sum(self.coefficient[:, None] / 2 * through_air**2)


class Tether(EnergyTerm):
    """U = k/2 |x_0|^2: a spring from node 0 to the origin."""

    stiffness: np.ndarray
    name: ClassVar[str] = "tether"

    def energy(self, at):
        return self.stiffness[0] / 2 * jnp.sum(at.q[0] ** 2)


class Lift(ForceLaw):
    """A force on all nodes against their vertical motion; it is booked with the wind."""

    force_on_each: np.ndarray
    name: ClassVar[str] = "lift"
    cause: ClassVar[str] = "wind"

    def force(self, motion, other_forces):
        return -self.force_on_each * jnp.tanh(motion.v) * jnp.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def prism():
    """A free prism without any dissipation, whose struts and cables alone act."""
    scene = prism_tower(3, exact=False)
    structure = eqx.tree_at(lambda s: s.cables.damping, scene.structure, None)
    return Scene(structure)


DRAG = WindDrag(np.full(6, 2.0), (1.0, 0.0, 0.0))


def test_what_a_scene_knows_of_itself_follows_from_its_laws(prism):
    """A term of one's own is described, and makes a scene dissipate that did not."""
    windy = with_terms(prism, DRAG)
    assert not prism.dissipates
    assert windy.dissipates
    assert with_terms(prism, Lift(np.ones(()))).dissipates
    assert not with_terms(prism, Tether(np.ones(1))).dissipates
    lines = describe(windy).splitlines()
    assert "wind drag" in lines[0]
    assert "wind drag" not in lines[1]
    with pytest.raises(InputError, match="without dissipation; this one has damping or friction"):
        simulate(windy, 0.1, options=SolverOptions(method="verlet"))


def test_symmetries_ask_every_law(prism):
    """Wind along the prism's axis leaves its turns, wind across it or a tether at one node none of them."""
    assert len(standing_symmetries(prism)) == 6
    along = WindDrag(np.full(6, 2.0), (0.0, 0.0, 1.0))
    assert len(standing_symmetries(with_terms(prism, along))) == 3
    for term in (DRAG, Tether(np.ones(1))):
        assert len(standing_symmetries(with_terms(prism, term))) == 1


def test_a_law_without_a_rule_is_compared_at_states_that_it_acts_in(prism):
    """A force, one of short range, one that begins late; of what is never seen to act, the identity alone is kept."""

    class Late(Tether):
        def energy(self, at):
            return super().energy(at) * jnp.maximum(at.t - 5.0, 0)

        def bends(self):
            return np.array([0.0, 5.0, 5.1])

    class Soft(Tether):
        def energy(self, at):
            return jnp.sum(jnp.maximum(1e-2 - jnp.linalg.norm(at.q - at.scene.structure.nodes, axis=1), 0))

    class Never(Tether):
        def energy(self, at):
            return 0 * super().energy(at)

    turns = [3 if prism.gravity else 6, 1, 6, 1]
    for term, count in zip((Lift(np.ones(())), Late(np.ones(1)), Soft(np.ones(1)), Never(np.ones(1))), turns):
        assert len(standing_symmetries(with_terms(prism, term))) == count, term


@pytest.mark.slow
def test_rules_of_symmetry_say_what_random_states_say(scenes):
    """What a rule allows is seen at all states; and on each scene all laws together leave the same."""
    uneven = eqx.tree_at(lambda s: s.structure.cables.damping, scenes[0], 8.0 + np.arange(24.0))
    for scene in (with_gait(each, None) for each in (scenes[3], scenes[5], uneven)):
        maps, rules, seen = symmetries(scene.structure), [], []
        for law in (law for law in scene.laws if not isinstance(law, Constraint)):
            alike = looks_alike(law, scene)
            found, said = [alike(one) for one in maps], [law.keeps(one) for one in maps]
            assert all(there for there, rule in zip(found, said) if rule), law.name
            seen.append(found)
            rules.append(found if said[0] is None else said)
        assert np.all(rules, axis=0).tolist() == np.all(seen, axis=0).tolist()


@pytest.mark.parametrize(
    ("term", "named"),
    [
        (WindDrag(np.array([2.0, 2.0, 2.0, 9e3, 2.0, 2.0])), "wind drag at node 3"),
        (Tether(np.full(1, 1e8)), "tether at node 0"),
    ],
    ids=["drag", "tether"],
)
@pytest.mark.slow
def test_the_report_on_stability_asks_every_law(prism, term, named):
    """A term that limits the step is named by the part of it that does."""
    scene = with_terms(prism, term)
    assert limiting_part(scene, standing(scene), METHODS["rk4"]) == named


def test_parts_that_a_law_does_not_name_are_the_nodes(prism):
    """Their shares in a motion are those that a law has by scaling coefficients of its own; other parts are refused."""

    class Scaled(Tether):
        def scaled(self, factors):
            return Scaled(self.stiffness * factors[0])

    class Named(Tether):
        def parts(self, scene):
            return ("one", "two")

    law, q = Tether(np.full(1, 5.0)), jnp.asarray(prism.structure.nodes)
    assert law.parts(prism) == tuple(f"tether at node {k}" for k in range(6))
    shape = np.random.default_rng(0).normal(size=(2, 6, 3))
    ours, its = (with_terms(Scene(prism.structure), kind(law.stiffness)) for kind in (Tether, Scaled))
    found, expected = (part_shares(scene, q, 0 * q, shape, 1.0)[-1] for scene in (ours, its))
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    np.testing.assert_allclose(found[0], -5 * np.sum(shape[:, 0] ** 2), rtol=1e-12)
    with pytest.raises(InputError, match="tether has 2 parts and no `scaled`; expected one, or one for each node"):
        part_shares(with_terms(prism, Named(law.stiffness)), q, 0 * q, shape, 1.0)


def test_the_power_of_every_law_is_booked(prism, booked):
    """Under the cause that it gives; two laws of one cause are added up."""
    scene = with_terms(Scene(prism.structure, gravity=9.81), DRAG, Lift(np.ones(())), Tether(np.full(1, 50.0)))
    found = booked(scene)
    assert set(found) == {"wind", "actuation", "impulse", "moment"}
    assert abs(found["wind"]).min() > 0.1


@pytest.mark.campaign
def test_the_energy_audit_asks_every_law(prism):
    """What the air does is booked under the cause that its laws give, added up, and the balance closes."""
    falling, options = Scene(prism.structure, gravity=9.81), SolverOptions(dt=1e-4)
    audits = []
    for lift in (0.0, 1.0):
        scene = with_terms(falling, DRAG, Lift(np.asarray(lift)), Tether(np.full(1, 50.0)))
        audits.append(energy_audit(scene, 0.2, options=options, frame_rate=50.0))
        assert set(audits[-1].dissipated) == {"wind"}
        assert np.abs(audits[-1].residual).max() < 1e-6 * audits[-1].turned_over
    drag, both = (audit.lost[-1] for audit in audits)
    assert abs(drag) > 1e-3
    # lift acts against the fall: it takes energy out too
    assert both > drag + 0.1


def test_terms_of_ones_own_are_traced_like_the_librarys(prism):
    """Their numbers are inputs of what is compiled: a derivative by one is there, and right."""

    def end(c):
        scene = with_terms(prism, WindDrag(c * jnp.ones(6), (1.0, 0.0, 0.0)))
        return scene.dissipation(jnp.zeros((6, 3)), scene.structure.nodes, 0.0, None)

    np.testing.assert_allclose(jax.grad(end)(2.0), 6 / 2, rtol=1e-12)


@pytest.mark.parametrize("name", ["exact", "reference"])
def test_laws_find_all_members_whatever_acts_along_them(request, name):
    """Also of struts that are rigid; of what is not there, one line says so, and what there is."""
    scene = request.getfixturevalue(name)
    i, j = np.array(scene.structure.struts.edges).T
    q, v = scene.structure.nodes, np.random.default_rng(0).normal(size=(12, 3))
    motion = scene.motion(v, q, 0.0, None)
    np.testing.assert_array_equal(motion.at.vector("struts"), q[i] - q[j])
    np.testing.assert_array_equal(motion.rate("struts"), v[i] - v[j])
    assert motion.rate("cables").shape == motion.at.vector("cables").shape == (24, 3)
    bare = dataclasses.replace(scene, structure=dataclasses.replace(scene.structure, cables=None), gait=None)
    with pytest.raises(InputError, match=r"'cables', which the scene does not have; expected 'struts'$"):
        bare.configuration(q, 0.0).vector("cables")
    with pytest.raises(InputError, match=r"'ropes', which the scene does not have; expected 'struts' or 'cables'$"):
        motion.rate("ropes")
    alone = Scene(Structure(nodes=np.zeros((1, 3)), node_mass=np.ones(1)))
    with pytest.raises(InputError, match=r"expected a scene with members$"):
        alone.configuration(np.zeros((1, 3)), 0.0).vector("struts")


class Glue(ConeFriction):
    """A cone whose law is one of its own."""

    def law(self, ground):
        return Gluing(self, ground)


class Gluing(CoulombCone):
    """A constraint that no sweep knows of."""

    name: ClassVar[str] = "gluing"


def test_a_constraint_that_nothing_meets_is_refused(prism):
    """Whoever brings it: sweeps would go on as with Coulomb's cone."""
    with pytest.raises(InputError, match="gluing: no method solves this constraint; expected one of rigid struts"):
        Scene(prism.structure, gravity=9.81, ground=ExactGround(), friction=Glue(0.5))
