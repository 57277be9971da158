"""Public classes that a user fills refuse in one line whatever their fields may not hold: each class, each field."""

import dataclasses
import inspect
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jaxtyping
import numpy as np
import pytest

import jaxgrity
from jaxgrity import control, model, search
from jaxgrity.model import force_laws
from jaxgrity.model.hinges import HingeDampers, HingeSprings
from jaxgrity.model.pulls import CommandedPull
from jaxgrity.model.stiffening import PolynomialStiffness

ANY, POSITIVE, NOT_NEGATIVE, COUNT, INDEX, OTHER = "any number", "positive", "not negative", "count", "index", "other"
"""Kinds of fields: finite real numbers, whole numbers from 1 and from 0 on, and what holds no numbers."""
ROWS = "rows"
"""Of a field that may have further axes, such as that of a population."""
NODES, ONES = np.array([[0.0, 0, 0], [1, 0, 0]]), np.ones(2)


class Example(NamedTuple):
    """A class, as it may be filled."""

    make: Callable
    fields: dict[str, tuple]
    """a value of each, its kind, and `ROWS` where it may have further axes"""


def _of(make: Callable, **fields: tuple) -> Example:
    return Example(make, fields)


STRUCTURE = jaxgrity.Structure(NODES, ONES, cables=jaxgrity.Members(((0, 1),), [100.0], [0.9]))
GAIT = jaxgrity.Gait((0,), [0.0], [0.3], [1.0])
EXAMPLES = [
    _of(
        jaxgrity.Members,
        edges=(((0, 1), (1, 2)), OTHER),
        stiffness=(ONES, NOT_NEGATIVE),
        rest_length=(ONES, NOT_NEGATIVE),
        damping=(ONES, NOT_NEGATIVE),
        stuck=((0,), OTHER),
        mass=(ONES, NOT_NEGATIVE),
        clusters=((), OTHER),
        motors=((), OTHER),
        pulleys=((), OTHER),
        yield_force=(ONES, NOT_NEGATIVE),
        bending_stiffness=(ONES, NOT_NEGATIVE),
    ),
    _of(
        jaxgrity.Structure,
        nodes=(NODES, ANY),
        node_mass=(ONES, NOT_NEGATIVE),
        struts=(None, OTHER),
        cables=(STRUCTURE.cables, OTHER),
        fixed=((), OTHER),
        bodies=((), OTHER),
        mobility=(None, OTHER),
    ),
    _of(
        jaxgrity.Motor,
        member=(0, INDEX),
        times=(np.array([0.1, 0.2]), ANY),
        lengths=(ONES, POSITIVE),
        rate=(0.1, POSITIVE),
        lag=(0.1, POSITIVE),
        smallest=(0.1, POSITIVE),
    ),
    _of(
        model.Pulley,
        between=((0, 1), OTHER),
        radius=(0.1, POSITIVE),
        axis=(np.ones(3), ANY),
        axle=(None, OTHER),
        turns=(1, INDEX),
        mu=(0.2, NOT_NEGATIVE),
        slip_speed=(0.01, POSITIVE),
        drum=(5, INDEX),
    ),
    _of(
        jaxgrity.Scene,
        structure=(STRUCTURE, OTHER),
        gravity=(9.81, NOT_NEGATIVE),
        node_damping=(ONES, NOT_NEGATIVE),
        ground=(jaxgrity.ExactGround(), OTHER),
        friction=(jaxgrity.ConeFriction(0.5), OTHER),
        gait=(GAIT, OTHER),
        up=(np.array([0.6, 0.0, 0.8]), ANY),
        shaking=(None, OTHER),
        terms=((), OTHER),
        scales=(None, OTHER),
        loads=((), OTHER),
    ),
    _of(
        jaxgrity.Gait,
        members=((0, 1), OTHER),
        phase=(ONES, ANY, ROWS),
        amplitude=(0.3 * ONES, NOT_NEGATIVE, ROWS),
        frequency=(ONES, NOT_NEGATIVE, ROWS),
        start=(0.0, ANY),
        ramp=(1.0, POSITIVE),
        overtones=((), OTHER),
        robot=(None, OTHER),
    ),
    _of(jaxgrity.Overtone, size=(ONES, NOT_NEGATIVE, ROWS), phase=(ONES, ANY, ROWS)),
    _of(
        jaxgrity.PenaltyGround,
        stiffness=(1e4, POSITIVE),
        dissipation=(1.0, POSITIVE),
        incline=(0.1, ANY),
        surface=(None, OTHER),
        offset=(None, OTHER),
        balls=(None, OTHER),
    ),
    _of(
        jaxgrity.ExactGround,
        incline=(0.0, ANY),
        restitution=(0.5, NOT_NEGATIVE),
        surface=(jaxgrity.Slope(0.1), OTHER),
        offset=(np.zeros(3), ANY),
        balls=(None, OTHER),
        capsules=(None, OTHER),
    ),
    _of(jaxgrity.SmoothFriction, mu=(0.5, NOT_NEGATIVE, ROWS), slip_speed=(0.01, POSITIVE)),
    _of(
        jaxgrity.SwitchFriction,
        mu_static=(0.5, NOT_NEGATIVE, ROWS),
        mu_kinetic=(0.4, NOT_NEGATIVE, ROWS),
        slip_speed=(0.01, POSITIVE),
    ),
    _of(jaxgrity.ConeFriction, mu=(0.5, NOT_NEGATIVE, ROWS)),
    _of(jaxgrity.Slope, incline=(0.1, ANY)),
    _of(jaxgrity.Sphere, centre=(np.zeros(3), ANY), radius=(1.0, POSITIVE), hollow=(False, OTHER)),
    _of(
        jaxgrity.Box,
        centre=(np.zeros(3), ANY),
        size=(np.ones(3), POSITIVE),
        turn=(0.1, ANY),
        rounding=(0.1, NOT_NEGATIVE),
    ),
    _of(
        jaxgrity.Cylinder,
        start=(np.zeros(3), ANY),
        end=(np.ones(3), ANY),
        radius=(1.0, POSITIVE),
        rounding=(0.1, NOT_NEGATIVE),
    ),
    _of(
        jaxgrity.Stairs,
        rise=(0.1, POSITIVE),
        run=(0.3, POSITIVE),
        steps=(2, COUNT),
        start=(0.5, ANY),
        turn=(0.1, ANY),
        rounding=(0.01, NOT_NEGATIVE),
    ),
    _of(jaxgrity.HeightWaves, amplitude=(ONES, ANY), length=(ONES, POSITIVE), direction=(ONES, ANY), phase=(ONES, ANY)),
    _of(
        jaxgrity.bumps,
        deviation=(0.1, POSITIVE),
        length=(1.0, POSITIVE),
        seed=(0, INDEX),
        waves=(3, COUNT),
    ),
    _of(
        jaxgrity.HeightMap,
        coefficients=(np.zeros((6, 6)), ANY),
        corner=(np.zeros(2), ANY),
        spacing=(ONES, POSITIVE),
    ),
    _of(
        jaxgrity.Shaking,
        amplitude=(np.ones(3), ANY),
        frequency=(1.0, POSITIVE),
        start=(0.0, NOT_NEGATIVE),
        ramp=(1.0, POSITIVE),
    ),
    _of(jaxgrity.Wind, velocity=(np.ones(3), ANY), drag=(ONES, NOT_NEGATIVE, ROWS)),
    _of(
        jaxgrity.Push,
        nodes=((0, 1), OTHER),
        force=(np.ones((2, 3)), ANY),
        start=(0.0, ANY),
        duration=(1.0, POSITIVE),
        ramp=(0.1, POSITIVE),
    ),
    _of(
        jaxgrity.ForceTable,
        stretch=(np.array([0.0, 1.0]), ANY),
        force=(np.array([0.0, 1.0]), NOT_NEGATIVE),
        factors=(ONES, NOT_NEGATIVE, ROWS),
    ),
    _of(jaxgrity.ForceLimit, largest=(ONES, POSITIVE, ROWS), factors=(ONES, NOT_NEGATIVE, ROWS)),
    _of(force_laws.DeadBand, width=(ONES, NOT_NEGATIVE, ROWS), factors=(ONES, NOT_NEGATIVE, ROWS)),
    _of(force_laws.CableDampers, damping=(ONES, NOT_NEGATIVE, ROWS)),
    _of(
        CommandedPull,
        pull=(ONES, NOT_NEGATIVE, ROWS),
        slope=(ONES, NOT_NEGATIVE, ROWS),
        factors=(ONES, NOT_NEGATIVE, ROWS),
    ),
    _of(
        PolynomialStiffness,
        quadratic=(ONES, NOT_NEGATIVE, ROWS),
        cubic=(ONES, NOT_NEGATIVE, ROWS),
        factors=(ONES, NOT_NEGATIVE, ROWS),
    ),
    _of(
        HingeSprings,
        nodes=(((0, 1, 2, 3), (4, 5, 6, 7)), OTHER),
        stiffness=(np.ones(2), NOT_NEGATIVE, ROWS),
        rest_angle=(np.ones(2), ANY),
    ),
    _of(HingeDampers, nodes=(((0, 1, 2, 3), (4, 5, 6, 7)), OTHER), damping=(np.ones(2), NOT_NEGATIVE, ROWS)),
    _of(model.Slides, nodes=((2,), OTHER), along=(((0, 1),), OTHER)),
    _of(model.LoadCase, name=("snow", OTHER), nodes=((0, 1), OTHER), force=(np.ones((2, 3)), ANY)),
    _of(model.Balls, nodes=((0, 1), OTHER), radius=(ONES, NOT_NEGATIVE, ROWS)),
    _of(
        model.rigid_body,
        nodes=(NODES, ANY),
        points=((0, 1), OTHER),
        mass=(1.0, POSITIVE),
        inertia=(np.array([0.0, 0.1, 0.1]), NOT_NEGATIVE),
        centre=(np.array([0.5, 0.0, 0.0]), ANY),
    ),
    _of(
        jaxgrity.SolverOptions,
        method=("rk4", OTHER),
        dt=(1e-3, POSITIVE),
        dtype=("float64", OTHER),
        rtol=(1e-6, POSITIVE),
        atol=(1e-6, POSITIVE),
        sweeps=(8, COUNT),
        strut_tolerance=(1e-6, POSITIVE),
        coupled=(None, OTHER),
        max_steps=(100, COUNT),
        any_step=(False, OTHER),
    ),
    _of(
        jaxgrity.Differences,
        friction=(ONES, NOT_NEGATIVE, ROWS),
        cable_stiffness=(np.ones((2, 1)), NOT_NEGATIVE, ROWS),
        cable_damping=(np.ones((2, 1)), NOT_NEGATIVE, ROWS),
        cable_rest_length=(np.ones((2, 1)), NOT_NEGATIVE, ROWS),
        node_mass=(np.ones((2, 2)), NOT_NEGATIVE, ROWS),
        up=(np.array([[0.0, 0, 1]] * 2), OTHER),
        positions=(np.zeros((2, 2, 3)), OTHER),
        velocities=(np.zeros((2, 2, 3)), OTHER),
        terrain=(np.zeros((2, 3)), OTHER),
        strut_rest_length=(np.ones((2, 1)), NOT_NEGATIVE, ROWS),
        body_mass=(np.ones((2, 1)), POSITIVE, ROWS),
    ),
    _of(
        jaxgrity.Uncertainty,
        **dict.fromkeys((field.name for field in dataclasses.fields(jaxgrity.Uncertainty)), (0.1, NOT_NEGATIVE)),
    ),
    _of(
        jaxgrity.GAConfig,
        population=(8, COUNT),
        generations=(2, COUNT),
        elites=(2, COUNT),
        tournament=(2, COUNT),
        mutation_rate=(0.3, NOT_NEGATIVE),
        mutation_size=((0.1, 0.02), OTHER),
        drawn=(16, COUNT),
        crossover=(0.5, NOT_NEGATIVE),
        parents=(4, COUNT),
        optimiser=("genetic", OTHER),
    ),
    _of(
        jaxgrity.Genome,
        actuators=(2, COUNT),
        amplitude=((0.1, 0.2), OTHER),
        frequency=((0.1, 0.2), OTHER),
        overtones=(1, INDEX),
        active=(1, COUNT),
        images=((), OTHER),
        waves=((), OTHER),
        quickest=((), OTHER),
        ramp=(0.5, POSITIVE),
    ),
    _of(jaxgrity.ActuatorBounds, rate=(1.0, POSITIVE), force=(1.0, POSITIVE), power=(1.0, POSITIVE)),
    _of(
        jaxgrity.Fitness,
        objective=(jaxgrity.Distance(), OTHER),
        uncertainty=(jaxgrity.Uncertainty(phase=0.1), OTHER),
        robots=(2, COUNT),
        caution=(1.0, NOT_NEGATIVE),
        bounds=(jaxgrity.ActuatorBounds(), OTHER),
    ),
    _of(jaxgrity.Direction, heading=(0.1, ANY)),
    _of(jaxgrity.SteadyDirection, heading=(0.1, ANY), sideways=(0.1, NOT_NEGATIVE)),
    _of(jaxgrity.SteadyTurn, turning=(0.1, ANY), sharpness=(0.1, NOT_NEGATIVE)),
    _of(
        control.MotorLimits,
        lag=(0.1, POSITIVE),
        rate=(0.1, POSITIVE),
        force=(0.1, POSITIVE),
        stroke=(0.1, POSITIVE),
    ),
    _of(
        control.PhaseLocked,
        gait=(GAIT, OTHER),
        gains=(np.ones((2, 2)), ANY, ROWS),
        swings=(np.ones((2, 2)), ANY, ROWS),
        time_scale=(1.0, POSITIVE, ROWS),
    ),
    _of(
        control.Steered,
        policy=(control.OpenLoop(GAIT), OTHER),
        bend=(0.5, ANY, ROWS),
        offsets=(np.ones((1, 2)), ANY, ROWS),
        goal=(np.ones(2), ANY, ROWS),
        full=(0.8, POSITIVE, ROWS),
        averaged=(1.0, POSITIVE, ROWS),
        slowest=(0.1, POSITIVE),
    ),
    _of(
        control.Blend,
        one=(control.OpenLoop(GAIT), OTHER),
        other=(control.OpenLoop(GAIT), OTHER),
        share=(0.5, NOT_NEGATIVE, ROWS),
    ),
    _of(
        control.Deployed,
        environment=(control.environment("heading", jaxgrity.load_scene("exact")), OTHER),
        policy=(lambda seen: seen[:6], OTHER),
        heading=(np.ones(2), ANY, ROWS),
        goal=(None, OTHER),
    ),
    _of(
        control.Sensors,
        noise=(control.Errors(), OTHER),
        bias=(control.Errors(), OTHER),
        every=(1, COUNT),
        delay=(1, INDEX),
    ),
    _of(
        jaxgrity.SearchConfig,
        duration=(40.0, POSITIVE),
        population=(16, COUNT),
        generations=((2, 2), OTHER),
        optimiser=("genetic", OTHER),
        from_gait=(False, OTHER),
        wide=(True, OTHER),
        dt=(1e-3, POSITIVE),
        seed=(0, INDEX),
        space=(search.SearchSpace(), OTHER),
        evaluation=(search.EvaluationConfig(), OTHER),
        polish=(None, OTHER),
    ),
    _of(
        search.SearchSpace,
        members=("scene", OTHER),
        active=(2, COUNT),
        amplitude=((0.1, 0.2), OTHER),
        scaled=(False, OTHER),
        frequency=((0.1, 0.2), OTHER),
        ramp=(0.5, POSITIVE),
        waves=("every", OTHER),
        overtones=(0, INDEX),
    ),
    _of(
        search.EvaluationConfig,
        objective=(jaxgrity.SteadySpeed(), OTHER),
        bounds=(jaxgrity.ActuatorBounds(), OTHER),
        uncertainty=(jaxgrity.Uncertainty(phase=0.1), OTHER),
        robots=(2, COUNT),
        caution=(1.0, NOT_NEGATIVE),
        both_models=(True, OTHER),
        attracting=(True, OTHER),
    ),
    _of(
        control.LearningConfig,
        robots=(8, COUNT),
        held=(2, COUNT),
        decisions=(2, COUNT),
        epochs=(2, COUNT),
        batches=(2, COUNT),
        discount=(0.5, NOT_NEGATIVE),
        trace=(0.5, NOT_NEGATIVE),
        clip=(0.5, POSITIVE),
        entropy=(0.5, NOT_NEGATIVE),
        divergence=(0.5, POSITIVE),
        width=(8, COUNT),
        depth=(2, INDEX),
        symmetric=(True, OTHER),
    ),
]
"""one of each class; functions stand for what they make"""


def wrong_values(value: Any, kind: str, shape: str = "") -> Iterator[Any]:
    """What a field of this kind may not hold; `value` is one that it may."""
    if kind == OTHER:
        return
    yield from ("1.0", True, 1j)
    if kind in (COUNT, INDEX):
        yield from (2.5, -1, np.nan, np.ones(2))
        yield from ([0] if kind == COUNT else [])
        return
    for number in (np.nan, np.inf, *([] if kind == ANY else [-0.5]), *([0.0] if kind == POSITIVE else [])):
        bad = np.array(value, float)
        bad[(0,) * bad.ndim] = number
        yield bad if bad.ndim else number
    if shape != ROWS:
        yield np.ones((*np.shape(value), 2))


MADE = {
    *("Body", "Command", "Environment", "EnvironmentState", "Learned", "Outcomes", "Plant", "ResolvedOptions"),
    *("RodContact", "Trajectory"),
}
"""Names of classes whose objects functions make, or hand out."""
NUMBERLESS = {"HeightFunction", "OpenLoop", "Union"}
"""Names of classes that hold no numbers themselves."""


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.make.__name__)
@pytest.mark.filterwarnings("ignore:A JAX array is being set as static")
def test_what_a_field_may_not_hold_is_refused(example):
    """By `InputError`, where it is made; annotations are not checked meanwhile, since users have no such checks."""
    jaxtyping.config.update("jaxtyping_disable", True)  # of this test alone: conftest.py sets it anew for each
    given = {name: value for name, (value, *_) in example.fields.items()}
    example.make(**given)
    taken = []
    for name, field in example.fields.items():
        for wrong in wrong_values(*field):
            try:
                example.make(**{**given, name: wrong})
            except jaxgrity.InputError:
                continue
            taken.append((name, wrong))
    assert not taken


def test_every_class_that_is_filled_has_an_example():
    """And every field of it is named there."""
    rooms = [jaxgrity, *(getattr(jaxgrity, room) for room in ("control", "model", "populations", "search", "stepping"))]
    public = {name: getattr(room, name) for room in rooms for name in room.__all__ if name[0].isupper()}
    filled = {
        name: kind
        for name, kind in public.items()
        if inspect.isclass(kind) and dataclasses.is_dataclass(kind) and not inspect.isabstract(kind)
    }
    known = {example.make.__name__: example for example in EXAMPLES}
    for name, kind in filled.items():
        fields = {field.name for field in dataclasses.fields(kind) if field.init}
        if fields and name not in MADE | NUMBERLESS:
            assert fields == set(known[name].fields), name
