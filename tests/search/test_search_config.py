"""What a search is made of, before anything is rolled out: what may vary, and what is refused."""

import dataclasses

import jax
import jaxtyping
import numpy as np
import pytest

from jaxgrity import (
    ActuatorBounds,
    Distance,
    InputError,
    PolishConfig,
    SearchConfig,
    SteadySpeed,
    SteadyTurn,
    Uncertainty,
    load_gait,
    load_scene,
    parse_scene,
    scene_text,
    with_gait,
)
from jaxgrity.cli.search_settings import SearchSettings
from jaxgrity.model.actuation import actuated_lengths, peak_rates, ramp_rates
from jaxgrity.populations.uncertainty import ensemble
from jaxgrity.search import EvaluationConfig, SearchSpace, ga_configs, genome_to_polish, search_problem
from jaxgrity.search.judging import masses_and_lengths
from jaxgrity.search.search_config import plain_config
from jaxgrity.search.search_space import with_actuated


def test_by_default_gaits_are_waves_and_look_for_steady_speed(exact):
    """With one phase and one amplitude for all struts; free gaits have those of every strut."""
    problem = search_problem(exact, SearchConfig())
    assert isinstance(problem.fitness.objective, SteadySpeed)
    assert problem.genome.blocks == {"phase": 1, "wave": 1, "amplitude": 1, "frequency": 1}
    free = search_problem(exact, SearchConfig(space=SearchSpace(waves="none")))
    assert free.genome.blocks == {"phase": 6, "amplitude": 6, "frequency": 1}


def test_a_turn_is_not_its_mirror_image():
    """Where the robot stands so that a mirror leaves it as it is, gaits that turn have half of the images."""
    scene = parse_scene(scene_text("exact").replace('pose = "face"', 'pose = "strut"'))
    images = {
        kind: search_problem(scene, SearchConfig(evaluation=EvaluationConfig(kind()))).genome.images
        for kind in (SteadySpeed, SteadyTurn)
    }
    assert len(images[SteadySpeed]) == 2 * len(images[SteadyTurn]) > 2


def test_scaled_gaits_stay_within_the_bound_on_the_rate(exact):
    """From the first moment on, with strokes that are off by as much as they may be, too. Without a bound, none is."""
    space, evaluation = SearchSpace(waves="none", frequency=(0.3, 3.0)), EvaluationConfig()
    problem = search_problem(exact, SearchConfig(space=space))
    gaits = problem.genome.gaits(exact.gait, np.random.default_rng(0).uniform(size=(64, problem.genome.size)))
    lengths, most = actuated_lengths(exact.structure, exact.gait.members), 1 / (1 + evaluation.uncertainty.actuation)
    for rates in (peak_rates(gaits, lengths), ramp_rates(gaits, lengths)):
        assert float(rates.max()) == pytest.approx(evaluation.bounds.rate * most)
    unbounded = search_problem(exact, SearchConfig(space=space, evaluation=EvaluationConfig(bounds=ActuatorBounds())))
    assert unbounded.genome.quickest == ()


def test_scaled_gaits_of_cables_leave_room_for_less_prestress(exact):
    """Robots with longer cables keep the bound on the rate too, and some nearly reach it."""
    doubts = Uncertainty(prestress=0.3, actuation=0.02)
    space = SearchSpace(members="cables", waves="none", frequency=(0.5, 2.5))
    evaluation = EvaluationConfig(uncertainty=doubts)
    scene = with_actuated(exact, space)
    problem = search_problem(scene, SearchConfig(space=space, evaluation=evaluation))
    gaits = problem.genome.gaits(scene.gait, np.random.default_rng(0).uniform(size=(32, problem.genome.size)))
    robots, differences = ensemble(jax.random.key(0), scene, gaits, doubts, 16)
    lengths = masses_and_lengths(scene, robots, differences)[1]
    for rates in (peak_rates(robots, lengths), ramp_rates(robots, lengths)):
        assert 0.95 < float(rates.max()) <= evaluation.bounds.rate


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_scaled_gaits_do_not_exceed_the_bound_by_rounding(exact, dtype):
    """With certain amplitudes they are at the bound, and would rank after all gaits within it."""
    space = SearchSpace(waves="none", frequency=(0.3, 3.0))
    certain = EvaluationConfig(uncertainty=Uncertainty(), caution=0.0)
    problem = search_problem(exact, SearchConfig(space=space, evaluation=certain))
    genes = np.random.default_rng(0).uniform(size=(256, problem.genome.size)).astype(dtype)
    gaits = jax.tree.map(lambda x: np.asarray(x, dtype), problem.genome.gaits(exact.gait, genes))
    lengths = np.asarray(actuated_lengths(exact.structure, gaits.members), dtype)
    rates = peak_rates(gaits, lengths).max(-1)
    assert np.median(np.maximum(rates, ramp_rates(gaits, lengths).max(-1))) == pytest.approx(1.0, rel=1e-4)
    assert rates.max() == pytest.approx(1.0, rel=1e-4)
    np.testing.assert_array_equal(ActuatorBounds(rate=certain.bounds.rate).excess(rates, None), 0)


def test_polishing_shapes_overtones_of_waves(exact):
    """Of the same gait, but for faint ones; amplitudes stay within the bound on the rate. Gaits that are no waves have
    none, and as many genes as before; those of a scene whose gait has overtones keep these."""
    config = SearchConfig(evaluation=EvaluationConfig(bounds=ActuatorBounds(rate=0.5)))
    polish = PolishConfig(overtones=2)
    problem = search_problem(exact, config)
    genes = np.random.default_rng(0).uniform(size=(16, problem.genome.size))
    genome, wider = genome_to_polish(problem, genes, polish)
    assert list(genome.blocks)[-4:] == ["sine 2", "cosine 2", "sine 3", "cosine 3"]
    before, after = problem.genome.gaits(exact.gait, genes), genome.gaits(exact.gait, wider)
    np.testing.assert_allclose(after.phase, before.phase)
    assert max(np.abs(each.size).max() for each in after.overtones) < 2e-3
    rates = np.asarray(peak_rates(after, actuated_lengths(exact.structure, exact.gait.members)))
    assert rates.max() <= 0.5
    shaped = with_gait(exact, load_gait("brisk"))
    assert genome_to_polish(search_problem(shaped, config), genes, polish)[0].overtones == 0
    free = search_problem(exact, SearchConfig(space=SearchSpace(waves="none")))
    assert genome_to_polish(free, np.zeros((1, 13)), polish)[0].overtones == 0


def test_a_wide_search_draws_many_and_goes_on_with_the_best_eighth():
    """On the scene's own model with fewer. All cross parents over; those of a search that is not wide are drawn by
    tournaments."""
    screening, own = ga_configs(SearchConfig(population=64), 2)
    assert (screening.population, screening.drawn, screening.parents, screening.crossover) == (64, 256, 8, 1.0)
    assert (own.population, own.drawn, own.parents) == (8, None, 1)
    narrow, _ = ga_configs(SearchConfig(population=64, wide=False), 2)
    assert (narrow.drawn, narrow.parents, narrow.crossover) == (None, None, 1.0)


def test_a_search_polishes_as_polish_does_by_default():
    assert SearchConfig().polish == PolishConfig()


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (
            SearchConfig(space=SearchSpace(frequency=(0.0, 1.0))),
            r"frequency = \(0.0, 1.0\): expected bounds above 0 Hz",
        ),
        (SearchConfig(space=SearchSpace(frequency=None)), "expected one that all actuators share"),
        (SearchConfig(duration=0.5), r"duration = 0.5 s: the gait begins at 1 s; expected a longer time"),
        (
            SearchConfig(
                space=SearchSpace(amplitude=(0.05, 0.9), frequency=(0.3, 1.0)),
                evaluation=EvaluationConfig(uncertainty=Uncertainty(actuation=0.2)),
            ),
            r"amplitude = 0\.9: with uncertainty\.actuation = 0\.2 robots reach 1\.08; expected less than 1",
        ),
        (SearchConfig(polish=PolishConfig(gaits=0)), "polish: gaits = 0; expected 1 to 16"),
        (
            SearchConfig(polish=PolishConfig(kind="pathwise")),
            "polishing by 'pathwise': caution = 1, bounds.power = 200, objective = SteadySpeed; expected "
            r"caution = 0, bounds.power = None \(--objective.largest-power None\), "
            "objective = distance, direction or speed, or another gradient",
        ),
    ],
)
def test_what_cannot_be_searched_is_refused(exact, config, message):
    """Before anything compiles."""
    mixed = with_gait(exact, dataclasses.replace(exact.gait, frequency=np.linspace(0.4, 0.6, 6)))
    with pytest.raises(InputError, match=message):
        search_problem(mixed, config)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (
            {"objective": "steady speed"},
            "EvaluationConfig: objective is 'steady speed'; expected an Objective; jaxgrity.SteadySpeed",
        ),
        ({"bounds": 100.0}, r"bounds is 100.0; expected an ActuatorBounds; pass jaxgrity.ActuatorBounds\("),
        ({"objective": SteadySpeed}, "objective is the class SteadySpeed itself; expected an Objective"),
        ({"uncertainty": 0.1}, "uncertainty is 0.1; expected an Uncertainty"),
        ({"polish": "orbit"}, "polish is 'orbit'; expected a PolishConfig or None"),
        ({"waves": "all"}, "waves = 'all': unknown; expected one of every, axis, none"),
        ({"members": "cable"}, "members = 'cable': unknown; perhaps you meant cables; expected one of scene, struts"),
        ({"wide": "no"}, "wide is 'no'; expected True or False"),
        ({"generations": 3}, r"generations = 3: expected two whole numbers, such as \(10, 2\)"),
        ({"generations": (3, -1)}, r"generations = \(3, -1\): expected two whole numbers"),
        ({"amplitude": 0.3}, "amplitude = 0.3: expected two ascending bounds from 0 on, below 1"),
        ({"frequency": ("0.3", "1")}, r"frequency = \('0.3', '1'\): expected two ascending bounds"),
    ],
)
def test_a_setting_of_another_kind_is_refused(wrong, message):
    """Where it is made; a member of another name would stand for cables, and another symmetry for every wave."""
    jaxtyping.config.update("jaxtyping_disable", True)  # which users do not have; of this test alone
    groups = (SearchSpace, EvaluationConfig, SearchConfig)
    kind = next(each for each in groups if wrong.keys() <= {part.name for part in dataclasses.fields(each)})
    with pytest.raises(InputError, match=message):
        kind(**wrong)


def test_a_distance_needs_no_common_period(exact):
    """Orbits do; a scene without a gait has nothing to evolve."""
    mixed = with_gait(exact, dataclasses.replace(exact.gait, frequency=np.linspace(0.4, 0.6, 6)))
    search_problem(mixed, SearchConfig(space=SearchSpace(frequency=None), evaluation=EvaluationConfig(Distance())))
    with pytest.raises(InputError, match=r"the scene has no \[gait\]"):
        search_problem(with_gait(load_scene("exact"), None), SearchConfig())


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: SearchSpace(waves="axes"),
            "waves = 'axes': unknown; perhaps you meant axis; expected one of every, axis",
        ),
        (lambda: SearchSpace(waves=None), "waves = None: unknown; perhaps you meant none"),
        (lambda: SearchSpace(members="bars"), "members = 'bars': unknown; expected one of scene, struts, cables"),
        (lambda: SearchSpace(active=3, waves="axis"), "active = 3, waves = 'axis': all members of a wave"),
        (lambda: SearchSpace(amplitude=(0.5, 0.1)), r"amplitude = \(0\.5, 0\.1\): expected two ascending bounds"),
        (lambda: EvaluationConfig(robots=1), r"caution = 1\.0: one robot has no spread; expected robots = 2 or more"),
        (lambda: EvaluationConfig("speed"), "objective is 'speed'; expected an Objective"),
        (
            lambda: SearchConfig(space={"ramp": 1.0}),
            r"space is {'ramp': 1\.0}; expected a SearchSpace; pass SearchSpace\(",
        ),
        (
            lambda: SearchConfig(64, waves="none", robots=2, ramp=1.0),
            r"^waves, ramp, robots: expected in a group now, SearchConfig\(space=jaxgrity\.search\.SearchSpace\("
            r"waves=\.\.\., ramp=\.\.\.\), evaluation=jaxgrity\.search\.EvaluationConfig\(robots=\.\.\.\)\)$",
        ),
        (
            lambda: SearchConfig(robots=2),
            r"SearchConfig\(evaluation=jaxgrity\.search\.EvaluationConfig\(robots=\.\.\.\)\)$",
        ),
    ],
)
def test_a_group_refuses_what_it_cannot_hold(make, message):
    """By itself, without a scene; names from before there were groups are refused with the group that has them now."""
    jaxtyping.config.update("jaxtyping_disable", True)  # of this test alone: conftest.py sets it anew for each
    with pytest.raises(InputError, match=message):
        make()


def test_settings_are_flat_in_files():
    """Under the names of the command's options, as in folders of searches that began before there were groups."""
    space = SearchSpace(waves="none")
    found = plain_config(SearchConfig(population=16, space=space, evaluation=EvaluationConfig(Distance()), polish=None))
    assert {"population": 16, "waves": "none", "robots": 4, "polish": None}.items() <= found.items()
    assert found["objective"] == {"kind": "Distance"}
    assert not {"space", "evaluation"} & found.keys()
    options = {field.name for field in dataclasses.fields(SearchSettings)}
    assert found.keys() - {"bounds", "from_gait"} <= options  # the command has `--gait` for the latter


def test_a_search_may_begin_with_the_gait_of_its_scene(exact):
    """Its genes are found, or what is not possible is refused; later mutations are smaller."""
    scene = with_gait(exact, load_gait("straight"))
    config = SearchConfig(from_gait=True, space=SearchSpace(ramp=None))
    genome = search_problem(scene, config).genome
    gaits = genome.gaits(scene.gait, genome.genes_of(scene.gait)[None])
    np.testing.assert_allclose(gaits.amplitude[0], scene.gait.amplitude, rtol=1e-9)
    near, wide = (ga_configs(each, 2)[0] for each in (config, SearchConfig()))
    assert near.mutation_size[0] < wide.mutation_size[0]
    for message, where, space in (
        ("members = 'cables'", scene, SearchSpace("cables", waves="none")),
        ("amplitude = .* of the gait", scene, SearchSpace(amplitude=(0.05, 0.2))),
        ("no wave of this robot", exact, SearchSpace()),
    ):
        with pytest.raises(InputError, match=message):
            search_problem(where, SearchConfig(from_gait=True, space=space))
