"""MuJoCo simulates the same robot: in free flight, where contact models play no part, both agree."""

import equinox as eqx
import numpy as np
import pytest

from jaxgrity import Scene, SolverOptions, gaits_of, random_phases, simulate_population


@pytest.mark.campaign
def test_free_flight_agrees_with_mujoco(reference):
    """Two engines, one set of springs: every node within 2e-5 m after 1 s, with the gait in full swing."""
    pytest.importorskip("mujoco")
    from measurements.mujoco_peer import roll

    gait = eqx.tree_at(lambda g: (g.start, g.amplitude), reference.gait, (np.asarray(0.0), np.full(6, 0.1)))
    mass = np.linspace(0.3, 0.7, 12)
    structure = eqx.tree_at(lambda s: s.node_mass, reference.structure, mass)
    scene = Scene(structure, gravity=9.81, node_damping=np.linspace(0.1, 2.0, 12), gait=gait)
    phases = random_phases(2, 6, seed=5)
    theirs, wall = roll(scene, phases, 1.0, 1e-4, "RK4")
    ours = simulate_population(scene, gaits_of(gait, phases), 1.0, options=SolverOptions(dt=1e-4))
    np.testing.assert_allclose(theirs, ours.positions, rtol=0, atol=2e-5)
    assert np.abs(np.asarray(ours.com_end)[:, :2]).max() > 2e-4
    assert wall > 0
