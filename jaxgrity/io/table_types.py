"""The common base of a scene file's tables: no unknown keys, and numbers within limits."""

from typing import Annotated, ClassVar

import msgspec
from msgspec import Meta

Positive = Annotated[float, Meta(gt=0)]
NotNegative = Annotated[float, Meta(ge=0)]
Share = Annotated[float, Meta(ge=0, lt=1)]
Seed = Annotated[int, Meta(ge=0)]
Number = Annotated[int, Meta(ge=0)]
Pair = tuple[int, int]


class Table(msgspec.Struct, forbid_unknown_fields=True):
    """A table of a scene file; unknown keys are refused."""

    elsewhere: ClassVar[dict[str, str]] = {}
    """what to do in place of keys that one might look for in this table, by these keys"""
