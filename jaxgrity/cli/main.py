"""The command `jaxgrity`: simulate, search, compare, diagnose, explore, inspect, catalogue and convert."""

from importlib import import_module
from typing import Annotated

from tyro.conf import subcommand

from jaxgrity.cli import settings
from jaxgrity.cli.command_line import from_command_line

Chosen = (
    Annotated[settings.SimulateSettings, subcommand("simulate")]
    | Annotated[settings.SearchSettings, subcommand("search")]
    | Annotated[settings.CompareSettings, subcommand("compare")]
    | Annotated[settings.DiagnoseSettings, subcommand("diagnose")]
    | Annotated[settings.ExploreSettings, subcommand("explore")]
    | Annotated[settings.InspectSettings, subcommand("inspect")]
    | Annotated[settings.CatalogueSettings, subcommand("catalogue")]
    | Annotated[settings.ConvertSettings, subcommand("convert")]
)
"""for each command its settings, whose name says which module of `jaxgrity.cli` has its `main`"""


def main() -> None:
    """What the command `jaxgrity` calls."""
    chosen = from_command_line(Chosen, prog="jaxgrity", description=__doc__)
    name = type(chosen).__name__.removesuffix("Settings").lower()
    print(f"{name}: loading JAX ...", flush=True)
    # what takes most of a second to import comes after the first word, and is not needed for --help
    script = import_module("jaxgrity.cli.script")
    script.configure()
    script.execute(import_module(f"jaxgrity.cli.{name}").main, chosen)


if __name__ == "__main__":
    main()
