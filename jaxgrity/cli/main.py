"""The command `jaxgrity`: simulate, search, compare, diagnose, explore, inspect, catalogue and convert."""

from collections.abc import Callable
from typing import Annotated

from jaxgrity.cli.script import configure, execute, from_command_line

import tyro

from jaxgrity.cli import catalogue, compare, convert, diagnose, explore, inspect, search, simulate

COMMANDS: dict[type, Callable] = {
    simulate.SimulateSettings: simulate.main,
    search.SearchSettings: search.main,
    compare.CompareSettings: compare.main,
    diagnose.DiagnoseSettings: diagnose.main,
    explore.ExploreSettings: explore.main,
    inspect.InspectSettings: inspect.main,
    catalogue.CatalogueSettings: catalogue.main,
    convert.ConvertSettings: convert.main,
}

Chosen = (
    Annotated[simulate.SimulateSettings, tyro.conf.subcommand("simulate", description=simulate.__doc__)]
    | Annotated[search.SearchSettings, tyro.conf.subcommand("search", description=search.__doc__)]
    | Annotated[compare.CompareSettings, tyro.conf.subcommand("compare", description=compare.__doc__)]
    | Annotated[diagnose.DiagnoseSettings, tyro.conf.subcommand("diagnose", description=diagnose.__doc__)]
    | Annotated[explore.ExploreSettings, tyro.conf.subcommand("explore", description=explore.__doc__)]
    | Annotated[inspect.InspectSettings, tyro.conf.subcommand("inspect", description=inspect.__doc__)]
    | Annotated[catalogue.CatalogueSettings, tyro.conf.subcommand("catalogue", description=catalogue.__doc__)]
    | Annotated[convert.ConvertSettings, tyro.conf.subcommand("convert", description=convert.__doc__)]
)


def main() -> None:
    """What the command `jaxgrity` calls."""
    configure()
    chosen = from_command_line(Chosen, prog="jaxgrity", description=__doc__)
    execute(COMMANDS[type(chosen)], chosen)


if __name__ == "__main__":
    main()
