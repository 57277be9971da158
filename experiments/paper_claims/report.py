"""What the check of a claim leaves: rows with verdicts, and what its figure shows."""

from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from jaxgrity import ConeFriction, ExactGround, Members, Scene, Structure, load_scene

HOLDS, CONDITIONAL, FAILS = VERDICTS = "holds", "holds with a condition", "does not hold"

PROGRAM, TEXT, REFERENCE = "paper_program", "paper_text", "reference"
"""names of scenes: the robot of the paper's program, of its text, and the project's own"""
CALLED = {PROGRAM: "paper's program", TEXT: "paper's text", REFERENCE: "reference robot"}
"""what figures call them"""


class Row(NamedTuple):
    """One verdict."""

    claim: str
    section: str
    """of the paper"""
    scene: str
    measured: str
    verdict: str
    why: str


class Report(NamedTuple):
    """One claim, checked."""

    title: str
    rows: list[Row]
    picture: str
    """name of its figure, whose caption is in docs/paper.md"""
    drawn: dict[str, Any]
    """what the module's function `figure` takes, as JSON"""


def verdict(holds: bool, under_condition: bool = False) -> str:
    """The verdict that follows: the claim as it stands, or where it holds under some condition only."""
    return HOLDS if holds else CONDITIONAL if under_condition else FAILS


def scenes() -> dict[str, Scene]:
    """The three scenes by their names."""
    return {name: load_scene(name) for name in (PROGRAM, TEXT, REFERENCE)}


def without(scene: Scene, *parts: str) -> Scene:
    """The scene without some of its parts."""
    where = lambda s: [getattr(s, part) for part in parts]  # noqa: E731
    return eqx.tree_at(where, scene, [None] * len(parts), is_leaf=lambda x: x is None)


def hardened(scene: Scene) -> Scene:
    """The same robot with rigid struts, exact contact and Coulomb's cone."""
    structure, ground, friction = scene.structure, scene.ground, scene.friction
    struts = Members(structure.struts.edges, None, structure.struts.rest_length)
    return Scene(
        Structure(structure.nodes, structure.node_mass, struts, structure.cables),
        scene.gravity,
        scene.node_damping,
        ExactGround(ground.incline),
        ConeFriction(friction.sliding_mu),
        scene.gait,
    )


def stiffened(scene: Scene, K: float) -> Scene:
    """The same robot with struts of stiffness K, N/m."""
    count = len(scene.structure.struts.edges)
    return eqx.tree_at(lambda s: s.structure.struts.stiffness, scene, np.full(count, K))


def grounded(scene: Scene, k_n: float) -> Scene:
    """The same robot on ground of stiffness k_n, N/m."""
    return eqx.tree_at(lambda s: s.ground.stiffness, scene, np.asarray(k_n))


def thinned(values: np.ndarray, most: int = 150) -> np.ndarray:
    """At most so many of the values, evenly spread: a panel has few more pixels."""
    return np.asarray(values)[:: -(-len(values) // most)]


def significant(value: float, unit: str = "") -> str:
    """Three significant digits, with the unit."""
    return f"{value:.3g} {unit}".rstrip()
