"""A scene whose orbit is smooth, for the tests of derivatives of its speed."""

import numpy as np
import pytest

from jaxgrity import (
    Gait,
    Members,
    Overtone,
    PenaltyGround,
    Scene,
    SmoothFriction,
    SolverOptions,
    Structure,
    find_orbit,
    resolve,
)


@pytest.fixture(scope="module")
def crawler():
    """Two unequal masses on a strut that lengthens faster than it shortens, so that it creeps over the ground."""
    nodes = np.array([[0.0, 0, -1e-3], [1, 0, -1e-3]])
    struts = Members(((0, 1),), [2e3], [1.1], damping=[20.0])
    gait = Gait((0,), [0.0], [0.2], [1.0], start=0.0, ramp=1.0, overtones=(Overtone([0.5], [np.pi / 2]),))
    scene = Scene(
        Structure(nodes, [1.0, 3.0], struts=struts),
        gravity=9.81,
        ground=PenaltyGround(1e4, 2.0),
        friction=SmoothFriction(0.2, 0.2),
        gait=gait,
    )
    options = resolve(scene, 1.0, SolverOptions("rk4", 2e-3))
    return scene, find_orbit(scene, 60.0, options=options), options
