"""Two models, one robot: spring struts tend to rigid ones as K grows, penalty contact to exact contact as k_n does.

Three motions: a drop, the robot settling, and a slow roll. Everything but the one law is the same in both models. In
the limit struts do not rebound, impacts are plastic and friction is Coulomb's. Stiff springs alone do not get there: at
a constant damping ratio they give back the same share of an impact, however stiff. So the damping of struts grows with
K, Hunt and Crossley's alpha with k_n, and the slip speed of smooth friction falls with k_n. Where nodes slip as they
hit the ground, one more difference stays: a stiff strut takes the impact in turn, its near end first, and Coulomb's law
depends on the order; a rigid one takes it at once. Without friction it goes.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from jaxgrity.cli.script import measured, run

import equinox as eqx
import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from jaxgrity import Members, PenaltyGround, Scene, SmoothFriction, SolverOptions, load_scene, simulate, with_gait
from jaxgrity.io.files import save_json
from jaxgrity.report import plot

FRAME_RATE = 50.0


@dataclass
class Settings:
    strut_stiffness: tuple[float, ...] = (1e4, 3e4, 1e5, 3e5, 1e6)
    """K, N/m"""
    ground_stiffness: tuple[float, ...] = (3e3, 1e4, 3e4, 1e5, 3e5)
    """k_n, N/m"""
    dt: float = 5e-6
    """step of all rollouts, s"""
    out: Path = Path("results/equivalence")
    """folder for a JSON file and a figure for each motion"""
    quick: bool = False
    """the drop alone, with three values of each"""


def main(settings: Settings) -> None:
    motions = {"drop": (drop, 0.3), "settle": (settle_down, 3.0), "roll": (slow_roll, 4.0)}
    if settings.quick:
        motions = {"drop": motions["drop"]}
        settings.strut_stiffness = settings.ground_stiffness = (1e4, 1e5, 1e6)
    laws = {
        "K": (spring_struts, settings.strut_stiffness, lambda scene: scene),
        "K, no friction": (spring_struts, settings.strut_stiffness, frictionless),
        "k_n": (penalty_contact, settings.ground_stiffness, lambda scene: scene),
    }
    with tqdm(total=len(motions) * sum(1 + len(values) for _, values, _ in laws.values()), unit="rollout") as bar:
        for name, (prepare, duration) in motions.items():
            bar.set_description(name)
            facts: dict = {**measured(), "motion": name, "duration": duration, "dt": settings.dt}
            for symbol, (law, values, adapt) in laws.items():
                exact = adapt(prepare(load_scene("exact")))
                limit = path(exact, duration, settings.dt)
                bar.update()
                facts[symbol] = compare(law, exact, values, limit, duration, settings.dt, bar.update)
            save_json(settings.out / f"{name}.json", facts)
            plot.save(figure(facts), settings.out / f"{name}.png")
            slopes = ", ".join(f"{symbol}^{facts[symbol]['slope']:.2f}" for symbol in laws)
            bar.write(f"{name}: the distance between the models goes as {slopes}")
    print(f"wrote {settings.out}/")


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


def path(scene: Scene, duration: float, dt: float) -> np.ndarray:
    """(frames, nodes, 3), m."""
    options = SolverOptions(method="complementarity", dt=dt, any_step=True)
    trajectory = simulate(scene, duration, options=options, frame_rate=FRAME_RATE)
    return np.asarray(trajectory.positions)


def compare(
    law: Callable,
    exact: Scene,
    values: tuple[float, ...],
    limit: np.ndarray,
    duration: float,
    dt: float,
    done: Callable,
) -> dict:
    """Root mean square distance of the nodes from the limit, over all frames, m, and what the ground gives way."""
    distances, penetrations = [], []
    for value in values:
        positions = path(law(exact, value), duration, dt)
        distances.append(float(np.sqrt(np.mean(np.sum((positions - limit) ** 2, axis=-1)))))
        deep = np.maximum(0, -positions[-1, :, 2])
        penetrations.append(
            {"mean": float(deep[deep > 0].mean()) if deep.any() else 0.0, "nodes": int((deep > 0).sum())}
        )
        done()
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


@plot.styled
def figure(facts: dict) -> Figure:
    """Distance between the models against stiffness, and penetration at rest against m g / (n k_n)."""
    chart = Figure(figsize=(10, 4), layout="constrained")
    apart, deep = chart.subplots(1, 2)
    for symbol, marker in (("K", "o"), ("K, no friction", "^"), ("k_n", "s")):
        row = facts[symbol]
        apart.loglog(row["values"], row["distance"], f"{marker}-", label=f"{symbol}: slope {row['slope']:.2f}")
    apart.set(xlabel="K, k_n (N/m)", ylabel="rms distance of the nodes, m", title=f"{facts['motion']}: from exact")
    apart.legend()
    row = facts["k_n"]
    deep.loglog(row["values"], row["penetration_at_end"], "s", label="mean penetration at the end")
    known = [(v, w) for v, w in zip(row["values"], row["weight_over_n_k"]) if w is not None]
    deep.loglog(*zip(*known), "k-", lw=0.8, label="m g / (n k_n), at rest")
    deep.set(xlabel="k_n (N/m)", ylabel="m")
    deep.legend()
    return chart


if __name__ == "__main__":
    run(main, Settings)
