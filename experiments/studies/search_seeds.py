"""The default search by several seeds: what each finds, and what polishing gains on the robots that decide about it."""

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from measurements.measurement import Figure, Record, measurement
from measurements.pages import columns

from jaxgrity.io.files import read_text

SEARCH = Path(__file__).parents[1] / "gait_search.py"


@measurement(page="search_records.md", quick={"seeds": (0,), "small": True})
def search_seeds(out: Path, seeds: tuple[int, ...] = tuple(range(8)), small: bool = False) -> Iterator[Record]:
    """A row for each seed; each search leaves a folder, and one that is finished there is not repeated.

    Args:
        seeds: of the searches
        small: whether searches are as small as with --quick
    """
    for seed in seeds:
        path = out / f"seed_{seed}" / "summary.json"
        if not path.exists():
            asked = ["--seed", str(seed), *["--quick"] * small, "--restart", "--out", str(path.parent)]
            subprocess.run([sys.executable, SEARCH, *asked], check=True)
        yield {"seed": seed} | facts_of(json.loads(read_text(path)))


def facts_of(summary: Record) -> Record:
    """Of a search's summary: the speed of the orbit, of perturbed robots, and the gain of polishing."""
    steady, polish = summary["steady"], summary["polish"]
    found: Record = {name: None if polish is None else polish[name] for name in ("fitness_before", "fitness_after")}
    if steady is None or not steady["settled"]:
        return found | dict.fromkeys(("speed", "settles", "own", "own_deviation", "other", "other_deviation"))
    own, other = steady["robust"], steady["other_contact_model"]
    size = steady["body_length"]
    return found | {
        "speed": steady["body_lengths_per_second"],
        "settles": steady["settled_after"],
        "own": own["mean"] / size,
        "own_deviation": own["standard_deviation"] / size,
        "other": other["speed"] / size,
        "other_deviation": other["standard_deviation"] / size,
    }


@search_seeds.table
def words(record: Record) -> str:
    """Speeds of what each seed found, and the gain of polishing."""
    number = lambda name, digits: lambda row: "-" if row[name] is None else f"{row[name]:.{digits}f}"  # noqa: E731
    robots = lambda name: lambda row: "-" if row[name] is None else f"{row[name]:.3f} ({row[name + '_deviation']:.3f})"  # noqa: E731
    cells = {
        "seed": "{seed}",
        "steady speed, body lengths/s": number("speed", 3),
        "perturbed robots": robots("own"),
        "on the other contact model": robots("other"),
        "settles after, s": number("settles", 1),
        "fitness before polish": number("fitness_before", 3),
        "after": number("fitness_after", 3),
    }
    return columns(record["rows"], cells)


@search_seeds.figure(4)
def figure(record: Record, chart: Figure) -> None:
    """Speeds of the orbit and of perturbed robots, with their standard deviations."""
    axes, rows = chart.subplots(), [row for row in record["rows"] if row["speed"] is not None]
    seeds = [row["seed"] for row in rows]
    axes.plot(seeds, [row["speed"] for row in rows], "k_", markersize=14, label="orbit")
    for shift, name, label in ((-0.1, "own", "perturbed robots"), (0.1, "other", "on the other contact model")):
        at, spread = [seed + shift for seed in seeds], [row[f"{name}_deviation"] for row in rows]
        axes.errorbar(at, [row[name] for row in rows], yerr=spread, fmt="o", markersize=4, capsize=3, label=label)
    axes.set(xlabel="seed of the search", ylabel="speed (body lengths/s)", xticks=seeds)
    chart.legend(loc="outside upper center", ncols=3)
