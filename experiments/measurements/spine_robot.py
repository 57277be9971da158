"""The measured spine: its scene, the tables of what was commanded and seen, and where statics says that it rests."""

import dataclasses
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity import InputError, Scene, load_scene
from jaxgrity.statics import equilibrium_near, resting_shape

FOLDER = Path(__file__).parent / "spine"
ORIGIN, TIP = 3, 6
"""nodes: the vertebra's frame is at the one, and its first axis points to the other"""
POSE = ("x", "z", "rotation")
"""m, m, rad"""


class Spine(NamedTuple):
    """The robot, and what the laboratory has of it."""

    scene: Scene
    """with nothing retracted"""
    retraction: np.ndarray
    """(commands, cables), m"""
    expected: np.ndarray
    """(commands, 3), the poses that the authors' inverse statics expected"""
    runs: tuple[str, ...]
    seen: np.ndarray
    """(runs, commands, 3), what the camera saw in the last 0.6 s before the next command; NaN where nothing"""
    middle: np.ndarray
    """likewise from 0.5 to 1.4 s after the command"""


def load_spine(folder: Path = FOLDER) -> Spine:
    """From the tables. Raises `InputError` where one is missing or lacks a column."""
    commands, poses = read_table(folder / "commands.csv"), read_table(folder / "poses.csv")
    runs = tuple(dict.fromkeys(column(poses, "run")))
    retraction = np.stack([numbers(commands, f"retraction_{k}") for k in range(1, 5)], axis=1)
    expected = np.stack([numbers(commands, f"expected_{name}") for name in POSE], axis=1)

    def of_runs(prefix: str) -> np.ndarray:
        return np.stack([numbers(poses, prefix + name) for name in POSE], axis=1).reshape(len(runs), -1, 3)

    return Spine(load_scene(folder / "spine.toml"), retraction, expected, runs, of_runs(""), of_runs("middle_"))


def read_table(path: Path) -> dict[str, list[str]]:
    """The columns of a CSV by their names. Raises `InputError` where it cannot be read."""
    try:
        head, *rows = [line.split(",") for line in path.read_text(encoding="utf-8").splitlines()]
        return {name: [row[k] for row in rows] for k, name in enumerate(head)}
    except (OSError, ValueError, IndexError) as error:
        raise InputError(f"{path}: cannot be read as a table: {error}") from error


def column(table: dict[str, list[str]], name: str) -> list[str]:
    """One of them. Raises `InputError` where it is missing."""
    if name not in table:
        raise InputError(f"no column {name!r}; expected it beside {', '.join(table)}")
    return table[name]


def numbers(table: dict[str, list[str]], name: str) -> np.ndarray:
    """One column as numbers, NaN where it is empty."""
    return np.array([float(text) if text else np.nan for text in column(table, name)])


def commanded(scene: Scene, retraction) -> Scene:
    """The spine with its cables so much shorter, (cables,), m."""
    cables = scene.structure.cables
    shorter = dataclasses.replace(cables, rest_length=cables.rest_length - retraction)
    return dataclasses.replace(scene, structure=dataclasses.replace(scene.structure, cables=shorter))


def pose(q):
    """(3,): x, z and rotation of the vertebra whose nodes are at `q` (nodes, 3)."""
    first = q[TIP] - q[ORIGIN]
    return jnp.stack([q[ORIGIN, 0], q[ORIGIN, 2], jnp.arctan2(first[2], first[0])])


def resting_shapes(spine: Spine) -> np.ndarray:
    """(commands, nodes, 3), m: where the robot rests after each command, from where it rested after the one before.

    Raises `InputError` where it finds no rest.
    """
    first = resting_shape(commanded(spine.scene, spine.retraction[0])).q
    shapes = np.asarray(_follow(spine.scene, jnp.asarray(first), jnp.asarray(spine.retraction)))
    lost = ~np.isfinite(shapes).all((1, 2))
    if lost.any():
        raise InputError(f"the spine finds no rest after command {int(np.argmax(lost))}; expected one after each")
    return shapes


@eqx.filter_jit
def _follow(scene: Scene, first, retraction):
    def rest(q, shorter):
        found = equilibrium_near(commanded(scene, shorter), q)
        return found, found

    return jax.lax.scan(rest, first, retraction)[1]


def rms(error: np.ndarray, axis=None) -> np.ndarray:
    """The root mean square of what is there."""
    return np.sqrt(np.nanmean(error**2, axis=axis))
