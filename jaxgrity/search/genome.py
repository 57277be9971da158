"""What evolves: genes in [0, 1], and the gaits that they stand for."""

import dataclasses
import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxgrity.core.errors import InputError
from jaxgrity.core.types import AnyArray, namespace_of
from jaxgrity.model.actuation import Gait, Overtone, peak_rates
from jaxgrity.model.waves import TravellingWave
from jaxgrity.populations.population import gaits_of

Genes = Float[AnyArray, "*population genes"]

FAINT = 1e-3
"""Coefficients of an overtone that is added to a gait, as shares of their range: at 0 its phase has no derivative."""


class Genome(eqx.Module):
    """Genes in [0, 1): phases, which go round a circle, then what else has bounds.

    Genes are phase/2 pi for each actuator; then, where asked for, one amplitude each, one frequency for all, for every
    overtone two Fourier coefficients each, and one rank each. What has no genes stays as the scene's gait says. Where
    gaits are waves, the actuators of a group have these genes in common, and one gene says which of the waves it is.

    With theta the angle of a member's first sine, phase included, overtone h is a sin(h theta) + b cos(h theta): a
    phase moves the wave and keeps its shape. Coefficients are smooth where a size and a phase are not, at no overtone.
    """

    actuators: int = eqx.field(static=True)
    amplitude: tuple[float, float] | None = eqx.field(static=True, default=None)
    """bounds"""
    frequency: tuple[float, float] | None = eqx.field(static=True, default=None)
    """bounds, Hz"""
    overtones: int = eqx.field(static=True, default=0)
    """how many follow the first sine of every member's Fourier series, with coefficients a, b up to half of it"""
    active: int | None = eqx.field(static=True, default=None)
    """how many of the actuators move, those that rank highest; the others keep their rest lengths"""
    images: tuple[tuple[int, ...], ...] = eqx.field(static=True, default=())
    """permutations of the actuators under which a gait is the same gait, seen from elsewhere (`gene_permutations`)"""
    waves: tuple[TravellingWave, ...] = eqx.field(static=True, default=())
    """those that gaits may be (`travelling_waves`); empty: each actuator moves as it likes"""
    quickest: tuple[float, ...] = eqx.field(static=True, default=())
    """1/s, the largest |dL/dt| / L0 of each actuator, to which amplitudes are scaled down; empty: they are not"""

    def __check_init__(self):
        for name, top in (("amplitude", 1.0), ("frequency", math.inf)):
            bounds = getattr(self, name)
            if bounds is not None and not 0 <= bounds[0] < bounds[1] < top:
                raise InputError(f"{name} = {bounds}: expected two ascending bounds from 0 on, below {top:g}")
        if self.overtones < 0:
            raise InputError(f"overtones = {self.overtones}: expected 0 or more")
        if self.quickest and (len(self.quickest) != self.actuators or not min(self.quickest) > 0):
            raise InputError(f"quickest = {self.quickest}: expected {self.actuators} positive numbers")
        if len({wave.groups for wave in self.waves}) > 1 or any(len(w.groups) != self.actuators for w in self.waves):
            raise InputError(f"waves: expected the same groups of {self.actuators} actuators in each")
        if self.waves and self.active is not None:
            raise InputError("waves, active: the actuators of a wave have no ranks; expected one of both")
        if self.active is not None and not 1 <= self.active < self.actuators:
            raise InputError(f"active = {self.active}: expected 1 to {self.actuators - 1}, fewer than may be actuated")

    @property
    def groups(self) -> int:
        """How many actuators, or groups of them, have genes of their own."""
        return len(set(self.waves[0].groups)) if self.waves else self.actuators

    @property
    def blocks(self) -> dict[str, int]:
        """How many genes each quantity has, in their order."""
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
        """The population of gaits that `genes` stand for, around the scene's own `gait`.

        Of NumPy's arrays it is one of NumPy's.
        """
        xp = namespace_of(genes)
        parts = self._of_actuators(self.split(genes))
        amplitude = frequency = None
        if self.amplitude:
            amplitude = _between(self.amplitude, parts["amplitude"])
        if self.frequency:
            frequency = xp.broadcast_to(_between(self.frequency, parts["frequency"]), parts["phase"].shape)
        gaits = gaits_of(gait, 2 * np.pi * parts["phase"], amplitude, frequency)
        if self.overtones:
            extra = tuple(
                _overtone(h, gaits.phase, parts[f"sine {h}"] - 0.5, parts[f"cosine {h}"] - 0.5)
                for h in range(2, 2 + self.overtones)
            )
            gaits = eqx.tree_at(lambda g: g.overtones, gaits, extra, is_leaf=lambda x: isinstance(x, tuple))
        if self.active is not None:
            place = xp.argsort(xp.argsort(-parts["rank"], axis=-1), axis=-1)
            gaits = eqx.tree_at(lambda g: g.amplitude, gaits, xp.where(place < self.active, gaits.amplitude, 0))
        if self.quickest:
            most = xp.array(self.quickest, gaits.phase.dtype)
            beyond = xp.maximum(1, peak_rates(gaits, xp.ones_like(most)) / most)
            gaits = eqx.tree_at(lambda g: g.amplitude, gaits, gaits.amplitude / beyond)
        return gaits

    def with_overtones(self, genes: Genes, overtones: int) -> tuple["Genome", Genes]:
        """The genome with so many overtones, no fewer than it has, and genes that stand for the same gaits in it."""
        parts, n = self.split(genes), self.groups
        wider = dataclasses.replace(self, overtones=max(overtones, self.overtones))
        nothing = np.full((*np.shape(genes)[:-1], n), 0.5 + FAINT)
        return wider, np.concatenate([parts.get(name, nothing) for name in wider.blocks], axis=-1)

    def within(self, genes: Genes) -> Genes:
        """Angles brought back to their circle, the rest to its bounds."""
        return jnp.where(self.circular, genes % 1, jnp.clip(genes, 0, 1))

    def bounded(self, genes: Genes) -> Genes:
        """Angles as they are, the rest brought back to its bounds."""
        return jnp.where(self.circular, genes, jnp.clip(genes, 0, 1))

    def towards(self, a: AnyArray, b: AnyArray) -> AnyArray:
        """b - a, the shorter way round where the gene is an angle: in [-1/2, 1/2) of a turn."""
        return jnp.where(self.circular, (b - a + 0.5) % 1 - 0.5, b - a)

    def nearest_image(self, a: Genes, b: Genes) -> Genes:
        """Of the gaits that `b` is by symmetry, the one nearest to `a`; of waves, `b` itself."""
        if len(self.images) < 2 or self.waves:
            return b
        images = jnp.stack([b[..., self._permuted(image)] for image in self.images])
        gaps = jnp.sum(self.towards(a, images) ** 2, axis=-1)
        which = jnp.argmin(gaps, axis=0)
        return jnp.take_along_axis(images, which[None, ..., None], axis=0)[0]

    def gap(self, a: Genes, b: Genes) -> AnyArray:
        """The largest difference of any gene between `a` and the image of `b` nearest to it."""
        return jnp.abs(self.towards(a, self.nearest_image(a, b))).max(-1)

    def _which(self, gene: AnyArray) -> AnyArray:
        """The number of the wave that a gene stands for."""
        return (gene * len(self.waves)).astype(int).clip(0, len(self.waves) - 1)

    def _of_actuators(self, parts: dict[str, AnyArray]) -> dict[str, AnyArray]:
        """Genes for each actuator, where there is one for each group; its phase is shifted as its wave says."""
        if not self.waves:
            return parts
        shifts = namespace_of(parts["phase"]).array([wave.shifts for wave in self.waves], parts["phase"].dtype)
        groups = np.array(self.waves[0].groups)
        which = self._which(parts["wave"][..., 0]) if len(shifts) > 1 else 0
        found = {name: part[..., groups] if part.shape[-1] == self.groups else part for name, part in parts.items()}
        return found | {"phase": found["phase"] + shifts[which]}

    def _permuted(self, image: tuple[int, ...]) -> np.ndarray:
        """The numbers of the genes in the order that permutes the actuators."""
        rows, first = [], 0
        for name, count in self.blocks.items():
            rows.append(first + (np.array(image) if name != "frequency" else np.arange(count)))
            first += count
        return np.concatenate(rows)


def _overtone(h: int, phase: AnyArray, sine: AnyArray, cosine: AnyArray) -> Overtone:
    xp = namespace_of(phase)
    return Overtone(xp.hypot(sine, cosine), h * phase + xp.arctan2(cosine, sine))


def _between(bounds: tuple[float, float], genes: AnyArray) -> AnyArray:
    return bounds[0] + (bounds[1] - bounds[0]) * genes
