"""The tables about speed, of README, docs/performance.md and docs/scaling.md: what they quote, and how they say it."""

from pages import made_by, table

Facts = dict

STEPS = {"rk4": 5e-4, "complementarity": 5e-3}
"""s, at which the benchmark's methods are quoted"""

SEARCHED = 256
"""gaits, of the sizes between the smallest and the largest the one that is quoted too"""


def benchmark_facts(raw: Facts) -> Facts:
    costs = [
        {key: point[key] for key in ("engine", "dtype", "dt", "seconds")}
        | {"over_C": raw["ratios_to_C"].get(f"{point['engine']} {point['dtype']} {point['dt']:g}")}
        for point in raw["points"]
        if STEPS.get(point["engine"]) == point["dt"]
    ]
    kept = ("command", "cores", "gaits", "duration", "repeats", "C_sweeps", "largest_difference_from_C")
    return {
        **{name: raw[name] for name in kept},
        "costs": costs,
        "numpy_seconds": raw["numpy"]["seconds"],
        "gradient": {name: raw["gradient"][name] for name in ("phases", "reverse", "forward")},
        "rollouts_per_second": [
            {"error": float(target), "rates": rates} for target, rates in raw["rollouts_per_second"].items()
        ],
    }


def benchmark_table(facts: Facts) -> str:
    return "\n\n".join([_costs(facts), _rates(facts), _about(facts)]) + made_by(facts, "benchmark", "README.md")


def _costs(facts: Facts) -> str:
    """Of one gait, each method in both precisions."""
    said = {"rk4": "RK4", "complementarity": "complementarity stepping"}
    rows = []
    for engine in dict.fromkeys(cost["engine"] for cost in facts["costs"]):
        mine = [cost for cost in facts["costs"] if cost["engine"] == engine]
        over = [cost["over_C"] for cost in mine]
        times = "-" if None in over else " and ".join(f"{ratio:.1f}" for ratio in over)
        step = f"{1e3 * mine[0]['dt']:g} ms"
        rows.append([f"{said[engine]}, {step}", *(f"{1e6 * cost['seconds']:.0f} us" for cost in mine), times])
    rows.append(["a NumPy loop, RK4, 0.5 ms", "-", f"{facts['numpy_seconds']:.1f} s", "-"])
    return table(["a simulated second of one gait", "float32", "float64", "times hand-written SIMD C"], rows)


def _rates(facts: Facts) -> str:
    """Rollouts a second of each engine, at its cheapest step with an error below each of the bounds."""
    written = {"limit": "hand-written C, RK4", "exact": "hand-written C, exact contact"}
    bounds = facts["rollouts_per_second"]
    names = dict.fromkeys(name for bound in bounds for name in bound["rates"])
    rows = [
        [written.get(name, name), *(f"{b['rates'][name]:.0f}" if name in b["rates"] else "-" for b in bounds)]
        for name in names
    ]
    return table(["engine", *(f"rollouts a second at {1e3 * b['error']:g} mm" for b in bounds)], rows)


def _about(facts: Facts) -> str:
    """What was measured, and what else came out."""
    off, gradient = facts["largest_difference_from_C"], facts["gradient"]
    rows = [
        ["population", f"{facts['gaits']} gaits of {facts['duration']:g} s on {facts['cores']} cores"],
        ["rounds, of which the median counts", str(facts["repeats"])],
        ["sweeps in a step of hand-written C", str(facts["C_sweeps"])],
        ["centres of mass, RK4 against hand-written C", "-" if off is None else f"within {off:.0e} m"],
        [f"gradient in {gradient['phases']} phases, reverse mode", f"{gradient['reverse']:.1f} rollouts"],
        [f"gradient in {gradient['phases']} phases, forward mode", f"{gradient['forward']:.1f} rollouts"],
    ]
    return table(["about these numbers", "measured"], rows)


def scaling_facts(raw: Facts) -> Facts:
    rows = []
    for method, exponent in raw["exponents"].items():
        mine = {name: [row for row in raw[name] if row["method"] == method] for name in ("devices", "population")}
        one, several = mine["devices"]
        struts = [row for row in raw["struts"] if row["method"] == method]
        sizes = mine["population"]
        told = {row["gaits"]: row for row in (sizes[0], *(row for row in sizes if row["gaits"] == SEARCHED), sizes[-1])}
        rows.append(
            {
                "method": method,
                "devices": several["devices"],
                "gaits": several["gaits"],
                "speed_up": one["seconds"] / several["seconds"],
                "populations": list(told),
                "per_gait_and_simulated_second": [row["per_gait_and_simulated_second"] for row in told.values()],
                "struts": [struts[0]["struts"], struts[-1]["struts"]],
                "per_gait_and_step": [struts[0]["per_gait_and_step"], struts[-1]["per_gait_and_step"]],
                "exponent": exponent,
                "times_real_time": [row["times_real_time"] for row in raw["single"] if row["method"] == method],
                "in_C": _in_c(raw, method, list(told)) if raw["C"] else None,
            }
        )
    compiled = [{"method": row["method"], "loops": row["loops"]} for row in raw["compiled"]]
    return {
        "command": raw["command"],
        "cores": raw["cores"],
        "methods": rows,
        "compiled": compiled,
        "start": raw["start"],
    }


def _in_c(raw: Facts, method: str, sizes: list[int]) -> Facts:
    """Of the C program that does the same as a method: its speed-up, and its cost in populations of the sizes."""
    mine = [row for row in raw["C"] if row["method"] == method]
    cost = {(row["devices"], row["gaits"]): row["per_gait_and_simulated_second"] for row in mine}
    several = max(threads for threads, _ in cost)
    shared = next(gaits for threads, gaits in cost if threads == 1)
    return {
        "speed_up": cost[1, shared] / cost[several, shared],
        "per_gait_and_simulated_second": [cost[several, size] for size in sizes],
    }


def microseconds(seconds: float) -> str:
    return f"{1e6 * seconds:.0f} us"


def scaling_table(facts: Facts) -> str:
    rows = [
        [
            row["method"],
            f"{row['speed_up']:.2f} times as fast as one",
            ", ".join(microseconds(cost) for cost in row["per_gait_and_simulated_second"]),
            f"{1e6 * row['per_gait_and_step'][0]:.2f} and {1e6 * row['per_gait_and_step'][1]:.0f} us",
            f"{row['exponent']:.2f}",
            " and ".join(f"{times:.0f}" for times in row["times_real_time"]),
        ]
        for row in facts["methods"]
    ]
    in_c = [row for row in facts["methods"] if row["in_C"]]
    rows += [
        [
            f"hand-written C, as {row['method']}",
            f"{row['in_C']['speed_up']:.2f} times",
            ", ".join(microseconds(cost) for cost in row["in_C"]["per_gait_and_simulated_second"]),
            *3 * ["-"],
        ]
        for row in in_c
    ]
    first = facts["methods"][0]
    populations, struts = (", ".join(str(size) for size in first[name]) for name in ("populations", "struts"))
    head = [
        "method",
        f"{first['devices']} devices, {first['gaits']} gaits",
        f"{populations} gaits, a gait and simulated second",
        f"{struts} struts, a step",
        "cost ~ struts^",
        "one rollout, float32 and float64: times real time",
    ]
    return table(head, rows) + made_by(facts, "scaling")


def million_table(facts: Facts) -> str:
    """What a search of 10^6 gaits costs, by arithmetic on the largest population."""
    rows = []
    for row in facts["methods"]:
        cost = row["per_gait_and_simulated_second"][-1]
        rows.append([row["method"], microseconds(cost), f"{1e6 * 10 * cost / 60:.0f} minutes"])
    head = ["method", "a gait and simulated second, float32", f"10^6 rollouts of 10 s on {facts['cores']} cores"]
    return table(head, rows) + made_by(facts, "scaling")


def compiled_table(facts: Facts) -> str:
    rows = []
    for found in facts["compiled"]:
        counts = [", ".join(f"{n} {kind}" for kind, n in loop["instructions"].items()) for loop in found["loops"]]
        rows.append([found["method"], "; ".join(counts), "; ".join(str(loop["roots"]) for loop in found["loops"])])
    head = ["method", "instructions in the body of each loop, innermost first", "roots in one pass, of one gait"]
    return table(head, rows) + made_by(facts, "scaling")


def start_table(facts: Facts) -> str:
    start = facts["start"]
    rows = [
        ["importing JAX and diffrax", f"{start['jax and diffrax']:.2f} s"],
        ["importing jaxgrity, with JAX and diffrax", f"{start['jaxgrity']:.2f} s"],
        [
            "a script that loads, describes and simulates a scene: its first steps, with what an earlier run compiled",
            f"{start['first steps']:.1f} s",
        ],
        [
            "the same with nothing compiled before",
            f"{start['first steps, cold']:.1f} s",
        ],
    ]
    return table(["from the start of the process", "wall time"], rows) + made_by(facts, "scaling")


def gradients_facts(raw: Facts) -> Facts:
    rows = [{key: row[key] for key in ("mode", "gaits", "parameters", "rollouts")} for row in raw["rows"]]
    long = [{key: row[key] for key in ("gaits", "parameters", "method", "horizon", "rollouts")} for row in raw["long"]]
    kept = ("command", "cores", "short", "lengths", "memory")
    return {name: raw[name] for name in kept} | {"rows": rows, "long": long}


def gradients_table(facts: Facts) -> str:
    cases = list(dict.fromkeys((row["gaits"], row["parameters"]) for row in facts["rows"]))
    modes = list(dict.fromkeys(row["mode"] for row in facts["rows"]))
    cost = {(row["mode"], row["gaits"], row["parameters"]): row["rollouts"] for row in facts["rows"]}
    rows = [[mode, *(f"{cost[mode, *case]:.1f}" for case in cases)] for mode in modes]
    gaits = [f"{g} gait{'s' if g > 1 else ''}, {p} parameters" for g, p in cases]
    head = [f"time in rollouts of {facts['short']:g} s", *gaits]
    first = facts["long"][0]
    long_head = [
        f"checkpointed reverse, {first['gaits']} gaits, {first['horizon']:g} s",
        *(f"{row['parameters']} parameters, {row['method']}" for row in facts["long"]),
    ]
    long = ["time in rollouts", *(f"{row['rollouts']:.1f}" for row in facts["long"])]
    memory = [[name, *(f"{x / 2**20:.1f} MiB" for x in found)] for name, found in facts["memory"].items()]
    memory_head = ["memory beside the state", *(f"{t:g} s" for t in facts["lengths"])]
    tables = table(head, rows), table(long_head, [long]), table(memory_head, memory)
    return "\n\n".join(tables) + made_by(facts, "gradients")


WAITED = ("first_word", "seconds", "cpu", "tracing", "compiling", "programs")
"""what the table of the first commands has of each"""


def first_commands_facts(raw: Facts) -> Facts:
    kept = ("name", "state", *WAITED)
    rows = {key: [{name: row[name] for name in kept} for row in raw[key] or []] for key in ("commands", "before")}
    return {"command": raw["command"], "cores": raw["cores"], **rows}


def first_commands_table(facts: Facts) -> str:
    """Each command cold and warm; where an earlier version was measured too, its numbers come first."""
    head = ["command", "first word (s)", "to the end (s)", "processor (s)", "tracing (s)", "compiling (s)", "programs"]
    rows = []
    before = {(row["name"], row["state"]): row for row in facts["before"]}
    for now in facts["commands"]:
        earlier = before.get((now["name"], now["state"]))
        row = [f"{now['name']}, {now['state']}"]
        for column in WAITED:
            was = "" if earlier is None else f"{_to_read(earlier[column])} → "
            row.append(was + _to_read(now[column]))
        rows.append(row)
    return table(head, rows) + made_by(facts, "first_commands")


def _to_read(number: float) -> str:
    return f"{number:.0f}" if number >= 10 or number == int(number) else f"{number:.1f}"
