"""The problem of a search, which all its stages share."""

from typing import NamedTuple

from jaxgrity.model.scene import Scene
from jaxgrity.search.genome import Genome
from jaxgrity.search.judging import Fitness, Judging, without_force_bounds
from jaxgrity.search.models import model_of
from jaxgrity.stepping.options import Options


class SearchProblem(NamedTuple):
    """What a search does: it varies the quantities of `genome` in the scene's gait, to raise the `fitness`."""

    scene: Scene
    """the robot, with a gait for all quantities that do not vary"""
    genome: Genome
    """encoding of the quantities that vary"""
    duration: float
    """simulated time of each rollout, s"""
    fitness: Fitness
    """value of a gait"""

    @property
    def seeks_orbits(self) -> bool:
        """Whether the gaits' orbits are computed: on uneven ground there is none."""
        ground = self.scene.ground
        return self.fitness.objective.steady and (ground is None or ground.surface is None)

    @property
    def without_force_bounds(self) -> "SearchProblem":
        """The same without bounds on force and power, for most stages of a search: to measure them multiplies costs.

        A search measures them on one robot to choose a gait (`promote`, `kept_or_undone`), on many by `final_verdict`.
        """
        return self._replace(fitness=without_force_bounds(self.fitness))

    def judging(
        self, options: Options = None, *, scene: Scene | None = None, fitness: Fitness | None = None
    ) -> Judging:
        """The judging of its gaits, by `options`: on its own scene and by its own fitness, or on another, by another.

        Raises `InputError` as `resolve` does.
        """
        return Judging((model_of(scene or self.scene, self.duration, options),), self.duration, fitness or self.fitness)
