"""The one error for users: bad input, refused in one line before anything compiles."""

import difflib
from collections.abc import Iterable


class InputError(ValueError):
    """A scene, a gait or an option that cannot be simulated: what, where, the value received, what was expected."""


def unknown(name: str, known: Iterable[str]) -> str:
    """The word "unknown" for a message, with the one known name that begins so, or the closest, if one is close."""
    known = list(known)
    longer = [each for each in known if name and each.startswith(str(name))]
    nearest = longer if len(longer) == 1 else difflib.get_close_matches(str(name), known, n=1)
    return f"unknown; perhaps you meant {nearest[0]}" if nearest else "unknown"


def check_known(what: str, name: str, known: Iterable[str]) -> None:
    """Raise `InputError` for a name that is none of the known ones."""
    if name not in known:
        raise InputError(f"{what} = {name!r}: {unknown(name, known)}; expected one of {', '.join(known)}")
