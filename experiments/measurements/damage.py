"""A broken cable, a stuck strut: how fast does a gait still roll, and how soon is a better one found?

Every cable breaks in turn, and every strut gets stuck at its rest length (`broken = [k]` under [cables] and
`stuck = [k]` under [struts] say the same in a scene file). What counts is steady speed, in the mean over robots that
differ, on both contact models. The intact robot's gait is tried as it is; so are all gaits of the library, those of
cables too, as each rotation and mirroring of the robot sees them. Three short searches look for new ones: for waves of
struts, for gaits of struts that each move as they like, and for gaits of cables alone, as quick as actuators can be.
All of it is done with the intact robot too, since a short search may find little there as well.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from measurements.damage_recovery import SEARCHES, WAYS, Ways, damaged, known_gaits, plain_names, recover
from measurements.measurement import Figure, Record, check_names, measurement
from measurements.pages import table

from jaxgrity import SearchConfig, gait_record, load_scene
from jaxgrity.model import symmetries
from jaxgrity.report import plot

ENOUGH = 0.7
"""Share of what the intact robot reaches from which on a gait counts as recovered."""


@measurement(
    page="search_records.md",
    quick={"cases": ("cable 7", "strut 1"), "duration": 5.0, "population": 16, "generations": 1, "images": 1},
    raw=("intact", "damaged", "recovered"),
    drawn=("speeds",),
)
def damage(
    gait: str = "lasting",
    cases: tuple[str, ...] = (),
    duration: float = 40.0,
    population: int = 128,
    generations: int = 25,
    images: int | None = None,
    seed: int = 0,
) -> Iterator[Record]:
    """A row for each robot, the intact one first, until all are done; then one for each kind of damage and each way.

    Args:
        gait: of the library: what the robot does when it is damaged
        cases: which damages, as "cable 7" or "strut 1"; every one where not given
        duration: s
        population: gaits in a generation of a search
        generations: of a search
        images: of each gait of the library, how many are tried; all where not given
        seed: the same seed gives the same numbers
    """
    check_names("gait", (gait,), plain_names())
    scene = load_scene(gait_record(gait)["scene"])
    every, found = damaged(scene), {}
    check_names("cases", cases, every)
    robots = {"intact": scene} | {name: every[name] for name in cases or every}
    library = known_gaits(scene, symmetries(scene.structure)[:images])
    size = duration, population, (generations, 0)
    configs = {way: SearchConfig(*size, space=space) for way, space in SEARCHES.items()}
    for number, (name, robot) in enumerate(robots.items()):
        found[name] = recover(scene, robot, (library, gait), configs, (seed, seed + number))
        yield {"robot": name, **found[name]}
    intact = found.pop("intact")
    kinds = dict.fromkeys(name.split()[0] for name in found)  # cable, strut
    searched = population * (3 + generations)  # the first generation is four times as large
    counts = {kind: recovered(found, intact, kind) for kind in kinds}
    about = {"gait": gait, "enough": ENOUGH, "duration": duration, "population": population, "generations": generations}
    gaits = {"as it was": 1, "library": len(library.names)} | dict.fromkeys(SEARCHES, searched)
    whole = {"intact": intact, "damaged": found, "recovered": counts}
    return {**about, "gaits": gaits, "rows": told(**whole), "speeds": drawn_speeds({"intact": intact} | found), **whole}


def drawn_speeds(robots: dict[str, Ways]) -> Record:
    """For the figure: on the own contact model, of all robots by each way, and the intact robot's best."""
    own = {way: [robot[way]["own"] for robot in robots.values()] for way in WAYS}
    found = {name: {way: [each[name] for each in own[way]] for way in WAYS} for name in ("mean", "standard_deviation")}
    within = {way: [robot[way]["within_bounds"] for robot in robots.values()] for way in WAYS}
    best = fastest(robots["intact"])["own"]["mean"]
    return {"robots": list(robots), "best": best, **found, "within_bounds": within}


def told(intact: Ways, damaged: dict[str, Ways], recovered: Record) -> list[Record]:
    """For each way to a gait: its speeds on the intact robot, and on damaged ones, and in how many they are enough."""
    rows = [row_of("nothing", way, [found]) for way, found in intact.items()]
    for kind, counts in recovered.items():
        some = [case for name, case in damaged.items() if name.startswith(kind)]
        for way in intact:
            row = row_of(kind, way, [case[way] for case in some])
            rows.append(row | {"of_best": counts["best"][way]})
        rows.append({"kind": kind, "way": "any", "cases": counts["cases"], "of_best": counts["best"]["any"]})
    return rows


def row_of(kind: str, way: str, found: list[Record]) -> Record:
    """What one way reaches in some cases: the slowest, the median and the fastest of them, and by which gaits."""
    speeds = {
        model: [float(x) for x in np.quantile([one[model]["mean"] for one in found], (0, 0.5, 1))]
        for model in ("own", "other")
    }
    names = sorted({one["gait"] for one in found if one["gait"]})
    beyond = sum(not one["within_bounds"] for one in found)
    return {"kind": kind, "way": way, "cases": len(found), "names": names, "beyond_bounds": beyond, **speeds}


@damage.table
def words(record: Record) -> str:
    """What each way reaches on robots of each kind, and how much was tried for it."""
    counts = ("of_best", "beyond_bounds")
    rows = [
        [
            row["kind"],
            ": ".join([row["way"], *row.get("names", [])]),
            *(speeds(row, model) for model in ("own", "other")),
            *(f"{row[name]} of {row['cases']}" if name in row else "" for name in counts),
        ]
        for row in record["rows"]
    ]
    head = ["broken or stuck", "gait", "speed, body lengths/s", "on the other contact model", "recovered"]
    head += ["beyond actuator bounds"]
    about = [record["gaits"]["library"], record["population"], record["generations"], record["gaits"]["free"]]
    settings = table(
        [
            "library gaits tried, turned and mirrored",
            "population",
            "generations",
            "gaits per search",
            "duration",
        ],
        [[*map(str, about), f"{record['duration']:g} s"]],
    )
    return f"{table(head, rows)}\n\n{settings}"


def speeds(row: Record, model: str) -> str:
    """Of the median case, and of the slowest and the fastest where they are not the same to the digits shown."""
    if model not in row:
        return ""
    low, median, high = (f"{speed:.2f}" for speed in row[model])
    return median if low == high else f"{median} ({low} to {high})"


def fastest(case: Ways) -> dict[str, Any]:
    """What is fastest on the own contact model, of all ways; ways beyond the bounds on actuators come last."""
    return max(case.values(), key=lambda one: (one["within_bounds"], one["own"]["mean"]))


def recovered(cases: dict[str, Ways], intact: Ways, kind: str) -> dict[str, Any]:
    """In how many cases each way, and any of them, reaches enough of the intact robot's best on both contact models,
    within the bounds on actuators."""
    top, some = fastest(intact), [case for name, case in cases.items() if name.startswith(kind)]

    def reaches(one: dict[str, Any]) -> bool:
        fast = (one[model]["mean"] >= ENOUGH * top[model]["mean"] for model in ("own", "other"))
        return one["within_bounds"] and all(fast)

    of_best = {way: sum(reaches(case[way]) for case in some) for way in WAYS}
    of_best["any"] = sum(any(reaches(one) for one in case.values()) for case in some)
    return {"cases": len(some), "best": of_best}


@damage.figure()
def figure(record: Record, chart: Figure) -> None:
    """Steady speed of each robot on each of the ways, and what counts as recovered."""
    found = record["speeds"]
    robots, top = found["robots"], found["best"]
    chart.set_figheight(0.5 * len(robots) + 1.6)
    axes = chart.subplots()
    rows = np.arange(len(robots))
    for k, (way, marker) in enumerate(zip(WAYS, plot.MARKERS)):
        speed, spread = (np.array(found[name][way], float) for name in ("mean", "standard_deviation"))
        within = np.array(found["within_bounds"][way])
        look = {"color": f"C{k}", "marker": marker, "linestyle": "", "markersize": 5}
        place = rows + 0.16 * (k - (len(WAYS) - 1) / 2)
        axes.errorbar(speed[within], place[within], xerr=spread[within], **look, lw=0.6, label=way)
        axes.plot(speed[~within], place[~within], **look, markerfacecolor="white")
    axes.plot([], [], "o", color="grey", markerfacecolor="white", label="hollow: beyond actuator bounds")
    axes.axvline(top, color="black", lw=1, label="the intact robot's best")
    axes.axvline(record["enough"] * top, color="C6", lw=1, ls="--", label=f"{record['enough']:.0%} of that")
    for between in rows[1:] - 0.5:
        axes.axhline(between, color="grey", lw=0.8, alpha=1.0 if between == 0.5 else 0.3)
    axes.grid(visible=False, axis="y")
    axes.set_yticks(rows, robots)
    axes.set(ylim=(len(rows) - 0.5, -0.5), xlim=(0, None))
    axes.set_xlabel("steady speed (body lengths/s): mean and standard deviation of perturbed robots")
    chart.legend(ncols=3, loc="outside lower center")
