"""The main job: evolve a rolling gait that stands perturbation, polish it by gradients, verify it, and show it.

Thousands of rough rollouts screen gaits, the scene's own model goes on with the best, and few exact rollouts judge what
comes out. Every generation is saved: --resume goes on after an interruption, to the very same end. Leaves gait.json,
population.npz, trajectory.npz, figures, an animation, summary.json and a page to open (index.html).
"""

import dataclasses
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from jaxgrity.cli.script import measured

from jaxgrity.cli.progress import Bars
from jaxgrity.cli.simulate import scene_name
from jaxgrity.core.errors import InputError
from jaxgrity.io.scene_files import load_scene
from jaxgrity.report.gait_report import Origin, write_report
from jaxgrity.rollout.uncertainty import Uncertainty
from jaxgrity.search.objectives import ActuatorBounds, Objective, find_objective
from jaxgrity.search.pipeline import SearchResult, search_gaits
from jaxgrity.search.search_config import UNCERTAIN, SearchConfig


@dataclass
class ObjectiveSettings:
    kind: str = "steady speed"
    """steady speed, steady direction, steady turn, distance, direction, speed, cost of transport or straightness"""
    heading: float | None = None
    """rad from +x, for steady direction and direction"""
    turning: float | None = None
    """rad per body length, positive to the left, for steady turn"""
    largest_rate: float | None = 1.0
    """m/s, bound on any actuator's |dL/dt|; None: no bound"""
    largest_force: float | None = None
    """N"""
    largest_power: float | None = 200.0
    """W"""

    @property
    def objective(self) -> Objective:
        """What these settings ask for. Raises `InputError` where it is unknown."""
        kind = find_objective(self.kind)
        known = {part.name for part in dataclasses.fields(kind)}
        given = {"heading": self.heading, "turning": self.turning}
        chosen = {name: value for name, value in given.items() if value is not None}
        for name, value in chosen.items():
            if name not in known:
                raise InputError(f"{name} = {value}: {self.kind!r} has none; expected an objective that has")
        return kind(**chosen)

    @property
    def bounds(self) -> ActuatorBounds:
        """The most that a gait may ask of an actuator."""
        return ActuatorBounds(self.largest_rate, self.largest_force, self.largest_power)


@dataclass
class SearchSettings:
    scene: str = "exact"
    """a scene of the library by its name (reference, exact, uphill), or a scene file (TOML), with a [gait]"""
    out: Path = Path("results/gait_search")
    """folder for everything this command leaves"""
    duration: float = 40.0
    """horizon over which the objective counts, s"""
    population: int = 128
    """gaits in a generation"""
    generations: tuple[int, int] = (10, 2)
    """generations of screening; on the scene's own model, where screening is on its contact twin"""
    optimiser: Literal["genetic", "cma-es"] = "genetic"
    """what makes one generation from the last; cma-es needs the extra `baselines`"""
    robots: int = 4
    """that each gait is tried on in a generation, drawn from what is uncertain"""
    objective: ObjectiveSettings = field(default_factory=ObjectiveSettings)
    """what a rollout is worth"""
    uncertainty: Uncertainty = field(default_factory=lambda: UNCERTAIN)
    """half-widths of what is not known exactly; all zero, with --robots 1 --caution 0: as the model says"""
    caution: float = 1.0
    """standard deviations of its robots that are held against a gait"""
    amplitude: tuple[float, float] | None = (0.05, 0.5)
    """bounds between which each member's amplitude evolves too; None: it stays as the scene's gait says"""
    frequency: tuple[float, float] | None = (0.3, 1.6)
    """bounds (Hz) between which the gait's frequency evolves too; None: likewise"""
    scaled: bool = False
    """whether amplitudes are scaled down to what the bound on the rate allows; else gaits beyond it are lost"""
    overtones: int = 0
    """how many more sines each member's Fourier series has"""
    waves: Literal["every", "axis", "none"] = "every"
    """whether actuators follow each other as every rotation of the robot says, or those about one axis, which lets it
    turn, or each moves as it likes"""
    both_models: bool = True
    """whether the best gaits are tried on both contact models before one is chosen"""
    attracting: bool = True
    """whether, of the best, gaits whose orbit attracts disturbed robots come first"""
    wide: bool = True
    """whether screening looks widely first, and goes on with mutations of the best alone"""
    members: Literal["scene", "struts", "cables"] = "scene"
    """which members may be actuated"""
    active: int | None = None
    """how many of them are, which ones evolves too"""
    polish: Literal["smoothed", "pathwise", "combined", "orbit"] = "smoothed"
    """by which gradient"""
    polish_rollouts: int = 384
    """what polishing may cost; 0: no polish"""
    polish_gaits: int = 1
    """how many of the best gaits are polished"""
    dt: float | None = None
    """step of the scene's own model, s; verified at it and below, as errors ask; without it, the scene decides"""
    seed: int = 0
    """the same seed gives the same search"""
    resume: bool = False
    """go on with the search in the folder, which had the same settings"""
    restart: bool = False
    """begin again where the folder holds an unfinished search"""
    quick: bool = False
    """a small search, mostly compilation: 8 s at most, 16 gaits, 3 generations, 128 rollouts of polish"""

    @property
    def config(self) -> SearchConfig:
        """How to search. Raises `InputError` where the objective is unknown."""
        known = {part.name for part in dataclasses.fields(SearchConfig)}
        same: dict[str, Any] = {name: value for name, value in vars(self).items() if name in known}
        return SearchConfig(**same | {"objective": self.objective.objective, "bounds": self.objective.bounds})


def main(settings: SearchSettings) -> None:
    """Search, and leave gait, figures and page."""
    began = time.perf_counter()
    if settings.quick:
        settings.duration, settings.population, settings.generations = min(settings.duration, 8.0), 16, (3, 2)
        settings.polish_gaits, settings.polish_rollouts = 1, min(settings.polish_rollouts, 128)
    scene, config = load_scene(settings.scene), settings.config
    print(
        f"Searching for a gait of {scene_name(settings.scene)}: gaits evolve on a rough model, the best go on to finer "
        f"ones,\nare polished by gradients, and verified. Programs are compiled first, which takes a minute the first "
        f"time.\nWhat is found goes to {settings.out}/. After Ctrl-C, --resume goes on.\n"
    )
    print(scene.describe(), end="\n\n", flush=True)
    found: dict[str, str] = {}
    with Bars() as bars:

        def report(result: SearchResult) -> None:
            origin = Origin(scene_name(settings.scene), settings.objective.kind, told(settings), measured()["command"])
            found.update(write_report(result, origin, settings.out, bars.show))

        search_gaits(
            scene,
            config,
            folder=settings.out,
            resume=settings.resume,
            restart=settings.restart,
            on_progress=bars.hear,
            report=report,
        )
    print("\n" + "\n".join(f"{name}: {text}" for name, text in found.items()))
    print(f"open {settings.out}/index.html ({time.perf_counter() - began:.0f} s since this command began)")


def told(settings: SearchSettings) -> dict[str, Any]:
    """The settings that decide a search, as they go into its files."""
    return {name: value for name, value in asdict(settings).items() if name not in ("out", "scene")}
