"""Section 9: what the paper leaves to the future, and what this project has of it.

Numbers about control are those of other measurements, in docs/measured.
"""

import json
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from paper_claims.block import LAWS, slide
from paper_claims.report import HOLDS, REFERENCE, Report, Row, scenes, significant, verdict

from jaxgrity import ExactGround, SolverOptions, bumps, gaits_of, random_phases, sensitivity, simulate_population
from jaxgrity.io.files import read_text
from jaxgrity.report import plot

MEASURED = Path(__file__).parents[2] / "docs" / "measured"


def check(quick: bool) -> Report:
    """One number for each direction."""
    slips = {law: slide(law, 45.0)["slid"] for law in LAWS}
    exact = slide("cone", 45.0)["exact"]
    spread = turning(quick)
    growth = sensitivity(scenes()[REFERENCE], 2.0 if quick else 8.0, options=SolverOptions("rk4", 1e-3))
    slope = ExactGround(np.radians(15.0)).normal
    places = np.linspace(-5, 5, 101)
    rough = ExactGround(surface=bumps(0.03, 0.8, seed=0)).height(*np.meshgrid(places, places))
    planned, robots = measured("obstacles")["planned"], measured("obstacles")["fields"]
    dropped, bumpy, uphill = (
        {row["policy"]: row for row in measured("feedback_penalty")["rows"] if row["case"] == case}
        for case in ("dropped, after 15 s", "bumps of 2 cm", "slope of 5 degrees, on the way up")
    )
    rows = [
        Row(
            "more sophisticated friction or slip models",
            "9",
            "1 kg block, 45 degrees",
            f"smooth, switch and cone slide {', '.join(significant(s, 'm') for s in slips.values())} in 5 s; exact "
            f"{significant(exact, 'm')}",
            HOLDS,
            "jaxgrity has them (`jaxgrity/model/friction.py`), here with one friction coefficient each",
        ),
        Row(
            "multi-step rolling path planning with obstacles",
            "9",
            REFERENCE,
            f"the {spread['gaits']} gaits tried lead in {spread['sectors']} of 8 directions (sectors of 45 degrees); "
            f"by the plan {planned['reached']} of {robots} robots reach a goal round obstacles, and touch nothing",
            verdict(planned["reached"] == robots, planned["reached"] > 0),
            "jaxgrity has it: `jaxgrity.control.lead_to` (`docs/control.md`)",
        ),
        Row(
            "real-time feedback control for strut reconfiguration",
            "9",
            REFERENCE,
            f"without feedback the centre of mass after {growth.times[-1]:g} s depends on the phases by "
            f"{significant(growth.norm[-1], 'm/rad')}; of {dropped['feedback']['counted']} dropped robots "
            f"{dropped['open loop']['rolled']} roll without feedback, {dropped['feedback']['rolled']} with it",
            verdict(False, dropped["feedback"]["rolled"] > dropped["open loop"]["rolled"]),
            "jaxgrity has it in simulation (`docs/control.md`); no real robot has been driven",
        ),
        Row(
            "higher-level locomotion in unstructured terrain",
            "9",
            "planes and bumps",
            f"ground is any signed distance: a plane at 15 degrees has n = ({slope[0]:.3f}, 0, {slope[2]:.3f}), random "
            f"bumps are {rough.min():.3f} to {rough.max():.3f} m high; of {bumpy['sure-footed']['counted']} robots "
            f"with `sure_footed` feedback {bumpy['sure-footed']['rolled']} roll on bumps of 2 cm, "
            f"{uphill['sure-footed']['rolled']} up a slope of 5 degrees",
            verdict(min(row["sure-footed"]["rolling"] for row in (bumpy, uphill)) > 0.9),
            "jaxgrity has planes, stairs, bumps, measured heights and obstacles (`docs/terrain.md`), and feedback for "
            "them (`docs/control.md`)",
        ),
    ]
    return Report("Future directions", rows, "future", {"moved": spread["moved"]})


def measured(name: str) -> dict:
    """What pages quote of a measurement."""
    return json.loads(read_text(MEASURED / f"{name}.json"))


def turning(quick: bool) -> dict:
    """Displacements of random gaits, and into how many sectors they lead."""
    scene = scenes()[REFERENCE]
    phases = random_phases(8 if quick else 64, len(scene.gait.members), seed=0)
    duration, options = 2.0 if quick else 8.0, SolverOptions(dt=1e-3)
    outcomes = simulate_population(scene, gaits_of(scene.gait, phases), duration, options=options)
    moved = np.asarray(outcomes.com_end - outcomes.com_start)[:, :2]
    far = np.linalg.norm(moved, axis=1) > 0.0
    sectors = np.floor(np.degrees(np.arctan2(moved[far, 1], moved[far, 0])) / 45).astype(int)
    return {"gaits": len(phases), "sectors": len(set(sectors.tolist())), "moved": moved}


@plot.styled
def figure(moved: list) -> Figure:
    chart = Figure(figsize=(plot.WIDTH, 4.8), layout="constrained")
    axes = chart.subplots()
    axes.plot(*np.transpose(moved), "o", ms=4, label="random gaits, 8 s")
    axes.plot(0, 0, "k+", ms=12, label="start")
    axes.set(xlabel="x (m)", ylabel="y (m)")
    axes.axis("equal")
    chart.legend(loc="outside right upper")
    return chart
