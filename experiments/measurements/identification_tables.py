"""The tables of docs/identification.md."""

from numerics_tables import chosen
from pages import made_by, table

Facts = dict
CASES = {"rolling": "rolls by its gait", "ten": "rolls, ten unknown", "dropped": "is dropped and slides"}


def identification_facts(raw: Facts) -> Facts:
    kept = ("duration", "windows", "trials", "converged", "seconds", "longest", "parameters")
    cases = {name: chosen(facts, *kept) for name, facts in raw["cases"].items()}
    return chosen(raw, "command", "cores") | {"cases": cases}


def identification_table(facts: Facts) -> str:
    rows = []
    for name, case in facts["cases"].items():
        about = f"{CASES[name]}, {case['duration']:g} s, {case['windows']} window{'s' * (case['windows'] > 1)}"
        converged = f"{case['converged']} of {case['trials']}, {case['seconds']:.0f} s, {case['longest']:.0f} s"
        for each in case["parameters"]:
            told = each["told"]
            cells = [
                f"{each[key]:.2%}" if told else "cannot be told" for key in ("standard_error", "median", "largest")
            ]
            counts = [f"{each[key]} of {case['trials']}" if told else "" for key in ("within_2_percent", "covered")]
            rows.append([about, converged, f"`{each['name']}`", *cells, *counts])
            about = converged = ""
    head = ["the robot", "converged, a fit takes, the longest", "parameter", "standard error", "off by, median", "most"]
    return table([*head, "within 2 %", "inside its interval"], rows) + made_by(facts, "identification")


def sim_to_real_facts(raw: Facts) -> Facts:
    names = ("speed", "mean", "standard_deviation", "by_gradient", "rolling", "explained", "parameters")
    forecasts = {name: chosen(each, *names) for name, each in raw["forecasts"].items()}
    return chosen(raw, "command", "cores", "gait", "robots", "seen", "true") | {"forecasts": forecasts}


def sim_to_real_table(facts: Facts) -> str:
    rows = [
        [
            f"{name} identification",
            f"{each['mean']:.4f} ({each['standard_deviation']:.2g})",
            f"{each['speed']:.4f} ({each['by_gradient']:.2g})",
            f"{each['rolling']:.0%}",
            f"{each['explained']:.0%}",
        ]
        for name, each in facts["forecasts"].items()
    ]
    rows.append(["the robot itself", f"{facts['true']:.4f}", "", "", ""])
    head = [
        "plausible robots",
        f"steady speed of {facts['robots']}, m/s (standard deviation)",
        "of the most probable (by the gradient)",
    ]
    return table([*head, "roll", "of the variance linear"], rows) + made_by(facts, "sim_to_real")


def sim_to_real_shares(facts: Facts) -> str:
    rows = []
    for name, forecast in facts["forecasts"].items():
        about = name
        for each in forecast["parameters"]:
            shares = [f"{each[key]:.0%}" for key in ("gradient_share", "share")]
            rows.append([about, f"`{each['name']}`", f"{each['spread']:.1%}", f"{each['slope']:+.4f}", *shares])
            about = ""
    head = ["identification", "parameter", "not known by", "speed per plausible spread, m/s"]
    last = ["variance that goes once known: by the gradient", "over the robots"]
    return table([*head, *last], rows) + made_by(facts, "sim_to_real")
