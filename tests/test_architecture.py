"""The package as text: how long its parts are, what its signatures ask for, and what is public."""

import ast
import itertools
import re
import statistics
import tomllib
import warnings
from collections import defaultdict
from importlib import import_module
from operator import attrgetter
from pathlib import Path

import pytest

import jaxgrity
from jaxgrity.core.moved_names import MOVED, RENAMED, REPLACED

PACKAGE = Path(jaxgrity.__file__).parent
TEXTS = {str(path.relative_to(PACKAGE)): path.read_text() for path in sorted(PACKAGE.rglob("*.py"))}
TREES = {module: ast.parse(text) for module, text in TEXTS.items()}
FUNCTIONS = {
    f"{module}: {node.name}": node
    for module, tree in TREES.items()
    for node in ast.walk(tree)
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
}
"""all functions and methods, inner ones too"""
STUBS = {
    ".".join(("jaxgrity", *path.parent.relative_to(PACKAGE).parts)): ast.parse(path.read_text())
    for path in sorted(PACKAGE.rglob("__init__.pyi"))
}
"""of the package, and of each room that has public names"""
MOST_AT_THE_TOP = 120
"""names, which most users need"""

LONGEST_MODULE, MEDIAN_MODULE, LONGEST_FUNCTION = 300, 150, 60
"""lines"""
MOST_PARAMETERS = 7
IN_SEVERAL_MODULES = {"main"}
"""what each command of the command line begins with"""


def lines(module: str) -> int:
    return TEXTS[module].count("\n")


def parameters(function: ast.FunctionDef) -> int:
    """Those by name count too; what belongs together is one object. `self` and `cls` do not count."""
    given = function.args
    names = [a.arg for a in (*given.posonlyargs, *given.args, *given.kwonlyargs, given.vararg, given.kwarg) if a]
    return len([name for name in names if name not in ("self", "cls")])


def assigned(node: ast.stmt) -> list[str]:
    """The names that a statement gives values to."""
    targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
    return [target.id for target in targets if isinstance(target, ast.Name)]


def names_imported(package: str) -> dict[str, str]:
    """The public names of a package or room, and the modules that they come from."""
    room = package.removeprefix("jaxgrity").lstrip(".")
    return {
        alias.asname or alias.name: ".".join(part for part in (room, node.module) if part)
        for node in STUBS[package].body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
        if alias.name not in jaxgrity.SUB_PACKAGES
    }


def names_listed(package: str) -> list[str]:
    """`__all__` of its stub."""
    body = STUBS[package].body
    (listed,) = (node.value for node in body if isinstance(node, ast.Assign) and assigned(node) == ["__all__"])
    return ast.literal_eval(listed)


def test_the_package_is_read():
    """Else nothing below could fail."""
    assert len(TEXTS) > 50
    assert len(FUNCTIONS) > 300
    assert parameters(FUNCTIONS["stepping/simulate.py: simulate"]) == 7


def test_modules_are_short():
    """Long ones hide what they are made of; half of those that hold anything are much shorter."""
    assert not {module: lines(module) for module in TEXTS if lines(module) > LONGEST_MODULE}
    assert statistics.median(lines(module) for module, text in TEXTS.items() if text) <= MEDIAN_MODULE


def test_functions_are_short():
    """With their docstrings."""
    lengths = {name: node.end_lineno - node.lineno + 1 for name, node in FUNCTIONS.items()}
    assert not {name: length for name, length in lengths.items() if length > LONGEST_FUNCTION}


def test_no_signature_has_many_parameters():
    """Fields of data classes are not parameters."""
    assert not {name: count for name, node in FUNCTIONS.items() if (count := parameters(node)) > MOST_PARAMETERS}


def test_imports_stand_at_the_top():
    """So that what a module needs can be seen, and circles cannot hide."""
    kinds = ast.Import | ast.ImportFrom
    assert not [name for name, node in FUNCTIONS.items() if any(isinstance(x, kinds) for x in ast.walk(node))]


def test_motions_are_stepped_in_one_place():
    """A method's step is taken, and its memory begun, by `stepping/loop.py` alone; diffrax does the rest. Experiments
    step by it too."""
    takers = {module for module, text in TEXTS.items() if re.search(r"(?<!environment)\.step\(|solver\.init\(", text)}
    assert takers == {"stepping/loop.py"}
    scripts = {path.name: path.read_text() for path in (PACKAGE.parent / "experiments").rglob("*.py")}
    assert any("advance(scheme" in text for text in scripts.values())
    assert not [name for name, text in scripts.items() if re.search(r"solver\.(step|init)\(", text)]


def test_every_module_says_what_it_is():
    """In a docstring, but where it is empty."""
    assert not [module for module, text in TEXTS.items() if text.strip() and not ast.get_docstring(TREES[module])]


def test_no_two_things_have_one_name():
    """Of public classes and functions at the top of all modules."""
    homes = defaultdict(list)
    for module, tree in TREES.items():
        for node in tree.body:
            if isinstance(node, ast.ClassDef | ast.FunctionDef) and not node.name.startswith("_"):
                homes[node.name].append(module)
    assert not {name: where for name, where in homes.items() if len(where) > 1 and name not in IN_SEVERAL_MODULES}


@pytest.mark.parametrize("package", STUBS)
def test_the_public_names_are_those_that_the_stub_imports(package):
    """Each once; `__all__`, by which they are imported when they are used, is the same list."""
    listed = names_listed(package)
    assert sorted(set(listed)) == sorted(listed)
    assert set(listed) == set(names_imported(package))
    assert set(import_module(package).__all__) == set(listed)


def test_each_public_name_has_one_home():
    """At the top, or in one room; no module of a room has the name of something in it, which it would hide."""
    assert set(STUBS) == {"jaxgrity", *(f"jaxgrity.{room}" for room in jaxgrity.SUB_PACKAGES)}
    homes = [name for package in STUBS for name in names_listed(package)]
    assert not [name for name in homes if homes.count(name) > 1]
    assert len(names_listed("jaxgrity")) <= MOST_AT_THE_TOP
    for room in jaxgrity.SUB_PACKAGES:
        modules = {path.stem for path in (PACKAGE / room).glob("*.py")} - {"plot", "view"}
        assert not modules & set(names_listed(f"jaxgrity.{room}"))


def test_rooms_are_found_where_one_looks():
    """By completion, and by type checkers, which read the stub alone."""
    imported = {
        alias.name for node in STUBS["jaxgrity"].body if isinstance(node, ast.ImportFrom) for alias in node.names
    }
    assert set(jaxgrity.SUB_PACKAGES) <= imported & set(dir(jaxgrity))


def test_names_that_moved_warn_and_are_there():
    """For one release, from the top too."""
    with pytest.warns(DeprecationWarning, match=r"jaxgrity.find_orbit is jaxgrity.orbits.find_orbit now"):
        assert jaxgrity.find_orbit is jaxgrity.orbits.find_orbit
    with pytest.warns(DeprecationWarning, match=r"jaxgrity.Motors is jaxgrity.control.MotorLimits now"):
        assert jaxgrity.Motors is jaxgrity.control.MotorLimits
    with pytest.warns(DeprecationWarning, match=r"jaxgrity.Waves is jaxgrity.HeightWaves now"):
        assert jaxgrity.Waves is jaxgrity.HeightWaves
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        from jaxgrity import speed_gradient  # noqa: F401
    assert len(warned) == 1


def test_each_name_of_the_last_release_leads_somewhere():
    """In a sub-package, by its name or another; or to what does the same now, which need not be in one."""
    in_rooms = {name for package in STUBS if package != "jaxgrity" for name in names_listed(package)}
    assert in_rooms >= MOVED
    assert set(RENAMED.values()) <= in_rooms | set(jaxgrity.__all__)
    assert all(attrgetter(place)(jaxgrity) for place in REPLACED.values())


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("no_such_name", "jaxgrity.no_such_name: unknown"),
        ("simulat", "unknown; perhaps you meant simulate"),
        ("find_orbt", "unknown; perhaps you meant find_orbit"),
        ("MotorLimits", "jaxgrity.MotorLimits: expected jaxgrity.control.MotorLimits"),
        ("least_mass", "jaxgrity.least_mass: expected jaxgrity.statics.least_mass"),
        ("equilibrium", "jaxgrity.equilibrium: expected jaxgrity.statics.resting_shape"),
        ("control.Steerd", "jaxgrity.control.Steerd: unknown; perhaps you meant Steered"),
    ],
)
def test_misspelt_names_are_answered_with_the_nearest(name, words):
    """Of the top, of a room; and a name that only a room has had is not one of the top."""
    with pytest.raises(AttributeError, match=words):
        attrgetter(name)(jaxgrity)


@pytest.mark.parametrize("package", STUBS)
def test_public_names_are_documented(package):
    """And are there: classes, functions and modules by docstrings, constants by the string below them."""
    silent = []
    for name, home in names_imported(package).items():
        assert hasattr(import_module(package), name), name
        module = f"{home}/{name}".replace(".", "/") + ".py"
        if module in TREES:
            documented = ast.get_docstring(TREES[module])
        else:
            documented = _documentation(TREES[home.replace(".", "/") + ".py"].body, name)
        if not documented:
            silent.append(name)
    assert not silent


def _documentation(body: list[ast.stmt], name: str) -> str | None:
    """Of a name that is given its meaning at the top of a module."""
    for node, below in itertools.pairwise([*body, ast.Pass()]):
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name == name:
            return ast.get_docstring(node)
        if name in assigned(node) and isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant):
            return below.value.value
    return None


def test_the_version_is_that_of_the_project():
    assert f'version = "{jaxgrity.__version__}"' in (PACKAGE.parent / "pyproject.toml").read_text().splitlines()
    assert f"version: {jaxgrity.__version__}" in (PACKAGE.parent / "CITATION.cff").read_text().splitlines()
    heads = [line for line in (PACKAGE.parent / "CHANGELOG.md").read_text().splitlines() if line.startswith("## ")]
    assert heads[0].startswith((f"## {jaxgrity.__version__} (", "## Unreleased"))


def test_badges_say_what_the_project_says():
    """Of Python and of the license."""
    root = PACKAGE.parent
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    oldest = project["requires-python"].removeprefix(">=")
    for name, words in (("python", f"{oldest} or newer"), ("license", project["license"])):
        assert f">{words}</text>" in (root / "docs" / "badges" / f"{name}.svg").read_text()
