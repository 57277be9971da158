"""Run a measurement, a study or a script of the docs by its name, with its own options.

python experiments/run.py                 what there is, a line each
python experiments/run.py basin --help    what one of them does, and its options
"""

import difflib
import sys

from jaxgrity.cli.script import run

from measurements.registry import loaded, measured, scripts, sentence


def main() -> None:
    """The first word names what to run; `--measured` lists what `make measure` runs."""
    name, *options = sys.argv[1:] or ["--help"]
    if name in scripts():
        found = loaded(name)
        run(found.main, found.Settings, args=options, prog=f"run.py {name}")
    elif name == "--measured":
        print("\n".join(measured()))
    elif name in ("--help", "-h"):
        print(__doc__)
        print("\n".join(f"{each:20} {sentence(each)}" for each in scripts()))
    else:
        near = "".join(f"; perhaps you meant {each}" for each in difflib.get_close_matches(name, scripts(), 1))
        print(f"error: {name!r} is not in measurements/, studies/ or docs_tables/{near}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
