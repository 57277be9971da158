"""All structure files of a clone of NTRT, on all its branches: how many are read, and why others are refused."""

import io
import subprocess
import tarfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from measurements.measurement import Record, measurement
from measurements.pages import columns

from jaxgrity import InputError
from jaxgrity.formats import read_ntrt

NASA = Path(__file__).parents[2] / "tests" / "data" / "ntrt" / "nasa"
REASONS = {
    "not YAML": "not YAML: comments begin with `%`",
    "there is no such file": "a substructure names a file that is not there",
    "expected each key once": "a key is there twice",
    "expected less pretension": "the pretension of a string asks for a rest length below 0",
    "expected one of nodes, pair_groups": "not a structure of NTRT",
    "where nothing is built": "a string ends where nothing is built",
}
"""What is said in the table where a refusal contains these words."""


@measurement(page="files.md", quick={"clone": str(NASA)})
def ntrt_files(clone: str = "NTRTsim") -> Iterator[Record]:
    """A row for each reason of refusal.

    Args:
        clone: folder of a git clone of NTRT's repository, with its branches; or a folder of structure files
    """
    found: dict[str, str] = {}
    for folder, files in trees(Path(clone)):
        for path, blob in files.items():
            if found.get(blob, "not seen yet"):  # files that are refused in one place may be read in another
                found[blob] = refusal(folder / path)
    refused = Counter(said(words) for words in found.values() if words)
    for reason, count in refused.most_common():
        yield {"reason": reason, "files": count}
    return {"distinct": len(found), "read": sum(not words for words in found.values())}


def trees(clone: Path) -> Iterator[tuple[Path, dict[str, str]]]:
    """Each branch, tag and pull request as a folder, with the hashes of its structure files by their paths."""
    if not (clone / ".git").exists() and not (clone / "HEAD").exists():
        yield clone, {str(path.relative_to(clone)): str(path) for path in sorted(clone.rglob("*.y*ml"))}
        return
    for branch in git(clone, "for-each-ref", "--format=%(refname)").decode().split():
        listed = (line.split("\t") for line in git(clone, "ls-tree", "-r", branch).decode().splitlines())
        files = {path: facts.split()[2] for facts, path in listed if path.endswith((".yaml", ".yml"))}
        if files:
            with TemporaryDirectory() as folder:
                with tarfile.open(fileobj=io.BytesIO(git(clone, "archive", branch, *files))) as archive:
                    archive.extractall(folder, filter="data")
                yield Path(folder), files


def git(clone: Path, *words: str) -> bytes:
    """What git says."""
    return subprocess.run(["git", "-C", str(clone), *words], check=True, capture_output=True).stdout


def refusal(path: Path) -> str:
    """Why a file is refused; nothing where it is read."""
    try:
        read_ntrt(path)
    except InputError as error:
        return str(error)
    return ""


def said(words: str) -> str:
    """The reason of a refusal, as the table says it."""
    return next((reason for mark, reason in REASONS.items() if mark in words), "another reason")


@ntrt_files.table
def words(record: Record) -> str:
    """How many files are read, and why others are not."""
    rows = [
        {"reason": "read", "files": record["read"]},
        *record["rows"],
        {"reason": "all", "files": record["distinct"]},
    ]
    return columns(rows, {"distinct files": "{reason}", "number": "{files}"})
