"""Numbers that are none: refused in one line where they are known, and failures of the motion where they are not."""

import subprocess
import sys
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgrity
from jaxgrity import ExactGround, Gait, HeightFunction, InputError, Members, Overtone, PenaltyGround, Scene, Structure
from jaxgrity.model.external import Push, Wind, wind
from jaxgrity.model.motors import Motor
from jaxgrity.model.shaking import Shaking

NAN = np.nan


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: PenaltyGround(1e4, incline=NAN), "incline = nan rad: expected a finite number"),
        (lambda: PenaltyGround(1e4, incline=2.0), "incline = 2 rad: expected an angle of less than pi/2"),
        (lambda: jaxgrity.Sphere([NAN, 0, 0], 1.0), r"sphere.centre\[0\] = nan: expected a finite number"),
        (lambda: jaxgrity.Sphere([0, 0, 0], [1.0, 2.0]), r"sphere.radius has shape \(2,\); expected one number"),
        (lambda: jaxgrity.Box([0, 0, 0], [1.0, 1.0]), r"box.size has shape \(2,\); expected \(3,\)"),
        (lambda: jaxgrity.Box([0, 0, 0], [1.0, 1.0, 1.0], turn=NAN), "box.turn = nan: expected a finite number"),
        (lambda: jaxgrity.Cylinder([0, 0, 0], [0, NAN, 1], 0.1), r"cylinder.end\[1\] = nan"),
        (
            lambda: jaxgrity.HeightWaves([0.1], [0.0], [0.0], [0.0]),
            r"waves.length\[0\] = 0 m: expected a positive number",
        ),
        (lambda: jaxgrity.HeightWaves([NAN], [1.0], [0.0], [0.0]), r"waves.amplitude\[0\] = nan"),
        (lambda: jaxgrity.bumps(0.1, np.inf, seed=1), "bumps.length = inf: expected a positive number"),
        (lambda: jaxgrity.height_map(np.zeros((4, 4)), (1.0, 1.0), (NAN, 0.0)), r"centre\[0\] = nan"),
        (lambda: jaxgrity.height_map(np.zeros((4, 4)), (np.inf, 1.0)), "size = .*: expected two positive numbers, m"),
        (lambda: jaxgrity.height_map([[0, 1], [1]], (1.0, 1.0)), "heights: expected rows of numbers"),
        (lambda: wind([NAN, 0, 0], 0.1, 12), r"wind.velocity\[0\] = nan: expected a finite number"),
        (lambda: wind([1, 0, 0], [0.1, 0.2], 12), r"wind.drag has shape \(2,\); expected one number, or \(12,\)"),
        (lambda: Wind(np.zeros((12, 3)), np.ones(12)), r"wind.velocity has shape \(12, 3\); expected \(3,\)"),
        (lambda: Wind(np.zeros(3), np.full(12, np.inf)), r"wind.drag\[0\] = inf: expected a finite number"),
        (lambda: Push((1,), [[NAN, 0, 0]], 0.0, 1.0), r"push.force\[0, 0\] = nan: expected a finite number"),
        (lambda: Push((1,), [[1, 0, 0]], 0.0, np.inf), "push.duration = inf: expected a finite number"),
        (lambda: Motor(-1, [0.1], [1.0], 1.0), "motor.member = -1: expected a whole number from 0 on"),
        (lambda: Motor(0, [0.1], [NAN], 1.0), r"motor of member 0.lengths\[0\] = nan: expected a finite number"),
        (lambda: Motor(0, [0.1], [1.0], [1.0, 2.0]), r"motor of member 0.rate has shape \(2,\); expected one number"),
        (lambda: Gait((0,), [NAN], [0.1], [1.0]), r"gait.phase\[0\] = nan: expected a finite number"),
        # at an amplitude of 2 a strut of 1 m had a rest length of -1 m; overtones whose sizes sum to -1 gave NaN
        (lambda: Gait((0, 1), [0.0, 0.0], [0.3, 2.0], [1.0, 1.0]), "gait.amplitude = 2.0: expected 0 to less"),
        (lambda: Gait((0,), [0.0], [-0.3], [1.0]), "gait.amplitude = -0.3: expected 0 to less"),
        (
            lambda: Gait((0,), [0.0], [0.3], [-2.0]),
            r"gait.frequency\[0\] = -2 Hz: expected a finite number, at least 0",
        ),
        (lambda: Overtone([-1.0], [0.0]), r"overtone.size\[0\] = -1: expected a finite number, at least 0"),
        # a spring that pushes apart what is stretched, a damper that drives, a rod that weighs less than nothing
        (
            lambda: Members(((0, 1),), [-1.0], [1.0]),
            r"members.stiffness\[0\] = -1: expected a finite number, at least 0",
        ),
        (
            lambda: Members(((0, 1),), [1.0], [-1.0]),
            r"members.rest_length\[0\] = -1: expected a finite number, at least 0",
        ),
        (
            lambda: Members(((0, 1),), [1.0], [1.0], damping=[-1.0]),
            r"members.damping\[0\] = -1: expected a finite number, at least 0",
        ),
        (
            lambda: Members(((0, 1),), [1.0], [1.0], mass=[-1.0]),
            r"members.mass\[0\] = -1: expected a finite number, at least 0",
        ),
        (lambda: Members(((2, 2),), [1.0], [1.0]), r"members.edges\[0\] = \(2, 2\): expected two nodes"),
        (lambda: Shaking([NAN, 0, 0], 1.0), r"shaking.amplitude\[0\] = nan: expected a finite number"),
        (lambda: Shaking([0.1, 0, 0], NAN), "shaking.frequency = nan: expected a finite number"),
    ],
)
def test_bad_arguments_are_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()


@pytest.mark.slow
def test_arguments_of_other_types_are_refused():
    """In a process of its own: here annotations are checked, and would speak first."""
    program = """
import numpy as np, jaxgrity
from jaxgrity import *
from jaxgrity.control.learned import check_acting
for make in (
    lambda: Slope("steep"),
    lambda: Stairs(0.1, 0.3, 2.5),
    lambda: bumps(0.1, 1.0, seed=1.5),
    lambda: bumps(0.1, 1.0, 1, waves=2.5),
    lambda: HeightFunction(3),
    lambda: Union((3,)),
    lambda: Push((1.5,), [[1, 0, 0]], 0.0, 1.0),
    lambda: jaxgrity.control.MotorLimits(stroke="half"),
    lambda: Gait((0.7, 1.2), [0.0] * 2, [0.1] * 2, [1.0] * 2),
    lambda: Members(((0, 1.5),), [1.0], [1.0]),
    lambda: Structure(np.eye(3), np.ones(3), fixed=(2,)),
    lambda: jaxgrity.control.environment("speed", "exact"),
    lambda: jaxgrity.control.environment("speed", load_scene("exact"), seconds="1"),
    lambda: jaxgrity.control.plant_of(load_scene("exact"), (0.7, 1.2)),
    lambda: jaxgrity.control.plant_of(load_scene("exact"), load_gait("lasting")),
    lambda: Union([Slope()]),
    lambda: jaxgrity.control.MotorLimits(stroke=None),
    lambda: jaxgrity.control.Sensors(noise=jaxgrity.control.Errors(place="far")),
    lambda: jaxgrity.control.Steered(load_gait("lasting"), 0.1, np.zeros((6, 6))),
    lambda: jaxgrity.control.Blend(jaxgrity.control.OpenLoop(load_gait("lasting")), load_gait("lasting"), 0.5),
    lambda: jaxgrity.control.gait_choices(load_scene("exact").structure, {"one": load_gait("lasting")}),
    lambda: jaxgrity.control.GymnasiumEnvironment("goal"),
    lambda: check_acting(None, "heading"),
):
    try:
        print(make())
    except InputError as error:
        print(error)
"""
    told = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    expected = """\
incline = 'steep' rad: expected a finite number
stairs.steps = 2.5: expected a whole number, at least 1
bumps.seed = 1.5: expected a whole number from 0 on
bumps.waves = 2.5: expected a whole number, at least 1
heights = 3: expected a function of x and y, m
union.parts = (3,): expected at least one surface, in a tuple
push.nodes[0] = 1.5: expected a whole number from 0 on
motors.stroke = 'half': expected a positive, finite number, or None
gait.members = [0.7, 1.2]: expected whole numbers
members.edges[0] = (0, 1.5): expected two nodes, as whole numbers
structure.fixed has 2; expected a node and its axes, such as (0, 'xyz')
environment: scene is 'exact'; expected a Scene; pass jaxgrity.load_scene('exact')
environment: seconds is '1'; expected a number
members[0] = 0.7: expected a whole number from 0 to 29
members = Gait: expected at least one that is actuated, as (0, 1, 2)
union.parts = list: expected at least one surface, in a tuple
motors.stroke = None: expected less than 1, a fraction of a member's length
sensors.noise.place = 'far': expected a finite number, at least 0
Steered: policy is a Gait; expected a Policy
Blend: other is a Gait; expected a Policy
gaits: 'one' is a Gait; expected feedback: PhaseLocked(gait)
GymnasiumEnvironment: environment is 'goal'; expected an Environment; jaxgrity.control.environment(task, ...) makes one
policy = 'heading': expected a function of observations, as load_policy makes one
"""
    assert told == expected


@pytest.mark.parametrize(
    ("part", "message"),
    [
        ("structure.nodes", r"structure.nodes\[0, 0\] = nan"),
        ("structure.node_mass", r"structure.node_mass\[0\] = nan"),
        ("structure.cables.rest_length", r"(structure.cables|members).rest_length\[0\] = nan"),
        ("structure.cables.stiffness", r"(structure.cables|members).stiffness\[0\] = nan"),
        ("node_damping", r"node_damping\[0\] = nan"),
    ],
)
def test_a_scene_with_a_number_that_is_none_is_refused(part, message, reference):
    """As soon as it is made; where JAX holds the number, as soon as it is to move."""
    *way, name = part.split(".")
    owners = [reference]
    for step in way:
        owners.append(getattr(owners[-1], step))
    value = np.array(getattr(owners[-1], name), float)
    value.flat[0] = NAN

    def made(value):
        found = replace(owners[-1], **{name: value})
        for owner, step in zip(owners[-2::-1], reversed(way)):
            found = replace(owner, **{step: found})
        return found

    with pytest.raises(InputError, match=message):
        made(value)
    with pytest.raises(InputError, match=message):
        jaxgrity.simulate(made(jnp.asarray(value)), 0.1)


def test_what_acts_on_nodes_that_are_not_there_is_refused(reference):
    """A wind for another robot, a push at a node beyond the last, and shaking along an axis that no support holds."""
    with pytest.raises(InputError, match="wind: it is that on 11 nodes; expected nodes = 12"):
        jaxgrity.with_terms(reference, wind([1, 0, 0], 0.1, nodes=11))
    with pytest.raises(InputError, match=r"push.nodes\[0\] = 99: expected a whole number from 0 to 11"):
        jaxgrity.with_terms(reference, Push((99,), [[1, 0, 0]], 0.0, 1.0))
    held = replace(reference, structure=replace(reference.structure, fixed=((0, "z"),)))
    with pytest.raises(InputError, match=r"shaking.amplitude along x: no support is fixed so"):
        replace(held, shaking=Shaking([0.1, 0, 0], 1.0))


@pytest.mark.slow
@pytest.mark.parametrize("ground", [pytest.param(PenaltyGround(1e4, 2.0), marks=pytest.mark.campaign), ExactGround()])
def test_ground_that_ends_in_nothing_is_a_failure(ground):
    """Two nodes slide to where the height is no number, on the ground and above it."""
    surface = HeightFunction(lambda x, y: jnp.where(x > 0.05, jnp.nan, 0 * x))
    nodes = np.array([[0.0, 0, 0], [0, 0.3, 0]])
    body = Structure(nodes, np.ones(2), cables=Members(((0, 1),), [10.0], [0.3]))
    scene = Scene(body, gravity=9.81, ground=replace(ground, surface=surface))
    still = jaxgrity.simulate(scene, 0.1)
    assert not still.failed
    moving = np.array([[1.0, 0, 0]] * 2)
    for height in (0.0, 0.5):
        assert jaxgrity.simulate(scene, 0.1, positions=nodes + np.array([0, 0, height]), velocities=moving).failed


@pytest.mark.parametrize("name", [pytest.param("reference", marks=pytest.mark.campaign), "exact"])
def test_a_traced_number_that_is_none_is_a_failure(name, request):
    """Cables of no length would be slack, and the motion finite."""
    scene = jaxgrity.with_gait(request.getfixturevalue(name), None)
    options, lengths = jaxgrity.stepping.resolve(scene, 0.02), jnp.asarray(scene.structure.cables.rest_length)

    @jax.jit
    def fine(lengths):
        changed = eqx.tree_at(lambda s: s.structure.cables.rest_length, scene, lengths)
        return jaxgrity.rollout(changed, np.array([0.0, 0.02]), options=options).ok

    assert fine(lengths)
    assert not fine(lengths.at[0].set(jnp.nan))
