"""Appendix A.3: struts as their stiffness grows, and the mass matrix of what remains."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure
from paper_claims.report import (
    CALLED,
    PROGRAM,
    REFERENCE,
    TEXT,
    Report,
    Row,
    scenes,
    significant,
    stiffened,
    verdict,
    without,
)

from jaxgrity import Scene, SolverOptions, edge_lengths, simulate
from jaxgrity.report import plot

STIFFNESSES = (1e4, 1e5, 1e6, 1e7)
DURATION = 0.5
SPEED = 0.5
"""m/s, of the nodes at the start"""


def check(quick: bool) -> Report:
    """Strut strain in free flight, from velocities that the constraints allow and from velocities that they do not."""
    known = scenes()
    names = (TEXT,) if quick else (PROGRAM, TEXT, REFERENCE)
    values = STIFFNESSES[:2] if quick else STIFFNESSES
    strains = {name: {kind: strain(known[name], values, kind) for kind in ("allowed", "any")} for name in names}
    rows = [strain_row(name, kind, found[kind]) for name, found in strains.items() for kind in ("allowed", "any")]
    rows += [mass_row(name, reduced_mass(known[name])) for name in names]
    return Report("The rigid limit", rows, "rigid_limit", {"values": values, "strains": strains})


def strain(scene: Scene, values: tuple[float, ...], kind: str) -> dict:
    """Largest |l - L|, m, for each stiffness; slope of its logarithm between the two largest, where prestress matters
    least."""
    free = undamped(without(scene, "ground", "friction", "gait", "gravity", "node_damping"))
    q = np.asarray(free.structure.nodes)
    v = np.random.default_rng(0).normal(size=q.shape)
    if kind == "allowed":
        directions = strut_rows(free)
        v = v - (directions.T @ np.linalg.lstsq(directions.T, v.ravel(), rcond=None)[0]).reshape(v.shape)
    v *= SPEED / np.sqrt(np.mean(np.sum(v * v, axis=1)))
    found = []
    for K in values:
        stiff = stiffened(free, K)
        options = SolverOptions("rk4", 2e-5, any_step=True)
        motion = simulate(stiff, DURATION, options=options, frame_rate=1e4, velocities=v)
        lengths = np.array([edge_lengths(x, stiff.structure.struts.edges) for x in np.asarray(motion.positions)])
        found.append(float(np.abs(lengths - np.asarray(stiff.structure.struts.rest_length)).max()))
    return {"strain": found, "slope": float(np.log(found[-1] / found[-2]) / np.log(values[-1] / values[-2]))}


def undamped(scene: Scene) -> Scene:
    """The same robot without dampers in its members."""
    where = lambda s: (s.structure.struts.damping, s.structure.cables.damping)  # noqa: E731
    return eqx.tree_at(where, scene, (None, None), is_leaf=lambda x: x is None)


def strut_rows(scene: Scene) -> np.ndarray:
    """(struts, 3 nodes): d l/dq of each strut, from the energy's own edge lengths."""
    edges = np.asarray(scene.structure.struts.edges)

    def lengths(q):
        return jnp.linalg.norm(q[edges[:, 0]] - q[edges[:, 1]], axis=1)

    q = jnp.asarray(scene.structure.nodes)
    return np.asarray(jax.jacobian(lengths)(q)).reshape(len(edges), -1)


def reduced_mass(scene: Scene) -> dict:
    """What is left of M when the struts' lengths are constraints."""
    mass = np.repeat(np.asarray(scene.structure.node_mass), 3)
    _, strengths, axes = np.linalg.svd(strut_rows(scene))
    basis = axes[np.sum(strengths > 1e-9) :].T
    reduced = basis.T @ (mass[:, None] * basis)
    i, j = scene.structure.struts.edges[0]
    q = np.asarray(scene.structure.nodes)
    arms, ends = q[[i, j]] - q[[i, j]].mean(0), np.asarray(scene.structure.node_mass)[[i, j]]
    J = np.einsum("e,ek,ek->", ends, arms, arms) * np.eye(3) - np.einsum("e,ei,ej->ij", ends, arms, arms)
    return {
        "size": len(reduced),
        "off_diagonal": float(np.abs(reduced - np.diag(np.diag(reduced))).max()),
        "inertia": np.linalg.eigvalsh(J),
        "rank": int(np.linalg.matrix_rank(J, tol=1e-9 * np.abs(J).max())),
    }


def strain_row(name: str, kind: str, found: dict) -> Row:
    close = abs(found["slope"] + 1) < 0.15
    first, last = (significant(found["strain"][k], "m") for k in (0, -1))
    measured = f"largest |l - L| from {first} to {last}, slope {found['slope']:.2f}"
    why = (
        "the force in a strut is that of its constraint, f, and stretches it by about f/K"
        if kind == "allowed"
        else "velocity along a strut is energy in its vibration, K s^2/2 for any K: s falls as 1/sqrt(K). Fixed "
        "initial energy is not enough, velocities must respect the lengths"
    )
    label = "lengths kept at t = 0" if kind == "allowed" else "any velocities at t = 0"
    return Row(
        "strut strain is O(1/K) at fixed initial energy", "A.3", f"{name}, {label}", measured, verdict(close), why
    )


def mass_row(name: str, found: dict) -> Row:
    measured = f"{found['size']} coordinates remain of 36; in an orthonormal basis M is m times the identity to "
    measured += f"{found['off_diagonal']:.0e}; J_s has eigenvalues "
    measured += ", ".join(significant(x) for x in found["inertia"]) + f" kg m^2, rank {found['rank']}"
    why = (
        "six constraints leave 30 coordinates, so it is m I_30, in a basis that turns with the struts. With a centre p "
        "and a rotation R for each strut it is diag(2 m I_3, J_s), with the inertia J_s about the centre. Spin about a "
        "strut's own axis moves no mass, so J_s is singular"
    )
    return Row("the reduced mass matrix is still m I_36", "A.3, 3.5", name, measured, verdict(found["size"] == 36), why)


@plot.styled
def figure(values: tuple[float, ...], strains: dict) -> Figure:
    chart = Figure(figsize=(plot.WIDTH, 5.5), layout="constrained")
    axes = chart.subplots()
    looks = iter(zip(range(8), plot.MARKERS))
    kinds = {"allowed": ("-", "lengths kept at first"), "any": ("--", "any velocities")}
    for name, found in strains.items():
        for kind, (style, words) in kinds.items():
            (k, marker), row = next(looks), found[kind]
            label = f"{CALLED[name]}, {words}: slope {row['slope']:.2f}"
            axes.loglog(values, row["strain"], marker + style, color=f"C{k}", label=label)
    axes.set(xlabel="stiffness of the struts (N/m)", ylabel="largest change of a strut's length (m)")
    chart.legend(loc="outside lower center", ncols=2)
    return chart
