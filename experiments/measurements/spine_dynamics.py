"""Whether the camera can tell the damping of the measured spine: its mean response to commands, beside that of its
slowest mode, whose damping ratio is scanned.
"""

import numpy as np
from measurements.measurement import Figure, Record, measurement
from measurements.pages import table
from measurements.spine_robot import FOLDER, commanded, load_spine, numbers, read_table, resting_shapes
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import least_squares

from jaxgrity.statics import vibration_modes

RATIOS = tuple(np.geomspace(0.01, 1.0, 13).tolist())
"""damping over critical damping"""
STEP = 2e-3
"""s, of the simulated response"""
WIDER = 3.84
"""of chi^2 per degree of freedom at its least: by which it may rise within an interval of 95 %"""


@measurement(page="validation.md", quick={"ratios": (0.01, 0.1, 1.0)}, drawn=("seen",))
def spine_dynamics(ratios: tuple[float, ...] = RATIOS) -> Record:
    """The damping ratios that fit, and the motion of the motors.

    Args:
        ratios: damping over critical damping
    """
    spine, seen = load_spine(), seen_by_camera()
    # of rigid struts, stiff springs in this analysis, the vertebra keeps three slow modes
    modes = np.array(
        [
            vibration_modes(commanded(spine.scene, spine.retraction[k]), q, count=3).frequency
            for k, q in list(enumerate(resting_shapes(spine)))[:: len(spine.retraction) // 4]
        ]
    )
    frequency = float(np.median(modes[:, 0]))
    fits = [fitted(seen, frequency, ratio) for ratio in ratios]
    squares = np.array([fit["squares"] for fit in fits])
    freedom = len(seen["time"]) - 4
    kept = np.array(ratios)[squares <= squares.min() * (1 + WIDER / freedom)]
    facts = {"lowest": modes.min(0), "highest": modes.max(0), "frequency": frequency}
    return facts | {"ratios": [kept.min(), kept.max()], "tried": [min(ratios), max(ratios)], "fits": fits, "seen": seen}


def seen_by_camera() -> dict[str, np.ndarray]:
    """The mean response that the camera saw."""
    response = read_table(FOLDER / "response.csv")
    return {name: numbers(response, name) for name in ("time", "progress", "standard_error")}


def response(times: np.ndarray, frequency: float, ratio: float, shape: np.ndarray) -> np.ndarray:
    """Progress of a mode driven by motors that move evenly, from `shape`: begin, duration and scatter of clocks, s.

    x'' + 2 ratio w x' + w^2 x = w^2 u, exact for u constant over each step.
    """
    begin, duration, scatter = shape
    grid, w = np.arange(-2.0, 2.0, STEP), 2 * np.pi * frequency
    u = np.clip((grid - begin) / max(duration, STEP), 0, 1)
    x, v, path = 0.0, 0.0, []
    for each in u:
        # semi-implicit Euler, with the damping implicit: w STEP is a hundredth
        v = (v + STEP * w * w * (each - x)) / (1 + 2 * STEP * ratio * w)
        x = x + STEP * v
        path.append(x)
    return np.interp(times, grid, gaussian_filter1d(path, max(abs(scatter) / STEP, 1e-3)))


def fitted(seen: dict[str, np.ndarray], frequency: float, ratio: float) -> dict:
    """Begin, duration and scatter that fit best, for one damping ratio."""

    def misses(shape):
        return (response(seen["time"], frequency, ratio, shape) - seen["progress"]) / seen["standard_error"]

    found = min((least_squares(misses, [-0.6, 0.5, s], diff_step=1e-3) for s in (0.03, 0.15)), key=lambda f: f.cost)
    return {"ratio": ratio, "squares": 2 * found.cost, "shape": found.x}


@spine_dynamics.table
def words(record: Record) -> str:
    """What the response tells, and what it cannot."""
    begin, duration, scatter = min(record["fits"], key=lambda fit: fit["squares"])["shape"]
    squares = [fit["squares"] for fit in record["fits"]]
    bands = (f"{low:.1f} to {high:.1f}" for low, high in zip(record["lowest"], record["highest"]))
    rows = [
        ["simulated: the vertebra's three slowest modes over the commands", f"{', '.join(bands)} Hz"],
        ["motors move", f"from {begin:.2f} s after the command is logged, for {duration:.2f} s"],
        ["scatter of the clocks", f"{abs(scatter):.3f} s"],
        ["damping ratios tried", f"{record['tried'][0]:g} to {record['tried'][1]:g}"],
        ["sum of squared residuals, in standard errors, over these", f"{min(squares):.2f} to {max(squares):.2f}"],
        ["damping ratios that cannot be told apart", f"{record['ratios'][0]:g} to {record['ratios'][1]:g}"],
    ]
    return table(["quantity", "value"], rows)


@spine_dynamics.figure(3.6)
def figure(record: Record, chart: Figure) -> None:
    """The mean response and that of least and most damping; chi^2 over the damping ratio."""
    frequency, fits = record["frequency"], record["fits"]
    seen = {name: np.array(values, float) for name, values in record["seen"].items()}
    left, right = chart.subplots(1, 2)
    left.errorbar(seen["time"], seen["progress"], 2 * seen["standard_error"], fmt=".", color="0.4", label="camera")
    times = np.linspace(-1, 1, 400)
    for fit, line in ((fits[0], "-"), (fits[-1], "--")):
        path = response(times, frequency, fit["ratio"], fit["shape"])
        left.plot(times, path, line, label=f"damping ratio {fit['ratio']:.2g}")
    left.set(xlabel="time after the command (s)", ylabel="progress", title="Mean response")
    left.legend()
    squares = [fit["squares"] for fit in fits]
    right.semilogx([fit["ratio"] for fit in fits], squares, "o-")
    right.set(xlabel="damping ratio", ylabel="sum of squares (standard errors)", title="Misfit")
    right.set_ylim(0, 1.2 * max(squares))
