"""Orbits closed by Newton's method; their speed and turning have derivatives in everything in the scene."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxgrity.core.dense import least_solution
from jaxgrity.core.errors import InputError
from jaxgrity.core.tracing import traced
from jaxgrity.core.typed import typed
from jaxgrity.core.types import AnyArray, NodeVectors, Scalar
from jaxgrity.model.scales import length_scale, speed_scale
from jaxgrity.model.scene import Scene
from jaxgrity.orbits.cycles import plane_of, turned_by, way_along
from jaxgrity.orbits.finding import FRAMES, Orbit, in_step, restarted
from jaxgrity.stepping.final_state import final_state, states_at
from jaxgrity.stepping.options import ResolvedOptions, resolve

ITERATIONS = 20
"""Most iterations of Newton's method."""
CLOSED = 1e-9
"""Largest miss of the state after a cycle at which an orbit counts as closed, m and m/s for a body of one metre."""


class ClosedOrbit(NamedTuple):
    """A state that one cycle maps on itself, up to a planar motion."""

    q: NodeVectors
    """m, at the beginning of a period"""
    v: NodeVectors
    """m/s"""
    speed: Scalar
    """m/s, as `Orbit.speed`"""
    turning: Scalar
    """rad/s about the vertical, positive to the left"""
    residual: Scalar
    """m and m/s, for a body of one metre, gap of the closed state; speed and turning are NaN above `CLOSED`"""


@typed
def closed_orbit(scene: Scene, orbit: Orbit, options: ResolvedOptions) -> ClosedOrbit:
    """The relative periodic orbit near that of `find_orbit`, as a differentiable function of the scene.

    P is the state after one cycle, G the planar motion by a shift s and an angle a about the centre of mass. Newton's
    method solves P(x) = G(s, a) x for x, s and a, with centre and heading held. The derivatives of x, s and a are those
    of the implicit function theorem (`jax.lax.custom_root`), in both modes. So the derivative of a long rollout is not
    needed, which grows without bound in chaotic motion.

    With smooth laws (penalty contact, smooth friction) P is smooth, except at single corners. Complementarity stepping
    moves impacts to whole steps. Between two such moves its P is smooth too, and Newton's method closes the orbit of
    the stepped motion. But its derivatives lack the part of the impact times: they are not those of the speed over a
    wider range.

    Args:
        scene: level ground, and the gait of the orbit; its arrays may carry derivatives.
        orbit: by `find_orbit`.
        options: by `resolve`, with a fixed step; it is shortened until it divides the period.

    Returns:
        The orbit's state, speed and turning; NaN where Newton's method does not converge.

    Raises:
        InputError: supports, a slope, a steady wind or another law with a direction, or options as for `find_orbit`.

    Example:
        >>> scene = jaxgrity.with_gait(jaxgrity.load_scene("reference"), jaxgrity.load_gait("lasting"))
        >>> orbit = jaxgrity.orbits.find_orbit(scene, 80.0)  # doctest: +SKIP
        >>> options = jaxgrity.stepping.resolve(scene, orbit.period)  # doctest: +SKIP
        >>> def speed(mu):
        ...     there = eqx.tree_at(lambda s: s.friction.mu, scene, mu)
        ...     return jaxgrity.orbits.closed_orbit(there, orbit, options).speed
        >>> jax.grad(speed)(scene.friction.mu)  # doctest: +SKIP
    """
    if scene.structure.fixed:
        raise InputError("closed_orbit: the structure has supports, and moves nowhere; expected one without")
    if not traced((scene.ground, scene.up, scene.terms)) and not plane_of(scene).turns:
        found = "closed_orbit: the ground slopes, or a law such as wind has a direction, so that turned orbits are none"
        raise InputError(f"{found}; expected level ground, and laws without a direction")
    running = restarted(scene, orbit)
    chosen = in_step(scene, orbit.period, options)
    return _closed(running, orbit, resolve(running, orbit.period, chosen))


def _closed(scene: Scene, orbit: Orbit, options: ResolvedOptions) -> ClosedOrbit:
    assert scene.gait is not None, "an orbit has a gait"
    assert options.dt is not None, "`in_step` gives a step"
    q0, v0 = (jnp.asarray(x) for x in orbit.state)
    size, steps = q0.size, round(orbit.cycle / float(options.dt))
    # the number of steps is that of the orbit; how long they are follows the frequency, with its derivatives
    cycle = orbit.periods / jnp.ravel(scene.gait.frequency)[0]
    shares = scene.structure.lumped_mass / scene.structure.mass  # in a turn the centre's speed depends on them
    share = jax.lax.stop_gradient(shares)
    away = q0 - share @ q0
    L, speed = length_scale(scene), speed_scale(scene)

    def miss(y):
        q, v = y[:size].reshape(q0.shape), y[size : 2 * size].reshape(q0.shape)
        shift, angle = y[-3:-1], y[-1]
        end = final_state(scene, cycle, options, (q, v), steps=steps)
        centre = share @ q
        turned = (q - centre) @ _turn(angle).T + centre + jnp.append(shift, 0.0)
        # an orbit that is shifted or turned is an orbit too: without place and heading the system would be singular
        moved = (share @ q - share @ q0)[:2]
        heading = share @ (away[:, 0] * (q - centre)[:, 1] - away[:, 1] * (q - centre)[:, 0])
        off = (end[0] - turned).ravel() / L, (end[1] - v @ _turn(angle).T).ravel() / speed
        return jnp.concatenate([*off, moved / L, heading[None] / (L * L)])

    found = jax.lax.custom_root(
        miss, _guess(*jax.lax.stop_gradient((scene, (q0, v0), cycle)), options, steps, share), _newton, _tangent
    )
    residual = jnp.max(jnp.abs(miss(jax.lax.stop_gradient(found))))
    there = jnp.where(residual <= CLOSED, 1.0, jnp.nan)
    start, frames = (found[:size].reshape(q0.shape), found[size : 2 * size].reshape(q0.shape)), orbit.periods * FRAMES
    times = jnp.linspace(0, 1, frames + 1) * cycle
    path = jnp.einsum("n,fnk->fk", shares, states_at(scene, start, times, steps // frames, options, reverse=True)[0])
    speed = way_along(path[:, :2], found[-1] / frames) * frames / cycle
    return ClosedOrbit(start[0], start[1], there * speed, there * found[-1] / cycle, residual)


def _turn(angle: Scalar) -> AnyArray:
    """About the vertical."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    return jnp.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _guess(
    scene: Scene, state: tuple, cycle: Scalar, options: ResolvedOptions, steps: int, share: AnyArray
) -> AnyArray:
    """The state, and the shift and the angle of one cycle from it."""
    q, _ = state
    end, _ = final_state(scene, cycle, options, state, steps=steps)
    shift = (share @ end - share @ q)[:2]
    return jnp.concatenate([*(x.ravel() for x in state), shift, jnp.reshape(turned_by(share, q, end), 1)])


def _newton(f, y):
    def step(carry):
        y, r, k = carry
        y = y - least_solution(jax.jacfwd(f)(y), r)
        return y, f(y), k + 1

    def going(carry):
        _, r, k = carry
        # far below `CLOSED`: the last iteration gains many digits, and the theorem holds at a root alone
        return (k < ITERATIONS) & (jnp.max(jnp.abs(r)) > CLOSED / 100) & jnp.all(jnp.isfinite(r))

    return jax.lax.while_loop(going, step, (y, f(y), 0))[0]


def _tangent(g, y):
    return least_solution(jax.jacfwd(g)(jnp.zeros_like(y)), y)
