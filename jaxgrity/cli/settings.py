"""Settings of every command, with the texts of --help, which is quick since nothing here imports JAX or Matplotlib."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional


@dataclass
class SimulateSettings:
    """Simulate a robot: once with the gait of its scene, or once for each row of a CSV file of phases."""

    scene: Annotated[str, Positional]
    """name of a library scene (reference, exact, uphill), or a scene file (TOML)"""
    gaits: Path | None = None
    """CSV file without a header; each row has the phases (rad) of one gait"""
    gait: str | None = None
    """name of a library gait, or the gait.json of a search; replaces the gait of the scene"""
    duration: float = 10.0
    """simulated time, s"""
    method: str | None = None
    """rk4, tsit5, dopri8, kvaerno3, kvaerno5, verlet or complementarity; by default the scene decides"""
    dt: float | None = None
    """fixed time step, s; by default adaptive methods adapt their step, and other methods take a safe one"""
    dtype: Literal["float32", "float64"] = "float64"
    """floating-point precision of the simulation"""
    any_step: bool = False
    """allow time steps beyond the stable limit, which are otherwise refused"""
    diagnose: bool = True
    """report error bars, energy audit and sensitivity; costs several more simulations"""
    animation: Literal["none", "gif", "mp4"] = "none"
    """write an animated picture of a single simulation; mp4 needs imageio-ffmpeg (pip install 'jaxgrity[video]')"""
    fps: float = 25.0
    """frame rate of the animated picture, frames per second"""
    width: int = 640
    """width of the animated picture, pixels"""
    camera: Literal["whole", "follow"] = "whole"
    """view of the animated picture: the whole path, or a camera that follows the robot"""
    replay: bool = True
    """write a page that plays a single simulation in 3D; needs viser (pip install 'jaxgrity[view]')"""
    out: Path = Path("results/simulate")
    """folder for summary.json and figures; a single simulation adds trajectory.npz and replay.html"""
    quick: bool = False
    """simulate at most 2 s"""


@dataclass
class DemoSettings:
    """Watch a six-strut robot roll in the browser."""

    browser: bool = True
    """open the replay in a browser"""
    out: Path = Path("results/demo")
    """folder for the files of the simulation"""
    quick: bool = False
    """simulate at most 2 s"""


@dataclass
class ObjectiveSettings:
    kind: str = "steady speed"
    """steady speed, steady direction, steady turn, distance, direction, speed, cost of transport, straightness or jump
    height"""
    heading: float | None = None
    """heading for steady direction and direction, rad from +x"""
    turning: float | None = None
    """turning for steady turn, rad per body length, positive to the left"""
    largest_rate: float | None = 1.0
    """bound on the rate |dL/dt| of each actuator after the gait's ramp, m/s; None: no bound"""
    largest_force: float | None = None
    """bound on the force of each actuator, N; None: no bound"""
    largest_power: float | None = 200.0
    """bound on the power of each actuator, W; None: no bound"""


@dataclass
class UncertaintySettings:
    phase: float = 0.03
    """half-width of the phase of each actuated member, rad"""
    actuation: float = 0.02
    """half-width of the amplitude of each actuated member, as a fraction"""
    friction: float = 0.2
    """half-width of the friction coefficient, as a fraction; one value for all nodes of a robot"""
    cable_stiffness: float = 0.05
    """half-width of the cable stiffness, as a fraction; one value for all cables of a robot"""
    prestress: float = 0.0
    """half-width of the cable tension in the given shape, as a fraction; one value for all cables of a robot"""
    node_mass: float = 0.05
    """half-width of the mass of each node, as a fraction"""
    slope: float = 0.0
    """largest extra slope of the ground, in a random direction, rad"""
    terrain: float = 0.0
    """half-width of the shift of uneven ground in x and in y, m; its height is adapted to keep the start clear of it"""


@dataclass
class SearchSettings:
    """Search for a rolling gait: evolve it, polish it by gradients, verify it, and show it.

    Thousands of rough simulations screen gaits. The scene's own model improves the best of them, and a few fine
    simulations verify the result. Every generation is saved: --resume continues an interrupted search to the same
    result. Writes gait.json, population.npz, trajectory.npz, summary.json, figures, an animation and index.html.
    """

    scene: str = "exact"
    """name of a library scene (reference, exact, uphill), or a scene file (TOML) with a [gait]"""
    out: Path = Path("results/gait_search")
    """folder for all files of the search"""
    duration: float = 40.0
    """simulated time of each rollout, s"""
    population: int = 128
    """number of gaits per generation"""
    generations: tuple[int, int] = (10, 2)
    """numbers of generations: of screening, and then on the scene's own model. With --no-wide, the second number
    counts only if screening uses the contact twin"""
    optimiser: Literal["genetic", "cma-es"] = "genetic"
    """search method; cma-es needs evosax (pip install 'jaxgrity[baselines]')"""
    robots: int = 4
    """number of perturbed robots that evaluate each gait in a generation"""
    objective: ObjectiveSettings = field(default_factory=ObjectiveSettings)
    """objective of the search"""
    uncertainty: UncertaintySettings = field(default_factory=UncertaintySettings)
    """half-widths by which perturbed robots differ; for no perturbation set all to 0, with --robots 1 --caution 0"""
    caution: float = 1.0
    """number of standard deviations over perturbed robots that are subtracted from the mean objective"""
    amplitude: tuple[float, float] | None = (0.05, 0.5)
    """bounds of each member's amplitude; None: the amplitudes of the scene's gait are kept"""
    frequency: tuple[float, float] | None = (0.3, 1.6)
    """bounds of the gait's frequency, Hz; None: the frequency of the scene's gait is kept"""
    ramp: float | None = 0.75
    """time in which gaits reach their full amplitude, s; None: that of the scene's gait"""
    scaled: bool = True
    """scale amplitudes down to the bound on the rate, ramp included; otherwise gaits beyond the bound come last"""
    overtones: int = 0
    """number of overtones in each member's Fourier series"""
    waves: Literal["every", "axis", "none"] = "every"
    """symmetry of the gaits: all rotations of the robot, those about one axis (the robot can turn), or none"""
    both_models: bool = True
    """evaluate the best gaits on both contact models before one is chosen"""
    attracting: bool = True
    """among the best gaits, prefer those whose orbit attracts disturbed robots"""
    wide: bool = True
    """begin screening with many random gaits, and continue with mutations of the best"""
    members: Literal["scene", "struts", "cables"] = "scene"
    """members to actuate: those of the scene's gait, all struts, or all cables"""
    active: int | None = None
    """number of actuated members; the search also chooses which, and gaits are no waves; None: all of them"""
    polish: Literal["smoothed", "pathwise", "combined", "orbit"] = "smoothed"
    """gradient for polishing"""
    polish_rollouts: int = 9216
    """number of simulations that polishing may use; 0: no polish"""
    polish_overtones: int = 4
    """number of overtones that polishing adds to gaits that are waves; at least those of the search; none if the gait
    of the scene has its own"""
    polish_gaits: int = 1
    """number of the best gaits that are polished"""
    dt: float | None = None
    """time step of the scene's own model, s; by default the scene decides; verification takes smaller steps too"""
    seed: int = 0
    """seed of the random number generator"""
    resume: bool = False
    """continue the search in the folder; its settings must be the same"""
    restart: bool = False
    """start again if the folder holds an unfinished search"""
    quick: bool = False
    """small search: rollouts of at most 16 s, 64 gaits, 3 generations of screening, 256 simulations of polish"""


@dataclass
class CompareSettings:
    """Compare gait searches: their settings, what they found, and how far you can trust it."""

    runs: Annotated[tuple[Path, ...], Positional]
    """result folders of searches"""
    out: Path = Path("results/compare_gaits")
    """folder for comparison.json and comparison.png"""
    quick: bool = False
    """no effect, since this command is quick"""


@dataclass
class DiagnoseSettings:
    """Report how far you can trust a simulation: error bars, energy and momentum, sensitivity, penetration."""

    scene: Annotated[str, Positional]
    """name of a library scene (reference, exact, uphill), or a scene file (TOML)"""
    gait: str | None = None
    """name of a library gait, or the gait.json of a search; replaces the gait of the scene"""
    duration: float = 10.0
    """simulated time, s"""
    method: str | None = None
    """rk4, tsit5, dopri8, kvaerno3, kvaerno5, verlet or complementarity; by default the scene decides"""
    dt: float | None = None
    """fixed time step, s; by default adaptive methods adapt their step, and other methods take a safe one"""
    dtype: Literal["float32", "float64"] = "float64"
    """floating-point precision of the simulation"""
    out: Path = Path("results/diagnose")
    """folder for diagnosis.json and path.png"""
    quick: bool = False
    """simulate at most 2 s"""


@dataclass
class ExploreSettings:
    """Open a page with sliders for the robot, its gait and its ground, and watch how the motion changes."""

    scene: Annotated[str, Positional] = "exact"
    """name of a library scene (reference, exact, uphill), or a scene file (TOML)"""
    duration: float = 10.0
    """simulated time, s"""
    host: str = "127.0.0.1"
    """network address of the server; any other than the default lets other machines connect"""
    port: int = 8080
    """port of the server; if it is taken, the next free one is used"""
    browser: bool = True
    """open the page in a browser"""


@dataclass
class InspectSettings:
    """Report on a structure's statics: self-stress, mechanisms, stability, member forces and natural frequencies."""

    scene: Annotated[str, Positional]
    """name of a library scene (reference, exact, uphill), or a scene file (TOML)"""
    out: Path = Path("results/inspect")
    """folder for inspection.json and forces.png"""
    quick: bool = False
    """no effect, since this command is quick"""


@dataclass
class CatalogueSettings:
    """List the structures of the catalogue, each with its keys in a scene file and a picture."""

    out: Path = Path("results/catalogue")
    """folder for catalogue.json, a picture of each structure, and one of all"""
    quick: bool = False
    """print the list without drawing pictures"""


@dataclass
class TrainSettings:
    """Learn a policy by reinforcement learning, test it on new episodes, and save it with a replay.

    Progress is saved every 20 updates: --resume continues after an interruption. Load policy.eqx with
    `jaxgrity.control.load_policy`.
    """

    task: Annotated[str, Positional]
    """task to learn: speed, heading, goal, slope, bumps or recover"""
    scene: str = "exact"
    """name of a library scene, or a scene file (TOML); the members of its gait are actuated"""
    gait: str | None = None
    """name of a library gait, or the gait.json of a search; replaces the gait of the scene"""
    updates: int = 500
    """number of updates of the policy; with 512 robots each takes 65536 control periods"""
    robots: int = 512
    """number of robots that learn side by side"""
    dt: float | None = 0.01
    """time step, s; None: the scene decides"""
    episodes: int = 64
    """number of new episodes that test the policy"""
    seed: int = 0
    """seed of the random number generator"""
    resume: bool = False
    """continue the run in the folder; its settings must be the same"""
    out: Path = Path("results/train")
    """folder for policy.eqx, learner.eqx, curve.json, learning.png, summary.json and replay.html"""
    quick: bool = False
    """two tiny updates, to see the course of a run"""


@dataclass
class ConvertSettings:
    """Convert a robot between file formats: TOML, NTRT (YAML), MuJoCo (XML), MATLAB, CSV, URDF, GLB, OBJ."""

    source: Annotated[str, Positional]
    """file to read (.toml, .yaml, .xml, .mat, .csv), or name of a library scene"""
    target: Annotated[Path, Positional]
    """file to write (.toml, .yaml, .xml, .mat, .csv, .urdf, .glb, .obj)"""
    settle: bool = False
    """first let the structure come to rest without gravity, and set it down on its ground"""
    unit: float | None = None
    """length unit of an NTRT file, m; by default 0.1. Other files are in metres"""
    drop: tuple[str, ...] = ()
    """parts to leave out: contact, radius, friction, limits, damping, actuators, air, forces of a MuJoCo model; radius,
    wrapping, friction of a NTRT file"""
    keyframe: str = ""
    """keyframe of a MuJoCo model in which the robot starts; by default it starts where the model places its bodies"""
    columns: tuple[str, ...] = ()
    """your names of a table's columns, such as X=x_m; colour= leaves out a column"""
    quick: bool = False
    """no effect, since this command is quick"""
