"""The sliders of the explorer: numbers of a scene, none of them part of a compiled program."""

import dataclasses
from typing import NamedTuple

import equinox as eqx
import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.types import AnyArray
from jaxgrity.model.actuation import waves_ahead
from jaxgrity.model.pulleys import built_lengths
from jaxgrity.model.scene import Scene

LARGEST_PHASE = 6.28
"""Largest phase of a slider, rad: 2 pi rounded down to its steps of 0.01."""


class Knob(NamedTuple):
    """One number with a slider."""

    name: str
    low: float
    high: float
    step: float
    value: float
    """as the scene has it"""
    hint: str

    @property
    def place(self) -> float:
        """Where its slider stands at first: on a step, within the ends."""
        return float(np.clip(np.round(self.value / self.step) * self.step, self.low, self.high))

    def at(self, slider: float) -> float:
        """The number for a place of the slider: the scene's own, to the last bit, while it has not been moved."""
        unmoved = slider == self.place or not np.isfinite(slider)
        return self.value if unmoved else float(np.clip(slider, self.low, self.high))


def knobs(scene: Scene) -> tuple[Knob, ...]:
    """The adjustable numbers of a scene: only those it has. Raises `InputError` without a gait."""
    gait, cables = scene.gait, scene.structure.cables
    if gait is None:
        raise InputError("the scene has no [gait]; the explorer expected one to play with")
    most, fastest = float(np.max(gait.amplitude)), float(np.max(gait.frequency))
    found = [
        Knob("amplitude", 0.0, max(0.6, most), _step(most), most, "of the strongest member; the others go along"),
        Knob(
            "frequency (Hz)",
            min(0.1, fastest / 2),
            max(2.0, 2 * fastest),
            _step(fastest),
            fastest,
            "of the fastest member",
        ),
    ]
    if scene.friction is not None:
        mu = float(np.max(np.asarray(scene.friction.sliding_mu)))
        found.append(Knob("friction", 0.0, max(1.5, 2 * mu), _step(mu), mu, "coefficient of a node that slides"))
    if scene.gravity is not None and scene.up is None:
        found.append(Knob("incline (degrees)", -15.0, 15.0, 0.5, 0.0, "more than the scene's own; it falls towards +x"))
    if cables is not None:
        strain = _prestrain(scene)
        if strain > 0:
            found.append(
                Knob("prestress", 0.0, min(0.8, 2 * strain), _step(strain), strain, "strain of the cables as built")
            )
        found.append(Knob("cable stiffness", 0.5, 2.0, 0.05, 1.0, "times what the scene says"))
    phases = np.mod(np.asarray(gait.phase, float), 2 * np.pi)
    for member, phase in zip(gait.members, phases) if len(phases) <= 12 else ():
        found.append(Knob(f"phase of {member} (rad)", 0.0, LARGEST_PHASE, 0.01, float(phase), "of this member's wave"))
    return tuple(found)


def _step(value: float) -> float:
    """Step of a slider: 0.01, or less where the scene's own number is small, so that it is some 20 steps from 0."""
    return min(0.01, float(10.0 ** np.floor(np.log10(value / 20)))) if value > 0 else 0.01


def adjusted(scene: Scene, values: dict[str, float]) -> Scene:
    """The scene with the knobs at these values; other knobs stay.

    Only arrays of the same shapes change: a program compiled for one setting serves all others.
    """
    own = {knob.name: knob.value for knob in knobs(scene)}

    def scaled(numbers: AnyArray, name: str) -> np.ndarray:
        """The numbers in the knob's ratio to the scene's own; all of them the knob's where these are 0."""
        to, numbers = values.get(name, own[name]), np.asarray(numbers)
        return np.asarray(numbers * (to / own[name])) if own[name] else np.full_like(numbers, to)

    gait, friction, structure = scene.gait, scene.friction, scene.structure
    assert gait is not None, "`knobs` refuses a scene without a gait"
    phase = [values.get(f"phase of {m} (rad)", p) for m, p in zip(gait.members, np.asarray(gait.phase, float))]
    gait = dataclasses.replace(
        waves_ahead(gait, np.array(phase) - np.asarray(gait.phase, float)),
        phase=np.array(phase),
        amplitude=scaled(gait.amplitude, "amplitude"),
        frequency=scaled(gait.frequency, "frequency (Hz)"),
    )
    if "friction" in own and friction is not None:
        names = [field.name for field in dataclasses.fields(friction) if field.name.startswith("mu")]
        friction = dataclasses.replace(
            friction, **{name: scaled(getattr(friction, name), "friction") for name in names}
        )
    if structure.cables is not None:
        strain = values.get("prestress", own["prestress"]) / own["prestress"] if "prestress" in own else 1.0
        cables = _tightened(scene, strain, values.get("cable stiffness", 1.0))
        structure = eqx.tree_at(lambda s: s.cables, structure, cables)
    up = scene.up
    if "incline (degrees)" in own:
        lean = np.radians(values.get("incline (degrees)", 0.0))
        up = np.array([-np.sin(lean), 0.0, np.cos(lean)])
    return dataclasses.replace(scene, gait=gait, friction=friction, structure=structure, up=up)


def _prestrain(scene: Scene) -> float:
    cables = scene.structure.cables
    assert cables is not None, "a structure without cables has no prestress"
    return float(np.mean(1 - np.asarray(cables.rest_length) / built_lengths(cables, scene.structure.nodes)))


def _tightened(scene: Scene, strain: float, stiffness: float):
    """The cables with their prestrain and stiffness times these factors."""
    cables = scene.structure.cables
    assert cables is not None, "a structure without cables has none to tighten"
    built = built_lengths(cables, scene.structure.nodes)
    rest = built - (built - np.asarray(cables.rest_length)) * strain
    return dataclasses.replace(cables, rest_length=rest, stiffness=np.asarray(cables.stiffness) * stiffness)
