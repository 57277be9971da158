"""The report on a structure: what it counts, where it stands, what its members bear."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

from jaxgrity import InputError, Members, Scene, Structure, load_scene, parse_scene
from jaxgrity.model import LoadCase
from jaxgrity.report import plot
from jaxgrity.report.plot import resting_force_figure
from jaxgrity.statics import inspect_structure, load_report, member_forces, vibration_modes

PRISM = """
[structure]
kind = "prism"
mass = 1.0
prestress = 40.0
[struts]
stiffness = 2e4
[cables]
stiffness = 800.0
"""


@pytest.fixture(scope="module")
def prism_report():
    return inspect_structure(parse_scene(PRISM))


@pytest.mark.parametrize("name", ["reference", "exact"])
def test_six_strut_robot(name):
    """Counts of the closed form, and forces of the stated prestress, with spring struts and with rigid ones."""
    report = inspect_structure(load_scene(name))
    summary = report.summary()
    counts = [summary[key] for key in ("rank", "states_of_self_stress", "mechanisms", "rigid_motions")]
    assert counts == [29, 1, 1, 6]
    assert [summary[key] for key in ("stable", "prestress_stable", "super_stable")] == [True] * 3
    q = report.forces / np.r_[np.full(6, 1.0), np.full(24, np.sqrt(6) / 4)]
    np.testing.assert_allclose(q[:6].mean() / q[6:].mean(), -1.5, rtol=0.02)
    assert not report.slack
    assert report.frequencies[0] > 1


def test_a_scene_with_prestress_stands_as_it_is(prism_report):
    """Its shape is the equilibrium, and the tightest cable has the tension that is asked for."""
    assert prism_report.at_rest
    assert prism_report.stable
    assert prism_report.moved < 1e-9
    np.testing.assert_allclose(prism_report.forces[3:].max(), 40.0, rtol=1e-9)
    assert prism_report.statics.self_stress.shape[1] == 1


def test_words_and_numbers_agree(prism_report):
    """What the table says is in the summary."""
    table = prism_report.table()
    assert "rank 11, 1 of self-stress, 1 mechanism\n" in table
    assert "keeps its shape      yes, by its prestress" in table
    assert "super-stable         yes" in table
    assert f"{prism_report.frequencies[0]:.4g}" in table


def test_slack_cables_are_named():
    """One that is far too long: what is left stands another way, or not at all, and the report says so."""
    scene = parse_scene(PRISM)
    rest = np.array(scene.structure.cables.rest_length)
    rest[4] = 3.0
    loose = dataclasses.replace(scene.structure, cables=dataclasses.replace(scene.structure.cables, rest_length=rest))
    report = inspect_structure(Scene(loose))
    assert 4 in report.slack
    assert "slack cables         " in report.table()
    assert report.forces[3 + 4] == 0


def test_supports_carry_gravity():
    """Of a standing prism whose feet are held, the members push the weight down to them."""
    free = parse_scene(PRISM)
    feet = dataclasses.replace(free.structure, fixed=tuple((node, "xyz") for node in range(3)))
    scene = dataclasses.replace(free, structure=feet, gravity=9.81)
    report = inspect_structure(scene)
    assert report.at_rest
    down = np.zeros(3)
    forces = member_forces(scene.structure, report.shape)
    edges = scene.structure.struts.edges + scene.structure.cables.edges
    for (i, j), force in zip(edges, forces):
        if (i < 3) != (j < 3):
            low, high = (i, j) if i < 3 else (j, i)
            d = report.shape[high] - report.shape[low]
            down += force * d / np.linalg.norm(d)
    # members pull their feet towards the upper nodes, which weigh half of the robot
    np.testing.assert_allclose(down, [0, 0, -9.81 / 2], atol=1e-7)


def test_nothing_to_inspect():
    """A node alone."""
    with pytest.raises(InputError, match="the structure has no members"):
        inspect_structure(Scene(Structure(np.zeros((1, 3)), np.ones(1))))


def test_the_figure_shows_every_member(prism_report, tmp_path):
    """One line and one bar each; struts in one colour, cables in another."""
    figure = resting_force_figure(prism_report)
    plot.save(figure, tmp_path / "forces.png")
    shape, bars = figure.axes[0], figure.axes[1]
    assert len(shape.collections[0].get_segments()) == len(bars.patches) == 12
    red, blue = bars.patches[0].get_facecolor(), bars.patches[-1].get_facecolor()
    assert red[0] > red[2]
    assert blue[2] > blue[0]
    assert (tmp_path / "forces.png").stat().st_size > 5000


def test_a_limp_structure_is_not_called_stable():
    """Without prestress no member carries anything but rounding, and mechanisms meet no resistance."""
    report = inspect_structure(parse_scene(re.sub(r"prestress = .*", "", PRISM)))
    assert not np.any(report.forces)
    assert len(report.slack) == len(report.structure.cables.edges)
    assert report.loose > 0
    assert report.prestress_stable is False
    assert f"neutral: {report.loose} ways to move meet no resistance" in report.table()
    assert "keeps its shape      no: it can move, at least a little, without resistance" in report.table()
    assert "no member carries force: give [cables] prestrain, or [structure] prestress" in report.table()


def test_what_buckles_or_takes_another_shape_does_not_keep_its_own():
    """Struts too slender for their force; and cables so short that nodes move far from the given shape."""
    slender = PRISM.replace("[struts]\n", "[struts]\nbending_stiffness = 0.01\n")
    assert "keeps its shape      no: a member yields or buckles" in inspect_structure(parse_scene(slender)).table()
    scene = parse_scene(PRISM)
    cables = dataclasses.replace(scene.structure.cables, rest_length=0.5 * scene.structure.cables.rest_length)
    short = Scene(dataclasses.replace(scene.structure, cables=cables))
    assert "keeps its shape      yes, but not the given shape" in inspect_structure(short).table()


def test_the_structure_of_the_recipe_stands():
    """The scene in docs/howto.md with nodes of its own."""
    page = (Path(__file__).parents[2] / "docs" / "howto.md").read_text(encoding="utf-8")
    (scene,) = re.findall(r"```toml\n(\[structure\]\nkind = \"custom\".*?)```", page, re.DOTALL)
    report = inspect_structure(parse_scene(scene))
    assert report.prestress_stable
    assert report.slack == ()
    assert report.moved < 0.05


@pytest.mark.parametrize(
    ("mass", "length"),
    [(1.0, 1.0), (1e-6, 1.0), *(pytest.param(*x, marks=pytest.mark.campaign) for x in ((1e6, 10.0), (1e-3, 0.01)))],
)
def test_a_rigid_strut_alone_bears_its_load_at_every_size(mass, length):
    """A pendulum at rest pulls with its weight, m g, and swings at sqrt(g/l) along x and y: no spring is beside it."""
    rod = Members(((0, 1),), None, [length])
    hung = Scene(Structure([[0, 0, 0], [0, 0, -length]], [0.0, mass], rod, fixed=((0, "xyz"),)), gravity=9.81)
    found = inspect_structure(hung)
    np.testing.assert_allclose(found.forces, mass * 9.81, rtol=1e-6)
    assert found.moved < 1.1e-5 * length
    swings = np.sqrt(9.81 / length) / (2 * np.pi)
    np.testing.assert_allclose(found.frequencies[:2], swings, rtol=2e-5)
    np.testing.assert_allclose(vibration_modes(hung).frequency[:2], swings, rtol=1e-9)
    aside = load_report(hung, LoadCase("aside", (1,), [[0.1 * mass * 9.81, 0, 0]]))
    np.testing.assert_allclose(aside.displacement[1, 0], length * np.sin(np.arctan(0.1)), rtol=2e-5)
    np.testing.assert_allclose(aside.forces, mass * 9.81 * np.hypot(1, 0.1), rtol=1e-6)


def test_forces_of_rigid_struts_alone_are_not_guessed():
    """They follow from what loads them, of which a structure alone knows nothing."""
    rod = Members(((0, 1),), None, [1.0])
    with pytest.raises(InputError, match="no spring loads the rigid struts; expected `inspect_structure`"):
        member_forces(Structure([[0, 0, 0], [0, 0, -1]], [0.0, 1.0], rod, fixed=((0, "xyz"),)), np.eye(3)[:2])
