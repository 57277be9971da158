"""Gaits to choose from, one number for each, with their images under the robot's symmetries."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.control.feedback import PhaseLocked, one_frequency
from jaxgrity.control.learned import Deployed
from jaxgrity.control.policies import Memory, Policy
from jaxgrity.control.steering import SLOWEST_TRAVEL, Steered, centre_offsets, clock_moved
from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray
from jaxgrity.model.actuation import Gait, Overtone, check_robot
from jaxgrity.model.scales import length_scale
from jaxgrity.model.scene import Scene
from jaxgrity.model.structure import Structure
from jaxgrity.model.symmetry import image, symmetries

REST = "rest"
"""Name of the gait that does nothing."""
SAME_GAIT = 1e-6
"""Largest difference, in radians or as a fraction, between gaits that count as the same."""


class GaitChoices(NamedTuple):
    """Gaits with feedback and a bend, as one policy. Made by `gait_choices`."""

    policy: Steered
    """its arrays have the gaits as the last axis"""
    names: tuple[str, ...]
    """of each; images of a gait have its name. The last one is `REST`"""

    def chosen(self, rows: AnyArray, bends: AnyArray) -> Steered:
        """The policy of robots with these gaits, (robots,), and these bends, (robots,), the robots last."""
        taken = _rows(self.policy, rows)
        return replace(taken, bend=jnp.asarray(bends, taken.bend.dtype))

    @property
    def bend(self) -> float:
        """The bend before the first choice."""
        return float(np.ravel(self.policy.bend)[0])

    def clocks(self, before: np.ndarray, after: np.ndarray, turns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Factors on the clocks of robots that change from one gait to another at the same angle, and the seconds by
        which those clocks advance for some turns."""
        frequency = np.atleast_2d(self.policy.policy.gait.frequency)[0]  # type: ignore[attr-defined]
        return frequency[before] / frequency[after], turns.astype(frequency.dtype) / frequency[after]

    def moved(self, memory: Memory, factors: AnyArray, seconds: AnyArray) -> Memory:
        """The memory with its clock changed as `clocks` says."""
        return clock_moved(memory, factors, seconds)


class Headings(NamedTuple):
    """A learned policy whose heading is chosen, in place of a gait's bend; it has no clock that could jump."""

    policy: Deployed
    """its arrays have one row, as the last axis"""
    names: tuple[str, ...] = ("",)
    bend: float = 0.0
    """before the first choice"""

    def chosen(self, rows: AnyArray, bends: AnyArray) -> Deployed:
        """The policy of robots whose headings are turned to the left, (robots,), by half a turn for a bend of 1."""
        taken = _rows(self.policy, rows)
        angle = jnp.pi * jnp.asarray(bends, taken.heading.dtype)
        (x, y), c, s = taken.heading, jnp.cos(angle), jnp.sin(angle)
        # no `replace`, which would check the policy with the observation of one robot
        return eqx.tree_at(lambda own: own.heading, taken, jnp.stack([c * x - s * y, s * x + c * y]))

    def clocks(self, before: np.ndarray, after: np.ndarray, turns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Without an effect."""
        return np.ones(turns.shape), np.zeros(turns.shape)

    def moved(self, memory: Memory, factors: AnyArray, seconds: AnyArray) -> Memory:
        """The memory as it is."""
        return memory


Choices = GaitChoices | Headings
"""What a predictive controller chooses from."""


def choices_of(policy: Policy | GaitChoices) -> Choices:
    """A policy alone, without its goal. Raises `InputError` for one without a bend and a clock of one frequency, or a
    heading."""
    if isinstance(policy, GaitChoices):
        return policy
    if isinstance(policy, Deployed) and policy.heading is not None:
        return Headings(jax.tree.map(_one_row, policy))
    if not (isinstance(policy, Steered) and isinstance(policy.policy, PhaseLocked)):
        found = f"Steered({type(policy.policy).__name__})" if isinstance(policy, Steered) else type(policy).__name__
        expected = "a Steered(PhaseLocked), whose bend and clock are chosen, or a Deployed with a heading"
        raise InputError(f"policy = {found}: expected {expected}")
    one_frequency(policy.policy.gait)
    return GaitChoices(jax.tree.map(_one_row, replace(policy, goal=None)), ("",))


def _one_row(x: Any) -> Any:
    """An array with a last axis of one row, integers as they are; what is no array stays as it is."""
    if not eqx.is_array_like(x):
        return x
    found = np.asarray(x)
    return (found if np.issubdtype(found.dtype, np.integer) else found.astype(float))[..., None]


def _rows(tree: Any, rows: AnyArray) -> Any:
    """The tree with these rows of all its arrays."""
    return jax.tree.map(lambda x: jnp.asarray(x)[..., jnp.asarray(rows)] if eqx.is_array_like(x) else x, tree)


@typed
def gait_choices(structure: Structure, gaits: Mapping[str, PhaseLocked], dtype: str = "float32") -> GaitChoices:
    """Gaits among which `lead_to` chooses: yours, their images under the structure's symmetries and mirrors, and rest.

    An image that equals the gait at another time is left out: a jump of the clock has the same effect. All gaits are in
    full swing from the beginning, so that a robot can change to one at any angle of its clock. Where steering fades,
    and for how long the direction of travel is averaged, follows the robot's length and `PhaseLocked.time_scale`.

    Args:
        structure: the robot.
        gaits: the gaits with feedback, by names of your choice; the first one is tried most.
        dtype: precision, that of the model.

    Raises:
        InputError: no gait, or one called "rest". A gait without feedback, with several frequencies or none, or of
            another robot. Gaits with different members.
    """
    if not gaits or REST in gaits:
        raise InputError(f"gaits: {list(gaits)}; expected at least one, none of them called {REST!r}")
    for name, locked in gaits.items():
        if not isinstance(locked, PhaseLocked):
            raise InputError(f"gaits: {name!r} is a {type(locked).__name__}; expected feedback: PhaseLocked(gait)")
        check_robot(locked.gait, structure)
    first = next(iter(gaits.values())).gait
    found: list[tuple[str, PhaseLocked]] = []
    harmonics = max(len(locked.gait.overtones) for locked in gaits.values())
    for name, locked in gaits.items():
        cycle = one_frequency(locked.gait)
        # in full swing from one cycle before the clock's zero on: a clock may jump back
        gait = replace(locked.gait, start=np.array(-2 * cycle), ramp=np.array(cycle))
        if gait.members != first.members:
            raise InputError(f"gaits: {name!r} has other members than the first one")
        own = [image(gait, symmetry) for symmetry in symmetries(structure)]
        for k, each in enumerate(own):
            if not any(_later(each, before) for before in own[:k]):
                found.append((name, replace(locked, gait=_with_overtones(each, harmonics))))
    still = found[0][1]
    resting = replace(still, gait=replace(still.gait, amplitude=0 * np.asarray(still.gait.amplitude)))
    found.append((REST, resting))
    stacked = jax.tree.map(lambda *x: np.stack(x, axis=-1), *(locked for _, locked in found))
    offsets = np.repeat(centre_offsets(structure, first.members)[..., None], len(found), axis=-1)
    none = np.zeros(len(found))
    # of a robot of this size whose motions take as long as its feedback says
    scale, size = np.asarray(stacked.time_scale), float(length_scale(Scene(structure)))
    slowest = SLOWEST_TRAVEL * size / float(scale.max())
    policy = Steered(stacked, none, offsets, full=none + 0.8, averaged=1.0 * scale, slowest=slowest)
    return GaitChoices(jax.tree.map(lambda x: jnp.asarray(x, dtype), policy), tuple(name for name, _ in found))


def _with_overtones(gait: Gait, harmonics: int) -> Gait:
    """The gait with some number of overtones, missing ones of size 0."""
    none = np.zeros(len(gait.members))
    return replace(gait, overtones=gait.overtones + (Overtone(none, none),) * (harmonics - len(gait.overtones)))


def _later(one: Gait, other: Gait) -> bool:
    """Whether one gait is the other at another time."""
    same = all(
        np.allclose(a, b, rtol=0, atol=SAME_GAIT)
        for a, b in [
            (one.amplitude, other.amplitude),
            (one.frequency, other.frequency),
            *((p.size, q.size) for p, q in zip(one.overtones, other.overtones)),
        ]
    )
    shift = one.phase[0] - other.phase[0]
    pairs = [(one.phase, other.phase), *((p.phase, q.phase) for p, q in zip(one.overtones, other.overtones))]
    turned = [np.exp(1j * (a - b - h * shift)) for h, (a, b) in enumerate(pairs, start=1)]
    return same and all(np.allclose(turn, 1, rtol=0, atol=SAME_GAIT) for turn in turned)
