"""The ground tables of a scene file: a surface in place of the plane, and obstacles on it."""

from pathlib import Path
from typing import Annotated

import numpy as np
from msgspec import Meta

from jaxgrity.core.errors import InputError
from jaxgrity.io.files import read_picture
from jaxgrity.io.table_types import NotNegative, Positive, Seed, Table
from jaxgrity.model.height_fields import HeightMap, HeightWaves, bumps, height_map
from jaxgrity.model.solids import Box, Cylinder, Sphere, Stairs
from jaxgrity.model.surface import Surface

Point = tuple[float, float, float]
Sizes = tuple[Positive, Positive, Positive]


class BumpsTable(Table, tag="bumps", tag_field="kind"):
    """Random waves: standard deviation of the height, distance from bump to bump, and the seed."""

    deviation: Positive
    length: Positive
    seed: Seed = 0
    waves: Annotated[int, Meta(ge=1, le=1000)] = 8

    def surface(self, folder: Path) -> Surface:
        return bumps(self.deviation, self.length, self.seed, self.waves)


class StairsTable(Table, tag="stairs", tag_field="kind"):
    """Steps that rise along +x turned by `turn`, from `start` on."""

    rise: Positive
    run: Positive
    steps: Annotated[int, Meta(ge=1, le=1000)] = 1
    start: float = 0.0
    turn: float = 0.0
    rounding: NotNegative = 0.0

    def surface(self, folder: Path) -> Surface:
        return Stairs(self.rise, self.run, self.steps, self.start, self.turn, self.rounding)


class BowlTable(Table, tag="bowl", tag_field="kind"):
    """The lower half of a hollow ball, whose lowest point is the origin."""

    radius: Positive

    def surface(self, folder: Path) -> Surface:
        return Sphere(np.array([0.0, 0.0, self.radius]), self.radius, hollow=True)


class HeightsTable(Table, tag="heights", tag_field="kind"):
    """Measured heights: a table of rows along x, or a picture whose brightness goes from `lowest` to `highest`."""

    size: tuple[Positive, Positive]
    values: list[list[float]] | None = None
    image: str | None = None
    lowest: float = 0.0
    highest: float | None = None
    centre: tuple[float, float] = (0.0, 0.0)

    def surface(self, folder: Path) -> Surface:
        if (self.values is None) == (self.image is None):
            raise InputError("ground.surface: expected either values or image, one of them")
        if self.image is not None:
            if self.highest is None:
                raise InputError("ground.surface.highest: missing; expected the height (m) of white, beside an image")
            table = read_picture(folder / self.image)
            heights = self.lowest + (self.highest - self.lowest) * table[::-1].T
        else:
            rows = self.values or []
            if len({len(row) for row in rows}) != 1:
                raise InputError("ground.surface.values: rows of different lengths; expected a table")
            heights = np.array(rows, float)
        return height_map(heights, self.size, self.centre)


class WavesTable(Table, tag="waves", tag_field="kind"):
    """Single waves, the parts of random bumps: heights, lengths, directions and phases."""

    amplitude: list[float]
    length: list[Positive]
    direction: list[float]
    phase: list[float]

    def surface(self, folder: Path) -> Surface:
        return HeightWaves(
            *(np.array(part, float) for part in (self.amplitude, self.length, self.direction, self.phase))
        )


class SplineTable(Table, tag="spline", tag_field="kind"):
    """The coefficients of a cubic spline, from measured heights: rows along x, from a corner on."""

    coefficients: list[list[float]]
    corner: tuple[float, float]
    spacing: tuple[Positive, Positive]

    def surface(self, folder: Path) -> Surface:
        rows = {len(row) for row in self.coefficients}
        if len(rows) != 1 or min(len(self.coefficients), *rows) < 6:
            raise InputError("ground.surface.coefficients: expected a table of at least 6 by 6, rows of one length")
        return HeightMap(np.array(self.coefficients, float), np.array(self.corner), np.array(self.spacing))


class BoxTable(Table, tag="box", tag_field="kind"):
    centre: Point
    size: Sizes
    turn: float | Point = 0.0
    rounding: NotNegative = 0.0

    def surface(self, folder: Path) -> Surface:
        return Box(np.array(self.centre), np.array(self.size), np.array(self.turn), self.rounding)


class SphereTable(Table, tag="sphere", tag_field="kind"):
    centre: Point
    radius: Positive

    def surface(self, folder: Path) -> Surface:
        return Sphere(np.array(self.centre), self.radius)


class CylinderTable(Table, tag="cylinder", tag_field="kind"):
    start: Point
    end: Point
    radius: Positive
    rounding: NotNegative = 0.0

    def surface(self, folder: Path) -> Surface:
        return Cylinder(np.array(self.start), np.array(self.end), self.radius, self.rounding)


ObstacleTable = BoxTable | SphereTable | CylinderTable
"""Tables of solids on the ground."""
SurfaceTable = BumpsTable | StairsTable | BowlTable | HeightsTable | WavesTable | SplineTable | ObstacleTable
"""Tables of the surfaces that may take the place of the plane."""
