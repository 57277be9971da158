"""Landings at their own time, and friction against the mean velocity: the method `complementarity2`."""

from dataclasses import replace
from itertools import product

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxgrity
from jaxgrity import (
    ConeFriction,
    ExactGround,
    InputError,
    Members,
    Scene,
    SolverOptions,
    Sphere,
    Structure,
    gaits_of,
    load_scene,
    random_phases,
    rollout,
    simulate,
    simulate_population,
    with_contact_along_struts,
)
from jaxgrity.model import Slides, rigid_body
from jaxgrity.stepping import discretise, resolve
from jaxgrity.stepping.loop import Step, advance, carried_at
from jaxgrity.stepping.power import ground_impulses, strut_impulses

METHODS = ("complementarity", "complementarity2")
STEPS = (1e-2, 5e-3, 2.5e-3, 1.25e-3)
"""s"""


def rod(mu: float = 0.95, **ground) -> Scene:
    """A rod of two unequal masses above rough ground."""
    nodes = np.array([[0.0, 0.0, 0.5], [1.0, 0.0, 0.5]])
    struts = Members(((0, 1),), None, np.array([1.0]), None)
    return Scene(
        Structure(nodes, np.array([1.0, 1.5]), struts, None),
        gravity=9.81,
        ground=ExactGround(incline=0.0, **ground),
        friction=ConeFriction(mu),
    )


def starts(count: int, speed: float, spin: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Inclined rods just above the ground, that fall, slide and spin, m and m/s."""
    draw, found = np.random.default_rng(0), []
    for _ in range(count):
        tilt, turn, height = np.deg2rad(50 + 20 * draw.random()), 2 * np.pi * draw.random(), 0.03 + 0.05 * draw.random()
        along = np.array([np.cos(tilt) * np.cos(turn), np.cos(tilt) * np.sin(turn), np.sin(tilt)])
        foot, v = np.array([0.0, 0.0, height]), np.array([*(speed * draw.normal(size=2)), -0.3 * draw.random()])
        w = spin * draw.normal(size=3)
        found.append((np.array([foot, foot + along]), np.array([v, v + np.cross(w, along)])))
    return found


def box(mu: float) -> tuple[Scene, list[tuple[np.ndarray, np.ndarray]]]:
    """A rigid body that lands on a corner, and starts of it, m and m/s: it slides and spins."""
    size, mass, draw = np.array([0.5, 0.3, 0.2]), 2.0, np.random.default_rng(0)
    corners, turn = np.array(list(product((-0.5, 0.5), repeat=3))) * size, Rotation.from_rotvec([0.5, 0.4, 0.2])
    moments, placed = turn.as_matrix() @ np.diag(mass / 12 * (size @ size - size**2)), turn.apply(corners)
    placed[:, 2] += 0.05 - placed[:, 2].min()
    body = rigid_body(placed, range(8), mass, moments @ turn.as_matrix().T, basic=(0, 1, 2, 4))
    structure = Structure(placed, np.zeros(8), bodies=(body,))
    scene = Scene(structure, gravity=9.81, ground=ExactGround(), friction=ConeFriction(mu))
    found = []
    for height in (0.0, 0.011, 0.033, 0.047):
        v, spin = np.array([*draw.normal(size=2), -0.3 * draw.random()]), 1.5 * draw.normal(size=3)
        q = placed + np.array([0.0, 0.0, height])
        found.append((q, v + np.cross(spin, q - q.mean(0))))
    return scene, found


def errors(
    scene: Scene, begin: list, duration: float, method: str, steps=STEPS, coupled: bool | None = None
) -> np.ndarray:
    """m, of each start at each step, against a step 256 times smaller than the first."""

    def end(start, h, method):
        options = SolverOptions(method=method, dt=h, coupled=coupled)
        return rollout(scene, np.array([0.0, duration]), start=start, options=options).positions[-1]

    finest = [end(start, STEPS[0] / 256, "complementarity2") for start in begin]
    return np.array([[np.linalg.norm(end(b, h, method) - x) for h in steps] for b, x in zip(begin, finest)])


both_solvers = pytest.mark.parametrize("coupled", [False, pytest.param(True, marks=pytest.mark.slow)])


@pytest.mark.slow
def test_rods_that_land_and_stick_have_a_fifth_of_the_error():
    for spin in (0.5, 2.0):
        begin = starts(6, 0.2, spin)
        plain, timed = (
            np.median(errors(rod(), begin, 0.2, m), axis=0) for m in ("complementarity", "complementarity2")
        )
        assert (timed[:3] < plain[:3] / 3).all()
        assert np.median(timed / plain) < 0.2


@both_solvers
def test_a_landing_that_turns_the_slip_has_one_limit(coupled):
    """The plain method's answer depends there on where in a step the landing is, however small the step."""
    begin = starts(6, 1.5, 0.0)
    timed = np.median(errors(rod(0.2), begin, 0.2, "complementarity2", coupled=coupled), axis=0)
    assert timed[-1] < timed[0] / 5


@pytest.mark.slow
def test_a_rigid_body_that_lands_has_one_limit():
    """Of the plain method all errors are more than 4 mm."""
    scene, begin = box(0.2)
    coarse, fine = np.median(errors(scene, begin, 0.2, "complementarity2", steps=(1e-2, 1.25e-3)), axis=0)
    assert coarse < 4e-3
    assert fine < coarse / 4


@pytest.mark.slow
def test_both_solvers_take_the_same_steps():
    """The robot that rolls, alone and in a population: up to what sweeps leave after four rounds."""
    exact = load_scene("exact")
    gaits = gaits_of(exact.gait, random_phases(3, 6, seed=0))

    def ends(coupled):
        options = SolverOptions(method="complementarity2", coupled=coupled)
        return np.asarray(simulate_population(exact, gaits, 2.0, options=options).com_end)

    swept = ends(False)
    np.testing.assert_allclose(ends(True), swept, atol=1e-8)
    plain = simulate_population(exact, gaits, 2.0, options=SolverOptions(method="complementarity")).com_end
    assert np.linalg.norm(swept - plain, axis=1).max() > 5e-5
    alone, together = (
        simulate(exact, 2.2, options=SolverOptions(method="complementarity2", coupled=c)).positions
        for c in (False, True)
    )
    np.testing.assert_allclose(together, alone, atol=1e-7)


@both_solvers
def test_a_curved_slide_is_of_second_order(coupled):
    ground = ExactGround(incline=0.5)
    point = Scene(
        Structure(np.zeros((1, 3)), np.array([1.0]), None, None),
        gravity=9.81,
        ground=ground,
        friction=ConeFriction(0.3),
    )
    first, second = (np.asarray(t) for t in ground.tangents)
    begin = [(np.zeros((1, 3)), (x * first + y * second)[None]) for x, y in ((-2.0, 1.5), (-1.7, 2.2), (-1.5, 1.8))]
    found = np.median(errors(point, begin, 1.6, "complementarity2", coupled=coupled), axis=0)
    assert (np.log2(found[:-1] / found[1:]) > 1.8).all()


@pytest.mark.campaign
def test_rolling_robots_are_nearly_twice_as_accurate():
    exact = load_scene("exact")
    gaits = gaits_of(exact.gait, random_phases(16, 6, seed=0))

    def ends(method, h):
        options = SolverOptions(method=method, dt=h, dtype="float64")
        return np.asarray(simulate_population(exact, gaits, 3.0, options=options).com_end)

    def error(method):
        return np.median(np.linalg.norm(ends(method, 5e-3) - ends(method, 3e-4), axis=1))

    assert error("complementarity2") < error("complementarity") / 1.4


@both_solvers
@pytest.mark.parametrize("dtype", [pytest.param("float32", marks=pytest.mark.campaign), "float64"])
def test_constraints_hold_and_nothing_sinks(dtype, coupled):
    options = SolverOptions(method="complementarity2", dtype=dtype, coupled=coupled)
    rolling = simulate(load_scene("exact"), 3.0, options=options)
    tolerance = 1e-12 if dtype == "float64" else 1e-6
    assert int(rolling.failure) == 0
    assert rolling.positions[..., 2].min() > -tolerance


def test_without_friction_it_is_the_plain_method():
    smooth, (start, velocities) = replace(rod(), friction=None), starts(1, 0.2, 2.0)[0]
    one, other = (
        simulate(smooth, 0.6, options=SolverOptions(method=m), positions=start, velocities=velocities).positions
        for m in ("complementarity", "complementarity2")
    )
    assert np.min(one[..., 2]) < 1e-9
    np.testing.assert_array_equal(one, other)


def test_landings_with_friction_add_no_energy():
    """Rods that land, without weight, fluctuate as any midpoint rule does, and as with the plain method."""
    draw, count, h, scene = np.random.default_rng(1), 10000, 1e-3, replace(rod(), gravity=0.0)
    up = draw.normal(size=(count, 3))
    up[:, 2] = abs(up[:, 2])
    up /= np.linalg.norm(up, axis=1)[:, None]
    v, w = draw.normal(size=(count, 3)), 3 * draw.normal(size=(count, 3))
    v[:, 2] = -abs(v[:, 2])
    foot = np.stack([0 * v[:, 0], 0 * v[:, 0], -v[:, 2] * h * draw.random(count)], axis=1)
    q, v = np.stack([foot, foot + up], axis=1), np.stack([v, v + np.cross(w, up)], axis=1)
    mu = draw.uniform(0.0, 0.95, count)

    def gained(method):
        options = resolve(scene, 0.1, SolverOptions(method=method, dt=h))

        def after(q, v, mu):
            there = eqx.tree_at(lambda s: s.friction.mu, scene, mu)
            return rollout(there, jnp.array([0.0, 4 * h]), start=(q, v), options=options, steps=4).velocities[-1]

        def energy(v):
            return (np.array([0.5, 0.75])[:, None] * np.asarray(v) ** 2).sum((1, 2))

        return energy(jax.jit(jax.vmap(after))(q, v, mu)) / energy(v) - 1

    plain, timed = gained("complementarity"), gained("complementarity2")
    assert timed.max() < plain.max() + 1e-12 < 2e-5
    assert np.median(timed) < -0.01


@both_solvers
def test_all_momentum_is_from_the_ground_and_from_gravity(coupled):
    """The ground's impulses of a landing's second half are among those of the step."""
    scene, (q, v), h = rod(), starts(1, 0.2, 0.5)[0], 5e-3
    scheme = discretise(resolve(scene, 0.2, SolverOptions(method="complementarity2", dt=h, coupled=coupled)))
    after, pushed = carried_at(scheme, scene, 0.0, h, (q, v)), 0.0
    step = jax.jit(lambda before, t: advance(scheme, scene, (t, t + h), before))
    for t in h * np.arange(40):
        before, after = after, step(after, t)
        taken = Step(t, h, before, after)
        pull, ground = strut_impulses(scene, taken), sum(ground_impulses(scene, taken)).sum(0)
        gained = scene.structure.node_mass @ (after.motion[1] - before.motion[1])
        np.testing.assert_allclose(pull.sum(0), 0.0, atol=1e-12)
        np.testing.assert_allclose(gained, ground + np.array([0, 0, -9.81 * 2.5 * taken.kick]), atol=1e-12)
        pushed = max(pushed, abs(ground).max())
    assert pushed > 0.5


def test_a_load_between_two_cables_follows_the_rod():
    """Nodes without a strut are parts of their own, which a landing of the rod does not touch."""
    bare, load = rod(), np.array([[0.5, 0.0, 0.9]])
    cables = Members(((0, 2), (1, 2)), np.array([300.0, 300.0]), np.array([0.5, 0.5]), np.array([5.0, 5.0]))
    nodes = np.concatenate([bare.structure.nodes, load])
    scene = replace(bare, structure=Structure(nodes, np.array([1.0, 1.5, 0.3]), bare.structure.struts, cables))
    ends = [simulate(scene, 0.6, options=SolverOptions(method=m)).positions[-1] for m in METHODS]
    np.testing.assert_allclose(*ends, atol=2e-3)
    assert ends[0][:2, 2].max() < 1e-9


@pytest.mark.campaign
@pytest.mark.parametrize("problem", ["swept", "coupled", "body"])
def test_derivatives_are_those_of_the_step(problem):
    scene, (q, v) = rod(), starts(1, 0.2, 0.5)[0]
    if problem == "body":
        scene, ((q, v), *_) = box(0.5)
    coupled = problem != "swept"
    options = resolve(scene, 0.1, SolverOptions(method="complementarity2", dt=5e-3, coupled=coupled))

    def end(scale):
        times = np.array([0.0, 0.2])
        return jnp.sum(rollout(scene, times, start=(q, scale * v), options=options).positions[-1] ** 2)

    numeric = (end(1 + 1e-6) - end(1 - 1e-6)) / 2e-6
    np.testing.assert_allclose(jax.grad(end)(1.0), numeric, rtol=1e-5)
    np.testing.assert_allclose(jax.jvp(end, (1.0,), (1.0,))[1], numeric, rtol=1e-5)


def test_scenes_that_it_cannot_solve_are_refused():
    timed = SolverOptions(method="complementarity2")
    with pytest.raises(InputError, match="bounces"):
        resolve(rod(restitution=0.5), 1.0, timed)
    hill = with_contact_along_struts(replace(rod(), ground=ExactGround(surface=Sphere([0.0, 0.0, -5.0], 5.0))), 1)
    with pytest.raises(InputError, match=r"along struts.*expected 'complementarity'"):
        resolve(hill, 1.0, timed)
    nodes, edges = np.array([[0.0, 0.0, 0.5], [1.0, 0.0, 0.5], [0.0, 1.0, 0.5]]), ((0, 1), (0, 2))
    shared = replace(rod(), structure=Structure(nodes, np.ones(3), Members(edges, None, np.ones(2), None)))
    with pytest.raises(InputError, match=r"share nodes.*expected 'complementarity'"):
        resolve(shared, 1.0, replace(timed, coupled=False))
    assert resolve(shared, 1.0, timed).coupled
    bead = replace(
        rod(), structure=Structure([[0.0, 0, 0.5], [1, 0, 0.5], [0.4, 0, 0.5]], np.ones(3), rod().structure.struts)
    )
    with pytest.raises(InputError, match=r"slide along rods.*expected 'complementarity'"):
        resolve(replace(bead, terms=(Slides((2,), ((0, 1),)),)), 1.0, timed)
    given = resolve(rod(), 1.0, timed)
    with pytest.raises(InputError, match="bounces"):
        jaxgrity.stepping.resolve(rod(restitution=0.5), 1.0, given)
