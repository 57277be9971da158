"""Appendix A, 6.2 and 6.3: the printed gradients against those of the energies, by automatic differentiation."""

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from paper_claims.report import Report, Row, verdict

from jaxgrity import Members, PenaltyGround, Scene, Structure
from jaxgrity.report import plot

K, L0 = 2e4, 0.8
SPRING = Members(((0, 1),), np.array([K]), np.array([L0]))
ENDS = np.array([[L0, 0.0, 0.0], [0.0, 0.0, 0.0]]), np.ones(2)
"""where a spring's nodes are at rest, m, and their masses, kg"""
INCLINE = np.radians(10.0)


def check(quick: bool) -> Report:
    """Random pairs of nodes for the springs, random nodes for the ground, a sweep through l = L0 for the cable."""
    count = 10 if quick else 1000
    draw = np.random.default_rng(0)
    pairs = draw.normal(size=(count, 2, 3))
    strut = Scene(Structure(*ENDS, struts=SPRING))
    by_autodiff = jax.jit(jax.vmap(jax.grad(lambda q: strut.potential_energy(q, 0.0))))(pairs)
    scale = float(np.abs(by_autodiff).max())
    facts = {
        "A.1": float(np.abs(by_autodiff - printed_appendix(pairs)).max()) / scale,
        "A.1, sign reversed": float(np.abs(by_autodiff + printed_appendix(pairs)).max()) / scale,
        "6.2": float(np.abs(by_autodiff - printed_section(pairs)).max()) / scale,
        "6.3": incline_error(draw.normal(size=(count, 3))),
        "normal": float(np.abs(printed_normal() - signed_normal()).max()),
        "slack": slack(),
    }
    return Report("Gradients", rows(facts), "slack_cable", {"cable": facts["slack"]})


def printed_appendix(pairs: np.ndarray) -> np.ndarray:
    """A.1: K (l - L) dl/dx_i with dl/dx_p = -d, dl/dx_q = +d, d = (x_p - x_q)/l."""
    d = pairs[:, 0] - pairs[:, 1]
    length = np.linalg.norm(d, axis=1, keepdims=True)
    force = K * (length - L0) * d / length
    return np.stack([-force, force], axis=1)


def printed_section(pairs: np.ndarray) -> np.ndarray:
    """6.2: -K (l - L0) (x_j - x_i)/|x_j - x_i| for node i, the opposite for node j."""
    r = pairs[:, 1] - pairs[:, 0]
    length = np.linalg.norm(r, axis=1, keepdims=True)
    force = K * (length - L0) * r / length
    return np.stack([-force, force], axis=1)


def printed_normal() -> np.ndarray:
    """6.3: (-tan theta, 1, 0) normalised, y up; in the axes of this project (z up, falling to +x) with x mirrored."""
    n = np.array([-np.tan(INCLINE), 1.0, 0.0])
    n /= np.linalg.norm(n)
    return np.array([-n[0], n[2], n[1]])


def signed_normal() -> np.ndarray:
    """As this project has it."""
    return np.array(PenaltyGround(1.0, incline=INCLINE).normal)


def incline_error(nodes: np.ndarray) -> float:
    """Of k_n min(0, n·x) n against the gradient of the contact energy, relative."""
    scene = Scene(Structure(nodes, np.ones(len(nodes))), ground=PenaltyGround(K, incline=INCLINE))
    n, gradient = printed_normal(), np.asarray(jax.grad(scene.potential_energy)(nodes, 0.0))
    printed = K * np.minimum(0, nodes @ n)[:, None] * n
    return float(np.abs(gradient - printed).max() / np.abs(gradient).max())


def slack() -> dict:
    """Force (N) and stiffness (N/m) of a cable, dPhi/dl and d2Phi/dl2, around l = L0."""
    cable = Scene(Structure(*ENDS, cables=SPRING))

    def energy(length):
        return cable.potential_energy(jnp.array([[1.0, 0, 0], [0, 0, 0]]) * length, 0.0)

    force, stiffness = jax.grad(energy), jax.grad(jax.grad(energy))
    lengths = L0 + np.linspace(-1e-3, 1e-3, 41)
    either = np.array([L0 - 1e-9, L0 + 1e-9])
    return {
        "stretch": lengths - L0,
        "force": jax.vmap(force)(lengths),
        "stiffness": jax.vmap(stiffness)(lengths),
        "force_at_rest": float(force(L0)),
        "jump_of_force": float(np.ptp(jax.vmap(force)(either))),
        "jump_of_stiffness": float(np.ptp(jax.vmap(stiffness)(either))),
    }


def rows(facts: dict) -> list[Row]:
    tight, cable = 1e-12, facts["slack"]
    scene = "random pairs of nodes"
    jumps = cable["jump_of_force"] > 1e-3
    return [
        Row(
            "grad U = K (l - L) dl/dx, dl/dx_q = d_pq, dl/dx_p = -d_pq",
            "A.1",
            scene,
            f"off by {facts['A.1']:.2g} times the largest force; with the sign reversed by "
            f"{facts['A.1, sign reversed']:.0e}",
            verdict(facts["A.1"] < tight),
            "d_pq = (x_p - x_q)/l is dl/dx_p: the signs of both rows are exchanged",
        ),
        Row(
            "grad_i U = -K (l - L0) (x_j - x_i)/l",
            "6.2",
            scene,
            f"off by {facts['6.2']:.0e} of the largest force",
            verdict(facts["6.2"] < tight),
            "the same gradient, with the right sign",
        ),
        Row(
            "n = (-tan theta, 1, 0)/|.|, grad U = k_n min(0, n·x) n",
            "6.3",
            "random nodes",
            f"normal off by {facts['normal']:.0e}, gradient by {facts['6.3']:.0e}",
            verdict(facts["normal"] < tight and facts["6.3"] < tight),
            "n is (-sin theta, cos theta, 0). The formula is the gradient, and the force is minus the gradient",
        ),
        Row(
            "Phi' is discontinuous at l = L0",
            "A.2",
            "one cable",
            f"Phi' jumps by {cable['jump_of_force']:.0e} N across 2e-9 m, Phi'' by {cable['jump_of_stiffness']:.3g} "
            "N/m",
            verdict(jumps),
            "K (l - L0) starts from 0: the force has a kink, and it is the stiffness that jumps, by K",
        ),
        Row(
            "the sub-differential at L0 is [0, K (l - L0)], the code takes its largest element",
            "A.2",
            "one cable",
            f"Phi'(L0) = {cable['force_at_rest']:g} N",
            verdict(False, cable["force_at_rest"] == 0.0),
            "at l = L0 the interval is [0, 0]: Phi is differentiable, there is one element and nothing to choose",
        ),
    ]


@plot.styled
def figure(cable: dict) -> Figure:
    chart = Figure(figsize=(plot.WIDTH, 3.8), layout="constrained")
    force, stiffness = chart.subplots(1, 2)
    stretch = 1e3 * np.array(cable["stretch"])
    force.plot(stretch, cable["force"])
    # the stiffness jumps after the last sample that has none, which is that of l = L0
    stiffness.plot(stretch, cable["stiffness"], drawstyle="steps-pre")
    force.set(xlabel="stretch l - L0 (mm)", ylabel="force (N)")
    stiffness.set(xlabel="stretch l - L0 (mm)", ylabel="stiffness (N/m)")
    for axes in (force, stiffness):
        axes.xaxis.set_major_locator(MaxNLocator(5))
    return chart
