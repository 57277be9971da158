"""Gradients of rollouts: forward and reverse mode against differences, smoothed ones, and both combined."""

from collections.abc import Callable
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import ndtri

from jaxgrity import (
    Distance,
    Fitness,
    Genome,
    Objective,
    SearchProblem,
    SolverOptions,
    as_dtype,
    gaits_of,
    random_phases,
)
from jaxgrity.search import distance_and_gradient, distances
from jaxgrity.search.gradients import (
    ClimbTask,
    Gradient,
    combine,
    pathwise_gradient,
    right_angled,
    smoothed_gradients,
    utilities,
)
from jaxgrity.stepping import centre_of_mass, integrate, resolve

DT = 1e-3
# (where in the scene, name): each is varied by a factor, so that all derivatives are metres.
PARAMETERS = {
    **{f"phase of strut {k}": None for k in range(6)},
    "amplitude": lambda s: s.gait.amplitude,
    "frequency": lambda s: s.gait.frequency,
    "strut stiffness": lambda s: s.structure.struts.stiffness,
    "cable stiffness": lambda s: s.structure.cables.stiffness,
    "mass": lambda s: s.structure.node_mass,
    "friction": lambda s: s.friction.mu,
}


def changed(scene, x):
    """The scene with phases moved by x[:6] (rad) and each other parameter made 1 + x[k] times as large."""
    scene = eqx.tree_at(lambda s: s.gait.phase, scene, scene.gait.phase + x[:6])
    for k, where in enumerate(PARAMETERS.values()):
        if where is not None:
            scene = eqx.tree_at(where, scene, where(scene) * (1 + x[k]))
    return scene


class Displaced(NamedTuple):
    """Horizontal displacement of the centre of mass, m, from t = 1 s, where the robot has settled, to 2 s."""

    moved: np.ndarray
    """(2,)"""
    jacobian: np.ndarray
    """(parameters, 2)"""
    differences: np.ndarray
    """(parameters, 2), central ones"""


@pytest.fixture(scope="module")
def displaced(reference):
    """The robot as it is, each parameter a little more, and a little less, side by side in one program."""
    options, count, h = resolve(reference, 2.0, SolverOptions(method="rk4", dt=DT)), len(PARAMETERS), 1e-6

    def displacement(x, start, times):
        scene = changed(reference, x)
        q, v = (values[-1] for values in integrate(start, times, scene, options).ys)
        return (centre_of_mass(scene, q) - centre_of_mass(scene, start[0]))[:2], (q, v)

    @jax.jit
    def many(start, times):
        def one(x, tangent):
            return jax.jvp(lambda x: displacement(x, start, times), (x,), (tangent,), has_aux=True)

        unit = jnp.eye(count)
        return jax.vmap(one)(jnp.concatenate([0 * unit, h * unit, -h * unit]), jnp.concatenate([unit] * 3))

    standing = jnp.asarray(reference.structure.nodes), jnp.zeros_like(reference.structure.nodes)
    _, _, (q, v) = many(standing, jnp.linspace(0.0, 1.0, 2))
    moved, slopes, _ = jax.tree.map(np.asarray, many((q[0], v[0]), jnp.linspace(1.0, 2.0, 2)))
    return Displaced(moved[0], slopes[:count], (moved[count : 2 * count] - moved[2 * count :]) / (2 * h))


@pytest.mark.slow
def test_robot_moves_and_every_parameter_matters(displaced):
    assert np.linalg.norm(displaced.moved) > 1e-3
    assert np.all(np.linalg.norm(displaced.jacobian, axis=1) > 1e-4)


@pytest.mark.campaign
@pytest.mark.parametrize("k", range(len(PARAMETERS)), ids=list(PARAMETERS))
def test_derivative_is_that_of_central_differences(displaced, k):
    """To 1e-6, of the same discrete map: RK4 at a fixed step."""
    expected = displaced.differences[k]
    np.testing.assert_allclose(displaced.jacobian[k], expected, rtol=0, atol=1e-6 * np.linalg.norm(expected))


class Differentiated(NamedTuple):
    """Distances of three gaits after 2 s, in float64."""

    distance: Callable
    """of phases, (3, 6)"""
    both: Callable
    """the same and its gradient by reverse mode, compiled"""
    phase: np.ndarray
    gradient: np.ndarray
    """at `phase`"""


@pytest.fixture(scope="module", params=[pytest.param("reference", marks=pytest.mark.campaign), "exact"])
def differentiated(request):
    """By each of the two contact models."""
    scene = as_dtype(request.getfixturevalue(request.param), "float64")
    step = 1e-3 if request.param == "reference" else 1e-2
    options = resolve(scene, 2.0, SolverOptions(dt=step, dtype="float64"))
    phase = random_phases(3, 6, seed=5)

    def distance(phase):
        return distances(scene, gaits_of(scene.gait, phase), 2.0, options)

    both = jax.jit(lambda phase: distance_and_gradient(scene, gaits_of(scene.gait, phase), 2.0, options))
    return Differentiated(distance, both, phase, np.asarray(both(phase)[1]))


@pytest.mark.slow
def test_reverse_mode_gradient_is_the_derivative(differentiated):
    """Against central differences over the first second of the gait; h = 1e-5 leaves an error of about 1e-9."""
    both, phase = differentiated.both, differentiated.phase
    for k in (0, 4):
        step = np.zeros(6)
        step[k] = 1e-5
        slope = (both(phase + step)[0] - both(phase - step)[0]) / 2e-5
        np.testing.assert_allclose(differentiated.gradient[:, k], slope, rtol=1e-5, atol=1e-7)


@pytest.mark.campaign
def test_reverse_mode_is_forward_mode(differentiated):
    """The same derivative of the same steps, to rounding, by both modes and both methods."""
    distance, _, phase, gradient = differentiated
    tangents = np.broadcast_to(np.eye(6)[:, None], (6, 3, 6))
    forward = jax.jit(lambda phase: jax.lax.map(lambda t: jax.jvp(distance, (phase,), (t,))[1], tangents))(phase)
    assert np.abs(gradient).max() > 1e-3
    np.testing.assert_allclose(gradient, forward.T, rtol=0, atol=1e-9 * np.abs(gradient).max())


def climbing(scene, duration, objective=None):
    """The problem of a distance, or of another objective, on a model in float64."""
    options = resolve(scene, duration, SolverOptions(dt=1e-2, dtype="float64"))
    genome = Genome(len(scene.gait.members))
    problem = SearchProblem(as_dtype(scene, "float64"), genome, duration, Fitness(objective or Distance()))
    return ClimbTask(problem, options, problem.judging(options), width=1e-3)


@pytest.mark.parametrize(
    "body", [pytest.param("swimmer", marks=pytest.mark.slow), pytest.param("exact", marks=pytest.mark.campaign)]
)
def test_smoothed_and_pathwise_gradients_agree(body, request):
    """In the first second of a gait, where the distance is smooth: in the same direction.

    For two genes, whose directions are all of one length, ranks make the smoothed one a third longer.
    """
    task = climbing(request.getfixturevalue(body), 2.0)
    genes = jnp.asarray(random_phases(1, task.problem.genome.size, seed=7)[0] / (2 * np.pi))
    row = smoothed_gradients(jax.random.key(0), genes[None], task, 2.0, 512, 1)
    smoothed = jax.tree.map(lambda x: np.asarray(x)[0], row)
    pathwise = pathwise_gradient(jax.random.key(0), genes, task, 2.0, 4)
    assert float(pathwise.noise) < 1e-20
    assert float(smoothed.value) == pytest.approx(float(pathwise.value), abs=1e-4)
    error = float(np.sqrt(smoothed.noise))
    assert error < 0.2 * np.linalg.norm(pathwise.mean)
    longer = np.linalg.norm(smoothed.mean) / np.linalg.norm(pathwise.mean)
    assert np.linalg.norm(smoothed.mean / longer - pathwise.mean) < 2 * error
    assert 1.0 < longer < 1.5


class DistanceOfNodes(Objective):
    """The distance, read from where all nodes, which are alike, are at the end."""

    unit: ClassVar[str] = "m"
    needs_metrics: ClassVar[bool] = False
    any_heading: ClassVar[bool] = True

    def worth(self, scene, outcomes, duration):
        moved = (outcomes.positions.mean(1) - outcomes.com_start)[:, :2]
        return jnp.where(outcomes.failure == 0, jnp.sqrt(jnp.sum(moved * moved, axis=1)), jnp.nan)


@pytest.mark.slow
def test_objectives_may_read_all_that_came_of_a_rollout(swimmer):
    """In pathwise gradients too."""
    genes = jnp.asarray(random_phases(1, 2, seed=7)[0] / (2 * np.pi))
    found = [
        pathwise_gradient(jax.random.key(0), genes, climbing(swimmer, 2.0, objective), 2.0, 4)
        for objective in (Distance(), DistanceOfNodes())
    ]
    assert np.abs(found[0].mean).max() > 1e-6
    np.testing.assert_allclose(found[1].mean, found[0].mean, rtol=1e-9)


def test_directions_are_at_right_angles():
    """As many at a time as there are genes, so that their mean square is 1 in all directions; and drawn anew."""
    found = np.asarray(right_angled(jax.random.key(0), (2, 7, 3), "float64"))
    np.testing.assert_allclose(found[:, :3] @ found[:, :3].swapaxes(1, 2), [3 * np.eye(3)] * 2, atol=1e-12)
    mean_square = np.einsum("kpi,kpj->kij", found[:, :6], found[:, :6]) / 6
    np.testing.assert_allclose(mean_square, [np.eye(3)] * 2, atol=1e-12)
    assert np.ptp(found, axis=(0, 1)).min() > 0.1


ranked = jax.jit(utilities)


def test_utilities_rank_gaits():
    """The best weighs most and the worse half alike, however far it falls or fails; nothing is known where a quarter
    failed."""
    normal = np.random.default_rng(0).permutation(ndtri((np.arange(64) + 0.5) / 64))
    fitness = 3 + 0.1 * normal
    found, scale = ranked(fitness)
    assert np.argmax(found) == np.argmax(fitness)
    assert np.ptp(found[fitness < 3]) == 0
    for fallen in (-9.0, -np.inf):
        other, same = ranked(np.where(fitness == fitness.min(), fallen, fitness))
        np.testing.assert_array_equal(other, found)
        assert same == scale
    some = np.arange(12.0)
    assert ranked(np.where(some < 2, -np.inf, some))[1] > 0
    assert ranked(np.where(some < 3, -np.inf, some))[1] == 0


def test_utilities_covary_with_a_normal_fitness_as_it_does():
    """Of 64 gaits, over 2000 samples, to 5%: the scaled ones have its variance for a covariance with it."""
    samples = 0.3 * np.random.default_rng(0).normal(size=(2000, 64))
    found, scale = jax.jit(jax.vmap(utilities))(samples)
    covariance = np.mean((found - found.mean(1, keepdims=True)) * np.asarray(scale)[:, None] * samples)
    assert covariance == pytest.approx(0.09, rel=0.05)


def test_gradients_are_combined_by_their_variances():
    """A quarter of the variance has four times the weight; one that is not finite has none."""
    one, other = Gradient(1.0, np.array([1.0, 0.0]), 4.0), Gradient(2.0, np.array([0.0, 1.0]), 1.0)
    both, share = combine(one, other)
    assert float(share) == pytest.approx(0.8)
    np.testing.assert_allclose(both.mean, [0.2, 0.8])
    assert float(both.noise) == pytest.approx(0.8)
    for nothing in (Gradient(2.0, np.zeros(2), np.nan), Gradient(2.0, np.full(2, np.nan), np.nan)):
        both, share = combine(one, nothing)
        assert float(share) == 0
        np.testing.assert_allclose(both.mean, one.mean)
        assert both.noise == 4
        both, share = combine(nothing, one)
        assert float(share) == 1
        np.testing.assert_allclose(both.mean, one.mean)
        assert both.noise == 4
    certain = Gradient(1.0, np.ones(2), 0.0)
    assert np.isfinite(combine(certain, certain)[0].mean).all()
