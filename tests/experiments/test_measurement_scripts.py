"""The measuring scripts as a user runs them, at their quick sizes; and one clear line with exit code 2 on bad input.

All scripts run alike, so the cheapest shows how, and the others are campaigns.
"""

import ast
import dataclasses
import importlib
import importlib.util
import itertools
import json
import os
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import run as launcher
import tyro
from measurements import registry, scaling
from studies import library_gaits, short_rollouts, stability

import jaxgrity
from jaxgrity import InputError
from jaxgrity.cli.search import SearchSettings
from jaxgrity.control.motor_limits import contraction_reached

EXPERIMENTS = Path(__file__).parents[2] / "experiments"


def command(script: str) -> Any:
    """What a script runs, with a function `main` and a class `Settings`."""
    return importlib.import_module(script) if script == "paper" else registry.loaded(script)


def run(script: str, *arguments: object, **environment: str) -> subprocess.CompletedProcess:
    command = [sys.executable, str(EXPERIMENTS / "run.py"), script, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, env=os.environ | environment)


def quick(script: str, out: Path, *arguments: object) -> dict:
    """What a measuring script's --quick size leaves: its JSON; its figures are there too."""
    done = run(script, "--quick", *arguments, "--out", out)
    assert done.returncode == 0, done.stderr[-2000:]
    (first, *_) = out.glob("*.json")
    assert all(path.stat().st_size > 5000 for path in out.glob("*.png"))
    assert list(out.glob("*.png")) or getattr(command(script), "draw", None) is None
    facts = json.loads(first.read_text())
    assert facts["command"].startswith("python")
    assert str(out) not in first.read_text()
    return facts


def words(name: str, record: dict) -> str:
    """What a page says of the part of a record that is kept for it."""
    found = registry.measurements()[name]
    return found.all_words(found.quoted(record))


@pytest.mark.parametrize("script", [*registry.scripts(), "paper"])
def test_help_comes_from_the_settings(script, capsys):
    """Every script explains itself, and every measurement has a --quick size."""
    with pytest.raises(SystemExit, match="0"):
        tyro.cli(command(script).Settings, args=["--help"])
    said = capsys.readouterr().out
    assert "--help" in said
    assert "--quick" in said or script not in registry.measurements()


@pytest.mark.parametrize("name", jaxgrity.gait_names())
def test_commands_of_the_library_are_commands(name):
    """The search that found a gait can be asked for again, and says of itself what its record says."""
    record = jaxgrity.gait_record(name)
    settings = tyro.cli(SearchSettings, args=library_gaits.options_of(record["command"]))
    assert settings.seed == record["settings"]["seed"]
    assert settings.population == record["settings"]["population"]
    assert settings.objective.kind == record["objective"]


PUBLIC = ("jaxgrity", *(f"jaxgrity.{room}" for room in jaxgrity.SUB_PACKAGES))
BEHIND_COMMANDS = "jaxgrity.explorer.session", "jaxgrity.orbits.motion_report"
"""Modules that commands stand on, which the matrix tries on every kind of scene."""
STEP_BY_STEP = ("jaxgrity.stepping.loop",)
"""The one stepping loop, for what looks at every step."""
INNER = {
    "short_rollouts": ("jaxgrity.control.learned", "jaxgrity.control.ppo"),
    **dict.fromkeys(("gradients", "random_structures", "stability"), STEP_BY_STEP),
}
"""Modules that one experiment needs: the study of another learner shares parts of ours, so that only the gradient
differs."""


@pytest.mark.parametrize("path", sorted(EXPERIMENTS.rglob("*.py")), ids=lambda path: path.stem)
def test_no_experiment_imports_what_is_not_public(path):
    """Names of `jaxgrity.__all__` or of a room's, or from modules that are public beside it: files, and commands."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            assert not any(name.name.startswith("jaxgrity.") for name in node.names), ast.unparse(node)
        elif isinstance(node, ast.ImportFrom) and node.module in PUBLIC:
            rooms = jaxgrity.SUB_PACKAGES if node.module == "jaxgrity" else ()
            known = {*import_module(node.module).__all__, *rooms}
            assert {name.name for name in node.names} <= known, ast.unparse(node)
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("jaxgrity."):
            own = BEHIND_COMMANDS if path.stem.startswith("matrix") else INNER.get(path.stem, ())
            allowed = node.module == "jaxgrity.io.files" or f"{node.module}.".startswith("jaxgrity.cli.")
            assert allowed or node.module in own, ast.unparse(node)


@pytest.mark.parametrize(
    ("script", "arguments", "words"),
    [
        ("damage", ["--gait", "missing"], ["gait = 'missing': unknown"]),
        ("sim_to_real", ["--gait", "missing"], ["gait = 'missing': unknown"]),
        ("design_study", ["--strut-force", "-1"], ["expected positive limits"]),
        ("hard_cases", ["--cases", "warp drive"], ["cases = 'warp drive': unknown", "drop from 10 m"]),
        ("hard_cases", ["--methods", "euler"], ["euler", "rk4, tsit5"]),
        ("learning", ["--cases", "speed 8 1 0", "walk 8 2 0"], ["cases = 'walk 8 2 0'", "'speed 128 300 0'"]),
        ("learning", ["--cases", "heading 2"], ["cases = 'heading 2'"]),
        ("short_horizon", ["--cases", "exact PPO 8 0", "exact SAC 8 0"], ["'exact SAC 8 0'", "method = 'SAC'"]),
        ("keep_gait", ["--run", "missing", "--name", "mine"], ["missing/gait.json"]),
        ("update_docs", ["--docs", "missing"], ["missing"]),
    ],
)
def test_bad_input_is_one_line(tmp_path, monkeypatch, script, arguments, words):
    """What, where, the value received, what was expected; nothing is written."""
    monkeypatch.chdir(tmp_path)
    asked = command(script)
    out = [] if script in ("keep_gait", "update_docs") else ["--out", "out"]
    with pytest.raises((InputError, OSError)) as refusal:
        asked.main(tyro.cli(asked.Settings, args=[*arguments, *out]))
    said = str(refusal.value)
    assert "\n" not in said
    assert all(word in said for word in words), said
    assert not list(tmp_path.iterdir())


def test_scripts_are_listed_and_misspelt_ones_refused(monkeypatch, capsys):
    """Each with what it says of itself; `make measure` runs measurements, and no study."""
    monkeypatch.setattr(sys, "argv", ["run.py"])
    launcher.main()
    said = capsys.readouterr().out
    assert all(re.search(rf"^{name} +[A-Z]", said, re.MULTILINE) for name in registry.scripts())
    monkeypatch.setattr(sys, "argv", ["run.py", "--measured"])
    launcher.main()
    measured = capsys.readouterr().out.splitlines()
    assert {"run.py basin", "run.py benchmark --mujoco"} < set(measured)
    assert "run.py hard_cases" not in measured
    assert measured[-1] == "run.py update_docs"
    monkeypatch.setattr(sys, "argv", ["run.py", "bassin"])
    with pytest.raises(SystemExit, match="2"):
        launcher.main()
    assert "perhaps you meant basin" in capsys.readouterr().err


@pytest.mark.slow
def test_a_refusal_ends_with_exit_code_2(tmp_path):
    """And its one line is all that is said."""
    done = run("benchmark", "--mjx", "--out", tmp_path / "out")
    assert done.returncode == 2
    (line,) = done.stderr.strip().splitlines()
    assert line.startswith("error: --mjx")
    assert not (tmp_path / "out").exists()


@pytest.mark.campaign
def test_error_bars_are_honest(tmp_path):
    """On both models, gaits that nothing was tuned on: nearly all covered, by bars of a few errors."""
    facts = quick("error_bars", tmp_path)
    assert [row["scene"] for row in facts["rows"]] == ["reference", "exact"]
    for row in facts["rows"]:
        assert row["covered"] >= 0.85
        assert 1 <= row["median_ratio"] <= 5
    assert "| exact | 2 | 5 |" in words("error_bars", facts)


@pytest.mark.campaign
def test_the_models_tend_to_each_other(tmp_path):
    """A drop: penalty contact to exact contact, spring struts to rigid ones where nothing slips, at first order."""
    facts = quick("equivalence", tmp_path)
    laws = {row["grows"]: row for row in facts["rows"]}
    assert laws["k_n"]["slope"] == pytest.approx(-1, abs=0.15)
    assert laws["K, no friction"]["slope"] == pytest.approx(-1, abs=0.15)
    assert laws["K"]["distance"][-1] > 5 * laws["K, no friction"]["distance"][-1]
    assert "| ground | 1e+04 to 1e+06 |" in words("equivalence", facts)


@pytest.mark.campaign
def test_implicit_methods_take_fewer_steps_on_stiff_scenes(tmp_path):
    """Than Tsit5, to the same tolerance: struts, ground and friction made stiff, alone and together."""
    facts = quick("stiff", tmp_path)
    by_method = {m: [r for r in facts["rows"] if r["method"] == m] for m in ("tsit5", "kvaerno3", "kvaerno5")}
    for explicit, third, fifth in zip(*by_method.values()):
        assert explicit["outcome"] == third["outcome"] == fifth["outcome"] == "succeeded"
        assert fifth["steps"] + fifth["rejected"] <= explicit["steps"] + explicit["rejected"], explicit["scene"]
        assert third["steps"] + third["rejected"] <= explicit["steps"] + explicit["rejected"], explicit["scene"]
    assert "| all three | 1e-04 | kvaerno5 |" in words("stiff", facts)


def compiles_c() -> bool:
    """Whether the benchmarks have C programs to compare with."""
    return importlib.import_module("measurements.limit").programs() is not None


@pytest.mark.campaign
def test_benchmark_measures(tmp_path):
    """Without MuJoCo it measures what is here, and C where there is a compiler; the NumPy loop agrees."""
    facts = quick("benchmark", tmp_path, "--gaits", 8, "--duration", 0.8)
    measured = {(p["engine"], p["dtype"]) for p in facts["points"]}
    methods = ("rk4", "complementarity", "complementarity2")
    own = {(engine, dtype) for engine in methods for dtype in ("float32", "float64")}
    assert own <= measured
    assert {engine for engine, _ in measured - own} == ({"limit", "exact"} if compiles_c() else set())
    assert facts["numpy_off"] < 1e-12
    assert "| gradient in 6 phases costs, rollouts |" in words("benchmark", facts)


@pytest.mark.campaign
def test_the_bench_prints_a_table(tmp_path):
    """One row for each method, precision and population, with what it would need to be compared."""
    facts = quick("bench", tmp_path, "--gaits", 2, 4, "--duration", 0.8)
    assert facts["processor"]
    rows = {(row["engine"], row["dtype"], row["gaits"]): row for row in facts["rows"]}
    for engine in ("rk4", "complementarity"):
        for dtype in ("float32", "float64"):
            for gaits in (2, 4):
                row = rows[engine, dtype, gaits]
                seconds = row["us_per_step_and_gait"] * 1e-6 * 10 / row["dt"]
                assert row["rollouts_of_10_s_per_second"] == pytest.approx(1 / seconds, rel=1e-9)
                assert (row["times_C"] is not None) == compiles_c()


def test_random_structures_among_the_hard_cases_are_the_first_small_ones():
    """Not picked by what becomes of them."""
    cases = importlib.import_module("studies.cases")
    small = (seed for seed in itertools.count() if len(cases.random_scene(seed).structure.struts.edges) <= 12)
    assert tuple(itertools.islice(small, 10)) == cases.RANDOM


@pytest.mark.campaign
def test_hard_cases_have_no_silently_wrong_number(tmp_path):
    """Three cases by three methods, in both precisions; one of them is refused with the reason."""
    facts = quick("hard_cases", tmp_path)
    assert facts["counts"]["WRONG"] == 0
    assert facts["counts"]["right"] >= 4
    below = facts["rows"][0]
    assert (below["case"], below["dtype"]) == ("start 5 cm below ground", "float64")
    assert below["complementarity"] == "refused"
    assert set(below["rk4"]) == {"error", "bar"}
    told = words("hard_cases", facts)
    assert told.count("| start 5 cm below ground |") == 2
    assert re.search(r"\| complementarity \| node 8 .* below the ground", told)


@pytest.mark.campaign
def test_work_precision_compares_methods(tmp_path):
    """Free flight, RK4 and complementarity: errors fall with the step, and both have a cost at 5 mm."""
    facts = quick("work_precision", tmp_path, "--gaits", 8, "--repeats", 1)
    errors = [row["error"] for row in facts["rows"] if row["method"] == "rk4"]
    assert all(fine < coarse for coarse, fine in itertools.pairwise(errors) if coarse > 1e-10)
    assert set(facts["cost_at_target"]) == {"rk4 float64", "complementarity float64"}
    assert "| all nodes, root mean square | 5 |" in words("work_precision", facts)


@pytest.mark.campaign
def test_gradients_agree(tmp_path):
    """Every mode gives the same gradient, and a checkpointed one keeps less."""
    facts = quick("gradients", tmp_path)
    assert len({row["mode"] for row in facts["rows"]}) == 5
    assert all(row["difference"] < 1e-8 for row in facts["rows"])
    kept = facts["memory"]
    assert kept["checkpointed reverse"][-1] < kept["plain reverse"][-1] / 10
    assert "| plain reverse |" in words("gradients", facts)


@pytest.mark.campaign
def test_scaling_measures(tmp_path):
    """Devices, gaits, struts and single rollouts have a cost, and pages can be written of it."""
    facts = quick("scaling", tmp_path)
    assert [row["devices"] for row in facts["devices"]][:1] == [1]
    assert all(row["per_gait_and_step"] > 0 for row in facts["population"] + facts["struts"])
    told = words("scaling", facts)
    assert told.count("| complementarity |") == 3
    assert "real time" in told
    facts["C"] = []  # where there is no C compiler
    facts["methods"] = scaling.quoted(facts)
    assert "hand-written C" not in words("scaling", facts)
    sizes = ((1, 16, 2e-5), (2, 16, 1e-5))
    rows = [dict(zip(("devices", "gaits", "per_gait_and_simulated_second"), size)) for size in sizes]
    facts["C"] = [{"method": "complementarity", **row} for row in rows]
    facts["methods"] = scaling.quoted(facts)
    assert "| hand-written C, as complementarity | 2.00 | 10 |" in words("scaling", facts)


@pytest.mark.slow
def test_the_largest_steps_of_known_scenes_have_a_reason():
    """Of every explicit method on the reference scene, and of complementarity stepping on the exact one."""
    limits = stability.known_limits()
    known = {(row["scene"], row["method"]): row for row in limits}
    assert set(known) == {("reference", name) for name in ("rk4", "tsit5", "dopri8")} | {
        ("exact", name) for name in ("complementarity", "complementarity2")
    }
    assert known["reference", "rk4"]["step"] == pytest.approx(1.36e-3, rel=0.01)
    assert known["reference", "rk4"]["set_by"].startswith("friction at node")
    assert known["exact", "complementarity"]["set_by"].startswith("cable")


@pytest.mark.campaign
def test_damage_is_survived(tmp_path):
    """The intact robot and two cases of damage, quick: every way to a gait has its speed on both contact models, and a
    row in the docs. A stuck strut is no matter to a gait of cables, so the library's recovers that case."""
    facts = quick("damage", tmp_path)
    assert set(facts["damaged"]) == {"cable 7", "strut 1"}
    for robot in (facts["intact"], *facts["damaged"].values()):
        assert set(robot) == {"as it was", "library", "wave", "free", "cables, new"}
        speeds = [one[model]["mean"] for one in robot.values() for model in ("own", "other")]
        assert all(0 < speed < 2 for speed in speeds)
        assert robot["library"]["own"]["mean"] > robot["as it was"]["own"]["mean"] - 0.05
    intact, stuck = facts["intact"]["library"], facts["damaged"]["strut 1"]["library"]
    assert intact["gait"] == stuck["gait"] == "cables"
    assert stuck["own"]["mean"] == pytest.approx(intact["own"]["mean"], abs=0.02)
    assert facts["recovered"]["strut"]["cases"] == facts["recovered"]["strut"]["best"]["any"] == 1
    page = words("damage", facts)
    assert "| strut | library: cables |" in page
    assert all(f"| {robot} | cables, new |" in page for robot in ("nothing", "cable", "strut"))


@pytest.mark.campaign
def test_seeds_of_the_default_search_are_told_apart(tmp_path):
    """A small search by one seed; once more, it is read from its folder."""
    facts = quick("search_seeds", tmp_path)
    (row,) = facts["rows"]
    told = words("search_seeds", facts)
    assert f"| 0 | {row['speed']:.3f} |" in told if row["speed"] else "| 0 | - |" in told
    assert quick("search_seeds", tmp_path)["rows"] == facts["rows"]


@pytest.mark.campaign
def test_nothing_is_lost_in_a_crash(tmp_path):
    """A search that is killed, and resumed, ends with the population of one that was not; no file is broken."""
    done = run("crash_recovery", "--quick", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    facts = json.loads((tmp_path / "crash_recovery.json").read_text())
    (row,) = facts["rows"]
    assert sum(row["generations_saved"]) > 0
    assert row["same_population"]
    assert not row["broken_files"]
    assert "| resumed, with the same final population | 1 |" in words("crash_recovery", facts)


@pytest.mark.campaign
def test_ranges_are_drawn_again(tmp_path):
    """Nine statistics of two gaits on exact contact, and the words that are made of them."""
    facts = quick("redraws", tmp_path / "redraws")
    assert len(facts["rows"]) == 9
    assert all(0 <= row["covered"] <= 1 for row in facts["rows"])
    assert "| mean speed of straight | 95 % |" in words("redraws", facts)


@pytest.mark.campaign
def test_the_lasting_gait_is_followed_from_drops_and_on_other_robots(tmp_path):
    """Quick sizes: shares and times of what was dropped, and scans that are told as ranges."""
    (row,) = quick("basin", tmp_path / "basin")["rows"]
    assert row["speed"] > 0.5
    assert 0 <= row["rolling_after_15_s"] <= 1
    assert row["median_seconds_until"] <= 20.0
    climbed = quick("climbing", tmp_path / "climbing")
    (steep,) = (row for row in climbed["rows"] if row["slope"] == 15)
    assert min(steep["own"]) > 0.3
    assert f"| 15° | {steep['own'][0]:.2f} | " in words("climbing", climbed)
    jumps = quick("jumps", tmp_path / "jumps")
    (jump,) = jumps["rows"]
    assert jump["robust"]["mean"] > 0.01
    assert f"| 2 | {jump['robust']['mean']:.3f} (" in words("jumps", jumps)
    scans = quick("ranges", tmp_path / "ranges")
    scanned = [[row["scan"][name] for name in ("slowest", "mean", "fastest")] for row in scans["rows"]]
    every = [one for three in scanned for one in zip(*three)]
    assert len(every) == 3 * len(scans["rows"])
    assert all(mean is None or slowest <= mean <= fastest for slowest, mean, fastest in every)


@pytest.mark.campaign
def test_gaits_of_a_front_are_judged_by_their_speed_and_power(tmp_path):
    """Quick size: the judged gaits lie on the front of their robot, and settle with at most the power of the start."""
    facts = quick("trade_off", tmp_path)
    assert list(facts["fronts"]) == ["standard", "softer"]
    for row in facts["rows"]:
        assert row["own"] > 0.1
        assert row["settled_power"] <= row["power"] * (1 + 1e-9)
    for front in facts["fronts"].values():
        assert front["power"] == sorted(front["power"])
        assert front["fitness"] == sorted(front["fitness"])
    assert "| standard |" in words("trade_off", facts)


@pytest.mark.campaign
def test_robots_are_driven_by_feedback_to_goals_and_in_environments(tmp_path):
    """Quick sizes: what the tables of docs/control.md are made of."""
    facts = quick("feedback", tmp_path / "feedback", "--contact", "exact")
    assert "| sensors 100 ms late |" in words("feedback", facts)
    facts = quick("steering", tmp_path / "steering")
    assert "| 0.1 | " in words("steering", facts)
    facts = quick("transitions", tmp_path / "transitions")
    assert "| left | " in words("transitions", facts)
    facts = quick("sampling_ways", tmp_path / "sampling_ways")
    assert "| two rounds, 3 bends | 0 of 1 |" in words("sampling_ways", facts)
    for ground in ("slope", "bumps"):
        name = f"goals_{ground}"
        facts = quick("goals", tmp_path / name, "--ground", ground)
        assert " of 1 trials" in words("goals", facts)
    facts = quick("environments", tmp_path / "environments")
    assert facts["rows"][0]["repeated"]
    assert "| heading | 800 | " in words("environments", facts)
    facts = quick("tune", tmp_path / "tune", "--what", "feedback")
    assert "| found by this run |" in words("tune", facts)
    judged = {row["name"]: row for row in facts["judged"]}
    for name in ("found by this run", "plain feedback"):
        assert judged[name]["numbers"][4:] == [0.0] * 4 + [1.0] * 2


def test_gaits_of_a_damaged_robot_are_measured_with_their_own_start_and_ramp(exact, monkeypatch):
    """The library's have others than those of searches; equal draws judge them all."""
    module, begins = import_module("measurements.damage_recovery"), []
    gait, turned = jaxgrity.load_gait("lasting"), jaxgrity.model.symmetries(exact.structure)[:1]
    searched = module.together([module.of_every_member(exact, dataclasses.replace(gait, start=1.0, ramp=0.5))])

    def measured(level, problem, gaits, seed):
        begins.extend([(float(gaits.start), float(gaits.ramp))] * len(gaits.phase))
        return [{"seed": seed}] * len(gaits.phase)

    monkeypatch.setattr(module, "measure", measured)
    monkeypatch.setattr(module, "best", lambda *_: 0)
    monkeypatch.setattr(module, "evolved", lambda *_: searched)
    known = module.known_gaits(exact, turned)
    configs = {way: jaxgrity.SearchConfig(space=space) for way, space in module.SEARCHES.items()}
    found = module.recover(exact, exact, (known, "lasting"), configs, (3, 4))
    assert begins == [(float(gait.start), float(gait.ramp)), known.begins[0], *[(1.0, 0.5)] * 3]
    assert set(known.begins) == {(1.0, 0.75), (1.0, 1.0), (1.168, 0.75)}
    assert [row["seed"] for row in found.values()] == [3] * 5


def test_all_elites_that_attract_are_counted(exact, monkeypatch):
    """Also those that another row of the table tells of, whose gaits are not told again."""
    module, gait = import_module("measurements.repertoire"), jaxgrity.load_gait("straight")
    about = [(gait, {"cell": [0, k], "mirrored": False}) for k in range(3)]
    orbit = {"settled": True, "multiplier": 0.5, "returned": 1.0, "speed": 0.5, "bend": 0.1}
    monkeypatch.setattr(module, "candidates", lambda *_: about)
    monkeypatch.setattr(module, "watched", lambda scene: orbit)
    row = module.verified(SimpleNamespace(scene=exact), None, (0.5, 0.1), 3, [about[0][1]])
    assert (row["watched"], row["attracting"], row["cell"]) == (3, 3, [0, 1])


@pytest.mark.campaign
def test_orbits_are_followed_gaits_polished_and_a_repertoire_filled(tmp_path):
    """Quick sizes: what the tables of docs/gait_records.md about them are made of."""
    facts = quick("continuation", tmp_path / "continuation")
    assert "| friction | 0.90 times, no further tried | 1.00 times" in words("continuation", facts)
    facts = quick("polish_comparison", tmp_path / "polish")
    assert [row["way"] for row in facts["rows"]] == ["search runs on", "search with overtones", "smoothed", "orbit"]
    assert "| search with overtones |" in words("polish_comparison", facts)
    assert all(row["spent"] <= facts["rollouts"] for row in facts["rows"])
    facts = quick("repertoire", tmp_path / "repertoire")
    assert 0 < facts["filled"] < facts["cells"]
    assert re.search(r"\| straight(, a mirror image)? \| \d of \d+ \|", words("repertoire", facts))


@pytest.mark.campaign
def test_multipliers_are_told_of_an_orbit_that_attracts_and_of_one_that_strays(tmp_path):
    """Quick size: neutral ones are 1 on both; what is left of a small disturbance tells the two apart."""
    facts = quick("multipliers", tmp_path)
    straight, first = facts["rows"]
    assert max(straight["neutral_off"], first["neutral_off"]) < 1e-8
    assert straight["derivative"][1] < 0.2
    assert straight["disturbed"]["0.01"] < 1e-8
    assert first["disturbed"]["0.01"] > 1e-5
    assert 1e-4 < first["strays"] < 0.02
    assert "| straight, exact | 2 |" in words("multipliers", facts)


@pytest.mark.campaign
def test_robots_are_led_round_obstacles_and_feedback_is_tuned_on_bumps(tmp_path):
    """Quick sizes, in which nothing arrives; a robot that did not arrive never counts as one that did."""
    facts = quick("obstacles", tmp_path / "obstacles")
    assert not any(row[way]["reached"] for row in facts["rows"] for way in ("planned", "blind"))
    told = words("obstacles", facts)
    assert "| goal reached, nothing touched | 0 of 2 |" in told
    assert "| did not arrive in 1.5 s | 2 |" in told
    assert (tmp_path / "obstacles" / "replay.html").exists()
    facts = quick("scene_field", tmp_path / "scene_field")
    assert "| goal reached, nothing touched | 0 of 2 |" in words("scene_field", facts)
    facts = quick("predictive_speed", tmp_path / "predictive_speed")
    assert "| 8 | " in words("predictive_speed", facts)
    facts = quick("tune", tmp_path / "tune", "--what", "on bumps")
    assert "| `sure_footed` |" in words("tune", facts)
    found = next(row for row in facts["judged"] if row["name"] == "found by this run")
    assert found["numbers"] != facts["judged"][0]["numbers"]


@pytest.mark.campaign
def test_robots_are_designed(tmp_path):
    """Quick size: what the table of docs/gait_records.md about it is made of; limits are kept."""
    facts = quick("design_study", tmp_path)
    assert [row["kind"] for row in facts["rows"]] == ["gait alone", "robot and gait"]
    assert all(row["peak_power"] <= 160 and row["strut_force"] <= facts["limits"][0] for row in facts["rows"])
    assert "| robot and gait | 160 W | **" in words("design_study", facts)
    study = tmp_path / "design_study.json"
    climbed = quick("design_gradient", tmp_path / "climbs", "--study", study)
    (row,) = climbed["rows"]
    assert row["power"] == 160
    assert row["kept"] <= row["steps"] <= 4
    assert words("design_gradient", climbed).startswith("| power allowed |")


@pytest.mark.campaign
def test_damping_of_the_spine_is_not_told(tmp_path):
    """Quick size: what the table of docs/validation.md about it is made of."""
    facts = quick("spine_dynamics", tmp_path)
    assert facts["ratios"] == facts["tried"]
    assert "| damping ratios that cannot be told apart | 0.01 to 1 |" in words("spine_dynamics", facts)


@pytest.mark.campaign
def test_speeds_are_foretold(tmp_path):
    """Quick size: what the tables of docs/identification.md are made of."""
    told = words("sim_to_real", quick("sim_to_real", tmp_path))
    assert "| after identification | " in told
    assert "| before | `structure.cables.stiffness` | 10.0% |" in told


@pytest.mark.campaign
def test_baselines_of_tasks_need_evosax_and_leave_a_table(tmp_path):
    """With it the quick size makes a table; without it there is one clear line, and known rows can still be kept."""
    known = EXPERIMENTS.parent / "docs" / "measured" / "task_baselines.json"
    kept = quick("task_baselines", tmp_path / "kept", "--earlier", known)["rows"]
    assert kept[0]["progress"]["PPO"] > 0 > kept[0]["progress"]["open loop"]
    if importlib.util.find_spec("evosax") is None:
        done = run("task_baselines", "--quick", "--out", tmp_path)
        assert done.returncode == 2
        assert "needs evosax" in done.stderr
        return
    facts = quick("task_baselines", tmp_path)
    assert "| heading | " in words("task_baselines", facts)


@pytest.mark.campaign
def test_gradients_through_the_motion_are_compared_with_ppo(tmp_path):
    """Quick size: both methods learn for a moment, and only one of them has gradients through the motion."""
    facts = quick("short_horizon", tmp_path)
    ppo, shac = facts["rows"]
    assert ppo["norms"] is None
    assert 0 < shac["norms"][0] <= shac["norms"][1] < np.inf
    assert "| short-horizon, 8 robots | " in words("short_horizon", facts)


def test_commands_within_reach_have_derivatives_where_the_motors_saturate():
    """A plain command far away changes nothing; one within reach does, and moves a motor no further than it can."""
    motors, reach = jaxgrity.control.MotorLimits(rate=1.0, stroke=0.5), 0.04
    policy = short_rollouts.Reaching(None, (reach,), motors.stroke)
    now, lengths = jnp.array([0.1]), jnp.ones(1)

    def moved(output, within):
        output = jnp.array([output])
        action = policy.action(now, output) if within else jnp.tanh(output)
        wanted = motors.stroke * (1 + action) / 2
        return contraction_reached(motors, now, wanted, reach / motors.rate, lengths, None)[0] - now[0]

    for output in (-1.5, 0.0, 1.5):
        plain, smooth = (jax.grad(moved)(output, within) for within in (False, True))
        assert plain == 0 < smooth
        assert abs(moved(output, True)) < reach
    assert moved(-1.5, True) < 0 < moved(1.5, True)


def test_no_decision_of_a_robot_drowns_the_others():
    """Gradients are told in the median norm, and cut to it; one that is not finite counts nothing."""
    slope = jnp.array([[[1.0, 0], [2.0, 0]], [[0, 1e6], [jnp.inf, 0]], [[0.5, 0], [0, 0]]])
    evened = jax.vmap(short_rollouts.evened, axis_name=short_rollouts.AXIS)
    cut, norms = jax.tree.map(lambda x: np.asarray(x[0]), evened(slope[None]))
    assert np.allclose(cut, [[[1, 0], [1, 0]], [[0, 1], [0, 0]], [[0.5, 0], [0, 0]]])
    assert (norms["median"], norms["largest"]) == (1, 1e6)


@pytest.mark.campaign
def test_learning_is_judged_where_a_policy_never_was(tmp_path):
    """Quick size: a policy for headings is tried with other contact, with bad sensors and on goals."""
    facts = quick("learning", tmp_path)
    (row,) = facts["rows"]
    assert {"progress", "finer", "other", "erring", "goal"} < set(row)
    assert len(row["curve"]) == row["updates"] == 2
    again = quick("learning", tmp_path / "again", "--earlier", tmp_path / "learning.json")
    assert again["rows"] == facts["rows"]
    assert "| heading, 8, 0 | " in words("learning", facts)


@pytest.mark.campaign
def test_learning_by_brax_needs_brax_and_leaves_a_table(tmp_path):
    """With it the quick size makes a table; without it there is one clear line."""
    if importlib.util.find_spec("brax") is None:
        done = run("brax_ppo", "--quick", "--out", tmp_path)
        assert done.returncode == 2
        assert "Brax is not installed" in done.stderr
        return
    facts = quick("brax_ppo", tmp_path)
    assert "| goal | 0 | " in words("brax_ppo", facts)
