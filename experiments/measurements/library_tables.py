"""The tables of README and docs about the default search's gait and the library's."""

import jax
import numpy as np
from measurements.pages import columns, made_by, table, whole_zero

from jaxgrity import Gait, Members, gait_names, gait_record, load_gait, load_scene, with_error
from jaxgrity.model import rest_length

Facts = dict

PEAKS = (("force", 0, " N"), ("rate", 2, " m/s"), ("power", 0, " W"))
"""Peaks of an actuator in a cycle: name, most decimals, and unit."""


def gait_search_facts(raw: Facts) -> Facts:
    """The gait, what it is worth, and how it was found."""
    return {
        **{name: raw[name] for name in ("command", "wall_seconds", "stage_seconds")},
        "steady": raw["steady"],
        "rollouts": sum(search["rollouts"] for search in raw["searches"]),
        "polish": raw["polish"]["reason"],
        "actuators": {name: raw["actuators"][name] for name in ("peak_force", "peak_rate", "peak_power")},
        "slip_share": raw["motion"]["slip_share"],
    }


def gait_search_table(facts: Facts) -> str:
    """The most important numbers, of which all stand in docs/search_records.md."""
    steady, size = facts["steady"], facts["steady"]["body_length"]
    exact, penalty = (_of_robots(mean / size, robots, size) for mean, robots in _ensembles(steady))
    rows = [
        ["steady speed", f"**{_speed(steady)} body lengths/s**, after {steady['settled_after']:.0f} s"],
        ["128 perturbed robots, exact contact", f"{exact} body lengths/s"],
        ["128 perturbed robots, penalty contact", f"{penalty} body lengths/s"],
        ["largest force, speed and power of a motor in a cycle", _peaks(steady["cycle"])],
        ["the same, from the start of the gait on", _peaks(facts["actuators"])],
    ]  # fmt: skip
    return table(["the gait that `make gait` finds", "measured"], rows) + made_by(facts, "gait_search", "README.md")


def full_gait_search_table(facts: Facts) -> str:
    """The numbers about the gait and its search."""
    steady, size = facts["steady"], facts["steady"]["body_length"]
    stages = ", ".join(f"{name} {s:.0f} s" for name, s in facts["stage_seconds"].items())
    shares = [
        f"{_of_robots(mean / size, robots, size)} body lengths/s: {mean / steady['speed']:.0%} of the steady speed"
        for mean, robots in _ensembles(steady)
    ]
    turning = with_error(np.degrees(steady["turning"]), np.degrees(steady["turning_error_bar"]), " °/s", decimals=2)
    rows = [
        ["steady speed", f"**{_speed(steady)} body lengths/s**"],
        ["settles after", f"{steady['settled_after']:.0f} s"],
        ["stays on the orbit: watched for", f"{steady['verified_for']:.0f} s"],
        ["turning rate", turning],
        ["cycle", f"{steady['periods']} periods, {steady['period']:.2f} s each"],
        ["largest Floquet multiplier per cycle (translation and yaw excluded)", _multiplier(steady)],
        [f"{steady['robust']['robots']} perturbed robots over a minute, mean (standard deviation)", shares[0]],
        ["the same on the other contact model", shares[1]],
        ["largest force, speed and power of a motor in a cycle", _peaks(steady["cycle"])],
        ["the same, from the start of the gait on", _peaks(facts["actuators"])],
        ["cost of transport", _with_bar(steady["cycle"], "cost_of_transport", 2)],
        ["share of contact time spent slipping", f"{100 * facts['slip_share']:.0f} %"],
        ["rollouts of the evolution (polish comes on top)", f"{facts['rollouts']}"],
        ["polish", facts["polish"]],
        ["wall time", f"{facts['wall_seconds']:.0f} s: {stages}"],
    ]
    return table(["the gait that `make gait` finds", "measured"], rows) + made_by(facts, "gait_search")


def _ensembles(steady: Facts) -> list[tuple[float, Facts]]:
    """Mean speed, m/s, and all that is known, of perturbed robots on the gait's contact model and on the other."""
    along = steady.get("along_heading")
    if along is not None:
        return [(along[name]["mean"], along[name]) for name in ("robust", "other_contact_model")]
    robust, other = steady["robust"], steady["other_contact_model"]
    return [(robust["mean"], robust), (other["speed"], other)]


def _of_robots(mean: float, robots: Facts, size: float) -> str:
    """Mean and standard deviation of speeds, body lengths/s."""
    return f"{mean:.3f} ({robots['standard_deviation'] / size:.2g})"


def _repeats(steady: Facts) -> int:
    return round(steady["period"] * steady["periods"] / steady["repetition"]["time"])


def _with_bar(cycle: Facts, name: str, decimals: int) -> str:
    """A number of a cycle and its error bar."""
    return with_error(cycle[name], cycle["error_bars"][name], decimals=decimals)


def _speed(steady: Facts) -> str:
    """Of the orbit, body lengths/s."""
    size = steady["body_length"]
    return with_error(steady["speed"] / size, steady["speed_error_bar"] / size, decimals=3)


def _multiplier(steady: Facts) -> str:
    return with_error(steady["multiplier"], steady["multiplier_error_bar"])


NOT_FIRST = "fast", "lasting", "steep"
"""Gaits that README leaves out: one that is kept because other pages measure it, and the second for slopes."""


def gaits_table(names: tuple[str, ...] = gait_names()) -> str:
    """The most important numbers of gaits that come with the library, from their records in the package."""
    head = [
        "gait", "motion, largest stroke", "speed, body lengths/s", "turning, °/body length", "settles after, s",
        "peak power, W", "128 perturbed robots, body lengths/s",
    ]  # fmt: skip
    rows = []
    # those that roll first, the fastest of each kind first
    order = lambda name: (gait_record(name)["motion"]["kind"] != "rolls", -gait_record(name)["steady"]["speed"])  # noqa: E731
    for name in sorted(names, key=order):
        record, gait = gait_record(name), load_gait(name)
        steady, size = record["steady"], record["steady"]["body_length"]
        mean, robots = _ensembles(steady)[0]
        along = steady.get("along_heading")
        scene = load_scene(record["scene"])
        slope = np.degrees(scene.ground.incline)
        first = scene.structure.first_cable
        moved, count = ("struts", 0) if gait.members[0] < first else ("cables", first)
        stroke = _stroke(gait, getattr(scene.structure, moved), count)
        rows.append([
            f"`{name}`", f"{record['motion']['kind']}; {moved}, {100 * stroke:.0f} %",
            _speed(steady) if along is None else f"{along['speed'] / size:.2f} (up {slope:.0f}°, as on a map)",
            "-" if along is not None else _bend(steady), f"{steady['settled_after']:.0f}",
            _with_bar(steady["cycle"], "peak_power", 0), _of_robots(mean / size, robots, size),
        ])  # fmt: skip
    return table(head, rows)


def _stroke(gait: Gait, members: Members, first: int) -> float:
    """By which share of its length the member that moves most is shortened at most."""
    times = float(gait.start + gait.ramp) + np.arange(200) / 200 / float(np.min(gait.frequency))
    lengths = jax.vmap(lambda t: rest_length(members, gait, t, first))(times)
    return float(np.max(1 - np.asarray(lengths) / members.rest_length))


def full_gaits_tables() -> dict[str, str]:
    """All numbers about the library's gaits, by the marks of the tables: orbits, perturbed robots, and cycles."""
    told = [_facts_of(name) for name in gait_names()]
    tables = {"library/orbits": ORBIT, "library/robots": ROBOTS, "library/cycles": CYCLE}
    return {mark: columns(told, {"gait": "`{gait}`"} | cells) for mark, cells in tables.items()}


ORBIT = {
    "steady speed, body lengths/s": "{speed}",
    "turning, °/body length": "{turning}",
    "settles after, s": "{settled_after:.0f}",
    "slowest 10 s, % of the speed": "{slowest:.0f}",
    "Floquet multiplier": "{multiplier}",
    "slipping, % of contact time": "{slipping:.0f}",
}
"""What the first table says of a gait: the head of each column, and a format of what is known of the gait."""
ROBOTS = {
    "speed, body lengths/s": "{own[0]}",
    "standard deviation": "{own[1]}",
    "turning, °/body length": "{own[2]}",
    "other contact model: speed": "{twin[0]}",
    "its standard deviation": "{twin[1]}",
    "its turning": "{twin[2]}",
}
"""The second table."""
CYCLE = {
    "faces per cycle": "{faces}",
    "symmetry-equivalent segments": "{segments}",
    **{f"peak {kind}, {unit.strip()}": f"{{peak_{kind}}}" for kind, _, unit in PEAKS},
    "cost of transport": "{transport}",
}
"""The third table."""


def _facts_of(name: str) -> Facts:
    record = gait_record(name)
    steady, size = record["steady"], record["steady"]["body_length"]
    cycle, along = steady["cycle"], steady.get("along_heading")
    ensembles = zip(_ensembles(steady), (steady["robust"], steady["other_contact_model"]))
    own, twin = (
        (
            f"{mean / size:.3f}",
            f"{robots['standard_deviation'] / size:.2g}",
            f"{whole_zero(round(np.degrees(path['bend']))):.0f}",
        )
        for (mean, robots), path in ensembles
    )
    return {
        "gait": name,
        "speed": _speed(steady) + ("" if along is None else f", {along['speed'] / size:.3f} uphill"),
        "turning": _bend(steady) if along is None else "-",
        "settled_after": steady["settled_after"],
        "slowest": 100 * steady["slowest_window"] / steady["speed"],
        "multiplier": _multiplier(steady),
        "own": own,
        "twin": twin,
        "slipping": 100 * record["motion"]["slip_share"],
        "faces": len(cycle["supports"]),
        "segments": _repeats(steady),
        **{f"peak_{kind}": _with_bar(cycle, f"peak_{kind}", decimals) for kind, decimals, _ in PEAKS},
        "transport": _with_bar(cycle, "cost_of_transport", 1),
    }


def _bend(steady: Facts) -> str:
    """Turning of the path, degrees in a body length of way."""
    each_length = np.degrees(steady["body_length"] / steady["speed"])
    return with_error(each_length * steady["turning"], each_length * steady["turning_error_bar"], decimals=1)


def gait_commands() -> str:
    """The commands that found the library's gaits."""
    return "\n".join(f"    # {name}\n    {gait_record(name)['command']}" for name in gait_names())


def _peaks(asked: Facts) -> str:
    return f"{asked['peak_force']:.0f} N, {asked['peak_rate']:.2f} m/s, {asked['peak_power']:.0f} W"
