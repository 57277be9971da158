"""Make the tables in spine/ from the laboratory's raw logs: commands, settled poses, and the response to a command.

The logs are those of github.com/BerkeleyExpertSystemTechnologiesLab/2d-spine-control-hardware (Apache-2.0).
"""

import csv
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jaxgrity import InputError
from jaxgrity.io.files import write_whole

SETTLED = (-0.6, 0.0)
"""s, of the next command: the frames in which a pose counts as settled"""
MIDDLE = (0.5, 1.4)
"""s, after a command: frames that are surely neither of the motion before nor of the one after"""
RESPONSE = (-1.0, 1.0, 0.05)
"""s, about a command: from, to and width of the bins of the response"""
POSE = ("x", "z", "rotation")


@dataclass
class Settings:
    logs: Path
    """folder with inputs.csv, commands_DATE.csv and camera_DATE.csv"""
    out: Path = Path(__file__).parent / "spine"
    """folder for the tables"""


def main(settings: Settings) -> None:
    """Write the three tables. Raises `InputError` where a log is missing."""
    inputs = table(settings.logs / "inputs.csv", 5)
    names = sorted(path.name.removeprefix("commands_") for path in settings.logs.glob("commands_*.csv"))
    if not names:
        raise InputError(f"{settings.logs}: has no commands_DATE.csv; expected the laboratory's logs")
    poses, curves = [], []
    for name in names:
        times = table(settings.logs / f"commands_{name}", 2)[:, 0] / 1e3
        frames = table(settings.logs / f"camera_{name}", 2) * [1e-3, 1e-2, 1e-2, np.pi / 180]
        middle = np.array([pose(frames, t, *MIDDLE)[0] for t in times[:-1]])
        for k, after in enumerate(times[1:]):
            mean, spread, count = pose(frames, after, *SETTLED)
            poses.append([name.removesuffix(".csv"), k, count, *rounded([*mean, *spread, *middle[k]])])
        curves += [progress(frames, t, *middle[k : k + 2]) for k, t in enumerate(times[1:-1])]
    commands = [[k, *rounded(row[:4] / 100), *row[7:10]] for k, row in enumerate(inputs[1 : len(times)])]
    head = [f"retraction_{k}" for k in range(1, 5)]
    write(settings.out / "commands.csv", ["command", *head, *(f"expected_{name}" for name in POSE)], commands)
    spread = [f"scatter_{name}" for name in POSE]
    write(
        settings.out / "poses.csv", ["run", "command", "frames", *POSE, *spread, *(f"middle_{n}" for n in POSE)], poses
    )
    write(settings.out / "response.csv", ["time", "progress", "standard_error", "frames"], response(curves))
    print(f"{settings.out}: {len(commands)} commands, {len(poses)} poses of {len(names)} runs")


def table(path: Path, head: int) -> np.ndarray:
    """The numbers of a log, below its head. Raises `InputError` where it cannot be read."""
    try:
        return np.genfromtxt(path, delimiter=",", skip_header=head)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from error


def pose(frames: np.ndarray, t: float, first: float, last: float) -> tuple[np.ndarray, np.ndarray, int]:
    """Mean and standard deviation of the poses between two times about `t`, and how many; NaN where there are none."""
    seen = frames[(frames[:, 0] > t + first) & (frames[:, 0] <= t + last), 1:]
    nothing = np.full(3, np.nan)
    return (seen.mean(0) if len(seen) else nothing), (seen.std(0, ddof=1) if len(seen) > 1 else nothing), len(seen)


def progress(frames: np.ndarray, t: float, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """(frames, 3): time about a command, s; how much of its motion in x, z is done by then; and the weight of that."""
    near = frames[(frames[:, 0] > t + RESPONSE[0]) & (frames[:, 0] <= t + RESPONSE[1])]
    way = (after - before)[:2]
    size = way @ way or np.nan
    done = (near[:, 1:3] - before[:2]) @ way / size
    return np.column_stack([near[:, 0] - t, done, np.full(len(near), size)])


def response(curves: list[np.ndarray]) -> list[list[float]]:
    """The mean progress in each bin of time, with its standard error; long motions weigh more, as noise is in mm."""
    t, done, weight = np.concatenate(curves).T
    keep = np.isfinite(done)
    t, done, weight = t[keep], done[keep], weight[keep]
    first, last, width = RESPONSE
    rows = []
    for start in np.arange(first, last - width / 2, width):
        inside = (t > start) & (t <= start + width)
        share = weight[inside] / weight[inside].sum()
        mean = share @ done[inside]
        error = np.sqrt(share**2 @ (done[inside] - mean) ** 2)
        rows.append([*rounded([start + width / 2, mean, error]), int(inside.sum())])
    return rows


def rounded(values: list[float] | np.ndarray) -> list[str]:
    """To micrometres and microradians; nothing where a value is missing."""
    return [f"{value:.6f}" if np.isfinite(value) else "" for value in values]


def write(path: Path, head: list[str], rows: list[list]) -> None:
    """A CSV with a line of names."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([head, *rows])
    write_whole(path, lambda file: file.write(text.getvalue().encode()))
