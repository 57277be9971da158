"""How fast a population is integrated, beside hand-written C where its folder is given, and what its gradients cost."""

import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from common import SCENES, measured, run
from matplotlib.figure import Figure
from tqdm import tqdm

from jaxgrity import Scene, diagnose, gaits_of, load_scene, plot, random_phases, simulate_population
from jaxgrity.files import save_json
from jaxgrity.population import roll_out_lanes
from jaxgrity.refine import distance_and_gradient
from jaxgrity.scene import as_dtype
from jaxgrity.simulate import settle
from jaxgrity.structure import InputError


@dataclass
class Settings:
    scene: Path = SCENES / "reference.toml"
    """scene file (TOML) with spring struts, level ground and a gait on the struts"""
    gaits: int = 256
    """size of the population"""
    duration: float = 2.0
    """simulated time, s"""
    dt: float = 5e-4
    """step of RK4, s"""
    repeats: int = 5
    """timed runs of each, after a first that compiles; the median counts"""
    limit: Path | None = None
    """folder with the programs limit32 and limit64, to run beside in turn"""
    out: Path = Path("results/throughput")
    """folder for summary.json and throughput.png"""
    quick: bool = False
    """a tenth of the time, three repeats"""


def main(settings: Settings) -> None:
    if settings.quick:
        settings.duration, settings.repeats = settings.duration / 10, 3
    scene = load_scene(settings.scene)
    if scene.gait is None:
        raise InputError(f"{settings.scene}: has no [gait]; expected one to vary")
    phases = random_phases(settings.gaits, len(scene.gait.members), seed=0)
    steps = round(settings.duration / settings.dt)
    cores = jax.device_count()
    rows = {}
    with tqdm(total=3, unit="measurement") as bar:
        for dtype in ("float32", "float64"):
            rows[dtype] = side_by_side(scene, phases, steps, dtype, settings)
            bar.update()
        gradients = gradient_cost(scene, phases[:64], settings)
        bar.update()
    diagnosis = diagnose(scene, settings.duration, method="rk4", dt=settings.dt)
    save_json(
        settings.out / "summary.json",
        {
            **measured(),
            "diagnosis": diagnosis.summary(),
            "scene": settings.scene.name,
            "gaits": settings.gaits,
            "steps": steps,
            "dt": settings.dt,
            "devices": cores,
            "repeats": settings.repeats,
            "rk4": rows,
            "gradient": gradients,
        },
    )
    plot.save(figure(rows), settings.out / "throughput.png")
    for dtype, row in rows.items():
        beside = f", {row['ratio']:.1f} times the C program's {row['limit_us']:.3f}" if "ratio" in row else ""
        print(
            f"{dtype}: {row['us']:.3f} us per RK4 step per gait on {cores} cores{beside}; "
            f"compiled in {row['compile_seconds']:.1f} s"
        )
    print(
        f"gradient, {gradients['gaits']} gaits, {gradients['horizon']:g} s, relative to the rollout on one core: "
        f"reverse {gradients['reverse']:.1f}, forward {gradients['forward']:.1f} for {gradients['phases']} phases"
    )
    print(f"the scene's own gait:\n{diagnosis.table()}")
    print(f"wrote {settings.out}/summary.json")


def side_by_side(scene: Scene, phases: np.ndarray, steps: int, dtype: str, settings: Settings) -> dict:
    """jaxgrity and the C program in turn, microseconds per step per gait, and how far their answers differ."""
    gaits = gaits_of(scene.gait, phases)
    program = settings.limit and settings.limit.resolve() / f"limit{dtype[-2:]}"
    if program is not None and not program.exists():
        raise InputError(f"{program}: not there; expected the built program")

    def roll_out():
        return simulate_population(scene, gaits, settings.duration, method="rk4", dt=settings.dt, dtype=dtype)

    first, outcomes = clock(roll_out)
    ours, theirs, answers = [], [], None
    for _ in range(settings.repeats):
        ours.append(clock(roll_out)[0])
        if program is not None:
            seconds, answers = run_limit(program, scene, phases, steps, settings)
            theirs.append(seconds)
    per_step = 1e6 / steps / len(phases)
    row = {"us": float(np.median(ours)) * per_step, "compile_seconds": max(0.0, first - float(np.median(ours)))}
    if answers is not None:
        row["limit_us"] = float(np.median(theirs)) * per_step
        row["ratio"] = float(np.median(np.array(ours) / np.array(theirs)))
        row["largest_difference"] = float(np.abs(np.asarray(outcomes.com_end) - answers).max())
    return row


def clock(function: Callable) -> tuple[float, object]:
    """Wall time of one call, s, and its result."""
    start = time.perf_counter()
    result = jax.block_until_ready(function())
    return time.perf_counter() - start, result


def run_limit(
    program: Path, scene: Scene, phases: np.ndarray, steps: int, settings: Settings
) -> tuple[float, np.ndarray]:
    """Wall time that the C program measures on as many threads as there are devices, and its final centres of mass."""
    settings.out.mkdir(parents=True, exist_ok=True)
    text = settings.out / "limit.txt"
    text.write_text(limit_text(scene, phases, steps, settings.dt))
    command = [str(program), str(text), str(jax.device_count())]
    lines = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    facts = dict(word.split("=") for word in lines[-1].split() if "=" in word)
    return float(facts["seconds"]), np.array([line.split() for line in lines[:-1]], float)


def limit_text(scene: Scene, phases: np.ndarray, steps: int, dt: float) -> str:
    """The scene as the C program reads it."""
    structure, gait, ground, friction = scene.structure, scene.gait, scene.ground, scene.friction
    struts, cables = structure.struts, structure.cables
    counts = [len(structure.nodes), len(struts.edges), len(cables.edges)]
    rows = [counts, *np.column_stack([structure.node_mass, structure.nodes])]
    for members in (struts, cables):
        damping = np.zeros(len(members.edges)) if members.damping is None else members.damping
        for (i, j), *numbers in zip(members.edges, members.stiffness, members.rest_length, damping):
            rows.append([i, j, *numbers])
    dissipation = 0.0 if ground.dissipation is None else ground.dissipation
    rows.append([scene.gravity, scene.node_damping[0], ground.stiffness, dissipation, friction.mu, friction.slip_speed])
    rows.append([gait.amplitude[0], 2 * np.pi * gait.frequency[0], gait.start, gait.ramp])
    rows += [[dt, steps, len(phases)], *phases]
    return "\n".join(" ".join(repr(float(x)) if not isinstance(x, int) else str(x) for x in row) for row in rows) + "\n"


def gradient_cost(scene: Scene, phases: np.ndarray, settings: Settings) -> dict:
    """Time of the distance's gradient in all phases, by reverse and by forward mode, over that of the rollout alone."""
    horizon = settings.duration
    options = settle(scene, horizon, "rk4", settings.dt, "float64")
    scene = as_dtype(scene, "float64")
    gaits = jax.tree.map(jnp.asarray, gaits_of(scene.gait, phases))
    count = phases.shape[1]

    def ends(phase):
        start, end, *_ = roll_out_lanes(
            scene, phase, gaits.amplitude.T, gaits.frequency.T, jnp.asarray(horizon), options
        )
        return jnp.hypot(*(end - start)[:2])

    def forward(phase):
        tangents = jnp.broadcast_to(jnp.eye(count)[:, :, None], (count, *phase.shape))
        return jax.lax.map(lambda tangent: jax.jvp(ends, (phase,), (tangent,))[1], tangents)

    rollout = jax.jit(lambda: ends(gaits.phase.T))
    modes = {
        "reverse": jax.jit(lambda: distance_and_gradient(scene, gaits, horizon, options)[1]),
        "forward": jax.jit(lambda: forward(gaits.phase.T).T),
    }
    values = {name: jax.block_until_ready(mode()) for name, mode in modes.items()}
    alone = np.median([clock(rollout)[0] for _ in range(settings.repeats + 1)][1:])
    ratios = {n: float(np.median([clock(m)[0] for _ in range(settings.repeats)]) / alone) for n, m in modes.items()}
    difference = float(jnp.abs(values["reverse"] - values["forward"]).max())
    return {"gaits": len(phases), "phases": count, "horizon": horizon, "largest_difference": difference, **ratios}


def figure(rows: dict) -> Figure:
    """Microseconds per step per gait, beside the C program's where it ran."""
    drawing = Figure(figsize=(6, 3.5), layout="constrained")
    axes = drawing.subplots()
    for k, row in enumerate(rows.values()):
        bars = [("jaxgrity", row["us"], plot.STRUT), ("hand-written C", row.get("limit_us"), plot.CABLE)]
        for shift, (name, value, colour) in zip((-0.2, 0.2), bars):
            if value is not None:
                bar = axes.bar(k + shift, value, 0.38, color=colour, label=name if k == 0 else None)
                axes.bar_label(bar, fmt="%.3f")
    axes.set_xticks(range(len(rows)), list(rows))
    axes.set(ylabel="wall time per RK4 step per gait (us)", title="smaller is faster")
    axes.legend()
    return drawing


if __name__ == "__main__":
    run(main, Settings)
