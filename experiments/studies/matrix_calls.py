"""Public functions called on a scene as far as the compiler: by then it shows what they refuse, and what fails inside.

Compiling takes nearly all of the time of a small scene. A call that reaches the compiler with a large program has read
its arguments and has written the program down, so that only numbers can still be wrong.
"""

import contextlib
import functools
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from studies.matrix_uses import Case

from jaxgrity import (
    Differences,
    SolverOptions,
    Trajectory,
    Uncertainty,
    as_population,
    control,
    diagnose,
    energy_audit,
    ensemble,
    forces_along,
    populations,
    rolling,
    rollout,
    save_scene,
    sensitivity,
    simulate,
    simulate_population,
    stable_step,
    verify,
    with_gait,
)
from jaxgrity.explorer.session import OTHER, OWN, chosen_robot
from jaxgrity.formats import save_trajectory
from jaxgrity.orbits import find_orbit
from jaxgrity.orbits.motion_report import motion_report
from jaxgrity.report import animate, plot, view
from jaxgrity.statics import inspect_structure, resting_shape, settled, vibration_modes
from jaxgrity.stepping import resolve

LARGE = 120_000
"""Size of a program's text, in bytes with its places in the source, from which on it takes long to compile."""
ASKED_FOR = "/jax/compilation_cache/compile_requests_use_cache"
"""The event by which JAX says that it has written a program down and looks for it among those that were compiled."""


class CompilerReachedError(BaseException):
    """Not an `Exception`, so that nobody on the way takes it for one."""


@contextlib.contextmanager
def nothing_large_compiles() -> Iterator[None]:
    """Ends what would compile a large program by `CompilerReachedError`, where compiled programs are kept."""
    with tempfile.TemporaryDirectory() as folder:

        def refuse(event: str, **_) -> None:
            if event != ASKED_FOR:
                return
            sizes = []
            for text in Path(folder).iterdir():
                sizes.append(text.stat().st_size)
                text.unlink()
            if max(sizes, default=0) > LARGE:
                raise CompilerReachedError

        jax.config.update("jax_dump_ir_to", folder)
        jax.monitoring.register_event_listener(refuse)
        try:
            yield
        finally:
            jax.monitoring.unregister_event_listener(refuse)
            jax.config.update("jax_dump_ir_to", "")


def reaching(call: Callable[[Case], object]) -> Callable[[Case], None]:
    """The call as a use of the matrix: it may end at the compiler."""

    def use(case: Case) -> None:
        with contextlib.suppress(CompilerReachedError), nothing_large_compiles():
            call(case)

    return use


@functools.lru_cache(maxsize=1)
def falling(case: Case) -> Trajectory:
    """A motion that nothing was compiled for: the robot falls freely as it is posed."""
    times = np.linspace(0.0, case.duration, 5)
    q, fall = np.asarray(case.scene.structure.nodes, float), np.array([0.0, 0.0, -9.81])
    dtype = case.row["dtype"]
    place = (q + 0.5 * times[:, None, None] ** 2 * fall).astype(dtype)
    speed = np.broadcast_to(times[:, None, None] * fall, place.shape).astype(dtype)
    resolved = resolve(case.scene, case.duration, case.options)
    count = np.asarray(len(times))
    none = np.asarray(0)
    dt = None if resolved.dt is None else float(resolved.dt)
    return Trajectory(times.astype(dtype), place, speed, none, count, none, resolved.method.name, dt, case.scene)


def posed(case: Case) -> tuple[np.ndarray, np.ndarray]:
    """The robot as the scene has it, at rest."""
    q = np.asarray(case.scene.structure.nodes)
    return q, np.zeros_like(q)


def gradient(case: Case):
    """Of a rollout by gravity, mapped and jitted."""
    options, times = resolve(case.scene, case.duration, case.options), np.array([0.0, case.duration])

    def lowest(g):
        scene = jax.tree.map(lambda x: x, case.scene)
        object.__setattr__(scene, "gravity", g)
        return rollout(scene, times, options=options).positions[-1, :, 2].mean()

    return jax.jit(jax.vmap(jax.grad(lowest)))(jnp.array([9.0, 9.81], case.row["dtype"]))


def plant(case: Case, **how):
    """One robot whose members of the gait are commanded; the first cable where it has none."""
    members = (2,) if case.scene.gait is None else case.scene.gait.members
    return control.plant_of(case.scene, members, period=0.01 * case.at.time, options=case.options, **how)


def driven(case: Case):
    """In a closed loop, by its gait, with sensors and motors that err."""
    sensors = control.Sensors(noise=control.Errors(directions=0.02), delay=2)
    limits = control.MotorLimits(rate=1.0 * case.at.speed, lag=0.02 * case.at.time)
    return control.simulate_policy(
        plant(case, sensors=sensors, motors=limits), control.OpenLoop(case.scene.gait), case.duration
    )


def phase_locked(case: Case):
    return control.simulate_policy(plant(case), control.PhaseLocked(case.scene.gait), case.duration)


def led(case: Case):
    """By predictive control, to a place."""
    inner = control.PhaseLocked(case.scene.gait)
    offsets = control.centre_offsets(case.scene.structure, inner.members)
    steered = control.Steered(inner, np.array(0.0), offsets)
    robot = plant(case)
    return control.lead_to(robot, robot, steered, np.array([1.0, 0.0]) * case.at.length)


def many_driven(case: Case):
    """Side by side, with another friction each."""
    friction = None if case.scene.friction is None else Differences(friction=np.array([0.9, 1.1]))
    many = control.side_by_side(plant(case), 2, friction)
    policy = control.OpenLoop(case.scene.gait)
    loop = control.loop_start(many, policy, jax.random.key(0))
    return jax.jit(lambda loop: control.drive(many, policy, loop, 3))(loop)


def sensed(case: Case):
    """What sensors say of the start; where nothing is wrong, all of it is finite."""
    q = np.asarray(case.scene.structure.nodes)
    seen = control.measure(case.scene, 0.0, q, np.zeros(q.shape))
    assert all(np.isfinite(np.asarray(x)).all() for x in jax.tree.leaves(seen))


def episode(task: str, case: Case):
    """Reset and step of an environment, as they are traced."""
    env = control.environment(task, case.scene, options=case.options)
    state = jax.eval_shape(env.reset, jax.random.key(0))
    return jax.eval_shape(env.step, state, jax.ShapeDtypeStruct((env.action_size,), np.float32))


def replayed(case: Case) -> None:
    with tempfile.TemporaryDirectory() as folder:
        view.keep_html(case.scene, falling(case), Path(folder) / "replay.html")


def animated(case: Case) -> None:
    with tempfile.TemporaryDirectory() as folder:
        animate(case.scene, falling(case), Path(folder) / "a.gif", 20)


def saved(case: Case) -> None:
    with tempfile.TemporaryDirectory() as folder:
        for ending in (".npz", ".csv", ".nc"):
            save_trajectory(falling(case), Path(folder) / f"motion{ending}")


def varied(case: Case):
    """Robots that differ in all that may differ."""
    parts = {"phase": 0.1, "actuation": 0.1, "cable_stiffness": 0.1, "node_mass": 0.1}
    parts |= {} if case.row["cables"] in ("limits", "table") else {"prestress": 0.1}
    parts |= {} if case.scene.ground is None else {"friction": 0.1, "slope": 0.02}
    if case.scene.ground is not None and case.scene.ground.surface is not None:
        parts |= {"terrain": 0.1 * case.at.length}
    gaits, differences = ensemble(
        jax.random.key(0), case.scene, as_population(case.scene.gait), Uncertainty(**parts), 2
    )
    return simulate_population(case.scene, gaits, case.duration, options=case.options, differences=differences)


def explored(case: Case):
    """The robot of the explorer's page, as the sliders stand, on its own and on the other contact model."""
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder) / "scene.toml")
        save_scene(case.scene, path)
        for contact in (OTHER, OWN):
            robot = chosen_robot(path, contact, OWN, case.duration)
    return robot.roll({knob.name: knob.value for knob in robot.knobs})


CALLS: dict[str, Callable[[Case], object]] = {
    "stable_step": lambda case: stable_step(case.scene, posed(case), "rk4"),
    "simulate": lambda case: simulate(case.scene, case.duration, options=case.options),
    "gradient of rollout": gradient,
    "population with metrics": lambda case: simulate_population(
        case.scene, as_population(case.scene.gait), case.duration, options=case.options, with_metrics=True
    ),
    "perturbed robots": varied,
    "energy_audit": lambda case: energy_audit(case.scene, case.duration, options=SolverOptions()),
    "diagnose": lambda case: diagnose(case.scene, case.duration, options=case.options),
    "verify": lambda case: verify(case.scene, as_population(case.scene.gait), case.duration, options=case.options),
    "sensitivity": lambda case: sensitivity(case.scene, case.duration, options=case.options),
    "find_orbit": lambda case: find_orbit(case.scene, 120.0 * case.at.time, options=case.options),
    "forces_along": lambda case: forces_along(case.scene, falling(case)),
    "rolling": lambda case: rolling(case.scene, falling(case)),
    "motion_report": lambda case: motion_report(case.scene, falling(case)),
    "rod_depths": lambda case: populations.rod_depths(case.scene, falling(case)),
    "member_figure": lambda case: plot.member_figure(case.scene, falling(case)),
    "force_figure": lambda case: plot.force_figure(case.scene, falling(case)),
    "path_figure": lambda case: plot.path_figure(case.scene, falling(case)),
    "gait_figure": lambda case: plot.gait_figure(case.scene.gait, case.duration, None),
    "replay": replayed,
    "animate": animated,
    "save_trajectory": saved,
    "inspect_structure": lambda case: inspect_structure(case.scene),
    "resting_shape": lambda case: resting_shape(case.scene),
    "settled": lambda case: settled(case.scene),
    "vibration_modes": lambda case: vibration_modes(case.scene),
    "open loop": driven,
    "phase-locked": phase_locked,
    "lead_to": led,
    "side_by_side": many_driven,
    "sensors": sensed,
    "explorer": explored,
    **{f"environment {task}": lambda case, task=task: episode(task, case) for task in control.TASKS},
    "without a gait": lambda case: simulate(with_gait(case.scene, None), case.duration, options=case.options),
}
