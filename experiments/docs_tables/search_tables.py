"""What README and docs say about the gait search, in words and tables, from the facts that the scripts left."""

import numpy as np
from speed_words import made_by, table

from jaxgrity import gait_names, gait_record
from jaxgrity.search.objectives import UNITS


def gait_search(facts: dict) -> str:
    robust, polish, asked = facts["robust"], facts["polish"], facts["actuators"]
    rollouts = sum(search["rollouts"] for search in facts["searches"])
    gain = f"from {polish['before']:.3f} to {polish['after']:.3f} m" if polish["improved"] else "found nothing better"
    ranks = facts["ladder"]
    rough, own = (
        f"{every[-1]:.2f} ({among[-1]:.2f} among the evolved ones)"
        for every, among in zip(ranks["rank_correlation"], ranks["rank_correlation_of_the_evolved"][:2])
    )
    return (
        f"`make gait` ({facts['wall_seconds']:.0f} s on 2 cores; `experiments/gait_search.py`) found a gait that "
        f"travels **{facts['distance']:.3f} ± {facts['error_bar']:.1g} m** in {facts['duration']:g} s; robots whose "
        f"phases are off by up to 0.03 rad travel {robust['mean']:.3f} m in the mean, with a standard deviation of "
        f"{robust['standard_deviation']:.2g} m, and on the other contact model "
        f"{facts['other_contact_model']['mean']:.2f} ± {facts['other_contact_model']['standard_deviation']:.2g} m. "
        f"{rollouts} rollouts for the search and {polish['rollouts']} "
        f"for polishing, which {'brought the mean ' if polish['improved'] else ''}{gain}. Screening ranks gaits as "
        f"verification does with a rank correlation of {rough}, the scene's own model with {own}. The gait asks for up"
        f" to {asked['peak_force']:.0f} N, {asked['peak_rate']:.2f} m/s and {asked['peak_power']:.0f} W of an "
        "actuator ([docs/measured/gait_search.json](docs/measured/gait_search.json))."
    )


def rivals(name: str):
    def words(facts: dict) -> str:
        rows = []
        for method, found in facts["methods"].items():
            low, high = found["robust"]["quartiles"]
            mine = [run for run in facts["runs"] if run["method"] == method]
            bars = [run["error_bar"] / run["distance"] for run in mine if run["error_bar"] is not None]
            small = sum(bar < 0.03 for bar in bars)
            beats = [found["beats"].get(other) for other in ("GA+more", "GA", "CMA-ES")]
            polished = [one["improved"] for run in mine for one in run.get("polish", [])]
            rows.append(
                [
                    method,
                    f"{found['robust']['median']:.3f}",
                    f"{low:.3f} to {high:.3f}",
                    f"{found['distance']:.3f}",
                    f"{small} of {len(mine)}",
                    "-" if found["ratio_to_random"] is None else f"{found['ratio_to_random']:.2f}",
                    *("-" if count is None else f"{count[0]} of {count[1]}" for count in beats),
                    f"{sum(polished)} of {len(polished)}" if polished else "-",
                ]
            )
        head = [
            "search",
            "robust distance, m: median",
            "quartiles",
            "nominal, m",
            "error bar < 3%",
            "to random",
            "beats GA+more",
            "beats GA",
            "beats CMA-ES",
            "polish kept",
        ]
        share = facts["settings"]["shares"][1]
        said = f"{verdict(facts['methods'])} Polish had {share:.0%} of the rollouts."
        return f"{said}\n\n{table(head, rows)}{made_by(facts, f'rivals_{name}')}"

    return words


def verdict(methods: dict) -> str:
    """Who came first, what polish was good for, and how far ahead of random search anyone is."""
    order = sorted(methods, key=lambda name: -methods[name]["robust"]["median"])
    places = ", then ".join(f"{name} ({methods[name]['robust']['median']:.3f} m)" for name in order[:3])
    said = f"By the median, {places} went furthest."
    if "GA+smoothed" in methods:
        beats, others = methods["GA+smoothed"]["beats"], ("GA+more", "GA", "CMA-ES")
        told = [f"{name} on {beats[name][0]} of {beats[name][1]} seeds" for name in others if name in beats]
        said += f" Polish by smoothed gradients beat {', '.join(told)}." if told else ""
    best = methods[order[0]]["ratio_to_random"]
    return said if best is None else f"{said} The best median is {best:.2f} times random search's."


def damage(facts: dict) -> str:
    rows, still = [], []
    for name, kinds in facts["recovered"].items():
        goes = facts["intact"][name]["robust"]
        for kind, counts in kinds.items():
            total, tests = counts["cases"], counts["reached"].values()
            each = [f"{sure} of {total}" + (f" ({far})" if far > sure else "") for sure, far in tests]
            rows.append([f"{facts['enough']:.0%} of {name}'s {goes:.2f} m", kind, *each])
            cases = [case["as it was"][name]["robust"] for label, case in facts["cases"].items() if kind in label]
            left = [0.0 if far is None else far for far in cases]
            still.append([name, f"{goes:.2f} m", kind, *(f"{f(left):.2f} m" for f in (np.median, min, max))])
    ways = next(iter(next(iter(facts["recovered"].values())).values()))["reached"]
    cost, free = facts["rollouts"], facts["free"]
    return (
        "How far each gait of the library that moves these struts still goes as it was, in the mean of an ensemble (0 "
        "where a robot failed):\n\n"
        + table(["gait", "intact", "broken or stuck", "median", "least", "most"], still)
        + f"\n\nCases in which at least {facts['enough']:.0%} of an intact gait's robust distance is reached: by that "
        f"gait as it was, by the best of the library and its images ({cost['library']} rollouts), by polishing "
        f"that one ({cost['gradient']}), by a search from scratch ({cost['scratch']}; amplitudes "
        f"{free['amplitude'][0]:g} to {free['amplitude'][1]:g} and frequency {free['frequency'][0]:g} to "
        f"{free['frequency'][1]:g} Hz, where polish keeps those of its gait), and by any. The searches are the same "
        "for all rows; what they are held against differs. A case counts where the robust distance is enough, and the "
        "distance of the nominal gait less its error bar too; in brackets, the cases where the first is.\n\n"
        + table(["to be reached", "broken or stuck", *ways], rows)
        + made_by(facts, "damage")
    )


def kills(facts: dict) -> str:
    every = facts["kills"]
    same = sum(kill["same_population"] for kill in every)
    broken = sum(len(kill["broken_files"]) for kill in every)
    between = sum(0 < sum(kill["generations_saved"]) < 20 for kill in every)
    return (
        f"{len(every)} searches, {facts['undisturbed_seconds']:.0f} s long to their last generation, were killed "
        "(SIGKILL) at random moments, "
        f"{between} of them between their first and their last generation, and resumed: {same} ended with the very "
        f"same population, and {broken} files were broken." + made_by(facts, "kills")
    )


def library() -> str:
    """The gaits that come with the library, from their records in the package, and the commands that found them."""
    commands = "\n".join(f"    # {name}\n    {gait_record(name)['command']}" for name in gait_names())
    return f"{gaits_table()}\n\nEach is what its command leaves:\n\n{commands}"


def gaits_table() -> str:
    """The gaits that come with the library."""
    rows = []
    for name in gait_names():
        record = gait_record(name)
        robust, other, asked = record["robust"], record["other_contact_model"], record["actuators"]
        # a search maximises, so a cost counts below zero there
        sign, unit = (
            (-1, "W/(m g d)") if record["objective"] == "cost of transport" else (1, UNITS[record["objective"]])
        )
        rows.append(
            [
                f"`{name}`",
                record["scene"],
                f"{record['distance']:.3f} ± {record['error_bar']:.1g} m in {record['duration']:g} s",
                f"{sign * robust['mean']:.3f} ± {robust['standard_deviation']:.2g} {unit}".strip(),
                f"{sign * other['mean']:.3f} ± {other['standard_deviation']:.2g}",
                f"{record['motion']['kind']}, {record['motion']['rolls']} changes of support",
                f"{asked['peak_force']:.0f} N, {asked['peak_rate']:.2f} m/s, {asked['peak_power']:.0f} W",
            ]
        )
    head = ["gait", "scene", "verified", "robust", "other contact model", "motion", "peak of an actuator"]
    return (
        table(head, rows)
        + "\n\n± of what is verified is the error bar of the time step; of the others it is the standard "
        "deviation over robots that differ from the model, in the unit of the robust column. Cost of transport, "
        "W/(m g d), is better the lower it is."
    )
