"""Notebooks take up to a minute each: `make test` runs the one that a reader begins with, `make verify` the others."""

import os

import pytest

FIRST = "first_roll"

# learning goes on for as many updates as show that it works
os.environ.setdefault("UPDATES", "2")


def pytest_collection_modifyitems(items):
    for item in items:
        if item.path.suffix == ".ipynb":
            item.add_marker(pytest.mark.slow if item.path.stem == FIRST else pytest.mark.campaign)
