"""Two models, one robot: spring struts tend to rigid ones as K grows, penalty contact to exact contact as k_n does.

Three motions: a drop, the robot settling, and a slow roll. Everything but the one law is the same in both models. In
the limit struts do not rebound, impacts are plastic and friction is Coulomb's. Stiff springs alone do not get there: at
a constant damping ratio they give back the same share of an impact, however stiff. So the damping of struts grows with
K, Hunt and Crossley's alpha with k_n, and the slip speed of smooth friction falls with k_n. Where nodes slip as they
hit the ground, one more difference stays: a stiff strut takes the impact in turn, its near end first, and Coulomb's law
depends on the order; a rigid one takes it at once. Without friction it goes.
"""

from collections.abc import Callable, Iterator
from typing import Literal

import equinox as eqx
import numpy as np
from measurements.measurement import Figure, Record, measurement
from measurements.pages import short, table

from jaxgrity import Members, PenaltyGround, Scene, SmoothFriction, SolverOptions, load_scene, simulate, with_gait
from jaxgrity.report import plot

STEP, FRAME_RATE = 5e-6, 50.0
"""s; 1/s"""
SOFT = {"K": "struts", "K, no friction": "struts, no friction", "k_n": "ground"}
"""Part that has springs, by the name of its law."""


@measurement(
    page="accuracy.md",
    quick={"motion": ("drop",), "strut_stiffness": (1e4, 1e5, 1e6), "ground_stiffness": (1e4, 1e5, 1e6)},
    drawn=("every",),
)
def equivalence(
    motion: Literal["drop", "settle", "roll"],
    strut_stiffness: tuple[float, ...] = (1e4, 3e4, 1e5, 3e5, 1e6),
    ground_stiffness: tuple[float, ...] = (3e3, 1e4, 3e4, 1e5, 3e5),
) -> Iterator[Record]:
    """A row for each law that grows stiffer.

    Args:
        motion: of the robot
        strut_stiffness: K, N/m
        ground_stiffness: k_n, N/m
    """
    prepare, duration = {"drop": (drop, 0.3), "settle": (settle_down, 3.0), "roll": (slow_roll, 4.0)}[motion]
    laws = {
        "K": (spring_struts, strut_stiffness, lambda scene: scene),
        "K, no friction": (spring_struts, strut_stiffness, frictionless),
        "k_n": (penalty_contact, ground_stiffness, lambda scene: scene),
    }
    for symbol, (law, values, adapt) in laws.items():
        exact = adapt(prepare(load_scene("exact")))
        every = compare(law, exact, values, duration)
        ends = {name: [every[name][0], every[name][-1]] for name in ("values", "distance")}
        yield {"grows": symbol, **ends, "slope": every["slope"], "every": every}
    expected = every["weight_over_n_k"][-1]
    depth = None if expected is None else every["penetration_at_end"][-1] / expected
    return {"motion": motion, "depth_over_expected": depth}


@equivalence.table
def words(record: Record) -> str:
    """Of each law the first and the last stiffness, and how deep the robot stands in the ground at the end."""
    rows = [
        [
            SOFT[row["grows"]],
            f"{row['values'][0]:.0e} to {row['values'][1]:.0e}",
            f"{short(1e3 * row['distance'][0])} to {short(1e3 * row['distance'][1])}",
            f"{row['slope']:.2f}",
        ]
        for row in record["rows"]
    ]
    said = table(["part with springs", "stiffness, N/m", "distance, mm", "slope"], rows)
    if record["motion"] != "settle":
        return said
    depth = [f"{rows[-1][1].split()[-1]}", f"{record['depth_over_expected']:.3f}"]
    return said + "\n\n" + table(["stiffness of the ground, N/m", "mean depth, in m g/(n k_n)"], [depth])


def drop(scene: Scene) -> Scene:
    """From 5 cm, without its gait."""
    nodes = scene.structure.nodes + np.array([0.0, 0.0, 0.05])
    return eqx.tree_at(lambda s: s.structure.nodes, with_gait(scene, None), nodes)


def settle_down(scene: Scene) -> Scene:
    """From where it touches the ground, until it stands."""
    nodes = scene.structure.nodes - np.array([0.0, 0.0, scene.structure.nodes[:, 2].min()])
    return eqx.tree_at(lambda s: s.structure.nodes, with_gait(scene, None), nodes)


def slow_roll(scene: Scene) -> Scene:
    """With a gait of 0.25 Hz from the start on."""
    frequency = np.full(len(scene.gait.members), 0.25)
    return eqx.tree_at(lambda s: (s.gait.frequency, s.gait.start), scene, (frequency, np.asarray(0.0)))


def frictionless(scene: Scene) -> Scene:
    """The same on ice."""
    return eqx.tree_at(lambda s: s.friction, scene, None)


def spring_struts(scene: Scene, stiffness: float) -> Scene:
    """Struts of stiffness K on exact ground, with a relaxation time c/K as in the scene "reference"."""
    struts = scene.structure.struts
    count = len(struts.edges)
    springs = Members(
        struts.edges, np.full(count, stiffness), struts.rest_length, np.full(count, 36.0 * stiffness / 2e4)
    )
    return eqx.tree_at(lambda s: s.structure.struts, scene, springs)


def penalty_contact(scene: Scene, stiffness: float) -> Scene:
    """Ground of stiffness k_n, with smooth friction, under rigid struts."""
    stiffer = stiffness / 1e4
    ground = PenaltyGround(stiffness, 2.0 * stiffer)
    friction = SmoothFriction(scene.friction.mu, 1e-2 / stiffer)
    return eqx.tree_at(lambda s: (s.ground, s.friction), scene, (ground, friction))


def path(scene: Scene, duration: float) -> np.ndarray:
    """(frames, nodes, 3), m."""
    options = SolverOptions(method="complementarity", dt=STEP, any_step=True)
    trajectory = simulate(scene, duration, options=options, frame_rate=FRAME_RATE)
    return np.asarray(trajectory.positions)


def compare(law: Callable, exact: Scene, values: tuple[float, ...], duration: float) -> Record:
    """Root mean square distance of the nodes from the exact scene's, over all frames, m, and how deep they end."""
    limit, distances, penetrations = path(exact, duration), [], []
    for value in values:
        positions = path(law(exact, value), duration)
        distances.append(float(np.sqrt(np.mean(np.sum((positions - limit) ** 2, axis=-1)))))
        deep = np.maximum(0, -positions[-1, :, 2])
        penetrations.append(
            {"mean": float(deep[deep > 0].mean()) if deep.any() else 0.0, "nodes": int((deep > 0).sum())}
        )
    fit = np.polyfit(np.log(values), np.log(distances), 1)
    weight = float(exact.structure.mass) * float(exact.gravity)
    return {
        "values": values,
        "distance": distances,
        "slope": float(fit[0]),
        "penetration_at_end": [p["mean"] for p in penetrations],
        "nodes_in_ground": [p["nodes"] for p in penetrations],
        "weight_over_n_k": [weight / p["nodes"] / v if p["nodes"] else None for p, v in zip(penetrations, values)],
    }


@equivalence.figure(4)
def figure(record: Record, chart: Figure) -> None:
    """Distance between the models against stiffness, and penetration at the end against m g / (n k_n)."""
    apart, deep = chart.subplots(1, 2)
    for each, marker, name in zip(
        record["rows"], plot.MARKERS, ("stiffer struts", "stiffer struts, no friction", "stiffer ground")
    ):
        row = each["every"]
        apart.loglog(row["values"], 1e3 * np.array(row["distance"]), f"{marker}-", label=name)
    apart.set(xlabel="stiffness (N/m)", ylabel="distance from the exact model (mm)")
    deep.loglog(row["values"], 1e3 * np.array(row["penetration_at_end"]), "D", color="C3", label="depth at the end")
    known = [(v, 1e3 * w) for v, w in zip(row["values"], row["weight_over_n_k"]) if w is not None]
    deep.loglog(*zip(*known), color="black", label="depth at rest by its weight")
    deep.set(xlabel="stiffness of the ground (N/m)", ylabel="mean depth of nodes in the ground (mm)")
    for axes in (apart, deep):
        axes.yaxis.set_minor_formatter("")
    chart.legend(loc="outside lower center", ncols=3)
