"""Solver options: those that a user gives, and the complete ones that `resolve` chooses for a scene."""

import warnings
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import numpy as np

from jaxgrity.core.arguments import check_count, check_number
from jaxgrity.core.errors import InputError
from jaxgrity.core.remembered import remembered
from jaxgrity.core.tracing import traced
from jaxgrity.core.typed import check_fields, typed
from jaxgrity.core.types import Count, NodeVectors, Scalar
from jaxgrity.model.rigidity import LINKS
from jaxgrity.model.scales import length_scale, speed_scale
from jaxgrity.model.scene import Scene, check_laws
from jaxgrity.model.slides import slides_of
from jaxgrity.stepping.blocks import disjoint_groups
from jaxgrity.stepping.capsules import capsules_of
from jaxgrity.stepping.constraints import exact_ground, rigid_struts
from jaxgrity.stepping.methods import Method, check_solves, constrained_method, default_method, find_method
from jaxgrity.stepping.starts import check_start
from jaxgrity.stepping.step_limits import default_step, step_fault
from jaxgrity.stepping.strut_contacts import points_between

KEPT = 64
"""Number of calls of `resolve` whose result is remembered: a step's checks take longer than a short rollout."""
MASS_RATIO = 50
"""Largest ratio of the masses at a strut's ends at which sweeps are sure to converge on the ground."""
ROUGH = 1.0
"""Smallest friction coefficient mu at which sweeps may not converge."""
UNSWEPT = "sweeps handle no rods with mass, supports, bodies, balls or slides, and no contact along or between struts"
MOST_SWEEPS = 1000
"""Largest number of sweeps per complementarity step if a tolerance is given."""


@dataclass(frozen=True)
class SolverOptions:
    """Solver options. `resolve` chooses those that are None to suit the scene."""

    method: str | None = None
    """rk4, tsit5, dopri8, kvaerno3, kvaerno5, verlet, complementarity, complementarity2 or your own; None: automatic"""
    dt: float | None = None
    """fixed time step, s; None: adaptive methods adapt their step, and other methods take `default_step`"""
    dtype: str | None = None
    """ "float32" or "float64"; None: the default of JAX, which is float64 if x64 is on"""
    rtol: float | None = None
    """relative tolerance of an adaptive method; None: 1e-8, or 1e-5 in float32"""
    atol: float | None = None
    """absolute tolerance of an adaptive method, m and m/s; None: as `rtol`, times the body's length or speed scale"""
    sweeps: int | None = None
    """number of sweeps over all constraints per complementarity step; None: `usual_sweeps`; refused with `coupled`"""
    strut_tolerance: float | None = None
    """largest error of a rigid strut's length, m; sweeps stop below it, or after `sweeps` of them (by default 1000)"""
    coupled: bool | None = None
    """whether complementarity stepping solves struts and contacts together; None: only if sweeps might not converge"""
    max_steps: int = 10**6
    """number of steps after which an adaptive method gives up, and the simulation fails"""
    any_step: bool = False
    """whether a step beyond the stable limit is allowed, with a warning"""

    def __post_init__(self):
        check_fields(self)
        for name, unit in (("dt", "s"), ("rtol", ""), ("atol", ""), ("strut_tolerance", "m")):
            if (value := getattr(self, name)) is not None:
                check_number(name, value, above=0.0, unit=unit)
        for name in ("sweeps", "max_steps"):
            if (value := getattr(self, name)) is not None:
                check_count(name, value, 1)


class ResolvedOptions(eqx.Module):
    """Complete options, checked against a scene. Functions that take options accept these too."""

    method: Method = eqx.field(static=True)
    dt: Scalar | None
    """s; None: the method adapts its step"""
    dtype: str = eqx.field(static=True)
    rtol: Scalar
    atol: Scalar
    sweeps: Count | None = None
    strut_tolerance: Scalar | None = None
    coupled: bool = eqx.field(static=True, default=False)
    max_steps: int = eqx.field(static=True, default=10**6)

    def as_inputs(self) -> "ResolvedOptions":
        """The same with step, sweeps and tolerances as arrays: a function is compiled once for all their values.

        Plain numbers would be part of the compiled program. Reverse mode needs plain ones, to count the steps.
        """
        return jax.tree.map(lambda x: np.asarray(x, int if isinstance(x, int) else float), self)

    def refined(self) -> "list[ResolvedOptions]":
        """These options, then half and a quarter of their step, or a tenth and a hundredth of their tolerances."""
        if self.dt is not None:
            return [replace(self, dt=self.dt / 2**k) for k in range(3)]
        tightest = 10 * float(np.finfo("float64").eps)
        tolerances = [(max(tightest, self.rtol / 10**k), self.atol / 10**k) for k in range(3)]
        return [replace(self, rtol=rtol, atol=atol) for rtol, atol in tolerances]


Options = SolverOptions | ResolvedOptions | None
"""Type of the argument `options`."""


@typed
def resolve(
    scene: Scene,
    duration: float = 1.0,
    options: Options = None,
    *,
    dtype: str | None = None,
    positions: NodeVectors | None = None,
    since: Scalar = 0.0,
) -> ResolvedOptions:
    """Complete the options for a scene, and refuse those that cannot work before anything compiles.

    Call it once, outside `jit` and `grad`: traced numbers do not change the step that it has chosen.

    Args:
        scene: the scene to simulate.
        duration: simulated time, s. It has to be positive; method and step do not depend on it.
        options: options of the user; resolved ones are returned unchanged if their method suits the scene. If JAX
            traces the friction, the faster sweeps are chosen. They may fail at mu = 1 or more (`rollout` is then not
            `ok`): pass `SolverOptions(coupled=True)` for such friction.
        dtype: precision; replaces that of the options.
        positions: (nodes, 3), m, at the start; by default those of the structure.
        since: time of the start, s; rigid struts must have their lengths at that time.

    Raises:
        InputError: an unknown method or precision, or a duration that is not positive and finite. A `dt` too large for
            the scene (a warning with `any_step`). A method that cannot satisfy the scene's constraints, or a start that
            violates them. A symplectic method for a scene that dissipates. Sweeps, or a tolerance for them, for a
            method without sweeps. A tolerance finer than the precision. Float64 while JAX's x64 mode is off.
    """
    check_number("duration", duration, above=0.0, unit="s")
    check_start(scene, positions, since)
    return _resolved(scene, options, dtype, bool(jax.config.jax_enable_x64))  # type: ignore[attr-defined]


@remembered(KEPT)
def _resolved(scene: Scene, options: Options, dtype: str | None, x64: bool) -> ResolvedOptions:
    """`resolve` without the duration, on which nothing else depends; `x64` is whether float64 is switched on."""
    concrete = not traced(scene)
    check_laws(scene)
    if isinstance(options, ResolvedOptions):
        check_options(scene, options)
        return options if dtype is None else replace(options, dtype=_dtype(dtype, x64))
    given = options or SolverOptions()
    method = find_method(given.method) if given.method is not None else default_method(scene)
    dtype = _dtype(dtype or given.dtype, x64)
    # tolerances are plain numbers. Traced scales are not, and then the tolerances are those of a robot of one metre
    size, speed = (float(length_scale(scene)), float(speed_scale(scene))) if concrete else (1.0, 1.0)
    rtol, atol = _tolerances(given, method, dtype, min(size, speed))
    _check_method(scene, method)
    sweeps, coupled = _sweeps(given, method, dtype, size), is_coupled(scene, given, method, concrete)
    if coupled and given.sweeps is not None:
        other = "none" if _must_be_coupled(scene) else "none, or coupled = False"
        raise InputError(
            f"sweeps = {given.sweeps}: this scene's struts and contacts are solved together; expected {other}"
        )
    check_solves(method, scene, coupled)
    dt = given.dt
    if dt is None and not method.adaptive:
        dt = _default_step(scene, method)
    elif dt is not None and concrete:
        if fault := step_fault(scene, method, dt):
            if not given.any_step:
                raise InputError(fault)
            # it may look like a motion, since friction and slack cables bound it
            warnings.warn(f"{fault}; the motion is wrong, whether it fails or not", stacklevel=2)
        if not given.any_step:
            _check_sees_pushes(scene, method, dt)
    # plain numbers, so that they are compiled in: `jax.jit` would make NumPy numbers inputs of the program
    dt, rtol, atol = jax.tree.map(float, (dt, rtol, atol))
    return ResolvedOptions(method, dt, dtype, rtol, atol, sweeps, given.strut_tolerance, coupled, given.max_steps)


def check_options(scene: Scene, options: ResolvedOptions) -> None:
    """Refuse options that were resolved for a scene of another kind. The step is not looked at for what is stable."""
    method = options.method
    _check_method(scene, method)
    check_solves(method, scene, options.coupled)
    if method.constrained and not options.coupled and _must_be_coupled(scene):
        raise InputError(f"options: {UNSWEPT}; expected options that `resolve` makes for this scene")
    if options.dt is not None and not traced((scene, options)):
        _check_sees_pushes(scene, method, float(options.dt))


def _check_sees_pushes(scene: Scene, method: Method, dt: float) -> None:
    longest = 2 * _longest_step_for_pushes(scene, method)  # a search's rough rollouts take twice the default step
    if dt > longest:
        raise InputError(
            f"dt = {dt:g} s: a push or another short force would be lost between the steps of {method.name}; "
            f"expected at most {longest:g} s"
        )


def _longest_step_for_pushes(scene: Scene, method: Method) -> float:
    """s, the largest step that sees all that acts for a short time, such as a push."""
    acting = () if method.constrained or traced(scene) else scene.terms
    return min((term.longest_step() for term in acting), default=np.inf)


def _default_step(scene: Scene, method: Method) -> float:
    try:
        return min(default_step(scene, method), _longest_step_for_pushes(scene, method))
    except (jax.errors.ConcretizationTypeError, jax.errors.TracerArrayConversionError) as error:
        raise InputError(
            "dt: the scene's numbers are being traced, so no step can be chosen; pass a dt, or options = "
            "jaxgrity.stepping.resolve(scene) of a scene with known numbers"
        ) from error


def options_anew(scene: Scene, method: str, dt: float, dtype: str) -> ResolvedOptions:
    """The options of a motion of the scene, whose start has been checked: its method, its step (s), its precision."""
    given, chosen = SolverOptions(), find_method(method)
    rtol, atol = _tolerances(given, chosen, dtype, 1.0)  # which steps of one size have no use for
    coupled = is_coupled(scene, given, chosen, not traced(scene))
    return ResolvedOptions(chosen, dt, dtype, rtol, atol, coupled=coupled)


def _dtype(given: str | None, x64: bool) -> str:
    dtype = given or ("float64" if x64 else "float32")
    if dtype not in ("float32", "float64"):
        raise InputError(f"dtype = {dtype!r}: expected 'float32' or 'float64'")
    if dtype == "float64" and not x64:
        raise InputError("dtype = 'float64' needs jax.config.update(\"jax_enable_x64\", True) first")
    return dtype


def _tolerances(given: SolverOptions, method: Method, dtype: str, least: float) -> tuple[float, float]:
    rtol, atol, tightest = given.rtol, given.atol, 10 * float(np.finfo(dtype).eps)
    if rtol is not None and rtol < tightest:
        raise InputError(f"rtol = {rtol:g}: {dtype} cannot meet it; expected at least {tightest:.1g}")
    if (rtol is not None or atol is not None) and (given.dt is not None or not method.adaptive):
        raise InputError(f"rtol, atol: {method.name!r} at a fixed step has no tolerances; expected none, or no dt")
    usual = 1e-8 if dtype == "float64" else 1e-5
    return usual if rtol is None else rtol, usual * least if atol is None else atol


def _check_method(scene: Scene, method: Method) -> None:
    if scene.constrained and not method.constrained and (method.symplectic or not _only_keeps_distances(scene)):
        found = "rigid bodies, " * bool(scene.structure.bodies) + "rigid struts or exact contact"
        what = found if slides_of(scene) is None else "sliding nodes"
        raise InputError(f"method = {method.name!r}: this scene has {what}; expected {constrained_method().name!r}")
    if method.symplectic and scene.dissipates:
        raise InputError(
            f"method = {method.name!r} integrates scenes without dissipation; this one has damping or friction"
        )


def _only_keeps_distances(scene: Scene) -> bool:
    """Whether all constraints are distances that stay as they are, which multipliers keep."""
    struts, gait = scene.structure.struts, scene.gait
    moving = struts is not None and struts.rigid and (gait is not None or bool(struts.motors))
    return not moving and all(isinstance(law, LINKS) for law in scene.constraints)


def _sweeps(given: SolverOptions, method: Method, dtype: str, size: float) -> int | None:
    sweeps, tolerance = given.sweeps, given.strut_tolerance
    if (sweeps is not None or tolerance is not None) and not method.constrained:
        raise InputError(f"sweeps, strut_tolerance: only complementarity stepping has them, not {method.name!r}")
    if tolerance is None:
        return sweeps
    tightest = 100 * float(np.finfo(dtype).eps) * size
    if not tolerance >= tightest:
        raise InputError(f"strut_tolerance = {tolerance:g} m: expected at least {tightest:.1g} m in {dtype}")
    return MOST_SWEEPS if sweeps is None else sweeps


def _must_be_coupled(scene: Scene) -> bool:
    """Whether sweeps cannot solve the scene's struts and contacts."""
    balls = scene.ground is not None and scene.ground.balls is not None
    joined = scene.structure.needs_mobility or slides_of(scene) is not None
    return joined or balls or capsules_of(scene) is not None or bool(points_between(scene))


def is_coupled(scene: Scene, given: SolverOptions, method: Method, concrete: bool) -> bool:
    """Whether struts and contacts are solved together: by request, where they must be, or where sweeps may fail."""
    if not method.constrained:
        if given.coupled is not None:
            raise InputError(f"coupled: only complementarity stepping has it, not {method.name!r}")
        return False
    if given.coupled is not None:
        if not given.coupled and _must_be_coupled(scene):
            raise InputError(f"coupled = False: {UNSWEPT}; expected None")
        return given.coupled
    struts, must = rigid_struts(scene), _must_be_coupled(scene)
    if must or struts is None:
        return must
    if len(disjoint_groups(struts.edges)) > 1:
        return True
    if not concrete or exact_ground(scene) is None:
        return False
    mass, (i, j) = np.asarray(scene.structure.node_mass), np.array(struts.edges).T
    unequal = np.max(np.maximum(mass[i] / mass[j], mass[j] / mass[i])) > MASS_RATIO
    return bool(unequal or (scene.friction is not None and np.max(np.asarray(scene.friction.sliding_mu)) >= ROUGH))
