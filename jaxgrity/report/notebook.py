"""The display of scenes, motions, gaits and searches in Jupyter, as HTML with pictures."""

import base64
import io
from html import escape

import numpy as np
from matplotlib.figure import Figure

from jaxgrity.core.display import significant
from jaxgrity.model.actuation import Gait
from jaxgrity.model.scene import Scene
from jaxgrity.report import plot
from jaxgrity.report.gait_rows import distance_words, objective_words
from jaxgrity.report.measuring import verified_stays
from jaxgrity.search.pipeline import SearchResult
from jaxgrity.statics.describe import describe
from jaxgrity.stepping.discretisation import FAILURES
from jaxgrity.stepping.simulate import Trajectory, centre_path


def scene_html(scene: Scene) -> str:
    """The structure, and beside it the model's parts."""
    return _side_by_side(plot.structure_figure(scene), describe(scene))


def trajectory_html(trajectory: Trajectory) -> str:
    """Start and end of the robot, and the method of the rollout."""
    times = np.asarray(trajectory.times)
    step = "steps of its own choice" if trajectory.dt is None else f"dt = {trajectory.dt:g} s"
    words = [
        f"{times[-1] - times[0]:g} s of motion, {len(times)} saved frames",
        f"{trajectory.method}, {step}: {FAILURES[int(trajectory.failure)]}",
    ]
    if trajectory.scene is None or trajectory.failed:
        return _text("\n".join(words))
    moved = np.diff(centre_path(trajectory.scene, trajectory)[[0, -1], :2], axis=0)[0]
    words += [f"moved {significant(float(np.hypot(*moved)))} m", "in 3D: show()"]
    return _side_by_side(plot.still_figure(trajectory.scene, trajectory), "\n".join(words))


def gait_html(gait: Gait) -> str:
    """The rest lengths over time; for a population, the number of gaits."""
    if np.ndim(gait.phase) > 1:
        return _text(f"{len(gait.phase)} gaits of {len(gait.members)} members")
    return _picture(plot.gait_figure(gait))


def search_html(result: SearchResult) -> str:
    """The verdict on the result, in the words of the report, and its gait."""
    assert result.scene.gait is not None, "a search finds a gait"
    facts, unit = result.verdict.summary(), result.problem.fitness.objective.unit
    duration = float(result.problem.duration)
    facts |= {"duration": duration, "stays": verified_stays(result.scene, result.verdict.verified, duration)}
    rows = {
        "verified distance": distance_words(facts),
        "objective": objective_words(facts, unit),
        "beyond a bound on actuators": f"{100 * facts['beyond_bounds']:.0f} % of robots",
    }
    return _side_by_side(plot.gait_figure(result.scene.gait), "\n".join(f"{name}: {x}" for name, x in rows.items()))


def _side_by_side(figure: Figure, words: str) -> str:
    return (
        f'<div style="display:flex;flex-wrap:wrap;gap:1rem;align-items:center">{_picture(figure)}{_text(words)}</div>'
    )


def _text(words: str) -> str:
    return f"<pre>{escape(words)}</pre>"


def _picture(figure: Figure) -> str:
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=90)
    return (
        f'<img alt="" style="max-width:100%" src="data:image/png;base64,{base64.b64encode(file.getvalue()).decode()}">'
    )
