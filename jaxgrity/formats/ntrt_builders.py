"""Builders of NTRT's files: the tags that they match, and the parameters of what they make."""

from collections.abc import Collection
from typing import Any, NamedTuple

from jaxgrity.core.errors import InputError
from jaxgrity.formats.foreign import finite, not_negative, positive, short

CABLES = (
    "tgBasicActuatorInfo",
    "tgBasicContactCableInfo",
    "tgKinematicActuatorInfo",
    "tgKinematicContactCableInfo",
)
"""Builders of cables in NTRT."""
WRAPPING = ("tgBasicContactCableInfo", "tgKinematicContactCableInfo")
"""Builders of strings that bodies deflect."""
RIGID_BUILDERS = ("tgRodInfo", "tgBoxInfo")
"""Builders of what is rigid between two nodes; tgSphereInfo makes a sphere of one node."""
DEFAULTS: dict[str, dict[str, float]] = {
    "tgRodInfo": {"radius": 0.5, "density": 1.0, "friction": 1.0},
    "tgBoxInfo": {"width": 1.0, "height": 1.0, "density": 1.0, "friction": 1.0},
    "tgSphereInfo": {"radius": 0.5, "density": 1.0, "friction": 1.0},
    **{
        kind: {
            **{"stiffness": 1000.0, "damping": 10.0, "pretension": 0.0, "rotation": 0.0},
            **{"moveCablePointAToEdge": 1.0, "moveCablePointBToEdge": 1.0},
        }
        for kind in CABLES
    },
}
"""NTRT's own defaults of the parameters that are used, in its units."""
UNUSED = {
    "roll_friction", "restitution", "history", "max_tension", "target_velocity", "min_actual_length",
    "min_rest_length", "radius", "motor_friction", "motor_inertia", "back_drivable",
    "rollFriction", "hist", "maxTens", "targetVelocity", "minActualLength", "minRestLength",
}  # fmt: skip
"""Parameters that move nothing. Those of motors wait for a controller, and NTRT multiplies the others by a number of
its ground that is 0. The last six are names in NTRT's first builder of files."""
TRUTH = {"true": 1.0, "yes": 1.0, "on": 1.0, "y": 1.0, "false": 0.0, "no": 0.0, "off": 0.0, "n": 0.0}
"""YAML's words, in any case, for true and false."""


class Builder(NamedTuple):
    """How NTRT makes a rod, a string or a sphere of pairs and nodes that have all of some tags."""

    kind: str
    tags: frozenset[str]
    given: dict[str, float]


NTRT_BUILDERS = tuple(
    Builder(kind, frozenset({tag}), DEFAULTS[kind])
    for tag, kind in {"rod": "tgRodInfo", "string": CABLES[0], "box": "tgBoxInfo", "sphere": "tgSphereInfo"}.items()
)
"""Those that NTRT has before it reads any file."""


def read_builder(tags: str, given: dict[str, Any], parameters: dict[str, Any]) -> Builder:
    """A builder of a file. Raises `InputError` where its class or a parameter is unknown, or a value impossible."""
    where = f"builders.{tags}"
    kind = given.get("class")
    if kind not in DEFAULTS:
        raise InputError(f"{where}.class = {short(kind)}: expected one of {', '.join(DEFAULTS)}")
    found = dict(DEFAULTS[kind])
    for name, value in parameters.items():
        place = f"{where}.parameters.{name}"
        if name in found and name.startswith("move"):
            if str(value).lower() not in TRUTH:
                raise InputError(f"{place} = {short(value)}: expected true or false")
            found[name] = TRUTH[str(value).lower()]
        elif name in found:
            check = {"stiffness": positive, "rotation": finite, "pretension": finite}.get(name, not_negative)
            found[name] = check(value, place)
        elif name not in UNUSED:
            raise InputError(f"{place} is unknown; expected one of {', '.join(found)}")
    return Builder(kind, frozenset(tags.split()), found)


def builder_of(
    builders: list[Builder], tags: frozenset[str], own: frozenset[str], kinds: Collection[str]
) -> Builder | None:
    """The builder that NTRT takes: of those whose tags are all there, or are the substructure's `own`, the last one."""
    return next((each for each in reversed(builders) if each.kind in kinds and each.tags - own <= tags), None)
