"""Laws of one's own that cannot act are refused with their name, in one line, before anything compiles."""

from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest

from jaxgrity import DissipationTerm, EnergyTerm, ForceLaw, InputError, primitives, simulate, with_terms

UP = (0.0, 0.0, 1.0)


class Band(EnergyTerm):
    """A spring between nodes."""

    k: Any
    edges: Any = eqx.field(static=True)
    name: ClassVar[str] = "band"

    def energy(self, at):
        return primitives.half_squares(self.k, primitives.length(primitives.edge_vectors(at.q, self.edges)))


class Forgetful(Band):
    """Its edges are not static."""

    edges: Any


class Weight(Band):
    """One node, by its number."""

    edges: Any = eqx.field(static=True, default=())
    node: Any = eqx.field(static=True, default=0)

    def energy(self, at):
        return self.k * at.q[self.node, 2]


class Each(Weight):
    """A number for each node, in place of their sum."""

    def energy(self, at):
        return self.k * at.q[:1, 2]


class Product(Weight):
    """A sum of products with one number."""

    def energy(self, at):
        return primitives.inner(self.k, primitives.component(at.q, UP))


class Swapped(Weight):
    """Numbers first, then vectors."""

    def energy(self, at):
        return primitives.inner(1.0, primitives.length(primitives.scale(primitives.component(at.q, UP), at.q)))


class Drag(DissipationTerm):
    """A number for each node."""

    name: ClassVar[str] = "drag"
    cause: ClassVar[str] = "drag"

    def dissipation(self, motion):
        return primitives.norm_squared(motion.v)


class Thrust(ForceLaw):
    """One force in place of one for each node."""

    name: ClassVar[str] = "thrust"
    cause: ClassVar[str] = "thrust"

    def force(self, motion, other_forces):
        return jnp.ones(3)


@pytest.mark.parametrize(
    ("law", "expected"),
    [
        (
            Band(1.0, ((0, 12),)),
            r"Band \('band'\) cannot act in this scene: edges\[0\] = \[0, 12\]: expected two nodes from 0 to 11$",
        ),
        (Band(1.0, ((0, -1),)), r"edges\[0\] = \[0, -1\]: expected two nodes from 0 to 11$"),
        (Forgetful(1.0, ((0, 1),)), r"declare edges, which has whole numbers, as eqx.field\(static=True\)$"),
        (Weight(1.0, node=30), "Weight .*index 30 is out of bounds"),
        (Each(1.0), r"gives an array of shape \(1,\); expected \(\), one number, a sum$"),
        (
            Product(np.ones(11)),
            r"shapes \(11,\) and \(12,\); expected one shape; its fields have the shapes k \(11,\)$",
        ),
        (Swapped(1.0), r"primitives.scale has arrays \(12,\), \(12, 3\); expected \(n, 3\), then \(n,\)"),
        (Band(1.0, [(0, 1)]), r"Band \('band'\): its static field edges has a list; give a tuple of whole numbers$"),
        (Drag(), r"Drag \('drag'\) gives an array of shape \(12,\)"),
        (Thrust(), r"gives an array of shape \(3,\); expected \(12, 3\), a force for each node$"),
    ],
    ids=lambda x: x if isinstance(x, str) else "",
)
def test_a_law_that_cannot_act_is_refused_with_its_name(exact, law, expected):
    """As soon as the scene gets it, or where that was passed by, as soon as a motion is asked for."""
    jaxtyping.config.update("jaxtyping_disable", True)  # for this test: its own refusals would come first
    with pytest.raises(InputError, match=expected) as refused:
        with_terms(exact, law)
    assert "\n" not in str(refused.value)
    with pytest.raises(InputError, match=expected):
        simulate(eqx.tree_at(lambda scene: scene.terms, exact, (law,)), 0.01)


@pytest.mark.parametrize(
    ("edges", "advice"),
    [(np.array([[0, 1]]), "give a tuple of whole numbers"), (np.ones(2), "leave static=True out, and give an array")],
)
def test_arrays_in_static_fields_are_refused_before_other_laws_meet_them(exact, edges, advice):
    with pytest.warns(UserWarning, match="being set as static"):
        law = Band(1.0, edges)
    with pytest.raises(InputError, match=f"Band .*its static field edges has an array; {advice}$"):
        with_terms(exact, Drag(), law)


def test_laws_that_can_act_pass(exact):
    laws = Band(1.0, ((0, 11),)), Weight(1.0, node=-1), Product(np.ones(12)), Product(1.0)
    assert len(with_terms(exact, *laws).terms) == 4


def test_sums_and_components_take_one_number_and_one_direction_for_all():
    """Also for many robots, with the population last."""
    x, n = np.arange(12.0).reshape(4, 3), np.array([0.6, 0.0, 0.8])
    np.testing.assert_allclose(primitives.component(jnp.asarray(x), jnp.asarray(n)), x @ n)
    np.testing.assert_allclose(primitives.inner(jnp.asarray(2.0), jnp.asarray(x[:, 0])), 2 * x[:, 0].sum())

    def energy(k, q):
        return primitives.inner(k, primitives.component(q, jnp.asarray(n)))

    many = np.stack([x, 2 * x], axis=-1)
    found = jax.vmap(jax.grad(energy, (0, 1)), in_axes=-1, out_axes=-1)(np.array([1.0, 3.0]), jnp.asarray(many))
    np.testing.assert_allclose(found[0], [(x @ n).sum(), 2 * (x @ n).sum()])
    np.testing.assert_allclose(found[1][..., 1], np.tile(3 * n, (4, 1)))
