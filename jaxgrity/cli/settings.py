"""What each command can be asked for: read, and shown by --help, before anything of JAX or of a figure is imported."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional


@dataclass
class SimulateSettings:
    """Roll a scene out: once, with its own gait, or once for each row of phases in a CSV file."""

    scene: Annotated[str, Positional]
    """a scene of the library by its name (reference, exact, uphill), or a scene file (TOML)"""
    gaits: Path | None = None
    """CSV without a header: the phases (rad) of one gait a row"""
    gait: str | None = None
    """a gait of the library by its name, or the gait.json of a search, in place of the scene's own"""
    duration: float = 10.0
    """s"""
    method: str | None = None
    """rk4, tsit5, dopri8, kvaerno3, kvaerno5, verlet or complementarity; without it, the scene decides"""
    dt: float | None = None
    """fixed step, s; without it, adaptive methods adapt theirs, others take a safe one"""
    dtype: Literal["float32", "float64"] = "float64"
    """precision of the rollout"""
    any_step: bool = False
    """let a step pass that would blow up"""
    diagnose: bool = True
    """say how far the result can be trusted: error bars, energy audit, sensitivity; takes several more rollouts"""
    animation: Literal["none", "gif", "mp4"] = "none"
    """also leave an animated picture of a single rollout; mp4 needs imageio-ffmpeg (pip install 'jaxgrity[video]')"""
    fps: float = 25.0
    """frames a second of the animated picture"""
    width: int = 640
    """pixels of the animated picture"""
    camera: Literal["whole", "follow"] = "whole"
    """whether the animated picture shows all of the way, or a camera goes along with the robot"""
    replay: bool = True
    """leave a page that plays a single rollout in 3D, where viser is installed (pip install 'jaxgrity[view]')"""
    out: Path = Path("results/simulate")
    """folder for summary.json, figures, and trajectory.npz and replay.html of a single rollout"""
    quick: bool = False
    """at most 2 s of motion"""


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


@dataclass
class UncertaintySettings:
    phase: float = 0.03
    """rad, of each actuated member"""
    actuation: float = 0.02
    """share of the amplitude, of each actuated member"""
    friction: float = 0.2
    """share of mu, alike at all nodes"""
    cable_stiffness: float = 0.05
    """share, alike in all cables"""
    prestress: float = 0.0
    """share of the tension in the shape as built, alike in all cables, by their rest lengths"""
    node_mass: float = 0.05
    """share, of each node"""
    slope: float = 0.0
    """rad, by which the ground leans more than the scene says, in any direction"""
    terrain: float = 0.0
    """m, by which uneven ground is moved in x and in y, and up or down, so that the robot starts as high above it"""


@dataclass
class SearchSettings:
    """The main job: evolve a rolling gait that stands perturbation, polish it by gradients, verify it, and show it.

    Thousands of rough rollouts screen gaits, the scene's own model goes on with the best, and few exact rollouts judge
    what comes out. Every generation is saved: --resume goes on after an interruption, to the very same end. Leaves
    gait.json, population.npz, trajectory.npz, figures, an animation, summary.json and a page to open (index.html).
    """

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
    uncertainty: UncertaintySettings = field(default_factory=UncertaintySettings)
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
    polish_rollouts: int = 3072
    """what polishing may cost; 0: no polish"""
    polish_overtones: int = 4
    """how many overtones polishing shapes of gaits that are waves, those of the search at least"""
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


@dataclass
class CompareSettings:
    """Compare gait searches: how they were searched, what they found, and how far that can be trusted."""

    runs: Annotated[tuple[Path, ...], Positional]
    """folders that searches left"""
    out: Path = Path("results/compare_gaits")
    """folder for comparison.json and comparison.png"""
    quick: bool = False
    """it is quick anyway"""


@dataclass
class DiagnoseSettings:
    """Say how far one rollout of a scene can be trusted: error bars, energy and momentum, sensitivity, penetration."""

    scene: Annotated[str, Positional]
    """a scene of the library by its name (reference, exact, uphill), or a scene file (TOML)"""
    gait: str | None = None
    """a gait of the library by its name, or the gait.json of a search, in place of the scene's own"""
    duration: float = 10.0
    """s"""
    method: str | None = None
    """rk4, tsit5, dopri8, kvaerno3, kvaerno5, verlet or complementarity; without it, the scene decides"""
    dt: float | None = None
    """fixed step, s; without it, adaptive methods adapt theirs, others take a safe one"""
    dtype: Literal["float32", "float64"] = "float64"
    """precision of the rollout"""
    out: Path = Path("results/diagnose")
    """folder for diagnosis.json and path.png"""
    quick: bool = False
    """at most 2 s of motion"""


@dataclass
class ExploreSettings:
    """Open a page on this machine whose sliders change a robot, its gait and its ground, and that shows the motion."""

    scene: Annotated[str, Positional] = "exact"
    """a scene of the library by its name (reference, exact, uphill), or a scene file (TOML)"""
    duration: float = 10.0
    """s of motion"""
    host: str = "127.0.0.1"
    """address to answer at; any but this machine's own lets others in"""
    port: int = 8080
    """or the next that is free"""
    browser: bool = True
    """open the page in a browser"""


@dataclass
class InspectSettings:
    """Report on a structure's statics: self-stress, mechanisms, stability, member forces and natural frequencies."""

    scene: Annotated[str, Positional]
    """a scene of the library by its name (reference, exact, uphill), or a scene file (TOML)"""
    out: Path = Path("results/inspect")
    """folder for inspection.json and forces.png"""
    quick: bool = False
    """it is quick anyway"""


@dataclass
class CatalogueSettings:
    """List the structures of the catalogue, each with its keys in a scene file and a picture."""

    out: Path = Path("results/catalogue")
    """folder for catalogue.json, a picture of each structure, and one of all"""
    quick: bool = False
    """the list alone, without pictures"""


@dataclass
class TrainSettings:
    """Learn a policy by reinforcement learning, save it, judge it on new episodes, and leave a replay.

    Every 20 updates are saved: --resume goes on after an interruption. `jaxgrity.control.load_policy` loads policy.eqx.
    """

    task: Annotated[str, Positional]
    """speed, heading, goal, slope, bumps or recover"""
    scene: str = "exact"
    """a scene of the library by its name, or a scene file (TOML); its gait says which members are actuated"""
    gait: str | None = None
    """a gait in place of the scene's own"""
    updates: int = 500
    """of the policy; 65536 control periods each, with 512 robots"""
    robots: int = 512
    """side by side"""
    dt: float | None = 0.01
    """step, s; without it, the scene decides"""
    episodes: int = 64
    """new episodes, by which the policy is judged"""
    seed: int = 0
    """seed of the random number generator"""
    resume: bool = False
    """go on from what an earlier run with the same settings saved in the folder"""
    out: Path = Path("results/train")
    """folder for policy.eqx, learner.eqx, curve.json, learning.png, summary.json and replay.html"""
    quick: bool = False
    """two tiny updates: to see how it goes on"""


@dataclass
class ConvertSettings:
    """Turn a robot's file into another kind of file: TOML, YAML of NTRT, XML of MuJoCo, MATLAB, CSV, GLB, OBJ."""

    source: Annotated[str, Positional]
    """the file to read (.toml, .yaml, .xml, .mat, .csv), or a scene of the library by its name"""
    target: Annotated[Path, Positional]
    """the file to write (.toml, .xml, .mat, .csv, .glb, .obj)"""
    settle: bool = False
    """let the structure come to rest first, without gravity, and set it down on its ground"""
    unit: float = 0.1
    """m, the unit of length of NTRT's files"""
    drop: tuple[str, ...] = ()
    """kinds of what a MuJoCo model may lose: contact, radius, friction, limits, damping, actuators, air, forces"""
    quick: bool = False
    """it is quick anyway"""
