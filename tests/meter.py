"""What a run of the tests waited for: programs that JAX made, and the tests that made most of them.

A test mostly waits for compilation, not for physics. So each run ends with two tables: sums for each size of test, and
the twenty tests that spent longest on making programs. `.cache/test-meter.json` has the same for every test.
"""

import json
from collections import defaultdict
from pathlib import Path

import pytest
from measurements.compile_meter import Counter

LONGEST = 20
"""Number of tests in the second table."""


class Meter:
    """A plugin of pytest: counts in each process, and prints in the first one."""

    def __init__(self, sizes: tuple[str, ...], folder: Path):
        self.counter, self.sizes, self.folder = Counter(), sizes, folder
        self.tests = defaultdict(lambda: defaultdict(float))
        self.counter.listen()

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
