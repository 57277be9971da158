"""How fast this machine is, in about two minutes: a table of the library's methods, and of MuJoCo and hand-written C.

MuJoCo is measured where it is installed (the extra `peer`), C where there is a compiler. Engines take turns: what slows
the machine down slows all of them.
"""

import platform
import time
from dataclasses import dataclass
from importlib import metadata, util
from pathlib import Path

from jaxgrity.cli.script import command_header

import numpy as np
from measurements.engines import SAME_MODEL, Engine, engines, seconds_of
from measurements.pages import columns
from tqdm import tqdm

from jaxgrity import load_scene, random_phases
from jaxgrity.io.files import save_json

STEPS = {"rk4": 5e-4, "complementarity": 5e-3, "limit": 5e-4, "exact": 5e-3, "mujoco Euler": 1e-3}
"""s; engines without one here are left out"""


@dataclass
class Settings:
    gaits: tuple[int, ...] = (64, 256)
    """sizes of the populations"""
    duration: float = 4.0
    """simulated time, s"""
    repeats: int = 5
    """rounds; the median counts of those of each, in which an engine is timed for a fifth of a second"""
    out: Path = Path("results/bench")
    """folder for bench.json"""
    quick: bool = False
    """an eighth of the time, two rounds"""


def main(settings: Settings) -> None:
    began = time.perf_counter()
    if settings.quick:
        settings.duration, settings.repeats = settings.duration / 8, 2
    scenes = {name: load_scene(name) for name in ("reference", "exact")}
    tasks: list[Engine] = []
    mujoco = util.find_spec("mujoco") is not None
    for count in settings.gaits:
        chosen = engines(scenes, random_phases(count, 6, seed=0), settings.duration, mujoco, mjx=False)
        tasks += [each for each in chosen if each.name in STEPS and (each.gaits == count or count == settings.gaits[0])]
    first = [engine.roll(STEPS[engine.name])[1] for engine in tqdm(tasks, desc="compiling", unit="run")]
    rounds = [
        [seconds_of(engine, STEPS[engine.name]) for engine in tasks]
        for _ in tqdm(range(settings.repeats), desc="rounds", unit="round")
    ]
    rows = [
        row(engine, settings.duration, start, seconds)
        for engine, start, seconds in zip(tasks, first, np.median(rounds, axis=0))
    ]
    add_ratios(rows)
    versions = {name: metadata.version(name) for name in ("jaxgrity", "jax", "jaxlib")}
    facts = {"processor": processor(), "versions": versions, "duration": settings.duration, "rows": rows}
    save_json(settings.out / "bench.json", {**command_header(), **facts})
    print(table(facts))
    print(f"wrote {settings.out}/bench.json ({time.perf_counter() - began:.0f} s since this command began)")
    print(
        "To send it in, open an issue of the project with this table and bench.json; it says nothing but what it shows."
    )


def row(engine: Engine, duration: float, first: float, seconds: float) -> dict:
    """What one engine needs; `first` is the wall time of the call that compiles, s."""
    steps, share = duration / STEPS[engine.name], seconds / engine.gaits
    return {
        "gaits": engine.gaits,
        "engine": engine.name,
        "dtype": engine.dtype,
        "dt": STEPS[engine.name],
        "us_per_step_and_gait": 1e6 * share / steps,
        "rollouts_of_10_s_per_second": duration / 10 / share,
        "compile_seconds": max(0.0, first - seconds),
    }


def add_ratios(rows: list[dict]) -> None:
    """The time of each of the library's methods over that of the C program that does the same."""
    known = {(r["engine"], r["dtype"], r["gaits"]): r["us_per_step_and_gait"] for r in rows}
    for each in rows:
        same = known.get((SAME_MODEL.get(each["engine"]), each["dtype"], each["gaits"]))
        each["times_C"] = None if same is None else each["us_per_step_and_gait"] / same


def processor() -> str:
    """Its name, as the system tells it."""
    info = Path("/proc/cpuinfo")
    for line in info.read_text().splitlines() if info.exists() else ():
        if line.startswith("model name"):
            return line.split(":")[1].strip()
    return platform.processor() or platform.machine()


def table(facts: dict) -> str:
    """In Markdown, to be read and to be pasted."""
    cells = {
        "engine": "{engine}",
        "precision": "{dtype}",
        "gaits": "{gaits}",
        "step (s)": "{dt:g}",
        "us for a step of a gait": "{us_per_step_and_gait:.3f}",
        "rollouts of 10 s a second": "{rollouts_of_10_s_per_second:.0f}",
        "times C": lambda row: "-" if row["times_C"] is None else f"{row['times_C']:.1f}",
        "compiled (s)": "{compile_seconds:.1f}",
    }
    versions = ", ".join(f"{name} {version}" for name, version in facts["versions"].items())
    return f"{columns(facts['rows'], cells)}\n\n{facts['processor']}, {command_header()['cores']} cores; {versions}"
