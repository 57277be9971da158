"""Parameters from measurements: exact answers, what cannot be told, bad data, robots drawn from what is left."""

from collections.abc import Callable
from dataclasses import replace
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrity import (
    EnergyTerm,
    InputError,
    Members,
    PenaltyGround,
    Scene,
    Shaking,
    SolverOptions,
    Structure,
    SwitchFriction,
    simulate,
    with_terms,
)
from jaxgrity.identification import (
    Identified,
    Parameter,
    SeenAngles,
    SeenDistances,
    SeenPositions,
    SeenTensions,
    SeenTogether,
    Starts,
    changed,
    identify,
    measured_motion,
    measured_poses,
    misfit_of,
    posterior_robots,
    profile_likelihood,
    uncertainty_of,
)
from jaxgrity.identification.measurements import Measurement
from jaxgrity.identification.parameters import check_parameters
from jaxgrity.model import rigid_body
from jaxgrity.model.bodies import body_moments

STIFFNESS = Parameter("structure.cables.stiffness", spread=0.3)
MASS = Parameter("structure.node_mass", spread=0.3)
HEIGHT = SeenPositions((1,), "z")


def hanging(stiffness=100.0, damping=None) -> Scene:
    """A mass of 2 kg on a cable of 1 m: z = -1 - m g/K at rest."""
    cables = Members(((0, 1),), [stiffness], [1.0], damping=None if damping is None else [damping])
    nodes = np.array([[0.0, 0, 0], [0, 0, -1.1962]])
    return Scene(Structure(nodes, [0.0, 2.0], cables=cables, fixed=((0, "xyz"), (1, "xy"))), gravity=9.81)


def loaded(scene: Scene, load) -> Scene:
    """With the mass so many times as large."""
    return eqx.tree_at(lambda s: s.structure.node_mass, scene, scene.structure.node_mass * load)


LOADS = np.linspace(0.5, 1.5, 11)


def poses(values, noise=1e-3, **changes):
    """Heights under the loads."""
    shapes = np.zeros((len(LOADS), 2, 3))
    shapes[:, 1, 2] = -1.2
    how = dict(shapes=shapes, commands=LOADS, command=loaded) | changes
    return measured_poses(hanging(), np.asarray(values, float)[:, None], noise, HEIGHT, **how)


def heights(stiffness: float) -> np.ndarray:
    return -1 - 2 * LOADS * 9.81 / stiffness


@pytest.fixture(scope="module")
def stiffer() -> Identified:
    """A cable that is a fifth stiffer than the scene says, one pose missing."""
    seen = heights(120.0)
    seen[3] = np.nan
    return identify(hanging(), [STIFFNESS], poses(seen))


@pytest.mark.slow
def test_stiffness_and_its_error_are_those_of_the_closed_form(stiffer):
    """dz/dlogK = m g/K: s = noise/|dz/dlogK| over the loads that were seen; and the prior's pull is below that."""
    slope = 2 * np.delete(LOADS, 3) * 9.81 / 120
    expected = 1 / np.sqrt(np.sum((slope / 1e-3) ** 2) + 1 / 0.3**2)
    (estimate,) = stiffer.estimates
    np.testing.assert_allclose(estimate.value, 1.2, atol=1e-4)
    np.testing.assert_allclose(estimate.standard_error / estimate.value, expected, rtol=1e-3)
    assert estimate.interval[0] < 1.2 < estimate.interval[1]
    assert stiffer.converged
    assert stiffer.untold == ()
    np.testing.assert_allclose(stiffer.scene.structure.cables.stiffness, [120.0], rtol=1e-4)
    held_out = misfit_of(stiffer.scene, poses(heights(120.0)))
    assert held_out["rms"] < 2e-5
    assert held_out["misfit"] < 0.02


def test_intervals_widen_where_the_model_does_not_fit():
    """By the misfit: as many standard deviations as the residuals have of the noise."""
    scatter = np.random.default_rng(3).normal(0, 1e-2, len(LOADS))
    found = identify(hanging(), [STIFFNESS], poses(heights(100.0) + scatter))
    expected = np.linalg.norm(scatter) / np.sqrt(len(LOADS) - 1) / 1e-3
    np.testing.assert_allclose(found.misfit, expected, rtol=0.1)
    told = identify(hanging(), [STIFFNESS], poses(heights(100.0)))
    np.testing.assert_allclose(found.covariance, told.covariance * found.misfit**2, rtol=0.1)


@pytest.mark.slow
class Weighed(Measurement):
    """Of two columns, the first is the energy of the given shape, and nothing is measured in the second."""

    values: np.ndarray
    noise: np.ndarray

    def starts(self):
        return np.zeros(0), np.zeros(0)

    def predict(self, scene, start):
        seen = scene.potential_energy(jnp.asarray(scene.structure.nodes), 0.0)
        return jnp.stack([seen, seen])[None], jnp.zeros(0)


class Bent(EnergyTerm):
    """A law with a function among its numbers, as a network has its activation."""

    bend: Callable
    name: ClassVar[str] = "bent"

    def energy(self, at):
        return self.bend(at.q[1, 2])


def test_laws_hold_functions_in_a_fit_too():
    """And in a misfit, a column in which nothing was measured has none, without a warning."""
    scene = with_terms(replace(hanging(), gravity=None), Bent(jnp.square))
    seen = Weighed(np.array([[1.1962**2 + 120 / 2 * 0.1962**2, np.nan]]), np.full((1, 2), 1e-3))
    found = identify(scene, [STIFFNESS], seen)
    np.testing.assert_allclose(found.estimates[0].value, 1.2, rtol=1e-3)
    misfit = misfit_of(scene, seen)
    np.testing.assert_allclose(misfit["rms"], [10 * 0.1962**2, np.nan])
    np.testing.assert_allclose(misfit["misfit"], 1e4 * 0.1962**2)
    fails = eqx.tree_at(lambda s: s.structure.cables.stiffness, scene, np.array([np.nan]))
    assert misfit_of(fails, seen)["misfit"] == np.inf


def test_what_data_cannot_tell_gets_no_number():
    """Poses tell stiffness over mass alone: neither of the two, and one combination, their product."""
    found = identify(hanging(), [STIFFNESS, MASS], poses(heights(120.0)))
    assert [each.value for each in found.estimates] == [None, None]
    assert [each.interval for each in found.estimates] == [None, None]
    ((left, direction),) = found.untold
    np.testing.assert_allclose(left, 1.0, rtol=1e-3)
    np.testing.assert_allclose(np.abs(direction), np.sqrt([0.5, 0.5]), rtol=1e-3)
    assert direction[0] * direction[1] > 0
    ratio = found.scene.structure.cables.stiffness[0] / found.scene.structure.node_mass[1]
    np.testing.assert_allclose(ratio, 60.0, rtol=1e-4)
    assert "cannot tell" in found.summary()


@pytest.mark.campaign
def test_the_profile_is_that_of_the_posterior():
    """In a nearly linear problem it rises by 1 at one standard deviation."""
    seen = poses(heights(120.0))
    found = identify(hanging(), [STIFFNESS, MASS], seen)
    at = found.z[0] + np.array([-1.0, 0.0, 1.0]) * np.sqrt(found.covariance[0, 0])
    profile = profile_likelihood(hanging(), [STIFFNESS, MASS], seen, 0, at)
    np.testing.assert_allclose(profile[[0, 2]] - profile[1], 1.0, rtol=0.02)


@pytest.fixture(scope="module")
def swinging():
    """How a mass that is thrown moves on a damped cable, 100 times a second, with 2 mm of noise; and the truth."""
    truth = hanging(120.0, 0.8)
    options = SolverOptions("rk4", dt=5e-3)
    start = np.array([[0.0, 0, 0], [0, 0, -0.5]])
    moved = simulate(truth, 2.0, options=options, velocities=start)
    path = np.asarray(moved.positions)
    seen = path[:, 1, 2:] + np.random.default_rng(5).normal(0, 2e-3, (len(path), 1))
    noisy = path.copy()
    noisy[:, 1, 2:] = seen
    return np.asarray(moved.times), seen, noisy, options


BOTH = [Parameter("structure.cables.stiffness", 1.0), Parameter("structure.cables.damping", 1.0)]


@pytest.mark.parametrize("windows", [pytest.param(1, marks=pytest.mark.slow), 4])
def test_a_motion_tells_stiffness_and_damping_from_an_unknown_start(swinging, windows):
    """Within three standard errors, and to 3 % and 25 %; windows that may not miss each other tell nearly as much."""
    times, seen, path, options = swinging
    scene = hanging(100.0, 0.5)
    motion = measured_motion(scene, times, seen, 2e-3, HEIGHT, Starts(path, windows), options=options)
    found = identify(scene, BOTH, motion)
    for estimate, true, within in zip(found.estimates, (1.2, 1.6), (0.03, 0.25)):
        assert abs(estimate.value - true) < 3 * estimate.standard_error < within * true
    assert 0.8 < found.misfit < 1.2
    state = np.asarray(motion.state).copy()
    state[np.asarray(motion.spread) > 0] = found.starts[0]
    np.testing.assert_allclose(state[0, 1, 1, 2], -0.5, atol=0.02)


def test_windows_give_the_derivatives_of_the_whole(swinging):
    """Window by window they are those of the prediction as a whole, jumps included."""
    times, seen, path, options = swinging
    scene = hanging(100.0, 0.5)
    motion = measured_motion(scene, times, seen, 2e-3, HEIGHT, Starts(path, 4), options=options)
    z, start = jnp.array([0.3]), jnp.asarray(motion.starts()[0])

    def scene_at(z):
        return changed(scene, [STIFFNESS], z)

    @jax.jit
    def both_ways(z, start):
        whole = jax.jacfwd(lambda y: motion.predict(scene_at(y[:1]), y[1:]))(jnp.concatenate([z, start]))
        return motion.linearised(scene_at, z, start), whole

    ((rows, jumps), slopes), expected = both_ways(z, start)
    for found, right, size in zip(slopes, expected, (rows, jumps)):
        assert found.shape == (*size.shape, 1 + len(start))
        assert np.abs(right).max() > 0.1
        np.testing.assert_allclose(found, right, atol=1e-9 * np.abs(right).max())


@pytest.mark.parametrize("stiffness", [100.0, 60.0])
def test_windows_that_must_meet_are_fitted_in_few_steps_from_far_off(swinging, stiffness):
    """From half of the stiffness too; jumps a thousandth as large make a narrow valley, and change nothing."""
    times, seen, path, options = swinging
    scene, found = hanging(stiffness, 0.5), []
    for jump in ((1e-3, 1e-2), (1e-6, 1e-5)):
        starts = Starts(path, 4, jump=jump)
        motion = measured_motion(scene, times, seen, 2e-3, HEIGHT, starts, options=options)
        found.append(identify(scene, BOTH, motion))
    assert all(each.converged and each.steps < 20 for each in found)
    values = np.array([[each.value for each in one.estimates] for one in found])
    np.testing.assert_allclose(values[:, 0] * stiffness, 120.0, rtol=0.003)
    np.testing.assert_allclose(values[0], values[1], rtol=0.03)


def test_a_fit_that_gave_up_says_so():
    """After one step of several."""
    found = identify(hanging(), [STIFFNESS], poses(heights(200.0)), max_steps=1)
    assert not found.converged
    assert "did not converge" in found.summary()


def test_observations_see_what_they_say():
    """Of three nodes in a plane."""
    nodes = np.array([[0.0, 0, 0], [3, 0, 4], [3, 0, 0]])
    cables = Members(((0, 1), (0, 2)), [10.0, 20.0], [4.0, 3.5])
    scene = Scene(Structure(nodes, np.ones(3), cables=cables))
    everything = SeenTogether(
        (SeenPositions((1, 2), "zx"), SeenDistances(((0, 1), (1, 2))), SeenAngles(((0, 1),)), SeenTensions())
    )
    seen = jax.jit(lambda q: everything.seen(scene, q, 0.0))(nodes)
    np.testing.assert_allclose(seen, [4, 3, 0, 3, 5, 4, np.arctan2(4, 3), 10, 0], atol=1e-12)
    assert everything.columns(scene) == 9
    # an angle may be a turn away, where it is not missing; a length may not
    measured = np.array([4, 3, 0, 3, 5 + 7, 4, np.arctan2(4, 3) - 6, 10, np.nan])
    near = everything.near(scene, jnp.asarray(seen), measured)
    np.testing.assert_allclose(near, np.asarray(seen) - 2 * np.pi * (np.arange(9) == 6))


def test_parameters_change_what_they_name():
    """Factors and offsets, of all rows or of some."""
    scene = hanging()
    moved = changed(scene, [STIFFNESS, Parameter("structure.node_mass", 0.5, "offset", (1,))], np.array([1.0, 2.0]))
    np.testing.assert_allclose(moved.structure.cables.stiffness, [100 * np.exp(0.3)])
    np.testing.assert_allclose(moved.structure.node_mass, [0.0, 3.0])


def swinging_body() -> Scene:
    """A flywheel about a fixed point, held by a cable."""
    nodes = np.array([[0.0, 0, 0], [1, 0, 0], [0, 0.3, 0], [0, 0, 0.3], [1, 0, -0.5]])
    body = rigid_body(nodes, range(4), 2.0, [0.1, 0.1, 0.1], nodes[0], basic=(0,))
    cable = Members(((1, 4),), [50.0], [0.3])
    return Scene(Structure(nodes, np.zeros(5), cables=cable, fixed=((0, "xyz"), (4, "xyz")), bodies=(body,)))


def test_parameters_are_those_of_single_bodies():
    """By their numbers; a body that is not there is refused."""
    scene = swinging_body()
    (body,) = changed(scene, [Parameter("structure.bodies.0.matrix", 0.5)], np.array([1.0])).structure.bodies
    np.testing.assert_allclose(body.matrix, np.exp(0.5) * scene.structure.bodies[0].matrix)
    # a number counts in what is stored, so that no array has two names
    alias = "structure.members.0.stiffness"
    for path in (
        "structure.bodies.1.matrix",
        "structure.bodies.1.mass",
        "structure.bodies.matrix",
        "structure.bodies.-1.matrix",
        alias,
    ):
        with pytest.raises(InputError, match="the scene has no such numbers"):
            check_parameters(scene, [Parameter(path, 0.5)])


@pytest.mark.parametrize(
    "parameter",
    [
        Parameter("structure.bodies.0.matrix", 0.5, "factor", (0,)),
        Parameter("structure.bodies.0.matrix", 0.5, "offset"),
        Parameter("structure.bodies.0.mass", 0.5, "offset"),
        Parameter("structure.bodies.0.inertia", 0.5, "factor", (0,)),
        Parameter("structure.bodies.0.lengths", 0.5),
    ],
)
def test_an_impossible_body_is_no_parameter(parameter):
    """One row of its matrix alone would make it asymmetric; its lengths are those of its points."""
    with pytest.raises(
        InputError, match="would make the body impossible; expected a factor of its mass, inertia or matrix"
    ):
        check_parameters(swinging_body(), [parameter])


def test_mass_and_inertia_of_a_body_are_apart():
    """Each by its factor, about the same centre; both together are the whole matrix."""
    scene, at = (
        swinging_body(),
        lambda scene: body_moments(scene.structure.bodies[0], np.asarray(scene.structure.nodes)),
    )
    mass, centre, inertia = at(scene)
    for part, factors in (("mass", (2.0, 1.0)), ("inertia", (1.0, 2.0)), ("matrix", (2.0, 2.0))):
        found = at(changed(scene, [Parameter(f"structure.bodies.0.{part}", np.log(2.0))], np.array([1.0])))
        np.testing.assert_allclose(found[0], factors[0] * mass, rtol=1e-12)
        np.testing.assert_allclose(found[1], centre, atol=1e-12)
        np.testing.assert_allclose(found[2], factors[1] * inertia, atol=1e-12)


def test_robots_differ_in_their_bodies(stiffer):
    """As their posterior says; of mass alone, without its inertia, they cannot."""
    drawn = stiffer._replace(scene=swinging_body(), covariance=0.01 * np.eye(1), z=np.array([0.4]))
    whole, mass = (drawn._replace(parameters=(Parameter(f"structure.bodies.0.{k}", 0.5),)) for k in ("matrix", "mass"))
    factors = posterior_robots(jax.random.key(0), whole, 400).body_mass
    assert factors.shape == (400, 1)
    np.testing.assert_allclose(np.log(factors).std(), 0.5 * 0.1, rtol=0.1)
    with pytest.raises(InputError, match="robots of a population cannot differ in it"):
        posterior_robots(jax.random.key(0), mass, 3)


@pytest.mark.campaign
def test_a_motion_tells_mass_and_inertia_of_a_body_apart():
    """With a known start: a third more, and a quarter less, than the scene says. The cable's force is known."""
    scene, options = swinging_body(), SolverOptions(dt=5e-3, dtype="float64")
    parameters = [Parameter("structure.bodies.0.mass", 0.5), Parameter("structure.bodies.0.inertia", 0.5)]
    # about the joint, which is the centre, nothing moves the mass: the centre is elsewhere here
    nodes = np.asarray(scene.structure.nodes)
    body = rigid_body(nodes, range(4), 2.0, [0.1] * 3, [0.3, 0.0, 0.0], basic=(0,))
    free = tuple(each for each in scene.structure.fixed if each[0] != 0)
    scene = replace(scene, structure=replace(scene.structure, bodies=(body,), fixed=free))
    true = changed(scene, parameters, np.log([4 / 3, 3 / 4]) / 0.5)
    moved = simulate(true, 0.5, options=options, frame_rate=20.0)
    seen = np.asarray(moved.positions)[:, 1, 2:]
    start = Starts(np.asarray(moved.positions), spread=None)
    motion = measured_motion(scene, np.asarray(moved.times), seen, 1e-4, HEIGHT, start, options=options)
    estimates = identify(scene, parameters, motion).estimates
    np.testing.assert_allclose([each.value for each in estimates], [4 / 3, 3 / 4], rtol=1e-3)


@pytest.mark.campaign
def test_a_motion_tells_the_inertia_of_a_body():
    """With a known start; a third more than the scene says."""
    scene, options = swinging_body(), SolverOptions(dt=5e-3, dtype="float64")
    matrix = Parameter("structure.bodies.0.matrix", 0.5)
    true = changed(scene, [matrix], np.array([np.log(4 / 3) / 0.5]))
    moved = simulate(true, 0.5, options=options, frame_rate=20.0)
    seen = np.asarray(moved.positions)[:, 1, 2:]
    start = Starts(np.asarray(moved.positions), spread=None)
    motion = measured_motion(scene, np.asarray(moved.times), seen, 1e-4, HEIGHT, start, options=options)
    (estimate,) = identify(scene, [matrix], motion).estimates
    assert estimate.standard_error < 0.01
    np.testing.assert_allclose(estimate.value, 4 / 3, rtol=1e-4)


def test_robots_are_drawn_from_what_is_left(stiffer):
    """Factors of the identified scene, with the standard error as their deviation; likewise as half-widths."""
    robots = posterior_robots(jax.random.key(0), stiffer, 400)
    assert robots.cable_stiffness.shape == (400, 1)
    relative = stiffer.estimates[0].standard_error / stiffer.estimates[0].value
    np.testing.assert_allclose(np.std(robots.cable_stiffness), relative, rtol=0.1)
    np.testing.assert_allclose(np.mean(robots.cable_stiffness), 1.0, atol=0.2 * relative)
    width = uncertainty_of(stiffer, phase=0.03)
    np.testing.assert_allclose([width.cable_stiffness, width.phase], [np.sqrt(3) * relative, 0.03], rtol=1e-6)


def test_nodes_without_mass_have_none_in_any_robot_drawn(stiffer):
    """What is drawn are factors, and nothing times a factor is nothing."""
    drawn = stiffer._replace(parameters=(MASS,))
    factors = posterior_robots(jax.random.key(0), drawn, 20).node_mass
    assert np.isfinite(factors).all()
    assert np.ptp(factors[:, 1]) > 0
    np.testing.assert_array_equal(factors[:, 0], 1.0)


def test_two_frictions_are_not_one_factor(stiffer):
    """Robots differ in both alike: that they were identified apart would be lost."""
    both = tuple(Parameter(f"friction.{name}", 0.3) for name in ("mu_static", "mu_kinetic"))
    drawn = stiffer._replace(parameters=both, covariance=np.eye(2), z=np.zeros(2))
    with pytest.raises(InputError, match=r"friction\.mu_kinetic, friction\.mu_static: robots differ alike in them"):
        posterior_robots(jax.random.key(0), drawn, 3)
    with pytest.raises(InputError, match=r"friction\.mu_kinetic: another parameter has the same half-width"):
        uncertainty_of(drawn)


@pytest.mark.parametrize("name", ["mu_static", "mu_kinetic"])
def test_one_of_two_frictions_does_not_take_the_other_along(stiffer, name):
    """Robots of a population differ in both: the other one would be off where it was never in doubt."""
    switch = replace(hanging(), ground=PenaltyGround(1e4, 1.0), friction=SwitchFriction(0.6, 0.5, 0.01))
    one = (Parameter(f"friction.{name}", 0.3),)
    drawn = stiffer._replace(scene=switch, parameters=one, covariance=0.01 * np.eye(1), z=np.zeros(1))
    for use in (lambda: posterior_robots(jax.random.key(0), drawn, 3), lambda: uncertainty_of(drawn)):
        with pytest.raises(InputError, match=rf"friction\.{name}: robots differ alike in friction\.mu_"):
            use()


def test_robots_differ_in_no_gravity(stiffer):
    """All of a population are in the same field."""
    with pytest.raises(InputError, match="gravity: robots of a population cannot differ in it"):
        posterior_robots(jax.random.key(0), stiffer._replace(parameters=(Parameter("gravity", 0.1),)), 3)


def test_a_known_start_is_the_first_place():
    """At rest there, whatever the path does next."""
    path = np.array(hanging().structure.nodes) + 0.02 * np.sin(50 * TIMES)[:, None, None] + 0.01
    motion = measured_motion(hanging(), TIMES, np.zeros((11, 1)), 1e-3, HEIGHT, Starts(path, spread=None))
    np.testing.assert_array_equal(motion.state[0], [path[0], 0 * path[0]])


def test_supports_start_where_they_are_and_not_where_they_were_seen():
    """At rest, in every window; the other coordinates start as they were seen."""
    path = np.asarray(hanging().structure.nodes) + np.random.default_rng(0).normal(0, 0.01, (11, 2, 3))
    state = measured_motion(hanging(), TIMES, np.zeros((11, 1)), 1e-3, HEIGHT, Starts(path, windows=2)).state
    free, nodes = np.asarray(hanging().structure.free), hanging().structure.nodes
    np.testing.assert_array_equal(state[:, :, ~free], np.stack([[nodes[~free], 0 * nodes[~free]]] * 2))
    assert np.all(state[:, :, free] != np.stack([nodes[free], 0 * nodes[free]]))


def test_supports_follow_parameters_of_their_shaking_in_every_window():
    """They are where the changed scene has them, and their jumps, which are none, do not count as small residuals."""
    scene = replace(hanging(), shaking=Shaking([0.02, 0.0, 0.0], 3.3, ramp=0.05))
    path = np.broadcast_to(scene.structure.nodes, (11, 2, 3))
    options, support = SolverOptions("rk4", dt=5e-3), SeenPositions((0,), "x")
    motion = measured_motion(scene, TIMES, np.zeros((11, 1)), 1e-3, support, Starts(path, windows=2), options=options)
    twice = changed(scene, [Parameter("shaking.amplitude", 1.0)], np.array([np.log(2)]))
    seen, jumps = motion.predict(twice, jnp.asarray(motion.starts()[0]))
    expected = [2 * scene.shaking.displacement(jnp.asarray(t))[0] for t in TIMES]
    np.testing.assert_allclose(seen[:, 0], expected, atol=1e-5)
    assert np.abs(expected).max() > 0.01
    assert jumps.shape == (2,)  # of the one free coordinate, and of its velocity


def motion_of(times, values, **how):
    path = np.broadcast_to(hanging().structure.nodes, (len(times), 2, 3))
    return measured_motion(hanging(), times, values, 1e-3, HEIGHT, Starts(path, **how))


TIMES = np.linspace(0, 1, 11)
BAD = {
    "a missing column": (lambda: motion_of(TIMES, np.zeros((11, 2))), r"shape \(11, 2\); expected \(rows, 1\)"),
    "time backwards": (lambda: motion_of(TIMES[::-1], np.zeros((11, 1))), r"times\[1\] = 0\.9 s after 1 s: expected"),
    "all missing": (lambda: poses(np.full(11, np.nan)), "all 11 are missing"),
    "infinite": (lambda: poses(np.full(11, np.inf)), "is infinite"),
    "millimetres": (lambda: identify(hanging(), [STIFFNESS], poses(1e3 * heights(100.0))), "1000 times as large"),
    "kilometres": (lambda: identify(hanging(), [STIFFNESS], poses(1e-3 * heights(100.0))), "0.001 times as large"),
    "too few": (
        lambda: identify(hanging(), [STIFFNESS, MASS], poses(np.r_[heights(100.0)[:1], np.full(10, np.nan)])),
        "1 numbers measured for 2 parameters",
    ),
    "no noise": (lambda: poses(heights(100.0), noise=0.0), "noise: a standard deviation is not positive"),
    "noise of another shape": (lambda: poses(heights(100.0), noise=np.ones(3)), r"noise has shape \(3,\)"),
    "shapes": (lambda: poses(heights(100.0), shapes=np.zeros((3, 2, 3))), r"shapes has shape \(3, 2, 3\)"),
    "commands": (lambda: poses(heights(100.0), commands=LOADS[:4]), "commands has an array of shape"),
    "a gap in the path": (
        lambda: measured_motion(
            hanging(), TIMES, np.zeros((11, 1)), 1e-3, HEIGHT, Starts(np.full((11, 2, 3), [[np.nan], [0.0]]))
        ),
        r"path\[0, 0\] is not finite",
    ),
    "no parts": (
        lambda: identify(hanging(), [Parameter("gravity", 0.1, parts=())], poses(heights(100.0))),
        r"parts = \(\)",
    ),
    "windows": (lambda: motion_of(TIMES, np.zeros((11, 1)), windows=3), "windows = 3: expected a divisor of"),
    "no such node": (lambda: SeenDistances(((0, 7),)).columns(hanging()), "node = 7: expected a whole"),
    "no parameter": (lambda: identify(hanging(), [], poses(heights(100.0))), "there are none"),
    "unknown place": (
        lambda: identify(hanging(), [Parameter("structure.cables.colour", 0.1)], poses(heights(100.0))),
        "the scene has no such numbers",
    ),
    "no steps": (lambda: identify(hanging(), [STIFFNESS], poses(heights(100.0)), max_steps=0), "max_steps = 0: "),
    "no tolerance": (
        lambda: identify(hanging(), [STIFFNESS], poses(heights(100.0)), tolerance=np.nan),
        "tolerance = nan",
    ),
    "twice": (
        lambda: identify(hanging(), [STIFFNESS, STIFFNESS._replace(spread=0.1)], poses(heights(100.0))),
        "named twice",
    ),
    "no spread": (lambda: identify(hanging(), [Parameter("gravity", 0.0)], poses(heights(100.0))), "spread = 0: "),
}  # fmt: skip


@pytest.mark.parametrize(("make", "words"), BAD.values(), ids=BAD)
def test_bad_data_is_refused_in_one_line(make, words):
    """What is wrong, what was received, what was expected; nothing is fitted."""
    with pytest.raises(InputError, match=words) as refusal:
        make()
    assert "\n" not in str(refusal.value)


def test_a_profile_counts_what_starts_cost():
    """A mass that falls from an unknown start: the posterior is Gaussian, and known in closed form."""
    times, noise, spread = np.linspace(0, 0.3, 31), 0.005, (0.01, 0.05)
    seen = 1.0 - 0.12 * times - 9.9 / 2 * times**2 + noise * np.random.default_rng(1).normal(size=31)
    guess = np.zeros((31, 1, 3))
    guess[:, 0, 2] = 1.0 - 9.81 / 2 * times**2
    scene = Scene(Structure([[0.0, 0, 1.0]], [1.0]), gravity=9.81)
    start, options = Starts(path=guess, spread=spread), SolverOptions(method="rk4", dt=0.01)
    motion = measured_motion(scene, times, seen[:, None], noise, SeenPositions((0,), "z"), start, options=options)
    parameters = [Parameter("gravity", 0.5, kind="offset"), Parameter("structure.node_mass", 0.1)]
    columns = np.stack([-(times**2) / 4, np.full(31, spread[0]), times * spread[1]], 1) / noise
    left = (seen - guess[:, 0, 2]) / noise

    def least(z):
        rest, r = columns[:, 1:], left - columns[:, 0] * z
        x = np.linalg.solve(rest.T @ rest + np.eye(2), rest.T @ r)
        return np.sum((r - rest @ x) ** 2) + x @ x + z * z

    at = np.array([-0.3, 0.0, 0.4])
    found = profile_likelihood(scene, parameters, motion, 0, at)
    np.testing.assert_allclose(found - found[1], [least(z) - least(0.0) for z in at], rtol=1e-4, atol=1e-4)
