"""Orbits: of motions made by hand, whose speed and turning are known, and of a gait that lasts."""

from dataclasses import replace
from fractions import Fraction
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest

import jaxgrity
from jaxgrity import Gait, InputError, Motor, Push, SolverOptions, Trajectory, load_gait, wind, with_gait, with_terms
from jaxgrity.model import symmetries, travelling_waves
from jaxgrity.model.symmetry import gene_permutations
from jaxgrity.orbits import (
    closed_orbit,
    distance_from_orbit,
    error_bars,
    find_orbit,
    finding,
    floquet_multipliers,
    one_cycle,
    orbit_cycle,
    orbit_error_bars,
    orbit_stability,
    orbit_symmetry,
    refined_orbit,
    repetition,
    speed_gradient,
    stability,
)
from jaxgrity.orbits.cycles import MOST_PERIODS, Plane, plane_of, way_along
from jaxgrity.orbits.finding import in_step, restarted, shortest_watch
from jaxgrity.populations.motion_kinds import LASTING, rolling
from jaxgrity.populations.population import as_population, simulate_population
from jaxgrity.populations.uncertainty import Differences
from jaxgrity.stepping.dynamics import total_force
from jaxgrity.stepping.options import options_anew
from jaxgrity.stepping.starts import check_known_velocities

PERIOD, SPEED, TURNING = 0.5, 0.8, 0.3
LEVEL = Plane(np.eye(3), True)


def made_by_hand(scene, wobble: int, noise: float = 0.0, turning: float = TURNING) -> Trajectory:
    """The robot along an arc to the left, its height, size and heading changing with every `wobble`-th period."""
    times = np.arange(60 * finding.FRAMES + 1) * PERIOD / finding.FRAMES
    phase = 2 * np.pi * times / (wobble * PERIOD)
    heading = turning * times + 0.2 * np.sin(phase)
    nodes = np.asarray(scene.structure.nodes) - np.mean(scene.structure.nodes, axis=0)
    turn = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    plane = np.einsum("abt,nb->tna", turn, nodes[:, :2]) * (1 + 0.1 * np.sin(phase))[:, None, None]
    arc = SPEED / turning * np.stack([np.sin(turning * times), 1 - np.cos(turning * times)], axis=-1)
    high = nodes[:, 2] + (1 + 0.05 * np.cos(phase))[:, None]
    q = np.concatenate([plane + arc[:, None], high[..., None]], axis=-1)
    q = q + noise * np.random.default_rng(0).normal(size=q.shape)
    return Trajectory(times, q, 0 * q, jnp.array(0), jnp.array(1), jnp.array(0), "rk4", 1e-3)


def test_a_turn_changes_a_motion_on_a_slope_and_in_wind(exact):
    """So headings are no planar motions there; in wind from above, and after a push, they are."""
    winds = {velocity: with_terms(exact, wind(velocity, 0.05, 12)) for velocity in ((0.0, 4.0, 0.0), (0.0, 0.0, 4.0))}
    pushed = with_terms(exact, Push((3,), np.array([[60.0, 0, 0]]), 0.1, 0.2))
    slope = replace(exact, ground=replace(exact.ground, incline=0.1))
    aloft = replace(winds[0.0, 4.0, 0.0], ground=None, friction=None)
    turns = [plane_of(scene).turns for scene in (exact, *winds.values(), pushed, slope, aloft)]
    assert turns == [True, False, True, True, False, False]
    upright, leaning = (replace(exact, up=np.array(up)) for up in ((0.0, 0.0, 1.0), (0.6, 0.0, 0.8)))
    falling = replace(leaning, ground=None, friction=None)
    assert [plane_of(scene).turns for scene in (upright, leaning, falling)] == [True, False, False]


def test_pushes_and_motors_go_on_from_an_orbit(exact):
    """What was over when the orbit was found does not begin again, and what was to come comes at its time."""
    orbit = finding._orbit(exact, made_by_hand(exact, 1), PERIOD, LEVEL, 6)
    pushes = [Push((3,), np.array([[60.0, 0, 0]]), start, 0.2) for start in (0.1, 30.1)]
    motor = Motor(0, np.array([1.0, 30.05]), np.array([0.4, 0.3]), 1.0, lag=0.1)
    cables = replace(exact.structure.cables, motors=(motor,))
    scene = with_terms(replace(exact, structure=replace(exact.structure, cables=cables)), *pushes)
    here, q, v = restarted(scene, orbit), *orbit.state
    own, found = (replace(s, gait=None, ground=None, friction=None) for s in (scene, here))
    assert orbit.verified_for == pytest.approx(30.0)
    forces = jax.jit(total_force)
    for t in (0.0, 0.15, 0.6):
        np.testing.assert_allclose(forces(found, t, q, v), forces(own, t + orbit.verified_for, q, v), atol=1e-8)
    assert np.abs(forces(found, 0.15, q, v) - forces(own, 0.15, q, v)).max() > 1


def test_an_orbit_found_from_another_goes_on_in_time(exact, monkeypatch):
    """Motors and pushes of the scene know the time of both."""
    first = finding._orbit(exact, made_by_hand(exact, 1), PERIOD, LEVEL, 6)
    monkeypatch.setattr(finding, "simulate", lambda scene, *_, **__: made_by_hand(scene, 1))
    push = Push((3,), np.array([[60.0, 0, 0]]), 60.1, 0.2)
    second = find_orbit(with_terms(exact, push), 120.0, beginning=first)
    assert (first.scene_time, second.scene_time) == pytest.approx((30.0, 60.0))
    (later,) = restarted(with_terms(exact, push), second).terms
    assert float(later.start) == pytest.approx(0.1)


def test_a_robot_that_lies_flat_on_its_orbit_stands_on_the_faces_it_is_built_with(exact, monkeypatch):
    """At the moment at which the cycle begins, its nodes lie in a plane, and so have no faces."""
    motion = made_by_hand(exact, 1)
    orbit = finding._orbit(exact, motion, PERIOD, LEVEL, 6)
    flat = orbit._replace(state=(orbit.state[0] * np.array([1, 1, 0]), orbit.state[1]))
    monkeypatch.setattr(one_cycle, "simulate", lambda *_, **__: motion)
    found = one_cycle._supports(exact, restarted(exact, flat), flat, in_step(exact, PERIOD, None))
    assert found == rolling(exact, motion).supports
    assert len(found) == 1


@pytest.mark.parametrize("moment", np.linspace(0, 1, 8, endpoint=False))
def test_each_face_of_a_cycle_is_told_once(exact, monkeypatch, moment):
    """Wherever in its stay on a face the robot is when the cycle begins."""
    orbit = finding._orbit(exact, made_by_hand(exact, 1), PERIOD, LEVEL, 6)._replace(periods=3)
    faces = ((0, 1, 4), (1, 4, 9), (4, 9, 11))

    def simulated(scene, duration, *, options, frame_rate, velocities):
        return SimpleNamespace(failed=False, duration=duration, rate=frame_rate)

    def seen(scene, motion):
        # a face counts if it lasts, and a change is seen at the next frame
        changes = (np.arange(-1, 60) + moment) * orbit.cycle / 3
        since = np.ceil(np.maximum(changes, 0) * motion.rate - 1e-9) / motion.rate
        stays = np.diff(np.append(np.minimum(since, motion.duration), motion.duration)) >= LASTING
        lasting = [(faces[k % 3], t) for k, (t, stay) in enumerate(zip(since, stays)) if stay]
        return SimpleNamespace(supports=tuple(face for face, _ in lasting), since=np.array([t for _, t in lasting]))

    monkeypatch.setattr(one_cycle, "simulate", simulated)
    monkeypatch.setattr(one_cycle, "rolling", seen)
    found = one_cycle._supports(exact, restarted(exact, orbit), orbit, in_step(exact, PERIOD, None))
    assert len(found) == 3
    assert set(found) == set(faces)


@pytest.mark.parametrize("wobble", [1, 3, 5])
def test_a_motion_made_by_hand_has_its_speed_and_turning(exact, wobble):
    """And its cycle: shapes return after so many periods, to rounding."""
    orbit = finding._orbit(exact, made_by_hand(exact, wobble), PERIOD, LEVEL, 6)
    assert orbit.periods == wobble
    assert orbit.settled
    assert orbit.residual < 1e-12
    assert orbit.turning == pytest.approx(TURNING, rel=1e-9)
    assert orbit.speed == pytest.approx(SPEED, rel=1e-9)
    np.testing.assert_allclose(orbit.windows, SPEED, rtol=1e-9)
    assert orbit.standard_error < 1e-12
    assert orbit.summary()["body_lengths_per_second"] == pytest.approx(orbit.speed)


@pytest.mark.parametrize(("doubled", "periods"), [(1e-6, 2), (1e-3, 4)])
def test_a_cycle_is_longer_only_if_shapes_differ_visibly(exact, doubled, periods):
    """Cycles of 2 periods that differ in turn, by micrometres or by millimetres: what is left of settling, or twice the
    period. Micrometres too are far more than the change over 4 periods."""
    motion = made_by_hand(exact, 2)
    high = doubled * np.cos(2 * np.pi * np.asarray(motion.times) / (4 * PERIOD))
    motion = replace(motion, positions=motion.positions + high[:, None, None] * np.array([0, 0, 1.0]))
    orbit = finding._orbit(exact, motion, PERIOD, LEVEL, 6)
    assert orbit.periods == periods
    assert orbit.speed == pytest.approx(SPEED, rel=1e-9)


def test_a_cycle_is_no_more_than_a_semicircle(exact):
    """Where nearly equal cycles follow each other: a whole circle's chord is nothing, however fast the robot went."""
    orbit = finding._orbit(exact, made_by_hand(exact, 3, noise=1e-4, turning=0.7), PERIOD, LEVEL, 6)
    assert orbit.periods == 3
    assert orbit.speed == pytest.approx(SPEED, rel=1e-2)


def test_what_happens_before_the_robot_settles_does_not_count(exact):
    """A motion that is thrown about for its first 16 periods: the rest is on the orbit, and says since when."""
    motion = made_by_hand(exact, 3)
    early = np.asarray(motion.times) < 16.2 * PERIOD
    q = motion.positions + 0.5 * early[:, None, None] * np.random.default_rng(0).normal(size=motion.positions.shape)
    orbit = finding._orbit(exact, replace(motion, positions=q), PERIOD, LEVEL, 6)
    assert orbit.settled_after == 17 * PERIOD
    assert orbit.speed == pytest.approx(SPEED, rel=1e-9)
    assert orbit.residual < 1e-12
    late = np.asarray(motion.times) > 50 * PERIOD
    q = motion.positions + 0.5 * late[:, None, None] * np.random.default_rng(0).normal(size=motion.positions.shape)
    orbit = finding._orbit(exact, replace(motion, positions=q), PERIOD, LEVEL, 6)
    assert not orbit.settled
    assert orbit.residual > finding.SETTLED


def test_up_a_slope_shapes_return_too(exact):
    """Heights are those above the slope, and the speed is that along it. What turns there settles on no orbit."""
    slope = replace(exact, ground=replace(exact.ground, incline=0.3))
    plane = plane_of(slope)
    motion = made_by_hand(exact, 1, turning=1e-9)
    q = motion.positions @ plane.axes.T
    orbit = finding._orbit(slope, replace(motion, positions=q), PERIOD, plane, 6)
    assert orbit.residual < 1e-9
    assert orbit.speed == pytest.approx(SPEED, rel=1e-6)
    assert orbit.turning == pytest.approx(1e-9, rel=1e-3)
    turns = made_by_hand(exact, 1)
    assert finding._orbit(exact, turns, PERIOD, LEVEL, 6).settled
    assert not finding._orbit(slope, replace(turns, positions=turns.positions @ plane.axes.T), PERIOD, plane, 6).settled
    bumpy = replace(exact, ground=jaxgrity.ExactGround(surface=jaxgrity.bumps(0.02, 0.5, 0)))
    with pytest.raises(InputError, match=r"ground.surface: expected a plane"):
        find_orbit(with_gait(bumpy, load_gait("lasting")))


def test_a_motion_that_never_returns_is_no_orbit(exact):
    """Where shapes differ by decimetres, whatever the number of periods."""
    assert not finding._orbit(exact, made_by_hand(exact, 1, noise=0.1), PERIOD, LEVEL, 6).settled


def test_multipliers_of_a_map_made_by_hand():
    """d2 = A d1 in the two directions in which robots spread, and rounding in all others: A's own eigenvalues."""
    random = np.random.default_rng(0)
    basis = np.linalg.qr(random.normal(size=(36, 2)))[0]
    matrix = np.array([[0.5, 0.3], [-0.3, 0.5]])
    d1 = random.normal(0, 0.02, (60, 2))
    first, second = ((x @ basis.T).reshape(60, 12, 3) for x in (d1, d1 @ matrix))
    found = orbit_stability._stability(first, second, 1.0)
    np.testing.assert_allclose(np.abs(found.multipliers), np.hypot(0.5, 0.3), rtol=1e-6)
    assert found.largest == pytest.approx(np.hypot(0.5, 0.3))
    assert found.returned == 1
    lost = orbit_stability._stability(first, second + 1.0, 1.0)
    assert lost.returned == 0
    assert np.isinf(lost.largest)


def test_disturbed_velocities_are_those_of_bodies_on_supports():
    """Beside a body of five nodes, and along a rail: rollouts take them. Of points alone they stay as they are."""
    nodes = np.random.default_rng(0).normal(size=(7, 3))
    body = jaxgrity.model.rigid_body(nodes, tuple(range(5)), 1.0, [0.3, 0.3, 0.3])
    structure = jaxgrity.Structure(nodes, [0.0] * 5 + [1.0, 1.0], bodies=(body,), fixed=((6, "y"),))
    drawn = np.random.default_rng(1).normal(size=(4, 7, 3))
    allowed = orbit_stability._allowed(jaxgrity.Scene(structure), drawn)
    check_known_velocities(jaxgrity.Scene(structure), allowed)
    with pytest.raises(InputError, match="beside that of its rigid body"):
        check_known_velocities(jaxgrity.Scene(structure), drawn)
    np.testing.assert_allclose(allowed[:, 5:], drawn[:, 5:] * [[1, 1, 1], [1, 0, 1]], atol=1e-12)
    np.testing.assert_allclose(allowed[:, :5].mean(1), drawn[:, :5].mean(1), atol=1e-12)
    points = jaxgrity.Scene(jaxgrity.Structure(nodes, np.ones(7)))
    assert orbit_stability._allowed(points, drawn) is drawn


def test_only_gaits_of_one_frequency_have_orbits(exact):
    """Else nothing is periodic; and a cycle has to be seen more than once."""
    two = Gait((0, 1), [0.0, 0], [0.1, 0.1], [0.5, 0.7])
    with pytest.raises(InputError, match=r"frequencies \[0.5, 0.7\] Hz: expected one that all actuators share"):
        find_orbit(with_gait(exact, two))
    for asked in (lambda: find_orbit(with_gait(exact, None)), lambda: shortest_watch(None)):
        with pytest.raises(InputError, match=r"the scene has no gait, and so no orbit; pass jaxgrity.with_gait\("):
            asked()
    with pytest.raises(InputError, match=r"duration = 10 s: expected at least .* s, to see cycles"):
        find_orbit(exact, 10.0)
    for duration in (np.nan, np.inf):
        with pytest.raises(InputError, match=f"duration = {duration} s: expected a positive number"):
            find_orbit(exact, duration)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ("no gait", r"the scene has no gait, and so no orbit; pass jaxgrity.with_gait\("),
        ("failed", "orbit: its rollout failed; expected one that was watched to the end"),
        ("other robot", "orbit: it has 4 nodes; expected 12, those of the scene"),
    ],
)
def test_what_is_asked_of_an_orbit_needs_the_orbit_of_the_scene(exact, wrong, message):
    """Before a step is chosen for it."""
    orbit = finding._orbit(exact, made_by_hand(exact, 1), PERIOD, LEVEL, 6)
    scene = with_gait(exact, None) if wrong == "no gait" else exact
    changed = {"failed": {"verified_for": 0.0}, "other robot": {"state": tuple(x[:4] for x in orbit.state)}}
    orbit = orbit._replace(**changed.get(wrong, {}))
    options = options_anew(exact, "complementarity", 5e-3, "float64")
    for ask in (restarted, stability, orbit_cycle, repetition, floquet_multipliers, speed_gradient):
        with pytest.raises(InputError, match=message):
            ask(scene, orbit)
    with pytest.raises(InputError, match=message):
        closed_orbit(scene, orbit, options)
    with pytest.raises(InputError, match=message):
        distance_from_orbit(scene, orbit, np.zeros((1, *exact.structure.nodes.shape)))


def test_counts_of_what_is_asked_of_an_orbit_are_whole_numbers(exact):
    jaxtyping.config.update("jaxtyping_disable", True)  # for this test: its own refusals would come first
    orbit = finding._orbit(exact, made_by_hand(exact, 1), PERIOD, LEVEL, 6)
    for robots in (1, 0, -3, 16.0):
        with pytest.raises(InputError, match=f"robots = {robots}: expected a whole number, at least 2"):
            stability(exact, orbit, robots=robots)
    with pytest.raises(InputError, match=r"after = 2\.0: expected a whole number, at least 0"):
        floquet_multipliers(exact, orbit, after=2.0)
    with pytest.raises(InputError, match=r"shape \(0, 12, 3\); expected \(robots, 12, 3\), at least one robot"):
        distance_from_orbit(exact, orbit, np.zeros((0, 12, 3)))


def test_orbits_are_on_a_plane_and_known_before_a_step_is_chosen(exact, monkeypatch):
    """The step is what compiles first."""
    hill = replace(exact, ground=replace(exact.ground, surface=jaxgrity.bumps(0.03, 0.8, 0)))
    orbit = finding._orbit(exact, made_by_hand(exact, 1), PERIOD, LEVEL, 6)
    for module in (finding, error_bars):
        monkeypatch.setattr(module, "resolve", lambda *_, **__: pytest.fail("a step is chosen"))
    for ask in (find_orbit, refined_orbit, orbit_error_bars):
        with pytest.raises(InputError, match=r"ground.surface: expected a plane"):
            ask(hill)
        with pytest.raises(InputError, match="the scene has no gait, and so no orbit"):
            ask(with_gait(exact, None))
    for ask in (stability, speed_gradient, repetition):
        with pytest.raises(InputError, match=r"ground.surface: expected a plane"):
            ask(hill, orbit)


@pytest.mark.parametrize(("frequency", "start"), [(0.5, 1.0), (0.3, 0.0), (2.0, 20.0)])
def test_the_shortest_watch_leaves_two_of_the_longest_cycles(exact, frequency, start):
    """In the later half of the time at full amplitude, and no period more."""
    gait = Gait((0, 1), [0.0, 0], [0.1, 0.1], frequency, start, 1.0)
    periods = finding.shortest_watch(gait) * frequency - (start + 1.0) * frequency
    assert 4 * MOST_PERIODS <= periods < 4 * MOST_PERIODS + 1


def test_a_wave_follows_every_rotation_and_other_gaits_none(exact):
    """By a third of a period, or at once; a phase, or an amplitude, of its own keeps a gait from it."""
    rotations = symmetries(exact.structure, mirrors=False)
    wave = travelling_waves(exact.structure, exact.gait.members)[0]
    gait = replace(exact.gait, phase=2 * np.pi * np.array(wave.shifts) + 0.3, amplitude=np.full(6, 0.2))

    def shares(gait):
        slots = [gene_permutations(gait.members, (rotation,)) for rotation in rotations]
        return [orbit_symmetry._shift(gait, each) for each in slots]

    found = shares(gait)
    assert set(found) == {Fraction(0), Fraction(1, 3), Fraction(2, 3)}
    for rotation, share in zip(rotations, found, strict=True):
        phases = dict(zip(gait.members, gait.phase, strict=True))
        for member in gait.members:
            ahead = (phases[member] - phases[rotation.members[member]]) / (2 * np.pi) - float(share)
            assert ahead == pytest.approx(round(ahead), abs=1e-9)
    for other in (replace(gait, phase=gait.phase + np.eye(6)[2]), replace(gait, amplitude=0.2 + 0.1 * np.eye(6)[2])):
        assert shares(other).count(None) >= 8


@pytest.mark.campaign
def test_a_gait_that_lasts_is_on_an_orbit_at_any_step(exact):
    """At 5 ms and at 2.5 ms it goes as fast, to a hundredth, and robots that are disturbed come back."""
    scene = with_gait(exact, load_gait("lasting"))
    coarse, fine = (find_orbit(scene, 70.0, options=SolverOptions(dt=dt)) for dt in (5e-3, 2.5e-3))
    assert coarse.settled
    assert coarse.speed == pytest.approx(fine.speed, rel=0.01)
    assert coarse.windows.min() > 0.9 * coarse.speed
    cycle, fewer = (
        orbit_cycle(scene, orbit, options=SolverOptions(dt=dt)) for orbit, dt in ((coarse, 5e-3), (fine, 2.5e-3))
    )
    assert cycle.distance == pytest.approx(np.hypot(*coarse.velocity) * coarse.cycle, rel=1e-3)  # it rolls straight
    assert cycle.effort == pytest.approx(fewer.effort, rel=0.05)
    assert 0 < cycle.work < cycle.effort
    assert len(cycle.supports) == 12
    for now, after in zip(cycle.supports, (*cycle.supports[1:], cycle.supports[0]), strict=True):
        assert len(set(now) & set(after)) == 2
    found = repetition(scene, coarse)
    assert coarse.cycle / found.time == pytest.approx(6)
    images = [tuple(sorted(found.nodes[node] for node in face)) for face in cycle.supports]
    assert images == [*cycle.supports[2:], *cycle.supports[:2]]
    here, turn, lift = coarse.state[0], np.array([[0, 1.0, 0], [-1, 0, 0], [0, 0, 1]]), np.array([0, 0, 0.2])
    image = here[list(found.nodes)] @ turn + np.array([3, 4, 0])
    off = distance_from_orbit(scene, coarse, np.array([here, image, scene.structure.nodes, here + lift]))
    assert off[:2].max() < 1e-6
    assert off[2:].min() > 0.05
    with pytest.raises(InputError, match=r"positions have shape \(12, 3\); expected \(robots, 12, 3\)"):
        distance_from_orbit(scene, coarse, here)
    again, _, bars = orbit_error_bars(scene, 70.0, options=SolverOptions(dt=5e-3))
    finest = find_orbit(scene, 70.0, options=SolverOptions(dt=5e-3 / 8))
    reached = orbit_cycle(scene, finest, options=SolverOptions(dt=5e-3 / 8))
    assert (again.speed, again.turning) == (coarse.speed, coarse.turning)
    assert abs(finest.speed - coarse.speed) < bars.speed < 0.02
    assert abs(finest.turning - coarse.turning) <= bars.turning + 1e-6
    for name in ("cost_of_transport", "peak_rate", "peak_power", "work", "distance"):
        assert abs(getattr(reached, name) - getattr(cycle, name)) <= bars.cycle[name] + 1e-9, name
        assert bars.cycle[name] < 0.3 * getattr(cycle, name), name
    lengths = scene.structure.struts.rest_length * scene.gait.amplitude
    assert cycle.peak_rate == pytest.approx(np.pi / coarse.period * lengths.max(), rel=1e-2)
    held = stability(scene, coarse, robots=32)
    assert held.returned > 0.9
    assert held.largest < 0.5


@pytest.mark.campaign
def test_peaks_of_a_cycle_do_not_depend_on_its_beginning(exact):
    """Moving means of forces begin at zero, and are filled by the first of two cycles. In a first cycle alone, the peak
    of the gait of cables is up to 4 % too low, by the moment at which the cycle begins."""
    scene, found, first = with_gait(exact, load_gait("cables")), [], []
    for moment in (0.0, 0.25, 0.75):
        early = with_gait(exact, replace(scene.gait, phase=scene.gait.phase + 2 * np.pi * moment))
        orbit = find_orbit(early, 30.0)
        found.append(orbit_cycle(early, orbit))
        here, start = restarted(early, orbit), Differences(velocities=np.asarray(orbit.state[1])[None])
        options = in_step(early, orbit.period, None)
        alone = simulate_population(
            here, as_population(here.gait), orbit.cycle, options=options, differences=start, with_metrics=True
        )
        first.append(float(np.max(alone.metrics.peak_force)))
    for name in ("peak_force", "peak_power", "peak_rate"):
        numbers = np.array([getattr(cycle, name) for cycle in found])
        np.testing.assert_allclose(numbers, numbers[0], rtol=2e-3, err_msg=name)
    assert min(first) < 0.98 * found[0].peak_force


@pytest.mark.parametrize("moment", [0.0, 0.3, 0.75])
@pytest.mark.parametrize(("radius", "turning"), [(2.0, 0.3), (0.05, -0.5), (0.0, 0.8)])
def test_the_speed_is_that_about_the_centre_whatever_the_moment(radius, turning, moment):
    """Of a centre of mass that sways about the circle that its mean goes round on, on a large one and on the spot."""
    frames, angle = 60, turning / 60
    share = np.arange(frames + 1) / frames + moment
    sway = 0.1 * np.exp(2j * np.pi * share) + 0.06 * np.cos(4 * np.pi * share)
    place = 3 - 2j + np.exp(1j * turning * share) * (radius + sway)
    path = np.stack([place.real, place.imag], axis=1)
    assert float(way_along(path, angle)) * frames == pytest.approx(radius * abs(turning), rel=2e-4, abs=1e-5)
    straight = np.stack([share + sway.real, sway.imag], axis=1)
    assert float(way_along(straight, 0.0)) * frames == pytest.approx(1, rel=1e-12)


@pytest.mark.parametrize("coupled", [True, False])
def test_a_step_in_time_with_the_period_keeps_the_other_options(exact, coupled):
    """Whether struts and contacts are solved together, and how many steps there may be."""
    chosen = in_step(exact, 0.7, SolverOptions(dt=2e-3, coupled=coupled, max_steps=12345))
    assert (chosen.coupled, chosen.max_steps) == (coupled, 12345)
    assert 0.7 / chosen.dt == pytest.approx(round(0.7 / chosen.dt))
