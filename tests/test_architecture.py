"""The package as text: how long its parts are, what its signatures ask for, and what is public."""

import ast
import itertools
import statistics
from collections import defaultdict
from pathlib import Path

import jaxgrity

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
STUB = ast.parse((PACKAGE / "__init__.pyi").read_text())

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


def names_imported() -> dict[str, str]:
    """The public names, and the modules that they come from."""
    return {
        alias.asname or alias.name: node.module or ""
        for node in STUB.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }


def names_listed() -> list[str]:
    """`__all__` of the stub."""
    (listed,) = (node.value for node in STUB.body if isinstance(node, ast.Assign) and assigned(node) == ["__all__"])
    return ast.literal_eval(listed)


def test_the_package_is_read():
    """Else nothing below could fail."""
    assert len(TEXTS) > 50
    assert len(FUNCTIONS) > 300
    assert parameters(FUNCTIONS["stepping/simulate.py: simulate"]) == 6


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


def test_the_public_names_are_those_that_the_stub_imports():
    """Each once; `jaxgrity.__all__`, by which they are imported when they are used, is the same list."""
    listed = names_listed()
    assert sorted(set(listed)) == sorted(listed)
    assert set(listed) == set(names_imported())
    assert set(jaxgrity.__all__) == set(listed)


def test_public_names_are_documented():
    """And are there: classes, functions and modules by docstrings, constants by the string below them."""
    silent = []
    for name, home in names_imported().items():
        assert hasattr(jaxgrity, name), name
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
