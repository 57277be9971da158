"""Motions as files: npz, which is read again, CSV, and netCDF with units, which xarray opens."""

import io
import zipfile
import zlib
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.io import netcdf_file

from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.formats.spreadsheets import save_rows
from jaxgrity.io.files import save_arrays, write_whole
from jaxgrity.io.scene_files import parse_scene
from jaxgrity.io.scene_writing import scene_toml
from jaxgrity.model.actuation import Commands
from jaxgrity.stepping.simulate import Trajectory

ENDINGS = (".npz", ".csv", ".nc")
"""Endings of the files to which trajectories are written."""
UNITS = "times: s; positions: m; velocities: m/s; masses: kg; dt: s, NaN where the step adapts"
"""What an npz file says of its numbers."""


@typed
def save_trajectory(trajectory: Trajectory, path: str | Path) -> None:
    """Write a motion: where every node was, and how fast, at each saved time.

    `.npz`, for `load_trajectory`, has times (frames,), positions and velocities (frames, nodes, 3), and masses
    (nodes,). A rod's mass is shared by its ends. It also has method, dt, failure, steps, rejected and units, and the
    text of the scene file as scene. A scene that no scene file can say is left out, and scene_left_out says why. A
    closed loop adds command_members, command_times and command_contraction (times, actuators). `.csv`: a row for each
    node at each time: time_s, node, x_m, y_m, z_m, vx_m_per_s, vy_m_per_s, vz_m_per_s. `.nc`: netCDF 3 with dimensions
    time, node and axis, and units of all variables by the CF conventions, for `xarray.open_dataset(path)`.

    Args:
        trajectory: the motion, from `simulate`.
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
        save_arrays(path, **_arrays(trajectory))
    elif path.suffix == ".csv":
        moments = zip(times.tolist(), x.tolist(), v.tolist())
        rows = ([t, k, *node] for t, q, w in moments for k, node in enumerate(a + b for a, b in zip(q, w)))
        save_rows(path, ["time_s", "node", "x_m", "y_m", "z_m", "vx_m_per_s", "vy_m_per_s", "vz_m_per_s"], rows)
    elif path.suffix == ".nc":
        content = _netcdf(trajectory, times, x, v)
        write_whole(path, lambda file: file.write(content))
    else:
        raise InputError(f"{path}: unknown ending; expected one of {', '.join(ENDINGS)}")


@typed
def load_trajectory(path: str | Path) -> Trajectory:
    """The motion of an npz file that `save_trajectory`, `jaxgrity simulate` or `jaxgrity search` left, with its scene.

    Args:
        path: of the file.

    Returns:
        The motion as it was, to the last bit; without a scene where the file has none.

    Raises:
        InputError: there is no such file, or it is none of these.

    Example:
        >>> jaxgrity.formats.save_trajectory(jaxgrity.simulate(jaxgrity.load_scene("reference"), 0.1), "motion.npz")
        >>> again = jaxgrity.formats.load_trajectory("motion.npz")
        >>> again.positions.shape, again.scene.structure.mass
        ((11, 12, 3), 6.0)
    """
    try:
        with np.load(path) as file:
            saved = dict(file)
        # floats stay NumPy's, which keeps float64 where JAX does not allow it
        numbers = {name: saved[name] for name in ("times", "positions", "velocities")}
        numbers |= {name: jnp.asarray(saved[name]) for name in ("failure", "steps", "rejected")}
        method, dt = str(saved["method"]), float(saved["dt"])
    except (OSError, ValueError, EOFError, KeyError, TypeError, zipfile.BadZipFile, zlib.error) as error:
        raise InputError(f"{path}: no motion that save_trajectory wrote as .npz ({error})") from error
    scene = parse_scene(str(saved["scene"]), str(path)) if "scene" in saved else None
    commands = None
    if "command_times" in saved:
        members = tuple(saved["command_members"].tolist())
        commands = Commands(members, saved["command_times"], saved["command_contraction"])
    return Trajectory(**numbers, method=method, dt=None if np.isnan(dt) else dt, scene=scene, commands=commands)


def _arrays(trajectory: Trajectory) -> dict[str, Any]:
    """What an npz file holds, by its names there."""
    numbers = ("times", "positions", "velocities", "failure", "steps", "rejected", "method")
    found = {name: getattr(trajectory, name) for name in numbers}
    found |= {"dt": np.nan if trajectory.dt is None else trajectory.dt, "units": UNITS}
    if trajectory.scene is not None:
        found["masses"] = trajectory.scene.structure.lumped_mass
        try:
            found["scene"] = scene_toml(trajectory.scene)
        except InputError as error:
            found["scene_left_out"] = str(error)
    if (asked := trajectory.commands) is not None:
        found |= {"command_members": asked.members, "command_times": asked.times}
        found["command_contraction"] = asked.contraction
    return found


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
