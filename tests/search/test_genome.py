"""Genes: their blocks and bounds, the circle that phases go round, images by symmetry, and the gaits they stand for."""

import dataclasses

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxgrity import Gait, Genome, InputError, one_gait
from jaxgrity.model import TravellingWave, gene_permutations, standing_symmetries
from jaxgrity.model.actuation import Overtone, contraction, peak_rates, ramp_rates

FULL = Genome(
    3, amplitude=(0.1, 0.3), frequency=(0.2, 1.0), overtones=2, active=2, images=((0, 1, 2), (1, 2, 0), (2, 0, 1))
)
"""every kind of gene; its images are the turns of a three-strut prism"""
GAIT = Gait((0, 1, 2), np.zeros(3), np.full(3, 0.2), np.full(3, 0.5), start=0.0, ramp=1e-3)

# numbers so small that processors take them for 0 are left out
unit = st.floats(0, 0.999, allow_subnormal=False)
any_number = st.floats(-3, 3, allow_subnormal=False)
seeds = st.integers(0, 2**32 - 1)


gap, nearest_image = jax.jit(FULL.gap), jax.jit(FULL.nearest_image)


def random_genes(seed: int, *rows: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(size=(*rows, FULL.size))


def test_blocks_say_what_each_gene_is():
    """Phases, amplitudes, one frequency, two coefficients for each overtone, ranks; only phases are circular."""
    parts = {
        "phase": 3,
        "amplitude": 3,
        "frequency": 1,
        "sine 2": 3,
        "cosine 2": 3,
        "sine 3": 3,
        "cosine 3": 3,
        "rank": 3,
    }
    assert FULL.blocks == parts
    assert list(FULL.blocks) == list(parts)
    assert FULL.size == 22
    assert np.flatnonzero(FULL.circular).tolist() == [0, 1, 2]
    assert Genome(6).blocks == {"phase": 6}
    assert Genome(6).circular.all()


def test_split_takes_genes_apart_in_their_order():
    """Joined again, they are the genes; for one gait and for a population."""
    for rows in ((), (4,)):
        genes = random_genes(0, *rows)
        parts = FULL.split(genes)
        assert {name: part.shape[-1] for name, part in parts.items()} == FULL.blocks
        np.testing.assert_array_equal(np.concatenate(list(parts.values()), axis=-1), genes)


def test_genes_become_gaits_within_bounds(reference):
    """Phases in radians, an amplitude for each member, one frequency for all."""
    genome = Genome(6, amplitude=(0.1, 0.3), frequency=(0.2, 1.0))
    assert genome.size == 13
    genes = np.full((2, 13), 0.5)
    gaits = genome.gaits(reference.gait, genes)
    np.testing.assert_allclose(gaits.phase, np.pi)
    np.testing.assert_allclose(gaits.amplitude, 0.2)
    np.testing.assert_allclose(gaits.frequency, 0.6)


@pytest.mark.parametrize(("gene", "amplitude", "frequency"), [(0.0, 0.1, 0.2), (1.0, 0.3, 1.0)])
def test_genes_reach_their_bounds(gene, amplitude, frequency):
    """And not beyond; start, ramp and members stay the scene's own."""
    genome = Genome(3, amplitude=(0.1, 0.3), frequency=(0.2, 1.0))
    gaits = genome.gaits(GAIT, np.full((1, 7), gene))
    np.testing.assert_allclose(gaits.amplitude, amplitude, rtol=1e-15)
    np.testing.assert_allclose(gaits.frequency, frequency, rtol=1e-15)
    assert (gaits.members, gaits.start, gaits.ramp) == (GAIT.members, GAIT.start, GAIT.ramp)


def test_what_has_no_genes_stays_as_the_gait_says():
    """Amplitude and frequency of the scene's own gait, in every row."""
    gaits = Genome(3).gaits(GAIT, np.zeros((2, 3)))
    np.testing.assert_array_equal(gaits.amplitude, np.full((2, 3), 0.2))
    np.testing.assert_array_equal(gaits.frequency, np.full((2, 3), 0.5))
    assert gaits.overtones == ()


@given(seeds, st.floats(0, 10))
def test_overtones_stay_within_the_amplitude(seed, t):
    """The normalised series lies within -1 and 1, so that a member shortens by 0 to its amplitude, as by one sine."""
    gaits = FULL.gaits(GAIT, random_genes(seed, 8))
    assert all(np.all((np.asarray(o.size) >= 0) & (np.asarray(o.size) <= 0.71)) for o in gaits.overtones)
    shortened = np.asarray(contraction(gaits, t))
    assert np.all(shortened >= -1e-15)
    assert np.all(shortened <= gaits.amplitude + 1e-15)


def test_overtones_are_multiples_of_the_frequency():
    """A sine at twice and at three times the frequency, written out; of no size, they change nothing."""
    gait = Gait((0,), [0.3], [0.4], [0.5], 0.0, 1e-3, (Overtone([0.25], [1.0]), Overtone([0.5], [2.0])))
    for t in (0.1, 0.7, 1.3):
        x = np.pi * t
        wave = (np.sin(x + 0.3) + 0.25 * np.sin(2 * x + 1.0) + 0.5 * np.sin(3 * x + 2.0)) / 1.75
        np.testing.assert_allclose(contraction(gait, t), [0.2 * (1 + wave)], rtol=1e-14)
    silent = Gait((0,), [0.3], [0.4], [0.5], 0.0, 1e-3, (Overtone([0.0], [1.0]),))
    plain = Gait((0,), [0.3], [0.4], [0.5], 0.0, 1e-3)
    np.testing.assert_allclose(contraction(silent, 0.7), contraction(plain, 0.7), rtol=1e-15)


@given(seeds)
def test_genes_of_overtones_are_fourier_coefficients(seed):
    """a sin(h theta) + b cos(h theta) beside sin(theta), written out, with a and b between -1/h and 1/h."""
    genome = Genome(3, amplitude=(0.1, 0.3), frequency=(0.2, 1.0), overtones=2)
    genes = np.random.default_rng(seed).uniform(size=genome.size)
    parts, gaits = genome.split(genes), genome.gaits(GAIT, genes[None])
    t = 0.7
    theta = 2 * np.pi * (t * gaits.frequency[0] + parts["phase"])
    coefficients = {f"{name} {h}": 2 * (parts[f"{name} {h}"] - 0.5) / h for name in ("sine", "cosine") for h in (2, 3)}
    wave = np.sin(theta)
    for h in (2, 3):
        wave = wave + coefficients[f"sine {h}"] * np.sin(h * theta) + coefficients[f"cosine {h}"] * np.cos(h * theta)
    sizes = sum(np.hypot(coefficients[f"sine {h}"], coefficients[f"cosine {h}"]) for h in (2, 3))
    expected = gaits.amplitude[0] / 2 * (1 + wave / (1 + sizes))
    np.testing.assert_allclose(np.asarray(contraction(one_gait(gaits, 0), t)), expected, rtol=1e-12)


@given(seeds)
def test_a_gait_is_the_same_with_more_overtones(seed):
    """But for the faint ones that it gets; those that it has stay, in whatever order genes come."""
    genes = random_genes(seed, 2)
    wider, there = FULL.with_overtones(genes, 4)
    assert wider.blocks == FULL.blocks | {name: 3 for h in (4, 5) for name in (f"sine {h}", f"cosine {h}")}
    few, many = (np.asarray(contraction(genome.gaits(GAIT, x), 0.3)) for genome, x in ((FULL, genes), (wider, there)))
    np.testing.assert_allclose(many, few, atol=2e-3)
    assert FULL.with_overtones(genes, 1)[0] == FULL
    np.testing.assert_array_equal(FULL.with_overtones(genes, 1)[1], genes)


@given(st.lists(st.sampled_from([0.0, 0.25, 0.5, 1.0]), min_size=20, max_size=20))
def test_as_many_members_are_active_as_asked(ranks):
    """Exactly so many, also where ranks are equal, and none ranks below one that is not; the others do not move."""
    ranks = np.reshape(ranks, (4, 5))
    five = Gait(tuple(range(5)), np.zeros(5), np.full(5, 0.2), np.full(5, 0.5))
    for active in (1, 2, 4):
        moves = np.asarray(Genome(5, active=active).gaits(five, np.concatenate([0 * ranks, ranks], axis=1)).amplitude)
        assert np.all((moves == 0.2) | (moves == 0))
        assert np.all((moves > 0).sum(1) == active)
        for row, moving in zip(ranks, moves > 0):
            assert row[moving].min() >= row[~moving].max()


@given(unit, unit)
def test_the_way_between_angles_is_the_shorter_one(a, b):
    """From a, the way `towards` b arrives at b, and is at most half a turn."""
    way = float(Genome(1).towards(np.array([[a]]), np.array([[b]]))[0, 0])
    assert abs(way) <= 0.5
    gap = abs((a + way) % 1 - b)
    assert min(gap, 1 - gap) < 1e-9


@given(unit, unit)
def test_the_way_between_other_genes_is_their_difference(a, b):
    """A frequency of 0.9 does not come to 0.1 by way of 1."""
    way = Genome(1, frequency=(0.1, 1.0)).towards(np.array([0.0, a]), np.array([0.0, b]))
    assert float(way[1]) == pytest.approx(b - a, rel=1e-15, abs=1e-300)


@given(any_number, any_number)
def test_genes_are_brought_back_within_their_bounds(angle, other):
    """An angle to the same angle on its circle, another gene to the nearer bound; twice is the same as once."""
    genome = Genome(1, frequency=(0.1, 1.0))
    held = np.asarray(genome.wrapped(np.array([angle, other])))
    assert 0 <= held[0] <= 1
    assert abs((held[0] - angle) - round(held[0] - angle)) < 4e-15
    assert held[1] == min(max(other, 0.0), 1.0)
    np.testing.assert_array_equal(genome.towards(genome.wrapped(held), held), 0)


def test_nearest_image_is_an_image_and_the_nearest():
    """Of every block, the three members' genes are turned together; the frequency stays."""
    a, b = random_genes(0, 64), random_genes(1, 64)
    parts = [np.asarray(part) for part in FULL.split(b).values()]
    turned = [[p[:, list(turn)] if p.shape[1] == 3 else p for p in parts] for turn in FULL.images]
    images = np.array([np.concatenate(parts, axis=1) for parts in turned])
    away = [np.linalg.norm(FULL.towards(a, image), axis=1) for image in images]
    nearest = np.argmin(away, axis=0)
    assert set(nearest) == {0, 1, 2}
    np.testing.assert_array_equal(nearest_image(a, b), images[nearest, np.arange(64)])


def test_images_of_a_gait_are_no_gap_apart():
    """Nor does it matter which of two gaits comes first, or how either is turned."""
    a, b = random_genes(0, 64), random_genes(1, 64)
    turns = [FULL._permuted(image) for image in FULL.images]
    apart = np.asarray(gap(a, b))
    assert np.all((apart > 0) & (apart <= 1))
    for p in turns:
        np.testing.assert_array_equal(gap(a, a[:, p]), 0)
        np.testing.assert_allclose(gap(b[:, p], a), apart, rtol=1e-12)
        for r in turns:
            np.testing.assert_allclose(gap(a[:, p], b[:, r]), apart, rtol=1e-12)


def test_a_population_has_the_images_of_its_rows():
    """Each row of parents by itself."""
    a, b = random_genes(1, 5), random_genes(2, 5)
    rows = [nearest_image(x, y) for x, y in zip(a, b)]
    assert any(not np.array_equal(row, y) for row, y in zip(rows, b))
    np.testing.assert_array_equal(nearest_image(a, b), rows)
    np.testing.assert_array_equal(gap(a, b), [gap(x, y) for x, y in zip(a, b)])


def test_without_images_a_gait_is_its_own():
    """The genes of the other come back untouched."""
    a, b = np.array([0.1, 0.2]), np.array([0.2, 0.1])
    assert Genome(2).nearest_image(a, b) is b
    assert float(Genome(2).gap(a, b)) == pytest.approx(0.1, rel=1e-12)
    assert float(Genome(2, images=((0, 1), (1, 0))).gap(a, b)) == 0


def test_images_are_those_of_the_standing_robot(exact):
    """A gait and the same gait turned by 120 degrees, whose genes a robot on a face cannot tell apart."""
    images = gene_permutations(exact.gait.members, standing_symmetries(exact))
    assert len(images) == 3
    genome = Genome(6, images=images)
    genes = np.random.default_rng(3).uniform(size=6)
    assert float(genome.gap(genes, genes[list(images[1])])) == 0
    assert float(Genome(6).gap(genes, genes[list(images[1])])) > 0.1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"amplitude": (0.4, 0.2)}, r"amplitude = \(0\.4, 0\.2\): expected two ascending bounds from 0 on, below 1"),
        ({"amplitude": (0.4, 1.0)}, r"amplitude = \(0\.4, 1\.0\): expected two ascending bounds from 0 on, below 1"),
        ({"amplitude": (0.5, 1.5)}, "amplitude"),
        ({"frequency": (-0.1, 1.0)}, "frequency .* expected two ascending bounds from 0 on, below inf"),
        ({"overtones": -1}, "overtones = -1: expected a whole number, at least 0"),
        ({"active": 0}, "active = 0: expected a whole number, at least 1"),
        ({"active": 6}, "active = 6: expected 1 to 5, fewer than may be actuated"),
        ({"quickest": (1.0,) * 5}, "quickest = .*: expected 6 positive numbers"),
        ({"quickest": (0.0,) * 6}, "quickest = .*: expected 6 positive numbers"),
    ],
)
def test_bad_genomes_are_refused(options, message):
    """Bounds the wrong way round or out of range, fewer than no overtones, all or none of the members."""
    with pytest.raises(InputError, match=message):
        Genome(6, **options)


def test_amplitudes_are_scaled_down_to_the_quickest_that_members_may_move():
    """Slow gaits stay as they are; of quick ones each member moves as quickly as it may, in the ramp or after it."""
    options = {"amplitude": (0.0, 0.6), "frequency": (0.3, 3.0), "overtones": 1, "ramp": 0.5}
    genes = np.random.default_rng(0).uniform(size=(64, Genome(3, **options).size))
    plain, scaled = (Genome(3, **options, quickest=most).gaits(GAIT, genes) for most in ((), (1.0, 0.5, 2.0)))
    both = [[np.asarray(rate(gaits, np.ones(3))) for rate in (peak_rates, ramp_rates)] for gaits in (plain, scaled)]
    before, after = (np.maximum(*rates) for rates in both)
    np.testing.assert_allclose(after, np.minimum(before, [1.0, 0.5, 2.0]))
    quick = both[0][0] > [1.0, 0.5, 2.0]
    assert (both[0][1] > both[0][0])[quick].any()
    assert (both[0][1] < both[0][0])[quick].any()
    slow = before < [1.0, 0.5, 2.0]
    assert 0.1 < slow.mean() < 0.9
    np.testing.assert_allclose(scaled.amplitude[slow], plain.amplitude[slow])
    np.testing.assert_array_equal(scaled.phase, plain.phase)


WAVES = Genome(
    4,
    (0.1, 0.3),
    (0.2, 1.0),
    overtones=1,
    waves=(TravellingWave((0, 0, 1, 1), (0.0, 0.5, 0.0, 0.5)), TravellingWave((0, 0, 1, 1), (0.0, 0.25, 0.0, 0.75))),
)
"""two groups of two actuators, which follow each other in one of two ways"""


@given(seeds)
def test_actuators_of_a_wave_follow_each_other(seed):
    """They share all genes; the wave's shift is added to the phase, twice as much to that of the second harmonic."""
    assert WAVES.blocks == {"phase": 2, "wave": 1, "amplitude": 2, "frequency": 1, "sine 2": 2, "cosine 2": 2}
    genes = np.random.default_rng(seed).uniform(size=WAVES.size)
    own = Gait((0, 1, 2, 3), np.zeros(4), np.full(4, 0.2), np.full(4, 0.5), start=0.0, ramp=1e-3)
    gait = one_gait(WAVES.gaits(own, genes[None]), 0)
    shifts = np.array(WAVES.waves[int(genes[2] >= 0.5)].shifts)
    np.testing.assert_allclose(gait.phase / (2 * np.pi), genes[[0, 0, 1, 1]] + shifts)
    np.testing.assert_allclose(gait.amplitude, 0.1 + 0.2 * genes[[3, 3, 4, 4]])
    np.testing.assert_allclose(gait.frequency, 0.2 + 0.8 * genes[5])
    sine, cosine = genes[[6, 6, 7, 7]] - 0.5, genes[[8, 8, 9, 9]] - 0.5
    np.testing.assert_allclose(gait.overtones[0].phase, 2 * gait.phase + np.arctan2(cosine, sine))
    np.testing.assert_allclose(gait.overtones[0].size, np.hypot(sine, cosine))


@given(seeds)
def test_a_wave_takes_its_shape_from_the_first_of_each_group(seed):
    """Overtones and amplitudes of the scene's gait that do not evolve: members follow each other all the same, and a
    free gait keeps the shape of each member's sine."""
    draw, wave = np.random.default_rng(seed), TravellingWave((0, 1, 0, 1), (0.0, 0.0, 0.5, 0.25))
    own = Gait((0, 1, 2, 3), draw.uniform(0, 6, 4), draw.uniform(0.1, 0.4, 4), np.full(4, 0.5), -2.0, 1e-3)
    own = dataclasses.replace(own, overtones=(Overtone(draw.uniform(0, 0.5, 4), draw.uniform(0, 6, 4)),))
    waved = one_gait(Genome(4, waves=(wave,)).gaits(own, draw.uniform(size=(1, 2))), 0)
    free = one_gait(Genome(4).gaits(own, draw.uniform(size=(1, 4))), 0)
    early = (np.asarray(free.phase) - own.phase) / np.pi  # s, at half a period a second
    for t in (0.0, 0.3, 1.1):
        first, later = contraction(waved, t), [contraction(waved, t + shift / 0.5) for shift in (0.5, 0.25)]
        np.testing.assert_allclose([first[2], first[3]], [later[0][0], later[1][1]], atol=1e-12)
        of_own = [contraction(own, t + early[k])[k] for k in range(4)]
        np.testing.assert_allclose(contraction(free, t), of_own, atol=1e-12)


@given(seeds)
def test_a_wave_that_is_scaled_down_stays_one(seed):
    """Actuators that follow each other by thirds of a period keep one amplitude; none is quicker than it may."""
    wave = TravellingWave((0, 0, 0, 1, 1, 1), (0.0, 1 / 3, 2 / 3, 0.5, 5 / 6, 1 / 6))
    genome = Genome(6, (0.1, 0.6), (0.5, 3.0), overtones=1, waves=(wave,), quickest=(0.8,) * 6)
    own = Gait(tuple(range(6)), np.zeros(6), np.full(6, 0.2), np.full(6, 0.5), start=0.0, ramp=0.6)
    gaits = genome.gaits(own, np.random.default_rng(seed).uniform(size=(8, genome.size)))
    amplitudes = np.asarray(gaits.amplitude).reshape(8, 2, 3)
    np.testing.assert_allclose(amplitudes, np.broadcast_to(amplitudes[..., :1], (8, 2, 3)), rtol=1e-12)
    for rate in (peak_rates, ramp_rates):
        assert np.asarray(rate(gaits, np.ones(6))).max() <= 0.8 * (1 + 1e-12)


def test_gaits_have_the_ramp_of_the_genome():
    """In a population and alone; without one, that of the scene's gait."""
    genes = random_genes(0, 4)
    assert [float(Genome(3, ramp=ramp).gaits(GAIT, genes[:, :3]).ramp) for ramp in (None, 0.4)] == [1e-3, 0.4]
    with pytest.raises(InputError, match=r"^ramp = 0 s: expected a positive number"):
        Genome(3, ramp=0.0)


def test_one_wave_needs_no_gene_to_say_which():
    """And waves that do not fit the actuators, or each other, are refused."""
    wave = TravellingWave((0, 0, 0), (0.0, 1 / 3, 2 / 3))
    assert Genome(3, waves=(wave,)).blocks == {"phase": 1}
    np.testing.assert_allclose(
        Genome(3, waves=(wave,)).gaits(GAIT, np.array([[0.1]])).phase[0], 2 * np.pi * (0.1 + np.arange(3) / 3)
    )
    for waves in ((TravellingWave((0, 0), (0.0, 0.5)),), (wave, TravellingWave((0, 1, 0), (0.0, 0.0, 0.5)))):
        with pytest.raises(InputError, match="waves: expected the same groups of 3 actuators in each"):
            Genome(3, waves=waves)
    with pytest.raises(InputError, match="waves, active"):
        Genome(3, waves=(wave,), active=2)


TWO_WAVES = (
    TravellingWave((0, 0, 1, 1), (0.0, 0.25, 0.0, 0.5)),
    TravellingWave((0, 0, 1, 1), (0.0, 0.75, 0.0, 0.5)),
)
ENCODED = {
    "free": Genome(4, (0.1, 0.3), (0.2, 1.0), overtones=2),
    "waves": Genome(4, (0.1, 0.3), (0.2, 1.0), overtones=1, waves=TWO_WAVES),
    "one wave": Genome(4, (0.1, 0.3), waves=TWO_WAVES[:1]),
    "phases": Genome(4),
}
FOUR = Gait((0, 1, 2, 3), np.zeros(4), np.full(4, 0.2), np.full(4, 0.5), start=0.0, ramp=1.0)


@given(st.sampled_from(sorted(ENCODED)), seeds)
def test_the_genes_of_a_gait_encode_it(which, seed):
    """Of any genes' gait, `genes_of` gives genes of the same gait."""
    genome = ENCODED[which]
    gait = one_gait(genome.gaits(FOUR, np.random.default_rng(seed).uniform(size=(1, genome.size))), 0)
    again = one_gait(genome.gaits(FOUR, genome.genes_of(gait)[None]), 0)
    t = np.linspace(0, 2, 41)
    for at in t:
        np.testing.assert_allclose(contraction(again, at), contraction(gait, at), atol=1e-12)


def test_gaits_that_no_genes_encode_are_refused():
    """Beyond the bounds, no wave, more overtones than the genome has, or a genome with ranks."""
    over = (Overtone(np.full(4, 0.1), np.zeros(4)),)
    refused = {
        "amplitude = 0.4 of the gait to begin with: out of 0.1 to 0.3": ("free", {"amplitude": np.full(4, 0.4)}),
        "frequency = 0.1 of the gait to begin with": ("free", {"frequency": np.full(4, 0.1)}),
        "no wave of this robot": ("waves", {"phase": np.array([0.0, 1.0, 2.0, 3.0])}),
        "overtones = 1: the gait has 2": ("waves", {"overtones": 2 * over}),
    }
    for message, (which, parts) in refused.items():
        with pytest.raises(InputError, match=message):
            ENCODED[which].genes_of(dataclasses.replace(FOUR, **parts))
    uneven = np.array([0.2, 0.3, 0.2, 0.2])
    shifted = 2 * np.pi * np.array(TWO_WAVES[1].shifts)
    ENCODED["waves"].genes_of(dataclasses.replace(FOUR, phase=shifted))
    with pytest.raises(InputError, match="no wave of this robot"):
        ENCODED["waves"].genes_of(dataclasses.replace(FOUR, phase=shifted, amplitude=uneven))
    with pytest.raises(InputError, match="active = 2"):
        FULL.genes_of(GAIT)


def test_gaits_that_would_change_are_refused():
    """Overtones beyond 1/h, frequencies that differ, overtones that differ in a group; one number for all is fine."""
    big = (Overtone(np.full(4, 0.9), np.zeros(4)),)
    uneven = (Overtone(np.array([0.1, 0.1, 0.3, 0.1]), np.zeros(4)),)
    for which, parts in (
        ("waves", {"overtones": big, "phase": 2 * np.pi * np.array(TWO_WAVES[0].shifts)}),
        ("free", {"overtones": big}),
        ("free", {"frequency": np.array([0.5, 0.25, 1.0, 0.5])}),
        ("waves", {"overtones": uneven, "phase": 2 * np.pi * np.array(TWO_WAVES[0].shifts)}),
    ):
        with pytest.raises(InputError, match="no genes encode it"):
            ENCODED[which].genes_of(dataclasses.replace(FOUR, **parts))
    one = Gait((0, 1, 2, 3), np.zeros(4), 0.2, 0.5)
    np.testing.assert_array_equal(ENCODED["free"].genes_of(one), ENCODED["free"].genes_of(FOUR))
