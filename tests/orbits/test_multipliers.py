"""Floquet multipliers: against differences of the map, and against what becomes of robots that are disturbed."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrity import InputError, final_state, load_gait, with_gait
from jaxgrity.orbits import floquet_multipliers, multipliers, restarted, stability
from jaxgrity.orbits.cycles import Plane

PLANES = [Plane(np.eye(3), True), Plane(np.eye(3), False)]


@pytest.fixture(scope="module")
def found(crawler):
    """The multipliers of two masses that creep."""
    scene, orbit, options = crawler
    return floquet_multipliers(scene, orbit, options=options)


def test_neutral_multipliers_are_one(found):
    """A shift stays as it is in a cycle, and so does a turn; they are named, and the others apart."""
    assert list(found.neutral) == ["shift x", "shift y", "turn"]
    np.testing.assert_allclose(list(found.neutral.values()), 1.0, atol=1e-6)
    assert len(found.others) == 12 - 3
    assert found.largest < 1
    assert (np.diff(np.abs(found.others)) <= 0).all()
    assert found.residual < 1e-6


def test_a_deviation_along_a_direction_grows_by_its_multiplier(crawler, found):
    """By central differences of a cycle, but for the shift and the turn that it ends with: two masses on the x axis."""
    scene, orbit, options = crawler
    here, h, (q, v) = restarted(scene, orbit), 1e-5, found.state
    real = np.flatnonzero(np.abs(found.others.imag) < 1e-12)[0]
    value, way = found.others[real].real, found.directions[real].real
    ends = [final_state(here, orbit.cycle, options, (q + s * h * way[0], v + s * h * way[1])) for s in (1, -1)]
    grown = (np.concatenate(ends[0]) - np.concatenate(ends[1])) / (2 * h)
    # what no shift along the ground and no turn changes: heights, and the distance of the two
    heights = np.append(grown[:2, 2], grown[2:, 2])
    along = np.append(grown[1, 0] - grown[0, 0], grown[3, 0] - grown[2, 0])
    both = np.concatenate(way)
    expected = np.append(both[[0, 1, 2, 3], 2], [both[1, 0] - both[0, 0], both[3, 0] - both[2, 0]])
    np.testing.assert_allclose(np.append(heights, along), value * expected, atol=1e-5)


@pytest.mark.parametrize("plane", PLANES, ids=["level", "slope"])
def test_multipliers_of_a_map_made_by_hand(plane):
    """One that shifts and turns as it goes: what is neutral is taken out, and the eigenvalues of the rest are left."""
    random = np.random.default_rng(0)
    state, mass = random.normal(size=(2, 4, 3)), np.array([1.0, 2, 3, 4])
    neutral, fits = multipliers._generators(plane, state), multipliers._fits(mass, plane, state[0])
    held = np.linalg.svd(fits)[2][len(fits) :].T
    known = np.concatenate([[-1.7, 0.9], 0.1 * random.uniform(size=held.shape[1] - 2)])
    basis = np.column_stack([neutral, held])
    own = basis @ np.diag(np.append(np.ones(neutral.shape[1]), known)) @ np.linalg.inv(basis)
    angle = 0.4 * plane.turns
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    end = state @ turn.T + np.array([[[3.0, -1, 0]], [[0, 0, 0]]])
    found = multipliers._multipliers(mass, plane, state, end, np.kron(np.eye(8), turn) @ own)
    np.testing.assert_allclose(np.sort(found.others.real), np.sort(known), atol=1e-12)
    np.testing.assert_allclose(found.others[:2], [-1.7, 0.9], atol=1e-12)
    assert found.residual < 1e-12
    assert set(found.neutral) == set(multipliers.NEUTRAL[: neutral.shape[1]])
    lost = multipliers._multipliers(mass, plane, state, end, np.full((24, 24), np.nan))
    assert np.isnan(lost.others).all()


@pytest.mark.parametrize("nodes", [1, 3], ids=["a point", "a vertical line"])
def test_a_robot_without_extent_has_no_heading(nodes):
    """Shifts alone are neutral."""
    random = np.random.default_rng(0)
    state = random.normal(size=(2, nodes, 3)) * np.array([[[0, 0, 1.0]], [[1, 1, 1]]])
    other, shifts = 0.5 * np.eye(6 * nodes), np.zeros((6 * nodes, 2))
    for k in range(2):
        shifts[k : 3 * nodes : 3, k] = 1
    kept = shifts @ shifts.T / nodes
    found = multipliers._multipliers(np.ones(nodes), PLANES[0], state, state, kept + other @ (np.eye(6 * nodes) - kept))
    assert list(found.neutral) == ["shift x", "shift y"]
    np.testing.assert_allclose(list(found.neutral.values()), 1.0, atol=1e-12)
    np.testing.assert_allclose(found.others, np.full(6 * nodes - 2, 0.5), atol=1e-12)


def test_orbits_without_multipliers_are_refused(crawler):
    """A rollout that failed, a cycle that begins before the orbit's state."""
    scene, orbit, options = crawler
    with pytest.raises(InputError, match=r"^orbit: its rollout failed; expected one that was watched to the end"):
        floquet_multipliers(scene, orbit._replace(verified_for=0.0), options=options)
    with pytest.raises(InputError, match=r"^after = -1: expected a whole number, at least 0"):
        floquet_multipliers(scene, orbit, options=options, after=-1)


@pytest.mark.campaign
def test_on_exact_contact_an_orbit_that_attracts_has_the_multipliers_of_disturbed_robots(exact):
    """Of the same size, alike whichever cycle is taken; deviations that violate constraints add zeros."""
    from jaxgrity.orbits import find_orbit

    scene = with_gait(exact, load_gait("straight"))
    orbit = find_orbit(scene, 110.0)
    found = floquet_multipliers(scene, orbit, after=20)
    again = floquet_multipliers(scene, orbit, after=20 + orbit.periods)
    np.testing.assert_allclose(list(found.neutral.values()), 1.0, atol=1e-8)
    assert again.largest == pytest.approx(found.largest, rel=1e-3)
    assert found.largest == pytest.approx(stability(scene, orbit, robots=64).largest, rel=0.5)
    lengths = [q[1::2] - q[::2] for q in (jnp.asarray(found.state[0]), found.directions[0, 0])]
    assert np.abs(np.sum(lengths[0] * lengths[1], axis=1)).max() < 1e-3 * np.abs(found.directions[0, 0]).max()
