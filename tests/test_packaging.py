"""The wheel holds all that is needed: installed elsewhere, from an empty folder, scenes, gaits and the command work."""

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

pytestmark = pytest.mark.slow


def _python(*arguments, cwd, **environment):
    done = subprocess.run(
        [sys.executable, *map(str, arguments)],
        cwd=cwd,
        env=os.environ | environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The wheel, built from a copy, so that nothing left over from another build gets into it."""
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    shutil.copytree(ROOT / "jaxgrity", source / "jaxgrity", ignore=shutil.ignore_patterns("__pycache__"))
    offline = ("--quiet", "--disable-pip-version-check", "--no-deps", "--no-index", "--no-build-isolation")
    _python("-m", "pip", "wheel", *offline, "--wheel-dir", out, source, cwd=source)
    (built,) = out.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """The folder in which the wheel alone is installed; what it depends on is taken from the tests' own environment."""
    target = tmp_path_factory.mktemp("installed")
    offline = ("--quiet", "--disable-pip-version-check", "--no-deps", "--no-index")
    _python("-m", "pip", "install", *offline, "--target", target, wheel, cwd=target)
    return target


def test_wheel_holds_every_file_of_the_package(wheel):
    """Modules, the stub that names what is public, the marker for type checkers, scenes and gaits; and the licence."""
    held = set(zipfile.ZipFile(wheel).namelist())
    files = (path for path in (ROOT / "jaxgrity").rglob("*") if path.is_file() and "__pycache__" not in path.parts)
    assert {path.relative_to(ROOT).as_posix() for path in files} <= held
    assert any(name.endswith("licenses/LICENSE") for name in held)


def test_scenes_and_gaits_are_found_by_name_from_an_empty_folder(installed, tmp_path):
    """Each of them, by the installed package and by no other."""
    program = """
import jaxgrity
print(jaxgrity.__file__)
for name in jaxgrity.scene_names():
    jaxgrity.load_scene(name)
for name in jaxgrity.gait_names():
    jaxgrity.load_gait(name)
print(jaxgrity.describe(jaxgrity.load_scene("reference")))
"""
    where, *words = _python("-c", program, cwd=tmp_path, PYTHONPATH=str(installed)).splitlines()
    assert Path(where).is_relative_to(installed)
    assert words[0].startswith("modelled")


def test_rooms_read_the_stubs_of_the_wheel(wheel, installed, tmp_path):
    """`lazy_loader` reads the `.pyi` of a room when the room is imported: one that is missing breaks the import."""
    stubs = {path.relative_to(ROOT).as_posix() for path in (ROOT / "jaxgrity").rglob("*.pyi")}
    assert "jaxgrity/stepping/__init__.pyi" in stubs
    assert stubs <= set(zipfile.ZipFile(wheel).namelist())
    program = "import jaxgrity as j\nfor name in j.SUB_PACKAGES:\n    print(name, len(getattr(j, name).__all__))"
    said = _python("-c", program, cwd=tmp_path, PYTHONPATH=str(installed)).splitlines()
    assert len(stubs) == len(said) + 1
    assert all(int(line.split()[1]) > 0 for line in said)


def test_both_ways_to_call_the_command_show_its_help(installed, tmp_path):
    """`jaxgrity` and `python -m jaxgrity`, from the wheel alone."""
    path = {"PYTHONPATH": str(installed)}
    help_of_command = _python(installed / "bin" / "jaxgrity", "--help", cwd=tmp_path, **path)
    assert help_of_command.startswith("usage: jaxgrity")
    assert _python("-m", "jaxgrity", "--help", cwd=tmp_path, **path) == help_of_command
    assert "reference" in _python("-c", "import jaxgrity; print(jaxgrity.scene_names())", cwd=tmp_path, **path)


def test_command_simulates_from_an_empty_folder(installed, tmp_path):
    """`jaxgrity simulate` leaves a summary in the folder where it was called."""
    command = installed / "bin" / "jaxgrity"
    (tmp_path / "fall.toml").write_text('[structure]\nkind = "custom"\nnodes = [[0, 0, 1]]\nmass = 1.0\n[gravity]\n')
    words = ("simulate", "fall.toml", "--duration", "0.5", "--no-diagnose")
    _python(command, *words, cwd=tmp_path, PYTHONPATH=str(installed))
    assert (tmp_path / "results" / "simulate" / "summary.json").exists()
