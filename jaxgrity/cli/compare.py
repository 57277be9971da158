"""Compare gait searches: their settings, what they found, and how far you can trust it."""

import json
from pathlib import Path
from typing import Any

from jaxgrity.cli.script import command_header

import numpy as np
from matplotlib.figure import Figure

from jaxgrity.cli.settings import CompareSettings
from jaxgrity.core.display import aligned, mean_of_robots, with_error
from jaxgrity.core.errors import InputError
from jaxgrity.io.files import read_json, save_json
from jaxgrity.report import plot
from jaxgrity.report.gait_rows import peaks


def steady(summary: dict[str, Any]) -> str:
    """The speed of the orbit, if any."""
    found = summary.get("steady") or {"settled": False}
    return with_error(found["speed"], found["speed_error_bar"]) if found["settled"] else "-"


def beyond(summary: dict[str, Any]) -> str:
    """Whether the gait itself exceeds the bounds on actuators, and the share of perturbed robots beyond them."""
    own = "" if summary["within_bounds"] else "itself, and "
    return f"{own}{100 * summary['beyond_bounds']:.3g} % of robots"


COLUMNS = {
    "steady, m/s": steady,
    "verified, m": lambda s: with_error(s["distance"], s["error_bar"]),
    "scene": lambda s: s["scene"],
    "robust": lambda s: mean_of_robots(s["robust"], s["unit"]),
    "other model": lambda s: mean_of_robots({"standard_error": None} | s["other_contact_model"], s["unit"]),
    "motion": lambda s: (
        "-" if s["motion"] is None else f"{s['motion']['kind']}, changes of support: {s['motion']['rolls']}"
    ),
    "peak N, m/s, W": lambda s: ", ".join(each.split()[0] for each in peaks(s["actuators"])),
    "beyond a bound": beyond,
    "rollouts evolved": lambda s: str(sum(search["rollouts"] for search in s["searches"])),
    "seconds": lambda s: f"{s['wall_seconds']:.0f}" + " since resumed" * bool(s["settings"].get("resume")),
}
"""Functions of a summary that make the columns of the table, by their heads."""


def main(settings: CompareSettings) -> None:
    """Print a table of the searches, and write it as JSON with a figure."""
    if not settings.runs:
        raise InputError("no runs: expected at least one result folder of a search")
    runs = {str(folder): load_summary(folder) for folder in settings.runs}
    differ = different_settings(runs)
    rows = [["run", *differ, *COLUMNS]]
    for name, summary in runs.items():
        own = flat(summary["settings"])
        chosen = [json.dumps(own[key]) if key in own else "-" for key in differ]
        rows.append([name, *chosen, *(column(summary) for column in COLUMNS.values())])
    print(aligned(rows))
    facts = [dict(zip(rows[0], row)) for row in rows[1:]]
    save_json(settings.out / "comparison.json", {**command_header(), "runs": facts})
    plot.save(figure(runs), settings.out / "comparison.png")
    print(f"wrote {settings.out}/")


def load_summary(folder: Path) -> dict[str, Any]:
    """The summary of a finished run. Raises `InputError` for a missing one, and for one of another command."""
    path = folder / "summary.json"
    summary = read_json(path)
    needed = (
        *("distance", "error_bar", "robust", "other_contact_model", "steady", "actuators", "searches", "settings"),
        *("within_bounds", "beyond_bounds", "unit"),
    )
    missing = [key for key in needed if key not in summary]
    if missing:
        raise InputError(f"{path}: has no {', '.join(missing)}; expected the summary.json of a gait search")
    parts = [name for name in ("robust", "other_contact_model", "steady", "actuators") if summary[name] is not None]
    try:
        found = _numbers(summary, "distance", "error_bar") | {name: _numbers(summary[name]) for name in parts}
        flat(found["settings"])  # what main will ask of it, tried here, so that the error names the file
        for column in COLUMNS.values():
            column(found)
    except (KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{path}: not what a gait search leaves in summary.json: {error!r}") from error
    return found


def _numbers(facts: dict[str, Any], *names: str) -> dict[str, Any]:
    """The facts, with NaN where one of these names (or any) has none: JSON has no number that is not finite."""
    return {k: np.nan if value is None and k in (names or facts) else value for k, value in facts.items()}


def flat(settings: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested settings by their paths."""
    found: dict[str, Any] = {}
    for name, value in settings.items():
        found |= flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {f"{prefix}{name}": value}
    return found


def different_settings(runs: dict[str, dict[str, Any]]) -> list[str]:
    """The different settings of the runs, without those of their start; also settings that only some runs have."""
    every = [flat(run["settings"]) for run in runs.values()]
    keys = [key for key in dict.fromkeys(key for one in every for key in one) if key not in ("resume", "restart")]
    return [key for key in keys if any(key not in one or one[key] != every[0].get(key) for one in every)]


def best_within(search: dict[str, Any]) -> np.ndarray:
    """(generations,), fitness of the best gait; NaN where all exceed bounds."""
    return np.where(np.array(search["within"]) > 0, np.array(search["best"], float), np.nan)


@plot.styled
def figure(runs: dict[str, dict[str, Any]]) -> Figure:
    """Fitness by generation, with gaps where all gaits exceed bounds, and robust results with their robots' spread."""
    chart = Figure(figsize=(11, 4.5), layout="constrained")
    left, right = chart.subplots(1, 2)
    for k, (name, summary) in enumerate(runs.items()):
        best = np.concatenate([best_within(search) for search in summary["searches"]])
        (line,) = left.plot(np.arange(1, len(best) + 1), best, label=name)
        robust = summary["robust"]
        right.errorbar(robust["mean"], k, xerr=robust["standard_deviation"], fmt="o", color=line.get_color(), capsize=4)
        right.plot(summary["other_contact_model"]["mean"], k, "x", color=line.get_color())
    left.set(xlabel="generation", ylabel="fitness of the best, by the draws that chose it")
    left.set_title("gaps: all gaits beyond bounds", fontsize="medium")
    left.legend(fontsize="small")
    left.grid(alpha=0.3)
    right.set(yticks=range(len(runs)), yticklabels=[Path(name).name for name in runs], xlabel="robust objective")
    right.set_title("mean and standard deviation over robots; x: other contact model", fontsize="medium")
    right.grid(alpha=0.3)
    return chart
