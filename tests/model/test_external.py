"""Wind and pushes: closed forms, the balance of energy and momentum, scene files."""

import numpy as np
import pytest

from jaxgrity import (
    InputError,
    Push,
    Scene,
    Structure,
    energy_audit,
    parse_scene,
    scene_text,
    simulate,
    wind,
    with_terms,
)
from jaxgrity.model import standing_symmetries

NODE = Structure(nodes=np.zeros((1, 3)), node_mass=np.array([2.0]))


@pytest.mark.slow
def test_a_node_drifts_with_the_wind():
    """From rest: v(t) = w (1 - 1/(1 + c w t/m))."""
    drifting = simulate(Scene(NODE, 0.0, terms=(wind([4.0, 0.0, 0.0], 0.5, nodes=1),)), 1.0, frame_rate=10.0)
    expected = 4.0 * (1 - 1 / (1 + 0.5 * 4.0 * np.asarray(drifting.times) / 2.0))
    np.testing.assert_allclose(drifting.velocities[:, 0, 0], expected, atol=1e-8)


@pytest.mark.slow
def test_a_falling_node_reaches_its_terminal_speed():
    """sqrt(m g/c), in still air."""
    falling = simulate(Scene(NODE, 9.81, terms=(wind(np.zeros(3), 0.5, nodes=1),)), 4.0, frame_rate=2.5)
    np.testing.assert_allclose(falling.velocities[-1, 0, 2], -np.sqrt(2 * 9.81 / 0.5), rtol=1e-4)


@pytest.mark.slow
def test_a_push_gives_its_impulse_and_its_work_is_booked():
    """F (duration - ramp) in all, along the force alone, and the kinetic energy is its work."""
    push = Push((0,), np.array([[3.0, 0.0, -4.0]]), start=0.1, duration=0.2, ramp=0.05)
    audit = energy_audit(Scene(NODE, terms=(push,)), 0.5)
    gained = np.array([3.0, 0.0, -4.0]) * 0.15
    np.testing.assert_allclose(audit.kinetic[-1], gained @ gained / 2 / 2.0, rtol=1e-5)
    np.testing.assert_allclose(audit.dissipated["push"][-1], -audit.kinetic[-1], rtol=1e-5)
    assert audit.momentum_residual.max() < 1e-6


def test_wind_and_pushes_break_the_symmetries_that_they_do_not_share(exact):
    """A gale from above leaves all turns about the vertical; one from the side, or a push, none."""
    every = len(standing_symmetries(exact))
    assert every == 3
    for term, left in (
        (wind([0.0, 0.0, -5.0], 0.1, nodes=12), every),
        (wind([5.0, 0.0, 0.0], 0.1, nodes=12), 1),
        (Push((3,), np.array([[0.0, 0.0, 1.0]]), 0.0, 1.0), 1),
    ):
        assert len(standing_symmetries(with_terms(exact, term))) == left


@pytest.mark.slow
def test_scene_files_have_wind_and_pushes():
    """As many terms as the file says; a robot in a gale ends further downwind."""
    text = scene_text("exact") + "\n[wind]\nvelocity = [0.0, 6.0, 0.0]\ndrag = 0.05\n"
    text += "[[pushes]]\nnodes = [1, 2]\nforce = [5, 0, 0]\nstart = 0.1\nduration = 0.2\n"
    scene, calm = parse_scene(text), parse_scene(text.replace("[0.0, 6.0, 0.0]", "[0.0, 0.0, 0.0]"))
    assert [term.name for term in scene.terms] == ["wind", "push"]
    assert scene.terms[1].nodes == (1, 2)
    windy, calm = (simulate(s, 0.5, frame_rate=2.0).positions[-1, :, 1].mean() for s in (scene, calm))
    assert windy > calm + 0.01


@pytest.mark.parametrize(
    ("added", "words"),
    [
        ("[wind]\nvelocity = [1.0, 0.0, 0.0]", "wind.drag: missing; expected a number >= 0 or a list"),
        ("[wind]\nvelocity = [1.0, 0.0, 0.0]\ndrag = [0.1]", "wind.drag has 1 numbers; expected one, or 12"),
        ("[wind]\nvelocity = [1.0, 0.0, 0.0]\ndrag = -0.1", "wind.drag = -0.1: expected a number >= 0"),
        ("[[pushes]]\nnodes = [12]\nforce = [1, 0, 0]\nstart = 0\nduration = 1", "pushes.0..nodes = .12.: expected"),
        ("[[pushes]]\nnodes = [0]\nforce = [1, 0, 0]\nstart = 0\nduration = 0.01", "push.ramp = 0.01: expected more"),
    ],
)
def test_what_is_no_force_is_refused(added, words):
    with pytest.raises(InputError, match=words):
        parse_scene(f"{scene_text('exact')}\n{added}\n")
