"""The command `jaxgrity`: simulate, search, compare and diagnose."""

from collections.abc import Callable
from typing import Annotated

from jaxgrity.cli.script import configure, execute

import tyro

from jaxgrity.cli import compare, diagnose, search, simulate

COMMANDS: dict[type, Callable] = {
    simulate.SimulateSettings: simulate.main,
    search.SearchSettings: search.main,
    compare.CompareSettings: compare.main,
    diagnose.DiagnoseSettings: diagnose.main,
}

Chosen = (
    Annotated[simulate.SimulateSettings, tyro.conf.subcommand("simulate", description=simulate.__doc__)]
    | Annotated[search.SearchSettings, tyro.conf.subcommand("search", description=search.__doc__)]
    | Annotated[compare.CompareSettings, tyro.conf.subcommand("compare", description=compare.__doc__)]
    | Annotated[diagnose.DiagnoseSettings, tyro.conf.subcommand("diagnose", description=diagnose.__doc__)]
)


def main() -> None:
    """What the command `jaxgrity` calls."""
    configure()
    chosen = tyro.cli(Chosen, prog="jaxgrity", description=__doc__)
    execute(COMMANDS[type(chosen)], chosen)


if __name__ == "__main__":
    main()
