"""The reference scene as a plain NumPy loop, one robot at a time: how such a simulator is usually first written.

Its speed is what others are compared with, and its answer is independent: no energies, no automatic differentiation.
"""

import numpy as np

from jaxgrity import Scene


def roll(scene: Scene, phase: np.ndarray, duration: float, dt: float) -> np.ndarray:
    """Centre of mass at the end, (3,), m, by RK4."""
    structure, gait, ground, friction = scene.structure, scene.gait, scene.ground, scene.friction
    mass, drag = np.asarray(structure.node_mass), np.asarray(scene.node_damping)
    members = []
    for kind in (structure.struts, structure.cables):
        rows = zip(kind.edges, np.asarray(kind.stiffness), np.asarray(kind.rest_length), np.asarray(kind.damping))
        members += [(i, j, K, L, c, kind is structure.cables) for (i, j), K, L, c in rows]
    actuated = {k: a for a, k in enumerate(gait.members)}
    k_n, alpha = float(ground.stiffness), float(ground.dissipation)
    mu, eps, g = float(friction.mu), float(friction.slip_speed), float(scene.gravity)
    delta, frequency = np.asarray(gait.amplitude), np.asarray(gait.frequency)

    def acceleration(t, x, v):
        force = -drag[:, None] * v
        force[:, 2] -= mass * g
        ramp = min(max((t - float(gait.start)) / float(gait.ramp), 0.0), 1.0)
        for number, (i, j, K, L, c, cable) in enumerate(members):
            if number in actuated:
                a = actuated[number]
                L = L * (1 - delta[a] / 2 * ramp * (1 + np.sin(2 * np.pi * frequency[a] * t + phase[a])))
            d = x[i] - x[j]
            length = np.sqrt(d @ d)
            if cable and length <= L:
                continue
            d = d / length
            pull = (K * (length - L) + c * (d @ (v[i] - v[j]))) * d
            force[i] -= pull
            force[j] += pull
        for n in range(len(x)):
            if x[n, 2] < 0:
                normal = -k_n * x[n, 2] * max(0.0, 1 - alpha * v[n, 2])
                slip = v[n, :2]
                force[n, 2] += normal
                force[n, :2] -= mu * normal * slip / np.sqrt(slip @ slip + eps * eps)
        return force / mass[:, None]

    x = np.array(structure.nodes, float)
    v = np.zeros_like(x)
    for n in range(round(duration / dt)):
        t = n * dt
        a1 = acceleration(t, x, v)
        v2 = v + dt / 2 * a1
        a2 = acceleration(t + dt / 2, x + dt / 2 * v, v2)
        v3 = v + dt / 2 * a2
        a3 = acceleration(t + dt / 2, x + dt / 2 * v2, v3)
        v4 = v + dt * a3
        a4 = acceleration(t + dt, x + dt * v3, v4)
        x = x + dt / 6 * (v + 2 * v2 + 2 * v3 + v4)
        v = v + dt / 6 * (a1 + 2 * a2 + 2 * a3 + a4)
    return mass @ x / mass.sum()
