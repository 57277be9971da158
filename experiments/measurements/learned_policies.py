"""How well the library's learned policies do where they were not trained: contact, sensors, ground, falls, friction."""

from collections.abc import Iterator
from dataclasses import replace

import jax
import numpy as np
from measurements.measurement import Record, measurement
from measurements.pages import columns
from measurements.unseen import unseen

from jaxgrity import Push, Scene, bumps, load_scene, with_error
from jaxgrity.control import Environment, environment, load_policy, policy_names, trials

IMPULSE, LASTING, RAMP = 6.0, 0.1, 0.01
"""Of a push: N s, which change the robot's velocity by 1 m/s; its duration at full force, and its rise, s."""
ROLLS = 0.3
"""Mean progress from which an episode counts as rolling, m/s: a fifth of what such policies reach."""


@measurement(page="environments.md", quick={"episodes": 2, "names": ("speed",)})
def learned_policies(names: tuple[str, ...] = policy_names(), episodes: int = 256) -> Iterator[Record]:
    """A row for each policy of the library.

    Args:
        names: of policies, which are those of tasks
        episodes: new ones, each from another start, by which a policy is judged
    """
    for name in names:
        policy, scene = load_policy(name), load_scene("exact")
        for kind, env in kinds(name, scene).items():
            progress = trials(env, policy, jax.random.key(2000), episodes)
            yield {
                "policy": name,
                "kind": kind,
                "progress": float(progress.mean()),
                "error": 2 * float(progress.std(ddof=1)) / episodes**0.5,
                "rolls": float((progress > ROLLS).mean()),
            }
    return {"episodes": episodes}


def kinds(task: str, scene: Scene) -> dict[str, Environment]:
    """The same task where something is other than it was in training."""
    rough = replace(scene, ground=replace(scene.ground, surface=bumps(0.02, 1.0, seed=0)))
    slippery = replace(scene.friction, mu=0.6 * scene.friction.mu)
    shared = unseen(task, scene)
    pushes = tuple(pushed(scene, start) for start in (3.0, 5.0, 7.0))
    found = {
        "as trained, steps of 5 ms in float64": shared["finer"],
        "the other contact model": shared["other"],
        "sensors that err, 30 ms late": shared["erring"],
        "bumps of 2 cm": environment(task, rough),
        "friction 0.6 times as high": environment(task, replace(scene, friction=slippery)),
        "robot 5 % heavier, cables 5 % softer": environment(task, other_robot(scene, 1.05, 0.95)),
        "robot 5 % lighter, cables 5 % stiffer": environment(task, other_robot(scene, 0.95, 1.05)),
        "three pushes of 6 N s": environment(task, replace(scene, terms=pushes)),
    }
    if task == "heading":
        found["after falls from up to a metre"] = environment("recover", scene)
        found["uphill on a slope of 5°"] = environment("slope", scene)
    return found


def other_robot(scene: Scene, mass: float, stiffness: float) -> Scene:
    """The scene with other masses of nodes and another stiffness of cables, as factors."""
    structure = scene.structure
    cables = replace(structure.cables, stiffness=stiffness * structure.cables.stiffness)
    return replace(scene, structure=replace(structure, node_mass=mass * structure.node_mass, cables=cables))


def pushed(scene: Scene, start: float) -> Push:
    """A push along y on all nodes for a tenth of a second, `IMPULSE` in all."""
    nodes = tuple(range(len(scene.structure.nodes)))
    force = np.zeros((len(nodes), 3))
    force[:, 1] = IMPULSE / LASTING / len(nodes)
    return Push(nodes, force, start, LASTING + RAMP, RAMP)


@learned_policies.table
def words(record: Record) -> str:
    """Progress of each policy, and the share of its episodes that roll."""
    found = {(row["kind"], row["policy"]): row for row in record["rows"]}
    names = dict.fromkeys(policy for _, policy in found)

    def cell(name: str):
        def told(kind: str) -> str:
            row = found.get((kind, name))
            return (
                "-" if row is None else f"{with_error(row['progress'], row['error'], decimals=2)}, {row['rolls']:.0%}"
            )

        return told

    cells = {"episodes": lambda kind: kind}
    cells |= {f"`{name}`: progress, m/s; episodes that roll": cell(name) for name in names}
    return columns(list(dict.fromkeys(kind for kind, _ in found)), cells)
