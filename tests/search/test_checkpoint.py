"""A search's folder: states that come back to the last bit, one process at a time, nothing lost unasked."""

from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgrity import GAConfig, Genome, InputError
from jaxgrity.io.files import save_arrays
from jaxgrity.model.height_fields import HeightFunction
from jaxgrity.search import load_states, open_checkpoint
from jaxgrity.search.checkpoint import fingerprint, holds_unfinished, left_over, saved_arrays
from jaxgrity.search.climb import ClimbStep
from jaxgrity.search.genetic_algorithm import EvolutionState, Generation, Record, begin
from jaxgrity.search.judging import Scores
from jaxgrity.search.kept_stages import (
    KEPT_VERSION,
    check_kept_stages,
    load_polished,
    load_promoted,
    save_polished,
    save_promoted,
)
from jaxgrity.search.polish import Polished
from jaxgrity.search.promotion import Agreement, Promoted
from jaxgrity.trust.sensitivity import Sensitivity

SETTINGS = {"scene": Path("robot.toml"), "bounds": (0.1, 0.3), "seed": 3, "dt": None}
GENOME, CONFIG = Genome(3), GAConfig(population=4, elites=1)


def state(seed: int, dtype: str = "float32", generations: int = 2) -> EvolutionState:
    """Of a search after so many generations, with numbers at random."""
    first = begin(GENOME, CONFIG, seed, dtype)
    random = np.random.default_rng(seed)
    record = Record(*random.normal(size=(4, generations)))
    record.best[0] = -np.inf
    fitness = jnp.asarray([*random.normal(size=3), -np.inf], dtype)
    genes = jnp.asarray(random.uniform(size=(4, 3)), dtype)
    evaluated = Generation(genes, fitness, jnp.asarray(random.uniform(size=4), dtype), jnp.asarray(1))
    return first._replace(number=generations, record=record, evaluated=evaluated)


def assert_same(mine, its):
    """The same arrays to the last bit, of the same types."""
    assert jax.tree.structure(mine) == jax.tree.structure(its)
    for a, b in zip(jax.tree.leaves(mine), jax.tree.leaves(its)):
        assert np.asarray(a).dtype == np.asarray(b).dtype
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_states_come_back_to_the_last_bit(tmp_path, dtype):
    """Of every search in its place; the newest of each, and one that has evaluated nothing yet."""
    first, second = state(0, dtype), begin(GENOME, CONFIG, 1, dtype)
    with open_checkpoint(tmp_path / "run", SETTINGS) as checkpoint:
        assert checkpoint.states == ()
        checkpoint.save(0, state(5, dtype, generations=1))
        checkpoint.save(0, first)
        checkpoint.save(1, second)
    found = load_states(tmp_path / "run")
    assert len(found) == 2
    assert_same(found[0], first)
    assert_same(found[1], second)
    assert found[1].evaluated is None
    with open_checkpoint(tmp_path / "run", SETTINGS, resume=True) as checkpoint:
        assert_same(checkpoint.states, (first, second))


def test_a_key_that_comes_back_draws_the_same_numbers(tmp_path):
    """So that a search goes on as if it had never stopped."""
    with open_checkpoint(tmp_path, SETTINGS) as checkpoint:
        checkpoint.save(0, state(2))
    (found,) = load_states(tmp_path)
    draws = [jax.random.uniform(jax.random.wrap_key_data(jnp.asarray(s.key)), (3,)) for s in (found, state(2))]
    np.testing.assert_array_equal(*draws)


def test_one_run_holds_its_folder(tmp_path):
    """A second is refused while the first is open, whatever it asks for, and takes nothing away; then it may begin."""
    with open_checkpoint(tmp_path, SETTINGS) as checkpoint:
        checkpoint.save(0, state(0))
        for options in ({}, {"resume": True}, {"restart": True}):
            with (
                pytest.raises(InputError, match="another run is writing there; expected another folder"),
                open_checkpoint(tmp_path, SETTINGS, **options),
            ):
                pass
        assert_same(load_states(tmp_path), (state(0),))
    with open_checkpoint(tmp_path, SETTINGS, resume=True) as checkpoint:
        assert len(checkpoint.states) == 1


def test_an_unfinished_run_is_not_overwritten(tmp_path):
    """Only where that is asked for; a run that is done, or that saved nothing, gives way."""
    with open_checkpoint(tmp_path, SETTINGS):
        pass
    with open_checkpoint(tmp_path, SETTINGS) as checkpoint:
        checkpoint.save(0, state(0))
        checkpoint.save(1, state(1))
    with (
        pytest.raises(InputError, match="holds an unfinished run; expected resume, restart or another folder"),
        open_checkpoint(tmp_path, SETTINGS),
    ):
        pass
    assert len(load_states(tmp_path)) == 2
    with open_checkpoint(tmp_path, {**SETTINGS, "seed": 4}, restart=True) as checkpoint:
        assert checkpoint.states == load_states(tmp_path) == ()
        checkpoint.save(0, state(0))
        checkpoint.done()
    with open_checkpoint(tmp_path, SETTINGS) as checkpoint:
        assert checkpoint.states == load_states(tmp_path) == ()


def test_what_a_new_run_replaces_is_known_before(tmp_path):
    """States of a run that broke off, and a last population alone, not only what a whole search leaves."""
    assert left_over(tmp_path) == []
    assert not holds_unfinished(tmp_path)
    (tmp_path / "population.npz").write_bytes(b"")
    (tmp_path / "notes.txt").write_text("mine")
    assert [path.name for path in left_over(tmp_path)] == ["population.npz"]
    with open_checkpoint(tmp_path, SETTINGS) as checkpoint:
        assert [path.name for path in left_over(tmp_path)] == ["run.json"]
        assert not holds_unfinished(tmp_path)
        checkpoint.save(0, state(0))
        assert holds_unfinished(tmp_path)
        checkpoint.done()
    assert sorted(path.name for path in left_over(tmp_path)) == ["run.json", "state_0.npz"]
    assert not holds_unfinished(tmp_path)
    assert (tmp_path / "notes.txt").exists()


def test_a_run_that_breaks_off_can_be_resumed(tmp_path):
    """What it saved is kept, and the folder is free again."""

    def broken():
        with open_checkpoint(tmp_path, SETTINGS) as checkpoint:
            checkpoint.save(0, state(0))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        broken()
    with open_checkpoint(tmp_path, SETTINGS, resume=True) as checkpoint:
        assert_same(checkpoint.states, (state(0),))


def test_a_finished_run_can_be_looked_at_again(tmp_path):
    """Resuming it gives the states with which it ended."""
    with open_checkpoint(tmp_path, SETTINGS) as checkpoint:
        checkpoint.save(0, state(0))
        checkpoint.done()
    with open_checkpoint(tmp_path, SETTINGS, resume=True) as checkpoint:
        assert_same(checkpoint.states, (state(0),))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seed": 4}, "its run has seed = 3, not 4; expected the same to resume it"),
        ({"bounds": (0.1, 0.4)}, r"its run has bounds = \[0\.1, 0\.3\], not \[0\.1, 0\.4\]"),
        ({"scene": Path("other.toml")}, r"its run has scene = robot\.toml, not other\.toml"),
        ({"dt": 1e-3}, "its run has dt = None, not 0.001"),
        ({"seed": 4, "dt": 1e-3}, "seed = 3, not 4, dt = None, not 0.001; expected the same to resume it"),
        ({"more": 1}, "its run has more = None, not 1"),
    ],
)
def test_other_settings_do_not_resume_a_run(tmp_path, change, message):
    """They would lead to another end; what is there stays."""
    with open_checkpoint(tmp_path, SETTINGS) as checkpoint:
        checkpoint.save(0, state(0))
    with pytest.raises(InputError, match=message), open_checkpoint(tmp_path, SETTINGS | change, resume=True):
        pass
    assert_same(load_states(tmp_path), (state(0),))


def test_there_has_to_be_a_run_to_resume(tmp_path):
    """A folder that is empty, or not there."""
    for folder in (tmp_path, tmp_path / "new"):
        with (
            pytest.raises(InputError, match="has no run; expected one to resume"),
            open_checkpoint(folder, {}, resume=True),
        ):
            pass


@pytest.mark.parametrize("content", [b"", bytes(range(256))], ids=["empty", "no arrays"])
def test_a_damaged_state_is_refused(tmp_path, content):
    """By its name; to begin anew is still possible."""
    with open_checkpoint(tmp_path, SETTINGS):
        (tmp_path / "state_0.npz").write_bytes(content)
    for options in ({}, {"resume": True}):
        with (
            pytest.raises(InputError, match=r"state_0\.npz: damaged: .*; expected a run of this version, or restart$"),
            open_checkpoint(tmp_path, SETTINGS, **options),
        ):
            pass
    with open_checkpoint(tmp_path, SETTINGS, restart=True) as checkpoint:
        assert checkpoint.states == ()


def test_a_state_whose_numbers_are_overwritten_is_refused(tmp_path):
    """Not only a file that ends too soon: what was compressed cannot be read any more."""
    path = tmp_path / "state_0.npz"
    with open_checkpoint(tmp_path, SETTINGS):
        save_arrays(path, genes=np.random.default_rng(0).random((128, 6)))
        whole = path.read_bytes()
        first = whole.index(b"genes.npy") + len("genes.npy") + 20  # beyond the header of a large file
        path.write_bytes(whole[:first] + b"\xff" * 8 + whole[first + 8 :])
    with (
        pytest.raises(
            InputError, match=r"state_0\.npz: damaged: Error -3 .*; expected a run of this version, or restart$"
        ),
        open_checkpoint(tmp_path, SETTINGS, resume=True),
    ):
        pass


@pytest.mark.parametrize(
    ("content", "fault"),
    [("", "not JSON: Expecting value"), ("[]", "holds no JSON object"), ('{"done": false}', "has no settings")],
)
def test_settings_that_are_damaged_are_refused(tmp_path, content, fault):
    """By their name, also where only it is asked what there is; to begin anew is still possible."""
    (tmp_path / "run.json").write_text(content)
    message = rf"run\.json: {fault}.*; expected a run of this version, or restart$"
    for options in ({}, {"resume": True}):
        with pytest.raises(InputError, match=message), open_checkpoint(tmp_path, SETTINGS, **options):
            pass
    with pytest.raises(InputError, match=message):
        holds_unfinished(tmp_path)
    with open_checkpoint(tmp_path, SETTINGS, restart=True) as checkpoint:
        assert checkpoint.states == ()
    assert not holds_unfinished(tmp_path)


def test_files_that_were_never_finished_are_removed(tmp_path):
    """Those that a killed process left, and no others."""
    left, kept = tmp_path / ".state_0.npz.abc.part", tmp_path / "gait.part"
    left.write_text("half")
    kept.write_text("whole")
    with open_checkpoint(tmp_path, SETTINGS):
        assert not left.exists()
    assert kept.read_text() == "whole"


@pytest.mark.parametrize("deeper", [(), ("deeper",)], ids=["itself", "above"])
def test_a_folder_that_cannot_be_made_is_refused(tmp_path, deeper):
    """A file is in its place, or in that of a folder above: one line, with the path and the system's reason."""
    (tmp_path / "file").write_text("in the way")
    folder = (tmp_path / "file").joinpath(*deeper)
    with (
        pytest.raises(InputError, match="expected a folder that can be written to") as caught,
        open_checkpoint(folder, {}),
    ):
        pass
    message = str(caught.value)
    assert message.startswith(f"{folder}: ")
    assert message.isprintable()
    assert (tmp_path / "file").read_text() == "in the way"


HILL = """
def hills(height, power=2):
    def hill(x, y):
        return height * jnp.sin(x) ** power + (lambda z: 0.01 * z)(y)
    return hill
hill = hills(0.05)
"""


def test_a_scene_with_a_function_is_known_again(exact):
    """Made anew, as in another process, where it has another address; with another number it is another scene."""

    def told(text):
        made = {"jnp": jnp, "__name__": "hills"}
        exec(text, made)
        ground = HeightFunction(made["hill"])
        return fingerprint(eqx.tree_at(lambda s: s.ground.surface, exact, ground, is_leaf=lambda x: x is None))

    changes = (("hills(0.05)", "hills(0.06)"), ("power=2", "power=3"), ("0.01 *", "0.02 *"), ("sin", "cos"))
    others = {told(HILL.replace(*change)) for change in changes}
    assert told(HILL) == told(HILL)
    assert len(others | {told(HILL), fingerprint(exact)}) == len(changes) + 2


def scores(random: np.random.Generator, gaits: int) -> Scores:
    """At random; one gait failed."""
    return Scores(*random.normal(size=(3, gaits)), np.arange(gaits) == 1, *random.normal(size=(2, gaits, 6)))


def promoted_gaits(multipliers: np.ndarray | None) -> Promoted:
    random = np.random.default_rng(0)
    ranks = np.array([[1.0, np.nan], [np.nan, 1.0]])
    agreement = Agreement((), random.normal(size=(2, 5)), 3, ranks, ranks)
    return Promoted(random.uniform(size=(1, 3)), scores(random, 4), multipliers, agreement)


def polished_gait(sensitivity: Sensitivity | None, steps: tuple[ClimbStep, ...]) -> Polished:
    random = np.random.default_rng(1)
    each = scores(random, 1), scores(random, 1)
    genes = random.uniform(size=3).astype(np.float32)
    return Polished(genes, GENOME, True, *each, steps, 0.1 + 0.2, sensitivity, 128, "fitness up by 1/3 \u00b1 0.1")


@pytest.mark.parametrize("multipliers", [None, np.array([0.3, np.inf])])
def test_promoted_gaits_come_back_to_the_last_bit(tmp_path, multipliers):
    assert load_promoted(tmp_path, ()) is None
    save_promoted(tmp_path, promoted_gaits(multipliers))
    found = load_promoted(tmp_path, ())
    assert type(found.agreement.evolved) is int
    assert_same(found, promoted_gaits(multipliers))


@pytest.mark.parametrize("steps", [(), (ClimbStep(0.1, 1 / 3, 1.0, -2.0), ClimbStep(0.2, 1e-30, 0.0, np.inf))])
@pytest.mark.parametrize("growth", [None, Sensitivity(np.arange(3) / 10, np.array([0, 1 / 3, np.inf]), "m/(m/s)")])
def test_a_polished_gait_comes_back_to_the_last_bit(tmp_path, growth, steps):
    assert load_polished(tmp_path, GENOME) is None
    mine = polished_gait(growth, steps)
    save_polished(tmp_path, mine)
    found = load_polished(tmp_path, GENOME)
    assert found.genome is GENOME
    words = [(each.reason, each.sensitivity and each.sensitivity.unit) for each in (found, mine)]
    assert words[0] == words[1]
    plain = [
        each._replace(genome=None, reason="", sensitivity=each.sensitivity and each.sensitivity[:2])._asdict()
        for each in (found, mine)
    ]
    for each in plain:
        del each["reason"]
    assert_same(*plain)


@pytest.mark.parametrize(
    ("load", "name", "rest"), [(load_promoted, "promoted.npz", ()), (load_polished, "polished.npz", GENOME)]
)
def test_damaged_results_of_a_stage_are_refused(tmp_path, load, name, rest):
    """In one line that says which file, and what to do."""
    (tmp_path / name).write_bytes(b"PK\x03\x04 half of a file")
    with pytest.raises(InputError, match=rf"{name}: damaged: .*; expected a run of this version, or restart$"):
        load(tmp_path, rest)
    save_arrays(tmp_path / name, genes=np.zeros(3), version=KEPT_VERSION)
    with pytest.raises(InputError, match=rf"{name}: is not complete: .*; expected a run of this version, or restart$"):
        load(tmp_path, rest)


@pytest.mark.parametrize(
    ("name", "version", "said"),
    [
        ("promoted.npz", None, "no version"),
        ("polished.npz", None, "no version"),
        ("polished.npz", KEPT_VERSION + 1, f"version {KEPT_VERSION + 1}, not {KEPT_VERSION}"),
    ],
)
def test_results_that_another_release_kept_are_refused(tmp_path, name, version, said):
    """Though all that is read of them is there."""
    save_promoted(tmp_path, promoted_gaits(None))
    save_polished(tmp_path, polished_gait(None, ()))
    check_kept_stages(tmp_path)
    kept = saved_arrays(tmp_path / name)
    del kept["version"]
    save_arrays(tmp_path / name, **kept, **({} if version is None else {"version": version}))
    with pytest.raises(
        InputError, match=rf"{name}: kept by another release, with {said}; expected a run of this version, or restart$"
    ):
        check_kept_stages(tmp_path)


def test_what_stages_keep_changes_with_its_version():
    """Whoever changes a field counts `KEPT_VERSION` up, and tells this test."""
    kinds = (Promoted, Agreement, Scores, Polished, ClimbStep, Sensitivity)
    assert KEPT_VERSION == 2
    assert {kind.__name__: " ".join(kind._fields) for kind in kinds} == {
        "Promoted": "genes finals multipliers agreement",
        "Agreement": "levels fitness evolved rank_correlation rank_correlation_of_the_evolved",
        "Scores": "fitness mean spread failed each excess",
        "Polished": "genes genome improved before after steps horizon sensitivity rollouts reason",
        "ClimbStep": "horizon gradient_norm pathwise_share fitness",
        "Sensitivity": "times norm unit spread",
    }
