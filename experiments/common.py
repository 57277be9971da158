"""What every script does first and last: set JAX up, read the settings, and turn bad input into one line."""

import os
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import jax
import tyro

from jaxgrity import InputError

SCENES = Path(__file__).parent / "scenes"

Settings = TypeVar("Settings")


def measured() -> dict:
    """What every measurement says of itself: the command that made it, without folders, and on how many cores."""
    words = sys.argv[:]
    if "--out" in words:
        del words[words.index("--out") : words.index("--out") + 2]
    if "--limit" in words:
        words[words.index("--limit") + 1] = "FOLDER"
    return {"command": shlex.join(["python", *words]), "cores": len(os.sched_getaffinity(0))}


def configure() -> None:
    """Float64 allowed: for scripts, and for the processes that they start."""
    jax.config.update("jax_enable_x64", True)


def run(main: Callable[[Settings], None], settings: type[Settings]) -> None:
    """Call `main` with `settings` from the command line: float64 allowed, every core a device of its own.

    Ends with exit code 2 and one clear line on bad input.
    """
    configure()
    if "cpu" in (jax.config.jax_platforms or "cpu"):
        jax.config.update("jax_num_cpu_devices", len(os.sched_getaffinity(0)))
    chosen = tyro.cli(settings, description=sys.modules["__main__"].__doc__)
    try:
        main(chosen)
    except (InputError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
