"""One motion at all sizes: scaled in length, mass and time, every number of every report is the same but for units."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrity import (
    ConeFriction,
    ExactGround,
    Gait,
    InputError,
    Members,
    PenaltyGround,
    Scene,
    SmoothFriction,
    SolverOptions,
    Structure,
    Trajectory,
    as_population,
    contact_twin,
    diagnose,
    forces_along,
    gaits_of,
    rolling,
    simulate,
    simulate_population,
    with_gait,
)
from jaxgrity.model.scales import length_scale, mass_scale, speed_scale, time_scale
from jaxgrity.orbits import find_orbit, floquet_multipliers, speed_gradient, stability
from jaxgrity.populations.population import at_start
from jaxgrity.stepping import resolve, step_limit

NUMBER, LENGTH, MASS, TIME = (0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)
SPEED, RATE, FORCE, ENERGY, POWER = (1, 0, -1), (0, 0, -1), (1, 1, -2), (2, 1, -2), (2, 1, -3)
STIFFNESS, DAMPING = (0, 1, -2), (0, 1, -1)
PARTS = {
    "nodes": LENGTH, "node_mass": MASS, "rest_length": LENGTH, "mass": MASS, "gravity": (1, 0, -2),
    "stiffness": STIFFNESS, "damping": DAMPING, "node_damping": DAMPING, "dissipation": (-1, 0, 1), "mu": NUMBER,
    "slip_speed": SPEED, "phase": NUMBER, "amplitude": NUMBER, "frequency": RATE, "start": TIME, "ramp": TIME,
    "size": NUMBER, "restitution": NUMBER,
}  # fmt: skip
"""of a scene: the powers of length, mass and time in which their units are"""
REPORTS: dict[str, dict[str, tuple]] = {
    "Rolling": {"since": TIME, "path_length": LENGTH, "duration": TIME},
    "Metrics": {
        "path": LENGTH, "work": ENERGY, "effort": ENERGY, "contact": TIME, "slip": TIME, "flight": TIME,
        "force": FORCE, "peak_force": FORCE, "peak_rate": SPEED, "peak_power": POWER,
        "moved_x": LENGTH, "moved_y": LENGTH, "moved_z": LENGTH, "rise": LENGTH, "since": TIME,
    },
    "Forces": {"tension": FORCE, "ground": FORCE},
    "EnergyAudit": {
        "times": TIME, "positions": LENGTH, "kinetic": ENERGY, "potential": ENERGY, "actuation": ENERGY,
        "dissipated": ENERGY, "momentum_residual": (1, 1, -1), "angular_residual": (2, 1, -1),
        "constraint_residual": SPEED,
    },
    "Orbit": {
        "period": TIME, "speed": SPEED, "standard_error": SPEED, "turning": RATE, "velocity": SPEED,
        "residual": LENGTH, "settled_after": TIME, "windows": SPEED, "verified_for": TIME, "body_length": LENGTH,
        "window": TIME, "scene_time": TIME,
    },
    "Stability": {"spread": LENGTH},
}  # fmt: skip
"""likewise of reports; what is not named is a plain number, words, or node numbers"""
SIZES = {
    "a millimetre": (1e-3, 1e-9, 1e-3**0.5),
    "a centimetre, like feathers": (1e-2, 1e-8, 0.1),
    "a metre, on the moon": (1.0, 1.0, 6.0**0.5),
    "an hour for a second": (1.0, 1.0, 3600.0),
    "20 metres": (20.0, 8e3, 20.0**0.5),
    "100 metres, a thousand times as fast": (100.0, 1e6, 1e-2),
}


def test_the_gait_is_the_clock_of_robots_without_weight_and_springs():
    """The scene's, of 3 Hz, whatever gaits a population has: sqrt(g/1 m) over 2 pi f, as of the scene alone."""
    struts = Members(((0, 1),), None, np.ones(1))
    gait = Gait((0,), np.zeros(1), np.full(1, 0.4), np.full(1, 3.0))
    scene = Scene(Structure(np.eye(3)[:2] / np.sqrt(2), np.array([2.0, 1.0]), struts), gait=gait)
    others = gaits_of(gait, np.zeros((2, 1)), frequency=np.full((2, 1), 10.0))
    common = with_gait(scene, at_start(scene, others))
    np.testing.assert_allclose([time_scale(common), time_scale(scene)], np.sqrt(9.81) / (2 * np.pi * 3), rtol=1e-12)


KINDS = pytest.mark.parametrize(
    "kind", [pytest.param("exact", marks=pytest.mark.slow), pytest.param("penalty", marks=pytest.mark.campaign)]
)


def factor(size: tuple, unit: tuple) -> float:
    return float(np.prod([s**power for s, power in zip(size, unit)]))


def scaled(scene: Scene, size: tuple) -> Scene:
    """The scene `size` = (length, mass, time) times as long, as heavy, and as slow."""

    def times(path, x):
        return x * factor(size, PARTS[path[-1].name])

    return jax.tree_util.tree_map_with_path(times, scene)


def mapped_back(report: Any, size: tuple) -> dict[str, Any]:
    """Its fields, in the units of the motion that was scaled."""
    units = REPORTS[type(report).__name__]
    fields = report._asdict()
    assert not set(units) - set(fields), "a field has another name"

    def back(name, value):
        by = factor(size, units.get(name, NUMBER))
        return jax.tree.map(lambda x: np.asarray(x, float) / by, value)

    return {name: value if isinstance(value, str) else back(name, value) for name, value in fields.items()}


def assert_alike(report: Any, other: Any, size: tuple, off: float = 1e-6) -> None:
    """Every field of `other`, of the motion scaled by `size`, against that of `report`; residuals are rounding."""
    expected, found = mapped_back(report, NUMBER_SIZE), mapped_back(other, size)
    for name, value in expected.items():
        if name == "state":
            continue
        assert jax.tree.structure(value) == jax.tree.structure(found[name]), name
        for a, b in zip(jax.tree.leaves(value), jax.tree.leaves(found[name])):
            if isinstance(a, str):
                assert a == b, name
                continue
            largest = np.abs(a[np.isfinite(a)]).max(initial=0)
            least = 1e-9 if "residual" in name or "error" in name else 0.0
            np.testing.assert_allclose(b, a, rtol=off, atol=off * largest + least, err_msg=name)


NUMBER_SIZE = (1.0, 1.0, 1.0)


def two_rods(exact: bool) -> Scene:
    """Two crossed struts in four cables, thrown flat on the ground by a gait: small, and with all that a robot has."""
    nodes = np.array([[0.5, 0, 0.01], [-0.5, 0, 0.01], [0, 0.5, 0.5], [0, -0.5, 0.5]])
    struts, cables = ((0, 1), (2, 3)), ((0, 2), (0, 3), (1, 2), (1, 3))
    built = np.full(4, np.linalg.norm(nodes[0] - nodes[2]))
    rods = Members(struts, None if exact else np.full(2, 5e3), np.ones(2), None if exact else np.full(2, 10.0))
    structure = Structure(
        nodes, [1.0, 1.0, 2.0, 1.5], rods, Members(cables, np.full(4, 400.0), 0.8 * built, np.full(4, 5.0))
    )
    gait = Gait((0, 3), [0.3, 2.0], [0.2, 0.25], [1.1, 1.1], start=0.2033, ramp=0.3)
    ground = ExactGround() if exact else PenaltyGround(4e3, 2.0)
    friction = ConeFriction(0.4) if exact else SmoothFriction(0.4, 0.01)
    return Scene(structure, 9.81, np.full(4, 0.2), ground, friction, gait)


def steps_of(scene: Scene) -> float:
    return 5e-3 if scene.constrained else 1e-3


def moved(scene: Scene, size: tuple, seconds: float = 2.5, dtype: str = "float64"):
    """The motion of the scene at that size."""
    by = size[2]
    options = SolverOptions(dt=steps_of(scene) * by, dtype=dtype)
    here = scaled(scene, size)
    return here, simulate(here, seconds * by, options=options, frame_rate=100 / by), options


@KINDS
def test_a_motion_keeps_its_name_and_its_numbers_at_every_size(kind):
    """Of rolling and of the forces: from a millimetre to 100 m, and at other paces, on both contact models."""
    scene = two_rods(kind == "exact")
    here, motion, _ = moved(scene, NUMBER_SIZE)
    roll, force, hull = rolling(here, motion), forces_along(here, motion), length_scale(scene)
    assert hull == 1.0
    assert 0.05 < roll.slip_share < 0.95
    for name, size in SIZES.items():
        there, other, _ = moved(scene, size)
        assert not other.failed, name
        np.testing.assert_allclose(other.positions / size[0], motion.positions, rtol=0, atol=1e-7, err_msg=name)
        assert_alike(roll, rolling(there, other), size)
        assert_alike(force, forces_along(there, other), size)


@pytest.mark.campaign
@pytest.mark.parametrize("size", ["a millimetre", "100 metres, a thousand times as fast"])
def test_float32_finds_the_same_motion_at_every_size(size):
    """Guards against division by zero are far below the velocities of a robot of a millimetre, too."""
    scene = two_rods(True)
    _, motion, _ = moved(scene, NUMBER_SIZE, 0.5, "float32")
    _, other, _ = moved(scene, SIZES[size], 0.5, "float32")
    np.testing.assert_allclose(other.positions / SIZES[size][0], motion.positions, rtol=0, atol=1e-4)


@KINDS
def test_what_actuators_give_follows_the_size(kind):
    """Of populations: slip, flight and peaks of moving means among them."""
    scene = two_rods(kind == "exact")
    known = None
    for name, size in ({"": NUMBER_SIZE} | SIZES).items():
        here = scaled(scene, size)
        options = SolverOptions(dt=steps_of(scene) * size[2])
        found = simulate_population(here, as_population(here.gait), 2.0 * size[2], with_metrics=True, options=options)
        assert not found.failure.any(), name
        known = found.metrics if known is None else known
        assert_alike(known, found.metrics, size)


def spinning() -> Scene:
    """Two masses on a spring that swing and turn in free space: no weight says how fast anything is."""
    members = Members(((0, 1),), [40.0], [1.0], [0.3])
    return Scene(Structure([[0.0, 0, 0], [1.2, 0, 0]], [1.0, 3.0], struts=members))


@pytest.mark.campaign
def test_without_gravity_the_fastest_mode_says_how_fast_a_body_is():
    """A trust report: error bars, energies, sensitivity and horizon of a motion that only springs drive."""
    scene, known = spinning(), None
    for name, size in ({"": NUMBER_SIZE} | SIZES).items():
        here = scaled(scene, size)
        options = SolverOptions("rk4", dt=0.02 * size[2])
        found = diagnose(here, 1.0 * size[2], options=options, frame_rate=20 / size[2])
        known = found if known is None else known
        assert_alike(known.audit, found.audit, size)
        assert found.horizon / size[2] == pytest.approx(known.horizon, rel=1e-6), name
        assert found.predictable / size[0] == pytest.approx(known.predictable, rel=1e-12), name
        assert found.sensitivity.unit == "m/(m/s)"
        np.testing.assert_allclose(found.sensitivity.norm / size[2], known.sensitivity.norm, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(found.error_bars / size[0], known.error_bars, rtol=1e-4, atol=1e-12)
        last = found.table().splitlines()[-1].split("  ")
        assert (last[0], last[-1].strip()) == (f"predictable to {size[0]:.3g} cm up to", f"{found.horizon:.3g} s")
    to_the_end = known._replace(error_bars=0 * known.error_bars, sensitivity=None)
    assert to_the_end.table().splitlines()[-1].endswith("at least 1 s"), "the rollout ends there, not the knowledge"


def test_the_scales_of_bodies():
    """1 for the library's robots to the last bit, whatever their poses; of nodes without members by their box."""
    scene = two_rods(True)
    size = (4.0, 9.0, 3.0)
    assert [float(f(scene)) for f in (length_scale, speed_scale, time_scale)] == [1.0, 1.0, 1.0]
    there = scaled(scene, size)
    assert length_scale(there) == 4.0
    assert speed_scale(there) == pytest.approx(4 / 3)
    assert time_scale(there) == pytest.approx(3.0)
    assert mass_scale(there) / mass_scale(scene) == pytest.approx(9.0)
    turned = eqx.tree_at(lambda s: s.structure.nodes, scene, 2 * scene.structure.nodes)
    assert length_scale(turned) == 1.0
    points = Scene(Structure([[0.0, 0, 0], [0.3, 0, 0.4]], [1.0, 1.0]))
    assert length_scale(points) == pytest.approx(0.5)
    assert length_scale(Scene(Structure([[0.0, 0, 7.0]], [1.0]), gravity=9.81)) == 1.0
    swings = spinning()
    rate = np.sqrt(40.0 * (1 / 1.0 + 1 / 3.0))
    assert 1.0 <= speed_scale(swings) * np.sqrt(9.81) / rate < 1.3, "the bound is near the mode"


def test_the_other_contact_model_has_the_size_of_the_first():
    """Its stiffness, its dampers, its slip speed; and the twin of the twin keeps the struts' lengths."""
    for kind in (True, False):
        scene = two_rods(kind)
        twin = contact_twin(scene)
        for size in ((1e-3, 1e-9, 1e-3**0.5), (50.0, 2.0, 7.0)):
            expected, found = scaled(twin, size), contact_twin(scaled(scene, size))
            for a, b in zip(jax.tree.leaves(expected), jax.tree.leaves(found), strict=True):
                np.testing.assert_allclose(b, a, rtol=1e-12)


def test_a_start_is_as_exact_as_the_body_is_small():
    """A millionth of its length below ground, not a micrometre: what holds at a metre holds at a millimetre."""
    for size in (1e-3, 1.0, 100.0):
        here = scaled(two_rods(True), (size, size**3, size**0.5))
        for depth, fits in ((0.5e-6, True), (2e-6, False)):
            q = np.asarray(here.structure.nodes) - [0, 0, (0.01 + depth) * size]
            if fits:
                resolve(here, 1.0, positions=q)
            else:
                with pytest.raises(InputError, match="below the ground"):
                    resolve(here, 1.0, positions=q)


@pytest.mark.slow
def test_steps_that_are_chosen_follow_the_size():
    """Within the rounding to 1, 2 and 5: the stable step exactly, and the cap by the body's time."""
    for method in ("complementarity",):
        scene = two_rods(True)
        limit, own = step_limit(scene, method).step, resolve(scene, 1.0, SolverOptions(method)).dt
        for size in ((1e-3, 1e-9, 1e-3**0.5), (1.0, 1.0, 3600.0), (100.0, 1e6, 10.0)):
            there = scaled(scene, size)
            assert step_limit(there, method).step / size[2] == pytest.approx(limit, rel=1e-5)
            assert 0.4 <= resolve(there, 1.0, SolverOptions(method)).dt / size[2] / own <= 2.5


@pytest.mark.campaign
def test_solved_together_a_motion_is_the_same_at_every_size():
    """A rod with mass that falls on an end and slides: the general solver, in mass too."""
    rod = Members(((0, 1),), None, [1.0], mass=[0.6])
    structure = Structure([[0.0, 0, 0.05], [0.6, 0, 0.85]], [0.1, 0.2], struts=rod)
    scene = Scene(structure, 9.81, ground=ExactGround(), friction=ConeFriction(0.3))
    _, motion, _ = moved(scene, NUMBER_SIZE, 0.8)
    for name in ("a millimetre", "an hour for a second", "100 metres, a thousand times as fast"):
        _, other, _ = moved(scene, SIZES[name], 0.8)
        assert not other.failed
        np.testing.assert_allclose(other.positions / SIZES[name][0], motion.positions, rtol=0, atol=1e-8, err_msg=name)


@pytest.mark.campaign
def test_an_orbit_is_the_same_at_every_size(crawler):
    """Speed, turning, windows, what disturbed robots do; multipliers are plain numbers."""
    scene, orbit, options = crawler
    held = stability(scene, orbit, options=options, robots=16)
    multipliers, slope = (
        floquet_multipliers(scene, orbit, options=options),
        speed_gradient(scene, orbit, options=options),
    )
    for name in ("a millimetre", "100 metres, a thousand times as fast"):
        size = SIZES[name]
        here, there = scaled(scene, size), SolverOptions("rk4", dt=2e-3 * size[2])
        found = find_orbit(here, 60.0 * size[2], options=there)
        assert_alike(orbit, found, size)
        again = stability(here, found, options=there, robots=16)
        np.testing.assert_allclose(np.abs(again.multipliers), np.abs(held.multipliers), rtol=1e-3, atol=1e-6)
        assert again.returned == held.returned
        assert again.spread / size[0] == pytest.approx(held.spread, rel=1e-4)
        largest = floquet_multipliers(here, found, options=there).largest
        assert largest == pytest.approx(multipliers.largest, rel=1e-3, abs=1e-6)
        tangents = speed_gradient(here, found, options=there)
        assert tangents.settled == slope.settled
        np.testing.assert_allclose(
            tangents.of_speed.amplitude / factor(size, SPEED), slope.of_speed.amplitude, rtol=1e-4
        )


def test_frames_too_rare_for_a_small_robot_are_refused():
    """A hundred a second show how a robot of a metre rolls, and miss how one of a millimetre does."""
    scene = two_rods(True)
    for size, rate in (((1e-3, 1e-9, 1e-3**0.5), 158.1), (NUMBER_SIZE, 5.0)):
        here, by = scaled(scene, size), size[2]
        q, nothing = np.tile(here.structure.nodes, (5, 1, 1)), jnp.zeros((), int)
        for apart, fits in ((0.2 * by, True), (0.202 * by, False)):
            still = Trajectory(
                apart * np.arange(5.0) + here.gait.start, q, 0 * q, nothing, nothing, nothing, "rk4", None
            )
            if fits:
                assert rolling(here, still).kind == "hops", "it hangs in the air"
            else:
                with pytest.raises(InputError, match=f"expected a frame_rate of at least {rate:g}"):
                    rolling(here, still)
