"""A long motion in pieces is bit for bit the motion in one call, says how far it is, and can be stopped."""

import jax
import numpy as np
import pytest

from jaxgrity import Members, Scene, SolverOptions, Structure, load_gait, load_scene, simulate, with_gait
from jaxgrity.stepping import pieces

FIELDS = ("times", "positions", "velocities", "failure", "steps", "rejected")


@pytest.fixture(scope="module")
def falling():
    """Two nodes of 1 and 3 kg that nothing joins, with drag."""
    nodes = np.array([[0.0, 0, 1], [1, 0, 1]])
    return Scene(Structure(nodes, np.array([1.0, 3.0])), gravity=9.81, node_damping=np.array([0.5, 0.2]))


def assert_same_in_pieces(monkeypatch, scene, duration, **how):
    """Frames, failure code and steps; the first piece has a fourth of `LONG`, and each next one twice as many."""
    jax.clear_caches()  # programs of other tests may be optimised otherwise, and then round otherwise
    whole = simulate(scene, duration, **how)
    with monkeypatch.context() as changed:
        changed.setattr(pieces, "LONG", 2**11)
        heard = []
        cut = simulate(scene, duration, **how, on_progress=lambda *now: heard.append(now))
    assert len(heard) >= 4
    assert heard == sorted(heard)
    assert heard[-1] == (whole.times[-1], whole.times[-1])
    for name in FIELDS:
        first, second = (np.asarray(getattr(each, name)) for each in (whole, cut))
        assert first.dtype == second.dtype
        np.testing.assert_array_equal(first, second, err_msg=name)


def test_pieces_that_frames_limit_are_the_same_bit_for_bit(monkeypatch, falling):
    """There is room for 64 frames in each."""
    heard, options = [], SolverOptions(method="rk4", dt=1e-3)
    whole = simulate(falling, 2.0, options=options)
    monkeypatch.setattr(pieces, "SHARED_POSITIONS", 2**7)
    cut = simulate(falling, 2.0, options=options, on_progress=lambda *now: heard.append(now))
    assert len(heard) > 201 // 64
    np.testing.assert_array_equal(cut.positions, whole.positions)
    np.testing.assert_array_equal(cut.velocities, whole.velocities)
    inside = jax.jit(lambda: simulate(falling, 2.0, options=options).positions)()
    np.testing.assert_allclose(inside, whole.positions, rtol=0, atol=1e-12)  # known numbers are folded there


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "duration", "options", "moving"),
    [
        pytest.param("exact", 3.0, {}, 0.0, id="exact"),
        pytest.param("exact", 3.0, {}, 0.3, id="exact, moving", marks=pytest.mark.campaign),
        pytest.param("exact", 3.0, {"dtype": "float32"}, 0.0, id="exact, float32", marks=pytest.mark.campaign),
        pytest.param("reference", 1.0, {}, 0.0, id="rk4", marks=pytest.mark.campaign),
        pytest.param("reference", 0.5, {"method": "tsit5", "dt": 2e-4}, 0.0, id="tsit5", marks=pytest.mark.campaign),
    ],
)
def test_a_motion_in_pieces_is_the_same_bit_for_bit(monkeypatch, name, duration, options, moving):
    """Also where frames lie between the ends of steps, and the robot moves at the start."""
    scene, velocities = with_gait(load_scene(name), load_gait("straight")), np.tile([moving, 0, 0], (12, 1))
    how = {"options": SolverOptions(**options), "frame_rate": 93.0, "velocities": velocities}
    assert_same_in_pieces(monkeypatch, scene, duration, **how)


@pytest.mark.campaign
def test_verlet_in_pieces_is_the_same_bit_for_bit(monkeypatch):
    """Of two nodes on a spring that fall: without dissipation."""
    structure = Structure(np.array([[0.0, 0, 1], [1, 0, 1]]), np.array([1.0, 3.0]), Members(((0, 1),), [50.0], [0.8]))
    scene = Scene(structure, gravity=9.81)
    assert_same_in_pieces(monkeypatch, scene, 4.0, options=SolverOptions(method="verlet", dt=1e-3), frame_rate=31.0)


def test_a_long_motion_is_stopped_between_pieces(monkeypatch, falling):
    """Whatever is raised there ends it."""
    monkeypatch.setattr(pieces, "LONG", 2**7)
    heard = []

    def stop(done, total):
        heard.append(done)
        if done:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate(falling, 2.0, options=SolverOptions(method="rk4", dt=1e-3), on_progress=stop)
    assert len(heard) == 2
    assert 0 < heard[1] < 0.1
