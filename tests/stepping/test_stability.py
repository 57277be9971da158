"""Predicted stability: the limit is where small motions begin to grow, and the message names what sets it."""

from typing import ClassVar

import equinox as eqx
import numpy as np
import pytest
from studies.stability import at_rest, measure, random_scene

from jaxgrity import (
    ConeFriction,
    EnergyTerm,
    ExactGround,
    InputError,
    Members,
    Motor,
    Scene,
    SolverOptions,
    Structure,
    simulate,
    with_terms,
)
from jaxgrity.core.primitives import inner, norm_squared
from jaxgrity.model.scene import with_gait
from jaxgrity.stepping import resolve, step_limit
from jaxgrity.stepping.methods import METHODS
from jaxgrity.stepping.sparse_motion import sparse_motion
from jaxgrity.stepping.step_limits import limiting_part, linearise, stable_step, standing, strictest

TRIED = np.array([0.5, 0.65, 0.8, 0.899, 1.099])
"""steps, as multiples of the prediction: it is right to a tenth where the last of them alone is unstable"""


@pytest.mark.parametrize(
    ("number", "rigid"),
    [
        pytest.param(103, False, marks=pytest.mark.campaign),
        pytest.param(103, True, marks=pytest.mark.slow),
        pytest.param(100, False, marks=pytest.mark.campaign),
        pytest.param(101, False, marks=pytest.mark.campaign),
        pytest.param(102, True, marks=pytest.mark.campaign),
    ],
)
def test_predicted_within_a_tenth_of_measured(number, rigid):
    """Random robots in equilibrium, by every method that takes them; experiments/studies/stability.py has twenty."""
    scene = random_scene(number, contact=number % 2 == 1, damped=number % 4 > 1, rigid=rigid)
    state = at_rest(scene)
    for method in METHODS.values():
        if method.implicit or method.constrained != rigid or (method.symplectic and scene.dissipates):
            continue
        predicted = stable_step(scene, state, method)
        assert measure(scene, state, method, predicted, TRIED) == pytest.approx(predicted, rel=0.1), method.name


def test_standing_presses_on_the_ground_by_the_weight(reference):
    """Three nodes of the face are as deep in the ground as k_n needs to carry the robot."""
    q, v = standing(reference)
    pressed = -np.minimum(q[:, 2], 0) * reference.ground.stiffness
    assert pressed.sum() == pytest.approx(reference.structure.mass * 9.81, rel=1e-6)
    assert np.count_nonzero(pressed) == 3
    assert not v.any()


def test_rigid_struts_leave_as_many_coordinates_as_they_should(reference):
    """36 coordinates less one for each of six struts; on exact ground less three for each of three nodes that stick."""
    struts = Members(reference.structure.struts.edges, None, reference.structure.struts.rest_length)
    structure = Structure(reference.structure.nodes, reference.structure.node_mass, struts, reference.structure.cables)
    free = Scene(structure)
    assert linearise(free, standing(free)).stiffness.shape == (30, 30)
    held = Scene(structure, gravity=9.81, ground=ExactGround(), friction=ConeFriction(0.5))
    assert linearise(held, standing(held)).stiffness.shape == (21, 21)


def test_a_pendulum_of_a_rigid_strut_swings_at_its_frequency():
    """A strut under tension turns back: omega^2 = g / l, from nothing but the force that the constraint must exert."""
    column = Structure(
        np.array([[0.0, 0, 2], [0, 0, 1.0], [0, 0, 0]]),
        np.array([1e9, 1.0, 1.0]),
        Members(((0, 1), (0, 2)), None, np.array([1.0, 2.0])),
    )
    scene = Scene(column, gravity=9.81, ground=ExactGround())
    values, _ = linearise(scene, (column.nodes, 0 * column.nodes)).modes()
    frequencies = np.abs(values.imag[np.abs(values.real) < 1e-6])
    assert np.any(np.isclose(frequencies, np.sqrt(9.81), rtol=1e-6))


@pytest.mark.parametrize(("cart", "bob", "angle"), [(3.0, 0.5, 0.7), (0.2, 5.0, 0.4), (0.2, 5.0, 2.5)])
def test_the_strut_of_a_pendulum_on_a_cart_has_its_force_at_rest(cart, bob, angle):
    """Let go from an angle, no equilibrium: F = m g cos / (1 + m/M sin^2) for a bob m under a cart M on a rail.

    Across the plane of the rail the bob swings at omega^2 = F/(m l), or falls over, whatever happens within it. Dense
    and sparse matrices agree in the plane too.
    """
    size, g = 2.0, 9.81
    nodes = np.array([[0.0, 0, 0], [size * np.sin(angle), 0, -size * np.cos(angle)]])
    strut = Members(((0, 1),), None, [size])
    scene = Scene(Structure(nodes, [cart, bob], strut, fixed=((0, "yz"),)), gravity=g)
    state = standing(scene)
    values, shapes = linearise(scene, state).modes()
    across = np.abs(shapes[4]) > np.abs(shapes[[0, 3, 5]]).max(0)
    expected = -g * np.cos(angle) / size / (1 + bob / cart * np.sin(angle) ** 2)
    np.testing.assert_allclose(values[across] ** 2, [expected, expected], rtol=1e-9)
    motion = sparse_motion(scene, state)
    free = np.stack([motion.solve(x) for x in np.random.default_rng(0).normal(size=(3, 4))], axis=1)
    sparse = np.sort(np.linalg.eigvals(-motion.reduced(free).stiffness).real)
    np.testing.assert_allclose(sparse, np.sort((values**2).real)[::2], rtol=1e-9, atol=1e-9)


def test_nothing_strains_a_rod_in_free_fall():
    """Two unequal masses, which fall alike: no force of the strut, so nothing turns them."""
    nodes = np.array([[0.0, 0, 0], [0.3, 0, 0.4]])
    scene = Scene(Structure(nodes, [1.0, 7.0], Members(((0, 1),), None, [0.5])), gravity=9.81)
    np.testing.assert_allclose(linearise(scene, standing(scene)).stiffness, 0, atol=1e-12)
    assert abs(sparse_motion(scene, standing(scene)).stiffness).max() < 1e-12


def changed(part, value):
    return lambda scene: eqx.tree_at(part, scene, value)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (changed(lambda s: s.structure.struts.stiffness, np.r_[2e4, 2e4, 2e7, 2e4, 2e4, 2e4]), "strut 2"),
        (changed(lambda s: s.structure.cables.damping, np.r_[np.full(23, 8.0), 9e3]), "damping of cable 23"),
        (changed(lambda s: s.node_damping, np.r_[np.full(11, 0.5), 9e3]), "damping of node 11"),
        (changed(lambda s: s.friction, None), "strut"),
        (changed(lambda s: (s.friction, s.ground.stiffness), (None, 1e8)), "contact of node"),
        (lambda s: s, "friction at node"),
    ],
)
@pytest.mark.slow
def test_the_limit_is_blamed_on_what_sets_it(reference, change, named):
    """One member, damper or contact made far stiffer than all others sets the limit, and is named."""
    scene = change(with_gait(reference, None))
    _, taut, state = strictest(scene, METHODS["rk4"])
    assert named in limiting_part(taut, state, METHODS["rk4"])


@pytest.mark.slow
def test_cables_that_are_slack_at_first_count(reference):
    """They may come taut: their stiffness limits the step as if they were."""
    parts = lambda s: (s.structure.cables.stiffness, s.structure.cables.rest_length)  # noqa: E731
    slack = changed(parts, (np.full(24, 1e7), np.full(24, 2.0)))(with_gait(reference, None))
    limit, taut, state = strictest(slack, METHODS["rk4"])
    assert limit < 0.5 * stable_step(slack, state, "rk4")
    assert "cable" in limiting_part(taut, state, METHODS["rk4"])


def test_cables_that_motors_have_paid_out_count():
    """A mass between two cables, one stiff and slack at t = 0: rk4's 2.83 over sqrt(K/m) of both, as it may wind in."""
    nodes = np.array([[-1.0, 0, 0], [0, 0, 0], [1, 0, 0]])
    motor = Motor(0, [-9.0], [2.0], rate=1.0)
    cables = Members(((0, 1), (1, 2)), [1e4, 100.0], [0.8, 0.8], motors=(motor,))
    scene = Scene(Structure(nodes, [0.0, 1, 0], cables=cables, fixed=((0, "xyz"), (2, "xyz"))))
    assert step_limit(scene, "rk4").step == pytest.approx(8**0.5 / np.sqrt(1e4 + 100.0), rel=1e-3)


@pytest.mark.slow
def test_a_step_too_large_is_refused_by_name(reference):
    """What, where, the value, what was expected; the override lets it pass with a warning, and need not fail."""
    with pytest.raises(InputError, match=r"dt = 0\.003 s is too large for rk4.*0\.00136 s.*friction at node"):
        simulate(reference, 0.1, options=SolverOptions(dt=3e-3))
    with pytest.warns(
        UserWarning, match=r"dt = 0\.003 s is too large .*; the motion is wrong, whether it fails or not"
    ):
        assert not simulate(reference, 0.1, options=SolverOptions(dt=3e-3, any_step=True)).failed


def test_a_scene_that_nothing_drives_takes_any_step():
    """Free fall has no mode at all."""
    scene = Scene(Structure(np.zeros((1, 3)), np.ones(1)), gravity=9.81)
    assert stable_step(scene, standing(scene), "rk4") == np.inf


@pytest.mark.parametrize("method", [name for name, method in METHODS.items() if not method.implicit])
def test_an_absurd_step_is_refused(request, method):
    """By every explicit method, with the largest stable step in the message."""
    exact = METHODS[method].constrained
    scene = request.getfixturevalue("exact" if exact else "reference")
    if METHODS[method].symplectic:
        scene = Scene(undamped_springs(scene.structure))
    with pytest.raises(InputError, match="dt = 100 s is too large"):
        resolve(scene, 1000.0, SolverOptions(method=method, dt=100.0))


def undamped_springs(structure):
    kinds = [Members(m.edges, m.stiffness, m.rest_length) for m in (structure.struts, structure.cables)]
    return Structure(structure.nodes, structure.node_mass, *kinds)


class Anchor(EnergyTerm):
    """U = sum k r^4/4, r being the distance of a node from where it was built: soft near there, stiff far away."""

    stiffness: np.ndarray
    places: np.ndarray
    name: ClassVar[str] = "anchor"

    def energy(self, at):
        squared = norm_squared(at.q - self.places)
        return inner(self.stiffness * squared, squared) / 4

    def keeps(self, symmetry):
        return False


@pytest.mark.slow
def test_a_force_that_depends_on_the_place_is_judged_where_the_robot_is(reference):
    """Lifted far above the ground, an anchor that hardly pulls would limit the step."""
    anchored = with_terms(reference, Anchor(np.full(12, 10.0), np.asarray(reference.structure.nodes)))
    assert step_limit(anchored, "rk4").step == pytest.approx(step_limit(reference, "rk4").step, rel=1e-2)


def test_nothing_limits_the_step_where_nothing_pulls():
    """A point mass that only falls."""
    limit = step_limit(Scene(Structure(np.zeros((1, 3)), np.ones(1)), gravity=9.81), "rk4")
    assert (limit.step, limit.set_by) == (np.inf, "nothing")
