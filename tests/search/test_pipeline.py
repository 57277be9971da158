"""The whole search as a library call: one result, however often it is interrupted, for an objective of one's own."""

import dataclasses
import itertools
import json
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrity import (
    ActuatorBounds,
    Distance,
    ExactGround,
    Fitness,
    Gait,
    Genome,
    InputError,
    Members,
    Objective,
    PolishConfig,
    SearchConfig,
    SearchProblem,
    SearchResult,
    SolverOptions,
    SteadySpeed,
    Structure,
    Uncertainty,
    bumps,
    centre_path,
    edge_lengths,
    gaits_of,
    load_gait,
    one_gait,
    register_objective,
    search_gaits,
    simulate,
    with_gait,
)
from jaxgrity.io.files import save_arrays
from jaxgrity.orbits import find_orbit, stability
from jaxgrity.report.gait_report import Origin, write_report
from jaxgrity.report.measuring import actuators, directions
from jaxgrity.search import (
    OBJECTIVES,
    EvaluationConfig,
    Progress,
    SearchSpace,
    find_objective,
    judge_at,
    load_states,
    without_force_bounds,
)
from jaxgrity.search.checkpoint import saved_arrays
from jaxgrity.search.fidelity import excess_at
from jaxgrity.search.genetic_algorithm import distinct
from jaxgrity.search.judging import standard_error, with_robots
from jaxgrity.search.promotion import orbit_multipliers, promote
from jaxgrity.structures import random_tensegrity

pytestmark = pytest.mark.slow


class Sideways(Objective):
    """How far the centre of mass gets to the left, m."""

    unit: ClassVar[str] = "m"
    needs_metrics: ClassVar[bool] = False
    any_heading: ClassVar[bool] = False

    def worth(self, scene, outcomes, duration):
        moved = (outcomes.com_end - outcomes.com_start)[:, 1]
        return jnp.where(outcomes.failure == 0, moved, jnp.nan)


@pytest.fixture(scope="module")
def config():
    """A small search for the objective above, by its name."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("jaxgrity.search.objectives.OBJECTIVES", dict(OBJECTIVES))
        register_objective("sideways", Sideways)
        objective = find_objective("sideways")()
    return SearchConfig(
        duration=1.5,
        population=4,
        generations=(2, 1),
        wide=False,
        space=SearchSpace(amplitude=None, frequency=None, waves="none"),
        evaluation=EvaluationConfig(
            objective, ActuatorBounds(), Uncertainty(phase=0.03), robots=2, caution=0.0, both_models=False
        ),
        polish=PolishConfig(128, robots=4, final_robots=128),
    )


def evaluating(config: SearchConfig, **changes) -> SearchConfig:
    """The same search with another evaluation."""
    return dataclasses.replace(config, evaluation=dataclasses.replace(config.evaluation, **changes))


class Whole(NamedTuple):
    """A search that nothing interrupted."""

    result: SearchResult
    heard: list[Progress]
    population: dict[str, np.ndarray]
    """that it left in its folder"""
    done_at_report: bool
    done_at_the_end: bool


def population_in(folder: Path) -> dict[str, np.ndarray]:
    with np.load(folder / "population.npz") as saved:
        return dict(saved)


def is_done(folder: Path) -> bool:
    return json.loads((folder / "run.json").read_text())["done"]


@pytest.fixture(scope="module")
def whole(exact, config, tmp_path_factory):
    folder, heard, reported = tmp_path_factory.mktemp("whole"), [], []

    def report(result):
        reported.append((result, is_done(folder)))

    result = search_gaits(exact, config, folder=folder, on_progress=heard.append, report=report)
    ((told, done_at_report),) = reported
    assert told is result
    return Whole(result, heard, population_in(folder), done_at_report, is_done(folder))


class Interruption(Exception):  # noqa: N818 it is no error
    """Raised by a listener, as Ctrl-C would be."""


@pytest.mark.campaign
def test_the_gait_is_there_before_the_report(exact, whole, monkeypatch, tmp_path):
    """Whoever ends a search while its report is made keeps what was found and verified."""

    def stop(*_):
        raise Interruption

    monkeypatch.setattr("jaxgrity.report.gait_report._side_by_side", stop)
    with pytest.raises(Interruption):
        write_report(whole.result, Origin("exact", "sideways", {}, ""), tmp_path, lambda *_: None)
    kept = with_gait(exact, load_gait(tmp_path / "gait.json")).gait
    np.testing.assert_allclose(kept.phase, whole.result.scene.gait.phase)
    assert json.loads((tmp_path / "gait.json").read_text())["robust"] == whole.result.verdict.summary()["robust"]


@pytest.fixture
def interrupted(exact, config, tmp_path):
    """`interrupted(stage, done, **options)`: the folder of a search that was interrupted when it was so far."""

    def search(stage: str, done: int, **options) -> Path:
        def stop(progress):
            if (progress.stage, progress.done) == (stage, done):
                raise Interruption

        with pytest.raises(Interruption):
            search_gaits(exact, config, folder=tmp_path, on_progress=stop, **options)
        return tmp_path

    return search


def assert_same(mine: Any, its: Any) -> None:
    """Of two results all that is not a wall time, to the last bit."""
    mine, its = (result._replace(seconds={}) for result in (mine, its))
    assert jax.tree.structure(mine) == jax.tree.structure(its)
    for a, b in zip(jax.tree.leaves(mine), jax.tree.leaves(its), strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_search_ends_with_a_verified_gait(exact, config, whole):
    """Found for the objective that it was asked for, from the population that it left."""
    result = whole.result
    assert result.problem.fitness.objective == config.evaluation.objective
    assert eqx.tree_equal(result.scene, with_gait(exact, result.gait))
    assert [level.name for level in result.levels.compared] == ["screening", "own model", "verification"]
    assert [search.rollouts for search in result.searches] == [4 * 2 * 2]
    np.testing.assert_array_equal(whole.population["genes"], result.searches[0].last.genes)
    np.testing.assert_array_equal(whole.population["fitness"], result.searches[0].last.fitness)
    agreement = result.promoted.agreement
    assert agreement.fitness.shape == (3, agreement.evolved + 16)
    verified, robust = result.verdict.verified, result.verdict.robust.each[0]
    assert 0 < verified.error_bar[0] < 0.1
    assert robust.size in (64, 128, 192, 256)
    assert robust.size == 256 or standard_error(robust) <= 0.01 * abs(robust.mean())
    # to the left, as its robots get in the mean: the phases of each are a little off
    moved = (verified.com_end - verified.com_start)[0, 1]
    assert robust.min() < moved < robust.max()
    assert set(result.seconds) == {"evolving", "promoting", "polishing", "verifying"}


def test_the_gait_is_the_better_one_of_evolution_and_polish(whole):
    """The best finalist, or what polishing made of it."""
    result = whole.result
    assert result.polished is not None
    genome, genes = result.problem.genome, result.promoted.genes[0]
    if result.polished.improved:
        genome, genes = result.polished.genome, result.polished.genes
    assert_equal_gaits(result.gait, one_gait(genome.gaits(result.problem.scene.gait, genes[None]), 0))


def test_the_best_few_are_compared_over_many_robots(config, whole):
    """They are the best of those that evolved by few robots; the best of them by many goes on."""
    result = whole.result
    agreement, finals = result.promoted.agreement, result.promoted.finals
    evolved = distinct(result.searches[0].last, result.problem.genome, 16)
    few = min(4, len(evolved))
    assert finals.each.shape == (few, 16 * config.evaluation.robots)
    assert np.all(np.diff(finals.fitness) <= 0)
    best = evolved[np.argsort(-agreement.fitness[-1, : len(evolved)])[:few]]
    assert any(np.array_equal(result.promoted.genes[0], genes) for genes in best)
    gaits = result.problem.genome.gaits(result.problem.scene.gait, best)
    again = judge_at(result.levels.verification, gaits, many(result), config.seed + 3)
    np.testing.assert_array_equal(np.sort(again.mean), np.sort(finals.mean))
    assert result.promoted.multipliers is None  # the objective does not look for orbits


class SteadilySideways(Sideways):
    """The same of an orbit."""

    steady: ClassVar[bool] = True


def test_a_gait_whose_orbit_attracts_comes_first(config, whole, monkeypatch):
    """Before those that are worth more by their robots, whose orbit repels, or that settle on none."""
    told = lambda scene, gaits, *_: np.where(np.arange(len(gaits.phase)) % 2, 0.5, 1.5)  # noqa: E731
    monkeypatch.setattr("jaxgrity.search.promotion.orbit_multipliers", told)
    found, fitness = whole.result, evaluating(config, objective=SteadilySideways()).evaluation.fitness()
    problem, silent = found.problem._replace(fitness=fitness), lambda *_: None
    promoted = promote(problem, config.evaluation.bounds, found.levels, found.searches[0], config, silent)
    attracts = promoted.multipliers < 1
    assert set(attracts) == {True, False}
    np.testing.assert_array_equal(attracts, np.sort(attracts)[::-1])
    for part in (attracts, ~attracts):
        assert np.all(np.diff(np.asarray(promoted.finals.fitness)[part]) <= 0)


@pytest.mark.campaign
def test_multipliers_are_those_of_the_gaits_orbits(exact):
    """As from an orbit that is watched for longer, at another step; a gait that never settles has none."""
    known = load_gait("straight")
    each_as_it_likes = np.random.default_rng(0).uniform(0, 6, known.phase.shape)
    gaits = gaits_of(known, np.array([known.phase, each_as_it_likes]))
    lasting, wandering = orbit_multipliers(exact, gaits, 5e-3)
    scene, options = with_gait(exact, known), SolverOptions(dt=4e-3)
    longer = stability(scene, find_orbit(scene, 100.0, options=options), options=options)
    assert lasting == pytest.approx(longer.largest, abs=0.1)
    assert lasting < 0.5
    assert wandering == np.inf


def test_orbits_are_sought_where_there_may_be_some(exact):
    """On planes, also inclined ones, for objectives that look for them; on bumps a search ends without."""
    bumpy = dataclasses.replace(exact, ground=ExactGround(surface=bumps(0.02, 0.8, seed=0)))
    steep = dataclasses.replace(exact, ground=ExactGround(0.1))
    for scene, objective, sought in (
        (exact, SteadySpeed(), True),
        (steep, SteadySpeed(), True),
        (exact, Distance(), False),
        (bumpy, SteadySpeed(), False),
    ):
        assert SearchProblem(scene, Genome(6), 40.0, Fitness(objective)).seeks_orbits is sought


@pytest.mark.campaign
def test_on_an_incline_the_distance_is_the_horizontal_one_of_a_finer_rollout(exact, config):
    """Within its error bar, also in the mean of robots that hardly differ; they get down the slope."""
    ground = ExactGround(0.15)
    structure = dataclasses.replace(exact.structure, nodes=ground.set_down(exact.structure.nodes, -0.02))
    scene = dataclasses.replace(exact, ground=ground, structure=structure)
    config = evaluating(config, objective=Distance(), uncertainty=Uncertainty(friction=1e-6))
    config = dataclasses.replace(config, generations=(1, 1))
    result = search_gaits(scene, config)
    verified, robust = result.verdict.verified, result.verdict.robust.each[0]
    finer = centre_path(result.scene, simulate(result.scene, config.duration, options=SolverOptions(dt=6.25e-4)))
    moved = finer[-1] - finer[0]
    assert moved[2] < -0.05
    assert verified.distance[0] == pytest.approx(np.hypot(*moved[:2]), abs=2 * verified.error_bar[0])
    np.testing.assert_allclose(robust, verified.distance[0], atol=2 * verified.error_bar[0] + 1e-4)
    np.testing.assert_allclose((verified.com_end - verified.com_start)[0], moved, atol=3 * verified.error_bar[0])


def many(result):
    """The problem of a search with as many robots as its finalists were compared over."""
    fitness = with_robots(result.problem.fitness, result.promoted.finals.each.shape[1])
    return result.problem._replace(fitness=without_force_bounds(fitness))


def assert_equal_gaits(mine, its) -> None:
    for a, b in zip(jax.tree.leaves(mine), jax.tree.leaves(its), strict=True):
        np.testing.assert_array_equal(a, b)


def test_progress_arrives_in_order(whole):
    """Stage by stage; within each from nothing done to everything, one by one."""
    stages = {stage: list(heard) for stage, heard in itertools.groupby(whole.heard, lambda progress: progress.stage)}
    assert list(stages) == ["evolving", "promoting", "polishing", "verifying"]
    assert len(whole.heard) == sum(map(len, stages.values()))
    for stage, total in (("evolving", 2), ("promoting", 4), ("verifying", 4)):
        assert [(heard.done, heard.total) for heard in stages[stage]] == [(k, total) for k in range(total + 1)]
    steps = whole.result.polished.steps
    assert [heard.done for heard in stages["polishing"]] == list(range(len(steps) + 1))
    assert all(heard.total is None for heard in stages["polishing"])
    best = [heard.facts["best"] for heard in stages["evolving"][1:]]
    assert best == whole.result.searches[0].best.tolist()
    assert [heard.facts["level"] for heard in stages["promoting"][:3]] == ["screening", "own model", "verification"]
    assert [heard.facts["fitness"] for heard in stages["polishing"][1:]] == [step.fitness for step in steps]


def test_the_report_comes_before_the_search_counts_as_done(whole):
    """So that files which a crash kept from being written are written when the search is resumed."""
    assert not whole.done_at_report
    assert whole.done_at_the_end


@pytest.mark.parametrize(("stage", "done"), [("evolving", 1), pytest.param("polishing", 1, marks=pytest.mark.campaign)])
@pytest.mark.campaign
def test_an_interrupted_search_is_resumed_to_the_very_same_end(exact, config, whole, interrupted, stage, done):
    """Wherever it was interrupted; generations that were saved are not evolved again."""
    folder, heard = interrupted(stage, done), []
    # a generation is saved before the listener hears of it
    saved = 1 if stage == "evolving" else 2
    assert [state.number for state in load_states(folder)] == [saved]
    assert not is_done(folder)
    result = search_gaits(exact, config, folder=folder, resume=True, on_progress=heard.append)
    assert_same(result, whole.result)
    assert_equal_gaits(population_in(folder), whole.population)
    assert [one.done for one in heard if one.stage == "evolving"] == list(range(saved, 3))
    assert is_done(folder)


@pytest.mark.parametrize(
    ("stage", "kept"),
    [
        pytest.param("polishing", ["promote"], marks=pytest.mark.campaign),
        ("verifying", ["promote", "polish"]),
    ],
)
def test_a_resumed_search_repeats_no_stage_that_was_done(exact, config, whole, interrupted, monkeypatch, stage, kept):
    """What was promoted and polished is taken from the folder, to the last bit."""

    def repeated(*_, **__):
        raise AssertionError("done again")

    folder, heard = interrupted(stage, 0), []
    for name in kept:
        monkeypatch.setattr(f"jaxgrity.search.pipeline.{name}", repeated)
    result = search_gaits(exact, config, folder=folder, resume=True, on_progress=heard.append)
    assert_same(result, whole.result)
    saved = [one for one in heard if one.facts == {"result": "as saved"}]
    assert [(one.stage, one.done == one.total) for one in saved] == [
        (name, True) for name in ("promoting", "polishing")[: len(kept)]
    ]


def test_a_search_that_begins_again_forgets_all_stages(exact, config, interrupted):
    """Results of another search would pass for its own. Those of another release are refused before anything runs."""
    folder = interrupted("verifying", 0)
    assert (folder / "promoted.npz").exists()
    kept, heard = saved_arrays(folder / "polished.npz"), []
    del kept["version"]
    save_arrays(folder / "polished.npz", **kept)
    with pytest.raises(InputError, match=r"polished\.npz: kept by another release, with no version; expected a run of"):
        search_gaits(exact, config, folder=folder, resume=True, on_progress=heard.append)
    assert not heard
    interrupted("evolving", 0, restart=True)
    assert not list(folder.glob("po*.npz")) + list(folder.glob("pr*.npz"))


def test_a_search_is_resumed_with_its_own_config_and_scene_alone(exact, config, interrupted):
    """Others are refused in one line that says what differs; what was saved stays."""
    folder = interrupted("evolving", 1)
    with pytest.raises(InputError, match=r"its run has robots = 2, not 3; expected the same to resume it$"):
        search_gaits(exact, evaluating(config, robots=3), folder=folder, resume=True)
    heavier = eqx.tree_at(lambda s: s.structure.node_mass, exact, 2 * exact.structure.node_mass)
    with pytest.raises(InputError, match=r"its run has fingerprint of the scene = \w+, not \w+; expected"):
        search_gaits(heavier, config, folder=folder, resume=True)
    with pytest.raises(InputError, match=r"holds an unfinished run; expected resume, restart or another folder$"):
        search_gaits(exact, config, folder=folder)
    run = json.loads((folder / "run.json").read_text())
    del run["settings"]["crossover"]  # as of versions that bred otherwise
    (folder / "run.json").write_text(json.dumps(run))
    with pytest.raises(InputError, match=r"its run has crossover = None, not \[1\.0\]; expected the same"):
        search_gaits(exact, config, folder=folder, resume=True)
    assert [state.number for state in load_states(folder)] == [1]


def test_a_search_begins_again_where_that_is_asked_for(interrupted):
    """From its first generation."""
    folder = interrupted("evolving", 2)
    assert [state.number for state in load_states(folder)] == [2]
    interrupted("evolving", 1, restart=True)
    assert [state.number for state in load_states(folder)] == [1]


def test_a_search_needs_no_folder(exact, config, whole, tmp_path, monkeypatch):
    """It finds the same, and leaves no file behind."""
    monkeypatch.chdir(tmp_path)
    assert_same(search_gaits(exact, config), whole.result)
    assert not list(tmp_path.iterdir())


def test_a_report_that_fails_can_be_made_again(exact, config, whole, tmp_path):
    """The search is not done then, and nothing of it is searched again."""

    def fail(result):
        raise OSError("no space left on device")

    with pytest.raises(OSError, match="no space left"):
        search_gaits(exact, config, folder=tmp_path, report=fail)
    assert not is_done(tmp_path)
    heard, reported = [], []
    search_gaits(exact, config, folder=tmp_path, resume=True, on_progress=heard.append, report=reported.append)
    assert [one.done for one in heard if one.stage == "evolving"] == [2]
    assert_same(reported[0], whole.result)


@pytest.mark.parametrize("option", ["resume", "restart"])
def test_only_a_folder_has_a_search_to_resume(exact, config, option):
    with pytest.raises(InputError, match="there is no folder to find a search in; expected folder"):
        search_gaits(exact, config, **{option: True})


def test_a_search_is_not_both_resumed_and_restarted(exact, config, tmp_path):
    with pytest.raises(InputError, match="one continues a search, the other removes it; expected one of them"):
        search_gaits(exact, config, folder=tmp_path / "run", resume=True, restart=True)
    assert not (tmp_path / "run").exists()


@pytest.mark.campaign
def test_a_random_structure_can_be_searched(exact, config):
    """A robot of five struts that nobody designed, on exact contact: its gait is worth what a rollout of it shows."""
    shape = random_tensegrity(struts=5, seed=1)
    nodes = shape.nodes - [0, 0, shape.nodes[:, 2].min() - 0.02]
    body = Structure(
        nodes,
        np.full(10, 0.5),
        Members(shape.struts, None, edge_lengths(nodes, shape.struts)),
        Members(shape.cables, np.full(len(shape.cables), 600.0), 0.8 * edge_lengths(nodes, shape.cables)),
    )
    one = np.ones(5)
    gait = Gait((0, 1, 2, 3, 4), 0 * one, 0.1 * one, 0.8 * one, 0.1, 0.2)
    scene = dataclasses.replace(exact, structure=body, gait=gait, node_damping=np.full(10, 0.5))
    result = search_gaits(scene, dataclasses.replace(evaluating(config, objective=Distance()), polish=None))
    end = simulate(
        result.scene, config.duration, options=SolverOptions(dt=result.levels.verification.dt), frame_rate=20.0
    )
    path = centre_path(result.scene, end)
    moved = np.linalg.norm((path[-1] - path[0])[:2])
    told = result.verdict.verified
    assert abs(told.distance[0] - moved) <= 2 * told.error_bar[0] + 1e-3


@pytest.mark.campaign
def test_a_bound_on_force_that_binds_is_kept(exact, config):
    """Below what the best gait of a search without it needs: what is found needs less, or is said to exceed it."""
    loose = search_gaits(exact, dataclasses.replace(config, polish=None))
    peak = excess_at(loose.levels.own, loose.promoted.genes[:1], loose.problem, ActuatorBounds(force=1.0))[0] + 1.0
    assert np.isfinite(peak)
    bound = ActuatorBounds(force=0.97 * float(peak))
    assert excess_at(loose.levels.own, loose.promoted.genes[:1], loose.problem, bound)[0] > 0
    tight = search_gaits(exact, dataclasses.replace(evaluating(config, bounds=bound), polish=None))
    exceeds = excess_at(tight.levels.own, tight.promoted.genes[:1], tight.problem, bound)[0] > 0
    assert tight.verdict.beyond > 0 or not exceeds


def test_the_report_says_by_how_much_a_gait_exceeds_its_bounds(swimmer):
    """By its peaks in the report's own rollout, and the rate that follows from the gait alone."""
    how = swimmer, SolverOptions("rk4", dt=1e-2), 2.0
    asked = actuators(*how, ActuatorBounds())
    assert asked["excess"] == 0
    bounds = ActuatorBounds(force=0.8 * asked["peak_force"], power=2 * asked["peak_power"])
    assert actuators(*how, bounds)["excess"] == pytest.approx(0.25)
    # amplitude, pi and frequency, of struts of 1 m
    assert actuators(*how, ActuatorBounds(rate=0.1 * np.pi))["excess"] == pytest.approx(2)


def test_a_robot_in_a_plane_has_its_own_direction_alone(swimmer):
    """Its positions do not decide its symmetries, which the report of a search does without."""
    options = SolverOptions("rk4", dt=1e-2)
    (found,) = directions(swimmer, options, 2.0)
    path = centre_path(swimmer, simulate(swimmer, 2.0, options=options))
    assert found["distance"] == pytest.approx(abs(path[-1, 0] - path[0, 0]), abs=1e-9)
    assert abs(np.sin(found["heading"])) < 1e-9
