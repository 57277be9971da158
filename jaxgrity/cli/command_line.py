"""Settings from the command line; neither they nor --help import anything of JAX."""

import contextlib
import io
import itertools
import os
import re
import sys
from collections.abc import Iterator
from typing import Any

import tyro

from jaxgrity.cli.interrupts import INTERRUPTED

UNREAD = 141
"""Exit code where nobody reads what is printed any more, as after `| head`: 128 + SIGPIPE, as of other programs."""


@contextlib.contextmanager
def while_read() -> Iterator[None]:
    """End the process silently, with exit code `UNREAD`, if what it prints is read no more; with one line and exit
    code 2 if it cannot be written otherwise, as on a full disk, or `INTERRUPTED` on Ctrl-C."""
    try:
        try:
            yield
        finally:
            if sys.stdout is not None:  # it is where standard output was closed from the start
                sys.stdout.flush()
    except KeyboardInterrupt:  # while JAX is imported
        print("\ninterrupted", file=sys.stderr)
        sys.exit(INTERRUPTED)
    except OSError as error:
        # Python flushes once more at its end, and would complain there
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):
            sys.exit(UNREAD)
        if not isinstance(error.__context__, SystemExit):  # else the command has said its own error
            print(f"error: {error}", file=sys.stderr)
        sys.exit(2)


def from_command_line(settings: Any, **how: Any) -> Any:
    """The settings from the command line, by `tyro.cli`; errors are one line."""
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            return tyro.cli(settings, **how)
    except SystemExit:
        if said.getvalue():
            print(f"error: {in_one_line(said.getvalue())}; --help lists what there is", file=sys.stderr)
        raise


def in_one_line(box: str) -> str:
    """The first paragraph of tyro's box, and the first option it proposes."""
    plain = re.sub(
        r"\x1b\[[0-9;]*m", "", box
    )  # in a terminal it has colours, and no lines around it where letters are ASCII
    lines = [line.strip("│ ") for line in plain.splitlines() if line.startswith(("│ ", "  "))]
    first = list(itertools.takewhile(lambda line: line.strip("─-"), lines))
    proposed = [line for before, line in itertools.pairwise(lines) if before.startswith("Perhaps you meant")]
    return " ".join(first).rstrip(".") + "".join(f"; perhaps you meant {line}" for line in proposed[:1])
