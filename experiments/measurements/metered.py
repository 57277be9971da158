"""Run a program, and leave what it waited for as JSON: `python metered.py REPORT.json PROGRAM [ARGUMENTS]`.

PROGRAM is a module or a script. `first_commands.py` runs commands of jaxgrity in this way.
"""

import json
import runpy
import sys
from pathlib import Path

from compile_meter import Counter, Imports, covered


def main(report: str, *program: str) -> None:
    """The program ends as it would by itself; the report is left in any case."""
    counter = Counter()
    imports = Imports(counter)
    sys.argv = list(program)
    try:
        if program[0].endswith(".py"):
            runpy.run_path(program[0], run_name="__main__")
        else:
            runpy.run_module(program[0], run_name="__main__")
    finally:
        Path(report).write_text(json.dumps(counter.result() | {"imports": covered(imports.spans)}))


if __name__ == "__main__":
    main(*sys.argv[1:])
