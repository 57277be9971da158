"""Every published or foreign answer that is known, beside ours: closed forms, other programs, MuJoCo if installed."""

from dataclasses import dataclass
from itertools import chain
from pathlib import Path

from jaxgrity.cli.script import measured, run

from conformance_dynamics import dynamics_cases
from conformance_statics import Case, statics_cases

from jaxgrity.io.files import save_json


@dataclass
class Settings:
    out: Path = Path("results/conformance")
    """folder for conformance.json"""
    quick: bool = False
    """fewer of each kind, at coarser steps"""


def main(settings: Settings) -> None:
    """Compare, and leave the table as JSON."""
    rows = []
    for case in chain(statics_cases(settings.quick), dynamics_cases(settings.quick)):
        print(line(case), flush=True)
        rows.append({**case._asdict(), "difference": case.ours - case.theirs})
    save_json(settings.out / "conformance.json", {**measured(), "rows": rows})
    print(f"wrote {settings.out}/conformance.json")


def line(case: Case) -> str:
    """A case in words."""
    unit = f" {case.unit}" if case.unit else ""
    return f"{case.case}: {case.theirs:.8g}{unit} by {case.source}, {case.ours:.8g} here, {case.ours - case.theirs:.1e}"


if __name__ == "__main__":
    run(main, Settings)
