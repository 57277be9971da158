"""What a gradient costs: time and memory of each way to differentiate a rollout, against the rollout alone.

The gradient is that of the distance travelled, in the 6 phases of each gait, or in 100 parameters of the scene that
all gaits share, for one gait and for 64, by RK4 at 0.5 ms in float64; the mode that wins by exact contact at 5 ms too.
"""

from collections.abc import Callable, Iterator

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from measurements.engines import clock
from measurements.measurement import Figure, Record, measurement
from measurements.pages import table

from jaxgrity import Gait, Scene, SolverOptions, as_dtype, gaits_of, load_scene, random_phases
from jaxgrity.populations import discretise_lanes
from jaxgrity.report import plot
from jaxgrity.search import checkpointed_end, distances
from jaxgrity.stepping import ResolvedOptions, resolve
from jaxgrity.stepping.loop import carried_at, numbered, repeated

End = Callable[[Scene, Scene, tuple, float, ResolvedOptions], tuple]
"""a scene, its `in_axes`, the start, the horizon (s) and options, to the state of all gaits at the horizon"""
RK4 = SolverOptions("rk4", 5e-4, "float64", any_step=True)
EXACT = SolverOptions("complementarity", 5e-3, "float64")

TANGENTS = 8
"""side by side"""


@measurement(
    page="performance.md",
    quick={"horizon": 0.5, "repeats": 2, "gaits": (2,), "parameters": (6,), "lengths": (4.0,)},
    raw=("difference", "method", "horizon"),
)
def gradients(
    horizon: float = 5.0,
    short: float = 0.5,
    repeats: int = 5,
    gaits: tuple[int, ...] = (1, 64),
    parameters: tuple[int, ...] = (6, 100),
    lengths: tuple[float, ...] = (0.25, 1.0, 4.0),
) -> Iterator[Record]:
    """A row for each mode, number of gaits and number of parameters.

    Args:
        horizon: s, of the gradients of most gaits by the mode that wins
        short: s, on which all modes are compared
        repeats: timed calls, of which the median counts, after one that compiles
        gaits: sizes of populations
        parameters: 6 phases, or 100 parameters of the scene
        lengths: s, of rollouts whose gradients' memory is measured
    """
    scene, exact, long = moving_at_once("reference"), moving_at_once("exact"), []
    for count in gaits:
        several = jax.tree.map(jnp.asarray, gaits_of(scene.gait, random_phases(count, 6, seed=0)))
        for size in parameters:
            yield from compare(scene, several, size, short, repeats)
    for each, size in (*((scene, size) for size in parameters), (exact, 6)):
        (row,) = compare(each, several, size, horizon, repeats, ("checkpointed reverse",))
        long.append({key: row[key] for key in ("gaits", "parameters", "method", "horizon", "rollouts")})
    memory = {name: [temporary(scene, several, name, t) for t in lengths] for name in REVERSE}
    return {"short": short, "lengths": lengths, "memory": memory, "long": long}


@gradients.table
def words(record: Record) -> str:
    """Time of each mode in rollouts, of the winner over longer ones, and memory."""
    cases, modes = cases_of(record), list(dict.fromkeys(row["mode"] for row in record["rows"]))
    cost = {(row["mode"], row["gaits"], row["parameters"]): row["rollouts"] for row in record["rows"]}
    rows = [[mode, *(f"{cost[mode, *case]:.1f}" for case in cases)] for mode in modes]
    head = [f"time/rollout of {record['short']:g} s", *map(label, cases)]
    first = record["long"][0]
    long_head = [
        f"checkpointed reverse, {first['gaits']} gaits",
        *(f"{row['parameters']} parameters, {row['method']}" for row in record["long"]),
    ]
    long = [f"time/rollout of {first['horizon']:g} s", *(f"{row['rollouts']:.1f}" for row in record["long"])]
    memory = [[name, *(f"{x / 2**20:.1f}" for x in found)] for name, found in record["memory"].items()]
    memory_head = ["memory, MiB", *(f"rollout of {t:g} s" for t in record["lengths"])]
    return "\n\n".join([table(head, rows), table(long_head, [long]), table(memory_head, memory)])


def cases_of(record: Record) -> list[tuple[int, int]]:
    """Numbers of gaits and of parameters."""
    return list(dict.fromkeys((row["gaits"], row["parameters"]) for row in record["rows"]))


def label(case: tuple[int, int]) -> str:
    return f"{case[0]} gait{'s' if case[0] > 1 else ''}, {case[1]} parameters"


def moving_at_once(name: str) -> Scene:
    """The scene whose gait begins at the start, for a distance of exactly 0 has no gradient."""
    scene = as_dtype(load_scene(name), "float64")
    return eqx.tree_at(lambda s: (s.gait.start, s.gait.ramp), scene, (jnp.asarray(0.0), jnp.asarray(0.1)))


def varied(scene: Scene, gaits: Gait, parameters: int) -> tuple[jax.Array, Callable]:
    """The parameters, and what makes the scene and its gaits of them: the phases, or 100 factors, all 1."""
    if parameters == 6:
        return gaits.phase, lambda phase: (scene, eqx.tree_at(lambda g: g.phase, gaits, phase))

    def chosen(pair):
        s, g = pair
        cables = s.structure.cables
        shared = [cables.stiffness, cables.rest_length, cables.damping, s.structure.struts.stiffness]
        return [
            *shared,
            s.gravity,
            s.friction.mu,
            s.ground.stiffness,
            s.ground.dissipation,
            g.phase,
            g.amplitude,
            g.frequency,
        ]

    values = chosen((scene, gaits))
    sizes = [x.shape[-1] if x.ndim else 1 for x in values]
    assert sum(sizes) == parameters, sizes

    def scaled(factors):
        parts = jnp.split(factors, np.cumsum(sizes)[:-1])
        return eqx.tree_at(chosen, (scene, gaits), [x * (f if x.ndim else f[0]) for x, f in zip(values, parts)])

    return jnp.ones(parameters), scaled


def plain_end(scene: Scene, axes: Scene, start: tuple, horizon: float, options: ResolvedOptions) -> tuple:
    """The state at the horizon, by a scan over all steps: reverse mode keeps what each of them computed."""
    scheme, h = discretise_lanes(options, axes), options.dt
    numbers = jnp.arange(round(horizon / h), dtype=options.dtype)
    return repeated(numbered(scheme, scene, h), carried_at(scheme, scene, 0.0, h, start), numbers).motion


def diffrax_end(adjoint: diffrax.AbstractAdjoint) -> End:
    """The state at the horizon, by diffeqsolve with one of diffrax's adjoints."""

    def end(scene, axes, start, horizon, options):
        terms, solver = discretise_lanes(options, axes)
        steps = None if isinstance(adjoint, diffrax.ForwardMode) else round(horizon / options.dt) + 1
        solution = diffrax.diffeqsolve(
            terms, solver, 0.0, horizon, options.dt, start, scene, adjoint=adjoint, max_steps=steps, throw=False
        )
        return jax.tree.map(lambda x: x[-1], solution.ys)

    return end


REVERSE: dict[str, End] = {
    "checkpointed reverse": checkpointed_end,
    "plain reverse": plain_end,
    "diffrax's RecursiveCheckpointAdjoint": diffrax_end(diffrax.RecursiveCheckpointAdjoint()),
}
FORWARD: End = diffrax_end(diffrax.ForwardMode())


def of_parameters(make: Callable, end: End, horizon: float, options: ResolvedOptions) -> Callable:
    """Parameters to the distance of each gait, m."""
    return lambda parameters: distances(*make(parameters), horizon, options, end)


def by_reverse(make: Callable, end: End, horizon: float, options: ResolvedOptions) -> Callable:
    return jax.jit(jax.grad(lambda p: jnp.sum(of_parameters(make, end, horizon, options)(p))))


def by_forward(make: Callable, values: jax.Array, horizon: float, options: ResolvedOptions, together: int) -> Callable:
    """The gradient of the sum, one tangent after the other, `together` at once; of phases, all gaits' at a time."""
    count = values.shape[-1]

    def directional(p, tangent):
        tangent = jnp.broadcast_to(tangent, p.shape)
        return jax.jvp(of_parameters(make, FORWARD, horizon, options), (p,), (tangent,))[1]

    def gradient(p):
        return jax.lax.map(lambda tangent: directional(p, tangent), jnp.eye(count), batch_size=together)

    return jax.jit(gradient)


def compare(
    scene: Scene, gaits: Gait, parameters: int, horizon: float, repeats: int, only: tuple[str, ...] = ()
) -> Iterator[Record]:
    """Time of each mode over that of the rollout, and the largest difference of its gradient from the first's."""
    options = resolve(scene, horizon, EXACT if scene.constrained else RK4)
    values, make = varied(scene, gaits, parameters)
    alone, _ = timed(jax.jit(of_parameters(make, FORWARD, horizon, options)), values, repeats)
    modes = {name: by_reverse(make, end, horizon, options) for name, end in REVERSE.items()}
    modes["forward, one by one"] = by_forward(make, values, horizon, options, 1)
    modes[f"forward, {TANGENTS} side by side"] = by_forward(make, values, horizon, options, TANGENTS)
    reference = None
    for name in only or modes:
        seconds, gradient = timed(modes[name], values, repeats)
        gradient = gradient.T if parameters == 6 and gradient.shape != values.shape else gradient
        gradient = gradient if gradient.shape == values.shape else gradient.sum(-1)
        reference = gradient if reference is None else reference
        yield {
            "mode": name,
            "gaits": gaits.phase.shape[0],
            "parameters": parameters,
            "method": options.method.name,
            "horizon": horizon,
            "rollouts": seconds / alone,
            "difference": float(jnp.abs(gradient - reference).max() / jnp.abs(reference).max()),
        }


def timed(function: Callable, values: jax.Array, repeats: int) -> tuple[float, jax.Array]:
    """Median wall time of a call after the first, s, and the result."""
    runs = [clock(lambda: function(values)) for _ in range(repeats + 1)]
    return float(np.median([seconds for seconds, _ in runs[1:]])), runs[-1][1]


def temporary(scene: Scene, gaits: Gait, name: str, horizon: float) -> int:
    """Bytes that the compiled gradient in the phases takes beside its arguments and its result."""
    options = resolve(scene, horizon, RK4)
    values, make = varied(scene, gaits, 6)
    compiled = by_reverse(make, REVERSE[name], horizon, options).lower(values).compile()
    return compiled.memory_analysis().temp_size_in_bytes


@gradients.figure(6.8)
def figure(record: Record, chart: Figure) -> None:
    """Time of each mode in rollouts, and the memory of the reverse modes against the length of the rollout."""
    above, below = chart.subplots(2, 1)
    names = list(dict.fromkeys(row["mode"] for row in record["rows"]))
    cases = cases_of(record)
    for k, case in enumerate(cases):
        heights = [row["rollouts"] for row in record["rows"] if (row["gaits"], row["parameters"]) == case]
        above.barh(np.arange(len(names)) + 0.2 * k, heights, 0.18, label=label(case))
    above.set_yticks(np.arange(len(names)) + 0.1 * (len(cases) - 1), names)
    above.invert_yaxis()
    above.grid(axis="y", visible=False)
    above.set(xscale="log", xlim=(1, None), xlabel="time of a gradient, in rollouts")
    for (name, found), marker in zip(record["memory"].items(), plot.MARKERS):
        below.loglog(record["lengths"], np.array(found) / 2**20, f"{marker}-", label=name)
    below.set(xlabel="length of the rollout (s)", ylabel=f"memory (MiB),\n{cases[-1][0]} gaits, 6 parameters")
    below.set_xticks(record["lengths"], [f"{t:g}" for t in record["lengths"]])
    below.minorticks_off()
    over = {"loc": "lower center", "bbox_to_anchor": (0.5, 1.0)}  # where no bar and no curve is
    above.legend(**over, ncols=2)
    below.legend(**over, ncols=2)
