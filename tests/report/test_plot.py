"""Figures: in one style that leaves Matplotlib's own alone, readable where README shows them, and saying what is so."""

import dataclasses
import itertools
from types import SimpleNamespace
from unittest.mock import Mock

import jax
import matplotlib
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from PIL import Image

import jaxgrity
from jaxgrity.report import plot
from jaxgrity.report.notebook import search_html
from jaxgrity.search.pipeline import SearchResult
from jaxgrity.trust.error_bars import Verified

SHOWN_WIDTH = 830 * 0.75
"""points: how wide a page shows a figure, of 96 pixels an inch"""


@pytest.fixture(scope="module")
def motion():
    """A scene that rolls, and its motion."""
    scene = jaxgrity.with_gait(jaxgrity.load_scene("exact"), jaxgrity.load_gait("brisk"))
    return scene, jaxgrity.simulate(scene, 3.0, frame_rate=50.0)


@pytest.fixture(scope="module")
def figures(motion):
    """One of each kind that shows a robot or its motion."""
    scene, trajectory = motion
    return {
        "structure": plot.structure_figure(scene),
        "still": plot.still_figure(scene, trajectory),
        "path": plot.path_figure(scene, trajectory, 0.02),
        "members": plot.member_figure(scene, trajectory),
        "forces": plot.force_figure(scene, trajectory),
        "gait": plot.gait_figure(scene.gait),
        "polish": plot.polish_figure(scene.gait, jaxgrity.load_gait("brisk"), [0.5, 0.7], "body lengths/s"),
        "gait and faces": plot.gait_figure(scene.gait, 3.0, jaxgrity.rolling(scene, trajectory)),
        "orbit": plot.orbit_figure(scene, trajectory, 1.0),
        "energy": plot.energy_figure(jaxgrity.energy_audit(scene, 3.0, frame_rate=20.0)),
    }


@pytest.mark.campaign
def test_letters_are_readable_where_a_page_shows_them(figures):
    """At least 8 points; figures that are narrower than the page are not enlarged."""
    for name, figure in figures.items():
        shrunk = min(1.0, SHOWN_WIDTH / (figure.get_figwidth() * 130 / 96 * 72))
        # pixels of a figure at 130 dots an inch are shown as pixels of a page at 96
        sizes = [130 / 96 * shrunk * text.get_fontsize() for text in figure.findobj(Text) if text.get_text()]
        assert min(sizes) >= 8, name


@pytest.mark.campaign
def test_axes_say_what_they_show(figures):
    """Each with a label, and where it is a quantity, its unit."""
    for name in ("path", "members", "forces", "gait", "orbit", "energy"):
        for axes in figures[name].axes:
            labels = [axes.get_xlabel(), axes.get_ylabel()]
            assert any(labels), name
            # a cable's built length is longer than its full rest length: it is strained
            assert all("(" in label or label in ("", "member", "share of the full rest length") for label in labels), (
                name
            )


def test_the_style_is_the_functions_own(motion):
    """Whatever the user has set comes neither into the figure nor is it changed."""
    with matplotlib.rc_context({"font.size": 30, "axes.grid": False}):
        figure = plot.path_figure(*motion)
        assert matplotlib.rcParams["font.size"] == 30
    assert all(axes.xaxis.get_gridlines()[0].get_visible() for axes in figure.axes)
    assert figure.axes[0].xaxis.label.get_fontsize() == 10


def test_energies_add_up_to_what_was_put_in(motion):
    """The uppermost area ends at the line, but for the error of the steps."""
    audit = jaxgrity.energy_audit(motion[0], 3.0, frame_rate=20.0)
    axes = plot.energy_figure(audit).axes[0]
    (line,) = axes.lines
    top = axes.collections[-1].get_paths()[0].vertices
    highest = [top[np.isclose(top[:, 0], t), 1].max() for t in audit.times]
    np.testing.assert_allclose(highest, line.get_ydata(), atol=2 * np.abs(audit.residual).max() + 1e-9)


def test_the_gait_diagram_shows_rest_lengths():
    """Of each member, from its longest to its shortest; without overtones one and one minus its amplitude."""
    gait = jaxgrity.load_gait("lasting")
    assert not gait.overtones
    picture = plot.gait_figure(gait).axes[0].images[0].get_array()
    assert picture.shape[0] == len(gait.members)
    np.testing.assert_allclose(picture.min(1), 1 - gait.amplitude, atol=2e-3)


def test_a_scene_without_a_gait_has_no_gait_diagram():
    with pytest.raises(jaxgrity.InputError, match="gait_figure: gait is None; expected a Gait"):
        plot.gait_figure(None)


@pytest.mark.parametrize("name", ["a.png", "a.svg"])
def test_files_are_what_their_names_say(tmp_path, name):
    """Equal figures make equal files."""
    for path in (tmp_path / name, tmp_path / f"b{name}"):
        plot.save(plot.gait_figure(jaxgrity.load_gait("brisk")), path)
    assert (tmp_path / name).read_bytes() == (tmp_path / f"b{name}").read_bytes()
    if name.endswith("png"):
        with Image.open(tmp_path / name) as image:
            assert image.format == "PNG"
    else:
        assert b"<svg" in (tmp_path / name).read_bytes()


def test_objects_show_themselves_in_jupyter(motion):
    """With a picture, and what the library says of them in words."""
    scene, trajectory = motion
    for thing, said in ((scene, "node"), (trajectory, "moved"), (scene.gait, "")):
        page = thing._repr_html_()
        assert "data:image/png;base64," in page
        assert said in page
    assert isinstance(plot.still_figure(scene, trajectory), Figure)


def test_a_search_shows_itself_in_the_words_of_its_report(motion):
    """With units, and two standard errors after a mean over robots, as everywhere."""
    robots = {"mean": 0.824, "standard_deviation": 0.14, "standard_error": 0.012, "step_error": 2.5e-3, "robots": 128}
    facts = {"distance": 30.2, "error_bar": 0.04, "robust": robots, "other_contact_model": robots, "beyond_bounds": 0.2}
    verified = Mock(spec=Verified, distance=np.array([30.2]), error_bar=np.array([0.04]))
    verdict, problem = (
        SimpleNamespace(summary=lambda: facts, verified=verified),
        SimpleNamespace(duration=40.0, fitness=jaxgrity.Fitness()),
    )
    page = search_html(Mock(spec=SearchResult, scene=motion[0], verdict=verdict, problem=problem))
    assert "verified distance: 30.20 ± 0.04 m in 40 s" in page
    assert "objective: 0.82 ± 0.02 m (standard deviation 0.14) over 128 perturbed robots" in page
    assert "beyond a bound on actuators: 20 % of robots" in page


@pytest.mark.parametrize("stretch", [(1, 1, 3), (4, 1, 1), (1, 1, 1)], ids=["tall", "long", "plain"])
def test_a_still_shows_the_whole_robot(reference, stretch):
    """However tall it is or far it gets: every pixel at the figure's border is white."""
    nodes = np.asarray(reference.structure.nodes) * np.array(stretch)
    frames = np.stack([nodes, nodes + np.array([0.2, 0.1, 0.0])])
    trajectory = jaxgrity.simulate(reference, 0.02, frame_rate=50.0)
    moved = dataclasses.replace(trajectory, positions=frames, times=np.array([0.0, 1.0]))
    figure = plot.still_figure(reference, moved)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[..., :3]
    border = [pixels[:2], pixels[-2:], pixels[:, :2], pixels[:, -2:]]
    assert all((edge == 255).all() for edge in border)
    assert (pixels != 255).any(-1).sum() > 2000


def test_titles_and_legends_cover_nothing():
    """Titles side by side fit where no correlation is known, and legends are outside of the axes."""
    known = np.full((3, 3), np.nan)
    levels = plot.fidelity_figure(("screening", "own", "both"), np.eye(3, 8), 3, (known, known), "body lengths/s")
    speeds = np.linspace(0.4, 0.6, 8)
    robots = plot.robust_figure({"other contact model": speeds, "found": speeds, "before polish": speeds}, "m/s")
    for figure in (levels, robots):
        figure.draw_without_rendering()
        titles = [axes.title.get_window_extent() for axes in figure.axes]
        assert all(figure.bbox.x0 <= title.x0 and title.x1 <= figure.bbox.x1 for title in titles)
        assert all(one.x1 < other.x0 for one, other in itertools.pairwise(titles))
        (legend,) = figure.legends
        assert not any(legend.get_window_extent().overlaps(axes.bbox) for axes in figure.axes)


def test_gaits_that_are_not_shown_are_counted():
    """On any level: beyond a bound, NaN, or with a robot that failed, -inf."""
    worth, known = np.full((2, 8), 0.5), np.eye(2)
    worth[0, 1:3], worth[1, 3], worth[1, 1] = np.nan, -np.inf, -np.inf
    figure = plot.fidelity_figure(("screening", "own"), worth, 3, (known, known), "m")
    told = "not shown: 2 gaits beyond the actuators' bounds, 1 gait of which a robot failed"
    assert figure.get_supxlabel() == told


def test_polish_shows_one_actuator_before_and_after():
    """Where a search chooses members, the result lacks those that are idle, and others come first."""
    rows, gait = np.array([2, 4]), jaxgrity.load_gait("brisk")
    gait = dataclasses.replace(gait, amplitude=np.linspace(0.1, 0.4, len(gait.members)))
    moving = jax.tree.map(lambda x: np.asarray(x)[rows] if np.ndim(x) else x, gait)
    moving = dataclasses.replace(moving, members=tuple(gait.members[k] for k in rows))
    figure = plot.polish_figure(gait, moving, [0.5], "m", (3.25, 6.5))
    before, after, *_ = figure.axes[0].lines
    assert figure.axes[1].get_title() == "in rollouts of 3.25 s, then 6.5 s"
    np.testing.assert_array_equal(before.get_ydata(), after.get_ydata())


def test_what_has_no_unit_is_shown_without():
    """As a cost of transport: no axis, and no legend, leaves a gap for it."""
    known, costs = np.full((2, 2), np.nan), np.linspace(-3.0, -4.0, 8)
    levels = plot.fidelity_figure(("screening", "own"), np.eye(2, 8), 3, (known, known), "")
    robots = plot.robust_figure({"found": costs}, "")
    assert (levels.axes[0].get_xlabel(), levels.axes[0].get_ylabel()) == ("own", "screening")
    assert robots.legends[0].get_texts()[0].get_text() == "found: -3.500, standard deviation 0.33"


def test_members_have_a_colour_each_or_all_the_same(figures):
    """Six struts have six, and 24 cables one; rest lengths are drawn only where they differ: not of rigid struts."""
    for name in ("members", "forces"):
        struts, cables = figures[name].axes
        assert len(struts.lines) == len({line.get_color() for line in struts.lines}) == 6
        assert len(cables.lines) == 24
        assert len({line.get_color() for line in cables.lines}) == 1


def test_rigid_struts_are_drawn_as_of_one_length():
    """Rounding of their lengths does not fill the axis."""
    scene = jaxgrity.with_gait(jaxgrity.load_scene("exact"), None)
    motion = jaxgrity.simulate(scene, 0.1)
    rounded = motion.positions + 1e-9 * np.random.default_rng(0).normal(size=motion.positions.shape)
    low, high = plot.member_figure(scene, dataclasses.replace(motion, positions=rounded)).axes[0].get_ylim()
    assert high - low > 1e-3
