"""The entry points explain themselves: arguments, result, errors, and an example that says what it shows."""

import doctest
import inspect
import re
from operator import attrgetter

import pytest

import jaxgrity

ENTRY_POINTS = (
    "load_scene",
    "simulate",
    "simulate_population",
    "verify",
    "diagnose",
    "sensitivity",
    "energy_audit",
    "evolve",
    "polish",
    "search_gaits",
    "statics.inspect_structure",
    "statics.resting_shape",
    "statics.vibration_modes",
    "statics.static_response",
    "statics.load_report",
    "statics.least_mass",
    "statics.prestressed",
    "model.sized_members",
    "structures.random_tensegrity",
    "bumps",
    "height_map",
    "wind",
    "control.plant_of",
    "control.simulate_policy",
    "control.environment",
)
"""those that share scene, gaits, duration and step come one after the other, so that they share compiled programs"""
CAMPAIGNS = ("search_gaits", "evolve", "polish", "diagnose", "energy_audit")
"""those whose examples take long; searches have tests of their own, and the README's example has a diagnosis"""
SECTIONS = ("Args", "Returns", "Raises", "Example")


def sections(docstring: str) -> dict[str, str]:
    """The text of each section of a docstring in Google's style, by its title, in their order."""
    parts = re.split(r"^(\w+):$", docstring, flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2]))


@pytest.mark.parametrize("name", ENTRY_POINTS)
def test_entry_points_say_what_they_take_return_and_raise(name):
    """Each parameter is among the arguments, and they raise the one error that the library has for bad input."""
    function = attrgetter(name)(jaxgrity)
    found = sections(inspect.getdoc(function))
    assert tuple(found) == SECTIONS
    assert all(text.strip() for text in found.values())
    described = re.findall(r"^ {4}(\w+): ", found["Args"], flags=re.MULTILINE)
    assert described == list(inspect.signature(function).parameters)
    assert re.match(r"\s+InputError: ", found["Raises"])


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.campaign if name in CAMPAIGNS else pytest.mark.slow)
        for name in ENTRY_POINTS
    ],
)
def test_examples_show_what_happens(name):
    """With nothing imported but jaxgrity; each has a result to compare."""
    example = sections(inspect.getdoc(attrgetter(name)(jaxgrity)))["Example"]
    found = doctest.DocTestParser().get_doctest(inspect.cleandoc(example), {"jaxgrity": jaxgrity}, name, None, None)
    assert any(step.want for step in found.examples)
    said: list[str] = []
    outcome = doctest.DocTestRunner(verbose=False).run(found, out=said.append)
    assert outcome.attempted == len(found.examples)
    assert not outcome.failed, "".join(said)
