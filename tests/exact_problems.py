"""Motions known in closed form, for every method to reproduce.

Each problem is exact, not only its leading order; where a limit is taken (a heavy pivot, a slip far faster than eps),
`Problem.limit` says how far it is from the truth, and that is far below the tolerance.
"""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.model.actuation import Gait
from jaxgrity.model.friction import SmoothFriction, SwitchFriction
from jaxgrity.model.ground import PenaltyGround
from jaxgrity.model.scene import Scene
from jaxgrity.model.structure import Members, Structure

G = 9.81
PAIR = ((0, 1),)


@dataclass(frozen=True)
class Kink:
    """Where a contact or a cable comes into play or goes out of it, the force bends and a step is less exact."""

    jump: float
    """of the acceleration's slope, m/s^3"""
    shift: float
    """d(time of the kink)/d(log x), s"""
    remaining: float
    """time from the kink to the end, s"""


@dataclass(frozen=True)
class Problem:
    """`setup(x)` gives a scene with its first positions and velocities, `exact(t, x)` its positions at time t."""

    setup: Callable
    exact: Callable
    value: float
    """of the parameter x"""
    duration: float
    size: float = 0.0
    """of what swings or decays, m"""
    rate: float = 0.0
    """how fast it does, 1/s"""
    kink: Kink | None = None
    limit: float = 1e-12
    """how far `exact` is from the truth (m): rounding, where nothing else is said"""


def nodes(*rows):
    return jnp.array([jnp.stack([jnp.asarray(x, float) for x in row]) for row in rows])


def along_x(*x):
    return nodes(*((value, 0, 0) for value in x))


def free_fall() -> Problem:
    """Parabola; the parameter is g."""
    first, speed = np.array([[0.1, -0.2, 3.0]]), np.array([[0.4, 0.3, 2.0]])

    def setup(g):
        return Scene(Structure(first, np.array([2.0])), gravity=g), first, speed

    return Problem(setup, lambda t, g: first + speed * t - nodes((0, 0, g * t**2 / 2)), G, 0.5)


def drag() -> Problem:
    """A node slowed by damping alone: x = v0 m/c (1 - exp(-c t/m)); the parameter is c."""

    def setup(c):
        return Scene(Structure(along_x(0), np.array([0.5])), node_damping=c * np.ones(1)), along_x(0), along_x(2)

    return Problem(setup, lambda t, c: along_x(2 * 0.5 / c * (1 - jnp.exp(-c * t / 0.5))), 1.5, 0.5, size=0.7, rate=3)


MASSES = np.array([1.0, 2.0])
REDUCED = 1 / np.sum(1 / MASSES)


def pair(r):
    """Positions (m) of two free nodes at distance r, their centre of mass at rest at 0."""
    return along_x(-r * MASSES[1] / MASSES.sum(), r * MASSES[0] / MASSES.sum())


def joined(struts=None, cables=None, gait=None):
    return Scene(Structure(pair(1.0), MASSES, struts=struts, cables=cables), gait=gait)


def spring_mass() -> Problem:
    """Two nodes on a strut, along its axis: a cosine of the reduced mass; the parameter is K."""

    def setup(K):
        strut = Members(PAIR, K * np.ones(1), np.ones(1))
        return joined(struts=strut), pair(1.2), 0 * pair(0.0)

    def exact(t, K):
        return pair(1 + 0.2 * jnp.cos(jnp.sqrt(K / REDUCED) * t))

    return Problem(setup, exact, 100.0, 0.6, size=0.2, rate=np.sqrt(100 / REDUCED))


def damped_oscillator() -> Problem:
    """The same strut, stretched and let go, with damping along it; the parameter is c."""

    def setup(c):
        strut = Members(PAIR, np.array([100.0]), np.ones(1), c * np.ones(1))
        return joined(struts=strut), pair(1.2), 0 * pair(0.0)

    def exact(t, c):
        decay = c / (2 * REDUCED)
        omega = jnp.sqrt(100.0 / REDUCED - decay**2)
        swing = jnp.cos(omega * t) + decay / omega * jnp.sin(omega * t)
        return pair(1 + 0.2 * jnp.exp(-decay * t) * swing)

    return Problem(setup, exact, 3.0, 0.6, size=0.2, rate=np.sqrt(100 / REDUCED))


def driven_strut() -> Problem:
    """A strut whose gait is in full swing from t = 0: forced oscillation off resonance; the parameter is f."""
    L, delta, phase = 1.0, 0.3, 0.7
    omega = np.sqrt(100 / REDUCED)

    def setup(f):
        strut = Members(PAIR, np.array([100.0]), L * np.ones(1))
        gait = Gait((0,), phase * np.ones(1), delta * np.ones(1), f * np.ones(1), start=-1.0, ramp=1.0)
        return joined(struts=strut, gait=gait), pair(1.0), 0 * pair(0.0)

    def exact(t, f):
        drive, middle = 2 * jnp.pi * f, L * (1 - delta / 2)
        forced = -L * delta / 2 * omega**2 / (omega**2 - drive**2)
        cosine, sine = L - middle - forced * jnp.sin(phase), -forced * drive / omega * jnp.cos(phase)
        return pair(
            middle + forced * jnp.sin(drive * t + phase) + cosine * jnp.cos(omega * t) + sine * jnp.sin(omega * t)
        )

    return Problem(setup, exact, 0.8, 0.6, size=0.3, rate=omega)


def conical_pendulum() -> Problem:
    """A bob on an elastic strut circles below a pivot; the parameter is g.

    Exact at any angle and stiffness: the strut keeps the length l at which K (l - L) cos(alpha) = m g, and
    omega^2 = K (l - L) / (m l). The pivot, 1e12 kg, stands on a column and this on the ground; the bob moves them by
    1e-11 m.
    """
    heavy, m, K, L, length = 1e12, 1.0, 50.0, 0.7, 1.0
    column, soil = heavy * G / 0.1, 2 * heavy * G / 0.1
    pull = K * (length - L)
    omega = np.sqrt(pull / (m * length))

    def hanging(t, g):
        foot = -2 * heavy * g / soil
        pivot = foot + 3.0 - heavy * g / column
        cosine = m * g / pull
        sine = jnp.sqrt(1 - cosine**2)
        bob = (length * sine * jnp.cos(omega * t), length * sine * jnp.sin(omega * t), pivot - length * cosine)
        return nodes((0, 0, foot), (0, 0, pivot), bob)

    def setup(g):
        start, speed = jax.jvp(lambda t: hanging(t, g), (0.0,), (1.0,))
        struts = Members(((0, 1), (1, 2)), np.array([column, K]), np.array([3.0, L]))
        scene = Scene(Structure(start, np.array([heavy, heavy, m]), struts=struts), g, ground=PenaltyGround(soil))
        return scene, start, speed

    return Problem(setup, hanging, G, 1.0, size=length, rate=np.sqrt(K / m), limit=1e-10)


def cable_snap() -> Problem:
    """Two nodes fly apart, are turned back by a cable in half a period, and coast with it slack; the parameter is K."""
    speed, end = 0.5, 1.5 * np.pi / np.sqrt(100 / REDUCED)

    def setup(K):
        cable = Members(PAIR, K * np.ones(1), np.ones(1))
        return joined(cables=cable), pair(1.0), pair(speed)

    def exact(t, K):
        omega = jnp.sqrt(K / REDUCED)
        taut, slack = 1 + speed / omega * jnp.sin(omega * t), 1 - speed * (t - jnp.pi / omega)
        return pair(jnp.where(omega * t < jnp.pi, taut, slack))

    rate = np.sqrt(100 / REDUCED)
    kink = Kink(rate**2 * speed, shift=np.pi / rate / 2, remaining=end / 3)
    return Problem(setup, exact, 100.0, end, speed / rate, rate, kink)


def bounce() -> Problem:
    """A node falls on the undamped ground, which throws it back to the height it came from; the parameter is k_n."""
    m, height = 0.5, 0.3
    speed = np.sqrt(2 * G * height)

    def times(k):
        omega = jnp.sqrt(k / m)
        return omega, speed / G, 2 * (jnp.pi - jnp.arctan(speed * omega / G)) / omega

    def setup(k):
        start = np.array([[0.0, 0, height]])
        return Scene(Structure(start, m * np.ones(1)), G, ground=PenaltyGround(k)), start, np.zeros((1, 3))

    def exact(t, k):
        omega, fall, contact = times(k)
        s, u = t - fall, t - fall - contact
        falling = height - G * t**2 / 2
        pressed = -G / omega**2 * (1 - jnp.cos(omega * s)) - speed / omega * jnp.sin(omega * s)
        rising = speed * u - G * u**2 / 2
        return nodes((0, 0, jnp.where(s < 0, falling, jnp.where(u < 0, pressed, rising))))

    omega, fall, contact = (float(x) for x in times(200.0))
    kink = Kink(omega**2 * speed, shift=contact / 2, remaining=fall)
    return Problem(setup, exact, 200.0, 2 * fall + contact, speed / omega, omega, kink)


THETA, K_N, M = 0.4, 1e4, 2.0
NORMAL, DOWN = np.array([[np.sin(THETA), 0, np.cos(THETA)]]), np.array([[np.cos(THETA), 0, -np.sin(THETA)]])


def on_incline(friction, g=G, slip=0.0):
    """A node pressed into the slope by its weight, as deep as it stays, and slipping down."""
    start = -M * g * np.cos(THETA) / K_N * NORMAL
    scene = Scene(Structure(start, M * np.ones(1)), g, ground=PenaltyGround(K_N, incline=THETA), friction=friction)
    return scene, start, slip * DOWN


def creeping_block() -> Problem:
    """Below the friction angle, smooth friction holds but for a steady creep eps tan/sqrt(mu^2 - tan^2); x = mu."""
    eps, slope = 0.05, np.tan(THETA)

    def creep(mu):
        return eps * slope / jnp.sqrt(mu**2 - slope**2)

    def setup(mu):
        return on_incline(SmoothFriction(mu, eps), slip=creep(mu))

    def exact(t, mu):
        return on_incline(None)[1] + creep(mu) * t * DOWN

    return Problem(setup, exact, 0.6, 0.5)


def sliding(friction, limit=1e-12) -> Problem:
    """Above the friction angle: slides at g (sin - mu cos); x = mu. `friction(mu)` gives the law."""

    def setup(mu):
        return on_incline(friction(mu), slip=2.0)

    def exact(t, mu):
        return on_incline(None)[1] + (2 * t + G * (np.sin(THETA) - mu * np.cos(THETA)) * t**2 / 2) * DOWN

    return Problem(setup, exact, 0.3, 0.5, limit=limit)


def sticking_block() -> Problem:
    """Below the friction angle, the switch holds the node where it is, as deep as its weight says; x = g."""

    def setup(g):
        return on_incline(SwitchFriction(0.6, 0.5, 1e-3), g)

    return Problem(setup, lambda t, g: on_incline(None, g)[1] + 0 * t, G, 0.5)


PROBLEMS = {
    "free fall": free_fall(),
    "drag": drag(),
    "spring and mass": spring_mass(),
    "damped oscillator": damped_oscillator(),
    "driven strut": driven_strut(),
    "conical pendulum": conical_pendulum(),
    "cable snap": cable_snap(),
    "bounce": bounce(),
    "block creeping": creeping_block(),
    # eps changes the slide by mu g eps^2/(2 v^2) t^2/2 < 1e-9 m
    "block sliding, smooth": sliding(lambda mu: SmoothFriction(mu, 1e-4), limit=1e-9),
    "block sliding, switch": sliding(lambda mu: SwitchFriction(0.6, mu, 1e-3)),
    "block sticking, switch": sticking_block(),
}
