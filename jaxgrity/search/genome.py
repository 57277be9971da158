"""Genes in [0, 1], and the gaits that they encode."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxgrity.core.arguments import check_count, check_number, is_number
from jaxgrity.core.errors import InputError
from jaxgrity.core.types import AnyArray, namespace_of
from jaxgrity.model.actuation import Gait, Overtone, peak_rates, ramp_rates, waves_ahead
from jaxgrity.model.gait_waves import TravellingWave
from jaxgrity.populations.population import gaits_of

Genes = Float[AnyArray, "*population genes"]

ALIKE = 1e-4
"""Largest difference of the actuators in a group, in turns and as shares, by which a gait is still a wave. Files of
gaits have more digits."""
FAINT = 1e-3
"""Coefficients of a new overtone, as fractions of their range. At 0, its phase would have no derivative."""


class Genome(eqx.Module):
    """Encoding of gaits by genes in [0, 1]: phases, which are angles and below 1, then quantities with bounds.

    Each actuator has a gene phase/2 pi. On request there are more: an amplitude and a rank for each actuator, two
    Fourier coefficients for each overtone and actuator, and one frequency. Quantities without genes come from the
    scene's gait, and its overtones move with the phases. If gaits are waves, actuators form groups. All actuators of a
    group have the same genes, and those quantities without genes that the first of them has. One more gene selects the
    wave.

    Let theta be the angle of a member's first sine, phase included. Overtone h is a sin(h theta) + b cos(h theta). So a
    phase moves the wave and keeps its shape. Unlike a size and a phase, the coefficients are smooth at zero. They go up
    to 1/h of the first sine, so that equal genes of all overtones change the actuators' rate alike.
    """

    actuators: int = eqx.field(static=True)
    amplitude: tuple[float, float] | None = eqx.field(static=True, default=None)
    """bounds of the amplitude; None: no genes"""
    frequency: tuple[float, float] | None = eqx.field(static=True, default=None)
    """bounds of the frequency, Hz; None: no gene"""
    overtones: int = eqx.field(static=True, default=0)
    """number of overtones of each member's Fourier series, with coefficients a, b"""
    active: int | None = eqx.field(static=True, default=None)
    """number of actuators that move: those with the highest rank; None: all"""
    images: tuple[tuple[int, ...], ...] = eqx.field(static=True, default=())
    """permutations of the actuators that give symmetry-equivalent gaits (`gene_permutations`)"""
    waves: tuple[TravellingWave, ...] = eqx.field(static=True, default=())
    """travelling waves to choose from; empty: actuators are independent"""
    quickest: tuple[float, ...] = eqx.field(static=True, default=())
    """bound on |dL/dt| / L0 of each actuator, 1/s, ramp included, to which amplitudes are scaled down, in a wave alike;
    empty: no scaling"""
    ramp: float | None = eqx.field(static=True, default=None)
    """time in which gaits reach their full amplitude, s; None: that of the scene's gait"""

    def __check_init__(self):
        check_bounds("amplitude", self.amplitude, 1.0)
        check_bounds("frequency", self.frequency)
        check_count("actuators", self.actuators, 1)
        check_count("overtones", self.overtones, 0)
        if self.ramp is not None:
            check_number("ramp", self.ramp, above=0.0, unit="s")
        if self.quickest and (len(self.quickest) != self.actuators or not min(self.quickest) > 0):
            raise InputError(f"quickest = {self.quickest}: expected {self.actuators} positive numbers")
        if len({wave.groups for wave in self.waves}) > 1 or any(len(w.groups) != self.actuators for w in self.waves):
            raise InputError(f"waves: expected the same groups of {self.actuators} actuators in each")
        if self.waves and self.active is not None:
            raise InputError("waves, active: the actuators of a wave have no ranks; expected one of both")
        if self.active is not None and check_count("active", self.active, 1) >= self.actuators:
            raise InputError(f"active = {self.active}: expected 1 to {self.actuators - 1}, fewer than may be actuated")

    @property
    def groups(self) -> int:
        """Number of actuators, or groups of actuators, with their own genes."""
        return len(set(self.waves[0].groups)) if self.waves else self.actuators

    @property
    def blocks(self) -> dict[str, int]:
        """Number of genes of each quantity, in order."""
        n = self.groups
        found = {"phase": n}
        if len(self.waves) > 1:
            found["wave"] = 1
        if self.amplitude:
            found["amplitude"] = n
        if self.frequency:
            found["frequency"] = 1
        for h in range(2, 2 + self.overtones):
            found |= {f"sine {h}": n, f"cosine {h}": n}
        if self.active is not None:
            found["rank"] = n
        return found

    @property
    def size(self) -> int:
        return sum(self.blocks.values())

    @property
    def circular(self) -> np.ndarray:
        """(genes,), which genes are angles."""
        return np.concatenate([np.full(count, name == "phase") for name, count in self.blocks.items()])

    def split(self, genes: Genes) -> dict[str, AnyArray]:
        """The genes of each quantity."""
        ends = np.cumsum(list(self.blocks.values()))
        return dict(zip(self.blocks, namespace_of(genes).split(genes, ends[:-1], axis=-1)))

    def gaits(self, gait: Gait | None, genes: Genes) -> Gait:
        """The population of gaits that `genes` encode; `gait` is that of the scene.

        NumPy arrays give NumPy arrays.
        """
        xp = namespace_of(genes)
        parts = self._of_actuators(self.split(genes))
        amplitude = frequency = None
        if gait is not None and self.waves:
            # what has no genes has to be alike within a group, too: it is taken from the first member of each
            firsts = np.array([self.waves[0].groups.index(group) for group in self.waves[0].groups])
            gait = jax.tree.map(lambda x: x[firsts] if np.ndim(x) else x, gait)
        if self.amplitude:
            amplitude = _between(self.amplitude, parts["amplitude"])
        if self.frequency:
            frequency = xp.broadcast_to(_between(self.frequency, parts["frequency"]), parts["phase"].shape)
        gaits = gaits_of(gait, 2 * np.pi * parts["phase"], amplitude, frequency)
        if self.ramp is not None:
            gaits = eqx.tree_at(lambda g: g.ramp, gaits, np.asarray(self.ramp))
        if gait is not None and gait.overtones and not self.overtones:
            shaped = waves_ahead(gait, gaits.phase - gait.phase)
            phases = [xp.asarray(each.phase, gaits.phase.dtype) for each in shaped.overtones]
            gaits = eqx.tree_at(lambda g: [each.phase for each in g.overtones], gaits, phases)
        if self.overtones:
            # rates grow with h, so overtone h gets coefficients up to 1/h: none is quicker than the first sine
            extra = tuple(
                _overtone(h, gaits.phase, 2 / h * (parts[f"sine {h}"] - 0.5), 2 / h * (parts[f"cosine {h}"] - 0.5))
                for h in range(2, 2 + self.overtones)
            )
            gaits = eqx.tree_at(lambda g: g.overtones, gaits, extra, is_leaf=lambda x: isinstance(x, tuple))
        if self.active is not None:
            # sorting twice gives each actuator its place in the order
            place = xp.argsort(xp.argsort(-parts["rank"], axis=-1), axis=-1)
            gaits = eqx.tree_at(lambda g: g.amplitude, gaits, xp.where(place < self.active, gaits.amplitude, 0))
        if self.quickest:
            most = xp.array(self.quickest, gaits.phase.dtype)
            rates = xp.maximum(*(rate(gaits, xp.ones_like(most)) for rate in (peak_rates, ramp_rates)))
            # a group is scaled alike: otherwise its wave would lose its symmetry
            beyond = self._alike(xp.maximum(1, rates / most))
            gaits = eqx.tree_at(lambda g: g.amplitude, gaits, gaits.amplitude / beyond)
        return gaits

    def genes_of(self, gait: Gait) -> Float[np.ndarray, " genes"]:
        """The genes of a gait: `gaits` inverted, before amplitudes are scaled down.

        Raises `InputError` for a gait that no genes encode: one beyond the bounds, or none of the waves.
        """
        if self.active is not None:
            raise InputError(f"active = {self.active}: a gait has no ranks; expected None to begin with a gait")
        if self.overtones and len(gait.overtones) > self.overtones:
            kept = f"the gait has {len(gait.overtones)}; expected as many or more, or 0: it keeps its own"
            raise InputError(f"overtones = {self.overtones}: {kept}")
        shape = np.zeros(self.actuators)
        gait = dataclasses.replace(gait, amplitude=gait.amplitude + shape, frequency=gait.frequency + shape)
        wave, firsts = self._wave_of(gait)
        turns, found = np.asarray(gait.phase, float)[firsts] / (2 * np.pi), {}
        found["phase"] = turns % 1
        if len(self.waves) > 1:
            found["wave"] = np.array([(wave + 0.5) / len(self.waves)])
        if self.amplitude:
            found["amplitude"] = _gene("amplitude", gait.amplitude, self.amplitude)[firsts]
        if self.frequency:
            found["frequency"] = _gene("frequency", gait.frequency, self.frequency)[:1]
        for h in range(2, 2 + self.overtones):
            size = phase = np.zeros(len(firsts))
            if h - 2 < len(gait.overtones):
                size, phase = (np.asarray(x, float)[firsts] for x in jax.tree.leaves(gait.overtones[h - 2]))
            ahead = phase - 2 * np.pi * h * turns
            found[f"sine {h}"], found[f"cosine {h}"] = (0.5 + h / 2 * size * f(ahead) for f in (np.cos, np.sin))
        genes = np.concatenate([found[name] for name in self.blocks]).clip(0, 1)
        again = dataclasses.replace(self, quickest=(), ramp=None).gaits(gait, genes[None])
        if not np.allclose(_waveform(again)[:, 0], _waveform(gait), atol=ALIKE):
            expected = "one frequency, and overtones of at most 1/h of the first sine, in a wave the same for all"
            raise InputError(f"the gait to begin with: no genes encode it; expected {expected}")
        return genes

    def _wave_of(self, gait: Gait) -> tuple[int, list[int]]:
        """The number of a gait's wave, and the first actuator of each group; without waves, every actuator."""
        if not self.waves:
            return 0, list(range(self.actuators))
        groups = np.array(self.waves[0].groups)
        firsts = [int(np.flatnonzero(groups == group)[0]) for group in range(self.groups)]
        own = np.array(firsts)[groups]
        alike = all(np.allclose(x, np.asarray(x)[own], atol=ALIKE) for x in (gait.amplitude, gait.frequency))
        for number, wave in enumerate(self.waves):
            lag = np.asarray(gait.phase, float) / (2 * np.pi) - np.array(wave.shifts)
            if alike and np.all(np.abs((lag - lag[own] + 0.5) % 1 - 0.5) < ALIKE):
                return number, firsts
        raise InputError("the gait to begin with is no wave of this robot; expected one, or waves = 'none' or 'axis'")

    def _alike(self, each: AnyArray) -> AnyArray:
        """The largest of each actuator's group; without waves, its own."""
        if not self.waves:
            return each
        xp, groups = namespace_of(each), np.array(self.waves[0].groups)
        return xp.stack([each[..., groups == group].max(-1) for group in range(self.groups)], axis=-1)[..., groups]

    def with_overtones(self, genes: Genes, overtones: int, faint: float = FAINT) -> tuple["Genome", Genes]:
        """The genome with at least so many overtones, and genes that encode the same gaits in it, up to `faint`."""
        parts, n = self.split(genes), self.groups
        wider = dataclasses.replace(self, overtones=max(overtones, self.overtones))
        nothing = np.full((*np.shape(genes)[:-1], n), 0.5 + faint)
        return wider, np.concatenate([parts.get(name, nothing) for name in wider.blocks], axis=-1)

    def wrapped(self, genes: Genes) -> Genes:
        """Genes with angles wrapped, and other genes clipped to their bounds."""
        return jnp.where(self.circular, genes % 1, jnp.clip(genes, 0, 1))

    def clipped(self, genes: Genes) -> Genes:
        """Genes with angles unchanged, and other genes clipped to their bounds."""
        return jnp.where(self.circular, genes, jnp.clip(genes, 0, 1))

    def towards(self, a: AnyArray, b: AnyArray) -> AnyArray:
        """b - a; for angles the shorter way round, in [-1/2, 1/2) of a turn."""
        return jnp.where(self.circular, (b - a + 0.5) % 1 - 0.5, b - a)

    def nearest_image(self, a: Genes, b: Genes) -> Genes:
        """The symmetry-equivalent image of `b` nearest to `a`; for waves, `b` itself."""
        if len(self.images) < 2 or self.waves:
            return b
        images = jnp.stack([b[..., self._permuted(image)] for image in self.images])
        gaps = jnp.sum(self.towards(a, images) ** 2, axis=-1)
        which = jnp.argmin(gaps, axis=0)
        return jnp.take_along_axis(images, which[None, ..., None], axis=0)[0]

    def gap(self, a: Genes, b: Genes) -> AnyArray:
        """Largest difference of a gene between `a` and the nearest image of `b`."""
        return jnp.abs(self.towards(a, self.nearest_image(a, b))).max(-1)

    def _which(self, gene: AnyArray) -> AnyArray:
        """The number of the wave that a gene selects."""
        return (gene * len(self.waves)).astype(int).clip(0, len(self.waves) - 1)

    def _of_actuators(self, parts: dict[str, AnyArray]) -> dict[str, AnyArray]:
        """Genes for each actuator from those of its group, with the phase shifts of the wave."""
        if not self.waves:
            return parts
        shifts = namespace_of(parts["phase"]).array([wave.shifts for wave in self.waves], parts["phase"].dtype)
        groups = np.array(self.waves[0].groups)
        which = self._which(parts["wave"][..., 0]) if len(shifts) > 1 else 0
        found = {name: part[..., groups] if part.shape[-1] == self.groups else part for name, part in parts.items()}
        return found | {"phase": found["phase"] + shifts[which]}

    def _permuted(self, image: tuple[int, ...]) -> np.ndarray:
        """Order of the genes that permutes the actuators."""
        rows, first = [], 0
        for name, count in self.blocks.items():
            rows.append(first + (np.array(image) if name != "frequency" else np.arange(count)))
            first += count
        return np.concatenate(rows)


def check_bounds(name: str, bounds: tuple[float, float] | None, top: float = math.inf) -> None:
    """Raise `InputError` for bounds of a quantity with genes that are no two numbers, or do not ascend from 0 to below
    `top`."""
    if bounds is None:
        return
    pair = isinstance(bounds, tuple) and len(bounds) == 2 and all(map(is_number, bounds))
    if not pair or not 0 <= bounds[0] < bounds[1] < top:
        raise InputError(f"{name} = {bounds}: expected two ascending bounds from 0 on, below {top:g}")


def _overtone(h: int, phase: AnyArray, sine: AnyArray, cosine: AnyArray) -> Overtone:
    xp = namespace_of(phase)
    return Overtone(xp.hypot(sine, cosine), h * phase + xp.arctan2(cosine, sine))


def _waveform(gait: Gait) -> np.ndarray:
    """Amplitude, frequency, and the complex Fourier coefficients of each actuator; those of 0 are left out."""
    sines = [np.exp(1j * np.asarray(gait.phase)), *(o.size * np.exp(1j * np.asarray(o.phase)) for o in gait.overtones)]
    kept = [sine for sine in sines if np.any(np.abs(sine) > ALIKE)]
    return np.stack([np.asarray(gait.amplitude, complex), np.asarray(gait.frequency, complex), *kept])


def _gene(name: str, values: AnyArray, bounds: tuple[float, float]) -> np.ndarray:
    """The genes of a quantity's values. Raises `InputError` for one out of its bounds."""
    values, (low, high) = np.asarray(values, float), bounds
    found = (values - low) / (high - low)
    if np.any(np.abs(found - 0.5) > 0.5 + ALIKE):
        worst = values[np.argmax(np.abs(found - 0.5))]
        raise InputError(
            f"{name} = {worst:.3g} of the gait to begin with: out of {low:g} to {high:g}; expected wider bounds"
        )
    return found.clip(0, 1)


def _between(bounds: tuple[float, float], genes: AnyArray) -> AnyArray:
    return bounds[0] + (bounds[1] - bounds[0]) * genes
