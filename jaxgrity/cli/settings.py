"""Settings of every command but the search, with the texts of --help; nothing here imports JAX or Matplotlib."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional


@dataclass
class SimulateSettings:
    """Simulate a robot: once with the gait of its scene, or once for each row of a CSV file of phases."""

    scene: Annotated[str, Positional]
    """name of a library scene (exact, reference, uphill, steep, softer, three-bar), or a scene file (TOML)"""
    gaits: Path | None = None
    """CSV file without a header; each row has the phases (rad) of one gait"""
    gait: str | None = None
    """name of a library gait, or the gait.json of a search; replaces the gait of the scene"""
    duration: float = 10.0
    """simulated time, s"""
    method: str | None = None
    """rk4, tsit5, dopri8, kvaerno3, kvaerno5, verlet, complementarity or complementarity2; by default automatic"""
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
    """name of a library scene (exact, reference, uphill, steep, softer, three-bar), or a scene file (TOML)"""
    gait: str | None = None
    """name of a library gait, or the gait.json of a search; replaces the gait of the scene"""
    duration: float = 10.0
    """simulated time, s"""
    method: str | None = None
    """rk4, tsit5, dopri8, kvaerno3, kvaerno5, verlet, complementarity or complementarity2; by default automatic"""
    dt: float | None = None
    """fixed time step, s; by default adaptive methods adapt their step, and other methods take a safe one"""
    dtype: Literal["float32", "float64"] = "float64"
    """floating-point precision of the simulation"""
    out: Path = Path("results/diagnose")
    """folder for diagnosis.json and path.png"""
    quick: bool = False
    """simulate at most 2 s"""


@dataclass
class ValidateSettings:
    """Compare recorded motions of a robot with their simulation, and identify parameters from a part of them.

    A recording is a table (CSV) with columns t (s), x0, y0, z0, ... (m), empty where a node was not seen, and commands
    of members, such as "rest length 3" (m) or "contraction 3". The simulation starts from the first pose. Parameters
    are fitted to the first half of one recording, or to all but the last one, and are tested on the rest.
    """

    scene: Annotated[str, Positional]
    """name of a library scene (exact, reference, uphill, steep, softer, three-bar), or a scene file (TOML)"""
    data: tuple[Path, ...]
    """recordings of the robot (CSV, or JSON with the ends of its rods)"""
    unit: float = 1.0
    """length unit of the recordings, m"""
    identify: tuple[str, ...] = ()
    """parameters to fit, such as structure.cables.stiffness, or friction.mu=0.2 with its relative error (else 0.3)"""
    noise: float | None = None
    """standard deviation of a recorded coordinate, m; by default 0.2 % of a body length"""
    windows: int = 1
    """number of parts of each fitted recording that start anew; take several for long motions"""
    gait: str | None = None
    """name of a library gait, or the gait.json of a search; replaces the gait of the scene"""
    method: str | None = None
    """rk4, tsit5, dopri8, kvaerno3, kvaerno5, verlet, complementarity or complementarity2; by default automatic"""
    dt: float | None = None
    """fixed time step, s; by default adaptive methods adapt their step, and other methods take a safe one"""
    out: Path = Path("results/validate")
    """folder for summary.json and recorded.png"""
    quick: bool = False
    """at most 2 s of each recording, and no second fit on the other contact model"""


@dataclass
class ExploreSettings:
    """Open a page with sliders for the robot, its gait and its ground, and watch how the motion changes."""

    scene: Annotated[str, Positional] = "exact"
    """name of a library scene (exact, reference, uphill, steep, softer, three-bar), or a scene file (TOML)"""
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
    """name of a library scene (exact, reference, uphill, steep, softer, three-bar), or a scene file (TOML)"""
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
    """Convert a robot between file formats: TOML, NTRT (YAML), MuJoCo (XML), MATLAB, CSV, JSON, URDF, GLB, OBJ."""

    source: Annotated[str, Positional]
    """file to read (.toml, .yaml, .xml, .mat, .csv, .json), or name of a library scene"""
    target: Annotated[Path, Positional]
    """file to write (.toml, .yaml, .xml, .mat, .csv, .urdf, .glb, .obj)"""
    settle: bool = False
    """first let the structure come to rest without gravity, and set it down on its ground"""
    unit: float | None = None
    """length unit of an NTRT file (by default 0.1) or a JSON file (1), m. Other files are in metres"""
    drop: tuple[str, ...] = ()
    """parts of a MuJoCo, NTRT or JSON file to leave out, such as friction; the error for another word lists all"""
    mass_at_ends: bool = False
    """put the mass of rods at their ends: a search takes a fraction of the time, but rods are harder to turn"""
    keyframe: str = ""
    """keyframe of a MuJoCo model in which the robot starts; by default it starts where the model places its bodies"""
    columns: tuple[str, ...] = ()
    """your names of a table's columns, such as X=x_m; colour= leaves out a column"""
    quick: bool = False
    """no effect, since this command is quick"""
