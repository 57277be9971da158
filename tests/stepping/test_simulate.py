"""Rollouts: where they start, when they are saved, and what is refused before anything compiles."""

import subprocess
import sys
from pathlib import Path

import jax
import jaxtyping
import numpy as np
import pytest

from jaxgrity import InputError, Scene, SolverOptions, Structure, diagnose, energy_audit, sensitivity, simulate
from jaxgrity.stepping.simulate import centre_path, frame_times


@pytest.fixture(scope="module")
def falling():
    """Two nodes of 1 and 3 kg that nothing joins."""
    return Scene(Structure(np.array([[0.0, 0, 1], [1, 0, 1]]), np.array([1.0, 3.0])), gravity=9.81)


def test_a_rollout_starts_where_and_as_fast_as_asked(falling):
    """Given positions and velocities, in place of the structure's own, at rest; both fall alike."""
    q, v = np.array([[0.0, 0, 5], [0, 2, 5]]), np.array([[1.0, 0, 0], [0, 0, 3.0]])
    motion = simulate(falling, 0.5, frame_rate=10.0, positions=q, velocities=v)
    fall = 9.81 * np.asarray(motion.times)[:, None] * np.array([0, 0, 1.0])
    np.testing.assert_allclose(motion.velocities, v - fall[:, None], rtol=0, atol=1e-13)
    ways = v * np.asarray(motion.times)[:, None, None] - (fall * np.asarray(motion.times)[:, None] / 2)[:, None]
    np.testing.assert_allclose(motion.positions, q + ways, rtol=0, atol=1e-13)
    centre = np.average(q + ways, axis=1, weights=[1.0, 3.0])
    np.testing.assert_allclose(centre_path(falling, motion), centre, rtol=0, atol=1e-13)


def test_a_start_may_be_a_list(falling):
    """Of rows of numbers."""
    jaxtyping.config.update("jaxtyping_disable", True)  # of this test alone: conftest.py sets it anew for each
    q = [[0.0, 0, 5], [0, 2, 5]]
    from_list, from_array = (simulate(falling, 0.5, frame_rate=10.0, positions=x) for x in (q, np.array(q)))
    np.testing.assert_array_equal(from_list.positions, from_array.positions)


@pytest.mark.parametrize("name", ["positions", "velocities"])
@pytest.mark.parametrize("shape", [(1, 3), (3, 3)])
def test_a_start_of_another_shape_is_refused(falling, name, shape):
    """One that NumPy would stretch to the right shape too."""
    with pytest.raises(InputError) as caught:
        simulate(falling, 1.0, **{name: np.zeros(shape)})
    assert str(caught.value) == f"{name} has shape {shape}; expected (2, 3), a row for each node"


def test_a_motion_that_fits_no_memory_is_refused():
    """Such as one of a million million seconds."""
    with pytest.raises(InputError, match=r"duration = 1e\+12 s: 1e\+14 frames at 100 a second; expected at most"):
        frame_times(1e12, 100.0)


@pytest.mark.parametrize("roll_out", [simulate, energy_audit, sensitivity, diagnose])
@pytest.mark.parametrize("rate", [0.0, -10.0, float("nan"), float("inf")])
def test_frame_rates_that_make_no_frames_are_refused(falling, roll_out, rate):
    """By everything that saves frames."""
    with pytest.raises(InputError, match=f"frame_rate = {rate}: expected a positive, finite number of frames a second"):
        roll_out(falling, 1.0, frame_rate=rate)


@pytest.mark.parametrize(
    ("duration", "rate", "frames"), [(2.0, 100.0, 201), (1.0, 3.0, 4), (0.1, 1.0, 2), (0.01, 1e-9, 2), (0.5, 3.0, 3)]
)
def test_frames_go_from_the_start_to_the_end(duration, rate, frames):
    """As many a second as asked, to the nearest whole number; at least two."""
    times = frame_times(duration, rate)
    assert len(times) == frames
    assert (times[0], times[-1]) == (0, duration)
    np.testing.assert_allclose(np.diff(times), duration / (frames - 1), rtol=1e-12)


@pytest.mark.campaign
def test_without_float64_rollouts_are_in_float32(tmp_path):
    """After a description too, which takes float64 for a while; nothing warns. Bare phases are refused as gaits."""
    code = (
        f"import sys; sys.path.append({str(Path(__file__).parents[1])!r})\n"
        "import jaxgrity, small_scenes; scene = small_scenes.swept(); jaxgrity.describe(scene); "
        "motion = jaxgrity.simulate(scene, 0.1); print(motion.failed, motion.positions.dtype)\n"
        "try: jaxgrity.simulate_population(scene, [[0.0]], 0.1)\n"
        "except jaxgrity.InputError as error: print(error)"
    )
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, cwd=tmp_path)
    first, refused = done.stdout.splitlines()
    assert first == "False float32", done.stderr
    assert refused.startswith("simulate_population: gaits is a list; expected a Gait; ")
    assert "jaxgrity.gaits_of" in refused


def test_rollouts_are_differentiated_by_forward_mode(falling):
    """In all saved frames, whose number is that of a rollout that is not differentiated: dx/dv = t in free fall."""

    def path(speed):
        velocities = np.array([[0.0, 0, 0], [0, 0, 1]]) * speed
        return simulate(falling, 0.5, frame_rate=10.0, velocities=velocities).positions

    positions, slope = jax.jvp(path, (2.0,), (1.0,))
    np.testing.assert_allclose(positions, path(2.0), rtol=0, atol=1e-13)
    np.testing.assert_allclose(slope[:, 1, 2], np.linspace(0, 0.5, 6), rtol=0, atol=1e-13)
    assert not np.any(slope[:, 0])


def test_rollouts_may_be_compiled_with_what_is_made_of_them(falling):
    """Inside of a jitted function, which knows no numbers."""
    options = SolverOptions("rk4", 1e-2)
    height = jax.jit(lambda: simulate(falling, 0.5, options=options, frame_rate=10.0).positions[:, 0, 2])
    np.testing.assert_allclose(height(), 1 - 9.81 / 2 * np.linspace(0, 0.5, 6) ** 2, rtol=0, atol=1e-13)
