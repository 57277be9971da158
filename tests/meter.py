"""What a run of the tests waited for: programs that JAX made, and the tests that made most of them.

A test mostly waits for compilation, not for physics. So each run ends with two tables: sums for each size of test, and
the twenty tests that spent longest on making programs. `.cache/test-meter.json` has the same for every test.
"""

import json
import os
import time
from collections import defaultdict
from pathlib import Path

import jax
import pytest

EVENTS = {
    "/jax/core/compile/jaxpr_trace_duration": "tracing",
    "/jax/core/compile/jaxpr_to_mlir_module_duration": "tracing",
    "/jax/core/compile/backend_compile_duration": "compiling",
}
"""Durations that JAX reports, by the column in which they count. Reading a kept program counts as compiling it."""
HIT = "/jax/compilation_cache/cache_hits"
"""The event of a program that was read from the cache."""
LONGEST = 20
"""Number of tests in the second table."""


class Counter:
    """Programs made and kept ones read since the last reset, with the spans of time (s) of each column."""

    def __init__(self):
        self.reset()
        jax.monitoring.register_event_duration_secs_listener(self._duration)
        jax.monitoring.register_event_listener(self._event)

    def reset(self):
        self.spans, self.programs, self.read = {"tracing": [], "compiling": []}, 0, 0
        self.cpu_before = _cpu_seconds()

    def _duration(self, event, seconds, **_):
        if event in EVENTS:
            now = time.monotonic()
            self.spans[EVENTS[event]].append((now - seconds, now))
            self.programs += EVENTS[event] == "compiling"

    def _event(self, event, **_):
        self.read += event == HIT

    def result(self) -> dict:
        """Seconds of each column, where spans inside of others count once, and numbers of programs."""
        return {
            "cpu": _cpu_seconds() - self.cpu_before,
            **{column: _covered(spans) for column, spans in self.spans.items()},
            "programs": self.programs,
            "kept": self.read,
        }


def _cpu_seconds() -> float:
    """Processor time (s) of this process and of those it started that have ended; other work does not change it."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def _covered(spans) -> float:
    """Length of the union of spans (start, end)."""
    total, last = 0.0, -float("inf")
    for start, end in sorted(spans):
        total += max(0.0, end - max(start, last))
        last = max(last, end)
    return total


class Meter:
    """A plugin of pytest: counts in each process, and prints in the first one."""

    def __init__(self, sizes: tuple[str, ...], folder: Path):
        self.counter, self.sizes, self.folder = Counter(), sizes, folder
        self.tests = defaultdict(lambda: defaultdict(float))

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item, nextitem):
        self.counter.reset()
        return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(self, item, call):
        report = yield
        size = next((name for name in self.sizes if item.get_closest_marker(name)), "fast")
        # the last report of a test has all that it made, fixtures included
        made = self.counter.result() if call.when == "teardown" else {}
        report.user_properties = [*report.user_properties, ("meter", {"size": size, **made})]
        return report

    def pytest_runtest_logreport(self, report):
        made = dict(report.user_properties).get("meter", {})
        test = self.tests[report.nodeid]
        test["seconds"] += report.duration
        test.update(made)

    def pytest_terminal_summary(self, terminalreporter):
        tests = {name: dict(test) for name, test in self.tests.items() if "programs" in test}
        if not tests:
            return
        self.folder.mkdir(parents=True, exist_ok=True)
        (self.folder / "test-meter.json").write_text(json.dumps(tests, indent=1))
        terminalreporter.section("what was waited for (worker seconds)")
        for line in _tables(tests):
            terminalreporter.write_line(line)


def _tables(tests: dict) -> list[str]:
    heads = ("seconds", "cpu", "compiling", "tracing", "programs", "kept")
    sums = defaultdict(lambda: dict.fromkeys(("tests", *heads), 0))
    for test in tests.values():
        row = sums[test["size"]]
        row["tests"] += 1
        for head in heads:
            row[head] += test[head]
    lines = [f"{'size':10}" + "".join(f"{head:>11}" for head in ("tests", *heads))]
    lines += [f"{size:10}" + "".join(f"{value:11.0f}" for value in row.values()) for size, row in sums.items()]
    making = sorted(tests, key=lambda name: -tests[name]["compiling"] - tests[name]["tracing"])[:LONGEST]
    lines += ["", "".join(f"{head:>11}" for head in heads) + "  tests that made programs for longest"]
    return lines + ["".join(f"{tests[name][head]:11.1f}" for head in heads) + f"  {name}" for name in making]
