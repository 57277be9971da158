"""Hand-written C, built from the project's own source, ends where the library does."""

import shutil

import numpy as np
import pytest
from measurements import limit

from jaxgrity import (
    SolverOptions,
    gaits_of,
    load_gait,
    load_scene,
    random_phases,
    simulate_population,
    with_gait,
)


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")
@pytest.mark.parametrize(
    ("scene", "program", "method", "dt", "sweeps", "within"),
    [
        ("reference", "limit64", "rk4", 5e-4, None, 1e-7),
        # whose impulses come by other formulae of first order: both come closer with the step
        pytest.param("exact", "exact64", "complementarity", 5e-4, 16, 1e-4, marks=pytest.mark.campaign),
    ],
)
def test_c_ends_where_the_library_does(scene, program, method, dt, sweeps, within):
    """After two seconds, in which gaits begin and nodes land."""
    known, phases = load_scene(scene), random_phases(4, 6, seed=8)
    coarse, fine = (
        limit.roll(limit.programs() / program, known, phases, round(2.0 / h), h, 1, sweeps)[0] for h in (4 * dt, dt)
    )
    options = SolverOptions(method=method, dt=dt, dtype="float64")
    ours = simulate_population(known, gaits_of(known.gait, phases), 2.0, options=options).com_end
    off = [np.abs(ours - by_c).max() for by_c in (coarse, fine)]
    assert off[1] < within
    assert off[1] < 0.4 * off[0]


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")
def test_c_knows_overtones():
    """Of a gait whose waves are ahead by other angles, in the second in which it begins."""
    known = with_gait(load_scene("reference"), load_gait("brisk"))
    phases = np.asarray(known.gait.phase) + np.array([[0.0], [1.0], [2.0]])
    by_c = limit.roll(limit.programs() / "limit64", known, phases, 4000, 5e-4, 1)[0]
    options = SolverOptions(method="rk4", dt=5e-4, dtype="float64")
    rolled = lambda gaits: simulate_population(known, gaits, 2.0, options=options).com_end  # noqa: E731
    np.testing.assert_allclose(rolled(limit.waves_at(known.gait, phases)), by_c, rtol=0, atol=1e-7)
    other = rolled(gaits_of(known.gait, phases))  # as if overtones had kept their phases
    assert np.abs(other - by_c)[1:].max() > 1e-4
