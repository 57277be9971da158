"""What the stages after evolution found, in the folder of a search: a search that is resumed does not repeat them."""

from pathlib import Path
from typing import Any

import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.io.files import save_arrays
from jaxgrity.search.checkpoint import POLISHED, PROMOTED, RUN_OR_RESTART, saved_arrays
from jaxgrity.search.climb import ClimbStep
from jaxgrity.search.fidelity import FidelityLevel
from jaxgrity.search.genome import Genome
from jaxgrity.search.judging import Scores
from jaxgrity.search.polish import Polished
from jaxgrity.search.promotion import Agreement, Promoted
from jaxgrity.trust.sensitivity import Sensitivity

KEPT_VERSION = 2
"""Version of the files of these stages. It goes up by 1 with every change of what they hold, or of what that means."""
SEPARATOR = "."
"""Character between the name of a part and that of its field, in names of arrays."""


def save_promoted(folder: Path, promoted: Promoted) -> None:
    """Keep the promoted gaits; the levels of their `agreement` follow from the settings."""
    agreement = {name: value for name, value in promoted.agreement._asdict().items() if name != "levels"}
    found = {**promoted._asdict(), "finals": promoted.finals._asdict(), "agreement": agreement}
    save_arrays(folder / PROMOTED, version=KEPT_VERSION, **_flat(found))


def load_promoted(folder: Path, levels: tuple[FidelityLevel, ...]) -> Promoted | None:
    """What `save_promoted` kept, to the last bit, with the compared `levels`; None where it kept nothing.

    Raises `InputError` for a damaged file, and for one of another version.
    """
    if not (folder / PROMOTED).exists():
        return None
    found = _of_this_version(folder / PROMOTED)
    with _Read(folder / PROMOTED):
        agreement = _part(found, "agreement")
        agreement["evolved"] = int(agreement["evolved"])
        return Promoted(
            genes=found["genes"],
            finals=Scores(**_part(found, "finals")),
            multipliers=found.get("multipliers"),
            agreement=Agreement(levels=levels, **agreement),
        )


def save_polished(folder: Path, polished: Polished) -> None:
    """Keep the result of polishing; its genome follows from the settings and the promoted gaits."""
    growth = None if polished.sensitivity is None else polished.sensitivity._asdict()
    found = {name: value for name, value in polished._asdict().items() if name != "genome"}
    found |= {name: getattr(polished, name)._asdict() for name in ("before", "after")}
    found |= {"steps": np.array(polished.steps, float).reshape(-1, len(ClimbStep._fields)), "sensitivity": growth}
    save_arrays(folder / POLISHED, version=KEPT_VERSION, **_flat(found))


def load_polished(folder: Path, genome: Genome) -> Polished | None:
    """What `save_polished` kept, to the last bit, with the `genome` of its genes; None where it kept nothing.

    Raises `InputError` for a damaged file, and for one of another version.
    """
    if not (folder / POLISHED).exists():
        return None
    found = _of_this_version(folder / POLISHED)
    with _Read(folder / POLISHED):
        growth = _part(found, "sensitivity")
        return Polished(
            genes=found["genes"],
            genome=genome,
            improved=bool(found["improved"]),
            before=Scores(**_part(found, "before")),
            after=Scores(**_part(found, "after")),
            steps=tuple(ClimbStep(*row) for row in found["steps"].tolist()),
            horizon=float(found["horizon"]),
            sensitivity=Sensitivity(**{**growth, "unit": str(growth["unit"])}) if growth else None,
            rollouts=int(found["rollouts"]),
            reason=str(found["reason"]),
        )


def check_kept_stages(folder: Path) -> None:
    """Raise `InputError` where a search that is resumed could not read what its later stages kept in the folder."""
    for path in (folder / PROMOTED, folder / POLISHED):
        if path.exists():
            _of_this_version(path)


def _of_this_version(path: Path) -> dict[str, np.ndarray]:
    """The arrays of a file by their names; none has the name "version" in files of before there were versions."""
    found = saved_arrays(path)
    version = found.pop("version", None)
    if version is None or not np.array_equal(version, KEPT_VERSION):
        told = "no version" if version is None else f"version {version}, not {KEPT_VERSION}"
        raise InputError(f"{path}: kept by another release, with {told}; {RUN_OR_RESTART}")
    return found


class _Read:
    """A file of which something is read: what is missing in it is bad input."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        if isinstance(error, KeyError | TypeError):
            raise InputError(f"{self.path}: is not complete: {error}; {RUN_OR_RESTART}") from error


def _flat(parts: dict[str, Any]) -> dict[str, Any]:
    """All arrays by one name each; without what is None."""
    found: dict[str, Any] = {}
    for name, value in parts.items():
        if isinstance(value, dict):
            found |= {f"{name}{SEPARATOR}{key}": item for key, item in value.items() if item is not None}
        elif value is not None:
            found[name] = value
    return found


def _part(arrays: dict[str, np.ndarray], name: str) -> dict[str, Any]:
    """The fields of a part."""
    start = f"{name}{SEPARATOR}"
    return {key.removeprefix(start): value for key, value in arrays.items() if key.startswith(start)}
