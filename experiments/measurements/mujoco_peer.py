"""MuJoCo on the same robot: the same masses, springs, gaits and gravity, its own contacts. Extra: `peer`.

A node is a body on three slides; a member is a tendon with an affine actuator, F = K (L(t) - l) - c l', whose control
is L(t). A cable's force is clamped to pull, damping included, where jaxgrity's cable is damped only while it is taut.
Contact is MuJoCo's default soft constraint with its elliptic cone and the scene's friction coefficient, between nodes
and ground. MJX, MuJoCo written in JAX, takes the same model. Extra: `mjx`.
"""

import time

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import rollout

from jaxgrity import Gait, Scene, gaits_of, one_gait, rest_length

RADIUS = 1e-3
"""m, of the spheres that touch the ground, which lies as much lower"""


def build(scene: Scene, dt: float, integrator: str) -> mujoco.MjModel:
    """The scene as a MuJoCo model with steps of `dt` (s)."""
    g = 0.0 if scene.gravity is None else float(scene.gravity)
    structure, ground = scene.structure, scene.ground
    mass = np.asarray(structure.node_mass)
    drag = np.zeros(len(mass)) if scene.node_damping is None else np.asarray(scene.node_damping) * np.ones(len(mass))
    bodies, tendons, actuators = [], [], []
    for k, (x, m, c) in enumerate(zip(np.asarray(structure.nodes), mass, drag)):
        axes = ("1 0 0", "0 1 0", "0 0 1")
        slides = "".join(f'<joint type="slide" axis="{axis}" damping="{c:.17g}"/>' for axis in axes)
        bodies.append(
            f'<body pos="{x[0]:.17g} {x[1]:.17g} {x[2]:.17g}">{slides}<geom size="{RADIUS}" mass="{m:.17g}" '
            f'contype="1" conaffinity="0"/><site name="n{k}"/></body>'
        )
    for kind, limit in (("struts", ""), ("cables", 'forcelimited="true" forcerange="-1e9 0"')):
        members = getattr(structure, kind)
        for k, (i, j) in enumerate(members.edges if members is not None else ()):
            stiffness = float(members.stiffness[k])
            damping = 0.0 if members.damping is None else float(members.damping[k])
            tendons.append(f'<spatial name="{kind}{k}"><site site="n{i}"/><site site="n{j}"/></spatial>')
            actuators.append(
                f'<general tendon="{kind}{k}" gainprm="{stiffness:.17g}" biastype="affine" '
                f'biasprm="0 {-stiffness:.17g} {-damping:.17g}" {limit}/>'
            )
    plane = ""
    if ground is not None:
        mu = 0.0 if scene.friction is None else float(np.max(scene.friction.sliding_mu))
        n = ground.normal
        plane = (
            f'<geom type="plane" size="0 0 1" zaxis="{n[0]} {n[1]} {n[2]}" contype="0" conaffinity="1" '
            f'pos="{-RADIUS * n[0]} 0 {-RADIUS * n[2]}" friction="{mu} 0 0" priority="1"/>'
        )
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{dt:.17g}" integrator="{integrator}" gravity="0 0 {-g:.17g}" cone="elliptic"/>'
        f"<worldbody>{plane}{''.join(bodies)}</worldbody><tendon>{''.join(tendons)}</tendon>"
        f"<actuator>{''.join(actuators)}</actuator></mujoco>"
    )


def controls(scene: Scene, gait: Gait | None, steps: int, dt: float) -> np.ndarray:
    """(steps, members), L(t) at the start of each step, m."""
    structure, times = scene.structure, dt * np.arange(steps)
    lengths = [
        np.asarray(jax.vmap(lambda t, m=members, k=first: rest_length(m, gait, t, k))(times))
        for members, first in ((structure.struts, 0), (structure.cables, structure.first_cable))
        if members is not None
    ]
    return np.concatenate([np.broadcast_to(part, (steps, part.shape[-1])) for part in lengths], axis=1)


def roll(
    scene: Scene, phases: np.ndarray, duration: float, dt: float, integrator: str, threads: int = 2
) -> tuple[np.ndarray, float]:
    """Positions of each gait's nodes at the end, (gaits, nodes, 3), m, and the wall time of a warm run, s."""
    model, steps = build(scene, dt, integrator), round(duration / dt)
    gaits = gaits_of(scene.gait, phases)
    control = np.stack([controls(scene, one_gait(gaits, k), steps, dt) for k in range(len(phases))])
    data = [mujoco.MjData(model) for _ in range(threads)]
    start = np.zeros((len(phases), mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)))
    rollout.rollout(model, data, start, control[:, :2])
    began = time.perf_counter()
    states, _ = rollout.rollout(model, data, start, control)
    wall = time.perf_counter() - began
    return states[:, -1, 1 : 1 + model.nq].reshape(len(phases), -1, 3) + np.asarray(scene.structure.nodes), wall


def roll_mjx(scene: Scene, phases: np.ndarray, duration: float, dt: float, integrator: str) -> tuple[np.ndarray, float]:
    """`roll` by MJX in float32, all gaits in one `vmap`."""
    from mujoco import mjx

    steps = round(duration / dt)
    with jax.enable_x64(False):
        model = mjx.put_model(build(scene, dt, integrator))
        first, gaits = mjx.make_data(model), gaits_of(scene.gait, phases)
        control = jnp.stack([controls(scene, one_gait(gaits, k), steps, dt) for k in range(len(phases))])

        @jax.jit
        @jax.vmap
        def final(control):
            return jax.lax.scan(lambda d, u: (mjx.step(model, d.replace(ctrl=u)), None), first, control)[0].qpos

        program = final.lower(control).compile()
        began = time.perf_counter()
        q = jax.block_until_ready(program(control))
        wall = time.perf_counter() - began
    return np.asarray(q, float).reshape(len(phases), -1, 3) + np.asarray(scene.structure.nodes), wall
