"""Predicted against measured: the largest stable step of every fixed-step method on random scenes.

Each scene is a six-strut robot of random stiffness, mass and prestrain, with and without contact, damping and
friction, at rest in equilibrium. A tiny motion about it is integrated at steps near the predicted limit; the
measured one is the smallest step at which it grows a thousandfold in 7000 steps, by a thousandth a step.
"""

from itertools import product

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from measurements.measurement import Figure, Record, measurement
from measurements.pages import by_name, columns, table
from tqdm import tqdm

from jaxgrity import METHODS, Scene, SolverOptions, as_dtype, load_scene, parse_scene, simulate, stable_step
from jaxgrity.report import plot
from jaxgrity.statics import resting_shape
from jaxgrity.stepping import Method, discretise, resolve, standing, step_limit
from jaxgrity.stepping.loop import advance, carried_at

State = tuple[np.ndarray, np.ndarray]
"""positions q (nodes, 3), m, and velocities v (nodes, 3), m/s"""

FACTORS = np.concatenate([np.linspace(0.5, 0.84, 4), np.arange(0.86, 1.16, 0.02), np.linspace(1.2, 2.0, 5)])
"""steps tried, as multiples of the prediction"""
SMALL = 1e-10
"""m, of the motion that may grow: far less than the ground is pressed in"""
SMALL_CONSTRAINED = 1e-6
"""m, with constraints, which sweeps meet to about 1e-9 m"""
STEPS = 7000


@measurement(page="accuracy.md", quick={"scenes": 4}, drawn=("steps",))
def stability(scenes: int = 20, seed: int = 0) -> Record:
    """How far each method's measured limits are off, and what sets those of known scenes.

    Args:
        scenes: random scenes, each with spring struts and with rigid ones
        seed: the same seed gives the same scenes
    """
    rows = []
    for number, rigid in tqdm(list(product(range(scenes), (False, True))), desc="scenes", unit="scene"):
        scene = random_scene(seed + number, contact=number % 2 == 1, damped=number % 4 > 1, rigid=rigid)
        state = at_rest(scene)
        for method in METHODS.values():
            if method.implicit or method.constrained != rigid or (method.symplectic and scene.dissipates):
                continue
            predicted = stable_step(scene, state, method)
            blown_up = measure(scene, state, method, predicted)
            rows.append({"method": method.name, "predicted": predicted, "measured": blown_up})
    worst = {
        name: max(abs(row["measured"] / row["predicted"] - 1) for row in rows if row["method"] == name)
        for name in dict.fromkeys(row["method"] for row in rows)
    }
    return {"scenes": scenes, "worst": worst, "limits": known_limits(), "steps": by_name(rows)}


def known_limits() -> list[dict]:
    """The largest stable step, s, on two scenes of the library, and what sets it."""
    found = []
    for name in ("reference", "exact"):
        scene = load_scene(name)
        for method in METHODS.values():
            if not (method.implicit or method.symplectic) and method.constrained == scene.constrained:
                found.append({"scene": name, "method": method.name, **step_limit(scene, method)._asdict()})
    return found


def random_scene(seed: int, contact: bool, damped: bool, rigid: bool) -> Scene:
    """A six-strut robot standing on level ground, or floating without gravity."""
    draw = np.random.default_rng(seed)
    scaled = lambda low, high: float(np.exp(draw.uniform(np.log(low), np.log(high))))  # noqa: E731
    mass, strut, cable, ground = scaled(0.5, 20), scaled(3e3, 3e5), scaled(200, 2e3), scaled(3e3, 3e5)
    prestrain, damping, cable_damping, mu = (
        draw.uniform(0.1, 0.3),
        scaled(1, 100),
        scaled(0.3, 10),
        draw.uniform(0.2, 0.8),
    )
    text = ["[structure]", 'kind = "icosahedron"', f"mass = {mass}", 'pose = "face"', "height = 0.0", "[struts]"]
    text += ["rigid = true"] if rigid else [f"stiffness = {strut}"] + [f"damping = {damping}"] * damped
    text += ["[cables]", f"stiffness = {cable}", f"prestrain = {prestrain}"] + [f"damping = {cable_damping}"] * damped
    if contact and rigid:
        text += ["[gravity]", "[ground]", 'contact = "complementarity"', "[friction]", 'kind = "cone"', f"mu = {mu}"]
    elif contact:
        text += ["[gravity]", "[ground]", 'contact = "penalty"', f"stiffness = {ground}"]
        if damped:
            text += ["dissipation = 2.0", "[friction]", 'kind = "smooth"', f"mu = {mu}", "slip_speed = 0.05"]
    return parse_scene("\n".join(text))


def at_rest(scene: Scene) -> State:
    """The equilibrium near the pose in which the scene stands."""
    start, _ = standing(scene)
    if not scene.constrained:
        q = resting_shape(scene, start).q
        return q, 0 * q
    heavy = eqx.tree_at(
        lambda s: s.node_damping, scene, np.asarray(scene.structure.node_mass) * 5.0, is_leaf=lambda x: x is None
    )
    options = SolverOptions(dt=2e-3, any_step=True)
    q = np.asarray(simulate(heavy, 60.0, options=options, positions=start, frame_rate=1.0).positions[-1])
    return q, 0 * q


def measure(scene: Scene, state: State, method: Method, predicted: float, factors: np.ndarray = FACTORS) -> float:
    """The smallest step, s, at which a small motion grows; infinite where none of those tried does.

    Those are `factors` times the prediction, in ascending order.
    """
    small = SMALL_CONSTRAINED if scene.constrained else SMALL
    draw = np.random.default_rng(0).normal(size=state[0].shape) * small
    if scene.ground is not None and scene.ground.impulsive:
        draw = draw * (state[0] @ np.array(scene.ground.normal) > 1e-6)[:, None]
    options = resolve(scene, 1.0, SolverOptions(method.name, predicted, "float64", any_step=True)).as_inputs()
    largest = np.asarray(spread(as_dtype(scene, "float64"), state, draw, predicted * factors, options))
    grown = ~(largest < 1e3 * small)
    return float(predicted * factors[np.argmax(grown)]) if grown.any() else np.inf


@eqx.filter_jit
def spread(scene: Scene, state: State, draw, steps, options):
    """For each step size the largest distance, m, that a node gets from equilibrium in `STEPS` steps."""
    scheme = discretise(options)
    q, v = (jnp.asarray(x) for x in state)

    def one(h):
        def watched(carry, k):
            before, largest = carry
            after = advance(scheme, scene, (0 * h, h), before)
            return (after, jnp.maximum(largest, jnp.max(jnp.abs(after.motion[0] - q)))), None

        first = carried_at(scheme, scene, 0 * h, h, (q + draw, v)), jnp.zeros(())
        return jax.lax.scan(watched, first, jnp.arange(STEPS))[0][1]

    return jax.vmap(one)(jnp.asarray(steps))


@stability.table
def words(record: Record) -> str:
    """The largest deviation of each method, and the limits of known scenes."""
    worst = ["largest deviation", *(f"{off:.0%}" for off in record["worst"].values())]
    cells = {
        "scene": "{scene}",
        "method": "{method}",
        "largest stable step, ms": lambda row: f"{1e3 * row['step']:.3g}",
        "set by": "{set_by}",
    }
    deviations = table([f"{record['scenes']} random scenes", *record["worst"]], [worst])
    return deviations + "\n\n" + columns(record["limits"], cells)


@stability.figure(4.5)
def figure(record: Record, chart: Figure) -> None:
    """Measured against predicted, a colour and a marker for each method."""
    axes, steps = chart.subplots(), record["steps"]
    predicted, measured = (1e3 * np.array(steps[name]) for name in ("predicted", "measured"))
    for name, marker in zip(dict.fromkeys(steps["method"]), plot.MARKERS):
        mine = np.array(steps["method"]) == name
        axes.loglog(predicted[mine], measured[mine], marker, alpha=0.7, label=name)
    ends = np.array([predicted.min(), predicted.max()])
    axes.loglog(ends, ends, color="black", lw=0.8, label="equal")
    axes.fill_between(ends, 0.9 * ends, 1.1 * ends, color="black", alpha=0.1, label="within 10 %")
    axes.set(xlabel="predicted largest stable step (ms)", ylabel="smallest step that diverges (ms)")
    chart.legend(loc="outside right upper")
