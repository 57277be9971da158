"""What the tests of the search share: a body that compiles fast, for what does not depend on the robot."""

import numpy as np
import pytest

from jaxgrity import Gait, Members, Scene, Structure


@pytest.fixture(scope="session")
def swimmer():
    """Three nodes in a row on two struts that push them apart, and a medium that holds each back by another force:
    how far the whole gets depends on the struts' phases."""
    nodes, edges, one = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), ((0, 1), (1, 2)), np.ones(2)
    structure = Structure(nodes, np.ones(3), Members(edges, 100 * one, one))
    gait = Gait((0, 1), 0 * one, 0.3 * one, one, start=0.0, ramp=0.5)
    return Scene(structure, node_damping=np.array([0.5, 1.0, 3.0]), gait=gait)
