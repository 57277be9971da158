"""Several processes as one: a search on two of them finds what one finds. Several devices: each program once."""

import os
import socket
import subprocess
import sys

import numpy as np
import pytest

SEARCH = """
import os
import jax
from jaxgrity.cli.script import configure, join_hosts
configure()
join_hosts()
from jaxgrity import Fitness, GAConfig, Genome, SolverOptions, evolve, load_scene
from jaxgrity import SearchProblem
problem = SearchProblem(load_scene("exact"), Genome(6), 1.5, Fitness())
search = evolve(problem, GAConfig(12, 2, elites=2), options=SolverOptions(dt=1e-2, dtype="float64"))
print("hosts", jax.process_count(), "devices", jax.device_count())
print(*(float(x).hex() for x in search.last.fitness))
"""

COMPILED = """
import collections, logging, re
import jax
from jaxgrity.cli.script import configure
configure()
jax.config.update("jax_log_compiles", True)
jax.config.update("jax_enable_compilation_cache", False)
import numpy as np
from jaxgrity import *
compiled = collections.Counter()
class Counting(logging.Handler):
    def emit(self, record):
        compiled.update(re.findall(r"Finished XLA compilation of jit\\((\\w+)\\)", record.getMessage()))
logging.getLogger("jax").addHandler(Counting())
# three nodes in a row on two struts, in a medium: what is compiled for each step does not matter here
nodes, one = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]]), np.ones(2)
structure = Structure(nodes, np.ones(3), Members(((0, 1), (1, 2)), 100 * one, one))
gait = Gait((0, 1), 0 * one, 0.3 * one, one, start=0.0, ramp=0.5)
scene, options = Scene(structure, node_damping=np.array([0.5, 1.0, 3.0]), gait=gait), SolverOptions(dt=1e-2)
verify(scene, gaits_of(gait, random_phases(4, 2, seed=0)), 0.5)
problem = SearchProblem(scene, Genome(2), 0.5, Fitness(uncertainty=Uncertainty(phase=0.03), robots=2))
search = evolve(problem, GAConfig(8, 3, elites=2), options=SolverOptions(dt=1e-2, dtype="float32"))
polish(problem, search.last.genes[:1], PolishConfig(32, samples=4, robots=2, final_robots=4), options=options)
print("devices", jax.device_count())
print(*(f"{name} {compiled[name]}" for name in ("roll_out", "breed", "_estimates", "_worth")))
"""


def start(code=SEARCH, **environment):
    """A process that runs the code: the search, unless it is given another."""
    known = {k: v for k, v in os.environ.items() if not k.startswith(("SLURM", "JAX_"))}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen([sys.executable, "-W", "error", "-c", code], env=known | environment, **pipes)


def lines(process) -> list[str]:
    out, errors = process.communicate()
    assert process.returncode == 0, errors
    return [line for line in out.splitlines() if not line.startswith("[Gloo]")]


@pytest.mark.campaign
def test_two_hosts_find_what_one_finds():
    """To the last bit, in float64, with as many devices; within 1e-12 with one, whose vectors are twice as long."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    shared = {"JAX_COORDINATOR_ADDRESS": address, "JAX_NUM_PROCESSES": "2"}
    hosts = [start(**shared, JAX_PROCESS_ID=str(k)) for k in range(2)]
    try:
        first, second = (lines(host) for host in hosts)
    finally:
        for host in hosts:
            host.kill()
    (both, fitness), (one, close) = (lines(start(JAX_NUM_CPU_DEVICES=str(count))) for count in (2, 1))
    assert (both, one) == ("hosts 1 devices 2", "hosts 1 devices 1")
    assert first == second == ["hosts 2 devices 2", fitness]
    values = ([float.fromhex(x) for x in line.split()] for line in (fitness, close))
    np.testing.assert_allclose(*values, rtol=0, atol=1e-12)


@pytest.mark.campaign
def test_each_program_is_compiled_once_on_two_devices():
    """The three steps of an error bar share a program of rollouts, all generations and steps of polish another, in
    float32, and the last judgement has a third, in float64."""
    devices, compiled = lines(start(COMPILED, JAX_NUM_CPU_DEVICES="2"))
    assert devices == "devices 2"
    assert compiled == "roll_out 3 breed 1 _estimates 1 _worth 2"
