"""Whether forward mode, reverse mode and central differences agree on derivatives, for every array of a scene.

Of six short rollouts that do not switch, with penalty and with exact contact, of two shapes at rest, and of an orbit's
speed.
"""

import json
from collections.abc import Callable, Generator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from measurements.measurement import Figure, Record, check_names, measurement
from measurements.pages import table

from jaxgrity import (
    ConeFriction,
    ExactGround,
    Gait,
    Members,
    Overtone,
    PenaltyGround,
    Scene,
    SmoothFriction,
    SolverOptions,
    Structure,
    final_state,
    load_scene,
    with_gait,
)
from jaxgrity.io.files import read_text
from jaxgrity.orbits import closed_orbit, find_orbit
from jaxgrity.report import plot
from jaxgrity.statics import equilibrium_near, resting_shape
from jaxgrity.stepping import resolve

DURATION = 0.02
"""s"""
SLIDING = np.array([0.6, 0.3, 0.0])
"""m/s: nodes on the ground slide all the time, and none begins or ceases to"""
STEP = 2e-5
"""of the differences, relative"""


Outcome = Callable[[Scene, tuple], jax.Array]
"""what is differentiated: numbers, of a scene and of positions and velocities at the start"""


class Case(NamedTuple):
    """A robot, and what becomes of it."""

    make: Callable[[], Scene]
    outcome: Callable[[Scene], Outcome]
    velocity: np.ndarray = np.zeros(3)
    """m/s, of all nodes at the start"""


def rollout(dt: float) -> Callable[[Scene], Outcome]:
    """The state at the end, m and m/s."""

    def of(scene: Scene) -> Outcome:
        options = resolve(scene, DURATION, SolverOptions(dt=dt, any_step=True))

        def end(there, start):
            return jnp.concatenate([x.ravel() for x in final_state(there, DURATION, options, start)])

        return end

    return of


def rest(scene: Scene) -> Outcome:
    """The shape at rest: all distances between nodes, m, since nothing says where a robot afloat is."""
    shape = resting_shape(scene).q
    first, second = np.triu_indices(len(shape), 1)

    def distances(there, start):
        q = equilibrium_near(there, shape)
        return jnp.linalg.norm(q[first] - q[second], axis=1)

    return distances


def orbit_speed(scene: Scene) -> Outcome:
    """Of the orbit on which it settles, mm/s."""
    options = resolve(scene, 1.0, SolverOptions("rk4", 2e-3))
    orbit = find_orbit(scene, 60.0, options=options)
    return lambda there, start: 1e3 * closed_orbit(there, orbit, options).speed[None]


def tripod(exact: bool = False) -> Scene:
    """A tetrahedron of rods that slides on three feet."""
    turn = 2 * np.pi / 3 * np.arange(3)
    feet = np.stack([0.5 * np.cos(turn), 0.5 * np.sin(turn), 0 * turn], axis=1)
    nodes = np.vstack([feet, [[0.05, 0.02, 0.7]]])
    lengths, feet_of = np.linalg.norm(feet - nodes[3], axis=1), ((0, 3), (1, 3), (2, 3))
    struts = Members(feet_of, np.full(3, 5e3), lengths, damping=np.full(3, 20.0))
    cables = Members(((0, 1), (1, 2), (2, 0)), np.full(3, 300.0), np.full(3, 0.8), damping=np.full(3, 4.0))
    sunk = np.array([0, 0, 0 if exact else 2e-3])
    structure = Structure(nodes - sunk, np.array([0.5, 0.6, 0.7, 1.0]), struts, cables)
    ground, friction = PenaltyGround(1e4, 2.0), SmoothFriction(0.4, 0.05)
    scene = Scene(structure, gravity=9.81, node_damping=np.full(4, 0.3), ground=ground, friction=friction)
    return replace(scene, ground=ExactGround(), friction=ConeFriction(0.4)) if exact else scene


def running(scene: Scene, start: float = -0.4) -> Scene:
    """Its gait on its ramp, so that every number of it matters."""
    assert scene.gait is not None
    return with_gait(scene, replace(scene.gait, start=np.array(start), ramp=np.array(1.0)))


def lowered(scene: Scene, depth: float) -> Scene:
    """With the lowest node so deep in the ground, m."""
    nodes = np.asarray(scene.structure.nodes)
    down = np.array([0, 0, nodes[:, 2].min() + depth])
    return replace(scene, structure=replace(scene.structure, nodes=nodes - down))


def hanging() -> Scene:
    """A chain of two nodes on a support, its upper spring actuated."""
    nodes = np.array([[0.0, 0, 0], [0.1, 0, -1.1], [0.2, 0.1, -2.0]])
    cables = Members(((0, 1), (1, 2)), [300.0, 200.0], [1.0, 0.8], damping=[1.0, 2.0])
    structure = Structure(nodes, [0.0, 2.0, 1.0], cables=cables, fixed=((0, "xyz"),))
    gait = Gait((0,), [0.3], [0.2], [1.0], start=-0.4, ramp=1.0)
    return Scene(structure, gravity=9.81, node_damping=np.full(3, 0.3), gait=gait)


def crawler() -> Scene:
    """Two unequal masses on a strut that lengthens faster than it shortens, so that it creeps over the ground."""
    nodes = np.array([[0.0, 0, -1e-3], [1, 0, -1e-3]])
    struts = Members(((0, 1),), [2e3], [1.1], damping=[20.0])
    gait = Gait((0,), [0.0], [0.2], [1.0], start=0.0, ramp=1.0, overtones=(Overtone([0.5], [np.pi / 2]),))
    ground, friction = PenaltyGround(1e4, 2.0), SmoothFriction(0.2, 0.2)
    structure = Structure(nodes, [1.0, 3.0], struts=struts)
    return Scene(structure, gravity=9.81, ground=ground, friction=friction, gait=gait)


def floating() -> Scene:
    """The robot in the balance of its own prestress, its gait stopped at some shape."""
    return replace(running(load_scene("reference")), ground=None, friction=None, gravity=None)


BEGUN = 4.5e-3
"""s, between two steps: rigid struts have to start as long as they are built, and the ramp's beginning is a corner"""
CASES = {
    "tripod slides, penalty": Case(tripod, rollout(5e-4), SLIDING),
    "robot slides, penalty": Case(lambda: lowered(running(load_scene("reference")), 2e-3), rollout(5e-4), SLIDING),
    "robot flies, springs": Case(lambda: lowered(running(load_scene("reference")), -0.5), rollout(5e-4), SLIDING),
    "chain hangs, springs": Case(hanging, rollout(5e-4)),
    "tripod slides, exact": Case(lambda: tripod(exact=True), rollout(1e-3), SLIDING),
    "robot flies, rigid struts": Case(
        lambda: lowered(running(load_scene("exact"), BEGUN), -0.5), rollout(1e-3), SLIDING
    ),
    "chain at rest": Case(hanging, rest),
    "robot at rest, afloat": Case(floating, rest),
    "speed of an orbit": Case(crawler, orbit_speed),
}


@measurement(page="identification.md", quick={"robots": tuple(CASES)[:2]}, raw=("rows",), drawn=("dots",))
def leaf_gradients(out: Path, robots: tuple[str, ...] = tuple(CASES), seed: int = 1) -> Generator[Record, None, Record]:
    """A row for each array of each robot, and the worst of each robot.

    Args:
        robots: which; what the folder has of others is kept
        seed: of the direction in which each array varies
    """
    check_names("robots", robots, CASES)
    before = out / "leaf_gradients.json"
    rows = json.loads(read_text(before))["rows"] if before.exists() else []
    rows = [row for row in rows if row["robot"] not in robots]
    yield from rows
    for name in robots:
        found = [{"robot": name, **row} for row in compared(CASES[name], seed)]
        rows += found
        yield from found
    measured = [name for name in CASES if any(row["robot"] == name for row in rows)]
    each = {name: [row for row in rows if row["robot"] == name] for name in measured}
    return {
        "robots": {name: worst_of(found) for name, found in each.items()},
        "dots": {name: dots_of(found) for name, found in each.items()},
    }


def dots_of(rows: list[Record]) -> Record:
    """Disagreements of the arrays that matter."""
    return {kind: [row[kind] for row in rows if row["derivative"]] for kind in ("reverse", "differences")}


def worst_of(rows: list[Record]) -> Record:
    """How many arrays a robot has and how many of them matter, and the largest disagreements."""
    largest = {kind: max(row[kind] for row in rows) for kind in ("reverse", "differences")}
    return {"arrays": len(rows), "matter": sum(row["derivative"] != 0 for row in rows), **largest}


def compared(case: Case, seed: int = 1) -> list[dict[str, Any]]:
    """Of every array of a robot, its gait and its start: the derivative, and by how much modes and differences miss it.

    The derivative is that of a random sum of the outcome, by a relative change of the array in a random
    direction. Misses count relative to it where it is above 1 (m, m/s, mm/s), and else absolutely.
    """
    scene, random = case.make(), np.random.default_rng(seed)
    q = np.asarray(scene.structure.nodes)
    start = (q, np.where(scene.structure.free, case.velocity, 0.0))
    outcome = case.outcome(scene)
    leaves, tree = jax.tree.flatten((scene, start))
    paths = [jax.tree_util.keystr(path) for path, _ in jax.tree_util.tree_flatten_with_path((scene, start))[0]]
    # supports hold their nodes
    held = [scene.structure.free if np.shape(x) == q.shape else 1.0 for x in leaves]
    directions = [random.normal(size=np.shape(x)) * np.maximum(np.abs(x), 1e-2) * mask for x, mask in zip(leaves, held)]
    weights = random.normal(size=jax.eval_shape(outcome, scene, start).shape)

    def f(c):
        moved = [x + c[k] * d for k, (x, d) in enumerate(zip(leaves, directions))]
        there, begin = jax.tree.unflatten(tree, moved)
        return weights @ outcome(there, begin)

    # values come from the program of reverse mode, which spares one of their own
    at, with_reverse = jnp.zeros(len(leaves)), jax.jit(jax.value_and_grad(f))
    forward, reverse = np.asarray(jax.jit(jax.jacfwd(f))(at)), np.asarray(with_reverse(at)[1])
    rows = []
    for k, path in enumerate(paths):
        near = [float(with_reverse(c * STEP * np.eye(len(leaves))[k])[0]) for c in (1, -1, 2, -2)]
        difference = (8 * (near[0] - near[1]) - near[2] + near[3]) / (12 * STEP)
        size = max(1.0, abs(forward[k]))
        rows.append(
            {
                "leaf": leaf_name(path),
                "derivative": float(forward[k]),
                "reverse": float(abs(reverse[k] - forward[k]) / size),
                "differences": float(abs(difference - forward[k]) / size),
            }
        )
    return rows


def leaf_name(path: str) -> str:
    """Such as "structure.cables.stiffness"; "start q" and "start v" for the start."""
    return {"[1][0]": "start q", "[1][1]": "start v"}.get(path, path.removeprefix("[0]."))


@leaf_gradients.figure(3.6)
def figure(record: Record, chart: Figure) -> None:
    """Disagreements, a dot for each array, a line for each robot."""
    names = list(record["dots"])
    axes = chart.subplots()
    labels = {"reverse": "reverse mode", "differences": "central differences"}
    for (kind, label), marker, above in zip(labels.items(), plot.MARKERS, (-0.15, 0.15)):
        found = [np.maximum(each[kind], 1e-17) for each in record["dots"].values()]
        place = [np.full(len(some), k + above) for k, some in enumerate(found)]
        axes.plot(np.concatenate(found), np.concatenate(place), marker, markersize=4, alpha=0.6, label=label)
    axes.axvline(1e-6, color="black", linewidth=0.8, label="limit of the tests")
    axes.set(xscale="log", xlabel="relative difference from forward mode", yticks=range(len(names)), yticklabels=names)
    axes.invert_yaxis()
    chart.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=3)


@leaf_gradients.table
def words(record: Record) -> str:
    """The worst disagreement of each robot."""
    rows = [
        [name, f"{each['matter']} of {each['arrays']}", f"{each['reverse']:.0e}", f"{each['differences']:.0e}"]
        for name, each in record["robots"].items()
    ]
    head = ["case", "arrays with an effect", "reverse mode off by", "central differences off by"]
    return table(head, rows)
