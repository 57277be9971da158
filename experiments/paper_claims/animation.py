"""Figure 5: the robot settles, then rolls."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from paper_claims.report import REFERENCE, Report, Row, scenes, thinned, verdict

from jaxgrity import Scene, SolverOptions, Trajectory, centre_path, simulate
from jaxgrity.report import plot

STEP = 5e-4
MOMENT = 8.0
"""s, of the paper's second frame"""
ROLLED = 60.0
"""degrees: an icosahedron that has turned by less may still stand on its first face"""


def check(quick: bool) -> Report:
    """Rollouts of the scenes' own gaits: how far, how much the body has turned, how often its support changed."""
    duration = 2.0 if quick else 10.0
    known = scenes()
    names = (REFERENCE,) if quick else tuple(known)
    motions, finer = (
        {name: simulate(known[name], duration, options=SolverOptions("rk4", dt), frame_rate=50.0) for name in names}
        for dt in (STEP, STEP / 2)
    )
    facts = {name: roll(known[name], motion) for name, motion in motions.items()}
    for name, found in facts.items():
        found["distance_finer"] = roll(known[name], finer[name])["distance"]
    rows = [row(name, found) for name, found in facts.items()]
    drawn = {"frames": frames(known[REFERENCE], motions[REFERENCE])}
    return Report("The animation", rows, "frames", drawn)


def roll(scene: Scene, motion: Trajectory) -> dict:
    """What the body did by 8 s (or by the end of a shorter motion)."""
    times, q = np.asarray(motion.times), np.asarray(motion.positions)
    last = min(len(times) - 1, int(np.searchsorted(times, MOMENT)))
    path = centre_path(scene, motion)
    normal = np.array(scene.ground.normal)
    supports = [frozenset(np.argsort(x @ normal)[:3].tolist()) for x in q[times >= 1.0]]
    turned = [angle(q[0] - q[0].mean(0), x - x.mean(0)) for x in q[: last + 1]]
    return {
        "distance": float(np.hypot(*(path[last] - path[0])[:2])),
        "size": float(np.ptp(q[0], axis=0).max()),
        "turned": float(max(turned)),
        "support_faces": len(set(supports)),
        "failed": motion.failed,
    }


def angle(before: np.ndarray, after: np.ndarray) -> float:
    """Degrees of the rotation that best maps one cloud of nodes onto the other (Kabsch 1976)."""
    u, _, vt = np.linalg.svd(before.T @ after)
    sign = np.sign(np.linalg.det(u @ vt))
    rotation = u @ np.diag([1, 1, sign]) @ vt
    return float(np.degrees(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1))))


def row(name: str, found: dict) -> Row:
    measured = (
        f"by 8 s the centre has moved {found['distance']:.2f} m ({found['distance'] / found['size']:.1f} body sizes; "
        f"{found['distance_finer']:.2f} m at half the step), the body turned by up to {found['turned']:.0f} degrees, "
        f"stood on {found['support_faces']} triples of nodes"
    )
    rolls = found["turned"] >= ROLLED and not found["failed"]
    known = abs(found["distance"] - found["distance_finer"]) < 0.1 * found["distance"]
    why = "it turns onto other faces: it rolls" if rolls else "it does not turn onto another face: it hops or slides"
    why += "" if known else ". With this step, the place at the end is unknown"
    claim = "it settles, then actuation makes it roll, partly by 8 s"
    return Row(claim, "8, Fig. 5", name, measured, verdict(rolls and known, rolls), why)


def frames(scene: Scene, motion: Trajectory) -> list[dict]:
    """Three moments: the nodes, and the path of the centre before, near where it is then; m."""
    times, q = np.asarray(motion.times), np.asarray(motion.positions)
    path, found = centre_path(scene, motion)[:, :2], []
    for k in (0, min(len(times) - 1, 50), min(len(times) - 1, int(np.searchsorted(times, MOMENT)))):
        near = np.abs(path[: k + 1] - path[k]).max(1) < 0.9
        found.append({"time": times[k], "nodes": q[k], "centre": path[k], "path": thinned(path[: k + 1][near])})
    return found


@plot.styled
def figure(frames: list[dict]) -> Figure:
    scene, chart = scenes()[REFERENCE], Figure(figsize=(plot.WIDTH, 3.6))
    for place, frame in enumerate(frames):
        axes = chart.add_subplot(1, 3, place + 1, projection="3d", computed_zorder=False)
        x, y = frame["centre"]
        corners = np.array([[x - 1, x + 1], [x - 1, x + 1]]), np.array([[y - 1, y - 1], [y + 1, y + 1]])
        axes.plot_surface(*corners, 0 * corners[0], color=plot.GROUND, alpha=0.5, shade=False)
        near = np.array(frame["path"])
        axes.plot(near[:, 0], near[:, 1], 0 * near[:, 0], color=plot.PATH)
        plot.draw_robot(axes, scene, np.array(frame["nodes"]))
        axes.set(xlim=(x - 0.8, x + 0.8), ylim=(y - 0.8, y + 0.8), zlim=(0, 1.2))
        axes.set(xlabel="x (m)", ylabel="y (m)", zlabel="z (m)", title=f"t = {frame['time']:.1f} s")
        axes.set_box_aspect((1.6, 1.6, 1.2), zoom=0.95)
        axes.patch.set_visible(False)  # it would cover the labels of the axes to the left
        for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
            axis.set_major_locator(MaxNLocator(4, prune="both"))
    chart.subplots_adjust(left=0.0, right=0.96, bottom=0.04, top=0.92, wspace=0.1)  # 3D labels count in no layout
    return chart
