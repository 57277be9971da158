"""Closed loops: what a policy makes of a robot is the scene's own motion, for one robot, for many, and in gradients."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxgrity
from jaxgrity import (
    ExactGround,
    Gait,
    InputError,
    Members,
    PenaltyGround,
    Push,
    SolverOptions,
    Structure,
    control,
)
from jaxgrity.control import Errors, MotorLimits, Observation, OpenLoop, PhaseLocked, Sensors, Steered, centre_offsets
from jaxgrity.control.closed_loop import Loop, taken_over
from jaxgrity.structures import quadruped, superball

TEN_MS = SolverOptions(dt=0.01)
measure = eqx.filter_jit(control.measure)


@pytest.fixture(scope="module")
def scene():
    """The exact robot, whose gait begins at once."""
    gait = replace(jaxgrity.load_gait("lasting"), start=np.array(0.0), ramp=np.array(0.2))
    return jaxgrity.with_gait(jaxgrity.load_scene("exact"), gait)


@pytest.fixture(scope="module")
def plant(scene):
    return control.plant_of(scene, scene.gait.members, options=TEN_MS)


@pytest.fixture(scope="module")
def rolled(scene, plant):
    """Under the gait as an open loop, for 0.6 s."""
    return control.simulate_policy(plant, OpenLoop(scene.gait), 0.6)


def test_an_open_loop_is_the_gait(scene, rolled):
    """Where commands come as often as steps, to rounding."""
    own = jaxgrity.simulate(scene, 0.6, options=TEN_MS)
    np.testing.assert_allclose(rolled.positions, own.positions, atol=1e-12)
    assert np.ptp(own.positions[:, 0, 2]) > 0.01


@pytest.mark.campaign
@pytest.mark.parametrize("name", ["exact", "reference"])
def test_forces_of_a_closed_loop_are_those_of_its_commands(name, scene, tmp_path):
    """Also from the file that the motion is saved to. Commands are linear between control periods, the gait is not.

    Not in the last frame, whose forces on exact contact are means over a step that is not commanded.
    """
    scene = jaxgrity.with_gait(jaxgrity.load_scene(name), scene.gait)
    driven = control.simulate_policy(control.plant_of(scene, scene.gait.members), OpenLoop(scene.gait), 0.2)
    expected = jaxgrity.forces_along(scene, jaxgrity.simulate(scene, 0.2)).tension
    jaxgrity.formats.save_trajectory(driven, tmp_path / "motion.npz")
    again = jaxgrity.formats.load_trajectory(tmp_path / "motion.npz")
    for motion in (driven, again):
        found = jaxgrity.forces_along(motion.scene, motion).tension
        np.testing.assert_allclose(found[-10:-1], expected[-10:-1], atol=0.01 * np.abs(expected).max())
    if name == "reference":
        unknown = jaxgrity.forces_along(driven.scene, replace(driven, commands=None)).tension
        assert np.abs(unknown - expected).max() > 500  # N: springs with the rest lengths that they were built with


def test_feedback_without_gains_is_the_open_loop(scene, plant, rolled):
    """The clock then keeps time."""
    kept = control.simulate_policy(plant, PhaseLocked(scene.gait, np.zeros((2, 2))), 0.6)
    np.testing.assert_allclose(kept.positions, rolled.positions, atol=1e-10)


@pytest.fixture(scope="module")
def driver(scene):
    """A policy with all that feedback and steering have."""
    gains = np.array([[0.3, -0.2], [0.1, 0.2]])
    inner = PhaseLocked(scene.gait, gains)
    return Steered(inner, np.array(0.3), centre_offsets(scene.structure, scene.gait.members), goal=np.array([3.0, 4.0]))


@pytest.mark.campaign
def test_robots_side_by_side_move_as_each_alone(scene, plant, driver):
    """To rounding; they start apart, and one is pushed."""
    q, v = (np.repeat(np.asarray(x)[..., None], 2, axis=-1) for x in (scene.structure.nodes, np.zeros((12, 3))))
    v[:, 0, 1] += 0.3
    many = control.side_by_side(plant, 2)
    end = control.drive(many, driver, control.loop_start(many, driver, jax.random.key(0), (q, v)), 20, 2)
    for k in range(2):
        alone = control.simulate_policy(plant, driver, 0.4, start=(q[..., k], v[..., k]))
        np.testing.assert_allclose(end.end.plant.motion[0][..., k], alone.positions[-1], atol=1e-9)
    assert end.path.shape == (3, 3, 2)
    assert abs(end.path[-1, :, 0] - end.path[-1, :, 1]).max() > 0.01


@pytest.mark.campaign
def test_a_model_takes_over_a_robot_in_motion(scene):
    """With its contractions, its memory and its time: on penalty contact, where no solver carries anything, exactly."""
    twin = jaxgrity.contact_twin(scene)
    plant = control.plant_of(twin, scene.gait.members)
    policy = PhaseLocked(scene.gait)
    loop = control.drive(plant, policy, control.loop_start(plant, policy, jax.random.key(0)), 120).end
    many = control.side_by_side(plant, 2)
    on = control.drive(plant, policy, loop, 20).end.plant.motion[0]
    copies = control.drive(many, policy, taken_over(many, loop, 2), 20).end.plant.motion[0]
    for k in range(2):
        np.testing.assert_allclose(copies[..., k], on, atol=1e-10)
    assert np.abs(on - loop.plant.motion[0]).max() > 0.01


def pulled(contact):
    """Two masses in the air with a cable between them, and a push on the first one after half a second."""
    push = Push((0,), [[0.0, 0.0, 3.0]], 0.5, 10.0)
    pair = Structure([[0.0, 0, 5], [1, 0, 5]], [1.0, 2.0], None, Members(((0, 1),), [200.0], [0.9]))
    return jaxgrity.with_terms(jaxgrity.Scene(pair, ground=contact), push)


def test_a_model_of_another_method_takes_over_lengths_and_time():
    """Its first half step back is by the force of the shortened cable, and of the push; its sensors know of both."""
    limits = MotorLimits(force=1e3)
    robot = control.plant_of(pulled(PenaltyGround(1e4)), (0,), motors=limits)
    model = control.plant_of(pulled(ExactGround()), (0,), motors=limits, sensors=Sensors(delay=2), options=TEN_MS)
    many = control.side_by_side(model, 1)
    v = np.array([[0.0, 1, 0], [0, -1, 0]])

    @jax.jit
    def taken(q, v):
        state = control.plant_start(robot, jax.random.key(0), (q, v))
        state = state._replace(tick=jnp.asarray(100), contraction=jnp.array([0.5]), tension=jnp.array([70.0]))
        began = taken_over(many, Loop(state, ()), 1).plant
        return began, control.observe(many, began)[0]

    began, seen = taken(np.asarray(robot.scene.structure.nodes), v)
    force = np.array([[200 * (1 - 0.45), 0, 3.0], [-200 * (1 - 0.45), 0, 0]])
    np.testing.assert_allclose(began.motion[1][..., 0], v - 0.005 * force / [[1.0], [2.0]], atol=1e-12)
    np.testing.assert_allclose(seen.contraction, [[0.5]])
    np.testing.assert_allclose(seen.tensions, [[110.0]])
    assert began.tension == 70.0


def test_a_blend_is_a_mean_of_both(scene, moment):
    """With shares of 0, 1/4 and 1; clocks of both run on."""
    one, other = PhaseLocked(scene.gait), OpenLoop(replace(scene.gait, amplitude=0.5 * scene.gait.amplitude))
    t = jnp.asarray(0.4)
    alone = [policy(moment, t, policy.first())[0] for policy in (one, other)]
    for share in (0.0, 0.25, 1.0):
        blend = control.Blend(one, other, share)
        asked, ((clock, until), _) = blend(moment, t, blend.first())
        np.testing.assert_allclose(asked, (1 - share) * alone[0] + share * alone[1])
        assert float(until) == 0.4
        assert float(clock) > 0
    with pytest.raises(InputError, match=r"other.members = \(0,\): expected"):
        control.Blend(one, Short((0,)), 0.5)


@pytest.mark.slow
def test_gradient_through_a_closed_loop_is_that_of_central_differences(plant, driver):
    """In gains, of swings too, and in the bend, of a robot that stands and believes to travel: nothing switches."""

    def place(gains, bend, swings):
        policy = replace(driver, policy=replace(driver.policy, gains=gains, swings=swings), bend=bend)
        loop = control.loop_start(plant, policy, jax.random.key(0))
        inner, last, _, before = loop.memory
        loop = loop._replace(memory=(inner, last, jnp.array([0.5, 0.2]), before))
        end, _ = control.roll_on(plant, policy, loop, 30, lambda state: None)
        return jnp.sum(end.plant.motion[0][:, 0] ** 2)

    at = jnp.asarray(driver.policy.gains), jnp.asarray(driver.bend), jnp.full((2, 2), 0.1)
    both = jax.jit(jax.value_and_grad(place, argnums=(0, 1, 2)))
    _, gradient = both(*at)
    for which, k in ((0, (0, 0)), (0, (0, 1)), (0, (1, 0)), (0, (1, 1)), (1, ()), (2, (0, 1))):
        moved = ([x.at[k].add(s) if n == which else x for n, x in enumerate(at)] for s in (1e-5, -1e-5))
        up, down = (both(*each)[0] for each in moved)
        np.testing.assert_allclose(gradient[which][k], (up - down) / 2e-5, rtol=1e-6)
    assert abs(gradient[0][0, 0]) > 1e-6
    assert abs(gradient[1]) > 1e-6


def clock_rate(policy: PhaseLocked, observation: Observation, clock: float) -> float:
    """dc/dt that a policy makes of one observation."""
    _, (after, _) = policy(observation, 0.01, (jnp.asarray(clock), jnp.asarray(0.0)))
    return (float(after) - clock) / 0.01


@pytest.fixture(scope="module")
def moment(rolled):
    """What sensors say in the middle of a motion."""
    return measure(rolled.scene, 0.0, rolled.positions[35], rolled.velocities[35])


def test_the_clock_runs_as_its_law_says(scene, moment):
    """By hand, within its limits; and at both of them."""
    gains, clock = np.array([[0.3, -0.2], [0.1, 0.2]]), 0.37
    u = np.asarray(moment.directions)[:, 2]
    angle = 2 * np.pi * scene.gait.frequency * clock + scene.gait.phase
    rate = 1.0
    for h in (1, 2):
        rate += gains[h - 1] @ [np.sum(u**2 * np.cos(h * angle)), np.sum(u**2 * np.sin(h * angle))]
    assert 0 < rate < 2
    assert abs(rate - 1) > 0.01
    assert clock_rate(PhaseLocked(scene.gait, gains), moment, clock) == pytest.approx(rate, rel=1e-9)
    told = (rate - 1) / abs(rate - 1)
    strong = PhaseLocked(scene.gait, 1e3 * gains), PhaseLocked(scene.gait, -1e3 * gains)
    found = [clock_rate(policy, moment, clock) for policy in strong]
    np.testing.assert_allclose(found, [1 + told, 1 - told], atol=1e-9)


def test_the_clock_of_a_small_robot_runs_like_that_of_a_large_one(scene, moment):
    """A robot of a quarter of the size does the same in half of the time: swings, slow and fast, count alike."""
    built = scene.structure
    struts = replace(built.struts, rest_length=built.struts.rest_length / 4)
    small = replace(scene, structure=replace(built, struts=struts))
    gait = replace(scene.gait, frequency=2 * scene.gait.frequency)
    # weak, so that the clock is at none of its own limits
    own, alike, other = (
        replace(each, gains=0.1 * each.gains, swings=0.1 * each.swings)
        for each in (control.sure_footed(scene.gait), control.sure_footed(gait, small), control.sure_footed(gait))
    )
    assert control.sure_footed(scene.gait, scene).time_scale == own.time_scale == 1.0
    for factor in (1.0, 100.0):  # the fast ones are limited
        seen = moment._replace(spins=factor * moment.spins)
        rate = clock_rate(own, seen, 0.37)
        assert 0 < rate < 2
        assert clock_rate(alike, seen._replace(spins=2 * seen.spins), 0.185) == pytest.approx(rate, rel=1e-9)
    slow = moment._replace(spins=2 * moment.spins)
    assert clock_rate(other, slow, 0.185) != pytest.approx(clock_rate(own, moment, 0.37), rel=1e-3)


def test_the_clock_does_not_ask_on_which_face_the_robot_lies(scene, moment):
    """Under every symmetry of the structure the image of the gait, on the robot's image, has the same clock."""
    i, j = np.array(scene.structure.struts.edges).T
    policy = PhaseLocked(scene.gait, np.array([[0.3, -0.2], [0.1, 0.2]]), np.array([[0.2, 0.1], [-0.1, 0.05]]))
    own, found = clock_rate(policy, moment, 0.37), jaxgrity.model.symmetries(scene.structure)
    assert len(found) == 24
    for symmetry in found:
        ends = dict(zip(zip(i, j), range(6)))
        directions, spins = np.zeros((6, 3)), np.zeros((6, 3))
        for k, pair in enumerate(zip(i, j)):
            a, b = symmetry.nodes[pair[0]], symmetry.nodes[pair[1]]
            sign = 1 if (a, b) in ends else -1
            to = ends[(a, b)] if sign > 0 else ends[(b, a)]
            assert to == symmetry.members[k]
            directions[to], spins[to] = sign * moment.directions[k], moment.spins[k]
        seen = moment._replace(directions=directions, spins=spins)
        locked = replace(policy, gait=jaxgrity.model.image(scene.gait, symmetry))
        assert clock_rate(locked, seen, 0.37) == pytest.approx(own, rel=1e-9)
    assert own != pytest.approx(clock_rate(policy, moment, 0.5), rel=1e-3)


def asked(policy: Steered, observation: Observation, travel: list[float]):
    """Commands of a policy that believes to travel like this, at the origin, and of its inner policy."""
    memory = (policy.policy.first(), observation.place[:2], jnp.array(travel), jnp.asarray(0.3))
    inner, _ = policy.policy(observation, jnp.asarray(0.3), policy.policy.first())
    return np.asarray(policy(observation, jnp.asarray(0.3 + 1e-9), memory)[0]), np.asarray(inner)


def test_struts_on_the_left_stay_longer_in_a_bend_to_the_left(scene):
    """By where strut centres are as built, with +x for the direction of travel; to the right it is the other way."""
    q = np.asarray(scene.structure.nodes)
    seen = measure(scene, 0.0, q, np.zeros_like(q))
    i, j = np.array(scene.structure.struts.edges).T
    left = ((q[i] + q[j]) / 2 - q.mean(0))[:, 1]
    offsets = centre_offsets(scene.structure, scene.gait.members)
    gait = replace(scene.gait, ramp=np.array(0.01))
    for bend in (0.3, -0.3):
        steered, plain = asked(Steered(OpenLoop(gait), bend, offsets), seen, [0.5, 0.0])
        expected = plain * (1 - bend * left / np.abs(np.linalg.norm((q[i] + q[j]) / 2 - q.mean(0), axis=1)).max())
        np.testing.assert_allclose(steered, expected, rtol=0.02, atol=1e-3)
        assert np.ptp(steered / plain) > 0.2


def test_a_robot_with_struts_and_bodies_is_steered_by_all_directions_that_sensors_tell():
    """By where its struts' centres are as built."""
    built = quadruped()
    struts = jaxgrity.Members(((0, 1), (2, 3)), [1e3, 1e3], [1.0, 1.0])
    structure = jaxgrity.Structure(built.nodes, np.zeros(len(built.nodes)), struts, bodies=built.bodies)
    seen = measure(jaxgrity.Scene(structure), 0.0, structure.nodes, 0 * structure.nodes)
    offsets = centre_offsets(structure, (0, 1))
    centres = structure.nodes[[0, 2]] / 2 + structure.nodes[[1, 3]] / 2
    centres = centres - structure.lumped_mass @ structure.nodes / structure.lumped_mass.sum()
    np.testing.assert_allclose(offsets @ seen.directions, centres / np.linalg.norm(centres, axis=1).max(), atol=1e-9)
    gait = Gait((0, 1), np.zeros(2), np.full(2, 0.2), np.ones(2))
    steered, plain = asked(Steered(OpenLoop(gait), 0.3, offsets), seen, [0.5, 0.0])
    assert np.all(np.isfinite(steered))
    assert steered.shape == plain.shape == (2,)


def test_a_goal_on_the_left_is_a_bend_to_the_left(scene):
    """All of the bend where it is beside or behind the robot, none straight ahead, the other way round on the right."""
    q = np.asarray(scene.structure.nodes) * 1.0
    seen = measure(scene, 0.0, q, np.zeros_like(q))._replace(place=np.zeros(3))
    offsets = centre_offsets(scene.structure, scene.gait.members)
    gait = replace(scene.gait, ramp=np.array(0.01))
    to = lambda goal, bend: asked(Steered(OpenLoop(gait), bend, offsets, np.array(goal)), seen, [0.5, 0.0])[0]  # noqa: E731
    ahead, left, right = (to(goal, 0.3) for goal in ([5.0, 0.0], [0.0, 5.0], [0.0, -5.0]))
    fixed = [asked(Steered(OpenLoop(gait), bend, offsets), seen, [0.5, 0.0])[0] for bend in (0.0, 0.3, -0.3)]
    for own, same in zip((ahead, left, right), fixed):
        np.testing.assert_allclose(own, same, rtol=1e-6)


def test_a_robot_of_a_centimetre_steers_as_one_of_a_metre(scene):
    """Its ways, and the speed below which steering fades, a tenth in time and a hundredth in length."""
    q = np.asarray(scene.structure.nodes) * 1.0
    seen = measure(scene, 0.0, q, np.zeros_like(q))._replace(place=np.zeros(3))
    offsets, gait = centre_offsets(scene.structure, scene.gait.members), replace(scene.gait, ramp=np.array(0.01))
    found = [
        asked(
            Steered(OpenLoop(gait), 0.3, offsets, length * np.array([1.0, 2.0]), averaged=time, slowest=slowest),
            seen,
            [0.1 * length / time, 0.0],
        )[0]
        for length, time, slowest in ((1.0, 1.0, 0.05), (0.01, 0.1, 0.005), (0.01, 0.1, 0.05))
    ]
    np.testing.assert_allclose(found[1], found[0], rtol=1e-6)
    assert np.abs(found[2] / found[0] - 1).max() > 0.02
    with pytest.raises(InputError, match="slowest = 0 m/s: expected a positive number"):
        Steered(OpenLoop(gait), 0.3, offsets, slowest=0.0)


def test_gaits_to_choose_from_steer_alike_at_every_size(scene):
    """Those of a robot of a centimetre fade below a tenth of the speed, and are averaged over a tenth of the time."""
    built, lasting = scene.structure, jaxgrity.load_gait("lasting")
    small = replace(
        built, nodes=0.01 * built.nodes, struts=replace(built.struts, rest_length=0.01 * built.struts.rest_length)
    )
    for structure, time in ((built, 1.0), (small, 0.1)):
        found = control.gait_choices(structure, {"lasting": PhaseLocked(lasting, time_scale=time)}).policy
        np.testing.assert_allclose(found.averaged, time, rtol=1e-6)
        assert found.slowest == pytest.approx(0.05 * time, rel=1e-6)


class Counting(control.Policy):
    """Commands from an integer, a mask and a random key that it remembers."""

    members: tuple[int, ...]
    table: jax.Array
    """of integers"""

    def first(self):
        return jnp.asarray(0), jnp.asarray(True), jax.random.key(0)

    def __call__(self, observation, t, memory):
        count, even, key = memory
        key, drawn = jax.random.split(key)
        size = jnp.where(even, 0.1, 0.2) * jax.random.uniform(drawn, (len(self.members),), observation.place.dtype)
        return size * (self.table[count % 2] > 0), (count + 1, ~even, key)


def test_memories_and_parameters_keep_their_kinds(scene):
    """Integers count, masks choose and keys draw, in single precision too."""
    plant = control.plant_of(scene, scene.gait.members, options=SolverOptions(dt=0.01, dtype="float32"))
    policy = Counting(scene.gait.members, jnp.array([1, 0]))
    loop = control.loop_start(plant, policy, jax.random.key(0))
    end, contracted = control.roll_on(plant, policy, loop, 4, lambda state: state.contraction)
    assert int(end.memory[0]) == 4
    assert bool(end.memory[1])
    assert contracted.dtype == np.float32
    np.testing.assert_array_equal(np.asarray(contracted).any(1), [True, False, True, False])


class Network(control.Policy):
    """Strokes by a network, whose activation is a function among its numbers."""

    members: tuple[int, ...]
    layers: eqx.nn.MLP

    def first(self):
        return jnp.zeros(())

    def __call__(self, observation, t, memory):
        return jax.nn.sigmoid(self.layers(observation.place)) / 10, memory


def test_a_network_is_a_policy(scene, plant):
    """As Equinox makes it."""
    members = scene.gait.members
    network = Network(members, eqx.nn.MLP(3, len(members), 4, 1, key=jax.random.key(0)))
    assert not control.simulate_policy(plant, network, 0.05).failed


def test_commands_beyond_the_stroke_count_as_that():
    """On both sides."""
    none, wanted = np.zeros(3), np.array([1.5, -2.0, 0.3])
    reached = control.contraction_reached(MotorLimits(stroke=0.5), none, wanted, 0.01, np.ones(3), None)
    np.testing.assert_allclose(reached, [0.5, -0.5, 0.3])


def test_motors_lag_and_are_bounded():
    """By the share that a first-order lag closes, by their rate, and by the force that stalls them."""
    now, wanted, lengths = np.zeros(2), np.array([0.1, -0.1]), np.array([1.0, 2.0])
    lagging = control.contraction_reached(MotorLimits(lag=0.05), now, wanted, 0.01, lengths, None)
    np.testing.assert_allclose(lagging, (1 - np.exp(-0.2)) * wanted)
    slow = control.contraction_reached(MotorLimits(rate=0.5), now, wanted, 0.01, lengths, None)
    np.testing.assert_allclose(slow, [0.005, -0.0025])
    pulled = control.contraction_reached(MotorLimits(force=50.0), now, wanted, 0.01, lengths, np.array([60.0, 60.0]))
    np.testing.assert_allclose(pulled, [0.0, -0.1])
    single = (np.asarray(x, np.float32) for x in (now, wanted))
    both = MotorLimits(lag=0.05, rate=0.5)
    assert control.contraction_reached(both, *single, 0.01, np.asarray(lengths, np.float32), None).dtype == np.float32


@pytest.mark.campaign
def test_a_motor_that_is_too_weak_does_not_shorten_its_strut(scene):
    """Struts of this robot are pressed together by more than 1 N: they can shorten, and not lengthen again."""
    weak = control.plant_of(scene, scene.gait.members, motors=MotorLimits(force=1.0), options=TEN_MS)
    policy = OpenLoop(scene.gait)
    loop = control.loop_start(weak, policy, jax.random.key(0))
    end, shortened = control.roll_on(weak, policy, loop, 60, lambda state: state.contraction)
    assert end.plant.tension.max() < -1
    assert np.diff(shortened, axis=0).min() >= 0
    assert shortened[-1].max() > 0.1


def seen(value: float) -> Observation:
    return Observation(*(np.full(shape, value) for shape in ((6, 3), (6, 3), (24,), (24,), (12,), (3,), (6,))))


def readings_of(sensors: Sensors, values) -> list[Observation]:
    """What arrives when the truth takes these values in turn."""
    held = control.first_readings(sensors, seen(values[0]), jax.random.key(1))
    arrived = []
    for tick, value in enumerate(values):
        one, held = control.read(sensors, seen(value), held, tick, jax.random.key(tick))
        arrived.append(one)
    return arrived


def test_readings_are_held_and_late():
    """Each third one is new, and arrives two control periods later."""
    late = [float(one.place[0]) for one in readings_of(Sensors(every=3, delay=2), [0, 1, 2, 3, 4, 5, 6, 7, 8])]
    assert late == [0, 0, 0, 0, 0, 3, 3, 3, 6]


def test_biases_stay_and_noise_does_not():
    """Contact is not wrong where nothing says so."""
    off = readings_of(Sensors(noise=Errors(place=0.1), bias=Errors(tensions=2.0)), [0.0] * 400)
    tensions, places = (np.array([getattr(one, name) for one in off]) for name in ("tensions", "place"))
    assert np.ptp(tensions, axis=0).max() == 0
    assert 1 < tensions[0].std() < 3
    assert 0.08 < places.std() < 0.12
    assert not any(one.contact.any() for one in off)


def test_late_readings_err_from_the_first_on():
    """What arrives while the delay lasts has the bias, and noise, of every other reading."""
    off = readings_of(Sensors(bias=Errors(place=1.0, tensions=1.0), delay=3), [0.0] * 5)
    for one in off:
        np.testing.assert_array_equal(one.place, off[-1].place)
    assert np.all(off[0].place != 0)
    noisy = readings_of(Sensors(noise=Errors(place=1.0), delay=3), [0.0] * 5)
    assert np.all(noisy[0].place != 0)
    assert np.all(noisy[0].place != noisy[4].place)


def test_errors_respect_what_readings_are():
    """Contact is told wrongly as often as said, always by the same nodes where that is a bias; unit vectors stay so."""
    wrong = np.array([one.contact for one in readings_of(Sensors(noise=Errors(contact=0.2)), [0.0] * 300)])
    assert set(np.unique(wrong)) == {0.0, 1.0}
    assert 0.15 < wrong.mean() < 0.25
    stuck = np.array([one.contact for one in readings_of(Sensors(bias=Errors(contact=0.5)), [1.0] * 9)])
    assert np.ptp(stuck, axis=0).max() == 0
    assert 0 < stuck[0].mean() < 1
    noisy = readings_of(Sensors(noise=Errors(directions=0.3, tensions=5.0)), [1.0] * 9)
    for one in noisy:
        np.testing.assert_allclose(np.linalg.norm(one.directions, axis=1), 1)
        assert one.tensions.min() == 0
    assert np.ptp([one.directions[0, 0] for one in noisy]) > 0.1


def test_the_clock_of_feedback_needs_struts(scene):
    """Not cables, and not bodies, whose directions sensors tell too; also where a policy is part of another."""
    built = quadruped()
    body = jaxgrity.Structure(built.nodes, np.zeros(len(built.nodes)), bodies=built.bodies)
    clock = PhaseLocked(Gait((0, 6), np.zeros(2), np.full(2, 0.2), np.ones(2)))
    message = r"gait.members = \[0, 6\]: expected struts alone: the clock needs their directions"
    for robot in (scene, jaxgrity.Scene(body)):
        for policy in (clock, control.Blend(clock, OpenLoop(clock.gait), 0.5)):
            with pytest.raises(InputError, match=message):
                policy.check(robot)
    with pytest.raises(InputError, match=message):
        control.simulate_policy(control.plant_of(scene, (0, 6), options=TEN_MS), clock, 0.1)
    control.Blend(PhaseLocked(scene.gait), OpenLoop(scene.gait), 0.5).check(scene)


def test_a_start_of_a_plant_is_a_pair(plant):
    """Positions alone are none."""
    jaxtyping.config.update("jaxtyping_disable", True)  # of this test alone: conftest.py sets it anew for each
    with pytest.raises(InputError, match=r"start has arrays of shape \(12, 3\): expected q and v of shape"):
        control.plant_start(plant, jax.random.key(0), (plant.scene.structure.nodes,))


def test_a_drive_takes_whole_numbers(plant, scene):
    """None that are negative, in one line."""
    policy = OpenLoop(scene.gait)
    driven = lambda ticks: lambda key: control.drive(plant, policy, control.loop_start(plant, policy, key), ticks).path  # noqa: E731
    assert jax.eval_shape(driven(2), jax.random.key(0)).shape == (2, 3)
    with pytest.raises(InputError, match="ticks = -1: expected a whole number, at least 0"):
        jax.eval_shape(driven(-1), jax.random.key(0))


def test_gaits_of_other_robots_are_refused(scene):
    """As `with_gait` refuses them; also within another policy, and among gaits to choose from."""
    gait = jaxgrity.load_gait("lasting")
    struts = replace(scene.structure.struts, edges=tuple((j, i) for i, j in scene.structure.struts.edges))
    other = replace(scene, gait=None, structure=replace(scene.structure, struts=struts))
    plant = control.plant_of(other, gait.members)
    locked = PhaseLocked(gait)
    for policy in (OpenLoop(gait), locked, Steered(locked, 0.1, np.zeros((6, 6)))):
        with pytest.raises(InputError, match=r"gait: made for a robot of 12 nodes, .*; this one has 12 nodes"):
            control.loop_start(plant, policy, jax.random.key(0))
    with pytest.raises(InputError, match="expected a gait for this robot"):
        control.gait_choices(other.structure, {"lasting": locked})


@pytest.mark.parametrize("make", [quadruped, superball])
def test_sensors_tell_how_bodies_are_turned_and_turn(make):
    """Two directions of each: what they say of a turned robot gives the turn, and their spins its angular velocity."""
    built = make()
    structure = jaxgrity.Structure(built.nodes, np.zeros(len(built.nodes)), bodies=built.bodies)
    turn = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix()
    w = np.array([0.3, -2.0, 1.1])
    built = measure(jaxgrity.Scene(structure), 0.0, structure.nodes, np.zeros_like(structure.nodes))
    q = structure.nodes @ turn.T
    seen = measure(jaxgrity.Scene(structure), 0.0, q, np.cross(w, q))
    struts = 0 if structure.struts is None else len(structure.struts.edges)
    assert seen.directions.shape == seen.spins.shape == (struts + 2 * len(structure.bodies), 3)
    np.testing.assert_allclose(seen.directions, built.directions @ turn.T, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(seen.directions, axis=1), 1, rtol=1e-12)
    own = np.einsum("ki,i,kj->kj", seen.directions, w, seen.directions)
    np.testing.assert_allclose(seen.spins, w - own, atol=1e-12)
    a, b = seen.directions[struts:].reshape(-1, 2, 3).transpose(1, 0, 2)
    assert np.all(np.linalg.norm(np.cross(a, b), axis=1) > 0.1)


def test_what_sensors_say_without_error(plant, rolled):
    """Directions are unit vectors, a strut spins about what is normal to it, and cables pull as springs do."""
    q, v = rolled.positions[-1], rolled.velocities[-1]
    scene = plant.scene
    read = measure(scene, 0.0, q, v)
    i, j = np.array(scene.structure.struts.edges).T
    np.testing.assert_allclose(np.linalg.norm(read.directions, axis=1), 1)
    turned = np.cross(read.spins, q[i] - q[j])
    along = read.directions * np.sum((v[i] - v[j]) * read.directions, axis=1, keepdims=True)
    np.testing.assert_allclose(turned, v[i] - v[j] - along, atol=1e-12)
    lengths = jaxgrity.edge_lengths(q, scene.structure.cables.edges)
    pulls = scene.structure.cables.stiffness * np.maximum(lengths - scene.structure.cables.rest_length, 0)
    np.testing.assert_allclose(read.tensions, pulls)
    np.testing.assert_array_equal(read.contact, q[:, 2] < scene.ground.touched_below)
    assert 0 < np.sum(read.contact) < 12


def test_tensions_are_those_of_cables_that_are_wound_up(scene):
    """A cable that is actuated pulls as its rest length at that time says."""
    cables = scene.structure.cables
    gait = Gait((6,), np.zeros(1), np.array([0.4]), np.array([0.5]), np.array(0.0), np.array(0.01))
    q = np.asarray(scene.structure.nodes)
    read = measure(jaxgrity.with_gait(scene, gait), 0.5, q, np.zeros_like(q))
    length = jaxgrity.edge_lengths(q, cables.edges)[0]
    wound = cables.rest_length[0] * (1 - 0.2 * (1 + np.sin(np.pi / 2)))
    assert read.tensions[0] == pytest.approx(cables.stiffness[0] * (length - wound), rel=1e-9)
    assert read.tensions[0] > 1.5 * read.tensions[1]
    np.testing.assert_allclose(read.contraction, [0.4], rtol=1e-9)


def test_a_stuck_member_is_not_told_as_shortened(scene):
    """Its motor does not turn, whatever it is asked."""
    cables = replace(scene.structure.cables, stuck=(1,))
    gait = Gait((0, 6, 7), np.zeros(3), np.full(3, 0.4), np.full(3, 0.5), np.array(0.0), np.array(0.01))
    robot = replace(scene, gait=gait, structure=replace(scene.structure, cables=cables))
    read = measure(robot, 0.5, robot.structure.nodes, np.zeros_like(robot.structure.nodes))
    np.testing.assert_allclose(read.contraction, [0.4, 0.4, 0.0], rtol=1e-9)
    assert read.tensions[0] > 1.5 * read.tensions[1]


def test_tensions_are_those_of_the_law_of_a_cable(scene):
    """Of a limit, of a table, and one tension all along a cable that runs through a node."""
    cables, q = scene.structure.cables, 1.15 * np.asarray(scene.structure.nodes)
    stretch = jaxgrity.edge_lengths(q, cables.edges) - cables.rest_length
    springs = cables.stiffness * stretch
    limited = jaxgrity.with_terms(scene, jaxgrity.force_limit(cables, 60.0))
    far, force = [0.0, 0.05, 1.0], [0.0, 0.05 * cables.stiffness[0], 500.0]
    table = jaxgrity.with_terms(scene, jaxgrity.force_table(cables, far, force))
    clustered = replace(cables, clusters=((0, 16),))
    together = replace(scene, gait=None, structure=replace(scene.structure, cables=clustered))
    pulls = [np.asarray(measure(each, 0.0, q, np.zeros_like(q)).tensions) for each in (limited, table, together)]
    np.testing.assert_allclose(pulls[0], np.minimum(springs, 60.0), rtol=1e-6)
    np.testing.assert_allclose(pulls[1], np.interp(stretch, far, force), rtol=1e-6)
    shared = 1 / (1 / cables.stiffness[0] + 1 / cables.stiffness[16]) * (stretch[0] + stretch[16])
    np.testing.assert_allclose(pulls[2][[0, 16]], shared, rtol=1e-6)
    np.testing.assert_allclose(pulls[2][1:16], springs[1:16], rtol=1e-6)


class Short(control.Policy):
    """Commands for four members, whatever there are."""

    members: tuple[int, ...]

    def first(self):
        return None

    def __call__(self, observation, t, memory):
        return jnp.zeros(4), memory


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda scene: Sensors(delay=-1), "delay = -1"),
        (
            lambda scene: Sensors(noise=Errors(place=-1.0)),
            "sensors.noise.place = -1: expected a finite number, at least 0",
        ),
        (
            lambda scene: Sensors(bias=Errors(spins=np.nan)),
            "sensors.bias.spins = nan: expected a finite number, at least 0",
        ),
        (
            lambda scene: Sensors(noise=Errors(contact=1.5)),
            "sensors.noise.contact = 1.5: expected a number from 0 to 1",
        ),
        (lambda scene: PhaseLocked(scene.gait, np.full((2, 2), np.nan)), "gains = .*: expected finite numbers"),
        (
            lambda scene: Steered(OpenLoop(scene.gait), 0.1, np.zeros((6, 6)), np.zeros(3)),
            r"goal has the shape \(3,\): expected \(2,\)",
        ),
        (
            lambda scene: control.loop_start(control.plant_of(scene, tuple(range(6))), OpenLoop(scene.gait), 0),
            r"key of type int64 and shape \(\): expected one key",
        ),
        (
            lambda scene: control.loop_start(
                control.side_by_side(control.plant_of(scene, tuple(range(6))), 2),
                OpenLoop(scene.gait),
                jax.random.key(0),
                each=True,
            ),
            "each = True: the last axes have 6 rows; expected 2, one for each robot",
        ),
        (lambda scene: MotorLimits(stroke=1.0), r"motors.stroke = 1.0: expected less than 1"),
        (lambda scene: control.plant_of(scene, ()), r"members = \(\): expected at least one"),
        (
            lambda scene: control.plant_of(scene, (0,), period=np.nan),
            "period = nan s: expected a positive number",
        ),
        (
            lambda scene: control.side_by_side(control.plant_of(scene, (0,)), 0),
            "robots = 0: expected a whole number",
        ),
        (
            lambda scene: control.side_by_side(
                control.plant_of(scene, (0,)), 3, jaxgrity.Differences(friction=np.ones(2))
            ),
            r"differences.friction has shape \(2,\); expected \(3,\), a row for each robot",
        ),
        (
            lambda scene: control.side_by_side(control.side_by_side(control.plant_of(scene, (0,)), 2), 2),
            "side_by_side: the plant has 2 robots side by side; expected one",
        ),
        (
            lambda scene: control.simulate_policy(
                control.side_by_side(control.plant_of(scene, tuple(range(6))), 2),
                OpenLoop(scene.gait),
                0.1,
            ),
            "simulate_policy: the plant has 2 robots",
        ),
        (
            lambda scene: control.loop_start(
                control.plant_of(scene, tuple(range(6))), OpenLoop(scene.gait), jax.random.key(0), each=True
            ),
            "each = True: the plant has one robot",
        ),
        (
            lambda scene: control.simulate_policy(
                control.plant_of(scene, tuple(range(6))),
                OpenLoop(scene.gait),
                0.1,
                start=(np.zeros(3), np.zeros(3)),
            ),
            r"start has arrays of shape \(3,\): expected q and v of shape \(12, 3\) each",
        ),
        (lambda scene: Steered(OpenLoop(scene.gait), np.nan, np.zeros((6, 6))), "bend = nan: expected numbers between"),
        (lambda scene: Steered(OpenLoop(scene.gait), 0.1, np.zeros(6)), r"offsets have the shape \(6,\): expected"),
        (lambda scene: MotorLimits(rate=0.0), r"motors.rate = 0.0: expected a positive"),
        (lambda scene: PhaseLocked(scene.gait, np.zeros(2)), r"gains has shape \(2,\)"),
        (
            lambda scene: control.simulate_policy(control.plant_of(scene, (0,)), OpenLoop(scene.gait), 0.1),
            r"policy.members = \(0, 1, 2, 3, 4, 5\): expected \(0,\)",
        ),
        (
            lambda scene: control.simulate_policy(
                control.plant_of(scene, tuple(range(6))), Short(tuple(range(6))), 0.1
            ),
            r"commands have the shape \(4,\): expected \(6,\)",
        ),
        (
            lambda scene: control.simulate_policy(control.plant_of(scene, tuple(range(6))), OpenLoop(scene.gait), -1.0),
            "duration = -1 s: expected a positive number",
        ),
        (
            lambda scene: control.Sensors(every=0),
            "sensors.every = 0: expected a whole number, at least 1",
        ),
        (lambda scene: centre_offsets(scene.structure, (0, 6)), "expected struts alone"),
        (
            lambda scene: control.simulate_policy(
                control.plant_of(scene, tuple(range(6))), Steered(OpenLoop(scene.gait), 0.1, np.zeros((6, 5))), 0.1
            ),
            r"offsets have the shape \(6, 5\): the robot's sensors tell 6 directions",
        ),
        (
            lambda scene: control.plant_of(
                jaxgrity.Scene(
                    jaxgrity.Structure(np.eye(3), np.ones(3), jaxgrity.Members(((0, 1), (1, 2)), None, [2**0.5] * 2))
                ),
                (0,),
                motors=MotorLimits(force=10.0),
            ),
            "rigid struts share nodes: their forces cannot be told apart",
        ),
        (lambda scene: control.plant_of(scene, (99,)), r"members\[0\] = 99: expected a whole number from 0 to 29"),
        (
            lambda scene: control.plant_of(
                jaxgrity.load_scene("reference"), (0,), options=SolverOptions(method="tsit5")
            ),
            "expected an explicit one at a fixed step",
        ),
        (lambda scene: centre_offsets(scene.structure, ()), r"members = \[\]: expected struts alone"),
        (lambda scene: centre_offsets(scene.structure, (-1,)), r"members\[0\] = -1: expected a whole number from 0"),
    ],
)
def test_bad_input_is_refused(scene, make, message):
    """In one line, before anything compiles."""
    with pytest.raises(InputError, match=message):
        make(scene)
