"""Structures that several tests of the model use."""

import conformance_statics
import pytest


@pytest.fixture(scope="session")
def tower_answers():
    """What is published of a tower of two stacked prisms (TsgFEM, a MATLAB toolbox)."""
    return conformance_statics.RODS["tower"]


@pytest.fixture(scope="session")
def published_tower():
    """That tower on its three supports, struts and cables with mass."""
    return conformance_statics.published_tower()
