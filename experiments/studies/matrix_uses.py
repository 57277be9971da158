"""What a user does with a scene, each with a check that finds its result right, and how such a use ends."""

import tempfile
import time
import traceback
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np
from studies.matrix_scenes import GAP, MOTION, Row, scene_of, turn_about_z, turnable, units_of

from jaxgrity import (
    Forces,
    InputError,
    Scene,
    SolverOptions,
    Trajectory,
    as_dtype,
    as_population,
    contact_twin,
    describe,
    energy_audit,
    forces_along,
    load_scene,
    save_scene,
    simulate,
    simulate_population,
)
from jaxgrity.formats import read_any, write_any
from jaxgrity.stepping import acceleration

FRAMES = 4
"""Number of saved frames of a motion, after the first."""
TURN, SHIFT = 0.7, (0.3, -0.2)
"""rad, and units of the size: a motion is the same after such a turn and such a shift."""
NEAR = {"float32": 1e-3, "float64": 1e-7}
"""Largest difference between two computations of one motion, as a share of the size: rounding, and what the motion and
the tolerance of contact make of it."""


class Case:
    """A row, its scene, and its motion, which uses share."""

    def __init__(self, row: Row):
        self.row, self.at, self.scene = row, units_of(row), scene_of(row)

    @property
    def duration(self) -> float:
        """s"""
        return MOTION * self.at.time

    @property
    def near(self) -> float:
        """m"""
        return NEAR[self.row["dtype"]] * self.at.length

    @property
    def options(self) -> SolverOptions:
        return SolverOptions(dtype=self.row["dtype"])

    def moved(self, scene: Scene, dt: float | None = None) -> Trajectory:
        """The motion of a scene like this one, by steps of `dt`, s."""
        options = SolverOptions(dt=dt, dtype=self.row["dtype"])
        found = simulate(scene, self.duration, options=options, frame_rate=FRAMES / self.duration)
        assert not found.failed, f"failed with code {int(found.failure)}"
        return found

    @cached_property
    def trajectory(self) -> Trajectory:
        return self.moved(self.scene)

    @cached_property
    def forces(self) -> Forces:
        return forces_along(self.scene, self.trajectory)


def same(found: Any, expected: Any, within: float, what: str) -> None:
    """Fails where two arrays differ by more, or one is not finite."""
    away = float(np.max(np.abs(np.asarray(found, float) - np.asarray(expected, float)), initial=0.0))
    assert away <= within, f"{what}: {away:.2g} apart, expected at most {within:.2g}"


def describing(case: Case) -> None:
    """Every law that acts is named, and every number is one."""
    text = describe(case.scene)
    missing = [law.name for law in case.scene.laws if law.name not in text]
    assert not missing, f"missing {missing}"
    assert "nan" not in text.lower().split(), text


def scene_file(case: Case) -> None:
    with tempfile.TemporaryDirectory() as folder:
        save_scene(case.scene, Path(folder) / "scene.toml")
        again = load_scene(str(Path(folder) / "scene.toml"))
    assert jax.tree.structure(again) == jax.tree.structure(case.scene), "another scene is read than was written"
    for found, expected in zip(jax.tree.leaves(again), jax.tree.leaves(case.scene)):
        np.testing.assert_array_equal(found, expected)


ROUNDED = 2e-3
"""Radius of the balls at the nodes of written models, which round edges, m for a robot of one metre; at most."""


def written(ending: str, case: Case) -> None:
    """A structure that is written and read again is the same; on solids, robot and ground may be shifted together."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"robot{ending}"
        write_any(case.scene, path)
        if ending in (".glb", ".obj"):
            assert path.stat().st_size > 1000
            return
        read = read_any(path).scene
    built, again, within = case.scene.structure, read.structure, 1e-6 * case.at.length
    nodes = np.asarray(again.nodes)
    if read.ground is not None and read.ground.surface is not None:
        there, here = (np.asarray(each.ground.measured(each.structure.nodes).distance) for each in (read, case.scene))
        felt = np.isfinite(there)  # no ball is where a node is held
        same(there[felt], here[felt], ROUNDED * case.at.length, "distances from the ground")
        nodes = nodes - (nodes - np.asarray(built.nodes)).mean(0)
    same(nodes, built.nodes, within, "nodes")
    free = built.free.any(1)  # what a node weighs that is held counts nowhere
    same(again.lumped_mass[free], built.lumped_mass[free], 1e-6 * case.at.mass, "masses")
    assert again.member_count == built.member_count


def twin(case: Case) -> None:
    """Springs and penalty contact have a twin with constraints, and other scenes have one without any."""
    assert contact_twin(case.scene).constrained != case.scene.constrained, "the twin is of the same kind"


def simulating(case: Case) -> None:
    found = case.trajectory
    assert np.isfinite(np.asarray(found.positions)).all()
    fell = np.asarray(found.positions)[-1, :, 2] - np.asarray(found.positions)[0, :, 2]
    assert fell.min() < -1e-3 * case.at.length, f"moved by {fell} m: nothing falls"


def another_size(case: Case) -> None:
    """The same scene at size 1 moves alike, by steps that are alike: those that are chosen have round numbers."""
    model, dt = Case(case.row | {"size": 1.0}), case.trajectory.dt
    found = model.moved(model.scene, None if dt is None else dt / case.at.time)
    there = np.asarray(case.trajectory.positions) / case.at.length
    same(there, found.positions, NEAR[case.row["dtype"]], "motion over size")


def turned(case: Case) -> None:
    """Moved along the level, and turned about the vertical where the ground can be, the scene moves alike."""
    turn, shift = motion_of(case.row)
    other = case.moved(scene_of(case.row, turn, shift))
    there = np.asarray(other.positions, float) - case.at.length * np.array([*shift, 0.0])
    same(there @ turn_about_z(turn), case.trajectory.positions, case.near, "motion after a turn")


def accelerated(row: Row, turn: float, shift: tuple[float, float]) -> np.ndarray:
    """(nodes, 3): accelerations, over those of the row's size, in a state with contact, slip, and members in motion."""
    scene, at = as_dtype(scene_of(row, turn, shift), "float64"), units_of(row)
    draw = np.random.default_rng(0)
    away, speed = draw.normal(size=(2, 4, 3)) * [[[0.02]], [[0.3]]] - [[[0.0, 0.0, 2 * GAP]], [[0.0, 0.0, 0.1]]]
    held, back = scene.structure.free, turn_about_z(turn)
    q = scene.structure.nodes + at.length * np.where(held, away, 0) @ back.T
    v = at.speed * np.where(held, speed, 0) @ back.T
    return np.asarray(ACCELERATION(scene, np.asarray(0.04 * at.time), q, v)) @ back / (at.length / at.time**2)


ACCELERATION = eqx.filter_jit(acceleration)


def forces_of_a_state(case: Case) -> None:
    """Accelerations are alike at size 1, and after a turn about the vertical and a shift."""
    found = accelerated(case.row, 0.0, (0.0, 0.0))
    size = np.abs(found).max()
    same(accelerated(case.row | {"size": 1.0}, 0.0, (0.0, 0.0)), found, 1e-9 * size, "accelerations at size 1")
    same(accelerated(case.row, *motion_of(case.row)), found, 1e-9 * size, "accelerations after a turn")


def motion_of(row: Row) -> tuple[float, tuple[float, float]]:
    """The turn and the shift after which the scene is to move alike."""
    return TURN if turnable(row) else 0.0, (0.0, SHIFT[1]) if row["ground"] == "incline" else SHIFT


def balance(case: Case) -> None:
    """Forces that keep a support where it is, of ground that only pushes, and a tension of every member."""
    found, structure = case.forces, case.scene.structure
    assert all(np.isfinite(part).all() for part in found)
    assert found.tension.shape == (len(case.trajectory.times), structure.member_count)
    held = structure.supported
    assert not np.any(found.supports[:, ~held]), "a support acts on what it does not hold"
    assert not held.any() or np.abs(found.supports).max() > 0.1 * case.at.force, "supports carry nothing"
    if case.scene.ground is not None and case.row["ground"] in ("plane", "bumps", "moved", "heights", "function"):
        assert found.ground[..., 2].min() > -1e-3 * case.at.force, "the ground pulls"


def energy_balance(case: Case) -> None:
    """Of energy, within the error of steps that meet contact, and of momentum."""
    audit = energy_audit(case.scene, case.duration, frame_rate=FRAMES / case.duration)
    missed = float(np.abs(audit.residual).max() / audit.turned_over)
    assert missed < 0.02, f"{missed:.2%} of the energy that was turned over is missed"
    slip = float(audit.momentum_residual.max()) / (case.at.mass * case.at.speed)
    assert slip < 0.02, f"{slip:.2g} of the momentum is missed"


def one_of_many(case: Case) -> None:
    """Robots side by side, of whom one has the scene's gait, end where it ends alone."""
    if case.scene.gait is None:
        return
    gait = as_population(case.scene.gait)
    many = jax.tree.map(lambda x: np.concatenate([x, x]) if np.ndim(x) else x, gait)
    outcomes = simulate_population(case.scene, many, case.duration, options=case.options)
    assert not np.any(outcomes.failure), f"failed with codes {np.asarray(outcomes.failure)}"
    same(outcomes.positions[1], case.trajectory.positions[-1], case.near, "the second of two robots")


STILL: dict[str, Callable[[Case], None]] = {
    "describe": describing,
    "scene file": scene_file,
    "contact twin": twin,
    **{f"{end} file": lambda case, end=end: written(end, case) for end in (".xml", ".mat", ".csv", ".glb")},
}
"""What compiles next to nothing."""
MOVING: dict[str, Callable[[Case], None]] = {
    "forces of a state": forces_of_a_state,
    "simulate": simulating,
    "at size 1": another_size,
    "turned and moved": turned,
    "forces": balance,
    "energy_audit": energy_balance,
    "one of many": one_of_many,
}
"""What compiles programs for the scene."""


def tried(use: Callable[[Case], None], case: Case | Row) -> dict[str, Any]:
    """How a use ends: "right", "wrong" (what its check says), "refused" (in one line), or "raw" (another error).

    Of a row the case is made first.
    """
    began, end, words = time.perf_counter(), "right", ""
    try:
        use(case if isinstance(case, Case) else Case(case))
    except InputError as error:
        end, words = "refused", str(error)
    except AssertionError as error:
        end, words = "wrong", str(error).strip()
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        end, words = "raw", f"{type(error).__name__}: {error} ({Path(place.filename).name}:{place.lineno})"
    if end == "refused" and "\n" in words:
        end = "wrong"
    found: dict[str, Any] = {"end": end, "seconds": time.perf_counter() - began}
    return found | {"words": words[:400]} if words else found
