"""Whether PPO learns `heading` faster from vectors in the frame of the wanted direction, at equal processor time.

On level ground all headings are alike: turned about the vertical, the robot does the same. A policy that sees all
vectors in the frame of the wanted direction has this symmetry by construction.
"""

from collections.abc import Iterator
from dataclasses import fields

import jax
import jax.numpy as jnp
import numpy as np
from measurements.measurement import Figure, Record, measurement
from measurements.pages import columns
from studies.short_horizon import PPO, learned

from jaxgrity import SolverOptions, load_scene, with_error
from jaxgrity.control import Environment, EnvironmentState, LearningConfig, environment, trials

WORLD, TURNED = "world", "wanted direction"


class InFrame(Environment):
    """An environment whose observations are turned: x points along the wanted direction."""

    def reset(self, key) -> EnvironmentState:
        return self.turned(super().reset(key))

    def step(self, state: EnvironmentState, action) -> EnvironmentState:
        after = super().step(state, action)
        over = state.done > 0  # whose observation is turned already
        return after.replace(obs=jnp.where(over, after.obs, self.turned(after).obs))

    def turned(self, state: EnvironmentState) -> EnvironmentState:
        """The state with directions and spins of the struts, and the wanted direction, turned about the vertical."""
        size = 6 * len(self.plant.scene.structure.struts.edges)
        x, y = state.pipeline_state.aim
        turn = jnp.array([[x, y, 0], [-y, x, 0], [0, 0, 1]], state.obs.dtype)
        vectors = state.obs[:size].reshape(-1, 3) @ turn.T
        at = slice(-self.action_size - 2, -self.action_size)
        wanted = turn[:2, :2] @ state.obs[at]
        return state.replace(obs=state.obs.at[:size].set(vectors.ravel()).at[at].set(wanted))


@measurement(
    page="environments.md",
    quick={"seconds": 0.1, "robots": 8, "episodes": 2},
    raw=("curve",),
)
def turned_frame(
    seeds: tuple[int, ...] = (0,), seconds: float = 90.0, robots: int = 128, episodes: int = 64
) -> Iterator[Record]:
    """A row for each seed and frame.

    Args:
        seeds: of starts, networks and tries
        seconds: of processor time for each policy, without compilation
        robots: side by side
        episodes: new ones, by which a policy is judged
    """
    world = environment("heading", load_scene("exact"), options=SolverOptions(dt=0.01, dtype="float32"))
    turned = InFrame(**{field.name: getattr(world, field.name) for field in fields(world)})
    config = LearningConfig(robots=robots)
    for seed in seeds:
        for frame, env in {WORLD: world, TURNED: turned}.items():
            policy, curve, _ = learned(PPO, env, config, seed, seconds)
            found = trials(env, policy, jax.random.key(1000 + seed), episodes)
            yield {
                "frame": frame,
                "seed": seed,
                "periods": len(curve) * robots * config.decisions * config.held,
                "progress": float(found.mean()),
                "error": 2 * float(found.std(ddof=1)) / episodes**0.5,
                "curve": curve,
            }
    return {"seconds": seconds, "robots": robots, "episodes": episodes}


@turned_frame.table
def words(record: Record) -> str:
    """What is reached in each frame."""
    cells = {
        "frame of the observation": "{frame}",
        "seed": "{seed}",
        "progress, m/s": lambda row: with_error(row["progress"], row["error"], decimals=2),
        "control periods": lambda row: f"{row['periods'] / 1e6:.1f} million",
    }
    return columns(record["rows"], cells)


@turned_frame.figure(6, 3.5)
def figure(record: Record, chart: Figure) -> None:
    """Progress of the policies that are tried, against processor time."""
    axes = chart.subplots()
    for row in record["rows"]:
        spent, progress = np.array(row["curve"]).T
        axes.plot(spent, progress, label=f"frame of the {row['frame']}, seed {row['seed']}")
    axes.set(xlabel="processor time (s)", ylabel="progress with exploration (m/s)")
    axes.set_xlim(0, None)
    axes.legend()
