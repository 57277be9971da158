"""The pure rollout: what it returns, and that transformations take it in any order."""

import dataclasses
from collections.abc import Callable
from itertools import pairwise
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_scenes import swept

import jaxgrity.populations.lanes  # a sub-package has the function's name
from jaxgrity import (
    EnergyTerm,
    ExactGround,
    Gait,
    InputError,
    Members,
    Scene,
    SolverOptions,
    Structure,
    diagnose,
    energy_audit,
    final_state,
    gaits_of,
    rollout,
    sensitivity,
    simulate,
    simulate_population,
    verify,
    with_gait,
)
from jaxgrity.orbits import find_orbit
from jaxgrity.statics import resting_shape, vibration_modes
from jaxgrity.stepping import resolve

SCENE = swept()
OPTIONS = resolve(SCENE, 1.0, SolverOptions(dt=5e-3))
TIMES = np.array([0.0, 0.15, 0.3])
STILL = np.zeros((3, 3))
GAITS = gaits_of(SCENE.gait, np.zeros((1, 1)))


@pytest.mark.slow
def test_it_is_the_motion_of_simulate():
    """Under its own name, although a sub-package of that name is imported."""
    assert jaxgrity.rollout is rollout
    found = jaxgrity.rollout(SCENE, TIMES, options=OPTIONS)
    motion = simulate(SCENE, 0.3, options=OPTIONS, frame_rate=20 / 3)
    np.testing.assert_allclose(found.positions, motion.positions, rtol=0, atol=1e-13)
    np.testing.assert_allclose(found.velocities, motion.velocities, rtol=0, atol=1e-11)
    assert found.ok


LIGHT = dataclasses.replace(SCENE, structure=dataclasses.replace(SCENE.structure, cables=None), node_damping=None)
"""the same in a smaller program"""


def place(mu, lift):
    """Of all nodes in the end, m, along x, and whether all is well."""
    there = eqx.tree_at(lambda s: s.friction.mu, LIGHT, mu)
    start = (LIGHT.structure.nodes + lift * jnp.array([0.0, 0.0, 1.0]), STILL)
    found = rollout(there, TIMES, start=start, options=OPTIONS)
    return found.positions[-1, :, 0].sum(), found.ok


@pytest.mark.slow
def test_transformations_take_it_in_any_order():
    """jit of vmap of grad, and grad of vmap: derivatives as by differences, codes one by one."""
    mus, lifts = jnp.array([0.3, 0.5, 0.4]), jnp.array([0.0, 0.0, -0.1])
    slopes, ok = jax.jit(jax.vmap(jax.grad(place, has_aux=True)))(mus, lifts)
    assert ok.tolist() == [True, True, False]
    each = [place(mu + d, 0.0)[0] for mu in (0.3, 0.5) for d in (1e-6, -1e-6)]
    differences = np.array([each[0] - each[1], each[2] - each[3]]) / 2e-6
    assert np.abs(differences).min() > 1e-4
    np.testing.assert_allclose(slopes[:2], differences, rtol=1e-5)
    outside = jax.grad(lambda m: jnp.sum(jax.vmap(place)(m, lifts)[0][:2]))(mus)
    np.testing.assert_allclose(outside[:2], slopes[:2], rtol=1e-10)


class Field(EnergyTerm):
    """U = sum k f(z) for any function f, which is a leaf like the numbers."""

    shape: Callable
    k: Any
    name: ClassVar[str] = "field"

    def energy(self, at):
        return jnp.sum(self.k * self.shape(at.q[:, 2]))

    def keeps(self, symmetry):
        return False


@pytest.mark.campaign
def test_laws_may_have_functions_among_their_numbers():
    """Of nodes with U = k z^2/2, z(t) = z(0) cos(sqrt(k/m) t): one robot, many, and the derivative by k."""
    structure = Structure(np.array([[0.0, 0, 1.0], [0.0, 0, 2.0]]), [1.0, 1.0], Members(((0, 1),), [1e-9], [1.0]))
    gait = Gait((0,), [0.0], [0.0], [1.0])
    scene = Scene(structure, gait=gait, terms=(Field(lambda z: z * z / 2, np.ones(2)),))
    options = SolverOptions("rk4", dt=5e-3)
    np.testing.assert_allclose(
        simulate(scene, 1.0, options=options).positions[-1, :, 2], np.cos(1.0) * np.array([1, 2])
    )
    many = simulate_population(scene, gaits_of(gait, np.zeros((2, 1))), 1.0, options=options)
    np.testing.assert_allclose(many.positions[:, 0, 2], np.cos(1.0), rtol=1e-9)
    resolved = resolve(scene, 1.0, options)
    slope = jax.grad(lambda k: final_state(eqx.tree_at(lambda s: s.terms[0].k, scene, k), 1.0, resolved)[0][0, 2])(
        jnp.ones(2)
    )
    np.testing.assert_allclose(slope, [-np.sin(1.0) / 2, 0], rtol=0, atol=1e-9)


def test_options_say_the_precision():
    """Of a scene and a start in float64."""
    single = resolve(LIGHT, 0.1, SolverOptions(dt=5e-3, dtype="float32"))
    start = LIGHT.structure.nodes, STILL
    assert [x.dtype for x in final_state(LIGHT, 0.05, single, start)] == [jnp.float32, jnp.float32]


def test_times_may_be_traced_where_the_number_of_steps_is_given():
    ends = jax.jit(jax.vmap(lambda t: rollout(SCENE, t, options=OPTIONS, steps=30).positions[-1]))(
        jnp.array([[0.0, 0.15], [0.0, 0.14]])
    )
    np.testing.assert_allclose(ends[0], rollout(SCENE, TIMES[:2], options=OPTIONS).positions[-1], atol=1e-13)


def test_pieces_of_unequal_intervals_are_the_whole_where_nothing_dissipates():
    """With the same steps. Dampers see another velocity where steps of two lengths meet; between equal ones none do."""

    def apart(scene, times):
        whole = rollout(scene, np.array(times), options=OPTIONS, steps=30)
        state = whole.positions[0], whole.velocities[0]
        for ends in pairwise(times):
            piece = rollout(scene, np.array(ends), start=state, options=OPTIONS, steps=30)
            state = piece.positions[-1], piece.velocities[-1]
        return np.abs(state[0] - whole.positions[-1]).max()

    free = eqx.tree_at(lambda s: (s.node_damping, s.structure.cables.damping), SCENE, (np.zeros(3), np.zeros(2)))
    assert apart(free, [0.0, 0.15, 0.18]) < 1e-13
    assert apart(SCENE, [0.0, 0.15, 0.3]) < 1e-13
    assert 1e-8 < apart(SCENE, [0.0, 0.15, 0.18]) < 5e-6


def test_steps_are_as_fine_as_the_options_say():
    """Too few are refused; where times are traced, such a motion is not ok, nor one between equal times."""
    with pytest.raises(InputError, match=r"steps = 20: they would be longer than options.dt; expected 30 or more"):
        rollout(SCENE, TIMES[:2], options=OPTIONS, steps=20)
    with pytest.raises(InputError, match=r"steps = 20: they would be longer than options.dt; expected 30 or more"):
        final_state(SCENE, 0.15, resolve(SCENE, 0.15, OPTIONS), steps=20)
    ok = jax.jit(jax.vmap(lambda t: rollout(SCENE, t, options=OPTIONS, steps=30).ok))
    single = resolve(with_gait(LIGHT, None), 0.15, SolverOptions(dt=4e-4, any_step=True, dtype="float32"))
    late = 100 + np.arange(6) * 4e-4
    assert rollout(with_gait(LIGHT, None), late, options=single, steps=1).ok
    assert ok(jnp.array([[0.0, 0.15], [0.0, 0.2], [0.1, 0.1], [0.1, 0.0]])).tolist() == [True, False, False, False]


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("message", "call"),
    [
        ("times of shape", lambda: rollout(SCENE, np.array([0.1, 0.0]))),
        ("steps = 0: expected a whole number, at least 1", lambda: rollout(SCENE, TIMES, steps=0)),
        ("times are being traced; pass `steps`", lambda: jax.jit(lambda t: rollout(SCENE, t).ok)(TIMES)),
        ("start: velocities have shape", lambda: rollout(SCENE, TIMES, start=(SCENE.structure.nodes, np.zeros(3)))),
        ("start: expected two arrays of shape", lambda: rollout(SCENE, TIMES, start=(SCENE.structure.nodes,))),
        ("start: expected two arrays of shape", lambda: final_state(SCENE, 0.1, resolve(SCENE), SCENE.structure.nodes)),
        ("start: positions have shape", lambda: final_state(SCENE, 0.1, resolve(SCENE), (np.zeros(3), np.zeros(3)))),
        ("time = nan: expected a finite number", lambda: final_state(SCENE, 0.1, resolve(SCENE), since=np.nan)),
        ("adapts its step", lambda: rollout(swept(stiff=False), TIMES, options=SolverOptions("tsit5"))),
        ("no step can be chosen; pass a dt", lambda: jax.jit(_with_gravity)(9.81)),
        ("duration is being traced", lambda: jax.jit(lambda T: simulate(SCENE, T).positions)(0.1)),
        ("for reverse mode use jaxgrity.rollout", lambda: jax.grad(_simulated)(0.5)),
        ("diagnose: its numbers have to be known", lambda: _slope(lambda s: diagnose(s, 0.1).error_bar)),
        ("verify: its numbers have to be known", lambda: _slope(lambda s: verify(s, GAITS, 0.1).distance[0])),
        ("energy_audit: its numbers", lambda: _slope(lambda s: energy_audit(s, 0.1).kinetic[-1])),
        ("sensitivity: its numbers", lambda: _slope(lambda s: sensitivity(s, 0.1).norm[-1])),
        ("find_orbit: its numbers", lambda: _slope(lambda s: find_orbit(s).speed)),
        ("resting_shape: its numbers", lambda: _slope(lambda s: resting_shape(s).positions[0, 2])),
        ("vibration_modes: its numbers", lambda: _slope(lambda s: vibration_modes(s).frequency[0])),
        ("incline: it is being traced", lambda: jax.grad(lambda a: ExactGround(a).incline)(0.1)),
        ("duration is being traced", lambda: jax.jit(lambda T: final_state(SCENE, T, OPTIONS))(0.1)),
    ],
)
def test_what_does_not_work_says_what_to_pass(message, call):
    with pytest.raises(InputError, match=message):
        call()


def _with_gravity(g):
    return simulate(eqx.tree_at(lambda s: s.gravity, SCENE, g), 0.1).positions


def _slope(function):
    return jax.grad(lambda g: function(eqx.tree_at(lambda s: s.gravity, SCENE, g)))(9.81)


def _simulated(mu):
    there = eqx.tree_at(lambda s: s.friction.mu, SCENE, mu)
    return simulate(there, 0.1, options=OPTIONS, frame_rate=20.0).positions[-1].sum()


def test_times_that_begin_late_in_single_precision():
    """Free fall: the steps between two frames take as long as there is between these, however times are rounded."""
    falling = Scene(Structure([[0.0, 0, 0]], [1.0]), gravity=9.81)
    options = resolve(falling, 1.0, SolverOptions(method="rk4", dt=5e-4, dtype="float32"))
    times = np.array([128.0, 128.5])
    np.testing.assert_allclose(rollout(falling, times, options=options).positions[-1, 0, 2], -9.81 / 8, rtol=1e-4)
    with pytest.raises(InputError, match=r"apart in float32, for steps of 0.0005 s; expected times nearer to 0"):
        rollout(falling, times + 2000, options=options)
    with pytest.raises(InputError, match="apart in float32"):
        final_state(falling, 0.5, options, since=2000.0)
    with pytest.raises(InputError, match="ascending, finite times"):
        rollout(falling, np.array([0.0, np.inf]), options=options)
