"""Springs and dampers on the angle between two parts: angles and torques by hand, files, what is refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrity import InputError, load_scene, parse_scene, save_scene, scene_text, with_terms
from jaxgrity.io.bodies import HingeTable, build_hinges
from jaxgrity.model.hinges import HingeDampers, HingeSprings, hinge_angles

HINGE = (0, 1, 2, 3)
KEYS = "[[hinges]]\nnodes = [0, 4, 5, 8]\nstiffness = 2.0\nrest_angle = 0.3\ndamping = 0.1\n"


def leaves(angle):
    """Two parts about the z axis, the second one turned by `angle` (rad) from the first, and at another height."""
    other = [2 * np.cos(angle), 2 * np.sin(angle), 5.0]
    return jnp.array([[3.0, 0.0, -1.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.5], other])


@pytest.mark.parametrize("angle", [-3.0, -1.2, 0.0, 0.4, 2.9])
def test_the_angle_and_its_torque(angle):
    """U' = K (angle - rest), as a force across the arm of the second part; beyond half a turn from the other side."""
    assert float(hinge_angles(leaves(angle), (HINGE,))[0]) == pytest.approx(angle)
    spring = HingeSprings((HINGE,), [1.5], [1.0])
    energy = lambda q: spring.energy(at(q))  # noqa: E731
    away = (angle - 1.0 + np.pi) % (2 * np.pi) - np.pi
    assert float(energy(leaves(angle))) == pytest.approx(0.75 * away**2)
    force = -jax.grad(energy)(leaves(angle))
    across = np.array([-np.sin(angle), np.cos(angle), 0.0])
    np.testing.assert_allclose(force[3], -1.5 * away / 2 * across, atol=1e-12)
    np.testing.assert_allclose(force.sum(0), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.cross(leaves(angle), force).sum(0), 0.0, atol=1e-12)


def at(q, v=None):
    """What terms are given of nodes at q."""
    scene = load_scene("exact")
    return scene.configuration(q, 0.0, {}) if v is None else scene.motion(v, q, 0.0, None, ({}, {}))


def test_the_damper_resists_the_rate_of_the_angle_alone():
    """A turn of the second part at 0.7 rad/s; a turn of both together costs nothing."""
    damper, q = HingeDampers((HINGE,), [0.4]), leaves(0.8)
    turning = jnp.cross(jnp.array([0.0, 0.0, 0.7]), q)
    one = jnp.zeros_like(q).at[3].set(turning[3])
    assert float(damper.dissipation(at(q, one))) == pytest.approx(0.2 * 0.7**2)
    together = jnp.cross(jnp.array([0.3, -0.5, 0.7]), q) + jnp.array([1.0, 2.0, 3.0])
    assert float(damper.dissipation(at(q, together))) == pytest.approx(0, abs=1e-12)


def test_scene_files_have_them(tmp_path):
    scene = parse_scene(scene_text("exact") + KEYS)
    assert [type(term) for term in scene.terms] == [HingeSprings, HingeDampers]
    save_scene(scene, tmp_path / "robot.toml")
    again = load_scene(tmp_path / "robot.toml")
    assert again.terms[0].nodes == ((0, 4, 5, 8),)
    np.testing.assert_array_equal(again.terms[0].rest_angle, [0.3])
    built = parse_scene(scene_text("exact") + KEYS.replace("rest_angle = 0.3\n", "")).terms[0]
    np.testing.assert_allclose(built.rest_angle, hinge_angles(scene.structure.nodes, built.nodes), atol=1e-12)
    apart = with_terms(load_scene("exact"), scene.terms[0], HingeDampers(((1, 4, 5, 8),), [0.1]))
    save_scene(apart, tmp_path / "robot.toml")
    assert [term.nodes for term in load_scene(tmp_path / "robot.toml").terms] == [term.nodes for term in apart.terms]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (KEYS[KEYS.index("stiff") :], "", r"hinges\[0\]: expected stiffness \(N m/rad\), damping"),
        ("stiffness = 2.0\n", "", r"hinges\[0\]: expected stiffness"),
        ("5, 8]", "5, 80]", r"hinges\[0\].nodes = \[0, 4, 5, 80\]: expected nodes from 0 to 11"),
        ("5, 8]", "5, 4]", r"hinges: nodes = \[0, 4, 5, 4\]: expected four different nodes"),
        ("stiffness = 2.0", "stiffness = -2.0", r"hinges\[0\].stiffness|expected"),
    ],
)
def test_bad_hinges_are_refused(old, new, words):
    with pytest.raises(InputError, match=words):
        parse_scene(scene_text("exact") + KEYS.replace(old, new))
    with pytest.raises(InputError, match="hinges name node 12; expected 0 to 11"):
        with_terms(load_scene("exact"), HingeDampers(((0, 1, 2, 12),), [1.0]))


@pytest.mark.parametrize("nodes", [(0, 1, 2, 3), (3, 1, 2, 0), (0, 1, 4, 3)])
def test_hinges_need_nodes_beside_their_axis(nodes):
    """On it, or about an axis without a length, there is no angle."""
    table = HingeTable(nodes=nodes, stiffness=1.0)
    with pytest.raises(InputError, match="the first or the last lies on the axis through the middle two"):
        build_hinges([table], np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [2, 1, 0], [1, 0, 0]]))
