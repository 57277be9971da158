"""The progress of a command: a bar for each stage; its clock runs on while programs compile."""

import contextlib
import sys
import threading
import time
from typing import TYPE_CHECKING

from tqdm import tqdm

from jaxgrity.core.display import significant

if TYPE_CHECKING:
    from jaxgrity.search.pipeline import Progress

UNITS = {
    "rolling out": " simulated s",
    "timing": " simulated s",
    "diagnosing": "measurement",
    "drawing": "picture",
    "evolving": "generation",
    "learning": "update",
    "promoting": "comparison",
    "polishing": "step",
    "verifying": "check",
    "reporting": "part",
}
"""What a bar counts, by the stage that it shows."""
SAID = {"best": "best (by the draws that chose it)", "fitness": "fitness (by the draws and the horizon of this step)"}
"""Words with which a bar shows a fact whose name alone says too little."""
UNEVEN = {"diagnosing", "drawing", "promoting", "verifying", "reporting"}
"""Stages whose steps are so different that no remaining time follows from those that are done."""
TICK = 2.0
"""Longest time between two updates of a bar, s."""
SLOW = 100.0
"""Length of a step, s, from which on a line says that this is no error; after two minutes XLA prints an alarm."""
STILL = "still compiling or computing; on a slow machine that is normal, also if XLA prints 'Very slow compile?'"


class Bars:
    """A progress bar for each stage, one after the other; its clock runs on during long steps."""

    def __init__(self) -> None:
        self.stage = ""
        self.bar = tqdm(disable=True)
        self.over = threading.Event()
        self.moved, self.told = time.monotonic(), False

    def __enter__(self) -> "Bars":
        threading.Thread(target=self.tick, daemon=True).start()
        return self

    def __exit__(self, *error) -> None:
        self.over.set()
        self.bar.close()

    def tick(self) -> None:
        """Show the time during compilation and judgements."""
        with contextlib.suppress(BrokenPipeError):  # which the command meets too when it prints next
            while not self.over.wait(TICK):
                self.bar.refresh()
                if not self.told and time.monotonic() - self.moved > SLOW:
                    self.told = True
                    tqdm.write(STILL)

    def hear(self, progress: "Progress") -> None:
        """Show the progress of a search."""
        self.show(progress.stage, progress.done, progress.total)
        facts = {
            SAID.get(name, name): significant(x) if isinstance(x, float) else x for name, x in progress.facts.items()
        }
        self.bar.set_postfix(facts)

    def show(self, stage: str, done: int | float, total: int | float | None) -> None:
        """Move the bar of a stage; the first call begins it."""
        if stage != self.stage:
            self.bar.close()
            self.stage = stage
            counted = "{percentage:3.0f}%|{bar}| {n_fmt}/{total_fmt} " if total else ""
            form = f"{{desc}}: {counted}[{{elapsed}}{{postfix}}]" if stage in UNEVEN else None
            unit = UNITS[stage]
            self.bar = tqdm(total=total, initial=done, desc=stage, unit=unit, bar_format=form, file=sys.stdout)
        self.bar.n = done  # a sum of differences would show their rounding
        self.bar.update(0)
        self.moved = time.monotonic()
