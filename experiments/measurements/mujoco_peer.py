"""MuJoCo on the same robot: the model that `formats.mujoco_model` writes, with its own contacts. Extra: `peer`.

MJX, MuJoCo written in JAX, takes the same model. Extra: `mjx`.
"""

import time
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from measurements.limit import waves_at
from mujoco import rollout

from jaxgrity import Scene, one_gait
from jaxgrity.formats import mjcf_controls, mujoco_model

SOFTEST = 1e-4
"""The smallest impedance that MuJoCo knows."""


def build(scene: Scene, dt: float, integrator: str) -> mujoco.MjModel:
    """The scene as a MuJoCo model with steps of `dt` (s)."""
    return mujoco.MjModel.from_xml_string(mujoco_model(scene, dt, integrator).xml)


def controls(scene: Scene, phases: np.ndarray, steps: int, model: mujoco.MjModel) -> np.ndarray:
    """(gaits, steps, actuators), at the start of each step; actuators that damp nodes have none."""
    gaits, times = waves_at(scene.gait, phases), model.opt.timestep * np.arange(steps)
    moved = np.stack([mjcf_controls(scene, times, one_gait(gaits, k)) for k in range(len(phases))])
    return np.pad(moved, ((0, 0), (0, 0), (0, model.nu - moved.shape[-1])))


def sites(model: mujoco.MjModel, states: np.ndarray, nodes: int) -> np.ndarray:
    """(..., nodes, 3), m, where the nodes are in `states` (..., size), the full physics state of MuJoCo."""
    data = mujoco.MjData(model)
    order = [model.site(f"n{k}").id for k in range(nodes)]
    found = np.zeros((*states.shape[:-1], nodes, 3))
    for index in np.ndindex(states.shape[:-1]):
        data.qpos[:] = states[index][1 : 1 + model.nq]
        mujoco.mj_kinematics(model, data)
        found[index] = data.site_xpos[order]
    return found


def roll(
    scene: Scene, phases: np.ndarray, duration: float, dt: float, integrator: str, threads: int = 2
) -> tuple[np.ndarray, float]:
    """Positions of each gait's nodes at the end, (gaits, nodes, 3), m, and the wall time of a warm run, s."""
    model, steps = build(scene, dt, integrator), round(duration / dt)
    control = controls(scene, phases, steps, model)
    data = [mujoco.MjData(model) for _ in range(threads)]
    start = np.zeros((len(phases), mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)))
    start[:, 1 : 1 + model.nq] = model.qpos0
    rollout.rollout(model, data, start, control[:, :2])
    began = time.perf_counter()
    states, _ = rollout.rollout(model, data, start, control)
    wall = time.perf_counter() - began
    return sites(model, states[:, -1], len(scene.structure.nodes)), wall


def roll_mjx(scene: Scene, phases: np.ndarray, duration: float, dt: float, integrator: str) -> tuple[np.ndarray, float]:
    """`roll` by MJX in float32, all gaits in one `vmap`."""
    from mujoco import mjx

    steps, plain = round(duration / dt), build(scene, dt, integrator)
    with jax.enable_x64(False):
        model = mjx.put_model(plain)
        first, control = mjx.make_data(model), jnp.asarray(controls(scene, phases, steps, plain))

        @jax.jit
        @jax.vmap
        def final(control):
            return jax.lax.scan(lambda d, u: (mjx.step(model, d.replace(ctrl=u)), None), first, control)[0].qpos

        program = final.lower(control).compile()
        began = time.perf_counter()
        q = jax.block_until_ready(program(control))
        wall = time.perf_counter() - began
    states = np.concatenate([np.zeros((len(phases), 1)), np.asarray(q, float)], axis=1)
    return sites(plain, states, len(scene.structure.nodes)), wall


def with_spring_contact(stiffness: float) -> Callable[[mujoco.MjModel], None]:
    """A change of a model: what touches is pressed out by a spring of that stiffness (N/m), without damping.

    At the depth x, a contact of impedance d pushes there with (d/A) (k x/d - a). Here k stands in `solref`, A is the
    acceleration that a unit force gives the body, and a the acceleration without contact. So if d is small and
    k = K A, the contact is a spring of stiffness K. Its dimension is 1, since MuJoCo's smallest friction coefficient
    of 1e-5 shows in a motion of seconds.
    """

    def change(model: mujoco.MjModel) -> None:
        for geom in np.flatnonzero(model.geom_contype):
            alone = model.body_invweight0[model.geom_bodyid[geom], 0]
            model.geom_priority[geom] = 2  # above the ground's
            model.geom_solref[geom] = -stiffness * alone, 0.0
            model.geom_solimp[geom] = SOFTEST, SOFTEST, 1e-3, 0.5, 2.0
            model.geom_condim[geom] = 1

    return change


def without_friction(model: mujoco.MjModel) -> None:
    """A change of a model: what touches slides."""
    model.geom_condim[:] = 1


def without_contact(model: mujoco.MjModel) -> None:
    """A change of a model: nothing touches."""
    model.geom_contype[:], model.geom_conaffinity[:] = 0, 0


def run_once(
    scene: Scene,
    duration: float,
    dt: float,
    change: Callable[[mujoco.MjModel], None] | None = None,
    file: Path | None = None,
) -> tuple[np.ndarray, float]:
    """Where the nodes end by the scene's own gait, (nodes, 3), m, by RK4, and how deep in the ground the deepest is.

    `change` may change the model that is written. `file` is a model of the same robot that takes its place. There site
    `n3` is node 3, and controls change rest lengths, as in what is written.
    """
    steps = round(duration / dt)
    if file is None:
        model = build(scene, dt, "RK4")
    else:
        model = mujoco.MjModel.from_xml_path(str(file))
        model.opt.timestep, model.opt.integrator = dt, mujoco.mjtIntegrator.mjINT_RK4
    if change is not None:
        change(model)
    data = mujoco.MjData(model)
    for control in mjcf_controls(scene, dt * np.arange(steps)):
        data.ctrl[: len(control)] = control
        mujoco.mj_step(model, data)
    depth = float(-data.contact.dist.min()) if data.ncon else 0.0
    mujoco.mj_kinematics(model, data)
    order = [model.site(f"n{k}").id for k in range(len(scene.structure.nodes))]
    return data.site_xpos[order].copy(), depth
