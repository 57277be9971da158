"""A rigid body in motion: Euler's equations, and contact at points that follow others. One program serves both."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy
from scipy.spatial.transform import Rotation

from jaxgrity import ConeFriction, ExactGround, InputError, Members, Scene, SolverOptions, Structure, rollout, simulate
from jaxgrity.model import energy_of_motion, rigid_body
from jaxgrity.stepping import resolve
from jaxgrity.stepping.dynamics import angular_momentum
from jaxgrity.stepping.rigid_multipliers import vector_field_with_multipliers

SIZE, MASS = np.array([0.5, 0.3, 0.2]), 2.0
"""m, kg, of a box"""
INERTIA = MASS / 12 * (SIZE @ SIZE - SIZE**2)
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * SIZE / 2


def box(turn: Rotation, lowest: float, gravity: float) -> Scene:
    """Its eight corners, of which four follow the others, above a rough ground."""
    turned = turn.as_matrix()
    corners = CORNERS @ turned.T
    corners[:, 2] += lowest - corners[:, 2].min()
    body = rigid_body(corners, range(8), MASS, turned @ np.diag(INERTIA) @ turned.T, basic=(0, 1, 2, 4))
    structure = Structure(corners, np.zeros(8), bodies=(body,))
    return Scene(structure, gravity, ground=ExactGround(), friction=ConeFriction(0.5))


def tumbled(spin: np.ndarray, duration: float) -> np.ndarray:
    """How a box that starts along the axes is turned after that time, by Euler's equations, to rounding."""

    def slope(_, y):
        R, w = y[:9].reshape(3, 3), y[9:]
        return np.r_[(R @ np.cross(np.eye(3), w)).ravel(), -np.cross(w, INERTIA * w) / INERTIA]

    start = np.r_[np.eye(3).ravel(), spin]
    end = scipy.integrate.solve_ivp(slope, (0, duration), start, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    return end[:9].reshape(3, 3)


@pytest.mark.slow
def test_a_body_tumbles_as_euler_says():
    """About its intermediate axis, so that it flips (Dzhanibekov): second order, with all momenta to rounding."""
    scene, spin, drift, duration = box(Rotation.identity(), 9.0, 0.0), np.array([0.01, 3.0, 0.02]), 0.2, 4.0
    centre = scene.structure.nodes.mean(0)
    v, errors = drift + np.cross(spin, scene.structure.nodes - centre), []
    expected = centre + drift * duration + CORNERS @ tumbled(spin, duration).T
    for dt in (4e-3, 2e-3):
        motion = simulate(scene, duration, options=SolverOptions(dt=dt), velocities=v, frame_rate=25.0)
        q, w = np.asarray(motion.positions), np.asarray(motion.velocities)
        errors.append(np.abs(q[-1] - expected).max())
        first, last = (angular_momentum(scene, q[k], w[k]) for k in (0, -1))
        np.testing.assert_allclose(last, first, rtol=1e-11)
        energy = [float(energy_of_motion(scene.structure, each)) for each in w]
        assert np.ptp(energy) < 1e-4 * energy[0] * (dt / 4e-3) ** 2
    assert errors[1] < 5e-5
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.1)
    distances = lambda x: np.linalg.norm(x[:, None] - x, axis=-1)  # noqa: E731
    np.testing.assert_allclose(distances(q[-1]), distances(CORNERS), atol=1e-12)


@pytest.mark.slow
def test_a_box_comes_to_rest_on_a_face():
    """The corners that follow touch the ground as well."""
    motion = simulate(box(Rotation.from_rotvec([0.4, 0.3, 0.2]), 0.1, 9.81), 1.0, options=SolverOptions(dt=2e-3))
    height = np.asarray(motion.positions)[..., 2]
    assert not motion.failed
    np.testing.assert_allclose(np.sort(height[-1]), [0] * 4 + [SIZE[2]] * 4, atol=1e-9)
    assert height.min() > -1e-12


@pytest.mark.slow
def test_methods_without_impulses_follow_euler_as_exactly_as_they_say():
    """By multipliers: an adaptive method to 1e-8, and the body keeps its shape as exactly."""
    scene, spin, duration = box(Rotation.identity(), 9.0, 0.0), np.array([0.01, 3.0, 0.02]), 4.0
    scene = dataclasses.replace(scene, ground=None, friction=None, gravity=None)
    centre = scene.structure.nodes.mean(0)
    v = np.cross(spin, scene.structure.nodes - centre)
    options = SolverOptions(method="dopri8", rtol=1e-10, atol=1e-11)
    end = np.asarray(simulate(scene, duration, options=options, velocities=v, frame_rate=1.0).positions)[-1]
    np.testing.assert_allclose(end, centre + CORNERS @ tumbled(spin, duration).T, atol=1e-8)
    distances = lambda x: np.linalg.norm(x[:, None] - x, axis=-1)  # noqa: E731
    np.testing.assert_allclose(distances(end), distances(CORNERS), atol=1e-9)


@pytest.mark.slow
def test_a_rigid_strut_between_supports_changes_nothing():
    """Methods without impulses accelerate the other nodes as without it; here one hangs from both supports."""
    x = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 0, -1]])
    cables = Members(((0, 2), (1, 2)), [100.0, 200.0], [0.5, 0.6])
    base = Members(((0, 1),), None, [1.0])
    fixed = ((0, "xyz"), (1, "xyz"))
    held, bare = (Scene(Structure(x, np.ones(3), struts, cables, fixed=fixed), 9.81) for struts in (base, None))
    (_, found), (_, wanted) = (
        vector_field_with_multipliers(0.0, (jnp.asarray(x), jnp.zeros((3, 3))), scene) for scene in (held, bare)
    )
    assert np.abs(wanted).max() > 1
    np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-12)


@pytest.mark.campaign
def test_a_top_on_its_tip_precesses_as_lagrange_says():
    """A fast symmetric top, held at its tip, in steady precession: its axis turns about the vertical at that rate."""
    mass, arm, across, along, tilt, w = 0.5, 0.1, 1e-3, 8e-4, 0.5, 200.0
    # across_tip cos(tilt) W^2 - along s W + m g l = 0, s the spin of the axis: Goldstein, section 5.7
    at_tip = across + mass * arm**2
    slow = np.roots([(at_tip - along) * np.cos(tilt), -along * w, mass * 9.81 * arm]).min()
    turned = Rotation.from_rotvec([0, tilt, 0]).as_matrix()
    nodes = np.array([[0, 0, 0], [0.1, 0, 0.1], [-0.1, 0.1, 0.1], [0, -0.1, 0.1], [0, 0, 0.2]]) @ turned.T
    axis = turned[:, 2]
    inertia = across * np.eye(3) + (along - across) * np.outer(axis, axis)
    top = rigid_body(nodes, range(5), mass, inertia, arm * axis, basic=(0,))
    scene = Scene(Structure(nodes, np.zeros(5), fixed=((0, "xyz"),), bodies=(top,)), 9.81)
    v = np.cross(slow * np.array([0, 0, 1.0]) + w * axis, nodes)
    options = SolverOptions(method="dopri8", rtol=1e-9, atol=1e-10)
    end = np.asarray(simulate(scene, 1.0, options=options, velocities=v, frame_rate=1.0).positions)[-1]
    expected = Rotation.from_rotvec([0, 0, slow]).as_matrix() @ nodes[4]
    np.testing.assert_allclose(end[4], expected, atol=1e-6)
    np.testing.assert_allclose(end[0], 0, atol=1e-12)


@pytest.mark.campaign
def test_bodies_move_in_single_precision_and_within_compiled_functions():
    """Their numbers have the precision of the options, and are known while a function around them is traced."""
    scene = box(Rotation.identity(), 0.1, 9.81)
    options, start = SolverOptions(dt=2e-3, dtype="float32"), scene.structure.nodes
    times = np.array([0.0, 0.1])
    found = jax.eval_shape(lambda v: rollout(scene, times, start=(start, v), options=options), np.zeros(start.shape))
    assert {str(x.dtype) for x in (found.positions, found.velocities)} == {"float32"}


def test_velocities_that_bend_a_body_are_refused():
    """Of a point that follows others."""
    scene = box(Rotation.identity(), 1.0, 0.0)
    (body,) = scene.structure.bodies
    with pytest.raises(InputError, match=rf"velocities\[{body.carried[0]}\]: 1 m/s beside that of its rigid body"):
        simulate(scene, 0.1, velocities=np.eye(8)[:, [body.carried[0]]] * np.array([1.0, 0, 0]))


def test_velocities_that_stretch_what_is_rigid_are_refused_where_nothing_takes_them_back():
    """A rod that grows by 0.1 m/s: impulses stop that in the first step, multipliers keep the rate they find."""
    rod = Scene(Structure([[0.0, 0, 0], [1, 0, 0]], [1.0, 1.0], Members(((0, 1),), None, [1.0])))
    growing = np.array([[0.0, 0.3, 0], [0.1, 0.3, 0]])
    for method in ("rk4", "dopri8"):
        with pytest.raises(InputError, match="m/s, and their distance is constant"):
            simulate(rod, 0.1, velocities=growing, options=SolverOptions(method, dt=0.01 if method == "rk4" else None))
    options = resolve(rod, 0.1, SolverOptions("rk4", dt=0.01))
    start = lambda v: (rod.structure.nodes, v)  # noqa: E731
    ok = jax.vmap(lambda v: rollout(rod, np.array([0.0, 0.1]), start=start(v), options=options).ok)
    np.testing.assert_array_equal(ok(np.stack([growing, growing[[0, 0]]])), [False, True])
    found = simulate(rod, 0.1, velocities=growing, options=SolverOptions(dt=0.01)).positions[-1]
    np.testing.assert_allclose(np.linalg.norm(found[1] - found[0]), 1, atol=1e-9)


def test_starts_that_bend_a_body_are_refused():
    """Wherever a point is beside its place."""
    scene = box(Rotation.identity(), 1.0, 0.0)
    (body,) = scene.structure.bodies
    for node in (body.basic[0], body.carried[0]):
        moved = scene.structure.nodes + 1e-3 * np.eye(8)[:, [node]]
        with pytest.raises(InputError, match="rigid body"):
            simulate(scene, 0.1, positions=moved)


@pytest.mark.campaign
def test_rods_are_struts_with_mass_or_bodies_of_two_points(exact):
    """The six-strut robot falls and lands the same, to rounding."""
    structure = exact.structure
    x, lengths = structure.nodes, np.asarray(structure.struts.rest_length)
    heavy = dataclasses.replace(structure, struts=dataclasses.replace(structure.struts, mass=np.full(6, 0.4)))
    rods = []
    for (i, j), length in zip(structure.struts.edges, lengths):
        along = (x[i] - x[j]) / np.linalg.norm(x[i] - x[j])
        rods.append(rigid_body(x, (i, j), 0.4, 0.4 * length**2 / 12 * (np.eye(3) - np.outer(along, along))))
    bodies = dataclasses.replace(structure, struts=None, bodies=tuple(rods))
    step = SolverOptions(dt=2.5e-3)
    ends = [
        np.asarray(simulate(dataclasses.replace(exact, structure=each, gait=None), 0.3, options=step).positions)
        for each in (heavy, bodies)
    ]
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-12)
