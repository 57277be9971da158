"""What a process waits for: programs that JAX traces, compiles or reads from its cache.

As a command it runs a module or a script, and leaves that as JSON: `compile_meter.py REPORT.json PROGRAM [ARGUMENTS]`.
"""

import builtins
import json
import os
import runpy
import sys
import time
from pathlib import Path
from typing import Any

EVENTS = {
    "/jax/core/compile/jaxpr_trace_duration": "tracing",
    "/jax/core/compile/jaxpr_to_mlir_module_duration": "tracing",
    "/jax/core/compile/backend_compile_duration": "compiling",
}
"""Durations that JAX reports, by the column in which they count. Reading a kept program counts as compiling it."""
HIT = "/jax/compilation_cache/cache_hits"
"""The event of a program that was read from the cache."""


class Counter:
    """Programs made and kept ones read since the last reset, with the spans of time (s) of each column."""

    def __init__(self) -> None:
        self.reset()

    def listen(self) -> None:
        """Hear from now on what JAX reports; this imports JAX."""
        import jax

        jax.monitoring.register_event_duration_secs_listener(self._duration)
        jax.monitoring.register_event_listener(self._event)

    def reset(self) -> None:
        self.spans: dict[str, list[tuple[float, float]]] = {"tracing": [], "compiling": []}
        self.programs, self.read = 0, 0
        self.cpu_before = cpu_seconds()

    def _duration(self, event: str, seconds: float, **_: Any) -> None:
        if event in EVENTS:
            now = time.monotonic()
            self.spans[EVENTS[event]].append((now - seconds, now))
            self.programs += EVENTS[event] == "compiling"

    def _event(self, event: str, **_: Any) -> None:
        self.read += event == HIT

    def result(self) -> dict[str, float]:
        """Seconds of each column, where spans inside of others count once, and numbers of programs."""
        return {
            "cpu": cpu_seconds() - self.cpu_before,
            **{column: covered(spans) for column, spans in self.spans.items()},
            "programs": self.programs,
            "kept": self.read,
        }


def listen_once_there(counter: Counter) -> None:
    """Let it listen once somebody has imported JAX: the meter itself must not, for that takes most of a second."""
    plain = builtins.__import__

    def watched(*args: Any, **kwargs: Any) -> Any:
        found = plain(*args, **kwargs)
        if builtins.__import__ is watched and getattr(sys.modules.get("jax"), "monitoring", None):
            builtins.__import__ = plain
            counter.listen()
        return found

    builtins.__import__ = watched


def cpu_seconds() -> float:
    """Processor time (s) of this process and of those it started that have ended; other work does not change it."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def covered(spans: list[tuple[float, float]]) -> float:
    """Length of the union of spans (start, end)."""
    total, last = 0.0, -float("inf")
    for start, end in sorted(spans):
        total += max(0.0, end - max(start, last))
        last = max(last, end)
    return total


def main(report: str, *program: str) -> None:
    """The program ends as it would by itself; the report is left in any case."""
    counter = Counter()
    listen_once_there(counter)
    sys.argv = list(program)
    try:
        if program[0].endswith(".py"):
            runpy.run_path(program[0], run_name="__main__")
        else:
            runpy.run_module(program[0], run_name="__main__")
    finally:
        Path(report).write_text(json.dumps(counter.result()))


if __name__ == "__main__":
    main(*sys.argv[1:])
