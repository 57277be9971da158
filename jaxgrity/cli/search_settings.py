"""Settings of the search, with the texts of --help."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import arg

KINDS = (
    "steady speed, steady direction, steady turn, distance, direction, speed, cost of transport, straightness, "
    "jump height or quick start"
)
"""Objectives, as --help lists them: in a docstring of two lines, tyro would keep the line break."""


@dataclass
class ObjectiveSettings:
    kind: Annotated[str, arg(help=KINDS)] = "steady speed"
    heading: float | None = None
    """heading for steady direction and direction, rad from +x"""
    sideways: float | None = None
    """for steady direction, share of the displacement across the heading that is subtracted; None: none of it"""
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
    """name of a library scene (exact, reference, uphill, steep, softer, three-bar), or a file (TOML) with a [gait]"""
    gait: str | None = None
    """gait to begin with: name of a library gait, or a gait.json; None: random gaits"""
    out: Path = Path("results/gait_search")
    """folder for all files of the search"""
    duration: float = 40.0
    """simulated time of each rollout, s"""
    population: int = 128
    """number of gaits per generation"""
    generations: tuple[int, int] = (10, 2)
    """numbers of generations: of screening, and then on the scene's own model (--no-wide: if screening used a twin)"""
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
    """begin screening with many random gaits, and continue with children of the best eighth"""
    members: Literal["scene", "struts", "cables"] = "scene"
    """members to actuate: those of the scene's gait, all struts, or all cables"""
    active: int | None = None
    """number of actuated members; the search also chooses which, and gaits are no waves; None: all of them"""
    polish: Literal["smoothed", "pathwise", "combined", "orbit"] = "smoothed"
    """gradient for polishing"""
    polish_rollouts: int = 9216
    """number of simulations that polishing may use; 0: no polish"""
    polish_overtones: int = 4
    """number of overtones that polishing adds to waves (at least the search's), unless the scene's gait has its own"""
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
    """small search: at most 16 s, 64 gaits, 3 generations of screening and 2 after it, 256 simulations of polish"""
