"""Which symmetries a law keeps: by its own rule, or else compared at random states and at their images."""

import functools
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.model.laws import DissipationTerm, EnergyTerm, Law, Symmetry
from jaxgrity.model.scene import Scene, with_gait

STATES = 32
"""Number of random states at which a law is compared."""
DECADES = 3.0
"""Powers of ten over which displacements, speeds and times of these states are spread. So laws with a short range, or
laws that need speed, act in some of them."""
AS_EQUAL = 1e-8
"""Largest difference between a state and its image that counts as rounding, as a share of what all states differ by."""


def keeps(law: Law, scene: Scene) -> Callable[[Symmetry], bool]:
    """Whether the law is the same after a symmetry of the scene's structure, by its rule if it has one."""
    compare = looks_alike(law, scene)
    return lambda symmetry: compare(symmetry) if (rule := law.keeps(symmetry)) is None else rule


def looks_alike(law: Law, scene: Scene) -> Callable[[Symmetry], bool]:
    """Whether the law gives the same at random states and at the states that a symmetry makes of them.

    What is compared is U or R, or the force, without the gait. Of a law that none of the states can see, the identity
    alone is said to keep it.
    """
    states = _states(law, scene)

    @functools.cache
    def found() -> tuple[Callable[..., np.ndarray], np.ndarray]:
        value = _value(law, with_gait(scene, None))
        return value, value(*states)

    def alike(symmetry: Symmetry) -> bool:
        if symmetry.is_identity:
            return True
        value, there = found()
        spread = np.ptp(there, axis=0).max()
        moved = value(*_moved(states, scene, symmetry))
        # U and R are the same at the image; a force turns with it
        expected = there if there.ndim == 1 else _placed(there @ symmetry.matrix.T, symmetry)
        return bool(spread > 0 and np.abs(moved - expected).max() <= AS_EQUAL * spread)

    return alike


def _value(law: Law, scene: Scene) -> Callable[..., np.ndarray]:
    """What the law says at states: (states,), U in J or R in W; (states, nodes, 3), N, of a force without either."""

    def one(q, v, pressed, others, t):
        if isinstance(law, EnergyTerm):
            return law.energy(scene.configuration(q, t))
        motion = scene.motion(v, q, t, None if scene.ground is None else pressed)
        return law.dissipation(motion) if isinstance(law, DissipationTerm) else law.force(motion, others)

    each = eqx.filter_jit(jax.vmap(one))

    def value(*states: np.ndarray) -> np.ndarray:
        with jax.enable_x64(True):
            return np.asarray(each(*map(jnp.asarray, states)))

    return value


def _states(law: Law, scene: Scene) -> tuple[np.ndarray, ...]:
    """Positions, velocities, normal forces and other forces of all nodes, and times, of each state.

    The robot is deformed, and in half of the states stands in the ground by about half of its nodes.
    """
    random, nodes = np.random.default_rng(0), np.asarray(scene.structure.nodes, float)
    size = np.linalg.norm(nodes - nodes.mean(0), axis=1).max()
    wide = 10 ** random.uniform(-DECADES, 0, (STATES, 1, 1))
    q = nodes + size * wide * random.normal(size=(STATES, *nodes.shape))
    if scene.ground is not None:
        # laws of contact are zero above the ground: no state there shows which symmetries they keep
        for k in range(0, STATES, 2):
            q[k, :, 2] -= np.median(scene.ground.measured(q[k]).distance)
    fast = 10 ** random.uniform(-DECADES, DECADES, (STATES, 1, 1))
    v, others = size * fast * random.normal(size=q.shape), random.normal(size=q.shape)
    bends = np.asarray(law.bends(), float)
    times = random.uniform(bends.min(), bends.max(), STATES) if len(bends) else 10 ** random.uniform(0, DECADES, STATES)
    return q, v, random.uniform(size=q.shape[:2]), others, times


def _moved(states: tuple[np.ndarray, ...], scene: Scene, symmetry: Symmetry) -> tuple[np.ndarray, ...]:
    """The images of states, about the centre of mass of the start."""
    q, v, pressed, others, times = states
    mass, nodes = np.asarray(scene.structure.lumped_mass, float), np.asarray(scene.structure.nodes, float)
    centre = mass @ nodes / mass.sum()
    # the force with which the ground presses on a node is a number: it changes its node, and does not turn
    turned = [(q - centre) @ symmetry.matrix.T + centre, v @ symmetry.matrix.T, pressed, others @ symmetry.matrix.T]
    return (*(_placed(x, symmetry) for x in turned), times)


def _placed(values: np.ndarray, symmetry: Symmetry) -> np.ndarray:
    """What each node has, (states, nodes, ...), at the node whose place it takes."""
    placed = np.empty_like(values)
    placed[:, list(symmetry.nodes)] = values
    return placed
