"""What a gait costs in populations of 256 up to a million, by both contact models in both precisions.

It measures the devices that JAX finds: a GPU where there is one; `JAX_PLATFORMS=cpu` takes the cores. Each row is saved
as soon as it is measured, and --beside FILE shows the rows of another machine next to these.
"""

import json
import time
from dataclasses import dataclass
from pathlib import Path

from jaxgrity.cli.script import measured, run

import jax
import numpy as np
from matplotlib.figure import Figure
from scaling import METHODS
from tqdm import tqdm

from jaxgrity import Outcomes, SolverOptions, gaits_of, load_scene, random_phases, simulate_population
from jaxgrity.io.files import save_json
from jaxgrity.report import plot

DURATION = 0.5
"""s, that populations are rolled out for"""
SIZES = [4**k for k in range(4, 11)]
COMPARED = 256
"""gaits whose places at the end are kept: every population begins with them, on every machine"""


@dataclass
class Settings:
    largest: int = SIZES[-1]
    """gaits in the largest population"""
    beside: Path | None = None
    """populations.json of another machine"""
    out: Path = Path("results/populations")
    """folder for populations.json and populations.png"""
    quick: bool = False
    """256 gaits by complementarity stepping alone"""


def main(settings: Settings) -> None:
    jax.config.update("jax_num_cpu_devices", measured()["cores"])
    methods = ["complementarity"] if settings.quick else list(METHODS)
    sizes = [size for size in SIZES if size <= (SIZES[0] if settings.quick else settings.largest)]
    tasks = [(m, dtype, n) for n in sizes for m in methods for dtype in ("float32", "float64")]
    device = jax.devices()[0]
    facts = {
        **measured(),
        "device": device.device_kind if device.platform != "cpu" else f"{len(jax.devices())} cores",
        "jax": jax.__version__,
        "rows": [],
        "ends": {},
    }
    if settings.beside is not None:
        facts["beside"] = json.loads(settings.beside.read_text())
    for method, dtype, gaits in tqdm(tasks, unit="run"):
        row, end = cost(method, dtype, gaits)
        facts["rows"].append(row)
        facts["ends"].setdefault(f"{method} {dtype}", end.tolist())
        save_json(settings.out / "populations.json", facts)
        tqdm.write(f"{row['method']} {dtype}, {gaits} gaits: {1e6 * row['per_gait_and_simulated_second']:.3g} us")
    plot.save(figure(facts), settings.out / "populations.png")
    print(f"wrote {settings.out}/populations.json and populations.png, from {facts['device']}")


def cost(method: str, dtype: str, gaits: int) -> tuple[dict, np.ndarray]:
    """Of one call, the fastest of up to three after one that compiles; and where the first robots end, m."""
    name, dt = METHODS[method]
    scene = load_scene(name)
    phases = np.concatenate([random_phases(COMPARED, 6, seed=0), random_phases(gaits, 6, seed=1)])[:gaits]
    rows, options = gaits_of(scene.gait, phases), SolverOptions(method=method, dt=dt, dtype=dtype, any_step=True)
    seconds: list[float] = []
    while len(seconds) < 2 or (len(seconds) < 4 and sum(seconds[1:]) < 4.0):
        start = time.perf_counter()
        found: Outcomes = jax.block_until_ready(simulate_population(scene, rows, DURATION, options=options))
        seconds.append(time.perf_counter() - start)
    fastest = min(seconds[1:])
    facts = {
        "method": method,
        "dtype": dtype,
        "gaits": gaits,
        "seconds": fastest,
        "per_gait_and_simulated_second": fastest / gaits / DURATION,
        "compile_seconds": seconds[0] - fastest,
        "failed": int(np.sum(np.asarray(found.failure) != 0)),
    }
    return facts, np.asarray(found.com_end[:COMPARED], float)


@plot.styled
def figure(facts: dict) -> Figure:
    """Cost per gait and simulated second against the size of the population; dashed: the other machine's."""
    chart = Figure(figsize=(10, 4), layout="constrained")
    for axes, method in zip(chart.subplots(1, 2, sharey=True, squeeze=False)[0], METHODS):
        for style, measured_there in (("o-", facts), ("s--", facts.get("beside"))):
            for colour, dtype in zip(("C0", "C1"), ("float32", "float64")):
                if measured_there is None:
                    continue
                rows = [r for r in measured_there["rows"] if (r["method"], r["dtype"]) == (method, dtype)]
                each = 1e6 * np.array([row["per_gait_and_simulated_second"] for row in rows])
                label = f"{dtype}, {measured_there['device']}"
                axes.loglog([row["gaits"] for row in rows], each, style, color=colour, label=label)
        axes.set(xlabel="gaits", title=method)
        axes.grid(alpha=0.3, which="both")
        axes.legend()
    chart.axes[0].set_ylabel("us per gait and simulated second")
    return chart


if __name__ == "__main__":
    run(main, Settings)
