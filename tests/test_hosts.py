"""Several processes as one: a search on two of them finds what one finds."""

import os
import socket
import subprocess
import sys

import numpy as np
import pytest

SEARCH = """
import os
import jax
from common import SCENES, configure, join_hosts
configure()
join_hosts()
from jaxgrity import Breeding, Genome, evolve, load_scene
scene = load_scene(SCENES / "exact.toml")
search = evolve(scene, Genome(6), 1.5, Breeding(12, 2, elites=2), dt=1e-2, dtype="float64", any_step=True)
print("hosts", jax.process_count(), "devices", jax.device_count())
print(*(float(x).hex() for x in search.last.fitness))
"""


def start(**environment):
    """A process that searches, and prints how many processes there were and the fitness of the last generation."""
    known = {k: v for k, v in os.environ.items() if not k.startswith(("SLURM", "JAX_"))}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(
        [sys.executable, "-W", "error", "-c", SEARCH], env=known | environment, cwd="experiments", **pipes
    )


def lines(process) -> list[str]:
    out, errors = process.communicate(timeout=240)
    assert process.returncode == 0, errors
    return [line for line in out.splitlines() if not line.startswith("[Gloo]")]


@pytest.fixture
def root(request, monkeypatch):
    monkeypatch.chdir(request.config.rootpath)


@pytest.mark.usefixtures("root")
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
