"""Motions as files: npz, CSV, and netCDF with units, which xarray opens."""

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import netcdf_file

from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.io.files import save_arrays, write_whole
from jaxgrity.stepping.simulate import Trajectory

ENDINGS = (".npz", ".csv", ".nc")
"""Endings of the files to which trajectories are written."""


@typed
def save_trajectory(trajectory: Trajectory, path: str | Path) -> None:
    """Write a motion: where every node was, and how fast, at each saved time.

    `.npz`: times (frames,), positions and velocities (frames, nodes, 3). `.csv`: a row for each node at each time:
    time_s, node, x_m, y_m, z_m, vx_m_per_s, vy_m_per_s, vz_m_per_s. `.nc`: netCDF 3 with dimensions time, node and
    axis, and units of all variables by the CF conventions, for `xarray.open_dataset(path)`.

    Args:
        trajectory: what `simulate` returned.
        path: of the file, whose ending says how; it appears whole or not at all.

    Raises:
        InputError: the ending is another.

    Example:
        >>> trajectory = jaxgrity.simulate(jaxgrity.load_scene("reference"), 0.1)
        >>> jaxgrity.formats.save_trajectory(trajectory, "motion.nc")
    """
    times, x, v = (np.asarray(part, float) for part in (trajectory.times, trajectory.positions, trajectory.velocities))
    path = Path(path)
    if path.suffix == ".npz":
        save_arrays(path, times=times, positions=x, velocities=v)
    elif path.suffix == ".csv":
        text = io.StringIO()
        table = csv.writer(text, lineterminator="\n")
        table.writerow(["time_s", "node", "x_m", "y_m", "z_m", "vx_m_per_s", "vy_m_per_s", "vz_m_per_s"])
        for t, places, speeds in zip(times.tolist(), x.tolist(), v.tolist()):
            table.writerows([t, k, *place, *speed] for k, (place, speed) in enumerate(zip(places, speeds)))
        write_whole(path, lambda file: file.write(text.getvalue().encode()))
    elif path.suffix == ".nc":
        content = _netcdf(trajectory, times, x, v)
        write_whole(path, lambda file: file.write(content))
    else:
        raise InputError(f"{path}: unknown ending; expected one of {', '.join(ENDINGS)}")


def _netcdf(trajectory: Trajectory, times: np.ndarray, x: np.ndarray, v: np.ndarray) -> bytes:
    held = io.BytesIO()
    file: Any = netcdf_file(held, "w", version=2)
    file.Conventions, file.title = "CF-1.11", "motion of a tensegrity robot"
    file.source = f"jaxgrity, method {trajectory.method}, failure code {int(trajectory.failure)}"
    for name, size in zip(("time", "node", "axis"), x.shape):
        file.createDimension(name, size)
    _variable(file, "time", times, ("time",), units="s", long_name="time since the start", standard_name="time")
    _variable(file, "node", np.arange(x.shape[1], dtype=np.int32), ("node",), long_name="number of the node", units="1")
    axis = file.createVariable("axis", "c", ("axis",))
    axis[:] = np.array([b"x", b"y", b"z"])
    axis.long_name = "axis, z up"
    dimensions = ("time", "node", "axis")
    _variable(file, "position", x, dimensions, units="m", long_name="position of each node")
    _variable(file, "velocity", v, dimensions, units="m s-1", long_name="velocity of each node")
    file.flush()
    return held.getvalue()


def _variable(file: Any, name: str, values: np.ndarray, dimensions: tuple[str, ...], **attributes: str) -> None:
    variable = file.createVariable(name, values.dtype.newbyteorder(">"), dimensions)
    variable[:] = values
    for key, text in attributes.items():
        setattr(variable, key, text)
