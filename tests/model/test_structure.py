"""Nodes and members: what puts forces on nodes, and structures that are refused."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrity import InputError, Members, Structure
from jaxgrity.model.structure import member_vectors, onto_nodes

NODES = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])


def test_forces_of_kinds_go_where_their_members_are(reference):
    """`onto_nodes` is the transpose of `member_vectors`, for struts and cables together."""
    kinds = reference.structure.kinds
    random = np.random.default_rng(0)
    x = random.normal(size=(12, 3))
    forces = {name: random.normal(size=(len(members.edges), 3)) for name, members in kinds.items()}
    stretched = member_vectors(x, kinds)
    work = sum(float(jnp.sum(forces[name] * stretched[name])) for name in kinds)
    np.testing.assert_allclose(float(jnp.sum(x * onto_nodes(forces, kinds, 12))), work, rtol=1e-13)


def test_members_without_edges_are_refused():
    """None stands for members that are not modelled; an empty list is a mistake."""
    with pytest.raises(InputError, match="members: there are no edges; expected at least one, or None"):
        Members((), np.ones(0), np.ones(0))


@pytest.mark.parametrize("name", ["stiffness", "rest_length", "damping"])
def test_members_have_a_number_for_each_edge(name):
    """The part and both shapes are named."""
    parts = {"stiffness": np.ones(2), "rest_length": np.ones(2), "damping": np.ones(2), name: np.ones(3)}
    with pytest.raises(InputError, match=rf"members\.{name} has shape \(3,\); expected \(2,\), one number for each"):
        Members(((0, 1), (1, 2)), **parts)


@pytest.mark.parametrize(
    ("nodes", "mass", "edge", "message"),
    [
        (NODES[0], np.ones(3), (0, 1), r"structure\.nodes has shape \(3,\); expected \(nodes, 3\)"),
        (NODES[:0], np.ones(0), (0, 1), r"structure\.nodes has shape \(0, 3\); expected .*at least one node"),
        (NODES, np.ones(2), (0, 1), r"structure\.node_mass has shape \(2,\); expected \(3,\), one mass for each"),
        (NODES, np.ones(3), (0, 3), r"structure\.cables\[0\] = \[0, 3\]: expected nodes from 0 to 2"),
        (NODES, np.ones(3), (-1, 2), r"structure\.cables\[0\] = \[-1, 2\]: expected nodes from 0 to 2"),
    ],
)
def test_parts_that_do_not_fit_each_other_are_refused(nodes, mass, edge, message):
    """Arrays of other shapes, and members that join nodes which are not there."""
    with pytest.raises(InputError, match=message):
        Structure(nodes, mass, cables=Members((edge,), np.ones(1), np.ones(1)))
