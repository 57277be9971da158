"""A scene in words: what acts in it and what does not, its members, its prestress and its natural frequencies."""

import dataclasses
import re

import numpy as np
import pytest

from jaxgrity import (
    Box,
    ExactGround,
    PenaltyGround,
    Scene,
    Slope,
    SmoothFriction,
    Structure,
    SwitchFriction,
    Union,
    describe,
    load_scene,
    parse_scene,
)
from jaxgrity.model import rigid_body
from jaxgrity.statics.describe import _span

CUSTOM = """
[structure]
kind = "custom"
nodes = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
struts = [[0, 1]]
cables = [[1, 2]]
node_mass = [1.0, 2.0, 3.0]
[struts]
stiffness = 10
[cables]
stiffness = 5
rest_length = 1.0
"""


def described(scene) -> dict[str, str]:
    """The lines by their names."""
    lines = [re.split(r"\s{2,}", line, maxsplit=1) for line in describe(scene).splitlines()]
    return {name: text for name, text in lines}


def test_what_the_ground_is_is_said(exact):
    """Level, steep, or of solids."""
    box = Box(np.array([1.0, 0, 0]), np.array([0.3, 4, 0.2]))
    for ground, told in (
        (ExactGround(), "level plane"),
        (ExactGround(0.1), "plane that falls by 5.73° towards +x"),
        (ExactGround(surface=Union((Slope(), box))), "slope, box"),
    ):
        assert described(dataclasses.replace(exact, ground=ground))["ground"] == told
    assert "ground" not in described(dataclasses.replace(exact, ground=None, friction=None))


def test_small_numbers_that_differ_are_two():
    """As the masses of a robot of a millimetre."""
    assert _span([1e-9, 5e-9], "kg") == "1e-09 to 5e-09 kg"
    assert _span([1e-9, 1.0000001e-9], "kg") == "1e-09 kg"


def test_what_is_broken_or_stuck_is_named():
    """By their numbers, of rigid struts too; and says nothing where all is well."""
    lines = described(parse_scene(CUSTOM.replace("[cables]", "[cables]\nbroken = [0]\nstuck = [0]")))
    assert lines["cables"].endswith("stiffness 0 N/m, broken [0], stuck [0]")
    assert "stuck" not in lines["struts"]
    rigid = describe(parse_scene(CUSTOM.replace("stiffness = 10", "rigid = true\nstuck = [0]")))
    assert "rigid, stuck [0]\n" in rigid
    assert "broken" not in rigid


def test_what_is_modelled_and_what_is_not():
    """Terms, members, masses, prestress and frequencies; the cables of the reference scene carry about 105 N."""
    lines = described(load_scene("reference"))
    assert lines["modelled"] == (
        "strut springs, cables (tension only), node damping, strut damping, cable damping, gravity, penalty contact, "
        "contact dissipation, smooth friction, gait"
    )
    assert lines["not modelled"] == "rigid struts, rigid bodies, exact contact, Coulomb switch, Coulomb cone"
    assert "6 kg" in lines["nodes"]
    assert "cables 105" in lines["prestress"]
    assert re.fullmatch(r"4\.\d+ to \d+\.?\d* Hz", lines["natural frequencies"])
    assert lines["both without"] == "gravity, ground, gait"
    bare = described(parse_scene(CUSTOM))
    assert "both without" not in bare
    assert bare["modelled"] == "strut springs, cables (tension only)"
    assert "gravity" in bare["not modelled"]


def test_the_switch_creeps_beside_what_is_rigid():
    """A body on springy ground; nothing is said of smooth friction."""
    ends = np.array([[0.0, 0, 0], [1, 0, 0]])
    rod = Structure(ends, np.zeros(2), bodies=(rigid_body(ends, (0, 1), 6.0, [0.0, 0.5, 0.5]),))
    on_ground = Scene(rod, ground=PenaltyGround(1e4), friction=SwitchFriction(0.6, 0.5, 0.02))
    assert "nodes that should stick creep at up to 0.02 m/s" in described(on_ground)["friction"]
    smooth = dataclasses.replace(on_ground, friction=SmoothFriction(0.5, 0.02))
    assert "friction" not in described(smooth)


FLOPPY = """
[structure]
kind = "custom"
nodes = [
    [0.19, -0.52, -0.41], [-2.44, 1.8, 1.14], [-0.33, 0.77, 0.28],
    [-0.55, 0.98, -0.31], [-0.33, -0.79, 0.45], [-0.1, 0.55, -0.61],
]
struts = [[0, 1], [2, 3], [4, 5]]
cables = [[0, 2], [1, 3], [2, 4], [3, 5], [0, 4], [1, 5]]
mass = 6.0
[struts]
stiffness = 2e4
[cables]
stiffness = 600.0
prestrain = 0.3
"""


@pytest.mark.parametrize("struts", ["stiffness = 2e4", "rigid = true"])
def test_rounding_is_no_natural_frequency(struts):
    """Nothing resists some motions of this structure, whatever its struts are: their frequency is zero, not small.

    It has several minima; at which of them the search ends, rounding decides, and with it machines. Six nodes have
    twelve ways to vibrate. Springs for rigid struts, 1e5 times stiffer than cables, leave rounding that would look like
    vibrations of 4e-5 Hz, and forces that are not quite in equilibrium some of 2e-3 Hz.
    """
    lines = described(parse_scene(FLOPPY.replace("stiffness = 2e4", struts)))
    found = re.fullmatch(r"(.*) of 0 Hz \(nothing resists the motion\), (.*) to (.*) Hz", lines["natural frequencies"])
    assert found, lines["natural frequencies"]
    assert found[1] in "1234"
    assert float(found[2]) > 1
    assert float(found[3]) > 5
