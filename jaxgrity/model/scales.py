"""The scales of a body: how long it is, how fast what it does is, and how heavy it is.

Thresholds are said once, for a robot of one metre and six kilogrammes on Earth. For any other body they are multiplied
by its scales, so that a motion keeps its name and all its shares at every size.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.primitives import place_rows
from jaxgrity.core.types import Scalar
from jaxgrity.model.laws import SceneParts

METRE, EARTH, KILOGRAMMES = 1.0, 9.81, 6.0
"""Length (m), gravity (m/s^2) and mass (kg) of the body for which thresholds are given: the library's own robots."""


class Scales(NamedTuple):
    """What a step needs of the scales: computed once for all steps of a rollout."""

    length: Scalar
    speed: Scalar
    mass: Scalar


def length_scale(scene: SceneParts) -> Scalar:
    """How many times as long as the body of one metre: by the rest length of its longest strut.

    Of a structure without struts that of the longest cable counts, of nodes without members the diagonal of the box in
    which they lie; a single node has no length, and counts as one metre.
    """
    if scene.scales is not None:
        return scene.scales.length
    members = scene.structure.struts or scene.structure.cables
    longest = 0.0 if members is None else members.rest_length.max()
    nodes = scene.structure.nodes
    xp = _namespace(longest, nodes)
    box = xp.sqrt(((nodes.max(0) - nodes.min(0)) ** 2).sum())
    return _held(xp.where(longest > 0, longest, xp.where(box > 0, box, METRE)) / METRE)


def speed_scale(scene: SceneParts) -> Scalar:
    """How many times as fast as the body of one metre on Earth: by sqrt(g L).

    Without gravity by L times the rate of the fastest natural mode, which takes the place of sqrt(g/L).
    """
    if scene.scales is not None:
        return scene.scales.speed
    L, g = length_scale(scene), 0.0 if scene.gravity is None else scene.gravity
    xp = _namespace(L, g)
    # by the ratio of two accelerations: it is 1 to the last bit for the body of one metre
    weight = L * xp.where(g > 0, g, 1.0) / (EARTH * METRE)
    if scene.gravity is not None and not isinstance(g, jax.Array) and g > 0:
        return _held(xp.sqrt(weight))
    fastest = L * fastest_mode(scene) / np.sqrt(EARTH / METRE)
    return _held(_namespace(weight, fastest).where(g > 0, xp.sqrt(weight), fastest))


def time_scale(scene: SceneParts) -> Scalar:
    """How many times as long what it does takes, compared with the body of one metre on Earth."""
    return length_scale(scene) / speed_scale(scene)


def mass_scale(scene: SceneParts) -> Scalar:
    """How many times as heavy as the body of six kilogrammes; of what supports hold as a whole, 1."""
    if scene.scales is not None:
        return scene.scales.mass
    mass = scene.structure.mass
    return _held(_namespace(mass).where(mass > 0, mass, KILOGRAMMES) / KILOGRAMMES)


def scales_of(scene: SceneParts) -> Scales:
    """All of them, as JAX arrays of the scene's precision."""
    dtype = jnp.asarray(scene.structure.nodes).dtype
    return Scales(*(jnp.asarray(each(scene), dtype) for each in (length_scale, speed_scale, mass_scale)))


def fastest_mode(scene: SceneParts) -> Scalar:
    """1/s: the rate of the fastest natural mode, at most, by the stiffness and the mass at each node (Gershgorin).

    Without springs it is that of the fastest actuator; without these 1/s, since nothing in the scene has a time.
    """
    structure = scene.structure
    mass = structure.lumped_mass
    xp = _namespace(mass, *(m.stiffness for m in structure.members))
    stiffness = xp.zeros(len(structure.nodes))
    for members in structure.members:
        if members.stiffness is not None:
            for ends in zip(*members.edges):
                if xp is np:
                    stiffness = stiffness + np.bincount(ends, members.stiffness, len(structure.nodes))
                else:
                    stiffness = stiffness + place_rows(members.stiffness, ends, len(structure.nodes))
    moves = structure.free.any(1) & (mass > 0)
    fastest = xp.sqrt(2 * xp.max(xp.where(moves, stiffness / xp.where(moves, mass, 1.0), 0.0)))
    rate = 0.0 if scene.gait is None else 2 * np.pi * scene.gait.frequency.max()
    both = _namespace(fastest, rate)
    return both.where(fastest > 0, fastest, both.where(rate > 0, rate, 1.0))


def _namespace(*numbers: object):
    """JAX's where any of the numbers is JAX's, else NumPy."""
    return jnp if any(isinstance(x, jax.Array) for x in numbers) else np


def _held(scale: Any) -> Scalar:
    """Thresholds have no derivatives."""
    return jax.lax.stop_gradient(scale) if isinstance(scale, jax.Array) else float(scale)
