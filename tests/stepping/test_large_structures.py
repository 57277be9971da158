"""Large structures: the motions that limit the step, by sparse matrices, are those that dense matrices show."""

import dataclasses
import tracemalloc

import numpy as np
import pytest

from jaxgrity import (
    METHODS,
    ConeFriction,
    ExactGround,
    InputError,
    Members,
    PenaltyGround,
    Scene,
    SolverOptions,
    Structure,
    parse_scene,
)
from jaxgrity.model.scales import time_scale
from jaxgrity.model.scene import with_gait
from jaxgrity.stepping import resolve, standing
from jaxgrity.stepping import step_limits as limits
from jaxgrity.stepping.leading_modes import leading_modes, surely_stable
from jaxgrity.stepping.linearised import largest_step, linearise
from jaxgrity.stepping.sparse_motion import sparse_motion
from jaxgrity.structures import prism_tower

SAME = 1e-6
"""Largest relative difference between both limits."""


def undamped(scene: Scene) -> Scene:
    kinds = [Members(m.edges, m.stiffness, m.rest_length) for m in (scene.structure.struts, scene.structure.cables)]
    return Scene(Structure(scene.structure.nodes, scene.structure.node_mass, *kinds))


def heavy_and_held(scene: Scene) -> Scene:
    """With mass in the cables, and two supports."""
    cables = dataclasses.replace(scene.structure.cables, mass=np.full(len(scene.structure.cables.edges), 0.2))
    return dataclasses.replace(
        with_gait(scene, None),
        structure=dataclasses.replace(scene.structure, cables=cables, fixed=((0, "xyz"), (5, "xz"))),
    )


EXACT = """
    ground = {contact = "complementarity"}
    friction = {kind = "cone", mu = 0.5}
"""
PENALTY = """
    ground = {contact = "penalty", stiffness = 2e4, dissipation = 1.0}
    friction = {kind = "smooth", mu = 0.5, slip_speed = 0.01}
"""


def robot(kind: str, contact: str) -> Scene:
    """A robot of rigid bodies, with dampers."""
    return parse_scene(f"""
        structure = {{kind = "{kind}", prestress = 30.0}}
        cables = {{stiffness = 2000.0, damping = 5.0}}
        damping = {{node = 0.05}}
        gravity = {{}}
        {contact}""")


SCENES = {
    "penalty": lambda: prism_tower(9, exact=False),
    "exact": lambda: prism_tower(9, exact=True),
    "undamped": lambda: undamped(prism_tower(9, exact=False)),
    "rigid": lambda: undamped(prism_tower(9, exact=True)),
    "held, with mass in cables": lambda: heavy_and_held(prism_tower(9, exact=False)),
    "bodies with hinges": lambda: robot("hinged_spine", EXACT),
    # friction at a ball depends on how its body turns
    "bodies with balls": lambda: robot("superball", PENALTY),
}
SHOWN = ("exact", "held, with mass in cables", "bodies with balls")
"""Those of `make test`: rigid struts with dampers, springs with supports, and rigid bodies."""


@pytest.mark.campaign
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in SHOWN else pytest.mark.campaign) for name in SCENES]
)
def test_both_ways_find_the_same_limit(name):
    """Standing and aloft, by every method that takes the scene, with dampers, rigid struts and supports."""
    scene = SCENES[name]()
    for method in METHODS.values():
        rigid = scene.constrained
        if method.implicit or method.constrained != rigid or (method.symplectic and scene.dissipates):
            continue
        for case in limits._cases(scene):
            dense = largest_step(linearise(*case), method)
            motion = sparse_motion(*case)
            assert largest_step(leading_modes(motion, method), method) == pytest.approx(dense, rel=SAME), method.name
            assert not surely_stable(motion, method, 1.01 * dense), method.name


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    ["exact", *(pytest.param(name, marks=pytest.mark.campaign) for name in ("rigid", "held, with mass in cables"))],
)
def test_closer_bounds_are_those_of_the_dense_motion(name):
    """The largest stiffness and damping among motions that keep the constraints, at most 2 % more."""
    for case in limits._cases(SCENES[name]()):
        linear, bounds = linearise(*case), sparse_motion(*case).closer_bounds()
        for bound, dense in zip(bounds, linear[:2]):
            largest = np.linalg.eigvals(dense).real.max()
            assert largest <= bound <= 1.02 * largest + 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("name", ["penalty", "exact"])
def test_a_default_step_that_a_bound_shows_is_that_of_the_eigenvalues(name):
    """All steps of 1, 2 and 5 times a power of ten below 0.4 of the limit and the largest default one."""
    scene, method = SCENES[name](), METHODS["complementarity" if name == "exact" else "rk4"]
    most = limits.LARGEST_STEP * float(time_scale(scene))
    assert limits.default_step(scene, method) == limits._rounded(min(0.4 * limits.strictest(scene, method)[0], most))


def test_a_bound_shows_that_a_small_step_is_stable():
    """Without eigenvalues, on both contact models; never beyond the limit, as the test above shows."""
    for exact, method in ((False, "rk4"), (True, "complementarity")):
        taut = limits.all_taut(prism_tower(9, exact))
        motion = sparse_motion(*limits.aloft(taut))
        limit = largest_step(leading_modes(motion, METHODS[method]), METHODS[method])
        assert surely_stable(motion, METHODS[method], 0.1 * limit)


def test_large_structures_take_the_sparse_way(monkeypatch):
    """Their message names a part, and a step of one's own that is small enough needs no eigenvalues."""
    scene = prism_tower(27, exact=False)
    monkeypatch.setattr(limits, "linearise", None)
    with pytest.raises(InputError, match=r"dt = 0\.1 s is too large for rk4.*set by friction at node [0-5]$"):
        resolve(scene, 1.0, SolverOptions(dt=0.1))
    monkeypatch.setattr(limits, "leading_modes", None)
    assert resolve(scene, 1.0, SolverOptions(dt=5e-5)).dt == 5e-5


def test_slow_growth_of_a_column_is_no_fault_of_the_step():
    """Rigid struts under a weight lean over, faster and faster: the limit is that of the stiff cables."""
    scene = with_gait(prism_tower(9, exact=True), None)
    state = standing(scene)
    linear = leading_modes(sparse_motion(scene, state), METHODS["complementarity"])
    assert linear.modes()[0].real.max() == pytest.approx(linearise(scene, state).modes()[0].real.max(), rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    "ground",
    [
        pytest.param(ExactGround(), id="exact"),
        pytest.param(PenaltyGround(1e4, 1.0), id="penalty", marks=pytest.mark.campaign),
    ],
)
def test_memory_does_not_grow_as_the_square_of_the_nodes(ground):
    """Thousands of separate nodes on the ground: one dense matrix of their coordinates has 7 GB, or 0.6 GB."""
    count = 10_000 if isinstance(ground, ExactGround) else 3000
    nodes = np.column_stack([np.random.default_rng(0).uniform(0, 10, (count, 2)), np.zeros(count)])
    friction = ConeFriction(0.5) if isinstance(ground, ExactGround) else None
    scene = Scene(Structure(nodes, np.ones(len(nodes))), 9.81, ground=ground, friction=friction)
    tracemalloc.start()
    try:
        assert resolve(scene).dt > 0
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 1e4 * 3 * count
