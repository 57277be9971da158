"""Random structures: they stand, and a seed decides them."""

import numpy as np
import pytest

from jaxgrity import InputError, edge_lengths
from jaxgrity.statics import prestress
from jaxgrity.structures import random_tensegrity


@pytest.mark.parametrize("seed", [0, *(pytest.param(n, marks=pytest.mark.campaign) for n in (1, 2))])
def test_random_structure_carries_a_stress(seed):
    """With every cable in tension, in the shape that is returned; struts share no nodes."""
    nodes, struts, cables = random_tensegrity(5, seed, strut_length=2.0)
    assert sorted(node for edge in struts for node in edge) == list(range(10))
    assert not set(struts) & set(cables)
    forces = prestress(nodes, struts, cables, 1.0) * edge_lengths(nodes, struts + cables)
    assert forces[5:].min() > 0
    np.testing.assert_allclose(edge_lengths(nodes, struts), 2.0, rtol=0.02)
    assert len(nodes) == 10


def test_the_seed_decides():
    """The same again, and too few struts are refused."""
    first, again = random_tensegrity(4, 3), random_tensegrity(4, 3)
    np.testing.assert_array_equal(first.nodes, again.nodes)
    assert first.cables == again.cables
    with pytest.raises(InputError, match="struts = 2: expected a whole number, at least 3"):
        random_tensegrity(2)
