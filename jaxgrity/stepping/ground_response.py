"""Exact contact on a block of nodes: the ground's impulses and the nodes' velocities as functions of one vector.

With the ground's impulse p so far, and the velocity w, the trial impulse of a node is z = p - w. Let c be the normal
velocity at which the node just touches the ground at the end of the step. Signorini's law (p_n >= 0, w_n >= c, one of
them an equality) and Coulomb's (|p_t| <= mu p_n, against the slip where it is less) then say

    p_n = max(0, z_n + c),    p_t = min(1, mu p_n/|z_t|) z_t,    w = p - z,

and an impulse of another cause, which changes w, changes only z. P. Alart and A. Curnier 1991,
doi:10.1016/0045-7825(91)90022-X. All of it is elementwise, in the components along the ground's normal and tangents;
on uneven ground each node has its own, into which vectors are turned and from which they are turned back.
"""

from collections.abc import Callable
from functools import wraps
from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxgrity.core.elementwise import inverse_root
from jaxgrity.core.primitives import positive_part
from jaxgrity.core.types import AnyArray, PerRow, Scalar
from jaxgrity.stepping.blocks import Components

SLOWEST = 1e-10
"""Speed, m/s for a body of one metre. Its square is added to |z_t|^2: the derivative of |z_t| is then finite at 0."""


class Timing(NamedTuple):
    """When in a step friction acts on a block of nodes: p_t = (1 - s (1 - min(1, mu p_n/|y|))) y with y = z_t + c."""

    offset: tuple[PerRow, PerRow]
    """c, m/s, along both tangents: friction acts against w_t - c"""
    sliding: PerRow
    """s, the time that a node slides, in units of the kick's"""
    mass: Any = None
    """kg, with which its impulses change velocities; None: they are changes of velocities already"""


class Contact(NamedTuple):
    """The exact ground at a block of nodes."""

    closing: PerRow
    """c, m/s"""
    mu: PerRow | Scalar | None
    """coefficient of friction of a node that slides; None: no friction"""
    axes: tuple[Components, Components, Components] | None = None
    """normal and two tangents at each node; None: those along which vectors have their components"""
    least: Scalar = SLOWEST**2
    """m^2/s^2, its square for this body: one number, which XLA does not compute anew for each use"""
    timing: Timing | None = None
    """what the second order of contact adds; None: the first order"""


def along_own_axes(contact: Contact | None, x: Components) -> Components:
    """The components of vectors along the normal and the tangents of each node's contact."""
    return x if contact is None or contact.axes is None else Components(*(axis.dot(x) for axis in contact.axes))


def _in_any_components(law: Callable) -> Callable:
    """A law of a contact and of vectors in components along its axes, of vectors in any components."""

    @wraps(law)
    def turned(contact: Contact | None, *vectors: Components) -> Components:
        if contact is None or contact.axes is None:
            return law(contact, *vectors)
        found = law(contact, *(along_own_axes(contact, x) for x in vectors))
        normal, first, second = (axis * s for axis, s in zip(contact.axes, found.each))
        return normal + first + second

    return turned


@_in_any_components
def ground_impulse(contact: Contact | None, trial: Components) -> Components:
    """p, m/s: the change of velocity by the ground of nodes with the trial impulse z."""
    if contact is None:
        return trial * 0
    pressed = positive_part(trial.normal + contact.closing)
    if contact.mu is None:
        return Components(pressed, 0 * trial.first, 0 * trial.second)
    trial = _against(contact, trial)
    share = _share(contact.mu, pressed, _size_squared(contact, trial))
    if contact.timing is not None:
        share = 1 - contact.timing.sliding * (1 - share)
    return Components(pressed, share * trial.first, share * trial.second)


@_in_any_components
def velocity(contact: Contact | None, trial: Components) -> Components:
    """w = p - z, m/s, of nodes with the trial impulse z; w_n >= c to the last bit."""
    if contact is None:
        return trial * -1
    p = ground_impulse(contact._replace(axes=None), trial)
    # c itself: p_n - z_n is c but for rounding, with which a node may end a step below the ground
    normal = jnp.where(trial.normal + contact.closing > 0, contact.closing, -trial.normal)
    return Components(normal, p.first - trial.first, p.second - trial.second)


@_in_any_components
def answered(contact: Contact | None, trial: Components, push: Components) -> Components:
    """dw: the motion of nodes after a small `push`, which they would follow without the ground; dz = -push.

    A pressed node does not move along the normal. A sticking one does not move at all. A sliding one, with p_t along e,
    moves on in its plane; its friction grows by mu times the normal push. A push across its slip turns the friction, so
    that the share 1 - mu p_n/|z_t| of the push passes.
    """
    if contact is None:
        return push
    pressed = positive_part(trial.normal + contact.closing)
    touching = (pressed > 0).astype(pressed.dtype)
    normal = push.normal * (1 - touching)
    if contact.mu is None:
        return Components(normal, push.first, push.second)
    trial = _against(contact, trial)
    share = _share(contact.mu, pressed, _size_squared(contact, trial))
    sliding = touching * (share < 1).astype(share.dtype)
    back = inverse_root(_size_squared(contact, trial))
    first, second = trial.first * back, trial.second * back
    along = sliding * (share * (first * push.first + second * push.second) - contact.mu * push.normal)
    passing = 1 - share
    first, second = passing * push.first + along * first, passing * push.second + along * second
    if contact.timing is not None:
        # a node in the air follows the push
        moves = 1 + touching * (contact.timing.sliding - 1)
        first, second = moves * first, moves * second
    return Components(normal, first, second)


def _against(contact: Contact, trial: Components) -> Components:
    """The trial impulse whose tangential part friction answers: z_t + c."""
    if contact.timing is None:
        return trial
    first, second = contact.timing.offset
    return Components(trial.normal, trial.first + first, trial.second + second)


def without_offset(contact: Contact, x: AnyArray) -> AnyArray:
    """Vectors along normal and tangents, (nodes, 3), less the offset of friction."""
    if contact.timing is None:
        return x
    first, second = contact.timing.offset
    return x - jnp.stack([0 * first, first, second], axis=1)


def _share(mu: Scalar | AnyArray, pressed: PerRow, size_squared: PerRow) -> PerRow:
    """min(1, mu p_n/|z_t|): 1 where a node sticks, 0 without normal pressure."""
    return jnp.minimum(1, mu * pressed * inverse_root(size_squared))


def _size_squared(contact: Contact, trial: Components) -> PerRow:
    return trial.first * trial.first + trial.second * trial.second + contact.least
