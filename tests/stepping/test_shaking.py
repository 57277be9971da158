"""Supports that move: driven oscillators and pendulums, inertia, the energy balance, scene files."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from jaxgrity import (
    InputError,
    Members,
    Scene,
    Shaking,
    SolverOptions,
    Structure,
    describe,
    energy_audit,
    final_state,
    load_scene,
    parse_scene,
    rollout,
    save_scene,
    scene_text,
    simulate,
)
from jaxgrity.model.inertia import mass_matrix
from jaxgrity.stepping import resolve
from jaxgrity.stepping.dynamics import acceleration, total_force

DAMPING = 4.0
TABLE = Shaking([0.02, 0.0, 0.0], 1.5, ramp=2.0)


def oscillator() -> Scene:
    """1 kg on a spring of 100 N/m along x, damped by 4 N s/m, whose other end is shaken."""
    nodes = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    spring = Members(((0, 1),), [100.0], [1.0], damping=[DAMPING])
    return Scene(Structure(nodes, [0.5, 1.0], spring, fixed=((0, "xyz"), (1, "yz"))), shaking=TABLE)


def response() -> tuple[float, complex]:
    """w, rad/s, and H = (K + i c w)/(K - m w^2 + i c w), by which the motion of the table is multiplied."""
    w = 2 * np.pi * 1.5
    return w, (100 + 1j * DAMPING * w) / (100 - w**2 + 1j * DAMPING * w)


def pendulum() -> Scene:
    """A point of 1 kg on a rigid rod of 0.5 m, whose pivot is shaken along x."""
    nodes = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -0.5]])
    rod = Members(((0, 1),), None, [0.5])
    return Scene(Structure(nodes, [0.0, 1.0], rod, fixed=((0, "xyz"),)), 9.81, shaking=TABLE)


def swing(times: np.ndarray) -> np.ndarray:
    """The pendulum's angle by scipy: phi'' = -(g sin phi + s'' cos phi)/L."""
    move = jax.jit(jax.grad(jax.grad(lambda t: TABLE.displacement(t)[0])))

    def rates(t, y):
        return [y[1], -(9.81 * np.sin(y[0]) + float(move(t)) * np.cos(y[0])) / 0.5]

    return solve_ivp(rates, (0, times[-1]), [0.0, 0.0], "DOP853", times, rtol=1e-9, atol=1e-11).y[0]


@pytest.fixture(scope="module")
def shaken():
    return energy_audit(oscillator(), 12.0, options=SolverOptions(method="rk4", dt=5e-3), frame_rate=20.0)


@pytest.mark.slow
def test_a_driven_oscillator_has_the_amplitude_and_phase_of_theory(shaken):
    """x = A Im(H exp(i w t)), once the start has died down."""
    w, H = response()
    late = shaken.times > 10.0
    expected = np.imag(0.02 * H * np.exp(1j * w * shaken.times[late]))
    np.testing.assert_allclose(shaken.positions[late, 1, 0] - 1.0, expected, atol=5e-6)
    at = shaken.positions[late, 0, 0]
    np.testing.assert_allclose(at, 0.02 * np.sin(w * shaken.times[late]), atol=1e-6)


@pytest.mark.slow
def test_the_work_of_the_table_is_what_the_damper_takes(shaken):
    """On average c (x' - s')^2, and the balance of energy closes at every frame."""
    assert abs(shaken.residual).max() < 1e-5 * shaken.turned_over
    assert shaken.momentum_residual.max() < 1e-5
    w, H = response()
    power = DAMPING / 2 * (w * 0.02 * abs(H - 1)) ** 2
    whole = -np.interp([10.0, 12.0], shaken.times, shaken.dissipated["supports"])
    np.testing.assert_allclose(np.diff(whole) / 2.0, power, rtol=1e-3)


@pytest.mark.campaign
def test_a_rigid_pendulum_follows_its_pivot_at_second_order():
    times = np.linspace(0.0, 1.5, 16)
    errors = []
    for dt in (4e-3, 2e-3):
        moved = simulate(pendulum(), 1.5, options=SolverOptions(dt=dt), frame_rate=10.0).positions
        d = moved[:, 1] - moved[:, 0]
        errors.append(abs(np.arctan2(d[:, 0], -d[:, 2]) - swing(times)).max())
    assert errors[1] < errors[0] / 3.5
    assert errors[1] < 2e-5
    audit = energy_audit(pendulum(), 1.5, options=SolverOptions(dt=2e-3), frame_rate=10.0)
    assert abs(audit.residual).max() < 1e-3 * audit.turned_over
    assert abs(audit.dissipated["supports"]).max() > 0.1 * audit.turned_over


@pytest.mark.slow
@pytest.mark.parametrize("dtype", ["float64", pytest.param("float32", marks=pytest.mark.campaign)])
def test_exact_stepping_takes_supports_to_where_they_are(dtype):
    """A tenth of a period a step, a thousand of them: places and velocities are those of the motion, to rounding."""
    fast = Shaking([0.002, 0.0, 0.001], 20.0, ramp=0.5)
    scene = Scene(pendulum().structure, 9.81, shaking=fast)
    moved = simulate(scene, 5.0, options=SolverOptions(dt=5e-3, any_step=True, dtype=dtype), frame_rate=200.0)
    times, rounding = np.asarray(moved.times), float(np.finfo(dtype).eps)
    displacement, velocity = jax.jit(jax.vmap(lambda t: (fast.displacement(t), fast.velocity(t))))(times)
    np.testing.assert_allclose(moved.positions[:, 0], displacement, rtol=0, atol=20 * rounding)
    np.testing.assert_allclose(moved.velocities[:, 0], velocity, rtol=0, atol=20 * rounding * 2 * np.pi * 20)


@pytest.mark.campaign
def test_runge_kutta_methods_know_where_supports_are():
    """Though their steps do not end where the motion bends, and dampers act: what they return is a start, later too."""
    abrupt = Shaking([0.2, 0.0, 0.0], 2.0, ramp=0.2)
    scene = Scene(oscillator().structure, shaking=abrupt)
    options = resolve(scene, 4.0, SolverOptions(method="rk4", dt=3e-3, any_step=True))
    moved = simulate(scene, 4.0, options=options, frame_rate=10.0)
    np.testing.assert_allclose(moved.positions[:, 0, 0], jax.vmap(abrupt.displacement)(moved.times)[:, 0], atol=1e-5)
    np.testing.assert_allclose(moved.velocities[:, 0, 0], jax.vmap(abrupt.velocity)(moved.times)[:, 0], atol=1e-9)
    whole = rollout(scene, np.array([0.0, 2.0, 4.0]), options=options)
    assert whole.ok
    later = rollout(scene, np.array([2.0, 4.0]), start=(whole.positions[1], whole.velocities[1]), options=options)
    assert later.ok
    np.testing.assert_allclose(later.positions[-1], whole.positions[-1], rtol=0, atol=1e-12)


@pytest.mark.campaign
def test_a_start_in_the_middle_of_a_motion_moves_with_its_supports():
    """What a rollout returns goes on as if nothing had been; supports at rest are refused there, or not ok."""
    scene = pendulum()
    options, times = resolve(scene, 1.0, SolverOptions(dt=5e-3)), np.array([0.0, 0.6, 1.2])
    whole = rollout(scene, times, options=options)
    later = rollout(scene, times[1:], start=(whole.positions[1], whole.velocities[1]), options=options)
    np.testing.assert_allclose(later.positions[-1], whole.positions[-1], rtol=0, atol=1e-12)
    assert whole.ok
    assert later.ok
    expected = r"velocities\[0\] = \[0. 0. 0.\]: expected the velocity of its support at 0.6 s"
    with pytest.raises(InputError, match=expected):
        rollout(scene, times[1:], options=options)
    with pytest.raises(InputError, match=expected):
        final_state(scene, 0.1, options, since=0.6)
    at_rest = jnp.zeros((2, 3))
    traced = jax.jit(lambda v: rollout(scene, times[1:], start=(scene.structure.nodes, v), options=options).ok)
    assert not traced(at_rest)
    assert traced(whole.velocities[1])


def test_rods_with_mass_are_carried_along():
    """M a = F at what is free, a = s'' at what is fixed, with a mass matrix that joins both."""
    nodes = np.array([[0.0, 0.0, 0.0], [1.0, 0.2, 0.0], [1.5, 0.0, 0.3]])
    rods = Members(((0, 1), (1, 2)), [100.0, 80.0], [0.9, 0.5], mass=[2.0, 1.0])
    scene = Scene(Structure(nodes, np.full(3, 0.1), rods, fixed=((0, "xyz"), (2, "z"))), 9.81, shaking=TABLE)
    q, v = jnp.asarray(nodes), jnp.asarray(np.random.default_rng(0).normal(size=(3, 3)))

    @jax.jit
    def found(t):
        a, force = acceleration(scene, t, q, v), total_force(scene, t, q, v)
        left = (mass_matrix(scene.structure) @ a.ravel()).reshape(3, 3) - force
        return a, left, jax.jacfwd(jax.jacfwd(TABLE.displacement))(t)

    a, left, now = map(np.asarray, found(0.7))
    free = scene.structure.free
    np.testing.assert_allclose(left[free], 0, atol=1e-9)
    np.testing.assert_allclose(a[0], now, atol=1e-12)
    np.testing.assert_allclose(a[2, 2], now[2], atol=1e-12)


def test_scene_files_shake(tmp_path):
    text = scene_text("reference").replace(
        "[gravity]", "[shaking]\namplitude = [0.01, 0, 0]\nfrequency = 3.0\n\n[gravity]"
    )
    with pytest.raises(InputError, match="nothing is fixed"):
        parse_scene(text)
    scene = parse_scene(text.replace('pose = "face"', 'pose = "face"\nfixed = [0]'))
    assert "shaking" in describe(scene)
    save_scene(scene, tmp_path / "robot.toml")
    again = load_scene(tmp_path / "robot.toml").shaking
    assert (again.amplitude.tolist(), float(again.frequency), float(again.ramp)) == ([0.01, 0.0, 0.0], 3.0, 1.0)


def test_supports_begin_at_rest():
    with pytest.raises(InputError, match=r"shaking.start = -1 s: expected a finite number, at least 0"):
        Shaking([0.1, 0.0, 0.0], 1.0, start=-1.0)
    with pytest.raises(InputError, match="expected a positive number"):
        Shaking([0.1, 0.0, 0.0], 1.0, ramp=0.0)
    with pytest.raises(InputError, match=r"expected \(3,\)"):
        Shaking([0.1], 1.0)
