"""Levels of fidelity: searches that go through them, ranks on which they agree, and the final verdict on a gait."""

import dataclasses
import json

import equinox as eqx
import jax
import numpy as np
import pytest

from jaxgrity import (
    ActuatorBounds,
    ConeFriction,
    Distance,
    ExactGround,
    Fitness,
    GAConfig,
    Gait,
    Genome,
    InputError,
    Members,
    Scene,
    SearchConfig,
    SearchProblem,
    Speed,
    Structure,
    Uncertainty,
    as_population,
    contact_twin,
    search_gaits,
)
from jaxgrity.search import (
    EvaluationConfig,
    EvolutionState,
    FidelityLevel,
    evolve_through,
    fidelity_levels,
    final_verdict,
    judge_at,
    pipeline,
    rank_correlation,
    search_levels,
    with_robots,
)
from jaxgrity.search.fidelity import Verdict, excess_at
from jaxgrity.search.genetic_algorithm import Record
from jaxgrity.search.judging import judge_until, scored, standard_error
from jaxgrity.search.models import rough_step
from jaxgrity.stepping import default_method, default_step
from jaxgrity.trust.error_bars import Verified

SLOPE = 0.1
STROKES = Gait((0,), [-np.pi / 2], [0.3], [1.0], start=0.0, ramp=0.25)


def sled() -> Scene:
    """A strut that lies along a slope, with more of its mass at its lower end: with each stroke it creeps down."""
    nodes = np.array([[0, 0, 0], [np.cos(SLOPE), 0, -np.sin(SLOPE)]])
    structure = Structure(nodes, np.array([1.0, 2.0]), Members(((0, 1),), None, np.array([1.0])))
    return Scene(structure, 9.81, ground=ExactGround(incline=SLOPE), friction=ConeFriction(0.3), gait=STROKES)


class Enough(Exception):  # noqa: N818 it is no error
    """Ends a search whose progress has been heard."""


@pytest.mark.parametrize(
    ("bounds", "counted"),
    [
        (ActuatorBounds(), [set(), set()]),
        (ActuatorBounds(rate=1.0), [{"within the bound on rates"}] * 2),
        (ActuatorBounds(rate=1.0, power=200.0), [{"within the bound on rates"}, {"within bounds"}]),
        (ActuatorBounds(power=200.0), [set(), {"within bounds"}]),
    ],
)
def test_progress_names_the_bounds_that_were_counted(exact, monkeypatch, bounds, counted):
    """A wide screening looks at the bound on rates alone; without a bound there is nothing to be within."""
    heard, record = [], Record(*(np.zeros(1) for _ in Record._fields))

    def evolve(levels, problem, configs, *, on_generation, **how):
        for number in range(len(levels)):
            on_generation(number, EvolutionState(1, None, None, record, None))
        raise Enough

    monkeypatch.setattr(pipeline, "evolve_through", evolve)
    with pytest.raises(Enough):
        search_gaits(exact, SearchConfig(evaluation=EvaluationConfig(bounds=bounds)), on_progress=heard.append)
    assert [each.facts.keys() - {"level", "best", "failed"} for each in heard[1:]] == counted


def test_a_penalty_scene_is_screened_on_its_exact_twin(reference, exact):
    """Its exact twin at 10 ms, itself in float32 at twice its step, and in float64 at half of it."""
    screening, own, decisive, verification = levels = fidelity_levels(reference)
    assert [(level.name, level.dt, level.dtype) for level in levels.compared] == [
        ("screening", 0.01, "float32"),
        ("own model", 1e-3, "float32"),
        ("verification", 2.5e-4, "float64"),
    ]
    assert eqx.tree_equal(screening.scene, exact)
    assert own.scene is verification.scene is reference
    assert decisive is verification
    assert levels.rough_own is own
    assert search_levels(levels) == (screening, own)


def test_an_exact_scene_is_its_own_screening(exact):
    """Itself throughout: there is one search, for there is one model."""
    levels = fidelity_levels(exact)
    assert [(level.dt, level.dtype) for level in levels.compared] == [
        (0.01, "float32"),
        (5e-3, "float32"),
        (2.5e-3, "float64"),
    ]
    assert all(level.scene is exact for level in levels)
    assert search_levels(levels) == (levels.screening,)
    assert levels.rough_own is levels.screening


def steps_of(scene, dt=None):
    """Of all levels, s."""
    return [level.dt for level in fidelity_levels(scene, dt).compared]


def test_a_step_of_ones_own_is_halved_for_verification(reference, exact):
    """Verification is at half of it; screening stays as it is; a step that cannot be doubled is taken as it is."""
    assert steps_of(reference, 4e-4) == [0.01, 8e-4, 2e-4]
    assert steps_of(exact, 2e-3) == [0.01, 2e-3, 1e-3]
    assert steps_of(reference, 1e-3) == [0.01, 1e-3, 5e-4]


def test_steps_are_no_larger_than_is_stable(reference, exact):
    """Stiff cables leave neither 10 ms for screening nor twice the step for the own model."""
    stiff = [eqx.tree_at(lambda s: s.structure.cables.stiffness, s, np.full(24, 3e4)) for s in (exact, reference)]
    steps = [default_step(scene, default_method(scene)) for scene in stiff]
    assert steps_of(stiff[0]) == [steps[0], steps[0], steps[0] / 2]
    assert steps_of(stiff[0])[0] < 0.01
    assert steps_of(stiff[1])[0] == steps[0]


def test_rank_correlation_of_known_rows():
    """1 for the same order, -1 for the opposite; what failed on any level does not count."""
    rows = np.array([[1.0, 2, 3, 4, 5, 9, -9], [10, 20, 30, 40, 50, -np.inf, 0],
                     [5, 4, 3, 2, 1, 0, np.nan], [1, 3, 2, 4, 5, 7, 7]])  # fmt: skip
    expected = [[1, 1, -1, 0.9], [1, 1, -1, 0.9], [-1, -1, 1, -0.9], [0.9, 0.9, -0.9, 1]]
    np.testing.assert_allclose(rank_correlation(rows), expected, rtol=0, atol=1e-12)
    assert np.isnan(rank_correlation(rows[:, 1:])).all(), "two gaits always rank alike or opposite, and four often do"
    alike = rank_correlation(np.array([rows[0, :5], np.ones(5)]))
    np.testing.assert_array_equal(np.isnan(alike), [[False, True], [True, True]], "equal gaits have no ranks")


def test_another_number_of_robots_changes_nothing_else():
    """Objective, uncertainty, caution and bounds stay."""
    fitness = Fitness(Speed(), Uncertainty(phase=0.1), robots=4, caution=0.5, bounds=ActuatorBounds(rate=1.0))
    more = with_robots(fitness, 64)
    assert more.robots == 64
    assert eqx.tree_equal(with_robots(more, 4), fitness)


def test_two_models_count_alike(swimmer):
    """A robot is worth the mean of what it is worth on both, by the same draws."""
    thick = dataclasses.replace(swimmer, node_damping=3 * swimmer.node_damping)
    problem = SearchProblem(swimmer, Genome(2), 1.0, Fitness(uncertainty=Uncertainty(phase=0.3), robots=2))
    gaits = as_population(swimmer.gait)
    levels = [FidelityLevel("", scene, rough_step(thick), "float64") for scene in (swimmer, thick)]
    one, other = (judge_at(level, gaits, problem, seed=2).each for level in levels)
    both = judge_at(levels[0]._replace(twin=thick), gaits, problem, seed=2).each
    np.testing.assert_allclose(both, (one + other) / 2, rtol=1e-12)
    assert not np.allclose(one, other)


def test_gaits_beyond_a_bound_are_told_from_others(swimmer):
    """By the forces that a robot measures which is as the model says; a bound on the rate alone needs no rollout."""
    problem, level = SearchProblem(swimmer, Genome(2), 1.0, Fitness()), FidelityLevel("", swimmer, 1e-2, "float64")
    genes = np.array([[0.1, 0.2], [0.6, 0.3]])
    for force, within in ((1e-3, False), (1e6, True)):
        assert np.all((excess_at(level, genes, problem, ActuatorBounds(force=force)) == 0) == within)
    rate = 0.3 * np.pi
    assert np.all(excess_at(level, genes, problem, ActuatorBounds(rate=1.01 * rate)) == 0)
    np.testing.assert_allclose(excess_at(level, genes, problem, ActuatorBounds(rate=rate / 2)), 1, rtol=1e-3)


@pytest.fixture(scope="module")
def two_levels(swimmer):
    """Two levels that are alike, so that a generation is compiled once, and a problem to search on them."""
    levels = tuple(FidelityLevel(name, swimmer, 1e-2, "float32") for name in ("first", "second"))
    return levels, SearchProblem(swimmer, Genome(2), 1.0, Fitness())


@pytest.fixture(scope="module")
def two_searches(two_levels):
    """Two small searches, one after the other: `two_searches(**options)` runs them, and says what was reported."""
    config = GAConfig(population=8, generations=2, elites=1)

    def run(**options):
        seen = []
        tell = lambda number, state: seen.append((number, state))  # noqa: E731
        return evolve_through(*two_levels, (config, config), seed=5, on_generation=tell, **options), seen

    return run


def assert_same(mine, its):
    """To the last bit."""
    for a, b in zip(jax.tree.leaves(mine), jax.tree.leaves(its), strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_search_hands_its_population_on(two_searches):
    """The second one begins with the gaits with which the first one ended: alike levels judge them alike."""
    (first, second), seen = two_searches()
    assert [(number, state.number) for number, state in seen] == [(0, 1), (0, 2), (1, 1), (1, 2)]
    taken = seen[2][1].evaluated
    np.testing.assert_array_equal(taken.genes, first.last.genes)
    np.testing.assert_array_equal(taken.fitness, first.last.fitness)
    assert second.best[0] == first.best[-1]
    assert not np.array_equal(second.last.genes, first.last.genes)


def test_a_search_evolves_on_the_own_model_alone(two_levels):
    """A level's contact twin judges in comparisons, not in every generation."""
    (level, _), problem = two_levels
    thick = dataclasses.replace(level.scene, node_damping=3 * level.scene.node_damping)
    configs = (GAConfig(population=8, generations=1, elites=1),)
    own, both = (evolve_through((each,), problem, configs) for each in (level, level._replace(twin=thick)))
    assert_same(both, own)


def test_searches_go_on_from_where_they_were(two_searches):
    """From any state of either search to the same end of both, and only what is new is reported."""
    whole, seen = two_searches()
    for done, (number, state) in enumerate(seen, start=1):
        states = (state,) if number == 0 else (seen[1][1], state)
        again, later = two_searches(states=states)
        assert_same(again, whole)
        assert [n for n, _ in later] == [n for n, _ in seen[done:]]
        assert_same([s for _, s in later], [s for _, s in seen[done:]])


def test_a_population_that_grows_is_refused(two_levels):
    """Before anything is rolled out: the best of a population are handed on, and there are no more."""
    configs = tuple(GAConfig(population=size, generations=2, elites=1) for size in (6, 8))
    with pytest.raises(InputError, match=r"populations of \[6, 8\] gaits: expected none larger"):
        evolve_through(*two_levels, configs)


@pytest.mark.parametrize("robots", [8, 20])
def test_robots_are_asked_until_it_is_enough(robots):
    """In rounds of four, whose second halves have the opposite draws of the first, as have those of all of them."""
    draws = np.random.default_rng(0).normal(size=(5, 1, 2))
    asked = []

    def judged(number):
        asked.append(number)
        return scored(np.concatenate([1 + draws[number], 1 - draws[number]], axis=1), 0.5)

    scores = judge_until(judged, robots, 0.5, lambda each: each.size >= 12)
    assert asked == list(range(min(robots, 12) // 4))
    first, second = scores.each.reshape(2, -1)
    np.testing.assert_allclose(first + second, 2)
    assert standard_error(scores.each[0]) == pytest.approx(0, abs=1e-12)
    assert_same(scores, scored(scores.each, 0.5))


@pytest.mark.campaign
@pytest.mark.parametrize(("precision", "factor"), [(0.0, 1), (1.0, 2)])
def test_the_final_verdict_is_made_of_what_it_says(precision, factor, monkeypatch):
    """Its numbers are those of verification, of ensembles at the step or at twice that, as closely as is asked for, and
    of the other model; they agree with each other as far as they say, and go into a JSON file."""
    monkeypatch.setattr("jaxgrity.search.fidelity.PRECISION", precision)
    scene, dt = sled(), 5e-3
    problem = SearchProblem(scene, Genome(1), 1.0, Fitness(Distance(), Uncertainty(friction=0.1), robots=2))
    heard = []
    tell = lambda done, total: heard.append((done, total))  # noqa: E731
    gaits, level = as_population(scene.gait), FidelityLevel("", scene, factor * dt, "float32")
    feeling = Fitness(Distance(), Uncertainty(friction=0.1), robots=4, bounds=ActuatorBounds(force=1e-3))
    forces = 1e-3 * (1 + judge_at(level, gaits, problem._replace(fitness=feeling), 3).excess[0])
    bounds = ActuatorBounds(force=float(np.sort(forces)[2]) * (1 + 1e-6))
    verdict = final_verdict(problem, scene.gait, own_step=2 * dt, bounds=bounds, robots=4, seed=3, on_progress=tell)
    assert verdict.beyond == 0.25
    assert heard == [(done, 4) for done in range(5)]
    distance, robust = verdict.verified.distance[0], verdict.robust.each[0]
    assert verdict.verified.steps == (factor * dt, factor * dt / 2, factor * dt / 4)
    assert 0 < verdict.verified.error_bar[0] < distance
    assert robust.dtype == np.float32
    assert robust.shape == (4,)
    # friction, the one thing that differs, is less for some and more for others
    assert robust.min() < distance < robust.max()

    four = problem._replace(fitness=with_robots(problem.fitness, 4))
    fine, coarse = (judge_at(FidelityLevel("", scene, h, "float32"), gaits, four, 3) for h in (dt, 2 * dt))
    assert_same(verdict.robust, fine if factor == 1 else coarse)
    assert verdict.robust_step == factor * dt
    assert verdict.step_error == pytest.approx(abs(float(fine.mean[0]) - float(coarse.mean[0])))
    assert 0 < verdict.step_error < robust.mean() / 10

    other = verdict.other_model.each[0]
    soft = contact_twin(scene)
    step = default_step(soft, default_method(soft))
    assert_same(verdict.other_model, judge_at(FidelityLevel("", soft, step, "float32"), gaits, four, 3))
    assert other.shape == (4,)
    # as far as creep at 1 cm/s, which is smooth friction's, goes in a second
    assert abs(other.mean() - robust.mean()) < 0.01

    summary = json.loads(json.dumps(verdict.summary()))
    assert summary["distance"] == distance
    assert summary["error_bar"] == verdict.verified.error_bar[0]
    assert summary["robust"] == {
        "mean": robust.mean(),
        "standard_deviation": robust.std(),
        "standard_error": robust.reshape(2, -1).mean(0).std(ddof=1) / np.sqrt(2),
        "failed": 0,
        "tenth_percentile": np.quantile(robust, 0.1),
        "robots": 4,
        "step": factor * dt,
        "step_error": verdict.step_error,
    }
    assert summary["other_contact_model"] == {
        "mean": other.mean(),
        "standard_deviation": other.std(),
        "standard_error": other.reshape(2, -1).mean(0).std(ddof=1) / np.sqrt(2),
        "robots": 4,
        "failed": 0,
    }


def test_robots_that_failed_are_counted_and_not_in_the_mean():
    """Their pairs are broken, so that the error of the mean is not known."""
    one = np.ones(1)
    verified = Verified(one, 0.1 * one, np.zeros((1, 3)), np.zeros((1, 3)), (4e-3, 2e-3, 1e-3))
    some, all_fell = (scored(np.array([each]), 0.5) for each in ([1.0, np.nan, 3.0, 2.0], 4 * [np.nan]))
    summary = Verdict(verified, some, 4e-3, np.nan, all_fell, 0.0).summary()
    told = {"mean": 2.0, "standard_deviation": np.std([1, 3, 2]), "standard_error": None, "failed": 1}
    told |= {"tenth_percentile": np.quantile([1, 3, 2], 0.1), "robots": 4}
    assert {name: summary["robust"][name] for name in told} == told
    assert summary["other_contact_model"]["failed"] == 4
    assert np.isnan(summary["other_contact_model"]["mean"])
