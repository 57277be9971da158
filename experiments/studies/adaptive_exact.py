"""What a step of its own for each robot could save on exact contact.

Random gaits of the scene `exact` take the same list of constant steps, and a share of them must end within a bound. We
compare three ways to choose the steps: one step for all, the best step of each robot by its true error, and steps by an
estimate of this error. The estimate is the difference of two rollouts, one with half the step of the other.
"""

from collections.abc import Callable, Iterator

import numpy as np
from measurements.measurement import Record, measurement
from measurements.pages import columns, short

from jaxgrity import SolverOptions, gaits_of, load_scene, random_phases, simulate_population

METHODS = ("complementarity", "complementarity2")
BOUNDS = (1e-2, 2e-3)
"""m, of the centre of mass at the end"""
SHARES = {"half": 0.5, "nine of ten": 0.9, "all": 1.0}
"""of the robots, that must end within the bound"""
LARGEST, FINEST = 3e-2, 3e-2 / 1024
"""s: the first step of the list, and that which gives the true answer"""
PER_HALVING, STEPS = 4, 29
"""Each step of the list is smaller than the one before it, so that PER_HALVING of them halve it; so many steps."""
CAUTION = 2.0 ** np.arange(-3, 4.1, 0.5)
"""factors on the estimate, of which the best is chosen afterwards"""


@measurement(page="accuracy.md", quick={"gaits": 4, "duration": 2.0})
def adaptive_exact(gaits: int = 128, duration: float = 4.0, seed: int = 0) -> Iterator[Record]:
    """A row for each method, bound and share.

    Args:
        gaits: random gaits
        duration: of the rollouts, s
        seed: of the gaits
    """
    counts = np.array([int(np.ceil(duration / LARGEST * 2 ** (k / PER_HALVING))) for k in range(STEPS)])
    for method in METHODS:
        finest = _ends(method, round(duration / FINEST), gaits, duration, seed)
        ends = np.array([_ends(method, count, gaits, duration, seed) for count in counts])
        errors = np.linalg.norm(ends - finest, axis=2)
        halved = np.linalg.norm(ends[:-PER_HALVING] - ends[PER_HALVING:], axis=2)
        for bound in BOUNDS:
            within = errors <= bound
            for name, share in SHARES.items():
                found = *_oracle(within, counts, share), _estimated(halved / bound, within, counts, share)
                row: Record = {"method": method, "bound": bound, "share": name}
                yield row | dict(zip(("one", "own", "estimated"), map(_known, found)))


def _oracle(within: np.ndarray, counts: np.ndarray, share: float) -> tuple[float, float]:
    """Steps a robot, of one step for all and of the best for each; `within` (steps, robots) says which are good enough.

    A step is good enough only if all smaller ones are too. Robots that may miss the bound take the largest step.
    """
    enough = int(np.ceil(share * within.shape[1]))
    one = _fewest((within.sum(axis=1) >= enough)[:, None], counts)[0]
    own = np.sort(_fewest(within, counts))
    own[enough:] = counts[0]
    return one, own.mean()


def _fewest(good: np.ndarray, counts: np.ndarray) -> np.ndarray:
    """The fewest steps of each column from which on all more are `good`; infinite: the list has none."""
    lasting = np.minimum.accumulate(good[::-1])[::-1]
    return np.where(lasting.any(axis=0), counts[lasting.argmax(axis=0)].astype(float), np.inf)


def _estimated(estimates: np.ndarray, within: np.ndarray, counts: np.ndarray, share: float) -> float:
    """Mean steps a robot if each takes the step that its estimate, in bounds, asks for; with those for the estimate.

    The error of the finer rollout is nearly the estimate, and in proportion to the step. The first step and the caution
    are the best of all, known only afterwards.
    """
    best, robots = np.inf, np.arange(within.shape[1])
    for first, estimate in enumerate(estimates):
        half = first + PER_HALVING
        for caution in CAUTION:
            asked = np.minimum(np.searchsorted(counts, counts[half] * caution * estimate), len(counts) - 1)
            taken = np.maximum(asked, half)
            steps = counts[first] + counts[half] + np.where(taken > half, counts[taken], 0)
            if within[taken, robots].mean() >= share:
                best = min(best, steps.mean())
    return best


def _known(steps: float) -> float | None:
    """None: more than the list has."""
    return float(steps) if np.isfinite(steps) else None


def _ends(method: str, count: int, gaits: int, duration: float, seed: int) -> np.ndarray:
    """m, (gaits, 3): the centres of mass at the end, after so many steps."""
    scene = load_scene("exact")
    phases = random_phases(gaits, len(scene.gait.members), seed=seed)
    options = SolverOptions(method=method, dt=duration / count, dtype="float64", any_step=True)
    return np.asarray(simulate_population(scene, gaits_of(scene.gait, phases), duration, options=options).com_end)


@adaptive_exact.table
def words(record: Record) -> str:
    """Steps a robot with one step for all, and by which factor the other ways need fewer."""

    def saved(way: str) -> Callable[[Record], str]:
        known = lambda row: row["one"] is not None and row[way] is not None  # noqa: E731
        return lambda row: short(row["one"] / row[way]) if known(row) else "-"

    cells = {
        "method": "{method}",
        "bound, mm": lambda row: short(1e3 * row["bound"]),
        "within it": "{share}",
        "steps, one for all": lambda row: "-" if row["one"] is None else f"{row['one']:.0f}",
        "saved, oracle": saved("own"),
        "saved, estimate": saved("estimated"),
    }
    return columns(record["rows"], cells)
