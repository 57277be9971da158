"""Scenes made by functions: a tower of any size, which stands."""

import numpy as np
import pytest

from jaxgrity import InputError, SolverOptions, simulate
from jaxgrity.stepping.methods import default_method
from jaxgrity.stepping.step_limits import default_step
from jaxgrity.structures import prism_tower
from jaxgrity.structures.catalogue import PRISM_HEIGHT, prism_tower_geometry


@pytest.mark.parametrize(
    "exact", [pytest.param(False, marks=pytest.mark.campaign), pytest.param(True, marks=pytest.mark.slow)]
)
def test_tower_stands(exact):
    """Four prisms, for a second at the default step: nothing fails, and no strut changes by a tenth."""
    scene = prism_tower(12, exact)
    dt = default_step(scene, default_method(scene))
    trajectory = simulate(scene, 1.0, options=SolverOptions(dt=dt))
    assert not trajectory.failed
    q, struts = np.asarray(trajectory.positions[-1]), scene.structure.struts
    lengths = np.linalg.norm([q[i] - q[j] for i, j in struts.edges], axis=1)
    assert np.all(np.abs(lengths / struts.rest_length - 1) < 0.1)
    assert q[:, 2].max() > 1.5


@pytest.mark.parametrize("prisms", [1, 2, 5])
def test_each_prism_has_three_struts_and_nine_cables_and_six_tie_it_to_the_next(prisms):
    """Every node belongs to one strut, the lowest three stand at z = 0, and prisms do not reach into each other."""
    nodes, struts, cables = prism_tower_geometry(3 * prisms)
    assert len(struts) == 3 * prisms
    assert len(set(cables)) == len(cables) == 9 * prisms + 6 * (prisms - 1)
    assert sorted(node for edge in struts for node in edge) == list(range(6 * prisms))
    heights = nodes[:, 2].reshape(prisms, 6)
    assert np.all(heights[0, :3] == 0)
    np.testing.assert_allclose(np.ptp(heights, axis=1), PRISM_HEIGHT, rtol=1e-12)
    assert np.all(heights[1:].min(1) > heights[:-1].max(1))


@pytest.mark.parametrize("struts", [0, -3, 4])
def test_a_tower_of_parts_of_prisms_is_refused(struts):
    """Each prism has three struts."""
    with pytest.raises(InputError, match=f"struts = {struts}: expected a multiple of 3, three for each prism"):
        prism_tower(struts, exact=False)
