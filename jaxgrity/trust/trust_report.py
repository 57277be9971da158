"""How far one rollout can be trusted: every check that the library has, in one call."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxgrity.core.display import aligned, finite_or, in_digits
from jaxgrity.core.errors import InputError
from jaxgrity.core.tracing import refuse_traced
from jaxgrity.core.typed import typed
from jaxgrity.core.types import Times
from jaxgrity.model.actuation import rest_lengths_along
from jaxgrity.model.scales import length_scale, speed_scale, time_scale
from jaxgrity.model.scene import Scene
from jaxgrity.populations.clearance import rod_depths
from jaxgrity.stepping.discretisation import FAILURES, even_step
from jaxgrity.stepping.options import Options, ResolvedOptions, resolve
from jaxgrity.stepping.simulate import Trajectory, centre_path, frame_times, simulate, with_room
from jaxgrity.trust.energy_audit import EnergyAudit, energy_audit
from jaxgrity.trust.error_bars import refinement_bar, timing_bar
from jaxgrity.trust.sensitivity import Sensitivity, last_within, sensitivity

STATE_ERROR = 0.01
"""Uncertainty of all phases together (root of the sum of squares), rad; without a gait, of the initial velocities, m/s
for a body of one metre."""
PREDICTABLE = 0.01
"""Largest error of the centre of mass that counts as predicted, m for a body of one metre."""

SLOPES = 10.0
"""Rate at which the sensitivity of a body of one metre is sampled, 1/s."""
UNKNOWN_BAR = "not known, since a rollout failed"
"""Words for an error bar that is infinite."""
MEASUREMENTS = 5
"""Number of measurements in a report: rollouts at three steps, the energy audit and the sensitivity."""


class TrustReport(NamedTuple):
    """How far to trust one simulation."""

    trajectory: Trajectory
    """the simulated motion"""
    error_bars: Times
    """(frames,), error bar of the centre of mass, m, from smaller steps or tolerances"""
    audit: EnergyAudit | None
    """energy and momentum balance; None if the simulation failed"""
    sensitivity: Sensitivity | None
    penetration: float
    """largest depth of any node below the ground, m"""
    strut_strain: float
    """largest |l - L(t)| / L(t) of any strut; for rigid struts, the error of their constraint"""
    rod_depth: float = 0.0
    """largest depth of any strut in uneven ground between its nodes, m; contact does not act there"""

    @property
    def error_bar(self) -> float:
        """Error bar of the centre of mass at the end, m."""
        return float(self.error_bars[-1])

    @property
    def horizon(self) -> float:
        """Time up to which the error of the centre of mass stays within `predictable`, s.

        Until then neither the error bar exceeds it, nor the effect of an error `STATE_ERROR` in the phases (without a
        gait, in the initial velocities). If this holds to the end of the simulation, the horizon is that end.
        """
        exact = last_within(np.asarray(self.trajectory.times), self.error_bars, self.predictable)
        if self.sensitivity is None:
            return exact
        scene, in_phases = self.trajectory.scene, self.sensitivity.unit == "m/rad"
        speed = 1.0 if scene is None or in_phases else float(speed_scale(scene))
        return min(exact, self.sensitivity.horizon(self.predictable / (STATE_ERROR * speed)))

    @property
    def predictable(self) -> float:
        """Largest error at which the centre of mass of this body counts as predicted (`PREDICTABLE`), m."""
        scene = self.trajectory.scene
        return PREDICTABLE * (1.0 if scene is None else float(length_scale(scene)))

    def summary(self) -> dict[str, Any]:
        """The numbers for a JSON file, in SI units."""
        found: dict[str, Any] = {
            "outcome": FAILURES[int(self.trajectory.failure)],
            "error_bar": self.error_bar,
            "penetration": self.penetration,
            "strut_strain": self.strut_strain,
            "rod_depth": self.rod_depth,
            "predictable_up_to": self.horizon,
        }
        if self.audit is not None:
            found["energy"] = {
                "turned_over": self.audit.turned_over,
                "kinetic": self.audit.kinetic[-1],
                "potential_change": self.audit.potential[-1] - self.audit.potential[0],
                "actuation": self.audit.actuation[-1],
                "dissipated": {cause: lost[-1] for cause, lost in self.audit.dissipated.items()},
                "residual": np.abs(self.audit.residual).max(),
            }
            found["momentum_residual"] = self.audit.momentum_residual.max()
            found["angular_momentum_residual"] = self.audit.angular_residual.max()
            found["constraint_residual"] = self.audit.constraint_residual
        if self.sensitivity is not None:
            found["sensitivity"] = self.sensitivity.norm[-1]
            found["sensitivity_growth_rate"] = self.sensitivity.growth_rate
            found |= {"sensitivity_spread": self.sensitivity.spread} if self.sensitivity.spread else {}
        return found

    def table(self) -> str:
        """The report as text, one number per line."""
        facts, rows = self.summary(), {}
        rows["outcome"] = facts["outcome"]
        rows["error bar of the centre of mass"] = finite_or(facts["error_bar"], "m", UNKNOWN_BAR)
        if self.audit is not None:
            energy = facts["energy"]
            change = in_digits(energy["potential_change"], 4)
            taken = " (negative: members did work on them)" if energy["actuation"] < 0 else ""
            rows["energy"] = f"work of actuators {in_digits(energy['actuation'], 4)} J{taken}, kinetic at the end "
            rows["energy"] += f"{in_digits(energy['kinetic'], 4)} J, change of potential {float(change):+g} J"
            lost = ", ".join(f"{cause} {in_digits(amount)}" for cause, amount in energy["dissipated"].items())
            rows["dissipated"] = f"{lost} J" if lost else "nothing"
            rows["energy residual"] = f"{energy['residual']:.2g} J of {in_digits(energy['turned_over'])} J converted"
            rows["momentum residual"] = f"{facts['momentum_residual']:.2g} N s, angular "
            rows["momentum residual"] += f"{facts['angular_momentum_residual']:.2g} N m s"
        if facts.get("constraint_residual"):
            rows["constraint residual"] = f"{facts['constraint_residual']:.2g} m/s in any step"
        rows["largest penetration"] = f"{facts['penetration']:.2g} m"
        if facts["rod_depth"] > facts["penetration"]:
            rows["largest depth of a rod"] = f"{facts['rod_depth']:.2g} m in the ground between its nodes"
        rows["largest strut strain"] = f"{facts['strut_strain']:.2g}"
        if self.sensitivity is not None:
            rate = facts["sensitivity_growth_rate"]
            growing = f", growing by {in_digits(rate, 2)} 1/s" if np.isfinite(rate) else ""
            size = finite_or(facts["sensitivity"], self.sensitivity.unit, "not known, since it is not finite")
            spread = self.sensitivity.spread
            drawn = f" (estimated by random directions, standard deviation {spread:.0%})" if spread else ""
            rows["sensitivity at the end"] = f"{size}{drawn}{growing}"
        lasting = "at least " if facts["predictable_up_to"] >= np.asarray(self.trajectory.times)[-1] else ""
        rows[f"predictable to {100 * self.predictable:.3g} cm up to"] = f"{lasting}{facts['predictable_up_to']:.3g} s"
        return aligned(list(rows.items()))


@typed
def diagnose(
    scene: Scene,
    duration: float,
    *,
    options: Options = None,
    frame_rate: float = 100.0,
    motion: Trajectory | None = None,
    on_progress: Callable[[int, int], object] = lambda done, total: None,
) -> TrustReport:
    """Simulate a scene as `simulate` does, and report how far you can trust the result.

    Error bars come from simulations in float64 at half and a quarter of the step (or at a tenth and a hundredth of the
    tolerances), as in `verify`.

    Args:
        scene: the scene to simulate.
        duration: simulated time, s.
        options: solver options; by default the scene decides.
        frame_rate: saved frames per second.
        motion: what `simulate` returned for the same arguments; then it is not simulated again.
        on_progress: called with the number of finished measurements, and their total.

    Returns:
        The motion, with error bars, energy audit, sensitivity, penetration and strut strain.

    Raises:
        InputError: bad options (see `resolve`), a frame rate that is not positive and finite, or a `motion` of another
            scene, or with another method, step, precision, start, or other times. Its tolerances are not known.

    Example:
        >>> scene = jaxgrity.load_scene("reference")
        >>> report = jaxgrity.diagnose(scene, 0.2)
        >>> report.error_bar < 1e-3, report.horizon  # m; s
        (True, 0.2)
    """
    refuse_traced((scene, duration), "diagnose")
    resolved = resolve(scene, duration, options)
    first = resolved.refined()[0]
    on_progress(0, MEASUREMENTS)
    if motion is None:
        motion = simulate(scene, duration, options=first, frame_rate=frame_rate)
    else:
        _check_motion(scene, motion, first, frame_times(duration, frame_rate))
    on_progress(1, MEASUREMENTS)
    rollouts, audit, growth = _measured(scene, duration, resolved, motion, frame_rate, on_progress)
    paths = [centre_path(scene, rollout) for rollout in rollouts]
    failed = any(rollout.failed for rollout in rollouts)
    bars = np.full(len(motion.times), np.inf) if failed else refinement_bar(*paths) + timing_bar(scene, first)
    depth, strain = _penetration(scene, motion), _strut_strain(scene, motion)
    on_progress(MEASUREMENTS, MEASUREMENTS)
    uneven = scene.ground is not None and scene.ground.surface is not None
    rods = float(rod_depths(scene, motion).max(initial=0)) if uneven else 0.0
    return TrustReport(motion, bars, audit, growth, depth, strain, rods)


def _measured(
    scene: Scene,
    duration: float,
    options: ResolvedOptions,
    motion: Trajectory,
    frame_rate: float,
    on_progress: Callable[[int, int], object],
) -> tuple[list[Trajectory], EnergyAudit | None, Sensitivity | None]:
    """The motion and those at smaller steps; unless it failed, its audit and its sensitivity."""
    rollouts, audit, growth = [motion], None, None
    with ThreadPoolExecutor(1) as beside:  # what takes longest is compiled on a core of its own
        slopes = SLOPES / float(time_scale(scene))
        growing = None
        if not motion.failed:
            growing = beside.submit(_sensitivity_there(), scene, duration, options=options, frame_rate=slopes)
        for each in options.refined()[1:]:
            exact = resolve(scene, duration, each, dtype="float64")
            rollouts.append(simulate(scene, duration, options=exact, frame_rate=frame_rate))
            on_progress(len(rollouts), MEASUREMENTS)
        if growing is not None:
            audit = energy_audit(scene, duration, options=options, frame_rate=frame_rate)
            on_progress(4, MEASUREMENTS)
            growth = growing.result()
    return rollouts, audit, growth


def _check_motion(scene: Scene, motion: Trajectory, options: ResolvedOptions, times: np.ndarray) -> None:
    """Refuse a motion that `simulate` does not make of the scene with these options at these times, s."""
    dt = None if options.dt is None else float(options.dt)
    if dt is not None and options.method.constrained:
        dt = float(even_step(np.asarray(dt), np.asarray(times[-1])))
    start = np.asarray(scene.structure.nodes, motion.positions.dtype)
    faults = {
        "scene": motion.scene is not scene,
        "method": motion.method != options.method.name,
        "dt": motion.dt != dt,
        "dtype": str(motion.positions.dtype) != options.dtype,
        "times": not np.array_equal(motion.times, times.astype(options.dtype)),
        "start": not np.array_equal(np.asarray(motion.positions)[0], start)
        or bool(np.any(np.asarray(motion.velocities)[0][np.asarray(scene.structure.free)])),
    }
    if wrong := [name for name, differs in faults.items() if differs]:
        raise InputError(
            f"motion: it has another {wrong[0]}; expected what `simulate` returns for the same scene, duration, "
            "options and frame_rate"
        )


def _sensitivity_there() -> Callable[..., Sensitivity]:
    """`sensitivity` for another thread, to which a precision that was switched on for this one alone goes along."""
    x64 = bool(jax.config.jax_enable_x64)  # type: ignore[attr-defined]

    def there(*given: Any, **how: Any) -> Sensitivity:
        with jax.enable_x64(x64):
            return sensitivity(*given, **how)

    return there


def _penetration(scene: Scene, trajectory: Trajectory) -> float:
    if scene.ground is None:
        return 0.0
    phi = scene.ground.measured(np.asarray(trajectory.positions, float)).distance
    return max(0.0, float(-phi.min()))


def _strut_strain(scene: Scene, trajectory: Trajectory) -> float:
    """Of rigid struts in frames at which a step ends: positions between them are interpolated, and lengths are not."""
    struts = scene.structure.struts
    if struts is None:
        return 0.0
    times, dt = np.asarray(trajectory.times, float), trajectory.dt
    ends = np.abs(times / dt - np.round(times / dt)) < 1e-3 if dt and struts.rigid else np.ones(len(times), bool)
    wanted = np.asarray(rest_lengths_along(struts, scene.gait, with_room(times, len(scene.structure.nodes)), 0))
    wanted = wanted[: len(times)][ends]
    i, j = np.array(struts.edges).T
    positions = np.asarray(trajectory.positions, float)[ends]
    lengths = np.linalg.norm(positions[:, i] - positions[:, j], axis=-1)
    return float(np.max(np.abs(lengths - wanted) / wanted))
