"""Starts that no motion can have: known ones raise `InputError`, traced ones and those of a population get a code."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_scenes import swept

from jaxgrity import (
    FAILURES,
    Differences,
    Gait,
    InputError,
    Members,
    Scene,
    SolverOptions,
    Structure,
    final_state,
    gaits_of,
    rollout,
    simulate,
    simulate_population,
)
from jaxgrity.stepping import resolve

MISPLACED = FAILURES.index(
    "the start lies below the ground, has struts in each other, or rigid struts of other lengths"
)
OPTIONS = SolverOptions(dt=5e-3)
SCENE = swept()
NODES = np.asarray(SCENE.structure.nodes)
WRONG = {"0.28 m below the ground": NODES - [0, 0, 0.28], "longer struts": NODES * 1.3}
STILL = np.zeros((3, 3))


@pytest.mark.parametrize("wrong", WRONG.values(), ids=WRONG)
def test_known_starts_are_refused_by_all(wrong):
    options = resolve(SCENE, 0.1, OPTIONS)
    with pytest.raises(InputError, match=r"node 0 starts 0\.28 m below|strut 0 starts 1\.3 m long"):
        simulate(SCENE, 0.1, options=OPTIONS, positions=wrong)
    with pytest.raises(InputError, match=r"node 0 starts 0\.28 m below|strut 0 starts 1\.3 m long"):
        final_state(SCENE, 0.1, options, (wrong, STILL))
    with pytest.raises(InputError, match=r"node 0 starts 0\.28 m below|strut 0 starts 1\.3 m long"):
        rollout(SCENE, np.array([0.0, 0.1]), start=(wrong, STILL), options=options)


@pytest.mark.parametrize("name", ["positions", "velocities"])
def test_starts_that_are_no_numbers_are_refused_by_all(name):
    """Before anything compiles."""
    wrong = {"positions": NODES, "velocities": STILL, name: np.where(np.arange(3) == 1, np.nan, NODES)}
    options, start = resolve(SCENE, 0.1, OPTIONS), (wrong["positions"], wrong["velocities"])
    for call in (
        lambda: simulate(SCENE, 0.1, options=OPTIONS, **wrong),
        lambda: final_state(SCENE, 0.1, options, start),
        lambda: rollout(SCENE, np.array([0.0, 0.1]), start=start, options=options),
    ):
        with pytest.raises(InputError, match=rf"^{name}\[0, 1\] = nan: expected a finite number"):
            call()


def test_differences_have_a_row_for_each_robot():
    """Of all that differs; fewer rows would count as the last one, over and over."""
    gaits = gaits_of(SCENE.gait, np.repeat(SCENE.gait.phase[None], 3, axis=0))
    for name, shape in {"friction": (2,), "positions": (3, 2, 3), "node_mass": (3, 1), "cable_damping": (2,)}.items():
        with pytest.raises(InputError, match=rf"differences.{name} has shape .*; expected \(3"):
            simulate_population(SCENE, gaits, 0.1, options=OPTIONS, differences=Differences(**{name: np.ones(shape)}))


def test_struts_have_their_lengths_of_the_time_of_the_start():
    """A gait has changed the strut by then."""
    options = resolve(SCENE, 0.1, OPTIONS)
    end = rollout(SCENE, np.array([0.0, 0.1]), options=options)
    later = rollout(SCENE, np.array([0.1, 0.2]), start=(end.positions[-1], end.velocities[-1]), options=options)
    assert later.ok
    with pytest.raises(InputError, match=r"strut 0 starts 0\.\d+ m long; expected 1 m, its rest length at t = 0, "):
        rollout(SCENE, np.array([0.0, 0.1]), start=(end.positions[-1], end.velocities[-1]), options=options)


@pytest.mark.slow
def test_traced_starts_get_a_code():
    """Also by `vmap`, where others are fine."""

    @jax.jit
    @jax.vmap
    def rolled(q):
        return simulate(SCENE, 0.1, options=OPTIONS, frame_rate=10.0, positions=q).failure

    starts = jnp.stack([NODES, *WRONG.values(), NODES + np.array([0, 0, 0.1]), NODES - np.array([0, 0, 0.9e-6])])
    assert rolled(starts).tolist() == [0, MISPLACED, MISPLACED, 0, 0]


def test_traced_starts_get_a_code_from_methods_without_impulses():
    """Which keep rigid struts at the lengths that they start with."""
    scene = dataclasses.replace(swept(ground=False), gait=None)
    options = resolve(scene, 0.1, SolverOptions("rk4", dt=5e-3))
    rolled = jax.jit(lambda q: simulate(scene, 0.1, options=options, frame_rate=10.0, positions=q).failure)
    assert [int(rolled(jnp.asarray(q))) for q in (NODES, WRONG["longer struts"])] == [0, MISPLACED]


@pytest.mark.parametrize("dtype", ["float64", pytest.param("float32", marks=pytest.mark.campaign)])
def test_robots_of_a_population_that_start_so_fail_and_disturb_no_other(dtype):
    """Below the ground, nowhere, stretched, or with struts of another length; in float32 far from the origin too."""
    away = 0.0 if dtype == "float64" else 20.0
    fine = NODES + np.array([away, 0, 0])
    nowhere = np.where(np.arange(3) == 1, np.nan, fine)
    starts = np.stack([fine, fine - [0, 0, 0.28], fine * 1.3, fine, nowhere, fine])
    lengths = np.array([[1.0], [1.0], [1.0], [0.9], [1.0], [1.0]])
    speeds = np.zeros((6, 3, 3))
    speeds[5, 1] = np.nan
    gaits = gaits_of(SCENE.gait, np.repeat(SCENE.gait.phase[None], 6, axis=0))
    differences = Differences(positions=starts, velocities=speeds, strut_rest_length=lengths)
    options = dataclasses.replace(OPTIONS, dtype=dtype)
    outcomes = simulate_population(SCENE, gaits, 0.1, options=options, differences=differences)
    assert outcomes.failure.tolist() == [0, MISPLACED, MISPLACED, MISPLACED, 1, 1]
    assert np.isnan(outcomes.distance()).tolist() == [False, *[True] * 5]
    again = Differences(positions=np.stack([fine] * 6), velocities=0 * speeds, strut_rest_length=np.ones((6, 1)))
    undisturbed = simulate_population(SCENE, gaits, 0.1, options=options, differences=again)
    np.testing.assert_array_equal(outcomes.positions[0], undisturbed.positions[0])


def test_supports_do_not_start_in_motion():
    """In no kind of rollout."""
    spring = Members(((0, 1),), [400.0], [1.0])
    structure = Structure(np.array([[0.0, 0, 0], [1.0, 0, 0]]), [0.0, 1.0], spring, fixed=((0, "xyz"),))
    scene, v = Scene(structure, gait=Gait((0,), [0.0], [0.0], [1.0])), np.array([[1.0, 0, 0], [0, 0, 0]])
    options = resolve(scene, 1.0, SolverOptions("rk4", dt=1e-2))
    gaits = gaits_of(scene.gait, np.zeros((1, 1)))
    for call in (
        lambda: rollout(scene, np.array([0.0, 0.1]), start=(structure.nodes, v), options=options),
        lambda: final_state(scene, 0.1, options, (structure.nodes, v)),
        lambda: simulate_population(scene, gaits, 0.1, options=options, differences=Differences(velocities=v[None])),
    ):
        with pytest.raises(InputError, match=r"velocities\[0\] = .*: expected 0 where the node is fixed"):
            call()
