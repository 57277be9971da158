"""A gait knows which nodes are joined by what in the robot that it is for, and is refused for another one."""

import dataclasses

import numpy as np
import pytest

from jaxgrity import (
    Gait,
    InputError,
    as_population,
    gait_names,
    gaits_of,
    load_gait,
    simulate_population,
    with_gait,
)
from jaxgrity.cli.scenes import chosen_scene
from jaxgrity.io.files import save_json
from jaxgrity.io.gait_library import gait_facts
from jaxgrity.structures import prism_tower


@pytest.fixture(scope="module")
def prism():
    """It has as many nodes, struts and cables as the robot of the library's gaits."""
    return prism_tower(6, exact=True)


def test_gaits_of_the_library_know_their_robot(exact):
    """All are of the six-strut one; a scene with a gait is one program with the scene's own, so it forgets that."""
    for name in gait_names():
        assert load_gait(name).robot == exact.structure.robot
    assert with_gait(exact, load_gait("brisk")).gait.robot is None


def test_a_gait_of_another_robot_is_refused(prism):
    """By `with_gait`, by a scene that is made with it, and by populations; told to, it may be tried."""
    for gait in (load_gait("straight"), load_gait("cables")):
        for make in (lambda g: with_gait(prism, g), lambda g: dataclasses.replace(prism, gait=g)):
            with pytest.raises(InputError, match="made for a robot of 12 nodes, 6 struts, 24 cables"):
                make(gait)
        for gaits in (gaits_of(gait, np.zeros((2, len(gait.members)))), as_population(gait)):
            with pytest.raises(InputError, match="made for a robot of 12 nodes, 6 struts, 24 cables"):
                simulate_population(prism, gaits, 0.1)
    free = dataclasses.replace(load_gait("straight"), robot=None)
    assert with_gait(prism, free).gait.members == tuple(range(6))


def test_the_commands_refuse_it(tmp_path):
    """In one line, for a file with another robot."""
    (tmp_path / "prism.toml").write_text('[structure]\nkind = "prism"\nmass = 1.0\n[struts]\nrigid = true\n'
                                         "[cables]\nstiffness = 400.0\nprestrain = 0.2\n")  # fmt: skip
    with pytest.raises(InputError, match="made for a robot of") as caught:
        chosen_scene(str(tmp_path / "prism.toml"), "straight")
    assert "\n" not in str(caught.value)


def test_a_file_says_for_which_robot_its_gait_is(tmp_path, prism):
    """Where its scene was known; files of before say nothing, and fit any robot that has the members."""
    gait = Gait((0, 1), np.zeros(2), np.full(2, 0.1), np.ones(2))
    save_json(tmp_path / "gait.json", gait_facts(gait, prism.structure))
    assert load_gait(tmp_path / "gait.json").robot == prism.structure.robot
    save_json(tmp_path / "old.json", {name: x for name, x in gait_facts(gait).items() if name != "robot"})
    assert load_gait(tmp_path / "old.json").robot is None
    save_json(tmp_path / "bad.json", {**gait_facts(gait), "robot": [12]})
    with pytest.raises(InputError, match=r"robot = \[12\]: expected a text"):
        load_gait(tmp_path / "bad.json")
