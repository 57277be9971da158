"""The animation shows the motion in real time and where it goes, and appears whole or not at all."""

import math
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image, ImageColor, ImageSequence

import jaxgrity
from jaxgrity.report.animation import animate
from jaxgrity.report.plot import PATH, STRUT

SPEED = 3.0
"""m/s, with which the robot is carried along: within one second its gait does not begin"""


@pytest.fixture(scope="module")
def scene():
    return jaxgrity.load_scene("reference")


@pytest.fixture(scope="module")
def motion(scene):
    """One second of the robot settling on the ground."""
    return jaxgrity.simulate(scene, 1.0)


def carried(motion, heading):
    """The same motion while the robot is carried towards `heading`, rad."""
    direction = np.array([math.cos(heading), math.sin(heading), 0.0])
    return replace(motion, positions=motion.positions + SPEED * np.asarray(motion.times)[:, None, None] * direction)


def some(motion, frames):
    """Some frames of a motion."""
    kept = {name: getattr(motion, name)[frames] for name in ("times", "positions", "velocities")}
    return replace(motion, **kept)


def as_single(motion):
    """A motion in single precision."""
    return replace(motion, **{name: getattr(motion, name).astype("float32") for name in ("times", "positions")})


def read(path):
    """The frames of a GIF as arrays of colours, and how long each is shown, ms."""
    with Image.open(path) as gif:
        frames = [(frame.convert("RGB"), frame.info["duration"]) for frame in ImageSequence.Iterator(gif)]
    return [np.asarray(picture, int) for picture, _ in frames], [duration for _, duration in frames]


def where(picture, colour):
    """Rows and columns of the pixels that have this colour, or nearly so: the palette is limited."""
    return np.argwhere(np.abs(picture - ImageColor.getrgb(colour)).max(-1) < 24)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("frame_rate", "durations"),
    [
        (12.5, [80, 80, 80, 60]),
        (30.0, [30, 40, 30] * 3),
        pytest.param(100.0, [10] * 30, marks=pytest.mark.campaign),
        (1e9, [10] * 30),
        (0.1, [300]),
    ],
)
def test_frames_last_as_long_as_the_motion(scene, motion, tmp_path, frame_rate, durations):
    """Their number and durations fit the rate, up to what a GIF can count, and add up to 0.3 seconds."""
    called = []
    short = some(carried(motion, 0.0), slice(31))
    animate(scene, short, tmp_path / "a.gif", frame_rate, lambda *call: called.append(call))
    assert read(tmp_path / "a.gif")[1] == durations
    assert called == [(drawn, len(durations)) for drawn in range(len(durations) + 1)]


@pytest.mark.parametrize("frame_rate", [5.0, 50.0])
def test_few_saved_frames_are_shown_for_longer(scene, motion, tmp_path, frame_rate):
    """A motion saved five times a second, in single precision, has no more frames than that, and still lasts 1 s."""
    few = some(carried(motion, 0.0), slice(None, None, 20))
    animate(scene, as_single(few), tmp_path / "a.gif", frame_rate)
    _, durations = read(tmp_path / "a.gif")
    assert len(durations) == (5 if frame_rate == 5.0 else 6)
    assert sum(durations) == 1000


@pytest.mark.parametrize("heading", [0.0, 2.0, -1.5])
def test_the_robot_moves_to_the_right(scene, motion, tmp_path, heading):
    """Struts move steadily across the picture, whatever the heading, and the path behind them grows."""
    animate(scene, carried(motion, heading), tmp_path / "a.gif", frame_rate=5.0)
    pictures, _ = read(tmp_path / "a.gif")
    struts = np.array([where(picture, STRUT)[:, 1].mean() for picture in pictures])
    steps = np.diff(struts)
    assert (steps > 15).all()
    assert np.ptp(steps) < 0.5 * steps.mean()
    trail = [len(where(picture, PATH)) for picture in pictures]
    assert trail[0] == 0
    assert (np.diff(trail[1:]) > 0).all()
    assert where(pictures[-1], PATH)[:, 1].max() < where(pictures[-1], STRUT)[:, 1].max()


def test_only_what_moves_changes(scene, motion, tmp_path):
    """A frame that shows the robot elsewhere leaves no trace of it where it was, but its path."""
    animate(scene, carried(motion, 0.0), tmp_path / "a.gif", frame_rate=2.0)
    before, after = read(tmp_path / "a.gif")[0]
    left, right = where(before, STRUT), where(after, STRUT)
    assert left[:, 1].max() < right[:, 1].min()
    assert np.abs(len(left) - len(right)) < 0.3 * len(left)
    corner = (slice(-60, None), slice(0, 60))
    np.testing.assert_array_equal(before[corner], after[corner])


def test_without_a_ground(scene, motion, tmp_path):
    """Nothing but the ground is missing."""
    animate(replace(scene, ground=None, friction=None), carried(motion, 0.0), tmp_path / "a.gif", frame_rate=5.0)
    pictures, _ = read(tmp_path / "a.gif")
    assert all(len(where(picture, STRUT)) > 50 for picture in pictures)


@pytest.mark.parametrize("frame_rate", [0.0, -12.5, math.nan, math.inf])
def test_bad_frame_rate_is_refused(scene, motion, tmp_path, frame_rate):
    """What, the value received, what was expected, in one line; no file."""
    with pytest.raises(jaxgrity.InputError) as caught:
        animate(scene, motion, tmp_path / "a.gif", frame_rate)
    expected = f"frame_rate = {frame_rate:g}: expected a positive, finite number of frames a second"
    assert str(caught.value) == expected
    assert not list(tmp_path.iterdir())


def test_a_motion_that_is_not_finite_is_refused(scene, motion, tmp_path):
    """From when on it is not."""
    broken = replace(motion, positions=motion.positions.at[50:, 3].set(np.nan))
    with pytest.raises(jaxgrity.InputError, match=r"not finite from t = 0\.5 s on: expected"):
        animate(scene, broken, tmp_path / "a.gif")


def test_an_interrupted_write_leaves_nothing_behind(scene, motion, tmp_path):
    """Neither part of a file, nor harm to one that was there."""

    def interrupt(number, count):
        if number == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        animate(scene, motion, tmp_path / "a.gif", on_frame=interrupt)
    assert not list(tmp_path.iterdir())
    (tmp_path / "a.gif").write_bytes(b"as it was")
    with pytest.raises(KeyboardInterrupt):
        animate(scene, motion, tmp_path / "a.gif", on_frame=interrupt)
    assert [file.name for file in tmp_path.iterdir()] == ["a.gif"]
    assert (tmp_path / "a.gif").read_bytes() == b"as it was"


def test_an_mp4_lasts_as_long_as_the_motion(scene, motion, tmp_path):
    """At its size, by ffmpeg's own account; the file appears whole."""
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    animate(scene, some(carried(motion, 0.0), slice(51)), tmp_path / "a.mp4", 20.0, width=300)
    command = [ffmpeg.get_ffmpeg_exe(), "-i", str(tmp_path / "a.mp4"), "-f", "null", "-"]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stderr
    assert "Duration: 00:00:00.50" in said
    assert "300x210" in said
    assert [file.name for file in tmp_path.iterdir()] == ["a.mp4"]


def test_bad_widths_and_a_missing_encoder_are_one_line(scene, motion, tmp_path, monkeypatch):
    """Before anything is drawn."""
    with pytest.raises(jaxgrity.InputError, match="width = 10: expected 100 to 4000 pixels"):
        animate(scene, motion, tmp_path / "a.gif", width=10)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(jaxgrity.InputError, match=r"pip install 'jaxgrity\[video\]'"):
        animate(scene, motion, tmp_path / "a.mp4")


@pytest.mark.parametrize(
    ("heading", "rough"),
    [(0.0, True), (2.0, False), pytest.param(2.0, True, marks=pytest.mark.campaign)],
)
def test_a_camera_that_follows_keeps_the_robot_in_the_middle(scene, motion, tmp_path, heading, rough):
    """Large, while the lines on the ground and the path move to the left; on uneven ground as on the plane."""
    if rough:
        surface = jaxgrity.bumps(deviation=0.03, length=0.8, seed=0)
        scene = replace(scene, ground=replace(scene.ground, surface=surface))
    animate(scene, carried(motion, heading), tmp_path / "a.gif", frame_rate=3.0, width=300, camera="follow")
    pictures, _ = read(tmp_path / "a.gif")
    for picture in pictures:
        struts = where(picture, STRUT)[:, 1]
        assert abs(struts.mean() - 150) < 25
        assert np.ptp(struts) > 60
    trail = [where(picture, PATH)[:, 1] for picture in pictures]
    assert trail[-1].min() < 10 < 100 < trail[-1].max() < 190


@pytest.mark.parametrize("camera", ["whole", "follow"])
def test_a_robot_beside_all_ground_is_drawn(scene, motion, tmp_path, camera):
    """Of a table that it leaves: below it is no height at all."""
    table = jaxgrity.Box((0.0, 0.0, -0.5), (1.0, 1.0, 1.0))
    scene = replace(scene, ground=replace(scene.ground, surface=table))
    animate(scene, carried(motion, 0.0), tmp_path / "a.gif", frame_rate=3.0, width=300, camera=camera)
    pictures, _ = read(tmp_path / "a.gif")
    assert all(len(where(picture, STRUT)) > 30 for picture in pictures)


def test_a_camera_that_is_none_of_them_is_refused(scene, motion, tmp_path):
    """In one line."""
    with pytest.raises(jaxgrity.InputError, match="camera = 'above': expected whole or follow"):
        animate(scene, motion, tmp_path / "a.gif", camera="above")
