"""Environments that a learned policy never saw in training: finer steps, the other contact model, bad sensors."""

from jaxgrity import Scene, contact_twin
from jaxgrity.control import Environment, Errors, Sensors, environment

BAD = Sensors(noise=Errors(directions=0.02, spins=0.1, cable_lengths=0.002, tensions=1.0, contact=0.01), delay=3)
"""Noise of 0.02, 0.1 rad/s, 2 mm and 1 N, 1 % of contacts wrong, all of it 30 ms late."""


def unseen(task: str, scene: Scene) -> dict[str, Environment]:
    """The same task in float64 at the default steps, then also with the other contact model, or with bad sensors."""
    return {
        "finer": environment(task, scene),
        "other": environment(task, contact_twin(scene)),
        "erring": environment(task, scene, sensors=BAD),
    }
