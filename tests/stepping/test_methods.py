"""The methods: their order, what they conserve, that they agree with each other, and what they refuse."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrity import FAILURES, METHODS, Gait, InputError, PenaltyGround, SmoothFriction, SolverOptions, simulate
from jaxgrity.model.inertia import energy_of_motion
from jaxgrity.model.scales import time_scale
from jaxgrity.model.scene import Scene, as_dtype
from jaxgrity.model.structure import Members, Structure
from jaxgrity.stepping import ResolvedOptions, find_method, register_method, resolve
from jaxgrity.stepping.discretisation import integrate
from jaxgrity.stepping.dynamics import angular_momentum, momentum, vector_field
from jaxgrity.stepping.step_limits import LARGEST_STEP, default_step, stable_step, standing, step_limit

T = 0.1


def free_robot(reference, damped):
    """The reference robot afloat: no ground, gravity, gait or drag. Its cables stay taut, so its motion is smooth."""
    structure = reference.structure
    if not damped:
        structure = eqx.tree_at(lambda s: (s.struts.damping, s.cables.damping), structure, (None, None))
    return Scene(structure)


@pytest.fixture(scope="module")
def damped(reference):
    return free_robot(reference, damped=True)


@pytest.fixture(scope="module")
def undamped(reference):
    return free_robot(reference, damped=False)


def spin(scene, rate=(1.0, -0.5, 2.0), drift=(0.3, 0.0, -0.2)):
    """Velocities of a rigid rotation and a drift, m/s."""
    return np.cross(rate, np.asarray(scene.structure.nodes)) + np.array(drift)


def float_off(scene, duration=T, **options):
    options = SolverOptions(**options)
    motion = simulate(scene, duration, velocities=spin(scene), frame_rate=50.0, options=options)
    assert not motion.failed
    return motion


@pytest.fixture(scope="module")
def free(damped, undamped):
    return {"d": damped, "u": undamped}


@pytest.fixture(scope="module")
def exact(free):
    """Both motions by Dopri8 at its tightest."""
    return {which: float_off(scene, method="dopri8", rtol=1e-13, atol=1e-13) for which, scene in free.items()}


@pytest.mark.campaign
def test_cables_stay_taut_in_the_smooth_scene(exact, damped):
    cables = damped.structure.cables
    i, j = np.array(cables.edges).T
    q = np.asarray(exact["d"].positions)
    assert np.all(np.linalg.norm(q[:, i] - q[:, j], axis=2) > cables.rest_length)


@pytest.mark.parametrize(
    ("name", "which", "steps", "expected"),
    [
        pytest.param(
            *("rk4", "d", (1e-3, 5e-4, 2.5e-4), pytest.approx([4.0, 4.0], abs=0.2)), marks=pytest.mark.campaign
        ),
        ("verlet", "u", (4e-4, 2e-4, 1e-4), pytest.approx([2.0, 2.0], abs=0.1)),
    ],
)
@pytest.mark.slow
def test_error_falls_with_the_order_of_the_method(exact, free, name, which, steps, expected):
    """The slope between one step and half of it."""
    scene = free[which]
    end = exact[which].positions[-1]
    errors = [np.abs(float_off(scene, method=name, dt=dt).positions[-1] - end).max() for dt in steps]
    assert list(np.log2(np.array(errors[:-1]) / errors[1:])) == expected


@pytest.mark.parametrize("name", ["tsit5", "kvaerno5"])
@pytest.mark.campaign
def test_methods_agree_on_the_smooth_scene(exact, damped, name):
    """1e-9 m, a hundred times the tolerance of each step, at every saved frame."""
    motion = float_off(damped, method=name, rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(motion.positions, exact["d"].positions, rtol=0, atol=1e-9)


def test_forces_between_nodes_have_no_resultant_and_no_moment(damped):
    """Members, damped or not, pull their two ends with opposite forces along the same line."""
    random = np.random.default_rng(0)
    q = np.asarray(damped.structure.nodes) + 0.1 * random.normal(size=(12, 3))
    v = random.normal(size=(12, 3))
    _, a = vector_field(jnp.asarray(0.0), (q, v), damped)
    size = float(jnp.sum(damped.structure.node_mass * jnp.linalg.norm(a, axis=1)))
    assert np.abs(momentum(damped, a)).max() < 1e-14 * size
    assert np.abs(angular_momentum(damped, q, a)).max() < 1e-14 * size


@pytest.mark.parametrize(("name", "dt"), [("rk4", 5e-4), ("verlet", 1e-4), ("dopri8", None)])
@pytest.mark.slow
def test_momentum_and_angular_momentum_are_conserved(exact, damped, undamped, name, dt):
    """To 1e-12: p by every method; L exactly by Verlet, by others to their error (RK4 at 5e-4 s: not asked)."""
    if name == "dopri8":
        scene, motion = damped, exact["d"]
    else:
        scene = undamped if name == "verlet" else damped
        motion = float_off(scene, method=name, dt=dt)
    q, v = motion.positions, motion.velocities
    p = np.array([momentum(scene, x) for x in v])
    np.testing.assert_allclose(p, np.broadcast_to(p[0], p.shape), rtol=0, atol=1e-12 * np.linalg.norm(p[0]))
    if name != "rk4":
        L = np.array([angular_momentum(scene, x, u) for x, u in zip(q, v)])
        np.testing.assert_allclose(L, np.broadcast_to(L[0], L.shape), rtol=0, atol=1e-12 * np.linalg.norm(L[0]))


@pytest.mark.slow
def test_verlet_energy_error_stays_bounded(undamped):
    """Over 20,000 steps the error of the energy swings, and swings no further in the last quarter than in the first."""
    motion = float_off(undamped, 10.0, method="verlet", dt=5e-4)
    kinetic = jax.vmap(lambda v: energy_of_motion(undamped.structure, v))(motion.velocities)
    E = np.array(kinetic + jax.vmap(lambda q: undamped.potential_energy(q, 0.0))(motion.positions))
    error = np.abs(E - E[0])
    quarter = len(E) // 4
    # RK4 at 2e-3 s, which loses 4 % of the energy, misses both by far: a ratio of 2, a drift of 0.9 of the error.
    assert error[-quarter:].max() < 1.1 * error[1:quarter].max()
    assert abs(np.polyfit(motion.times, E, 1)[0] * 10.0) < 0.05 * error.max()
    # h^2 omega^2 / 8 = 3e-3 of what vibrates at omega = 300 1/s, the stiffest mode, which holds less than a third of E
    assert error.max() < 1e-3 * E[0]


@pytest.mark.slow
def test_rk4_step_is_the_papers(reference):
    """One step in contact, under a gait, against section 4's formula; equal but for the order of sums.

    t and h are binary fractions, so that both sides take exactly the same step.
    """
    scene, h, t = as_dtype(reference, "float64"), 2.0**-11, 1.25
    q = jnp.asarray(reference.structure.nodes) - jnp.array([0, 0, 0.025])
    state = (q, 0.1 * jnp.asarray(np.random.default_rng(0).normal(size=q.shape)))

    field = eqx.filter_jit(vector_field)

    def f(t, x):
        return field(jnp.asarray(t), x, scene)

    def add(x, h, *slopes):
        return jax.tree.map(lambda a, *k: a + h * sum(k), x, *slopes)

    k1 = f(t, state)
    k2 = f(t + h / 2, add(state, h / 2, k1))
    k3 = f(t + h / 2, add(state, h / 2, k2))
    k4 = f(t + h, add(state, h, k3))
    expected = add(state, h / 6, k1, k2, k2, k3, k3, k4)
    options = resolve(reference, h, SolverOptions(method="rk4", dt=h))
    times = jnp.array([t, t + h])
    actual = jax.tree.map(lambda x: x[-1], integrate(state, times, scene, options).ys)
    # positions and velocities of some m and m/s, with float64's 16 digits
    for a, b in zip(actual, expected):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-14)


def oscillator(damping=None):
    """Two nodes on a strut at rest length: one mode, omega = sqrt(K (1/m1 + 1/m2)), and omega."""
    nodes = np.array([[0.0, 0, 0], [1.0, 0, 0]])
    struts = Members(((0, 1),), np.array([100.0]), np.ones(1), damping)
    return Scene(Structure(nodes, np.array([1.0, 2.0]), struts)), np.sqrt(100.0 * 1.5)


def test_rk4_keeps_its_order_if_a_gait_starts_at_the_end_of_a_step():
    """The library's scenes start gaits there. Inside a step, the corner of the ramp costs two orders and more."""
    gait = Gait((0,), np.array([0.5]), np.array([0.2]), np.array([1.0]), start=0.2, ramp=0.2)
    scene = eqx.tree_at(lambda s: s.gait, oscillator()[0], gait, is_leaf=lambda x: x is None)

    def end(start, dt):
        late = eqx.tree_at(lambda s: s.gait.start, scene, start)
        return np.asarray(simulate(late, 0.6, options=SolverOptions(method="rk4", dt=dt)).positions[-1])

    for start, smallest, largest in ((0.2, 3.8, 4.3), (0.2031, 0.0, 2.5)):
        errors = [np.abs(end(start, 0.02 / 2**k) - end(start, 0.02 / 2**6)).max() for k in (0, 2)]
        assert smallest < np.log2(errors[0] / errors[1]) / 2 < largest


@pytest.mark.parametrize(("name", "limit"), [("rk4", 2 * np.sqrt(2)), ("verlet", 2.0)])
def test_stable_step_of_an_oscillator_is_the_textbooks(name, limit):
    """omega h = 2.828 on the imaginary axis for RK4, 2 for Verlet; 5e-4: growth of 1e-3 a step counts as stable."""
    scene, omega = oscillator()
    np.testing.assert_allclose(stable_step(scene, standing(scene), METHODS[name]) * omega, limit, rtol=5e-4)


@pytest.mark.parametrize(
    "name",
    [pytest.param("verlet", marks=pytest.mark.slow)]
    + [pytest.param(name, marks=pytest.mark.campaign) for name in ("rk4", "tsit5", "dopri8")],
)
def test_motion_blows_up_beyond_the_stable_step_and_not_below(name):
    """On a strongly damped strut, where every Runge-Kutta method has a clear limit; Verlet on an undamped one."""
    scene, _ = oscillator(None if name == "verlet" else np.array([20.0]))
    limit = stable_step(scene, standing(scene), METHODS[name])
    stretched = np.array([[0.0, 0, 0], [1.001, 0, 0]])

    def final_energy(factor):
        motion = simulate(
            scene,
            400 * limit,
            positions=stretched,
            options=SolverOptions(method=name, dt=factor * limit, any_step=True),
        )
        return np.inf if motion.failed else float(energy_of_motion(scene.structure, motion.velocities[-1]))

    start = 100.0 / 2 * 1e-3**2
    assert final_energy(0.98) <= start
    assert final_energy(1.02) > 100 * start


@pytest.mark.parametrize(
    "fixed",
    [
        pytest.param(((0, "y"), (1, "y")), id="in a plane"),
        pytest.param(((0, "xyz"),), id="about a hinge", marks=pytest.mark.campaign),
    ],
)
def test_what_supports_let_fall_lands(fixed):
    """On soft ground below, whose friction limits the step of the nodes that may move as it does without supports."""
    struts = Members(((0, 1),), [100.0], [1.0], damping=[1.0])
    free = Structure(np.array([[0.0, 0, 0.05], [1, 0, 0.05]]), [0.1, 0.1], struts)
    ground = {"ground": PenaltyGround(1e5, 0.5), "friction": SmoothFriction(0.5, 1e-3)}
    found = [step_limit(Scene(each, 9.81, **ground), "rk4") for each in (free, dataclasses.replace(free, fixed=fixed))]
    assert found[1].set_by.startswith("friction at node")
    np.testing.assert_allclose(found[1].step, found[0].step, rtol=0.01)


@pytest.mark.parametrize("name", ["kvaerno3", "kvaerno5"])
def test_implicit_methods_have_no_largest_step(name):
    scene, _ = oscillator()
    assert stable_step(scene, standing(scene), METHODS[name]) == np.inf
    largest = LARGEST_STEP * float(time_scale(scene))
    assert largest / 2.5 < default_step(scene, METHODS[name]) <= largest


@pytest.mark.slow
def test_a_step_that_becomes_too_small_is_a_failure():
    """A strut that swings at a million radians a second cannot be resolved over 200 s in float32."""
    struts = Members(((0, 1),), np.array([1e9]), np.ones(1))
    scene = Scene(Structure(np.array([[0.0, 0, 0], [1.01, 0, 0]]), np.full(2, 1e-3), struts))
    motion = simulate(scene, 200.0, options=SolverOptions(method="tsit5", dtype="float32", max_steps=10**5))
    assert FAILURES[int(motion.failure)] == "the step became too small"


@pytest.mark.parametrize(
    ("name", "fixed"),
    [
        pytest.param("rk4", True, marks=pytest.mark.slow),
        pytest.param("tsit5", False, marks=pytest.mark.slow),
        pytest.param("kvaerno3", False, marks=pytest.mark.campaign),
    ],
)
def test_another_step_is_not_compiled_anew(name, fixed):
    """Nor is another tolerance: the solver is built once, where the program is made; each has its own result."""
    built = []
    method = METHODS[name]
    build = method.fixed if fixed else method.adaptive
    counting = method._replace(**{"fixed" if fixed else "adaptive": lambda: built.append(name) or build()})
    strut = Members(((0, 1),), np.array([100.0]), np.array([0.8]))
    scene = Scene(Structure(np.array([[0.0, 0, 0], [1.0, 0, 0]]), np.ones(2), strut))
    start = scene.structure.nodes, np.zeros((2, 3))
    run = eqx.filter_jit(lambda options: integrate(start, jnp.array([0.0, 1.0]), scene, options).ys[0][-1])
    choices = [ResolvedOptions(counting, x if fixed else None, "float64", x, x) for x in (1e-2, 1e-3)]
    coarse, fine = (run(options.as_inputs()) for options in choices)
    assert built == [name]
    assert 0 < jnp.abs(coarse - fine).max() < 0.1
    if fixed:
        np.testing.assert_allclose(fine, run(choices[1]), rtol=0, atol=1e-12)
        assert built == [name, name], "as a number, the step is part of the program"


@pytest.mark.slow
def test_failure_is_data(reference):
    """A step far too large, asked for in spite of the check, comes back as a motion marked as failed."""
    motion = simulate(reference, 1.0, options=SolverOptions(dt=0.1, any_step=True))
    assert motion.failed
    assert not simulate(reference, 1.0, options=SolverOptions(dt=5e-4)).failed


@pytest.mark.slow
def test_the_former_name_of_verlet_warns_and_gives_the_same(undamped):
    """To the last bit; and no method of one's own can take it."""
    with pytest.warns(FutureWarning, match="method 'symplectic' is now called 'verlet'"):
        former = float_off(undamped, 0.02, method="symplectic", dt=4e-4)
    motion = float_off(undamped, 0.02, method="verlet", dt=4e-4)
    assert former.method == "verlet"
    assert np.asarray(former.positions).tobytes() == np.asarray(motion.positions).tobytes()
    with pytest.raises(InputError, match="method = 'symplectic': there is one of this name already"):
        register_method(METHODS["rk4"]._replace(name="symplectic"))
    with pytest.warns(FutureWarning, match="verlet"):
        assert find_method("symplectic") is METHODS["verlet"]


def test_methods_that_cannot_be_registered():
    """A name that is taken, and an explicit method whose stability nothing says."""
    with pytest.raises(InputError, match="method = 'rk4': there is one of this name already; expected another name"):
        register_method(METHODS["rk4"])
    with pytest.raises(InputError, match="method = 'mine': its solver has no tableau; expected a diffrax"):
        register_method(METHODS["verlet"]._replace(name="mine", symplectic=False))
    assert "mine" not in METHODS
