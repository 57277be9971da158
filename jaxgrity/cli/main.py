"""Simulate tensegrity robots, and search for the gaits that make them roll.

--version prints the version.
"""

import sys
from importlib import import_module, metadata
from typing import Annotated, get_args

from tyro.conf import subcommand

from jaxgrity.cli import settings
from jaxgrity.cli.command_line import from_command_line, while_read
from jaxgrity.cli.search_settings import SearchSettings
from jaxgrity.core.errors import unknown

Chosen = (
    Annotated[settings.SimulateSettings, subcommand("simulate")]
    | Annotated[settings.DemoSettings, subcommand("demo")]
    | Annotated[SearchSettings, subcommand("search")]
    | Annotated[settings.CompareSettings, subcommand("compare")]
    | Annotated[settings.DiagnoseSettings, subcommand("diagnose")]
    | Annotated[settings.ValidateSettings, subcommand("validate")]
    | Annotated[settings.TrainSettings, subcommand("train")]
    | Annotated[settings.ExploreSettings, subcommand("explore")]
    | Annotated[settings.InspectSettings, subcommand("inspect")]
    | Annotated[settings.CatalogueSettings, subcommand("catalogue")]
    | Annotated[settings.ConvertSettings, subcommand("convert")]
)
"""Settings of each command. Their class's name says which module of `jaxgrity.cli` has the command's `main`."""


def command_of(settings: type) -> str:
    """The command of these settings."""
    return settings.__name__.removesuffix("Settings").lower()


COMMANDS = [command_of(get_args(each)[0]) for each in get_args(Chosen)]
"""The first words that the command line accepts."""


@while_read()
def main() -> None:
    """The entry point of the command `jaxgrity`."""
    if sys.argv[1:2] == ["help"]:
        sys.argv[1:] = [*sys.argv[2:], "--help"]
    first = sys.argv[1] if len(sys.argv) > 1 else ""
    if first == "--version":
        print(f"jaxgrity {metadata.version('jaxgrity')}")
        return
    # tyro proposes options that are spelt nearly so, but not commands
    if first[:1].isalpha() and first not in COMMANDS:
        expected = f"expected one of {', '.join(COMMANDS)}"
        print(f"error: command {first!r}: {unknown(first, COMMANDS)}; {expected}", file=sys.stderr)
        sys.exit(2)
    chosen = from_command_line(Chosen, prog="jaxgrity", description=__doc__)
    name = command_of(type(chosen))
    print(f"{name}: loading JAX ...", flush=True)
    # what takes most of a second to import comes after the first word, and is not needed for --help
    script = import_module("jaxgrity.cli.script")
    script.configure()
    script.execute(import_module(f"jaxgrity.cli.{name}").main, chosen)


if __name__ == "__main__":
    main()
