"""Random structures, dropped and actuated: how many of them the step gets through, beside sweeps alone.

Each structure (1 to 30 rigid struts, up to six of them at a node, loops, cables, rods with mass, supports) is rolled
out with several sets of masses, coefficients of friction and phases. Sweeps know neither rods with mass nor
supports: they get the same structures with each rod's mass at its ends and without supports.
"""

import dataclasses
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from typing import NamedTuple

from jaxgrity.cli.script import configure, cores

import jax
import jax.numpy as jnp
import numpy as np
from measurements.measurement import Record, measurement
from measurements.pages import columns
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from jaxgrity import (
    ConeFriction,
    Differences,
    ExactGround,
    Gait,
    Members,
    Scene,
    SolverOptions,
    Structure,
    as_dtype,
    edge_lengths,
)
from jaxgrity.model import rest_length
from jaxgrity.populations import discretise_lanes, in_lanes, lanes_last, over_lanes
from jaxgrity.stepping import resolve
from jaxgrity.stepping.loop import advance, carried_at

STEP = 5e-3
"""s"""
CABLES = 0.02
"""K h^2/m of a cable for the lighter of its nodes, shared by the cables there: far below what is stable"""


class Verdict(NamedTuple):
    """What became of a structure's variants, an entry each."""

    flagged_at: np.ndarray
    """s, when the step gave up; NaN where it did not"""
    residual: np.ndarray
    """m/s, the largest by which velocities missed what the impulses make of them, up to then"""
    stretch: np.ndarray
    """the largest share of its length by which a strut was off, up to then"""


def random_scene(seed: int) -> Scene:
    """A structure above level ground with a gait, by its seed."""
    rng = np.random.default_rng(seed)
    count, most = int(rng.integers(1, 31)), int(rng.integers(1, 7))
    nodes, edges = _grown(rng, count, most)
    size = len(nodes)
    nodes[:, 2] += rng.uniform(0, 0.3) - nodes[:, 2].min()
    node_mass = 10 ** rng.uniform(-1, 1, size)
    rods = 10 ** rng.uniform(-1, 1, count) * (rng.random(count) < 0.7) if rng.random() < 0.5 else None
    fixed = ()
    if rng.random() < 0.3:
        fixed = ((int(np.argmax(nodes[:, 2])), str(rng.choice(["xyz", "xyz", "xy", "z", "xz"]))),)
    struts = Members(edges, None, edge_lengths(nodes, edges), mass=rods)
    structure = Structure(nodes, node_mass, struts, _cables(rng, nodes, node_mass, edges), fixed=fixed)
    gait = Gait(
        tuple(range(count)),
        rng.uniform(0, 2 * np.pi, count),
        _amplitudes(rng, structure),
        np.full(count, rng.uniform(0.3, 1.5)),
        ramp=0.5,
    )
    return Scene(structure, 9.81, 0.2 * node_mass, ExactGround(), ConeFriction(1.0), gait)


def _grown(rng: np.random.Generator, count: int, most: int) -> tuple[np.ndarray, tuple[tuple[int, int], ...]]:
    """So many struts, at most `most` at a node: each begins at an old node or a new one, and ends likewise."""
    nodes: list[np.ndarray] = []
    edges: list[tuple[int, int]] = []
    size = 0.5 + 0.1 * np.sqrt(count)
    for _ in range(count):
        used = [sum(node in edge for edge in edges) for node in range(len(nodes))]
        open_ = [node for node in range(len(nodes)) if used[node] < most]
        if most > 1 and open_ and rng.random() < 0.75:
            first = int(rng.choice(open_))
        else:
            first = len(nodes)
            nodes.append(rng.uniform(-size, size, 3))
        near = [
            node
            for node in open_
            if node != first
            and 0.2 < np.linalg.norm(nodes[node] - nodes[first]) < 1.5
            and (min(node, first), max(node, first)) not in edges
        ]
        if most > 1 and near and rng.random() < 0.35:
            second = int(rng.choice(near))
        else:
            second = len(nodes)
            way = rng.normal(size=3)
            nodes.append(nodes[first] + way / np.linalg.norm(way) * rng.uniform(0.3, 1.2))
        edges.append((min(first, second), max(first, second)))
    return np.array(nodes), tuple(edges)


def _cables(rng: np.random.Generator, nodes: np.ndarray, node_mass: np.ndarray, struts: tuple) -> Members | None:
    pairs = {tuple(sorted(rng.choice(len(nodes), 2, replace=False).tolist())) for _ in range(len(nodes))}
    edges = tuple(sorted(pair for pair in pairs if pair not in struts))
    if not edges:
        return None
    there = np.bincount(np.array(edges).ravel(), minlength=len(nodes))
    lighter = [min(node_mass[i] / there[i], node_mass[j] / there[j]) for i, j in edges]
    # a variant's masses are a tenth at least
    stiffness = CABLES / STEP**2 * 0.1 * np.array(lighter)
    return Members(edges, stiffness, edge_lengths(nodes, edges) * rng.uniform(0.7, 1.0, len(edges)))


def _amplitudes(rng: np.random.Generator, structure: Structure) -> np.ndarray:
    """Of each strut's gait: 0 for those in a loop, which need not close at other lengths, and for some others."""
    edges, nodes = structure.struts.edges, len(structure.nodes)
    amplitude = rng.uniform(0.05, 0.2, len(edges)) * (rng.random(len(edges)) < 0.6)
    whole = _pieces(edges, nodes)
    bridge = [_pieces((*edges[:k], *edges[k + 1 :]), nodes) > whole for k in range(len(edges))]
    return amplitude * np.array(bridge)


def _pieces(edges: tuple, nodes: int) -> int:
    """How many parts hang together."""
    i, j = np.array(edges, int).reshape(-1, 2).T
    return connected_components(coo_array((np.ones(len(edges)), (i, j)), (nodes, nodes)), directed=False)[0]


def varied(scene: Scene, count: int, seed: int) -> tuple[Gait, Differences]:
    """Gaits, masses over two decades about the scene's, and coefficients of friction from 0 to 1.5."""
    rng = np.random.default_rng((seed, 1))
    nodes = len(scene.structure.nodes)
    gait = scene.gait
    phases = rng.uniform(0, 2 * np.pi, (count, len(gait.members)))
    many = dataclasses.replace(
        gait, phase=phases, amplitude=np.tile(gait.amplitude, (count, 1)), frequency=np.tile(gait.frequency, (count, 1))
    )
    masses = 10 ** rng.uniform(-1, 1, (count, nodes))
    return many, Differences(friction=rng.uniform(0, 1.5, count), node_mass=masses)


def for_sweeps(scene: Scene) -> Scene:
    """The scene as sweeps alone can take it: rods' mass at their ends, no supports."""
    structure = scene.structure
    struts = dataclasses.replace(structure.struts, mass=None)
    lumped = np.asarray(structure.lumped_mass)
    return dataclasses.replace(
        scene, structure=dataclasses.replace(structure, node_mass=lumped, struts=struts, fixed=())
    )


def judged(scene: Scene, gaits: Gait, differences: Differences, duration: float, coupled: bool) -> Verdict:
    """Roll out all variants side by side, and watch each step."""
    options = SolverOptions(dt=STEP, dtype="float64", any_step=True, coupled=coupled)
    resolved = resolve(scene, duration, options)
    single = as_dtype(scene, "float64")
    gaits, differences = jax.tree.map(lambda x: jnp.asarray(x, float), (gaits, differences))
    many, axes = in_lanes(single, lanes_last(gaits), lanes_last(differences))
    scheme = discretise_lanes(resolved, axes)
    steps = round(duration / STEP)
    edges = np.array(scene.structure.struts.edges).T

    def step(carry, k):
        before, worst = carry
        after = advance(scheme, many, (k * STEP, (k + 1) * STEP), before)
        q = after.motion[0]
        wanted = over_lanes(lambda s: rest_length(s.structure.struts, s.gait, (k + 1) * STEP, 0), (axes,))(many)
        lengths = jnp.linalg.norm(q[edges[0]] - q[edges[1]], axis=1)
        residual = after.memory.residual if coupled else jnp.zeros(q.shape[-1])
        now = jnp.stack([residual, jnp.max(jnp.abs(lengths / wanted - 1), axis=0)])
        fine = jnp.isfinite(q).all(axis=(0, 1))
        return (after, jnp.where(fine, jnp.maximum(worst, now), worst)), fine

    start = (many.structure.nodes, 0 * many.structure.nodes)
    first = carried_at(scheme, many, 0.0, STEP, start)

    @jax.jit
    def roll(first):
        return jax.lax.scan(step, (first, jnp.zeros((2, first.motion[0].shape[-1]))), jnp.arange(steps))

    (_, worst), fine = roll(first)
    fine = np.asarray(fine)
    at = np.where(fine.all(0), np.nan, STEP * np.argmin(fine, axis=0))
    return Verdict(at, *np.asarray(worst))


def structure_row(seed: int, count: int, duration: float) -> dict:
    """What became of all variants of one structure, by both solvers."""
    scene = random_scene(seed)
    gaits, differences = varied(scene, count, seed)
    row = {"seed": seed, "struts": len(scene.structure.struts.edges), "nodes": len(scene.structure.nodes)}
    for name, case in (("coupled", scene), ("sweeps", for_sweeps(scene))):
        row[name] = judged(case, gaits, differences, duration, name == "coupled")._asdict()
    return row


def facts_of(verdicts: list[dict]) -> Record:
    """Numbers over all rollouts."""
    joined = Verdict(*(np.concatenate([np.array(v[name], float) for v in verdicts]) for name in Verdict._fields))
    flagged = np.isfinite(joined.flagged_at)
    return {
        "rollouts": len(flagged),
        "flagged": int(flagged.sum()),
        "largest_residual": float(joined.residual.max()),
        "largest_stretch": float(joined.stretch.max()),
        "off_by_more_than_1e-6": int(np.sum((joined.stretch > 1e-6) & ~flagged)),
    }


@measurement(page="accuracy.md", quick={"structures": 3, "variants": 2, "duration": 0.25}, raw=("rows", "variants"))
def random_structures(
    structures: int = 100, variants: int = 20, duration: float = 3.0, seed: int = 0
) -> Iterator[Record]:
    """A row for each structure: what became of its rollouts by both solvers.

    Args:
        structures: number of structures
        variants: sets of masses, coefficients and phases of each
        duration: s, of each rollout
        seed: the same seed gives the same structures
    """
    rows = []
    # a process keeps every program that it has compiled: a new one for each structure
    with ProcessPoolExecutor(cores(), get_context("spawn"), configure, max_tasks_per_child=1) as pool:
        seeds = [1000 * seed + k for k in range(structures)]
        for done in as_completed([pool.submit(structure_row, each, variants, duration) for each in seeds]):
            rows.append(done.result())
            yield rows[-1]
    struts = [row["struts"] for row in rows]
    about = {"duration": duration, "step": STEP, "variants": variants, "structures": len(rows)}
    about |= {"struts": [min(struts), max(struts)]}
    return about | {name: facts_of([row[name] for row in rows]) for name in ("coupled", "sweeps")}


@random_structures.table
def words(record: Record) -> str:
    """How many rollouts each solver gives up, and how far struts are off in the others."""
    solvers = {"coupled": record["coupled"], "sweeps": record["sweeps"]}
    cells = {
        "solver": "{name}",
        "rollouts": "{rollouts}",
        "failed": "{flagged}",
        "off": "{off_by_more_than_1e-6}",
        "largest relative error of a length": "{largest_stretch:.0e}",
        "largest residual, m/s": lambda row: (
            f"{row['largest_residual']:.0e}" if row["name"] == "coupled" else "not computed"
        ),
    }
    return columns([{"name": name} | facts for name, facts in solvers.items()], cells)
