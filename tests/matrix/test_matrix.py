"""What a user does with scenes of every kind ends right, or in one line that says why not."""

import itertools
import json
from pathlib import Path
from typing import Any

import jax
import pytest
from studies import matrix
from studies.matrix_scenes import IMPOSSIBLE, KINDS, covering, pairs
from studies.matrix_uses import STILL, Case, tried

from jaxgrity import InputError

ROWS = covering(KINDS)
"""Of all scenes."""
FOUND = Path(__file__).parents[2] / ".cache" / "matrix"
"""Where campaigns leave what they found."""
FIRST = 39
"""Number of the scene of which `make test` tries something: one with contact along struts, wind and a push."""


def test_the_scenes_show_every_pair_of_kinds():
    """But those that cannot be; and there are few of them."""
    shown = set().union(*map(pairs, ROWS))
    for (a, kinds), (b, others) in itertools.combinations(KINDS.items(), 2):
        assert {((a, x), (b, y)) for x in kinds for y in others} - shown <= IMPOSSIBLE
    assert not shown & IMPOSSIBLE
    assert len(ROWS) < 70


def test_every_use_meets_every_kind():
    """Of the uses that are not tried on all scenes."""
    for use in matrix.USES:
        met = {part for k, _ in matrix.jobs(ROWS, (use,)) for part in ROWS[k].items()}
        assert met == {(name, kind) for name, kinds in KINDS.items() for kind in kinds}


def test_pairs_that_cannot_be_are_refused():
    for each in matrix.impossible():
        assert each["end"] == "refused", each


@pytest.mark.slow
def test_ends_of_uses_are_told_apart():
    """A fault of a use is no refusal."""

    def failing(error):
        def use(case):
            raise error

        return tried(use, Case(ROWS[FIRST]))["end"]

    ends = [failing(error) for error in (InputError("no"), InputError("two\nlines"), AssertionError(), TypeError("x"))]
    assert ends == ["refused", "wrong", "wrong", "raw"]


def ended_well(k: int, use: str, case: Case) -> dict[str, Any]:
    """What came of it: right, or refused as docs/matrix.md lists it."""
    found = tried(matrix.USES[use], case)
    assert found["end"] in ("right", "refused"), (ROWS[k], use, found)
    return {"scene": k, "use": use, **found}


@pytest.mark.slow
def test_some_uses_of_a_scene():
    case = Case(ROWS[FIRST])
    for use in (*STILL, "sensors (call)", "environment speed (call)"):
        ended_well(FIRST, use, case)


@pytest.mark.campaign
@pytest.mark.parametrize("k", range(len(ROWS)))
def test_all_uses(k):
    """All that are tried on a scene, one after the other, so that they share its motion.

    What came of them stays in .cache/matrix, from which `matrix --known` makes the record of docs/matrix.md.
    """
    jax.clear_caches()  # the programs of the scene before: together they fill the memory
    case = Case(ROWS[k])
    uses = [use for number, use in matrix.jobs(ROWS, tuple(matrix.USES)) if number == k]
    FOUND.mkdir(parents=True, exist_ok=True)
    (FOUND / f"{k:02}.json").write_text(json.dumps({"rows": [ended_well(k, use, case) for use in uses]}))
