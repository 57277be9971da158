"""Compare recorded motions of a robot with their simulation, and identify parameters from a part of them."""

from typing import Any

from jaxgrity.cli.script import command_header

import numpy as np

from jaxgrity.cli.scenes import chosen_scene, scene_name
from jaxgrity.cli.settings import ValidateSettings
from jaxgrity.core.display import aligned, significant
from jaxgrity.core.errors import InputError
from jaxgrity.identification import identify
from jaxgrity.identification.parameters import Parameter, check_parameters
from jaxgrity.identification.recorded_motions import Compared, beside_simulation, recorded_motion
from jaxgrity.identification.recordings import FEWEST_FRAMES, Recording, read_recording
from jaxgrity.io.files import save_json
from jaxgrity.model.rigidity import linked
from jaxgrity.model.scales import length_scale
from jaxgrity.model.scene import Scene
from jaxgrity.report import plot
from jaxgrity.statics.describe import describe
from jaxgrity.stepping.options import SolverOptions

CLOSE = 0.1
"""Share of a body length within which a simulation counts as close to the recording."""
SPREAD = 0.3
"""Plausible error of a parameter for which none is given, as a fraction."""
QUICK = 2.0
"""Longest part of a recording that counts with --quick, s."""
BEFORE, AFTER = "simulated", "identified"
"""Names of the simulations: of the scene as it is, and of the fitted one."""


def main(settings: ValidateSettings) -> None:
    """Read, compare, identify, compare again; print a sentence for each part that counts, and a table of all."""
    scene = chosen_scene(settings.scene, settings.gait)
    parameters = [parameter_of(word) for word in settings.identify]
    if parameters:
        check_parameters(scene, parameters)
    parts, fitted = recorded_parts(scene, settings)
    options = SolverOptions(method=settings.method, dt=settings.dt)
    windows, noise = settings.windows, settings.noise
    # made of all parts, since they refuse what cannot be simulated before anything is said
    cut = {name: windows if name in fitted else 1 for name in parts}
    motions = {
        name: recorded_motion(scene, part, noise, windows=cut[name], options=options) for name, part in parts.items()
    }
    print(describe(scene), flush=True)
    found = None
    compared = {name: {BEFORE: beside_simulation(scene, part, options=options)} for name, part in parts.items()}
    if parameters:
        print(f"\nfitting {', '.join(settings.identify)} to {' and '.join(fitted)} ...", flush=True)
        found = identify(scene, parameters, [motions[name] for name in fitted], twin=not settings.quick)
        for name, part in parts.items():
            compared[name][AFTER] = beside_simulation(found.scene, part, options=options)
    size = float(length_scale(scene))
    rows = [part_numbers(name, simulations, size) for name, simulations in compared.items()]
    print()
    for row in rows:
        if row["recording"] not in fitted:
            print(sentence(row, size))
    print(f"\n{errors_table(rows)}")
    facts: dict[str, Any] = {"scene": scene_name(settings.scene), "close": CLOSE * size, "parts": rows}
    if found is not None:
        print(f"\n{found.summary()}")
        estimates = [each._asdict() for each in found.estimates]
        facts["identified"] = {"converged": found.converged, "misfit": found.misfit, "estimates": estimates}
        if linked(scene):
            print("rigid struts leave no start free: errors of the first pose are not in these intervals")
    save_json(settings.out / "summary.json", command_header() | facts)
    plot.save(plot.recorded_figure(scene, compared, CLOSE * size), settings.out / "recorded.png")
    print(f"wrote {settings.out}/summary.json and {settings.out}/recorded.png")


def parameter_of(word: str) -> Parameter:
    """A parameter from its name, perhaps with `=` and its plausible spread. Raises `InputError` for another word."""
    path, _, spread = word.partition("=")
    try:
        return Parameter(path, float(spread) if spread else SPREAD)
    except ValueError:
        raise InputError(f"--identify {word}: expected a name, or a name with its spread, such as {path}=0.3") from None


def recorded_parts(scene: Scene, settings: ValidateSettings) -> tuple[dict[str, Recording], list[str]]:
    """The parts that are compared, by name, and the names of those that parameters are fitted to.

    With parameters to identify, one recording is cut in halves, and of several the last one is held out.
    """
    if not settings.data:
        raise InputError("--data: names no recording; expected at least one file (CSV or JSON)")
    parts: dict[str, Recording] = {}
    alike = len({path.name for path in settings.data}) < len(settings.data)
    for path in settings.data:
        whole = read_recording(path, scene, settings.unit)
        short = whole.times - whole.times[0] <= QUICK
        if settings.quick and short.sum() < FEWEST_FRAMES:
            seen = f"rows in the first {QUICK:g} s: {short.sum()}"
            raise InputError(f"{path}: {seen}; expected {FEWEST_FRAMES} or more, or no --quick")
        parts[str(path) if alike else path.name] = whole.part(slice(int(short.sum()))) if settings.quick else whole
    if not settings.identify:
        return parts, []
    if len(parts) > 1:
        return parts, list(parts)[:-1]
    ((name, whole),) = parts.items()
    half = len(whole.times) // 2
    late = np.flatnonzero(np.all(whole.known(scene.structure)[half:-1], axis=1))
    if not late.size:
        raise InputError(f"{name}: no row after the middle has every node; expected one, with which the test can begin")
    cut, first, last = half + int(late[0]), f"{name}, fitted", f"{name}, held out"
    return {first: whole.part(slice(cut + 1)), last: whole.part(slice(cut, None))}, [first]


def part_numbers(name: str, simulations: dict[str, Compared], size: float) -> dict[str, Any]:
    """What a part of a recording shows, s and m: errors are root mean squares, infinite for a failed simulation."""
    first = simulations[BEFORE]
    found: dict[str, Any] = {
        "recording": name,
        "seconds": float(first.times[-1] - first.times[0]),
        "not_moved": rms(first.moved()),
    }
    for kind, each in simulations.items():
        found[kind] = {"error": rms(each.errors()), "close_for": each.stays_within(CLOSE * size)}
    return found


def rms(errors: np.ndarray) -> float:
    """The root mean square over the frames in which a node was seen."""
    return float(np.sqrt(np.nanmean(np.square(errors))))


def sentence(row: dict[str, Any], size: float) -> str:
    """How far simulations are from a recording, beside a robot that had not moved, in words."""
    near = row.get(AFTER, row[BEFORE])
    told = f"{row['recording']}: over {row['seconds']:.3g} s the simulated nodes are {far(row[BEFORE], size)}"
    told += f", and {far(near, size)} after identification." if AFTER in row else "."
    told += f" If the robot had not moved, they would be {significant(row['not_moved'])} m off."
    span = "all of the time" if near["close_for"] == row["seconds"] else f"the first {near['close_for']:.3g} s"
    return f"{told} The simulation stays within {CLOSE:.0%} of a body length for {span}."


def far(simulated: dict[str, float], size: float) -> str:
    """A root mean square distance from where nodes were recorded, m, in words."""
    distance = simulated["error"]
    if not np.isfinite(distance):
        return "nowhere, since the simulation failed (take a smaller --dt)"
    return f"{significant(distance)} m off ({distance / size:.2g} body lengths)"


def errors_table(rows: list[dict[str, Any]]) -> str:
    """A line for each part: root mean square distances, and how long simulations stay close."""
    simulated = [name for name in (BEFORE, AFTER) if name in rows[0]]
    heads = [cell for name in simulated for cell in (f"{name}, m", f"within {CLOSE:.0%}, s")]
    lines = [["recording", "time, s", "not moved, m", *heads]]
    for row in rows:
        cells = [cell for name in simulated for cell in row[name].values()]
        lines.append([row["recording"], *(f"{x:.3g}" for x in (row["seconds"], row["not_moved"], *cells))])
    return aligned(lines)
