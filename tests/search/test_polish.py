"""Polish: improvements are kept only when they verify, and gradients are refused where they mean nothing."""

import re
from typing import NamedTuple

import equinox as eqx
import numpy as np
import pytest

from jaxgrity import (
    ActuatorBounds,
    Fitness,
    Genome,
    InputError,
    PolishConfig,
    SearchProblem,
    SolverOptions,
    SteadySpeed,
    Straightness,
    Uncertainty,
    load_gait,
    polish,
    random_phases,
    with_gait,
)
from jaxgrity.model.actuation import actuated_lengths, peak_rates
from jaxgrity.search import FidelityLevel, FidelityLevels, Promoted, check_polish
from jaxgrity.search.gradients import smoothed_gradients
from jaxgrity.search.judging import scored
from jaxgrity.search.polish import KEPT, Polished
from jaxgrity.search.polish_kept import kept_or_undone

OPTIONS = SolverOptions(dt=1e-2)
ROBUST = Fitness(uncertainty=Uncertainty(phase=0.03), robots=4)
SMALL = PolishConfig(
    rollouts=480,
    samples=12,
    robots=4,
    width=0.02,
    learning_rate=0.02,
    comparison_robots=16,
    final_robots=16,
)


@pytest.fixture(scope="module")
def brisk(swimmer):
    """With a gait near its own frequency: its rollouts become more sensitive after the first period is over."""
    return eqx.tree_at(lambda s: (s.gait.frequency, s.gait.ramp), swimmer, (np.full(2, 1.5), np.array(0.1)))


def polished(scene, config, starts=1, fitness=ROBUST, on_step=None):
    """From random gaits, over 4 s at a coarse step."""
    members = len(scene.gait.members)
    genes = random_phases(starts, members, seed=7) / (2 * np.pi)
    problem = SearchProblem(scene, Genome(members), 4.0, fitness)
    return genes, polish(problem, genes, config, options=OPTIONS, final_options=OPTIONS, on_step=on_step)


@pytest.mark.slow
def test_polish_improves_and_verifies(brisk):
    """From a random gait there is much to gain; the last judgement in float64 repeats what is returned."""
    steps = []
    _, result = polished(brisk, SMALL, on_step=steps.append)
    assert result.improved
    assert "the polished gait is kept" in result.reason
    assert result.after.mean[0] > 1.1 * result.before.mean[0] > 0
    assert tuple(steps) == result.steps
    assert result.rollouts == 480 == len(steps) * 48
    _, again = polished(brisk, SMALL)
    np.testing.assert_array_equal(again.genes, result.genes)
    np.testing.assert_array_equal(again.after.each, result.after.each)


@pytest.mark.campaign
def test_polish_improves_a_robot_on_the_ground(exact):
    """By more than a tenth of a metre."""
    _, result = polished(exact, SMALL)
    assert result.improved
    assert result.after.mean[0] > result.before.mean[0] + 0.1


@pytest.mark.slow
def test_the_best_of_several_climbs_counts(brisk):
    """Each climb has its share, and the comparison of their ends is paid; the result beats the first start."""
    _, result = polished(brisk, SMALL, starts=2)
    assert result.rollouts == 2 * 4 * 48 + 2 * 16
    assert result.after.mean[0] > result.before.mean[0]


@pytest.mark.slow
def test_polish_keeps_the_start_where_nothing_is_gained(brisk):
    """Steps of no length gain nothing."""
    genes, result = polished(brisk, SMALL._replace(rollouts=48, learning_rate=0.0))
    assert not result.improved
    assert "kept as it was" in result.reason
    np.testing.assert_array_equal(result.genes, genes[0])


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["pathwise", "combined"])
def test_no_pathwise_gradient_where_the_sensitivity_forbids_it(brisk, kind):
    """With a bound that any motion passes it is not used, and the reason says so; the combined one goes on smoothed."""
    genes, result = polished(brisk, SMALL._replace(kind=kind, largest_sensitivity=1e-6))
    assert "no pathwise gradient was used: |d com/d phase| passes 1e-06 m/rad" in result.reason
    assert all(step.pathwise_share == 0 for step in result.steps)
    if kind == "pathwise":
        assert not result.steps
        assert not result.improved
        np.testing.assert_array_equal(result.genes, genes[0])
    else:
        assert result.improved


def climbs_as_far_as_the_sensitivity_allows(scene, bound):
    """Half way there in the first half of its steps."""
    _, result = polished(scene, SMALL._replace(kind="pathwise", rollouts=600, largest_sensitivity=bound))
    assert result.horizon == result.sensitivity.horizon(bound)
    ahead = [step.horizon for step in result.steps]
    assert ahead[0] < ahead[-1] == result.horizon
    assert all(step.pathwise_share == 1 for step in result.steps)
    assert result.improved
    return result


@pytest.mark.slow
def test_pathwise_polish_where_the_sensitivity_allows_it(brisk):
    """Over the horizon that the measured sensitivity allows, which is shorter than the rollout."""
    assert climbs_as_far_as_the_sensitivity_allows(brisk, 0.03).horizon < 4.0


@pytest.mark.campaign
def test_pathwise_polish_of_a_robot_on_the_ground(exact):
    """With a gait at 1 Hz, whose first period is over before it becomes sensitive."""
    climbs_as_far_as_the_sensitivity_allows(eqx.tree_at(lambda s: s.gait.frequency, exact, np.ones(6)), 3.0)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["smoothed", "combined"])
def test_climbs_keep_their_precision(brisk, kind, monkeypatch):
    """Gradients in float32 stay there: a gait in float64 would be rolled out in float64, at twice the cost."""
    found = []

    def watched(*arguments):
        found.append(smoothed_gradients(*arguments))
        return found[-1]

    monkeypatch.setattr("jaxgrity.search.climb.smoothed_gradients", watched)
    polished(brisk, SMALL._replace(kind=kind, rollouts=300, largest_sensitivity=0.03))
    assert len(found) > 1
    assert {leaf.dtype for gradient in found for leaf in gradient} == {np.dtype("float32")}


def test_bad_polish_configs_are_refused(exact):
    """An unknown gradient, too few rollouts, and a pathwise gradient of what needs metrics."""
    with pytest.raises(InputError, match="polishing by 'exact': unknown"):
        polished(exact, SMALL._replace(kind="exact"))
    with pytest.raises(InputError, match=r"8 rollouts of polish: expected 128 or more \(climbs: 2\)"):
        polished(exact, SMALL._replace(rollouts=8), starts=2)
    with pytest.raises(InputError, match=r"80 rollouts of polish: expected 128 or more \(climbs: 2\)"):
        check_polish(SMALL._replace(rollouts=2 * 16 + 48), ROBUST, 2)
    check_polish(SMALL._replace(rollouts=2 * (16 + 48)), ROBUST, 2)
    measured = Fitness(Straightness())
    with pytest.raises(InputError, match="'pathwise': objective = Straightness; expected objective = distance, "):
        polished(exact, SMALL._replace(kind="pathwise"), fitness=measured)
    cautious = Fitness(uncertainty=Uncertainty(phase=0.03), robots=4, caution=1.0)
    with pytest.raises(InputError, match="'combined': caution = 1; expected caution = 0, or another gradient"):
        polished(exact, SMALL._replace(kind="combined"), fitness=cautious)
    with pytest.raises(InputError, match="'pathwise': objective = SteadySpeed; expected objective = distance, "):
        polished(exact, SMALL._replace(kind="pathwise"), fitness=Fitness(SteadySpeed()))
    for samples in (5, 4.0):
        with pytest.raises(InputError, match=f"polish: samples = {samples}: expected an even number"):
            polished(exact, SMALL._replace(samples=samples))


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ({"robots": 0}, "robots = 0: expected a whole number, at least 1"),
        ({"comparison_robots": 0}, "comparison_robots = 0: expected a whole number, at least 1"),
        ({"final_robots": 8.5}, "final_robots = 8.5: expected a whole number, at least 1"),
        ({"overtones": -1}, "overtones = -1: expected a whole number, at least 0"),
        ({"gaits": 0}, "gaits = 0: expected a whole number, at least 1"),
        ({"width": 0.0}, "width = 0: expected a positive number"),
        ({"learning_rate": -1.0}, "learning_rate = -1: expected a finite number, at least 0"),
        ({"momentum": 2.0}, "momentum = 2: expected a number from 0 to 1"),
        ({"largest_sensitivity": np.nan}, "largest_sensitivity = nan: expected a positive number"),
    ],
)
def test_settings_out_of_their_range_are_refused(bad, message):
    """By their names, each alone."""
    with pytest.raises(InputError, match=f"^polish: {message}$"):
        check_polish(SMALL._replace(**bad), ROBUST, 1)


@pytest.mark.parametrize(
    "rows", [np.zeros((1, 1)), np.zeros((0, 2)), np.full((1, 2), np.nan)], ids=["one", "none", "nan"]
)
def test_genes_of_another_genome_are_refused(swimmer, rows):
    """One start or more, of as many numbers as the genome has."""
    with pytest.raises(InputError, match=r"^genes(\[0, 0\] = nan|.* expected \(1, 2\)$)"):
        polish(SearchProblem(swimmer, Genome(2), 4.0, ROBUST), rows, SMALL)


@pytest.mark.parametrize(
    ("multiplier", "said"),
    [
        (1.6, "an orbit that multiplies a disturbance in one cycle by 1.6, the start on one with 0.997"),
        (1234.0, "an orbit that multiplies a disturbance in one cycle by 1200, the start on one with 0.997"),
        (
            np.inf,
            "no orbit that attracts disturbed robots, in the first half of 48 periods of actuation, "
            "the start on one with 0.997",
        ),
    ],
)
def test_a_polished_gait_whose_orbit_repels_is_not_kept(swimmer, monkeypatch, multiplier, said):
    """The reason says so once, with digits that tell the multipliers from 1, and how long an orbit was looked for."""
    monkeypatch.setattr("jaxgrity.search.polish_kept.multipliers_of", lambda *_: np.array([multiplier]))
    problem, level = SearchProblem(swimmer, Genome(2), 4.0, Fitness()), FidelityLevel("", swimmer, 1e-2, "float64")
    start, worth = np.zeros(2), scored(np.zeros((1, 1)), 0.0)
    promoted = Promoted(start[None], worth, np.array([0.9974]), None)
    better = Polished(start + 0.5, problem.genome, True, worth, worth, (), 4.0, None, 8, f"up by 0.1: {KEPT}")
    found = kept_or_undone(problem, FidelityLevels(*(level,) * 4), promoted, start, better, SMALL)
    np.testing.assert_array_equal(found.genes, start)
    assert found.reason == f"up by 0.1; but it settles on {said}: the gait is kept as it was"


@pytest.mark.parametrize(
    ("excess", "said"),
    [
        ([0.0, *[0.1] * 4], "it is beyond a bound on actuators"),
        ([0.1, *[0.2] * 4], "it is further beyond a bound on actuators"),
        ([0.2, 0.1, *[0.3] * 3], None),
    ],
)
def test_polish_leads_no_further_beyond_a_bound(swimmer, monkeypatch, excess, said):
    """From a start within it, or beyond it; what is nearer to it is kept."""
    monkeypatch.setattr("jaxgrity.search.polish_kept.excess_at", lambda *_: np.array(excess))
    problem, level = SearchProblem(swimmer, Genome(2), 4.0, Fitness()), FidelityLevel("", swimmer, 1e-2, "float64")
    start, worth = np.zeros(2), scored(np.zeros((1, 1)), 0.0)
    promoted = Promoted(start[None], worth, None, None)
    better = Polished(start + 0.5, problem.genome, True, worth, worth, (), 4.0, None, 8, f"up by 0.1: {KEPT}")
    found = kept_or_undone(problem, FidelityLevels(*(level,) * 4), promoted, start, better, SMALL)
    assert found.improved is (said is None)
    if said:
        assert found.reason == f"up by 0.1; but {said}: the gait is kept as it was"


@pytest.mark.parametrize("turned", [False, True], ids=["better", "worse"])
def test_half_of_the_way_is_kept_where_more_is_beyond_a_bound(swimmer, monkeypatch, turned):
    """If an ensemble finds it better than the start; angles go the shorter way round."""
    ends = np.array([0.1, 0.35]), np.array([0.9, 0.55])
    start, end = ends[::-1] if turned else ends
    monkeypatch.setattr("jaxgrity.search.polish_kept.excess_at", lambda *_: np.array([0.0, 0.1, 0.1, 0.0, 0.0]))
    problem, level = SearchProblem(swimmer, Genome(2), 4.0, ROBUST), FidelityLevel("", swimmer, 1e-2, "float64")
    worth, levels = scored(np.zeros((1, 1)), 0.0), FidelityLevels(*(level,) * 4)
    promoted = Promoted(start[None], worth, None, None)
    better = Polished(end, problem.genome, True, worth, worth, (), 4.0, None, 8, f"up by 0.1: {KEPT}")
    found = kept_or_undone(problem, levels, promoted, start, better, SMALL)
    assert found.improved is not turned
    np.testing.assert_allclose(found.genes, start if turned else [0.0, 0.45], atol=1e-12)
    way = "down" if turned else "up"
    assert re.match(
        rf"up by 0.1; but it is beyond a bound on actuators; 50 % of the way: fitness {way} by ", found.reason
    )


class Rolling(NamedTuple):
    """A gait that lasts, as the problem of its steady speed, its genes, and options."""

    problem: SearchProblem
    genes: np.ndarray
    options: SolverOptions


@pytest.fixture(
    scope="module",
    params=[pytest.param(name, marks=pytest.mark.campaign) for name in ("creeping", "exact")],
)
def rolling(request):
    """Of a strut that creeps, whose contact is smooth; and of a robot with exact contact."""
    known = request.getfixturevalue(request.param)
    if request.param == "creeping":
        genome = Genome(1, amplitude=(0.05, 0.5), frequency=(0.3, 1.6), overtones=1)
        genes, scene = np.array([0.0, 0.15 / 0.45, 0.7 / 1.3, 0.5, 0.9]), known
        fitness = Fitness(SteadySpeed(), Uncertainty(friction=0.05), robots=2)
        return Rolling(SearchProblem(scene, genome, 20.0, fitness), genes, SolverOptions("rk4", 8e-3))
    scene, genome = with_gait(known, load_gait("lasting")), Genome(6, frequency=(0.3, 1.6), amplitude=(0.05, 0.5))
    amplitude, frequency = (float(x[0]) for x in (scene.gait.amplitude, scene.gait.frequency))
    phase = np.asarray(scene.gait.phase) / (2 * np.pi)
    genes = np.concatenate([phase, np.full(6, (amplitude - 0.05) / 0.45), [(frequency - 0.3) / 1.3]])
    fitness = Fitness(SteadySpeed(), Uncertainty(friction=0.05), robots=2)
    return Rolling(SearchProblem(scene, genome, 20.0, fitness), genes, OPTIONS)


def on_orbit(rolling, rollouts, problem=None, on_step=None):
    """Polished by so many rollouts."""
    config = PolishConfig(rollouts, "orbit", samples=4, robots=2, final_robots=16)
    how = {"options": rolling.options, "final_options": rolling.options, "on_step": on_step}
    return polish(problem or rolling.problem, rolling.genes[None], config, **how)


def test_polish_on_the_orbit_climbs_its_speed(rolling):
    """Faster on the very robots that judge its steps, in each of which the fitness does not fall."""
    steps = []
    result = on_orbit(rolling, 600, on_step=steps.append)
    assert tuple(steps) == result.steps
    assert len(steps) >= 2
    assert result.rollouts <= 600
    assert result.improved
    assert result.after.mean[0] > result.before.mean[0] + 1e-3
    assert np.all(np.diff([step.fitness for step in steps]) >= 0)


def test_polish_on_the_orbit_spends_no_more_than_it_may(rolling, monkeypatch):
    """If tangents cost more than is left, it ends where it began, and says so."""
    monkeypatch.setattr("jaxgrity.search.polish_orbit.TANGENT", 100.0)
    result = on_orbit(rolling, 30)
    assert result.rollouts <= 30
    assert not result.improved
    assert "the derivative of the orbit's speed costs more rollouts than are left" in result.reason


@pytest.mark.campaign
def test_polish_on_the_orbit_keeps_within_the_bound_on_rates(rolling):
    """The gradient asks for a higher frequency; the gait that is found is no quicker than the bound allows."""
    problem, genes, _ = rolling
    gait = problem.genome.gaits(problem.scene.gait, genes[None])
    lengths = actuated_lengths(problem.scene.structure, gait.members)
    limit = float(peak_rates(gait, lengths).max()) * 1.001
    bounded = problem._replace(
        fitness=Fitness(SteadySpeed(), Uncertainty(friction=0.05), robots=2, bounds=ActuatorBounds(rate=limit))
    )
    result = on_orbit(rolling, 400, bounded)
    assert result.steps
    found = problem.genome.gaits(problem.scene.gait, result.genes[None])
    assert float(peak_rates(found, lengths).max()) <= limit
    assert result.after.mean[0] > 0


def test_polish_on_the_orbit_needs_one(rolling, monkeypatch):
    """Where the robot settles on none, the reason says so, and the gait is kept as it was."""
    monkeypatch.setattr("jaxgrity.orbits.finding.SETTLED", 0.0)
    result = on_orbit(rolling, 200)
    assert result.reason == "the robot settles on no orbit in the first half of 48 periods of actuation"
    assert not result.steps
    np.testing.assert_array_equal(result.genes, rolling.genes)


def test_polish_on_the_orbit_is_of_steady_speed_alone(exact):
    """A distance from the start is no property of an orbit; and one gradient has to be paid."""
    with pytest.raises(InputError, match="the objective Distance is not the speed of an orbit; expected SteadySpeed"):
        polished(exact, SMALL._replace(kind="orbit"))
    with pytest.raises(InputError, match="20 rollouts of polish: expected"):
        check_polish(SMALL._replace(kind="orbit", rollouts=20), Fitness(SteadySpeed()), 1)
