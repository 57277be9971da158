"""Parts that only cables join: solved apart, they move as they do when all is solved together."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrity import (
    ConeFriction,
    Differences,
    ExactGround,
    Gait,
    Members,
    Scene,
    SolverOptions,
    Structure,
    edge_lengths,
    final_state,
    gaits_of,
    simulate,
    simulate_population,
    with_gait,
)
from jaxgrity.model import Balls, rigid_body
from jaxgrity.model.scene import with_scales
from jaxgrity.stepping import coupled, resolve
from jaxgrity.stepping.complementarity import first_memory
from jaxgrity.stepping.coupled_constraints import known_at
from jaxgrity.stepping.coupled_stepping import coupled_impulses
from jaxgrity.stepping.separate_parts import separate_parts
from jaxgrity.stepping.strut_contacts import TouchingStruts

G = 9.81
OPTIONS = SolverOptions(dt=5e-3, any_step=True)


def crossed(third: bool = False, balls: int = 0) -> Scene:
    """Two crossed rods with mass in a net of cables, low above rough ground; and a pyramid that hangs between them.

    With `balls` only the first so many nodes with balls touch the ground: the fifth is one of the pyramid.
    """
    nodes = [[0, 0, 0.05], [1, 0.1, 0.6], [1, 0.9, 0.02], [0.1, 1, 0.7]]
    cables, bodies = [(0, 2), (0, 3), (1, 2), (1, 3)], ()
    if third:
        nodes += [[0.5, 0.5, 0.3], [0.7, 0.5, 0.3], [0.5, 0.7, 0.3], [0.55, 0.55, 0.5], [0.6, 0.6, 0.25]]
        cables += [(0, 4), (1, 5), (2, 6), (3, 7), (2, 8)]
    x = np.array(nodes, float)
    if third:
        bodies = (rigid_body(x, range(4, 9), 0.4, [2e-3, 2e-3, 2e-3], x[4:8].mean(0)),)
    struts = Members(((0, 1), (2, 3)), None, edge_lengths(x, ((0, 1), (2, 3))), mass=[1.0, 0.6])
    net = Members(tuple(cables), [300.0] * len(cables), 0.9 * edge_lengths(x, tuple(cables)), [2.0] * len(cables))
    touching = Balls((0, 1, 2, 3, 8)[:balls], [0.0, 0.03, 0.02, 0.0, 0.04][:balls]) if balls else None
    return Scene(
        Structure(x, np.zeros(len(x)), struts, net, bodies=bodies),
        G,
        ground=ExactGround(balls=touching),
        friction=ConeFriction(0.4),
    )


def undivided(scene: Scene) -> Scene:
    """The same with a mass of 0 of its cables, for which no part is separate."""
    cables = dataclasses.replace(scene.structure.cables, mass=np.zeros(len(scene.structure.cables.edges)))
    return dataclasses.replace(scene, structure=dataclasses.replace(scene.structure, cables=cables))


def test_parts_are_what_bodies_and_rigid_struts_join():
    """Alike ones are together; supports are no parts; all is one part where all is joined."""
    two, three = (separate_parts(crossed(third)) for third in (False, True))
    assert [alike.nodes.tolist() for alike in two] == [[[0, 1], [2, 3]]]
    assert [alike.nodes.shape for alike in three] == [(2, 2), (1, 4)]
    assert [alike.contacts.shape for alike in three] == [(2, 2), (1, 5)]
    assert separate_parts(undivided(crossed())) is None
    apart = Structure(np.eye(3), np.ones(3), fixed=((2, "xyz"),))
    (points,) = separate_parts(Scene(apart, G, ground=ExactGround()))
    assert points.nodes.tolist() == [[0], [1]]
    assert separate_parts(Scene(dataclasses.replace(apart, fixed=((2, "xyz"), (1, "xyz"))), G)) is None
    joined = dataclasses.replace(crossed().structure, fixed=((2, "xyz"), (3, "xyz")))
    assert separate_parts(dataclasses.replace(crossed(), structure=joined)) is None


@pytest.mark.parametrize(
    ("third", "balls", "fixed"),
    [
        pytest.param(False, 0, (), marks=pytest.mark.slow),
        pytest.param(True, 0, (), marks=pytest.mark.campaign),
        pytest.param(True, 5, (), marks=pytest.mark.campaign),
        pytest.param(True, 4, (), marks=pytest.mark.campaign),
        pytest.param(False, 0, ((1, "xyz"),), marks=pytest.mark.campaign),
        pytest.param(True, 0, ((0, "xz"), (7, "y")), marks=pytest.mark.campaign),
    ],
)
def test_parts_apart_move_as_all_together(third, balls, fixed):
    """They fall, hit the ground, slide and stick: to rounding."""
    scene = crossed(third, balls)
    if fixed:
        x = scene.structure.nodes
        bodies = tuple(rigid_body(x, range(4, 9), 0.4, [2e-3] * 3, x[4:8].mean(0), basic=(7,)) for _ in range(third))
        scene = dataclasses.replace(scene, structure=dataclasses.replace(scene.structure, fixed=fixed, bodies=bodies))
    assert separate_parts(scene) is not None
    apart, together = (simulate(each, 0.4, options=OPTIONS) for each in (scene, undivided(scene)))
    assert not apart.failed
    moved = np.abs(np.asarray(apart.positions) - np.asarray(apart.positions)[0]).max()
    assert moved > 0.02
    np.testing.assert_allclose(apart.positions, together.positions, rtol=0, atol=1e-10)
    np.testing.assert_allclose(apart.velocities, together.velocities, rtol=0, atol=1e-8)


@pytest.mark.campaign
def test_parts_without_a_ball_move_as_all_together():
    """Balls are on one of two rods alone; the other one, and a node of the net, touch nothing."""
    scene = crossed()
    nodes = np.r_[scene.structure.nodes, [[0.5, 0.5, 0.6]]]
    net = (*scene.structure.cables.edges, (0, 4), (2, 4), (3, 4))
    cables = Members(net, [300.0] * 7, 0.9 * edge_lengths(nodes, net), [2.0] * 7)
    mass = np.array([0.0, 0.0, 0.0, 0.0, 0.2])
    scene = dataclasses.replace(
        scene,
        structure=dataclasses.replace(scene.structure, nodes=nodes, node_mass=mass, cables=cables),
        ground=ExactGround(balls=Balls((0, 1), [0.03, 0.02])),
    )
    assert [alike.contacts.shape for alike in separate_parts(scene)] == [(1, 2), (1, 0), (1, 0)]
    apart, together = (simulate(each, 0.3, options=OPTIONS) for each in (scene, undivided(scene)))
    assert not apart.failed
    assert np.asarray(apart.positions)[:, 2, 2].min() < -0.05
    np.testing.assert_allclose(apart.positions, together.positions, rtol=0, atol=1e-10)


@pytest.mark.campaign
@pytest.mark.parametrize("third", [False, pytest.param(True, marks=pytest.mark.campaign)])
def test_derivatives_through_parts_are_those_of_differences(third):
    """In reverse mode, of a place on the ground, in friction and in a cable's rest length."""
    scene = crossed(third)
    options = resolve(scene, 0.2, OPTIONS)

    @jax.jit
    @jax.value_and_grad
    def end(x):
        there = lambda s: (s.friction.mu, s.structure.cables.rest_length)  # noqa: E731
        changed = eqx.tree_at(there, scene, (x[0], scene.structure.cables.rest_length + x[1]))
        return final_state(changed, 0.2, options)[0][2, 0]

    at, steps = np.array([0.4, 0.0]), 1e-5 * np.eye(2)
    found = end(at)[1]
    differences = [float(end(at + step)[0] - end(at - step)[0]) / 2e-5 for step in steps]
    assert min(map(abs, differences)) > 1e-4
    np.testing.assert_allclose(found, differences, rtol=1e-4)


@pytest.mark.campaign
def test_parts_stay_in_single_precision():
    single, double = (
        simulate(crossed(third=True), 0.2, options=dataclasses.replace(OPTIONS, dtype=dtype))
        for dtype in ("float32", "float64")
    )
    assert str(single.positions.dtype) == "float32"
    assert not single.failed
    np.testing.assert_allclose(single.positions, double.positions, rtol=0, atol=1e-4)


@pytest.mark.campaign
def test_robots_whose_parts_have_no_rigid_struts():
    """Side by side they move as one alone: rods with mass are springs here."""
    scene = crossed()
    struts = dataclasses.replace(scene.structure.struts, stiffness=np.full(2, 1e4), damping=np.full(2, 5.0))
    scene = dataclasses.replace(scene, structure=dataclasses.replace(scene.structure, struts=struts))
    higher = Differences(positions=scene.structure.nodes + np.array([[[0.0, 0, 0]], [[0, 0, 0.1]]]))
    options = SolverOptions(dt=1e-3, any_step=True, coupled=True)
    gait = Gait((2,), [0.0], [0.1], [2.0], 0.0, 0.01)
    both = simulate_population(scene, gaits_of(gait, np.zeros((2, 1))), 0.1, options=options, differences=higher)
    alone = simulate(with_gait(scene, gait), 0.1, options=options)
    np.testing.assert_allclose(both.positions[0], alone.positions[-1], rtol=0, atol=1e-12)


def test_bodies_aloft_are_solved_without_their_contacts(monkeypatch):
    """Two bodies of five contacts in each of three robots: those that press on the ground alone need contacts.

    Side by side all move as each robot alone, and as without the short cut.
    """
    pyramid = np.array([[0, 0, 0], [0.2, 0, 0], [0, 0.2, 0], [0.05, 0.05, 0.25], [0.1, 0.1, 0]])
    low, high = pyramid, pyramid + np.array([0, 0, 0.5])
    pairs, aside = ((low, high), (high, high), (low, low)), np.array([1, 0, 0])
    x = np.array([np.vstack([first, second + aside]) for first, second in pairs])
    bodies = tuple(rigid_body(x[0], range(k, k + 5), 0.4, [2e-3] * 3, x[0, k : k + 4].mean(0)) for k in (0, 5))
    scene = with_scales(Scene(Structure(x[0], np.zeros(10), bodies=bodies), G, ground=ExactGround()))
    scene = dataclasses.replace(scene, friction=ConeFriction(0.4))
    assert [alike.contacts.shape for alike in separate_parts(scene)] == [(2, 5)]
    h, spin = 5e-3, np.cross([0.0, 0.3, 0.0], x[0])
    free = spin - [0, 0, G * h]

    def after(q):
        v, without = jnp.asarray(spin), jnp.asarray(free)
        last = first_memory(0 * q[0, 0], h + 0 * q[0, 0], (q, v)).impulses
        found = coupled_impulses(scene, (h, h), q, known_at(scene, h, (q, v), TouchingStruts()), without, v, last)
        return found.velocity, found.error

    (found, error), search = jax.jit(jax.vmap(after))(jnp.asarray(x)), coupled._search
    np.testing.assert_allclose(error, 0, atol=1e-9)
    np.testing.assert_allclose(found, [jax.jit(after)(jnp.asarray(q))[0] for q in x], rtol=0, atol=1e-12)
    pressed = np.abs(found - free).reshape(3, 2, -1).max(2) > 1e-3
    assert pressed.tolist() == [[True, False], [False, False], [True, True]]

    def wrong(problem, *start):
        """No solution with contacts."""
        return jax.tree.map(lambda a: a if problem.contact is None else a + 1, search(problem, *start))

    monkeypatch.setattr(coupled, "_search", wrong)
    off = np.abs(jax.jit(jax.vmap(lambda q: after(q)[0]))(jnp.asarray(x)) - found).reshape(3, 2, -1).max(2)
    assert (off > 1e-3).tolist() == pressed.tolist()
    assert off[~pressed].max() < 1e-12
