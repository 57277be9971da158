"""Section 6.5 and appendix C: struts against cables, slowly; and the random fifth of the cables."""

import numpy as np
from matplotlib.figure import Figure
from paper_claims.report import CALLED, PROGRAM, REFERENCE, TEXT, Report, Row, scenes, significant, thinned, verdict

from jaxgrity import Gait, Scene, SolverOptions, centre_path, gaits_of, simulate, simulate_population, with_gait
from jaxgrity.model import random_members
from jaxgrity.report import plot

FREQUENCIES = (0.5, 0.25, 0.125, 0.0625, 0.03125)
"""Hz"""
PERIODS = 2
FRAMES = 160
"""in a period"""
SHARE = 0.2
ALIKE = 0.1
"""of the longer displacement, within which two count as the same"""
RK4 = SolverOptions("rk4", 1e-3)


def check(quick: bool) -> Report:
    """Displacement and path as the frequency tends to zero, both actuations; displacement over random fifths."""
    known = scenes()
    names = (REFERENCE,) if quick else (REFERENCE, TEXT, PROGRAM)
    frequencies = FREQUENCIES[:2] if quick else FREQUENCIES
    slow = {name: {kind: creep(known[name], kind, frequencies) for kind in ("struts", "cables")} for name in names}
    seeds = 4 if quick else 32
    spread = {name: subsets(known[name], seeds, 4.0 if quick else 10.0) for name in names}
    rows = [slow_row(name, found, frequencies) for name, found in slow.items()]
    rows += [subset_row(name, found) for name, found in spread.items()]
    moved = {name: {kind: each["moved"] for kind, each in found.items()} for name, found in slow.items()}
    near = {kind: thinned(each["path"][:, :2]) for kind, each in slow[REFERENCE].items()}
    drawn = {"frequencies": frequencies, "moved": moved, "paths": near, "spread": spread}
    return Report("Struts against cables", rows, "actuation", drawn)


def actuated(scene: Scene, kind: str, frequency: float) -> Scene:
    """All struts, or a random fifth of the cables, with evenly spread phases, in full swing after one period."""
    first, struts, cables = 0, len(scene.structure.struts.edges), len(scene.structure.cables.edges)
    members = tuple(range(struts))
    if kind == "cables":
        members = random_members(range(struts, struts + cables), SHARE, seed=0)
    count = len(members)
    amplitude = np.full(count, float(np.max(scene.gait.amplitude)))
    phase = 2 * np.pi * np.arange(count) / count
    return with_gait(scene, Gait(members, phase, amplitude, np.full(count, frequency), first, 1 / frequency))


def creep(scene: Scene, kind: str, frequencies: tuple[float, ...]) -> dict:
    """m, horizontal displacement over the ramp and `PERIODS` more; the path at the lowest frequency."""
    moved = []
    for frequency in frequencies:
        changed = actuated(scene, kind, frequency)
        # as many frames at every frequency: one program
        motion = simulate(changed, (PERIODS + 1) / frequency, options=RK4, frame_rate=FRAMES * frequency)
        path = centre_path(changed, motion)
        after = path[np.asarray(motion.times) >= 1 / frequency]
        moved.append(float(np.hypot(*(after[-1] - after[0])[:2])))
    return {"moved": moved, "path": path - path[0]}


def subsets(scene: Scene, seeds: int, duration: float) -> list[float]:
    """m, displacement for each random fifth of the cables, random phases; all have a gait, most of them of size 0."""
    struts, cables = len(scene.structure.struts.edges), len(scene.structure.cables.edges)
    every = range(struts, struts + cables)
    amplitude, phase = np.zeros((seeds, cables)), np.zeros((seeds, cables))
    for seed in range(seeds):
        chosen = np.array(random_members(every, SHARE, seed)) - struts
        amplitude[seed, chosen] = float(np.max(scene.gait.amplitude))
        phase[seed] = np.random.default_rng(seed).uniform(0, 2 * np.pi, cables)
    frequency = float(np.max(scene.gait.frequency))
    gait = Gait(tuple(every), phase[0], amplitude[0], np.full(cables, frequency), 0.0, 1.0)
    still = with_gait(scene, gait)
    gaits = gaits_of(gait, phase, amplitude)
    return [float(d) for d in simulate_population(still, gaits, duration, options=RK4).distance()]


def slow_row(name: str, found: dict, frequencies: tuple[float, ...]) -> Row:
    struts, cables = found["struts"]["moved"], found["cables"]["moved"]
    longer = max(struts[-1], cables[-1])
    alike = abs(struts[-1] - cables[-1]) < ALIKE * longer
    measured = f"at {frequencies[-1]:g} Hz struts move it {significant(struts[-1], 'm')}, cables "
    measured += f"{significant(cables[-1], 'm')} in {PERIODS} periods; at {frequencies[0]:g} Hz "
    measured += f"{significant(struts[0], 'm')} and {significant(cables[0], 'm')}"
    why = (
        "which way the robot tips depends on the members that change, however slowly they change. Without damping it "
        "depends on the bounces too"
    )
    if alike:
        why = f"both displacements agree to {ALIKE:.0%}"
    elif longer < 0.1 * np.ptp(np.asarray(scenes()[name].structure.nodes), axis=0).max():
        why = "slowly, neither makes it tip: both displacements are small against the body, and not the same"
    return Row(
        "struts and cables roll it alike in the quasi-static limit", "6, 6.5", name, measured, verdict(alike), why
    )


def subset_row(name: str, found: list[float]) -> Row:
    distance = np.array(found)
    good = distance[np.isfinite(distance)]
    quartiles = np.percentile(good, [0, 25, 50, 75, 100])
    size = float(np.ptp(np.asarray(scenes()[name].structure.nodes), axis=0).max())
    measured = f"{len(good)} draws: " + ", ".join(significant(q) for q in quartiles) + " m (quartiles)"
    holds = bool(quartiles[2] > size)
    why = (
        f"how far it goes depends on which cables are drawn; the body is {size:.2f} m across, and half of the draws go "
    )
    why += "further" if holds else "less far"
    claim = "a random 20 % of the cables makes it roll"
    return Row(claim, "6, C", name, measured, verdict(holds, bool(quartiles[4] > size)), why)


@plot.styled
def figure(frequencies: list[float], moved: dict, paths: dict, spread: dict) -> Figure:
    chart = Figure(figsize=(plot.WIDTH, 4.8), layout="constrained")
    distance, above, draws = chart.subplots(1, 3)
    looks = iter(zip(("C0", "C1", "C2", "C3", "C4", "C5"), plot.MARKERS))
    for name, found in moved.items():
        for kind in ("struts", "cables"):
            (colour, marker), metres = next(looks), np.maximum(np.array(found[kind], float), 1e-6)
            style = "-" if kind == "struts" else "--"
            distance.loglog(frequencies, metres, marker + style, color=colour, ms=5, label=f"{CALLED[name]}, {kind}")
    for path, colour in zip(paths.values(), ("C0", "C1")):  # the reference robot's, as to the left
        above.plot(*np.transpose(path), color=colour)
    every = [np.array(each, float) for each in spread.values()]
    found = [each[np.isfinite(each)] for each in every]
    draws.boxplot(found, tick_labels=[CALLED[name].replace(" ", "\n") for name in spread], whis=(0, 100))
    draws.set_yscale("log")
    draws.grid(visible=False, axis="x")
    distance.set(xlabel="frequency (Hz)", ylabel="displacement in two periods (m)")
    above.set(xlabel="x (m)", ylabel="y (m)", title=f"{CALLED[REFERENCE]}, {frequencies[-1]:.3g} Hz")
    above.axis("equal")
    draws.set(ylabel="displacement (m)", title="a random fifth\nof the cables")
    distance.set_xticks(frequencies, [f"{f:.3g}" for f in frequencies], rotation=45)
    distance.minorticks_off()
    chart.legend(*distance.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return chart
