"""Impacts with restitution and friction never make energy, on one robot and on many."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrity import (
    ConeFriction,
    Cylinder,
    Differences,
    ExactGround,
    Gait,
    Members,
    Scene,
    Slope,
    SolverOptions,
    Sphere,
    Structure,
    Union,
    energy_audit,
    gaits_of,
    rollout,
    simulate,
    simulate_population,
)
from jaxgrity.model.scene import as_dtype
from jaxgrity.stepping import complementarity, resolve
from jaxgrity.stepping.discretisation import discretise, with_scales_and_mobility
from jaxgrity.stepping.loop import Step, carried_at, numbered
from jaxgrity.stepping.power import ground_impulses

ROBOTS, DT = 400, 5e-3


def thrown(mu: float = 0.3, restitution: float = 0.9, masses=(0.2, 2.0)) -> Scene:
    """A rigid strut without weight, whose light end bounces: what pushes it down pushes it sideways too."""
    structure = Structure([[0, 0, 0], [0, 0, 1.0]], masses, Members(((0, 1),), None, [1.0]))
    return Scene(structure, ground=ExactGround(restitution=restitution), friction=ConeFriction(mu))


def starts() -> tuple[np.ndarray, np.ndarray]:
    """Just above the ground, at any slope, moving and turning in any way, most of them downwards."""
    random = np.random.default_rng(0)
    along = random.normal(size=(ROBOTS, 3))
    along[:, 2] = np.abs(along[:, 2])
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    q = np.stack([0 * along, along], axis=1) + np.array([0.0, 0.0, 1e-3])
    v = random.normal(size=(ROBOTS, 2, 3)) - np.array([0.0, 0.0, 1.0])
    stretch = np.sum((v[:, 1] - v[:, 0]) * along, axis=1, keepdims=True) * along / 2
    return q, v + np.stack([stretch, -stretch], axis=1)


def works(robots: int, roughest: float, coupled: bool) -> tuple[np.ndarray, np.ndarray]:
    """(robots, steps): what the ground did in each step of robots with a friction, a restitution and masses of their
    own, and what was gained in all, as shares of their energy before the step."""
    scene = with_scales_and_mobility(as_dtype(thrown(), "float64"))
    options = resolve(scene, 1.0, SolverOptions(dt=DT, coupled=coupled))
    random = np.random.default_rng(1)
    numbers = random.uniform(size=(robots, 2)) * [roughest, 1.0], np.exp(random.normal(size=(robots, 2)))

    def rolled(numbers, q, v):
        (mu, restitution), masses = numbers
        parts = lambda s: (s.friction.mu, s.ground.restitution, s.structure.node_mass)  # noqa: E731
        own, problem, h = eqx.tree_at(parts, scene, (mu, restitution, masses)), discretise(options), jnp.asarray(DT)
        energy = lambda v: jnp.sum(masses[:, None] * v * v) / 2  # noqa: E731

        def step(before, k):
            after = numbered(problem, own, h)(before, k)
            done = Step(k * h, h, before, after)
            mean = (before.motion[1] + after.motion[1]) / 2
            by_ground = sum(jnp.sum(impulse * mean) for impulse in ground_impulses(own, done))
            was = energy(before.motion[1])
            return after, (by_ground / was, energy(after.motion[1]) / was - 1)

        return jax.lax.scan(step, carried_at(problem, own, 0 * h, h, (q, v)), jnp.arange(4))[1]

    q, v = (np.resize(x, (robots, 2, 3)) for x in starts())
    return jax.jit(jax.vmap(rolled))(numbers, q, v)  # type: ignore[return-value]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robots", "roughest", "coupled"),
    [(10_000, 1.0, False), pytest.param(1000, 3.0, True, marks=pytest.mark.campaign)],
)
def test_no_impact_makes_energy(robots, roughest, coupled):
    """With any friction, restitution and masses: by the law of Newton some would (Kane and Levinson 1985).

    Ends go along chords: of a rod that turns by an angle in a step that is known to the square of the angle. Where
    friction is nearly 1, sweeps may fail, which is said by a velocity that is none.
    """
    by_ground, gained = works(robots, roughest, coupled)
    turned = DT * np.linalg.norm(np.diff(starts()[1], axis=1), axis=2).max()
    assert np.isnan(by_ground).any(1).sum() < robots / 1000
    assert np.sum(by_ground < -1e-3) > robots / 2
    assert np.nanmax(by_ground) < 1e-12
    assert np.nanmax(gained) < turned**2


@pytest.mark.campaign
def test_by_the_law_of_newton_alone_some_gain(monkeypatch):
    """Else nothing above could fail."""
    monkeypatch.setattr(complementarity, "bounce_gains", lambda *given: jnp.zeros((), bool))
    jax.clear_caches()
    try:
        assert np.nanmax(works(ROBOTS, 1.0, False)[0]) > 0.01
    finally:
        jax.clear_caches()


def test_where_nothing_is_gained_the_law_is_that_of_newton():
    """A node leaves with e times its normal speed, and friction takes mu (1 + e) times that off the other."""
    scene = Scene(Structure([[0, 0, 1e-3]], [2.0]), ground=ExactGround(restitution=0.5), friction=ConeFriction(0.2))
    start = np.array([[0.0, 0.0, 1e-3]]), np.array([[3.0, 0.0, -2.0]])
    v = rollout(
        scene, np.array([0.0, 2 * DT]), start=start, options=resolve(scene, 1.0, SolverOptions(dt=DT))
    ).velocities[-1]
    np.testing.assert_allclose(v, [[3.0 - 0.2 * 1.5 * 2.0, 0.0, 1.0]], rtol=0, atol=1e-12)


@pytest.mark.campaign
@pytest.mark.parametrize("coupled", [False, pytest.param(True, marks=pytest.mark.campaign)])
def test_populations_bounce_as_each_robot_does(coupled):
    """With restitution and friction, whose law is chosen robot by robot."""
    q, v = starts()
    gait = Gait((0,), [0.0], [0.0], [1.0])
    scene, options = dataclasses.replace(thrown(), gait=gait), SolverOptions(dt=DT, coupled=coupled)
    gaits, own = gaits_of(gait, np.zeros((3, 1))), Differences(positions=q[:3], velocities=v[:3])
    many = simulate_population(scene, gaits, 0.1, options=options, differences=own, with_metrics=True)
    for k in range(3):
        alone = simulate(scene, 0.1, options=options, frame_rate=10.0, positions=q[k], velocities=v[k])
        np.testing.assert_allclose(many.positions[k], alone.positions[-1], rtol=0, atol=1e-12)


def test_what_a_robot_without_a_gait_does_is_no_actuation():
    """Its struts keep their lengths: what they miss by the size of the step is the scheme's."""
    audit = energy_audit(_tumbling(), 0.5, options=SolverOptions(dt=2e-3))
    assert not np.any(audit.actuation)
    assert audit.dissipated["impacts"][-1] > 0.1
    assert abs(audit.residual).max() < 2e-5 * audit.turned_over


def _tumbling() -> Scene:
    structure = Structure([[0, 0, 0.1], [0.6, 0, 0.9]], [1.0, 2.0], Members(((0, 1),), None, [1.0]))
    return Scene(structure, gravity=9.81, ground=ExactGround(), friction=ConeFriction(0.5))


CURVES = {
    "a bowl": (Sphere([0.0, 0.0, 1.0], 1.0, hollow=True), [np.sin(1.0), 0, 1 - np.cos(1.0)]),
    "a ball": (Sphere([0.0, 0.0, -1.0], 1.0), [np.sin(0.2), 0, np.cos(0.2) - 1]),
    "a log on the plane": (
        Union((Cylinder([0.0, -1, 1], [0.0, 1, 1], 1.0), Slope())),
        [np.sin(0.2), 0, np.cos(0.2) + 1 + 1e-9],
    ),
}


@pytest.mark.campaign
@pytest.mark.parametrize("curve", ["a bowl", pytest.param("a ball", marks=pytest.mark.campaign), "a log on the plane"])
def test_what_is_lost_on_a_curve_is_no_impact(curve):
    """A node without friction that slides along keeps its energy: at least as the square of the step."""
    surface, start = CURVES[curve]
    scene = Scene(Structure([start], [1.0]), gravity=9.81, ground=ExactGround(surface=surface))
    lost = [energy_audit(scene, 0.5, options=SolverOptions(dt=dt)).dissipated for dt in (2e-3, 1e-3)]
    stepping, impacts = (np.array([each[cause][-1] for each in lost]) for cause in ("stepping", "impacts"))
    assert 1e-12 < abs(stepping[0]) < 2e-4
    assert stepping[0] / stepping[1] > 3.7
    assert np.all(np.abs(impacts) < 2e-2 * np.abs(stepping))


@pytest.mark.slow
@pytest.mark.parametrize("half_angle", [0.1, *(pytest.param(a, marks=pytest.mark.campaign) for a in (0.2, 0.4))])
def test_what_is_lost_in_a_valley_is_an_impact(half_angle):
    """A node that slides down one side and meets the other keeps its velocity along it: E sin^2 of the turn is lost."""
    valley = ExactGround(surface=Union((Slope(half_angle), Slope(-half_angle))))
    start = [-0.5, 0.0, 0.5 * np.tan(half_angle)]
    scene = Scene(Structure([start], [1.0]), gravity=9.81, ground=valley)
    until = np.sqrt(2 * 0.5 / np.cos(half_angle) / (9.81 * np.sin(half_angle))) + 0.1
    found = energy_audit(scene, until, options=SolverOptions(dt=2.5e-4)).dissipated
    expected = 9.81 * start[2] * np.sin(2 * half_angle) ** 2
    assert found["impacts"][-1] == pytest.approx(expected, rel=0.03)
    assert abs(found["stepping"][-1]) < 0.02 * expected
