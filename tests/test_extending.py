"""The examples of docs/extending.md run as they stand, are short, and do what the page says."""

import re
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
import scipy.sparse as sp

from jaxgrity import METHODS, Constraint, ForceLaw, InputError, Scene, Structure, edge_lengths, energy_audit, with_terms
from jaxgrity.search import OBJECTIVES

PAGE = (Path(__file__).parents[1] / "docs" / "extending.md").read_text(encoding="utf-8")
SECTIONS = {
    section.splitlines()[0]: re.findall(r"```python\n(.*?)```", section, re.DOTALL)
    for section in PAGE.split("\n## ")[1:]
}
CAMPAIGNS = ("A force with a potential", "A force between two nodes", "A contact law", "A method", "An objective")
"""sections whose examples take long; the others show the same of force laws and of registries"""


@pytest.fixture
def _registries_as_before():
    """An example registers what other tests do not expect."""
    before = [(registry, dict(registry)) for registry in (METHODS, OBJECTIVES)]
    yield
    for registry, known in before:
        registry.clear()
        registry.update(known)


@pytest.mark.usefixtures("_registries_as_before")
@pytest.mark.parametrize(
    "section",
    [
        pytest.param(name, marks=pytest.mark.campaign if name.startswith(CAMPAIGNS) else pytest.mark.slow)
        for name in SECTIONS
    ],
)
def test_example_works(section):
    """Each section's blocks run one after the other, as one program; the last one checks what the first one adds."""
    names = {"__name__": "example"}
    for block in SECTIONS[section]:
        exec(compile(block, f"docs/extending.md, {section}", "exec"), names)


@pytest.mark.parametrize("section", SECTIONS)
def test_example_is_short(section):
    """40 lines at most, blank ones aside, and a check of its own."""
    example, *checks = SECTIONS[section]
    assert sum(bool(line.strip()) for line in example.splitlines()) <= 40
    assert any("assert" in check for check in checks)


class _Push(ForceLaw):
    """A constant force on every node along x."""

    force_on_each: float = 1.0
    name: ClassVar[str] = "push"
    cause: ClassVar[str] = "push"

    def force(self, motion, other_forces):
        return self.force_on_each * np.array([1.0, 0.0, 0.0]) + 0 * motion.v

    def keeps(self, symmetry):
        return False


class _BookedAsActuation(_Push):
    cause: ClassVar[str] = "actuation"


class _Leash(Constraint):
    """A constraint that no sweep knows of."""

    name: ClassVar[str] = "leash"

    def directions(self, q, size):
        return sp.csr_array((0, q.size))

    def gaps(self, q, t):
        return np.zeros(0)

    def complaint(self, q, t, part):
        return ""

    def keeps(self, symmetry):
        return True


@pytest.mark.slow
def test_force_law_pushes_and_is_in_the_balance(reference):
    """12 N on 6 kg for half a second in free fall, and its work of 12 N times the way."""
    aloft = with_terms(Scene(reference.structure), _Push())
    audit = energy_audit(aloft, 0.5)
    way = np.einsum("n,fn->f", reference.structure.node_mass / 6.0, audit.positions[..., 0])
    np.testing.assert_allclose(way - way[0], audit.times**2, atol=1e-9)
    np.testing.assert_allclose(audit.dissipated["push"], -12 * (way - way[0]), atol=1e-6)
    assert audit.momentum_residual.max() < 1e-9


@pytest.mark.parametrize(
    ("law", "words"),
    [(_Leash(), "expected an EnergyTerm"), (_BookedAsActuation(), "which the energy audit reserves")],
)
def test_scene_refuses_a_law_that_it_would_leave_out(reference, law, words):
    """Sweeps would not solve for the constraint, and the audit would overwrite one work with another."""
    with pytest.raises(InputError, match=words):
        with_terms(reference, law)


def test_law_along_members_that_are_not_there_is_refused():
    """In words, as the potential energy is first asked for."""
    node = Scene(Structure(nodes=np.zeros((1, 3)), node_mass=np.ones(1)))
    with pytest.raises(InputError, match="'cables'"):
        node.configuration(np.zeros((1, 3)), 0.0).stretch("cables")


def test_rates_are_there_for_members_without_dampers(exact):
    """d/dt |d|, for struts along which no force of the library acts."""
    rng = np.random.default_rng(0)
    q, v = rng.normal(size=(2, 12, 3))
    motion = exact.motion(v, q, 0.0, None)
    h, edges = 1e-6, exact.structure.struts.edges
    expected = (edge_lengths(q + h * v, edges) - edge_lengths(q - h * v, edges)) / (2 * h)
    np.testing.assert_allclose(motion.rate_of_length("struts"), expected, rtol=1e-7)
    np.testing.assert_allclose(motion.at.length("struts"), edge_lengths(q, edges), rtol=1e-12)
