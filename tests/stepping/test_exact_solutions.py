"""Motions known in closed form, by every method: positions, and their derivatives by a parameter, at five times."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from exact_problems import PROBLEMS, Problem

from jaxgrity import METHODS, InputError, SolverOptions
from jaxgrity.model.scene import as_dtype
from jaxgrity.stepping import ResolvedOptions, resolve
from jaxgrity.stepping.discretisation import integrate

FRAMES = 5
# What an adaptive method may err in a step, m and m/s: kvaerno3 would need very many steps for 1e-10.
STEP_ERROR = dict.fromkeys(METHODS, 1e-10) | {"kvaerno3": 1e-8}
# Of the phase of an oscillation after one radian, over (omega h)^order.
PHASE_ERROR = {"rk4": 1 / 120, "verlet": 1 / 24}


def fixed_step(problem: Problem, name: str) -> float | None:
    """Kinked motions go by small fixed steps in every method: error control does not watch the derivative there."""
    if problem.kink is not None:
        return 1e-4
    return None if METHODS[name].adaptive else 1e-3


def tolerances(problem: Problem, name: str) -> tuple[float, float]:
    """Of positions and of their derivatives by log x, m.

    Fixed steps: twice the error of the phase, which moves by (order + 1 + omega T) times as much with log omega.
    Adaptive: a hundred steps' errors, more than there are steps, for frames are interpolated between them. A kink adds
    the trapezoidal rule's error at one, J s (h - s)/2 in velocity for a kink s into the step: twice J h^2/8 at most
    (into contact, and out), and its derivative, J h/2 at most, by the shift of the last one.
    """
    value = gradient = problem.limit
    h, order, angle = fixed_step(problem, name), METHODS[name].order, problem.rate * problem.duration
    if name in PHASE_ERROR:
        swing = 2 * problem.size * angle * (problem.rate * h) ** order * PHASE_ERROR[name]
        value, gradient = value + swing, gradient + swing * (order + 1 + angle)
    else:
        value, gradient = value + 100 * STEP_ERROR[name], gradient + 500 * STEP_ERROR[name]
    if problem.kink is not None:
        kink = problem.kink
        value += kink.jump * h**2 / 4 * problem.duration
        gradient += kink.jump * h / 2 * kink.shift * kink.remaining
    return value, gradient


# Forces do not know the method, nor a method the forces: each motion by one method at least, each method on one motion.
FAST = [("spring and mass", "rk4"), ("spring and mass", "tsit5"), ("bounce", "rk4")]
SLOW = [
    ("free fall", "dopri8"),
    ("drag", "kvaerno3"),
    ("damped oscillator", "kvaerno5"),
    ("driven strut", "verlet"),
    ("conical pendulum", "rk4"),
    ("cable snap", "rk4"),
    ("block creeping", "rk4"),
    ("block sliding, smooth", "rk4"),
    ("block sliding, switch", "rk4"),
    ("block sticking, switch", "rk4"),
]
BY_COMPLEMENTARITY = ["driven strut"]


def size_of(title: str, name: str) -> tuple:
    """The mark of a motion and a method: what no list has is for campaigns."""
    if (title, name) in FAST:
        return ()
    return pytest.mark.slow if (title, name) in SLOW else pytest.mark.campaign


@pytest.mark.slow
@pytest.mark.parametrize(
    ("title", "name"),
    [
        pytest.param(title, name, marks=size_of(title, name))
        for title in PROBLEMS
        for name in METHODS
        if not METHODS[name].constrained
    ],
)
def test_motion_and_its_derivative_are_the_exact_ones(title, name):
    """To the tolerance of the method."""
    problem = PROBLEMS[title]
    scene = problem.setup(problem.value)[0]
    dt, tolerance = fixed_step(problem, name), STEP_ERROR[name]
    step = {"dt": dt} if dt is not None else {"rtol": tolerance, "atol": tolerance}
    options = SolverOptions(method=name, any_step=True, **step)
    if METHODS[name].symplectic and scene.dissipates:
        with pytest.raises(InputError, match="without dissipation"):
            resolve(scene, problem.duration, options)
        return
    q, dq = motion(title, resolve(scene, problem.duration, options))
    q_exact, dq_exact = exact_motion(title)
    value, gradient = tolerances(problem, name)
    assert np.abs(dq_exact).max() > 100 * gradient, "the tolerance would pass a derivative of zero"
    np.testing.assert_allclose(q, q_exact, rtol=0, atol=value)
    np.testing.assert_allclose(dq, dq_exact, rtol=0, atol=gradient)


@pytest.mark.parametrize(
    "title",
    [
        pytest.param(title, marks=pytest.mark.slow if title in BY_COMPLEMENTARITY else pytest.mark.campaign)
        for title, problem in PROBLEMS.items()
        if problem.kink is None
    ],
)
def test_complementarity_stepping_is_of_second_order(title):
    """Without constraints it is a leapfrog: half the step, a quarter of the error, derivatives too."""
    problem = PROBLEMS[title]
    scene = problem.setup(problem.value)[0]
    errors = []
    for dt in (4e-4, 2e-4):
        options = SolverOptions(method="complementarity", dt=dt, any_step=True)
        found = motion(title, resolve(scene, problem.duration, options))
        errors.append([float(np.abs(a - b).max()) for a, b in zip(found, exact_motion(title))])
    for coarse, fine in zip(*errors):
        assert coarse < 1e-4
        assert fine < 0.26 * coarse or coarse < 1e-12


def motion(title: str, options: ResolvedOptions) -> tuple:
    """Positions at five times, and their derivatives by log x: x d/dx, a length too."""
    times = np.linspace(0, PROBLEMS[title].duration, FRAMES)
    return _rollout_and_derivative(*_numbers(title), times, options.as_inputs())


@functools.cache
def _numbers(title: str) -> tuple:
    """Scene, positions and velocities of a problem, and their derivatives by log x."""
    x = PROBLEMS[title].value

    def setup(x):
        scene, *start = PROBLEMS[title].setup(x)
        return as_dtype(scene, "float64"), *(jnp.asarray(part, float) for part in start)

    return jax.jit(lambda x: jax.jvp(setup, (x,), (x,)))(x)


@eqx.filter_jit
def _rollout_and_derivative(numbers: tuple, derivatives: tuple, times, options: ResolvedOptions) -> tuple:
    """Compiled once for all problems of the same structure, for all their numbers, steps and tolerances."""

    def positions(numbers):
        scene, q, v = numbers
        return integrate((q, v), times, scene, options).ys[0]

    return jax.jvp(positions, (numbers,), (derivatives,))


@functools.cache
def exact_motion(title: str) -> tuple:
    """The same in closed form."""
    problem = PROBLEMS[title]
    times = jnp.linspace(0, problem.duration, FRAMES)

    def path(x):
        return jax.vmap(lambda t: problem.exact(t, x))(times)

    return jax.jit(lambda x: jax.jvp(path, (x,), (x,)))(problem.value)


def test_bounce_ends_where_it_began():
    """Without dissipation, the exact solution comes back to rest at the height of the fall."""
    problem = PROBLEMS["bounce"]
    end, speed = jax.jvp(lambda t: problem.exact(t, problem.value), (problem.duration,), (1.0,))
    np.testing.assert_allclose(end, problem.setup(problem.value)[1], rtol=0, atol=1e-14)
    np.testing.assert_allclose(speed, 0, atol=1e-13)
