"""What residuals say: noise that lasts from row to row, noise larger than was said, and another contact model."""

import equinox as eqx
import numpy as np
import pytest

from jaxgrity import (
    ConeFriction,
    ExactGround,
    Gait,
    Members,
    PenaltyGround,
    Scene,
    SmoothFriction,
    Structure,
    contact_twin,
    simulate,
)
from jaxgrity.identification import Parameter, SeenPositions, Starts, identify, measured_motion
from jaxgrity.identification.residuals import (
    Series,
    _autocorrelations,
    _burg,
    judged_residuals,
    scores_covariance,
    widened,
)

ROWS = 201


def white(rng, columns=3):
    return rng.normal(size=(ROWS, columns))


def lasting(rng, share=0.9, columns=3):
    """An autoregressive process of variance 1."""
    noise, x = rng.normal(size=(ROWS, columns)), np.zeros((ROWS, columns))
    x[0] = noise[0]
    for k in range(1, ROWS):
        x[k] = share * x[k - 1] + np.sqrt(1 - share**2) * noise[k]
    return x


def smoothed(rng):
    """A moving mean, as filters of cameras make it, twice as large as said."""
    return 2 * np.sqrt(5) * np.apply_along_axis(np.convolve, 0, white(rng), np.ones(5) / 5, "same")


def drifting(rng):
    """Pixels, and a camera that warms up: a sum of which no part is said."""
    return 0.7 * lasting(rng, 0.97) + 0.7 * white(rng)


def shared(rng):
    """One shaking camera sees all columns."""
    return np.repeat(lasting(rng, 0.8, 1), 3, axis=1)


def series(r):
    return Series(r, np.ones(r.shape, bool))


def told(r):
    return judged_residuals([series(r)], float(np.sqrt(np.mean(r**2))), float(r.size))


def test_white_noise_of_the_size_that_was_said_is_found_to_be_so():
    """In 200 draws no test of independence fails more often than once."""
    rng = np.random.default_rng(0)
    every = [told(white(rng)) for _ in range(200)]
    assert sum(each.correlated for each in every) <= 1
    assert sum(each.too_large for each in every) <= 1
    assert np.median([each.independent for each in every]) > 500
    assert "like independent noise" in every[0].summary()


@pytest.mark.parametrize("noise", [lasting, smoothed, drifting, shared])
def test_noise_that_lasts_is_found(noise):
    """By its correlation and by its runs, and what is left of the number of residuals."""
    found = told(noise(np.random.default_rng(1)))
    assert found.correlated
    assert found.runs < 1e-3
    assert found.independent < 200
    assert found.too_large == (noise is smoothed)
    assert "correlated from row to row" in found.summary()


def test_noise_larger_than_was_said_is_found():
    """By a tenth, in 600 numbers; white as it is, it is not correlated."""
    found = told(1.1 * white(np.random.default_rng(2)))
    assert (found.too_large, found.correlated) == (True, False)
    assert "1.1 times the noise that was said" in found.summary()


def test_few_rows_are_not_tested():
    """Nine of them say nothing of what lasts."""
    assert "too few rows" in told(np.ones((9, 3))).summary()
    assert not told(np.ones((9, 3))).correlated


def test_what_is_missing_does_not_count():
    """Half of the rows of one column are gone: pairs are those that are there."""
    rng = np.random.default_rng(3)
    r, seen = lasting(rng), np.ones((ROWS, 3), bool)
    seen[::2, 1] = False
    found = judged_residuals([Series(np.where(seen, r, 0), seen)], 1.0, 500.0)
    assert found.correlated
    assert 0.7 < found.autocorrelation < 0.95


def test_noise_that_lasts_does_so_through_what_is_missing():
    """The process that is fitted where two of five numbers are missing has the correlation of the one that is not."""
    rng = np.random.default_rng(4)
    found = []
    for _ in range(20):
        r, seen = lasting(rng), rng.uniform(size=(ROWS, 3)) > 0.4
        coefficients = [_burg(np.where(known, r, 0), known) for known in (np.ones_like(seen), seen)]
        found.append([_autocorrelations(a, ROWS)[1] for a in coefficients])
    whole, missing = np.median(found, axis=0)
    assert whole > 0.8
    assert missing == pytest.approx(whole, abs=0.05)


@pytest.mark.parametrize(("share", "off"), [(0.5, 0.15), (0.9, 0.35)])
def test_the_covariance_of_scores_is_that_of_the_process(share, off):
    """Against J'ΩJ with the Ω from which the noise was drawn, in the mean over draws."""
    rng, time = np.random.default_rng(4), np.linspace(0, 2, ROWS)
    J = np.stack([np.sin(10 * time), np.cos(3 * time) * time], 1)[:, None] * np.ones((1, 3, 1))
    omega = share ** np.abs(np.subtract.outer(np.arange(ROWS), np.arange(ROWS)))
    expected = 3 * J[:, 0].T @ omega @ J[:, 0]
    found = np.mean([scores_covariance(series(lasting(rng, share)), J) for _ in range(40)], axis=0)
    np.testing.assert_allclose(np.diag(found), np.diag(expected), rtol=off)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [lasting, smoothed, drifting, shared])
def test_intervals_cover_whatever_the_noise_is(noise):
    """90 to 99 %, of 300 linear fits with the slopes of a swinging mass; the noise's kind is not told."""
    rng, time = np.random.default_rng(5), np.linspace(0, 2, ROWS)
    J = np.zeros((ROWS, 3, 2))
    J[:, 2, 0], J[:, 0, 0] = 8 * time * np.sin(10.6 * time), 3 * time * np.sin(3 * time)
    J[:, 2, 1] = 4 * time * np.cos(10.6 * time)
    flat = J.reshape(-1, 2)
    inverse = np.linalg.inv(flat.T @ flat + np.eye(2))
    covered = []
    for _ in range(300):
        z = rng.normal(size=2)
        y = noise(rng) + J @ z
        found = inverse @ flat.T @ y.ravel()
        r = y - J @ found
        misfit = float(np.sqrt(np.sum(r**2) / (r.size - 2)))
        tests = judged_residuals([series(r)], misfit, r.size - 2.0)
        least = np.linalg.inv(flat.T @ flat / max(misfit, 1) ** 2 + np.eye(2))
        if tests.enough:
            scores = scores_covariance(series(r), J)
            covariance = widened(inverse @ (scores + np.eye(2)) @ inverse, least, tests)
            covered.append(np.abs(found - z) < 1.96 * np.sqrt(np.diag(covariance)))
    assert len(covered) > 150
    assert np.all((np.mean(covered, axis=0) >= 0.9) & (np.mean(covered, axis=0) <= 0.99)), np.mean(covered, axis=0)


PARAMETERS = [Parameter("structure.cables.stiffness", 0.3), Parameter("structure.cables.damping", 0.3)]


@pytest.fixture(scope="module")
def swinging():
    """A mass on a cable as it is thought to be, and the motion of one that is 12 % stiffer and 20 % more damped."""
    nodes = [[0.0, 0, 0], [0.2, 0, -1.1]]
    cables = Members(((0, 1),), [100.0], [1.0], [0.5])
    scene = Scene(Structure(nodes, [0.0, 1.0], cables=cables, fixed=((0, "xyz"),)), gravity=9.81)
    there = eqx.tree_at(lambda s: (s.structure.cables.stiffness, s.structure.cables.damping), scene,
                        (np.array([112.0]), np.array([0.6])))  # fmt: skip
    return scene, simulate(there, 2.0, frame_rate=100.0)


def fitted(swinging, noise):
    scene, truth = swinging
    path = np.asarray(truth.positions)
    motion = measured_motion(
        scene, truth.times, path[:, 1] + 2e-3 * noise, 2e-3, SeenPositions((1,)), Starts(path, spread=None)
    )
    return identify(scene, PARAMETERS, motion)


def covers(found) -> np.ndarray:
    """Of each interval whether the truth is in it; NaN where there is none, since data cannot tell the parameter."""
    return np.array([np.nan if each.interval is None else each.interval[0] <= true <= each.interval[1]
                     for each, true in zip(found.estimates, (1.12, 1.2))])  # fmt: skip


@pytest.mark.campaign
def test_a_fit_widens_for_noise_that_lasts_and_says_so(swinging):
    """Beside white noise of the same size; noise that hardly changes leaves no interval."""
    rng = np.random.default_rng(6)
    calm, lasts, frozen = (fitted(swinging, noise) for noise in (white(rng), lasting(rng), lasting(rng, 0.995)))
    assert calm.residuals.as_said
    assert lasts.residuals.correlated
    for a, b in zip(calm.estimates, lasts.estimates):
        assert b.standard_error > 2 * a.standard_error
    assert "correlated from row to row (0.9" in lasts.summary()
    assert not frozen.residuals.enough
    assert all(each.interval is None and each.value is not None for each in frozen.estimates)
    assert "(error not known)" in frozen.summary()
    assert calm.twin is None, "there is no ground"


@pytest.mark.campaign
@pytest.mark.parametrize("noise", [white, lasting, drifting, smoothed])
def test_forty_fits_cover(swinging, noise):
    """Of 40 intervals of 95 % each, as all but one in a hundred of such counts: no more than six are off."""
    rng = np.random.default_rng(7)
    found = np.array([covers(fitted(swinging, noise(rng))) for _ in range(40)])
    assert np.all(np.isfinite(found).sum(0) >= 25)
    assert np.all(np.sum(found == 0, axis=0) <= 6), np.nanmean(found, axis=0)


def hopper(exact: bool) -> Scene:
    """A strut that pumps on its end, with a heavy node on top: all that it does it does by contact."""
    nodes = [[0.0, 0, 0], [0.3, 0, 0.9]]
    length = [float(np.hypot(0.3, 0.9))]
    struts = Members(((0, 1),), None if exact else [2e3], length, None if exact else [20.0])
    gait = Gait((0,), [0.0], [0.1], [2.0], start=0.05, ramp=0.2)
    ground = ExactGround() if exact else PenaltyGround(3e3, 2.0)
    return Scene(Structure(nodes, [1.0, 2.0], struts=struts), 9.81, None, ground,
                 ConeFriction(0.3) if exact else SmoothFriction(0.3, 0.02), gait)  # fmt: skip


@pytest.mark.campaign
def test_what_both_contact_models_say_is_compared():
    """Data of the other model: residuals say that it is not the noise, both fits disagree, and the interval knows."""
    scene = hopper(False)
    truth = eqx.tree_at(lambda s: s.friction.mu, contact_twin(scene), np.array(0.2))
    moved = simulate(truth, 0.6, frame_rate=50.0)
    path = np.asarray(moved.positions)
    values = path[:, 0] + 5e-4 * np.random.default_rng(8).normal(size=path[:, 0].shape)
    motion = measured_motion(scene, moved.times, values, 5e-4, SeenPositions((0,)), Starts(path, spread=None))
    mu = Parameter("friction.mu", 0.5)
    found, alone = identify(scene, [mu], motion), identify(scene, [mu], motion, twin=False)
    assert not alone.residuals.as_said
    off = abs(alone.estimates[0].value - 2 / 3) / alone.estimates[0].standard_error
    assert found.twin.values["friction.mu"] == pytest.approx(2 / 3, rel=0.02)
    assert found.twin.misfit < 1.3 < found.misfit
    assert found.twin.apart["friction.mu"] > 3
    assert off > 3
    assert found.estimates[0].standard_error > 2 * alone.estimates[0].standard_error
    assert "the other contact model: friction.mu 0.66" in found.summary()
