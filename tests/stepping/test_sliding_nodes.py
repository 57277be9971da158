"""Nodes that slide along lines: exact solutions, momenta, energy, derivatives, and both ways to keep them on."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import eigh
from scipy.spatial.transform import Rotation

from jaxgrity import (
    ConeFriction,
    ExactGround,
    InputError,
    Members,
    Scene,
    SolverOptions,
    Structure,
    energy_audit,
    final_state,
    forces_along,
    simulate,
)
from jaxgrity.model import Slides, energy_of_motion, rigid_body
from jaxgrity.stepping import resolve
from jaxgrity.stepping.dynamics import angular_momentum
from jaxgrity.stepping.linearised import linearise

ROD, BEAD, LENGTH, G = 2.0, 0.5, 1.0, 9.81
"""kg, kg, m, m/s^2"""
ONE = Slides((2,), ((0, 1),))
TIGHT = SolverOptions(method="dopri8", rtol=1e-11, atol=1e-12)


def steps_of(dt: float) -> SolverOptions:
    return SolverOptions(method="complementarity", dt=dt)


def rod_with_bead(nodes: np.ndarray, **other) -> Scene:
    """A rigid rod from node 0 to node 1, and a point mass on it."""
    rod = Members(((0, 1),), None, [LENGTH], mass=[ROD])
    fixed = other.pop("fixed", ())
    return Scene(Structure(nodes, [0.0, 0.0, BEAD], rod, fixed=fixed), terms=(ONE,), **other)


def integrated(slope, start: list[float], duration: float) -> np.ndarray:
    return solve_ivp(slope, (0, duration), start, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]


TURN, SPIN, FIRST = Rotation.from_rotvec([0.7, -0.4, 1.1]).as_matrix(), 3.0, 0.1
"""Of rods that turn in a plane askew: this plane, rad/s, and m from the centre of the rod to where it slides."""


def slid_out(mu: float) -> tuple[float, np.ndarray]:
    """That distance after 1 s, m, and the direction of the rod: r'' = r w^2 and (I + mu r^2) w = constant."""
    inertia = ROD * LENGTH**2 / 12
    rate = lambda r: (inertia + mu * FIRST**2) * SPIN / (inertia + mu * r * r)  # noqa: E731
    r, _, angle = integrated(lambda _, y: [y[1], y[0] * rate(y[0]) ** 2, rate(y[0])], [FIRST, 0.0, 0.0], 1.0)
    return r, np.array([np.cos(angle), np.sin(angle), 0])


def spinning() -> tuple[Scene, np.ndarray, np.ndarray]:
    """A free rod that turns, with a bead: the scene, velocities, and where rod and bead are after 1 s."""
    flat = np.array([[-LENGTH / 2, 0, 0], [LENGTH / 2, 0, 0], [FIRST, 0, 0]])
    r, along = slid_out(BEAD * ROD / (BEAD + ROD))
    v = np.cross([0, 0, SPIN], flat)
    shares = np.array([ROD / 2, ROD / 2, BEAD]) / (ROD + BEAD)
    end = np.outer([-LENGTH / 2, LENGTH / 2, r], along)
    end += shares @ (flat + v) - shares @ end
    return rod_with_bead(flat @ TURN.T), v @ TURN.T, end @ TURN.T


def through_a_ring() -> tuple[Scene, np.ndarray, np.ndarray]:
    """The same of a rod that slides through a support, at the origin."""
    flat = np.array([[FIRST - LENGTH / 2, 0, 0], [FIRST + LENGTH / 2, 0, 0], [0, 0, 0]])
    r, along = slid_out(ROD)
    end = np.outer([r - LENGTH / 2, r + LENGTH / 2, 0], along)
    v = np.cross([0, 0, SPIN], flat)
    return rod_with_bead(flat @ TURN.T, fixed=((2, "xyz"),)), v @ TURN.T, end @ TURN.T


@pytest.mark.campaign
@pytest.mark.parametrize("start", [spinning, through_a_ring])
def test_a_rod_that_turns_slides_out(start):
    """The bead passes the end, at 0.5 m, and the rod leaves the ring. Second order; momenta to rounding."""
    scene, v, expected = start()
    errors = []
    for dt in (0.01, 0.005):
        motion = simulate(scene, 1.0, options=steps_of(dt), velocities=v, frame_rate=1.0)
        q, w = np.asarray(motion.positions), np.asarray(motion.velocities)
        errors.append(np.abs(q[-1] - expected).max())
        first, last = (angular_momentum(scene, q[k], w[k]) for k in (0, -1))
        np.testing.assert_allclose(last, first, rtol=1e-11)
        if not scene.structure.fixed:
            mass = np.asarray(scene.structure.lumped_mass)
            np.testing.assert_allclose(mass @ q[-1], mass @ (q[0] + v), rtol=1e-12)
        assert ONE.gaps(q[-1], 0.0).max() < 1e-12
    assert np.linalg.norm(expected[2] - expected[:2].mean(0)) > LENGTH / 2
    assert errors[1] < 5e-4
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.1)


@pytest.mark.slow
def test_methods_without_impulses_keep_a_bead_on_the_rod():
    """By multipliers, to their tolerance, and energy with it."""
    scene, v, expected = spinning()
    motion = simulate(scene, 1.0, options=TIGHT, velocities=v, frame_rate=1.0)
    np.testing.assert_allclose(motion.positions[-1], expected, atol=1e-8)
    first, last = (float(energy_of_motion(scene.structure, motion.velocities[k])) for k in (0, -1))
    assert last == pytest.approx(first, rel=1e-9)
    assert ONE.gaps(np.asarray(motion.positions[-1]), 0.0).max() < 1e-9
    off = v + 0.5 * np.outer([0, 0, 1], v[1] / np.linalg.norm(v[1]))
    with pytest.raises(InputError, match=r"node 2 moves 0\.5 m/s across the line through nodes \[0, 1\]"):
        simulate(scene, 1.0, options=TIGHT, velocities=off)


def swinging() -> tuple[Scene, np.ndarray]:
    """A rod on a pivot that falls, with a bead that slides down on it; where that is after 0.5 s."""
    nodes, inertia = np.array([[0, 0, 0], [0.8, 0, 0.6], [0.4, 0, 0.3]]), ROD * LENGTH**2 / 3

    def slope(_, y):
        r, rate, angle, w = y
        moment = (ROD * LENGTH / 2 + BEAD * r) * G * np.cos(angle) + 2 * BEAD * r * rate * w
        return [rate, r * w * w - G * np.sin(angle), w, -moment / (inertia + BEAD * r * r)]

    r, _, angle, _ = integrated(slope, [0.5, 0.0, np.arctan2(0.6, 0.8), 0.0], 0.5)
    end = r * np.array([np.cos(angle), 0, np.sin(angle)])
    return rod_with_bead(nodes, gravity=G, fixed=((0, "xyz"),)), end


@pytest.mark.campaign
def test_a_slide_does_no_work():
    """The audit books what a step errs by as such, of second order, and nothing else; forces agree."""
    scene, expected = swinging()
    given = ((steps_of(0.005), 100.0), (TIGHT, 400.0))
    motions = [simulate(scene, 0.5, options=options, frame_rate=rate) for options, rate in given]
    errors = [np.abs(np.asarray(each.positions)[-1, 2] - expected).max() for each in motions]
    assert errors[0] < 2e-4
    assert errors[1] < 1e-8
    by_impulses, by_multipliers = (forces_along(scene, each) for each in motions)
    for name in ("tension", "supports"):
        found, each = (getattr(forces, name)[:, 0] for forces in (by_impulses, by_multipliers))
        # impulses of steps are means from the middle of one to that of the next, and frames have two
        mean = (each[3:-4:4] / 2 + each[4:-3:4] + each[5:-2:4] + each[6:-1:4] + each[7::4] / 2) / 4
        assert np.ptp(mean, axis=0).max() > 5
        np.testing.assert_allclose(found[1:-1], mean, atol=0.05)
    lost = []
    for dt in (0.01, 0.005):
        audit = energy_audit(scene, 0.5, options=steps_of(dt))
        assert set(audit.dissipated) == {"stepping"}
        lost.append(abs(audit.dissipated["stepping"][-1]))
        assert np.abs(audit.residual).max() < 2e-4 * audit.turned_over * (dt / 0.01) ** 2
        assert np.abs(audit.angular_residual).max() < 1e-12
    assert np.log2(lost[0] / lost[1]) == pytest.approx(2, abs=0.1)
    audit = energy_audit(scene, 0.5, options=TIGHT)
    assert not audit.dissipated
    assert np.abs(audit.residual).max() < 1e-6


@pytest.mark.slow
def test_a_bead_falls_along_a_fixed_rail():
    """By g sin(a) t^2/2, exactly in steps of any size; the rail is a strut with stiffness, and its ends do not move."""
    rail = Members(((0, 1),), [1e4], [LENGTH])
    start, direction = np.array([0.3, 0.2, 0.1]), np.array([0.48, 0.64, -0.6])
    nodes = np.array([[0, 0, 0], direction, 0.1 * direction]) + start
    scene = Scene(Structure(nodes, [0, 0, BEAD], rail, fixed=((0, "xyz"), (1, "xyz"))), gravity=G, terms=(ONE,))
    motion = simulate(scene, 0.6, options=steps_of(0.05), frame_rate=5.0)
    along = 0.1 + G * 0.6 * np.asarray(motion.times) ** 2 / 2
    np.testing.assert_allclose(motion.positions[:, 2], start + np.outer(along, direction), atol=1e-12)


def joined() -> Scene:
    """A box whose corner, which follows others, slides along a spring; a point mass slides along one of its edges.

    Cables pull at both from rest.
    """
    turned = Rotation.from_rotvec([0.3, 0.5, -0.2]).as_matrix()
    box = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * [0.5, 0.3, 0.2] @ turned.T
    # 0 to 7 the corners; 8 and 9 the ends of the spring through corner 7; 10 on the edge from 3 to 7
    across = np.array([0.3, -0.5, 0.7])
    more = [box[7] + 0.4 * across, box[7] - 0.6 * across, 0.7 * box[3] + 0.3 * box[7]]
    nodes = np.concatenate([box, more])
    body = rigid_body(nodes, range(8), 2.0, turned @ np.diag([0.022, 0.048, 0.057]) @ turned.T, basic=(0, 1, 2, 4))
    assert {3, 7} <= set(body.carried)
    structure = Structure(
        nodes,
        np.r_[np.zeros(8), 0.6, 0.4, 0.3],
        Members(((8, 9),), [300.0], [0.8], damping=[1.0]),
        Members(((8, 0), (10, 9), (10, 1)), [40.0, 30.0, 50.0], [0.3, 0.4, 0.2]),
        bodies=(body,),
    )
    return Scene(structure, gravity=G, terms=(Slides((7, 10), ((8, 9), (3, 7))),))


@pytest.mark.campaign
def test_points_of_bodies_slide_and_have_lines():
    """Both ways to keep them agree to second order, also where the line is a spring that gets longer."""
    scene = joined()
    exact = simulate(scene, 0.3, options=TIGHT, frame_rate=10.0)
    q = np.asarray(exact.positions)
    places = (q[:, 10] - q[:, 3]) @ (q[0, 7] - q[0, 3])
    assert np.ptp(places) > 0.01
    assert np.ptp(np.linalg.norm(q[:, 8] - q[:, 9], axis=1)) > 0.01
    assert scene.terms[0].gaps(q[-1], 0.0).max() < 1e-8
    errors = []
    for dt in (2e-3, 1e-3):
        motion = simulate(scene, 0.3, options=steps_of(dt), frame_rate=10.0)
        errors.append(np.abs(np.asarray(motion.positions) - q).max())
        assert scene.terms[0].gaps(np.asarray(motion.positions)[-1], 0.0).max() < 1e-11
    assert errors[1] < 1e-3
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.2)


@pytest.mark.slow
def test_a_rod_with_a_bead_lands():
    """Exact contact and a slide in one step."""
    nodes = np.array([[0, 0, 0.1], [0.8, 0, 0.7], [0.32, 0, 0.34]])
    scene = rod_with_bead(nodes, gravity=G, ground=ExactGround(), friction=ConeFriction(0.5))
    motion = simulate(scene, 1.0, options=steps_of(2e-3))
    assert not motion.failed
    q = np.asarray(motion.positions)
    assert q[..., 2].min() > -1e-12
    np.testing.assert_allclose(q[-1, :, 2], 0, atol=1e-9)
    assert max(ONE.gaps(each, 0.0).max() for each in q) < 1e-9


@pytest.mark.slow
def test_derivatives_are_those_of_differences():
    """By masses, gravity and the start of the bead, in reverse mode."""
    scene, _ = swinging()
    options = resolve(scene, 0.2, steps_of(0.01))

    def end(x):
        structure = scene.structure
        bead = structure.nodes[0] + x[3] * (structure.nodes[1] - structure.nodes[0])
        rod = dataclasses.replace(structure.struts, mass=x[:1])
        structure = dataclasses.replace(
            structure,
            nodes=jnp.asarray(structure.nodes).at[2].set(bead),
            struts=rod,
            node_mass=jnp.zeros(3).at[2].set(x[1]),
        )
        q, _ = final_state(dataclasses.replace(scene, structure=structure, gravity=x[2]), 0.2, options)
        return jnp.sum(q * jnp.array([[0.0], [0.5], [1.0]]) * jnp.array([1.0, 0.3, -0.7]))

    x, step = jnp.array([ROD, BEAD, G, 0.5]), 1e-5
    run = jax.jit(end)
    expected = [(run(x.at[k].add(step)) - run(x.at[k].add(-step))) / (2 * step) for k in range(4)]
    assert np.abs(expected).min() > 1e-4
    np.testing.assert_allclose(jax.jit(jax.grad(end))(x), expected, rtol=1e-6)


def test_small_motions_know_that_slides_turn():
    """A rod on a pivot carries a bead that springs hold: the bead's weight along the rod grows as it turns."""
    nodes = np.array([[0, 0, 0], [1.0, 0, 0], [0.6, 0, 0], [1.0, 0, -1.0], [-1.0, 0, 0]])
    pull = (ROD / 2 + 0.6 * BEAD) * G
    held = Members(((1, 3), (2, 4)), [400.0, 50.0], [1 + pull / 400, 1.6])
    joint = Structure(
        nodes,
        [0, 0, BEAD, 0, 0],
        Members(((0, 1), *held.edges), [1e9, *held.stiffness], [1.0, *held.rest_length], mass=[ROD, 0, 0]),
        fixed=((0, "xyz"), (1, "y"), (2, "y"), (3, "xyz"), (4, "xyz")),
    )
    linear = linearise(Scene(joint, gravity=G, terms=(ONE,)), (nodes, 0 * nodes))

    def energy(y):
        angle, r = y
        along = jnp.array([jnp.cos(angle), 0, jnp.sin(angle)])
        first, second = (jnp.linalg.norm(x - nodes[k]) for x, k in ((along, 3), (r * along, 4)))
        springs = 400.0 * (first - held.rest_length[0]) ** 2 / 2 + 50.0 * (second - 1.6) ** 2 / 2
        return springs + (ROD / 2 + BEAD * r) * G * jnp.sin(angle)

    at = jnp.array([0.0, 0.6])
    np.testing.assert_allclose(jax.jit(jax.grad(energy))(at), 0, atol=1e-9)
    mass = np.diag([ROD / 3 + BEAD * 0.36, BEAD])
    expected = np.sqrt(eigh(jax.jit(jax.hessian(energy))(at), mass, eigvals_only=True))
    found = np.sort(np.abs(np.linalg.eigvals(linear.stiffness))) ** 0.5
    np.testing.assert_allclose(found[:2], expected, rtol=1e-5)
