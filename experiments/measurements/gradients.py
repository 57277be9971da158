"""What a gradient costs: time and memory of each way to differentiate a rollout, against the rollout alone.

The gradient is that of the distance travelled, in the 6 phases of each gait, or in 100 parameters of the scene that
all gaits share, for one gait and for 64, by RK4 at 0.5 ms in float64; the mode that wins by exact contact at 5 ms too.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from jaxgrity.cli.script import measured, run

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

from jaxgrity import Gait, Scene, SolverOptions, as_dtype, gaits_of, load_scene, random_phases
from jaxgrity.io.files import save_json
from jaxgrity.populations import discretise_lanes
from jaxgrity.report import plot
from jaxgrity.search import checkpointed_end, distances
from jaxgrity.stepping import ResolvedOptions, resolve

End = Callable[[Scene, Scene, tuple, float, ResolvedOptions], tuple]
"""a scene, its `in_axes`, the start, the horizon (s) and options, to the state of all gaits at the horizon"""
RK4 = SolverOptions("rk4", 5e-4, "float64", any_step=True)
EXACT = SolverOptions("complementarity", 5e-3, "float64")

TANGENTS = 8
"""side by side"""


@dataclass
class Settings:
    horizon: float = 5.0
    """s, of the gradients of 64 gaits by the mode that wins"""
    short: float = 0.5
    """s, on which all modes are compared"""
    repeats: int = 5
    """timed calls, of which the median counts, after one that compiles"""
    out: Path = Path("results/gradients")
    """folder for gradients.json and gradients.png"""
    quick: bool = False
    """a tenth of the longest gradient, two calls, two gaits and their phases alone"""


def main(settings: Settings) -> None:
    if settings.quick:
        settings.horizon, settings.repeats = settings.horizon / 10, 2
    scene, exact = moving_at_once("reference"), moving_at_once("exact")
    many, counts = (2, (6,)) if settings.quick else (64, (6, 100))
    rows, lengths = [], [settings.short / 2, settings.short * 2, settings.short * 8][-1 if settings.quick else 0 :]
    for count in tqdm((many,) if settings.quick else (1, many), desc="gaits", unit="population"):
        gaits = jax.tree.map(jnp.asarray, gaits_of(scene.gait, random_phases(count, 6, seed=0)))
        for parameters in counts:
            rows += compare(scene, gaits, parameters, settings)
    long = []
    for parameters in counts:
        long += compare(scene, gaits, parameters, settings, settings.horizon, ("checkpointed reverse",))
    long += compare(exact, gaits, 6, settings, settings.horizon, ("checkpointed reverse",))
    memory = {name: [temporary(scene, gaits, name, t) for t in lengths] for name in REVERSE}
    facts = {**measured(), "short": settings.short, "rows": rows, "long": long, "lengths": lengths, "memory": memory}
    save_json(settings.out / "gradients.json", facts)
    plot.save(figure(facts), settings.out / "gradients.png")
    report(facts)
    print(f"wrote {settings.out}/gradients.json and gradients.png")


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
    terms, solver = discretise_lanes(options, axes)
    h = options.dt

    def step(y, k):
        return solver.step(terms, k * h, (k + 1) * h, y, scene, None, False)[0], None

    return jax.lax.scan(step, start, jnp.arange(round(horizon / h), dtype=options.dtype))[0]


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
    scene: Scene, gaits: Gait, parameters: int, settings: Settings, horizon: float = 0.0, only: tuple[str, ...] = ()
) -> list[dict]:
    """Time of each mode over that of the rollout, and the largest difference of its gradient from the first's."""
    horizon = horizon or settings.short
    options = resolve(scene, horizon, EXACT if scene.constrained else RK4)
    values, make = varied(scene, gaits, parameters)
    alone, _, _ = timed(jax.jit(of_parameters(make, FORWARD, horizon, options)), values, settings.repeats)
    modes = {name: by_reverse(make, end, horizon, options) for name, end in REVERSE.items()}
    modes["forward, one by one"] = by_forward(make, values, horizon, options, 1)
    modes[f"forward, {TANGENTS} side by side"] = by_forward(make, values, horizon, options, TANGENTS)
    rows, reference = [], None
    for name in only or modes:
        seconds, compilation, gradient = timed(modes[name], values, settings.repeats)
        gradient = gradient.T if parameters == 6 and gradient.shape != values.shape else gradient
        gradient = gradient if gradient.shape == values.shape else gradient.sum(-1)
        reference = gradient if reference is None else reference
        rows.append(
            {
                "mode": name,
                "gaits": gaits.phase.shape[0],
                "parameters": parameters,
                "method": options.method.name,
                "horizon": horizon,
                "rollouts": seconds / alone,
                "rollout_seconds": alone,
                "compile_seconds": compilation,
                "difference": float(jnp.abs(gradient - reference).max() / jnp.abs(reference).max()),
            }
        )
    return rows


def timed(function: Callable, values: jax.Array, repeats: int) -> tuple[float, float, jax.Array]:
    """Median wall time of a call, s, what the first took longer, and the result."""
    seconds = []
    for _ in range(repeats + 1):
        start = time.perf_counter()
        result = jax.block_until_ready(function(values))
        seconds.append(time.perf_counter() - start)
    warm = float(np.median(seconds[1:]))
    return warm, seconds[0] - warm, result


def temporary(scene: Scene, gaits: Gait, name: str, horizon: float) -> int:
    """Bytes that the compiled gradient in the phases takes beside its arguments and its result."""
    options = resolve(scene, horizon, RK4)
    values, make = varied(scene, gaits, 6)
    compiled = by_reverse(make, REVERSE[name], horizon, options).lower(values).compile()
    return compiled.memory_analysis().temp_size_in_bytes


def report(facts: dict) -> None:
    for row in facts["rows"] + facts["long"]:
        print(
            f"{row['gaits']:3d} gaits, {row['parameters']:3d} parameters, {row['horizon']:g} s, {row['mode']:36s} "
            f"{row['rollouts']:7.1f} rollouts, off by {row['difference']:.0e}"
        )
    for name, found in facts["memory"].items():
        print(f"{name}: " + ", ".join(f"{x / 2**20:.1f} MiB at {t:g} s" for x, t in zip(found, facts["lengths"])))


@plot.styled
def figure(facts: dict) -> Figure:
    """Time of each mode in rollouts, and the memory of the reverse modes against the length of the rollout."""
    chart = Figure(figsize=(11, 4), layout="constrained")
    left, right = chart.subplots(1, 2)
    names = list(dict.fromkeys(row["mode"] for row in facts["rows"]))
    cases = list(dict.fromkeys((row["gaits"], row["parameters"]) for row in facts["rows"]))
    for k, case in enumerate(cases):
        heights = [row["rollouts"] for row in facts["rows"] if (row["gaits"], row["parameters"]) == case]
        label = f"{case[0]} gait{'s' if case[0] > 1 else ''}, {case[1]} parameters"
        left.barh(np.arange(len(names)) + 0.2 * k, heights, 0.18, label=label)
    left.set_yticks(np.arange(len(names)) + 0.1 * (len(cases) - 1), names)
    left.invert_yaxis()
    left.set(xscale="log", xlabel="time of a gradient, in rollouts")
    left.legend(fontsize=8)
    for name, found in facts["memory"].items():
        right.loglog(facts["lengths"], np.array(found) / 2**20, "o-", label=name)
    right.set(xlabel="length of the rollout (s)", ylabel="memory (MiB)", title=f"{cases[-1][0]} gaits, 6 phases")
    right.set_xticks(facts["lengths"], [f"{t:g}" for t in facts["lengths"]])
    right.minorticks_off()
    right.legend(fontsize=8)
    right.grid(alpha=0.3)
    return chart


if __name__ == "__main__":
    run(main, Settings)
