"""The explorer's page: sliders at the right, the robot in 3D, and one worker for the latest rollout."""

import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import lazy_loader
import matplotlib
import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.explorer.controls import LARGEST_PHASE
from jaxgrity.explorer.exports import EXPORTS
from jaxgrity.explorer.session import OTHER, OWN, Robot3D, Rolled, chosen_robot, gaits_for
from jaxgrity.explorer.tasks import Runner, polish_gait, search_gait
from jaxgrity.model.actuation import Gait
from jaxgrity.report.drawing import RobotDrawing, World
from jaxgrity.report.poses import robot_size
from jaxgrity.report.view import set_camera

viser = lazy_loader.load("viser")

SHOWN_RATE = 20.0
"""Number of frames sent to the browser per second."""
SLIDERS, AFTER_SLIDERS = 1000.0, 1001.0
"""Places in the panel of sliders and of what follows them. Everything before has places counted from 0."""
PLOTTED = 8
"""Most members whose lengths are plotted."""
IDLE = 1.0
"""Time without a move of a slider after which the explorer looks for the orbit, s."""


class Page:
    """One page on a viser server; all tabs show the same."""

    def __init__(self, server: Any, scenes: tuple[str, ...], duration: float):
        self._server, self._duration, self._scenes = server, duration, scenes
        self._robot: Robot3D | None = None
        self.rolled: Rolled | None = None
        """what is shown"""
        self._drawing: RobotDrawing | None = None
        self._world: World | None = None
        self.sliders: dict[str, Any] = {}
        """by the names of their knobs"""
        self._folder: Any = None
        self._found: dict[str, float] = {}
        """phases that a task found, by the names of their knobs; members beyond a dozen have no sliders"""
        self._wanted, self._over, self._drawn = threading.Event(), threading.Event(), threading.Lock()
        self._other_robot = True
        self.rollouts = 0
        """done so far"""
        gui = server.gui
        self._words = gui.add_markdown("compiling …")
        self._scene = gui.add_dropdown("scene", scenes, initial_value=scenes[0])
        self._contact = gui.add_dropdown("contact model", (OWN, OTHER), initial_value=OWN)
        self._gait = gui.add_dropdown("gait", (OWN,), initial_value=OWN)
        self._playing = gui.add_checkbox("play", initial_value=True)
        self._time = gui.add_slider("time (s)", 0.0, duration, 0.01, 0.0)
        self._lengths = gui.add_uplot(
            *self._no_lengths(),
            title="lengths of actuated members (m)",
            aspect=1.6,
            order=AFTER_SLIDERS,
            scales={"x": viser.uplot.Scale(time=False)},
        )
        for control in (self._scene, self._contact, self._gait):
            control.on_update(lambda event: self._choose(event))
        self._add_tasks()
        for name in EXPORTS:
            gui.add_button(f"save {name}", order=AFTER_SLIDERS).on_click(partial(self._save, name))
        self._threads = [threading.Thread(target=run, daemon=True) for run in (self._work, self._play)]

    def _add_tasks(self) -> None:
        """Buttons of long tasks, and their messages."""
        gui = self._server.gui
        self._task_words = gui.add_markdown("", order=AFTER_SLIDERS)
        self.runner = Runner(self._tell)
        for name, task in (("search for phases", search_gait), ("polish the phases", polish_gait)):
            gui.add_button(name, order=AFTER_SLIDERS).on_click(partial(self._begin, task))
        gui.add_button("stop", order=AFTER_SLIDERS).on_click(lambda event: self.runner.stop())

    def start(self) -> None:
        """Begin to roll out and to play."""
        self._wanted.set()
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        """End after the present rollout."""
        self._over.set()
        self._wanted.set()
        self.runner.stop(wait=True)
        for thread in self._threads:
            thread.join()

    @property
    def words(self) -> str:
        """The page's text."""
        return self._words.content

    @property
    def values(self) -> dict[str, float]:
        """The sliders' values, cut at their bounds; the scene's own where a slider has not been moved."""
        known = {} if self._robot is None else {knob.name: knob for knob in self._robot.knobs}
        return self._found | {name: known[name].at(slider.value) for name, slider in self.sliders.items()}

    def _choose(self, event: Any) -> None:
        """Another robot; the page's own choices come without a client."""
        if event.client is not None:
            self._other_robot = True
            self._wanted.set()

    def _work(self) -> None:
        """Roll out the sliders' values, over and over; values in between are skipped."""
        while True:
            self._wanted.wait()
            self._wanted.clear()
            if self._over.is_set():
                return
            try:
                if self._other_robot:
                    self._other_robot = False
                    self._change_robot()
                self._roll()
            except InputError as error:
                self._words.content = f"**not possible**: {error}"
            except Exception as error:
                self._words.content = f"**the explorer broke down** ({error}): start it again"
                raise

    def _change_robot(self) -> None:
        """Compile for another robot, and make its sliders."""
        self._words.content = "compiling …"
        for control in (self._scene, self._contact, self._gait):
            # a name that is none of the choices could be that of a file
            if control.value not in control.options:
                raise InputError(f"{control.label} = {control.value!r}: expected one of {', '.join(control.options)}")
        robot = chosen_robot(self._scene.value, self._contact.value, self._gait.value, self._duration)
        gaits = gaits_for(robot.scene)
        if self._gait.options != gaits:
            self._gait.options = gaits
        self._robot, self._found = robot, {}
        with self._drawn:
            self._drawing = None
            if self._folder is not None:
                self._folder.remove()
            self._folder = self._server.gui.add_folder("robot, gait and ground", order=SLIDERS)
            with self._folder:
                self.sliders = {knob.name: self._slider(knob) for knob in robot.knobs}

    def _slider(self, knob: Any) -> Any:
        slider = self._server.gui.add_slider(knob.name, knob.low, knob.high, knob.step, knob.place, hint=knob.hint)
        slider.on_update(lambda event: self._wanted.set())
        return slider

    def _roll(self) -> None:
        assert self._robot is not None, "a robot is chosen before it rolls"
        rolled = self._robot.roll(self.values)
        self._words.content = rolled.words(None)
        self._show(rolled)
        self.rollouts += 1
        bar = self._robot.error_bar(rolled, self._wanted.is_set) if rolled.poses is not None else None
        if bar is not None:
            self._words.content = rolled.words(bar)
            if not self._wanted.wait(IDLE):
                self._words.content = rolled.words(bar, self._robot.orbit(rolled))

    def _show(self, rolled: Rolled) -> None:
        """Put a new rollout in the place of the one before."""
        poses = rolled.poses
        if poses is None:
            return
        with self._drawn, self._server.atomic():
            if self._drawing is None:
                self._server.scene.reset()
                self._world = World(self._server.scene, rolled.scene)
                self._drawing = RobotDrawing(self._server.scene, "robot", rolled.scene, poses)
                set_camera(
                    self._server, np.array([0, 0, 0.4 * robot_size(rolled.scene)]), poses, robot_size(rolled.scene)
                )
            else:
                self._drawing.draw_path(poses)
            if self._world is not None:
                self._world.draw_ground(rolled.scene, poses.below)
            if self._world is not None and rolled.scene.up is not None:
                self._world.lean(np.asarray(rolled.scene.up, float))
            self.rolled = rolled
            members = list(rolled.scene.gait.members)[:PLOTTED] if rolled.scene.gait is not None else []
            self._lengths.data, self._lengths.series = self._no_lengths() if not members else _lengths(poses, members)
        self._frame(float(self._time.value))

    def _play(self) -> None:
        """Move the robot in real time, while a page is open."""
        while not self._over.wait(1 / SHOWN_RATE):
            if self.rolled is None or not self._server.get_clients():
                continue
            if self._playing.value:
                self._time.value = round((time.monotonic() % self._duration), 2)
            self._frame(float(self._time.value))

    def _frame(self, at: float) -> None:
        """Show the robot at a time, s."""
        with self._drawn, self._server.atomic():
            if self.rolled is None or self._drawing is None or self.rolled.poses is None or self._world is None:
                return
            poses = self.rolled.poses
            frame = min(int(np.searchsorted(poses.times, at)), len(poses.times) - 1)
            self._world.look_at(poses.below[frame])
            self._drawing.show(poses, frame)

    def _tell(self, words: str) -> None:
        """Show the progress of a task."""
        self._task_words.content = words

    def _begin(self, task: Callable, event: Any) -> None:
        """Start a task from the present values; the sliders move to its result."""
        shown = self.rolled
        if shown is not None:
            robot = self._robot
            self.runner.start(lambda tell: self._take(task(shown.scene, self._duration, tell), robot))

    def _take(self, gait: Gait, robot: Robot3D | None) -> None:
        """Move the sliders to the phases of a gait, unless another robot was chosen since."""
        if self._robot is not robot:
            return
        phases = np.minimum(np.mod(np.asarray(gait.phase, float), 2 * np.pi), LARGEST_PHASE)
        self._found = {f"phase of {member} (rad)": float(phase) for member, phase in zip(gait.members, phases)}
        for name, phase in self._found.items():
            if name in self.sliders:
                self.sliders[name].value = phase
        self._wanted.set()

    def _save(self, name: str, event: Any) -> None:
        if self.rolled is None or self.rolled.poses is None:
            return
        try:
            event.client.send_file_download(name, EXPORTS[name](self.rolled, self._scene.value))
        except InputError as error:
            self._tell(f"**not possible**: {error}")

    def _no_lengths(self) -> tuple[Any, Any]:
        nothing = np.array([0.0, self._duration])
        return (nothing, np.zeros(2)), (viser.uplot.Series(label="time (s)"), viser.uplot.Series(label=""))


def _lengths(poses: Any, members: list[int]) -> tuple[Any, Any]:
    """The members' lengths, for uPlot."""
    rows = [np.ascontiguousarray(poses.members.scale[:, k, 2], float) for k in members]
    shades = [matplotlib.colors.to_hex(f"C{k}") for k in range(len(members))]
    lines = [viser.uplot.Series(label=str(k), stroke=shade, width=1.5) for k, shade in zip(members, shades)]
    return (np.asarray(poses.times, float), *rows), (viser.uplot.Series(label="time (s)"), *lines)
