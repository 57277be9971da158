"""A recorded motion as a measurement for `identify`, and beside the simulation from its first pose."""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxgrity.core.arguments import check_number
from jaxgrity.core.typed import typed
from jaxgrity.core.types import NodeHistory, Scalar, State, Times
from jaxgrity.identification.measurements import predicted
from jaxgrity.identification.motions import (
    MeasuredMotion,
    Starts,
    above_exact_ground,
    measured_motion,
    state_at,
    with_supports_placed,
)
from jaxgrity.identification.observations import SeenPositions
from jaxgrity.identification.recordings import Recording
from jaxgrity.model.body_points import carrying, independent_nodes
from jaxgrity.model.inertia import independent_coordinates
from jaxgrity.model.rigidity import rigid_lengths, rigid_pairs
from jaxgrity.model.scales import length_scale
from jaxgrity.model.scene import Scene, as_dtype
from jaxgrity.model.slides import check_no_slides
from jaxgrity.stepping.options import Options
from jaxgrity.stepping.simulate import with_commands

NOISE = 2e-3
"""Standard deviation of a measured coordinate where none is given, in m for a body of one metre: cameras that follow
markers reach it easily."""
NEWTON_STEPS = 20
"""Most steps in which a measured pose is moved onto rigid struts: from a few percent off, five reach rounding."""


class Compared(NamedTuple):
    """A recorded motion, and a simulation of it from its first pose."""

    times: Times
    """(frames,), s"""
    recorded: NodeHistory
    """(frames, nodes, 3), m; NaN where a node was not seen"""
    simulated: NodeHistory
    """(frames, nodes, 3), m"""
    moves: Bool[np.ndarray, " nodes"]
    """the nodes that are compared: all but supports"""

    def errors(self) -> Float[np.ndarray, " frames"]:
        """m, root mean square distance of the simulated nodes from where they were seen.

        NaN where none was seen, and infinite after the simulation failed.
        """
        return _apart(self.recorded[:, self.moves], self.simulated[:, self.moves])

    def moved(self) -> Float[np.ndarray, " frames"]:
        """m, the same of a robot that stays in the first pose."""
        still = np.broadcast_to(np.asarray(self.simulated)[:1], self.recorded.shape)
        return _apart(self.recorded[:, self.moves], still[:, self.moves])

    def stays_within(self, distance: float) -> float:
        """s, from the first frame until the error is more than that, m, or the simulation fails; else to the end."""
        out = np.flatnonzero(self.errors() > distance)
        return float(self.times[out[0] if out.size else -1] - self.times[0])


@typed
def recorded_motion(
    scene: Scene, recording: Recording, noise: float | None = None, *, windows: int = 1, options: Options = None
) -> MeasuredMotion:
    """A recording as a measurement for `identify`.

    Its start is that of `measured_motion`: a parabola through the first frames. Rigid struts leave no start free: the
    nearest pose and velocities that they allow then count as known.

    Args:
        scene: the robot, with the gait of the recording where this has no commands.
        recording: as from `read_recording`.
        noise: standard deviation of a coordinate, m; by default 0.2 % of a body length.
        windows: number of parts with starts of their own, for long motions; last frames that do not fill one are
            left out.
        options: solver options; by default the scene's.

    Raises:
        InputError: a noise that is not positive, or as `measured_motion`.
    """
    check_no_slides(scene, "recorded_motion")
    size = float(length_scale(scene))
    noise = NOISE * size if noise is None else check_number("noise", noise, above=0.0, unit="m")
    intervals = len(recording.times) - 1
    recording = recording.part(slice(1 + (intervals // windows * windows if 0 < windows <= intervals else intervals)))
    times, path = np.asarray(recording.times), recording.filled(scene.structure)
    here = scene if recording.commands is None else with_commands(scene, recording.commands)
    values = np.where(scene.structure.free, recording.positions, np.nan).reshape(len(times), -1)
    if rigid_pairs(here):
        q, v = _as_rigid(here, times[0], state_at(times, path, 0))
        path[0] = above_exact_ground(here, q)
        motion = measured_motion(
            here, times, values, noise, SeenPositions(), Starts(path, windows, spread=None), options=options
        )
        state = np.array([[path[0], v]])
    else:
        motion = measured_motion(here, times, values, noise, SeenPositions(), Starts(path, windows), options=options)
        state = np.array(motion.state)
        for each in state:
            each[0] = above_exact_ground(here, each[0])
    return replace(motion, state=state, commands=recording.commands)


@typed
def beside_simulation(scene: Scene, recording: Recording, *, options: Options = None) -> Compared:
    """A recorded motion beside the simulation of the scene from its first pose, with the velocities there.

    Args:
        scene: such as `Identified.scene`.
        recording: as from `read_recording`.
        options: solver options; by default the scene's.

    Raises:
        InputError: as `recorded_motion`.
    """
    motion = recorded_motion(scene, recording, options=options)
    simulated = np.asarray(predicted(motion, scene, np.asarray(motion.starts()[0], float)))
    moves = np.asarray(np.any(np.asarray(scene.structure.free), axis=1))
    return Compared(recording.times, recording.positions, simulated.reshape(recording.positions.shape), moves)


def _apart(recorded: NodeHistory, simulated: NodeHistory) -> np.ndarray:
    seen, there = np.isfinite(recorded).all(2), np.where(np.isfinite(simulated), simulated, np.inf)
    squares = np.sum((np.nan_to_num(recorded) - there) ** 2, axis=2)
    count = seen.sum(1)
    total = np.where(seen, squares, 0.0).sum(1)
    return np.sqrt(np.divide(total, count, out=np.full(len(total), np.nan), where=count > 0))


def _as_rigid(scene: Scene, t: Scalar, state: np.ndarray) -> State:
    """The nearest pose and velocities with rigid struts as long, and changing, as the scene says, and whole bodies.

    By Newton's method, in coordinates u of q = held + ways u: supports and their motion are in `held`, and the points
    of a body follow its basic ones.
    """
    (i, j), structure = np.array(rigid_pairs(scene)).T, scene.structure
    with jax.enable_x64(True):
        known, now = as_dtype(scene, "float64"), jnp.asarray(t, float)
        lengths, rates = map(np.asarray, jax.jvp(lambda t: rigid_lengths(known, t), (now,), (jnp.ones(()),)))
        state = np.asarray(with_supports_placed(known, t, state))
    nodes = np.array(independent_nodes(structure.bodies, len(structure.nodes)))
    held = np.asarray(carrying(structure.bodies, len(structure.nodes))) @ np.where(structure.free, 0, state)[:, nodes]
    ways = np.linalg.qr(independent_coordinates(structure)[1])[0]
    q, v = (each + (ways @ (ways.T @ (x - each).ravel())).reshape(each.shape) for x, each in zip(state, held))
    rows = np.arange(len(i))
    for _ in range(NEWTON_STEPS):
        d = q[i] - q[j]
        found = np.linalg.norm(d, axis=1)
        slopes = np.zeros((len(i), *q.shape))
        slopes[rows, i], slopes[rows, j] = d / found[:, None], -d / found[:, None]
        slopes = slopes.reshape(len(i), -1)
        back = ways @ np.linalg.pinv(slopes @ ways)
        q = q - (back @ (found - lengths)).reshape(q.shape)
    return q, v - (back @ (slopes @ v.ravel() - rates)).reshape(v.shape)
