"""Options: what is left open is chosen for the scene, and what cannot work is refused before anything compiles."""

import dataclasses

import jax
import numpy as np
import pytest

from jaxgrity import (
    METHODS,
    ConeFriction,
    Differences,
    Gait,
    InputError,
    Members,
    Push,
    Scene,
    SolverOptions,
    Structure,
    final_state,
    gaits_of,
    rollout,
    simulate,
    simulate_population,
    with_terms,
)
from jaxgrity.model import exact_twin
from jaxgrity.stepping import ResolvedOptions, resolve
from jaxgrity.stepping.options import MOST_SWEEPS
from jaxgrity.stepping.step_limits import default_step, stable_step, standing


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "euler"}, r"'euler'.*rk4, tsit5, dopri8"),
        ({"duration": -1.0}, r"duration = -1"),
        ({"duration": float("nan")}, r"duration = nan"),
        ({"dt": 0.0}, r"dt = 0"),
        ({"rtol": -1e-6, "method": "tsit5"}, r"rtol = -1e-06"),
        ({"rtol": 1e-6}, r"rtol, atol: 'rk4' at a fixed step has no tolerances"),
        ({"rtol": 1e-6, "method": "tsit5", "dt": 1e-3}, r"'tsit5' at a fixed step"),
        ({"rtol": 1e-20, "method": "tsit5"}, r"rtol = 1e-20: float64 cannot meet it; expected at least 2e-15"),
        ({"max_steps": 0, "method": "tsit5"}, r"max_steps = 0: expected a whole number, at least 1"),
        ({"strut_tolerance": np.nan}, r"strut_tolerance = nan m: expected a positive number"),
        ({"dtype": "float16"}, r"'float16'"),
        ({"method": "verlet"}, r"without dissipation"),
    ],
)
def test_what_cannot_work_is_refused_by_name(reference, options, message):
    """One line, with the value received."""
    options = dict(options)
    duration = options.pop("duration", 1.0)
    with pytest.raises(InputError, match=message):
        resolve(reference, duration, SolverOptions(**options))


@pytest.mark.slow
def test_too_large_step_is_refused_with_the_largest_stable_one(reference):
    """Of the structure standing on the ground."""
    limit = stable_step(reference, standing(reference), METHODS["rk4"])
    with pytest.raises(InputError, match=rf"dt = 0\.1 s.*at most {limit:.3g} s"):
        resolve(reference, 1.0, SolverOptions(dt=0.1))


def test_what_is_left_open_is_chosen_for_the_scene(reference, exact):
    """Method and step by the scene, precision by JAX, tolerances by the precision."""
    assert resolve(reference, 1.0) == ResolvedOptions(
        METHODS["rk4"], default_step(reference, METHODS["rk4"]), "float64", 1e-8, 1e-8
    )
    assert resolve(exact, 1.0).method.constrained
    assert resolve(reference, 1.0, SolverOptions(dtype="float32")).rtol == 1e-5
    adaptive = resolve(reference, 1.0, SolverOptions(method="tsit5", rtol=1e-6))
    assert (adaptive.dt, adaptive.rtol, adaptive.atol) == (None, 1e-6, 1e-8)
    assert resolve(exact, 1.0, SolverOptions(strut_tolerance=1e-9)).sweeps == MOST_SWEEPS


def test_a_step_that_is_let_pass_warns_in_all_rollouts():
    """Once, also while a function around it is traced: nothing compiles here but what predicts the step."""
    spring, gait = Members(((0, 1),), [400.0], [1.0]), Gait((0,), [0.0], [0.0], [1.0])
    scene = Scene(Structure([[0.0, 0, 0], [1.0, 0, 0]], [1.0, 1.0], spring), gait=gait)
    given, v, times = SolverOptions("rk4", dt=0.2, any_step=True), np.zeros((2, 3)), np.array([0.0, 0.4])
    gaits, start = gaits_of(gait, np.zeros((1, 1))), scene.structure.nodes
    calls = (
        lambda v, scene: rollout(scene, times, start=(start, v), options=given).ok,
        lambda v, scene: (
            simulate_population(scene, gaits, 0.4, options=given, differences=Differences(velocities=v[None])).failure
        ),
        lambda v, scene: final_state(scene, 0.4, resolve(scene, 0.4, given), (start, v)),
    )
    for k, call in enumerate(calls):
        other = dataclasses.replace(scene, node_damping=[0.1 * k, 0.0])  # a scene is looked at once
        with pytest.warns(UserWarning, match=r"dt = 0.2 s is too large for rk4 .*; the motion is wrong"):
            jax.eval_shape(lambda v, call=call, other=other: call(v, other), v)


def test_options_that_are_resolved_stay_as_they_are(reference):
    """Also a step that the scene would refuse; the precision alone may be asked for anew."""
    options = ResolvedOptions(METHODS["rk4"], 0.1, "float32", 1e-8, 1e-8)
    assert resolve(reference, 1.0, options) is options
    assert resolve(reference, 1.0, options, dtype="float64").dtype == "float64"


def test_sweeps_are_refused_where_nothing_is_swept(exact):
    """Where struts and contacts are solved together by request, because friction is strong, or since they must be."""
    rough = dataclasses.replace(exact, friction=ConeFriction(1.2))
    held = dataclasses.replace(exact, structure=dataclasses.replace(exact.structure, fixed=((0, "xyz"),)))
    for scene, coupled, expected in (
        (exact, True, ", or coupled"),
        (rough, None, ", or coupled"),
        (held, None, "$"),
    ):
        with pytest.raises(InputError, match=f"sweeps = 9: .* solved together; expected none{expected}"):
            resolve(scene, 1.0, SolverOptions(dt=5e-3, any_step=True, sweeps=9, coupled=coupled))
    assert resolve(rough, 1.0, SolverOptions(dt=5e-3, any_step=True, sweeps=9, coupled=False)).sweeps == 9


def test_a_start_that_violates_constraints_is_refused(exact):
    """Of the scene itself, or of positions of one's own: a node below the ground, a strut of another length."""
    assert resolve(exact_twin(exact), 1.0)
    nodes = np.array(exact.structure.nodes)
    with pytest.raises(InputError, match=r"node \d+ starts 0\.03 m below the ground; expected: on exact contact"):
        resolve(exact, 1.0, positions=nodes - [0, 0, 0.05])
    longer = nodes.copy()
    longer[3] += 0.01 * (nodes[3] - nodes[2])
    with pytest.raises(InputError, match=r"strut 1 starts 1\.01 m long; expected 1 m, its rest length at t = 0"):
        resolve(exact, 1.0, positions=longer)


def test_refined_options_halve_the_step_or_cut_the_tolerances(reference):
    """Twice, for error bars; no tolerance below what float64 can meet."""
    by_step = resolve(reference, 1.0, SolverOptions(dt=4e-4)).refined()
    assert [each.dt for each in by_step] == [4e-4, 2e-4, 1e-4]
    by_error = resolve(reference, 1.0, SolverOptions(method="tsit5", rtol=1e-14, atol=1e-6)).refined()
    np.testing.assert_allclose([each.rtol for each in by_error], [1e-14, 10 * 2.0**-52, 10 * 2.0**-52], rtol=1e-12)
    np.testing.assert_allclose([each.atol for each in by_error], [1e-6, 1e-7, 1e-8], rtol=1e-12)


def test_resolved_steps_are_plain_numbers(reference):
    """A NumPy number would be an input of what is compiled, which reverse mode cannot count steps by."""
    options = resolve(reference, 1.0, SolverOptions(dt=np.float64(1e-4)))
    assert [type(x) for x in (options.dt, options.rtol, options.atol)] == [float] * 3
    assert [type(x) for x in (options.as_inputs().dt, options.as_inputs().rtol)] == [np.ndarray] * 2


def test_options_resolved_for_another_scene_are_refused_where_their_method_does_not_fit(reference, exact):
    """RK4, chosen for the one, would let the robot of the other fall through its ground."""
    resolved = resolve(reference, 1.0, SolverOptions(dt=5e-4, any_step=True))
    for run in (lambda: simulate(exact, 0.3, options=resolved), lambda: final_state(exact, 0.3, resolved)):
        with pytest.raises(InputError, match="'rk4': this scene has rigid struts or exact contact; expected 'complem"):
            run()


def test_options_resolved_for_another_kind_of_scene_are_refused(reference, exact):
    """Sweeps would let supports go; steps that were chosen without a push would lose it."""
    held = dataclasses.replace(exact, structure=dataclasses.replace(exact.structure, fixed=((0, "xyz"),)))
    swept = resolve(exact, 1.0)
    for run in (lambda: simulate(held, 0.3, options=swept), lambda: final_state(held, 0.3, swept)):
        with pytest.raises(InputError, match="sweeps handle no rods with mass, supports, bodies, balls"):
            run()
    pushed = with_terms(reference, Push((0,), [[1.0, 0, 0]], 0.1, 4e-4, ramp=1e-4))
    lost = r"dt = 0\.000\d+ s: a push .* would be lost between the steps of rk4; expected at most 0\.0001 s"
    with pytest.raises(InputError, match=lost):
        final_state(pushed, 0.3, resolve(reference))
    assert resolve(pushed, options=SolverOptions("rk4", dt=1e-4)).dt == 1e-4  # what the message expects
