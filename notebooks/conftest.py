"""Notebooks take up to a minute each: `make test` runs the one that a reader begins with, `make verify` the others."""

import pytest

FIRST = "first_roll"


def pytest_collection_modifyitems(items):
    for item in items:
        if item.path.suffix == ".ipynb":
            item.add_marker(pytest.mark.slow if item.path.stem == FIRST else pytest.mark.campaign)
