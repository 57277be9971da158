"""Figure 4: a block on an incline under each friction law, and the complementarity of appendix B."""

import equinox as eqx
import jax
import numpy as np
from matplotlib.figure import Figure
from paper_claims.report import Report, Row, significant, verdict

from jaxgrity import (
    ConeFriction,
    ExactGround,
    PenaltyGround,
    Scene,
    SmoothFriction,
    SolverOptions,
    Structure,
    SwitchFriction,
    simulate,
)
from jaxgrity.model import Friction
from jaxgrity.report import plot
from jaxgrity.stepping import smooth_force, velocities_midway

MU, G, K_N, DISSIPATION = 0.8, 9.81, 1e5, 2.0
STEP, DURATION = 1e-3, 5.0
SHOWN = slice(0, 1001, 4)
"""frames in the figure: the first second"""
FRICTION_ANGLE = float(np.degrees(np.arctan(MU)))
ANGLES = (10.0, 30.0, 38.0, round(0.999 * FRICTION_ANGLE, 2), round(1.001 * FRICTION_ANGLE, 2), 40.0, 45.0)
"""degrees"""
LAWS: dict[str, Friction] = {
    "smooth": SmoothFriction(MU, 1e-2),
    "switch": SwitchFriction(MU, MU, 1e-6),
    "cone": ConeFriction(MU),
}
STICKING = {"smooth": 1e-2, "switch": 1e-6, "cone": 1e-6}
"""m/s, below which a block counts as sticking: the slip speeds of the first two laws"""


def check(quick: bool) -> Report:
    """The block set down at rest, and dropped from 10 cm at 10 degrees."""
    angles = (10.0, 45.0) if quick else ANGLES
    facts = {law: {f"{angle:g}": slide(law, angle) for angle in angles} for law in LAWS}
    dropped = {law: slide(law, 10.0, height=0.1) for law in LAWS}
    rows = [penetration_row(law, facts[law]["10"], dropped[law]) for law in LAWS]
    rows += [angle_row(law, found) for law, found in facts.items()]
    rows += [chatter_row(law, facts[law], dropped[law]) for law in LAWS]
    rows += [cone_row(law, found) for law, found in facts.items()]
    rows += complementarity_rows(facts)
    drawn = {
        "slid": {law: [[float(a), row["slid"], row["exact"]] for a, row in facts[law].items()] for law in LAWS},
        "dropped": {law: {k: dropped[law][k] for k in ("times", "depth", "ratio")} for law in LAWS},
    }
    return Report("The friction switch", rows, "block", drawn)


def block(law: str, angle: float, height: float) -> tuple[Scene, np.ndarray]:
    """The scene and where it starts: pressed in as far as its weight does, or `height` above the plane."""
    theta = np.radians(angle)
    exact = law == "cone"
    damped = DISSIPATION if height and not exact else None
    ground = ExactGround(theta) if exact else PenaltyGround(K_N, damped, theta)
    normal = np.array(ground.normal)
    depth = 0.0 if exact or height else G * np.cos(theta) / K_N
    scene = Scene(Structure(np.zeros((1, 3)), np.ones(1)), G, ground=ground, friction=LAWS[law])
    return scene, ((height - depth) * normal)[None]


def slide(law: str, angle: float, height: float = 0.0) -> dict:
    """The motion, and what friction does in it."""
    scene, start = block(law, angle, height)
    options = SolverOptions("complementarity" if law == "cone" else "rk4", STEP, any_step=True)
    motion = simulate(scene, DURATION, options=options, frame_rate=1 / STEP, positions=start)
    q, v = np.asarray(motion.positions)[:, 0], velocities_midway(scene, motion)[:, 0]
    normal, down = (np.array(x) for x in (scene.ground.normal, scene.ground.tangents[0]))
    slip = v - (v @ normal)[:, None] * normal
    pressed, friction = forces(scene, law, q, v)
    touching = pressed > 1e-9
    ratio = np.where(touching, np.linalg.norm(friction, axis=1) / np.where(touching, pressed, 1), 0)
    speed, power = np.linalg.norm(slip, axis=1), np.sum(friction * slip, axis=1)
    slow = touching & (speed < STICKING[law])
    along = friction @ down
    theta = np.radians(angle)
    acceleration = max(0.0, G * (np.sin(theta) - MU * np.cos(theta)))
    return {
        "times": np.asarray(motion.times)[SHOWN],
        "depth": -(q @ normal)[SHOWN],
        "ratio": ratio[SHOWN],
        "penetration": float(max(0.0, -(q @ normal).min())),
        "penetration_at_rest": float(max(0.0, -(q[-1] @ normal))),
        "slid": float((q[-1] - q[0]) @ down),
        "exact": acceleration * DURATION**2 / 2,
        "reversals": int(np.sum(np.diff(np.sign(along[touching & (np.abs(along) > 1e-9)])) != 0)),
        "largest_ratio": float(ratio.max()),
        "work_while_sticking": float(np.sum(power[slow]) * STEP),
        "power_while_sticking": float(np.abs(power[slow]).max(initial=0)),
        "power_while_sliding": float(np.abs(power[touching & ~slow]).max(initial=0)),
    }


def forces(scene: Scene, law: str, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normal force, N, (frames,), and friction, N, (frames, 3); the cone's from the change of velocity in a step."""
    normal = np.array(scene.ground.normal)
    if law == "cone":
        gained = np.diff(v, axis=0, append=v[-1:]) / STEP + np.array([0, 0, G])
        # velocities live in the middle of steps; the first step is a half one
        gained[0], gained[-1] = gained[1], gained[-2]
        pressed = gained @ normal
        return np.maximum(pressed, 0), gained - pressed[:, None] * normal

    pressed, friction = _forces(scene, q[:, None], v[:, None])
    return np.asarray(pressed), np.asarray(friction)


@eqx.filter_jit
def _forces(scene: Scene, q: jax.Array, v: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The same of forces that are functions of the state, compiled once for all angles."""

    def at(q, v):
        pressed = scene.normal_force(q, v)
        if scene.force_laws:
            (switch,) = scene.force_laws
            others = smooth_force(scene, 0.0, q, v, pressed)
            return pressed[0], switch.force(scene.motion(v, q, 0.0, pressed), others)[0]
        return pressed[0], -jax.grad(lambda v: scene.dissipation_by_cause(v, q, 0.0, pressed)["friction"])(v)[0]

    return jax.vmap(at)(q, v)


def penetration_row(law: str, still: dict, dropped: dict) -> Row:
    measured = f"{significant(still['penetration_at_rest'], 'm')} at rest, "
    measured += f"{significant(dropped['penetration'], 'm')} after a drop from 10 cm"
    zero = still["penetration_at_rest"] <= 1e-12 and dropped["penetration"] <= 1e-12
    why = (
        "exact contact ends each step on or above the plane"
        if zero
        else "a spring holds the block only where it is pressed in: m g cos(theta)/k_n at rest, more in an impact. The "
        "paper's program puts the normal force in by hand, so its zero is no result"
    )
    return Row("penetration stays exactly zero, at 10 degrees", "7.2, Fig. 4", law, measured, verdict(zero), why)


def angle_row(law: str, found: dict) -> Row:
    creep = max(abs(row["slid"]) for angle, row in found.items() if float(angle) < FRICTION_ANGLE)
    off = max(abs(row["slid"] - row["exact"]) for angle, row in found.items() if float(angle) > FRICTION_ANGLE)
    measured = (
        f"below the friction angle ({FRICTION_ANGLE:.2f} degrees) it slides {significant(creep, 'm')} in "
        f"{DURATION:g} s, above it the distance is wrong by {significant(off, 'm')}"
    )
    holds = creep < 1e-6 and off < 1e-3
    why = {
        "smooth": "smoothed friction is viscous below its slip speed: a block on any slope creeps",
        "switch": "set down at rest it sticks and slides where it should",
        "cone": "the cone sticks and slides where it should",
    }[law]
    claim = "static friction is enforced: it sticks below, slides above the friction angle"
    return Row(claim, "7.2", law, measured, verdict(holds, creep < 0.1), why)


def chatter_row(law: str, found: dict, dropped: dict) -> Row:
    still, after = max(row["reversals"] for row in found.values()), dropped["reversals"]
    measured = f"friction changes its direction {still} times where the block starts at rest, {after} after the drop"
    why = {
        "smooth": "smoothed friction passes through zero with the slip",
        "switch": "a step changes the slip by mu g h = 8 mm/s, more than the 1e-6 m/s below which the switch lets a "
        "block stick: it jumps across",
        "cone": "the cone stops a block within a step",
    }[law]
    return Row("no chatter", "6.4, 7.2", law, measured, verdict(still + after <= 2, still == 0), why)


def cone_row(law: str, found: dict) -> Row:
    largest = max(row["largest_ratio"] for row in found.values())
    measured = f"largest |F_t|/F_n = {largest:.9f}, mu = {MU}"
    inside = largest <= MU * (1 + 1e-6)
    why = "each law bounds friction by mu times the normal force that the step knows"
    return Row("|F_t| <= mu F_n", "appendix B", law, measured, verdict(inside), why)


def complementarity_rows(facts: dict) -> list[Row]:
    """F_t·v_t = 0, while sticking and while sliding."""
    rows = []
    for law, found in facts.items():
        stick = max(row["power_while_sticking"] for row in found.values())
        work = sum(abs(row["work_while_sticking"]) for row in found.values())
        slip = max(row["power_while_sliding"] for row in found.values())
        measured = f"largest |F_t·v_t| {significant(stick, 'W')} sticking (slower than {STICKING[law]:g} m/s), work "
        measured += f"{significant(work, 'J')}; {significant(slip, 'W')} sliding"
        power = "sliding friction takes the power mu F_n |v_t|, as it must: F_t·v_t = 0 holds only while sticking"
        still = work < 1e-6
        rest = "a block that sticks does not move" if still else "smoothed friction lets a block creep, and takes power"
        rows += [
            Row("F_t·v_t = 0", "appendix B", f"{law}, sliding", measured, verdict(slip < 1e-6), power),
            Row("no mechanical work while sticking", "appendix B", f"{law}, sticking", measured, verdict(still), rest),
        ]
    return rows


@plot.styled
def figure(slid: dict, dropped: dict) -> Figure:
    chart = Figure(figsize=(plot.WIDTH, 4.2), layout="constrained")
    far, deep, ratio = chart.subplots(1, 3)
    for (law, found), marker in zip(slid.items(), plot.MARKERS):
        angles, distances, exact = np.array(found).T
        far.semilogy(angles, np.abs(distances) + 1e-16, f"{marker}-", label=law, alpha=0.7)
        motion, sparse = dropped[law], {"marker": marker, "markersize": 4, "markevery": 0.08}
        deep.plot(motion["times"], 1e3 * np.array(motion["depth"]), "--" if law == "switch" else "-", **sparse)
        ratio.plot(motion["times"], motion["ratio"], lw=1, **sparse)
    far.semilogy(angles[exact > 0], exact[exact > 0], "k_", ms=14, label="exact")
    far.axvline(FRICTION_ANGLE, color="C3", lw=1.2, label="friction angle")
    far.set(xlabel="incline (degrees)", ylabel="distance slid in 5 s (m)")
    deep.set(xlabel="time (s)", ylabel="depth below the plane (mm)", xlim=(0, 1), ylim=(-10, 4))
    ratio.axhline(MU, color="C4", lw=1.2, label="coefficient of friction")
    ratio.set(xlabel="time (s)", ylabel="friction / normal force", xlim=(0, 1))
    lines = {label: line for axes in (far, ratio) for line, label in zip(*axes.get_legend_handles_labels())}
    chart.legend(lines.values(), lines, loc="outside lower center", ncols=3)
    return chart
