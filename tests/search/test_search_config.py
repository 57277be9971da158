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
from jaxgrity.model.actuation import actuated_lengths, peak_rates, ramp_rates
from jaxgrity.populations.uncertainty import ensemble
from jaxgrity.search import ga_configs, genome_to_polish, search_problem
from jaxgrity.search.judging import masses_and_lengths
from jaxgrity.search.search_config import with_actuated


def test_by_default_gaits_are_waves_and_look_for_steady_speed(exact):
    """With one phase and one amplitude for all struts; free gaits have those of every strut."""
    problem = search_problem(exact, SearchConfig())
    assert isinstance(problem.fitness.objective, SteadySpeed)
    assert problem.genome.blocks == {"phase": 1, "wave": 1, "amplitude": 1, "frequency": 1}
    free = search_problem(exact, SearchConfig(waves="none"))
    assert free.genome.blocks == {"phase": 6, "amplitude": 6, "frequency": 1}


def test_a_turn_is_not_its_mirror_image():
    """Where the robot stands so that a mirror leaves it as it is, gaits that turn have half of the images."""
    scene = parse_scene(scene_text("exact").replace('pose = "face"', 'pose = "strut"'))
    images = {
        kind: search_problem(scene, SearchConfig(objective=kind(), waves="none")).genome.images
        for kind in (SteadySpeed, SteadyTurn)
    }
    assert len(images[SteadySpeed]) == 2 * len(images[SteadyTurn]) > 2


def test_scaled_gaits_stay_within_the_bound_on_the_rate(exact):
    """From the first moment on, with strokes that are off by as much as they may be, too. Without a bound, none is."""
    config = SearchConfig(waves="none", frequency=(0.3, 3.0))
    problem = search_problem(exact, config)
    gaits = problem.genome.gaits(exact.gait, np.random.default_rng(0).uniform(size=(64, problem.genome.size)))
    lengths, most = actuated_lengths(exact.structure, exact.gait.members), 1 / (1 + config.uncertainty.actuation)
    for rates in (peak_rates(gaits, lengths), ramp_rates(gaits, lengths)):
        assert float(rates.max()) == pytest.approx(config.bounds.rate * most)
    unbounded = search_problem(exact, SearchConfig(waves="none", frequency=(0.3, 3.0), bounds=ActuatorBounds()))
    assert unbounded.genome.quickest == ()


def test_scaled_gaits_of_cables_leave_room_for_less_prestress(exact):
    """Robots with longer cables keep the bound on the rate too, and some nearly reach it."""
    doubts = Uncertainty(prestress=0.3, actuation=0.02)
    config = SearchConfig(members="cables", waves="none", frequency=(0.5, 2.5), uncertainty=doubts)
    scene = with_actuated(exact, "cables")
    problem = search_problem(scene, config)
    gaits = problem.genome.gaits(scene.gait, np.random.default_rng(0).uniform(size=(32, problem.genome.size)))
    robots, differences = ensemble(jax.random.key(0), scene, gaits, doubts, 16)
    lengths = masses_and_lengths(scene, robots, differences)[1]
    for rates in (peak_rates(robots, lengths), ramp_rates(robots, lengths)):
        assert 0.95 < float(rates.max()) <= config.bounds.rate


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_scaled_gaits_do_not_exceed_the_bound_by_rounding(exact, dtype):
    """With certain amplitudes they are at the bound, and would rank after all gaits within it."""
    config = SearchConfig(waves="none", frequency=(0.3, 3.0), uncertainty=Uncertainty(), caution=0.0)
    problem = search_problem(exact, config)
    genes = np.random.default_rng(0).uniform(size=(256, problem.genome.size)).astype(dtype)
    gaits = jax.tree.map(lambda x: np.asarray(x, dtype), problem.genome.gaits(exact.gait, genes))
    lengths = np.asarray(actuated_lengths(exact.structure, gaits.members), dtype)
    rates = peak_rates(gaits, lengths).max(-1)
    assert np.median(np.maximum(rates, ramp_rates(gaits, lengths).max(-1))) == pytest.approx(1.0, rel=1e-4)
    assert rates.max() == pytest.approx(1.0, rel=1e-4)
    np.testing.assert_array_equal(ActuatorBounds(rate=config.bounds.rate).excess(rates, None), 0)


def test_polishing_shapes_overtones_of_waves(exact):
    """Of the same gait, but for faint ones; amplitudes stay within the bound on the rate. Gaits that are no waves have
    none, and as many genes as before; those of a scene whose gait has overtones keep these."""
    config = SearchConfig(bounds=ActuatorBounds(rate=0.5), polish=PolishConfig(overtones=2))
    problem = search_problem(exact, config)
    genes = np.random.default_rng(0).uniform(size=(16, problem.genome.size))
    genome, wider = genome_to_polish(problem, genes, config)
    assert list(genome.blocks)[-4:] == ["sine 2", "cosine 2", "sine 3", "cosine 3"]
    before, after = problem.genome.gaits(exact.gait, genes), genome.gaits(exact.gait, wider)
    np.testing.assert_allclose(after.phase, before.phase)
    assert max(np.abs(each.size).max() for each in after.overtones) < 2e-3
    rates = np.asarray(peak_rates(after, actuated_lengths(exact.structure, exact.gait.members)))
    assert rates.max() <= 0.5
    shaped = with_gait(exact, load_gait("brisk"))
    assert genome_to_polish(search_problem(shaped, config), genes, config)[0].overtones == 0
    free = SearchConfig(waves="none", polish=PolishConfig(overtones=2))
    assert genome_to_polish(search_problem(exact, free), np.zeros((1, 13)), free)[0].overtones == 0


def test_a_wide_search_draws_many_and_goes_on_with_the_best_eighth():
    """On the scene's own model with fewer. All cross parents over; those of a search that is not wide are drawn by
    tournaments."""
    screening, own = ga_configs(SearchConfig(population=64), 2)
    assert (screening.population, screening.drawn, screening.parents, screening.crossover) == (64, 256, 8, 1.0)
    assert (own.population, own.drawn, own.parents) == (8, None, 1)
    narrow, _ = ga_configs(SearchConfig(population=64, wide=False), 2)
    assert (narrow.drawn, narrow.parents, narrow.crossover) == (None, None, 1.0)


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (SearchConfig(frequency=(0.0, 1.0)), r"frequency = \(0.0, 1.0\): expected bounds above 0 Hz"),
        (SearchConfig(frequency=None), "expected one that all actuators share"),
        (SearchConfig(duration=0.5), r"duration = 0.5 s: the gait begins at 1 s; expected a longer time"),
        (
            SearchConfig(active=3, waves="axis", frequency=(0.3, 1.0)),
            "active = 3, waves = 'axis': all members of a wave",
        ),
        (
            SearchConfig(amplitude=(0.05, 0.9), frequency=(0.3, 1.0), uncertainty=Uncertainty(actuation=0.2)),
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
        ({"objective": "steady speed"}, "SearchConfig: objective is 'steady speed'; expected an Objective"),
        ({"objective": SteadySpeed}, "objective is the class SteadySpeed itself; expected an Objective"),
        ({"uncertainty": 0.1}, "uncertainty is 0.1; expected a Uncertainty"),
        ({"polish": "orbit"}, "polish is 'orbit'; expected a PolishConfig or None"),
        ({"waves": "all"}, "waves = 'all': unknown; expected one of every, axis, none"),
        ({"members": "cable"}, "members = 'cable': unknown; perhaps you meant cables; expected one of scene, struts"),
        ({"wide": "no"}, "wide is 'no'; expected True or False"),
        ({"generations": 3}, r"generations = 3: expected two whole numbers, such as \(10, 2\)"),
        ({"generations": (3, -1)}, r"generations = \(3, -1\): expected two whole numbers"),
        ({"amplitude": 0.3}, r"amplitude = 0.3: expected two bounds, such as \(0.1, 0.5\), or None"),
        ({"frequency": ("0.3", "1")}, r"frequency = \('0.3', '1'\): expected two bounds"),
    ],
)
def test_a_setting_of_another_kind_is_refused(wrong, message):
    """Where it is made; a member of another name would stand for cables, and another symmetry for every wave."""
    jaxtyping.config.update("jaxtyping_disable", True)  # which users do not have; of this test alone
    with pytest.raises(InputError, match=message):
        SearchConfig(**wrong)


def test_a_distance_needs_no_common_period(exact):
    """Orbits do; a scene without a gait has nothing to evolve."""
    mixed = with_gait(exact, dataclasses.replace(exact.gait, frequency=np.linspace(0.4, 0.6, 6)))
    search_problem(mixed, SearchConfig(objective=Distance(), frequency=None))
    with pytest.raises(InputError, match=r"the scene has no \[gait\]"):
        search_problem(with_gait(load_scene("exact"), None), SearchConfig())
