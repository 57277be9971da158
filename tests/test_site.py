"""The documentation site: nothing is missing from it, all its links lead somewhere, and it needs no network."""

import importlib
import re
import subprocess
import sys
import tomllib
from html import unescape
from pathlib import Path
from urllib.parse import unquote, urlsplit

import jax
import jax.numpy as jnp
import pytest

import jaxgrity

ROOT = Path(__file__).parents[1]


@pytest.fixture
def interface():
    """What writes the reference pages."""
    pytest.importorskip("sphinx")
    return importlib.import_module("docs.site.interface")


def test_reference_has_every_public_name_once(interface):
    """In groups with titles, each on a page of its own."""
    groups = interface.groups()
    rooms = [getattr(jaxgrity, room).__all__ for room in jaxgrity.SUB_PACKAGES]
    assert sorted(name for group in groups for name in group.names) == sorted(sum(rooms, jaxgrity.__all__))
    assert len({group.page for group in groups}) == len(groups) > 5
    assert all(group.names and group.title for group in groups)


def test_docstrings_are_plain_text_with_code(interface):
    """Signs that reStructuredText would read stand for themselves, but in code and examples; sections are kept."""
    lines = ["|v| of `a*b` is 2 * x_ here.", "", "Args:", "    x: m.", "", "Example:", "    >>> 2 * 3", "    6"]
    interface.as_plain_text(None, "function", "f", None, None, lines)
    assert lines[0] == r"\|v\| of `a*b` is 2 \* x\_ here."
    assert any(line.startswith(":param x:") for line in lines)
    assert any(line.strip() == ">>> 2 * 3" for line in lines)
    lines = ["(rows, 3), m: one for each", ""]
    interface.as_plain_text(None, "attribute", "f.x", None, None, lines)
    assert lines == ["(rows, 3), m: one for each", ""]


def test_make_docs_installs_all_that_the_reference_pages_import():
    """One of their modules is of Gymnasium, which the extra `docs` therefore needs."""
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]
    assert set(extras["gym"]) <= set(extras["docs"])


def test_every_page_is_in_the_contents():
    """Of those in docs/ and the notebooks; Sphinx would say so too, but later."""
    listed = set(re.findall(r"^([\w./]+)$", (ROOT / "docs" / "index.md").read_text(encoding="utf-8"), re.MULTILINE))
    pages = {path.stem for path in (ROOT / "docs").glob("*.md")} - {"index"}
    notebooks = {f"../notebooks/{path.stem}" for path in (ROOT / "notebooks").glob("*.ipynb")}
    assert pages | notebooks <= listed


def test_every_picture_is_in_the_gallery():
    """With a sentence below it."""
    page = (ROOT / "docs" / "gallery.md").read_text("utf-8")
    shown = re.findall(r"^!\[.+\]\(images/(.+)\)\n\n\S", page, re.MULTILINE)
    assert sorted(shown) == sorted(path.name for path in (ROOT / "docs" / "images").iterdir())


def test_links_between_pages_lead_somewhere():
    """To files that are there, and to headings that their pages have; Sphinx would say so too, but later."""
    pages = {path: path.read_text(encoding="utf-8") for path in (ROOT / "docs").glob("*.md")}
    anchors = {}
    for path, text in pages.items():
        titles = re.findall(r"^#+ (.*)$", re.sub(r"```.*?```", "", text, flags=re.DOTALL), re.MULTILINE)
        anchors[path] = {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in titles}
    found = [(path, link) for path, text in pages.items() for link in re.findall(r"\]\(((?!http)[^)\s]+)\)", text)]
    assert len(found) > 100
    for path, link in found:
        to, _, heading = link.partition("#")
        target = (path.parent / unquote(to)).resolve() if to else path
        # what the site writes itself has no file yet
        assert target.exists() or to.startswith("reference/"), f"{path.name}: {link}"
        assert not heading or heading in anchors.get(target, {heading}), f"{path.name}: {link}"


@pytest.mark.campaign
def test_site_is_built_without_a_warning(tmp_path):
    """Its links and anchors lead somewhere, and nothing that a page loads lies on another machine."""
    pytest.importorskip("sphinx")
    options = ["--fail-on-warning", "--keep-going", "--quiet", "-c", "docs", "--doctree-dir", tmp_path / "doctrees"]
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", *options, ".", tmp_path / "site"], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    pages = {path: path.read_text(encoding="utf-8") for path in (tmp_path / "site").rglob("*.html")}
    pages = {path: text for path, text in pages.items() if "_static" not in path.parts}
    assert len(pages) > 25
    anchors = {path: set(re.findall(r'\bid="([^"]+)"', text)) for path, text in pages.items()}
    for path, text in pages.items():
        loaded = re.findall(r'<(?:script|img|iframe)\b[^>]*\bsrc="([^"]+)"|<link\b[^>]*\bhref="([^"]+)"', text)
        assert not [one for one in loaded if "".join(one).startswith(("http", "//"))], path
        for link in re.findall(r'\b(?:href|src)="([^"]+)"', text):
            to = urlsplit(unescape(link))
            if to.scheme in ("", "file"):
                target = (path.parent / unquote(to.path)).resolve() if to.path else path
                assert target.exists(), f"{path.name}: {link}"
                assert not to.fragment or to.fragment in anchors.get(target, {to.fragment}), f"{path.name}: {link}"


@pytest.mark.parametrize(
    "page",
    [
        pytest.param("getting_started", marks=pytest.mark.slow),
        *(
            pytest.param(page, marks=pytest.mark.campaign)
            for page in ("cables", "control", "environments", "gaits", "identification", "terrain")
        ),
    ],
)
def test_examples_of_the_pages_run(page):
    run(page)


def run(page: str) -> dict:
    """The blocks of a page one after the other, as one program: the names that they leave."""
    names = {"__name__": "example"}
    for block in re.findall(r"```python\n(.*?)```", (ROOT / "docs" / f"{page}.md").read_text("utf-8"), re.DOTALL):
        exec(compile(block, f"docs/{page}.md", "exec"), names)
    return names


@pytest.mark.slow
def test_the_recipes_run_and_their_gradient_is_that_of_a_motion(central_difference, capsys):
    """Of how far a robot rolls, by friction: within a thousandth of the central difference."""
    shown = run("howto")
    far, slope = float(shown["far"]), float(shown["slope"])
    assert f"{far:.3f} m" in capsys.readouterr().out
    assert far > 0.5
    assert abs(slope) > 0.1
    step = central_difference(jax.jit(lambda mu: shown["distance"](mu)), jnp.asarray(0.5), 1e-5)
    assert slope == pytest.approx(float(step), rel=1e-3)


def test_scene_files_of_the_pages_are_right():
    """The one that a newcomer copies, and the parts of others."""
    scene = jaxgrity.load_scene(str(ROOT / "docs" / "my_robot.toml"))
    assert "rigid struts" in jaxgrity.describe(scene)
    assert scene.gait is not None
    whole = (ROOT / "docs" / "my_robot.toml").read_text("utf-8")
    assert f"```toml\n{whole}```" in (ROOT / "docs" / "getting_started.md").read_text("utf-8")
    for part in re.findall(r"```toml\n(.*?)```", (ROOT / "docs" / "howto.md").read_text("utf-8"), re.DOTALL):
        tables = set(re.findall(r"^\[+(\w+)", part, re.MULTILINE))
        # the tables of the part in place of those of the whole file
        others = [
            text for text in re.split(r"^(?=\[)", whole, flags=re.MULTILINE) if text[1:].split("]")[0] not in tables
        ]
        kept = [text for text in others if "structure" not in tables or not text.startswith(("[gait", "[struts"))]
        needed = "[struts]\nstiffness = 1e4\n" if "structure" in tables and "struts" not in tables else ""
        jaxgrity.parse_scene("\n".join(kept) + needed + part)
