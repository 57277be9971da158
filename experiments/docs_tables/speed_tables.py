"""What README and docs say about speed, in words and tables, from the facts that the scripts left."""


def table(head: list[str], rows: list[list[str]]) -> str:
    """A Markdown table."""
    assert all(len(row) == len(head) for row in rows), "a cell for each head"
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def made_by(facts: dict, name: str) -> str:
    """The command beside the numbers."""
    return f"\n\n`{facts['command']}`, [measured/{name}.json](measured/{name}.json)."


def benchmark(facts: dict) -> str:
    cost = {(p["engine"], p["dtype"], p["dt"]): 1e6 * p["seconds"] for p in facts["points"]}
    gradient, rates, ratios = facts["gradient"], facts["rollouts_per_second"], facts["ratios_to_C"]

    def said(engine: str, dt: float) -> tuple[str, str]:
        one, two = (cost[engine, dtype, dt] for dtype in ("float32", "float64"))
        times = " and ".join(f"{ratios[f'{engine} {dtype} {dt:g}']:.1f}" for dtype in ("float32", "float64"))
        return f"{one:.0f} us in float32 and {two:.0f} us in float64", f"{times} times"

    (rk4, rk4_times), (exact, exact_times) = said("rk4", 5e-4), said("complementarity", 5e-3)
    names = dict.fromkeys(name for found in rates.values() for name in found)
    written = {"limit": "hand-written C, RK4", "exact": "hand-written C, exact contact"}
    rows = [
        [written.get(name, name), *(f"{found[name]:.0f}" if name in found else "-" for found in rates.values())]
        for name in names
    ]
    head = ["engine", *(f"rollouts a second at {1e3 * float(target):g} mm" for target in rates)]
    return (
        f"A simulated second of one gait of the reference scene takes {rk4} by RK4 at 0.5 ms ({rk4_times} as long as "
        f"hand-written SIMD C, with which centres of mass agree to {facts['largest_difference_from_C']:.0e} m), and "
        f"{exact} by complementarity stepping at 5 ms ({exact_times} as long as C with {facts['C_sweeps']} sweeps); a "
        f"NumPy loop takes {facts['numpy']['seconds']:.1f} s. {facts['gaits']} gaits of {facts['duration']:g} s, "
        f"{facts['cores']} cores, median of {facts['repeats']}. The gradient in {gradient['phases']} phases costs "
        f"{gradient['reverse']:.1f} rollouts by reverse mode that computes stages again, {gradient['forward']:.1f} by "
        f"forward mode; pathwise polish uses the first.\n\n{table(head, rows)}\n\n"
        f"Rollouts of {facts['duration']:g} s, at the cheapest step whose error (median, against the engine's own "
        f"converged answer) is within the bound. MJX, where it is there, has one core. `{facts['command']}`, "
        "[docs/measured/benchmark.json](docs/measured/benchmark.json)."
    )


def microseconds(row: dict) -> str:
    return f"{1e6 * row['per_gait_and_simulated_second']:.0f} us"


def scaling(facts: dict) -> str:
    methods = list(facts["exponents"])
    kinds = ("devices", "population", "struts", "single")
    by_method = {name: {m: [r for r in facts[name] if r["method"] == m] for m in methods} for name in kinds}
    rows = []
    for m in methods:
        one, several = by_method["devices"][m]
        gain = one["seconds"] / several["seconds"]
        smallest, largest = by_method["population"][m][0], by_method["population"][m][-1]
        towers = by_method["struts"][m]
        rows.append(
            [
                m,
                f"{gain:.2f} times as fast as one",
                f"{microseconds(smallest)} and {microseconds(largest)}",
                f"{1e6 * towers[0]['per_gait_and_step']:.2f} and {1e6 * towers[-1]['per_gait_and_step']:.0f} us",
                f"{facts['exponents'][m]:.2f}",
                " and ".join(f"{row['times_real_time']:.0f}" for row in by_method["single"][m]),
            ]
        )
    populations, sizes = (
        [row[key] for row in by_method[n][m]] for n, key in (("population", "gaits"), ("struts",) * 2)
    )
    head = [
        "method",
        f"{several['devices']} devices, {several['gaits']} gaits",
        f"{populations[0]} and {populations[-1]} gaits, a gait and simulated second",
        f"{sizes[0]} and {sizes[-1]} struts, a step",
        "cost ~ struts^",
        "one rollout, float32 and float64: times real time",
    ]
    return table(head, rows) + made_by(facts, "scaling")


def million(facts: dict) -> str:
    """What a search of 10^6 gaits costs, by arithmetic on the largest population."""
    found = []
    for m in facts["exponents"]:
        row = [r for r in facts["population"] if r["method"] == m][-1]
        hours = 1e6 * 10 * row["per_gait_and_simulated_second"] / 3600
        found.append(f"{hours:.1f} hours by {m} (10 s x {microseconds(row)})")
    return f"10^6 rollouts of 10 s in float32 take {' or '.join(found)} on {facts['cores']} cores." + made_by(
        facts, "scaling"
    )


def compiled(facts: dict) -> str:
    rows = []
    for found in facts["compiled"]:
        loops = "; ".join(", ".join(f"{n} {kind}" for kind, n in loop.items()) for loop in found["loops"])
        rows.append([found["method"], loops])
    return table(["method", "instructions in the body of each loop, innermost first"], rows) + made_by(facts, "scaling")


def start_up(facts: dict) -> str:
    start = facts["start"]
    return (
        f"`import jaxgrity` takes {start['import jaxgrity']:.2f} s, of which `import jax, diffrax` "
        f"take {start['import jax, diffrax']:.2f} s; a script that loads, describes and rolls out a "
        f"scene takes its first steps after {start['first steps']:.1f} s, when it has run before."
        + made_by(facts, "scaling")
    )


def gradients(facts: dict) -> str:
    cases = list(dict.fromkeys((row["gaits"], row["parameters"]) for row in facts["rows"]))
    modes = list(dict.fromkeys(row["mode"] for row in facts["rows"]))
    cost = {(row["mode"], row["gaits"], row["parameters"]): row["rollouts"] for row in facts["rows"]}
    rows = [[mode, *(f"{cost[mode, *case]:.1f}" for case in cases)] for mode in modes]
    head = ["time in rollouts", *(f"{g} gait{'s' if g > 1 else ''}, {p} parameters" for g, p in cases)]
    memory = [[name, *(f"{x / 2**20:.1f} MiB" for x in found)] for name, found in facts["memory"].items()]
    long = ", ".join(f"{row['rollouts']:.1f} for {row['parameters']} parameters" for row in facts["long"])
    first = facts["long"][0]
    return (
        f"{table(head, rows)}\n\nOver {facts['short']:g} s. Over {first['horizon']:g} s and {first['gaits']} gaits the "
        f"checkpointed reverse mode takes, in rollouts: {long}.\n\n"
        f"{table(['memory beside the state', *(f'{t:g} s' for t in facts['lengths'])], memory)}"
        + made_by(facts, "gradients")
    )
