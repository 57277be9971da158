"""What the tests share: float64, hypothesis without time limits or files, the reference scene, finite differences."""

import ctypes
import gc
import os
import shutil
from collections.abc import Callable
from pathlib import Path

# As every command sets it (jaxgrity.cli.script), before Equinox is imported: compiled programs then call nothing back,
# and can be kept.
os.environ.setdefault("EQX_ON_ERROR", "nan")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import hypothesis
import jax
import jaxtyping
import numpy as np
import pytest
import shape_checks  # noqa: F401  before the package is imported
from measurements import conformance_statics
from meter import Meter

# Kernels made as the commands have them made (jaxgrity.cli.script), and each program in one piece: a test process has
# one core.
KERNELS = "--xla_cpu_use_fusion_emitters=false" if jax.__version_info__ < (0, 11) else ""
os.environ.setdefault("XLA_FLAGS", f"{KERNELS} --xla_cpu_parallel_codegen_split_count=1".strip())

jax.config.update("jax_enable_x64", True)

# Tracing makes millions of objects that live on in caches: looking through them as often as Python does by itself takes
# a sixth of the time.
gc.set_threshold(200_000, 50, 100)

# A program is compiled once for all test processes, the commands that they start, and the next run.
COMPILED = Path(__file__).parents[1] / ".cache" / "jax-tests"
SIZES = "slow", "campaign"
"""marks of all tests but the fast ones"""
LONG = {
    *("experiments", "explorer", "trust"),
    *("test_bounces", "test_commands", "test_complementarity", "test_finding", "test_learning", "test_methods"),
    *("test_pipeline", "test_population", "test_rolling", "test_scales", "test_speed_forecast"),
    *("test_draws", "test_gym"),
}
"""Folders and files of tests with long simulations, many robots, or numbers that agree to the last bit: their programs
are optimised. So are campaigns'."""
for name, value in {
    "JAX_COMPILATION_CACHE_DIR": str(COMPILED),
    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.0",
}.items():
    os.environ.setdefault(name, value)
jax.config.update("jax_compilation_cache_dir", os.environ["JAX_COMPILATION_CACHE_DIR"])
jax.config.update(
    "jax_persistent_cache_min_compile_time_secs", float(os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"])
)

# The same examples on every run, so that a failure on one machine is a failure on all.
hypothesis.settings.register_profile("jaxgrity", deadline=None, max_examples=30, derandomize=True, database=None)
hypothesis.settings.load_profile("jaxgrity")


def pytest_configure(config):
    """Each of several test processes keeps to its own cores: they spend a quarter longer where threads compete."""
    config.pluginmanager.register(Meter(SIZES, COMPILED.parent), "meter")
    worker = getattr(config, "workerinput", None)
    if worker is None and sum(path.stat().st_size for path in COMPILED.glob("*")) > 1e9:
        # nothing else ever removes a program from there
        shutil.rmtree(COMPILED)
    if worker is not None and hasattr(os, "sched_setaffinity"):
        cores, number = sorted(os.sched_getaffinity(0)), int(worker["workerid"].removeprefix("gw"))
        count = worker["workercount"]
        if len(cores) >= count:
            os.sched_setaffinity(0, cores[number % count :: count])


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    """Fast tests check the shapes of all arrays too (`shape_checks`); in the others that would cost too much time.

    What runs for a moment is not optimised by LLVM, which takes half of the time in which a program is made.
    """
    known = any(item.get_closest_marker(name) for name in SIZES)
    jaxtyping.config.update("jaxtyping_disable", known)
    long = item.get_closest_marker("campaign") or LONG & {item.path.stem, item.path.parent.name}
    jax.config.update("jax_disable_most_optimizations", not long)
    return (yield)


def pytest_collection_finish(session):
    """What was imported lives until the end: each later collection need not look through it."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="module", autouse=True)
def _forget_compiled_programs():
    """Thousands of them do not fit into one process: Linux allows it 65,530 memory maps, and they take some each. With
    what was traced for them they would grow to 7 GB.

    To forget takes seconds, and what is needed again is traced and read anew: so it waits until memory runs short.
    """
    yield
    maps = Path("/proc/self/maps")
    if not maps.exists() or maps.read_text().count("\n") > 45_000 or _memory() > _share_of_memory():
        jax.clear_caches()
        gc.collect()
        if hasattr(library := ctypes.CDLL(None), "malloc_trim"):
            library.malloc_trim(0)  # what is free goes back to the system


def _memory() -> float:
    """Bytes of memory that this process holds."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def _share_of_memory() -> float:
    """Bytes that each test process may hold: together they take half of the machine's memory, of 2 to 4 GB each.

    No more, since a container may have less memory than its machine.
    """
    there = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return min(4e9, max(2e9, 0.5 * there / int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))))


@pytest.fixture(scope="session")
def reference():
    """The robot of the scene "reference": every term but the Coulomb switch."""
    from jaxgrity import load_scene

    return load_scene("reference")


@pytest.fixture(scope="session")
def exact():
    """The same robot with rigid struts, exact contact and Coulomb's cone: the scene "exact"."""
    from jaxgrity import load_scene

    return load_scene("exact")


@pytest.fixture(scope="session")
def creeping():
    """Two unequal masses on a strut that lengthens faster than it shortens, so that it creeps over the ground."""
    from jaxgrity import Gait, Members, Overtone, PenaltyGround, Scene, SmoothFriction, Structure

    nodes = np.array([[0.0, 0, -1e-3], [1, 0, -1e-3]])
    struts = Members(((0, 1),), [2e3], [1.1], damping=[20.0])
    gait = Gait((0,), [0.0], [0.2], [1.0], start=0.0, ramp=1.0, overtones=(Overtone([0.5], [np.pi / 2]),))
    return Scene(
        Structure(nodes, [1.0, 3.0], struts=struts),
        gravity=9.81,
        ground=PenaltyGround(1e4, 2.0),
        friction=SmoothFriction(0.2, 0.2),
        gait=gait,
    )


@pytest.fixture(scope="session")
def crawler(creeping):
    """That strut, its orbit, which is smooth, for derivatives of its speed, and the options of both."""
    from jaxgrity import SolverOptions
    from jaxgrity.orbits import find_orbit
    from jaxgrity.stepping import resolve

    options = resolve(creeping, 1.0, SolverOptions("rk4", 2e-3))
    return creeping, find_orbit(creeping, 60.0, options=options), options


@pytest.fixture(scope="session")
def central_difference() -> Callable:
    """`central_difference(f, x, h)`: df/dx of a function of one number, with an error of order h^2."""
    return lambda f, x, h: (f(x + h) - f(x - h)) / (2 * h)


@pytest.fixture(scope="session")
def tower_answers():
    """What is published of a tower of two stacked prisms (TsgFEM, a MATLAB toolbox)."""
    return conformance_statics.RODS["tower"]


@pytest.fixture(scope="session")
def published_tower():
    """That tower on its three supports, struts and cables with mass."""
    return conformance_statics.published_tower()
