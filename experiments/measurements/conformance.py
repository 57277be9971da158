"""Every published or foreign answer that is known, beside ours: closed forms, other programs, MuJoCo if installed."""

from collections.abc import Iterator
from itertools import chain

from measurement import Record, measurement

from conformance_dynamics import dynamics_cases
from conformance_statics import statics_cases
from pages import columns


@measurement(page="conformance.md", quick={"few": True})
def conformance(few: bool = False) -> Iterator[Record]:
    """A row for each case.

    Args:
        few: fewer of each kind, at coarser steps
    """
    for case in chain(statics_cases(few), dynamics_cases(few)):
        yield {**case._asdict(), "difference": case.ours - case.theirs}


PRISMS = "prism of "
"""Beginning of the names of forty cases that are much alike, which have a table of their own."""


@conformance.table
def words(record: Record) -> str:
    """Both answers, and their difference, of all cases but prisms."""
    return compared([row for row in record["rows"] if not row["case"].startswith(PRISMS)])


@conformance.table(part="prisms")
def words_of_prisms(record: Record) -> str:
    """The same of prisms."""
    return compared([row for row in record["rows"] if row["case"].startswith(PRISMS)])


def compared(rows: list[Record]) -> str:
    """A row for each case."""
    cells = {
        "case": "{case}",
        "source": "{source}",
        "theirs": lambda row: f"{row['theirs']:.6g} {row['unit']}".strip(),
        "ours": lambda row: f"{row['ours']:.6g} {row['unit']}".strip(),
        "ours - theirs": lambda row: "0" if row["difference"] == 0 else f"{row['difference']:.0e}",
    }
    return columns(rows, cells)


if __name__ == "__main__":
    conformance.run()
