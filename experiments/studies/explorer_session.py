"""Measure a long session of the explorer: its memory, how soon a slider answers, and what is compiled."""

import time
from pathlib import Path

import jax
import numpy as np
from measurements.measurement import Record, measurement
from measurements.pages import table
from tqdm import tqdm

from jaxgrity import InputError
from jaxgrity.cli.explore import Page, served

SETTLED_AFTER = 20
"""rollouts, by which everything has been done once"""
PATIENCE = 300.0
"""s, for a single rollout"""


@measurement(page="performance.md", quick={"rollouts": 40, "duration": 2.0})
def explorer_session(duration: float = 10.0, rollouts: int = 500) -> Record:
    """Move sliders over and over, as somebody would who waits for each rollout and its error bar.

    Args:
        duration: s of motion
        rollouts: in one session
    """
    if not Path("/proc/self/statm").exists():
        raise InputError("/proc/self/statm: not there; expected Linux, which says how large a process is")
    began = time.perf_counter()
    with served(("exact",), duration) as (page, _):
        wait_until(lambda: "±" in page.words)
        first = time.perf_counter() - began
        found = session(page, rollouts)
    return {"duration": duration, "first_picture_seconds": first} | found


def session(page: Page, rollouts: int) -> dict:
    """What becomes of the process's size (MB), of the time until a rollout is shown (s), and of compilation."""
    rng, compiled = np.random.default_rng(0), []
    listen = lambda name, seconds, **_: compiled.append(name) if "backend_compile" in name else None  # noqa: E731
    jax.monitoring.register_event_duration_secs_listener(listen)
    sizes, answers, early = [], [], 0
    for number in tqdm(range(rollouts), unit="rollout"):
        name = rng.choice(sorted(page.sliders))
        slider, done = page.sliders[name], page.rollouts
        moved = time.perf_counter()
        places = np.round(np.arange(slider.min, slider.max, slider.step), 2)
        slider.value = float(rng.choice(places[places != slider.value]))  # where it is already, it would not move
        wait_until(lambda done=done: page.rollouts > done)
        answers.append(time.perf_counter() - moved)
        wait_until(lambda: "…" not in page.words)
        sizes.append(megabytes())
        early = len(compiled) if number < SETTLED_AFTER else early
    jax.monitoring.unregister_event_duration_listener(listen)
    settled, later = sizes[SETTLED_AFTER - 1], sizes[SETTLED_AFTER:]
    return {
        "rollouts": rollouts,
        "megabytes_settled": settled,
        "largest_growth": max(later) / settled - 1,
        "median_answer": float(np.median(answers)),
        "slowest_answer": max(answers),
        "compiled_later": len(compiled) - early,
    }


def megabytes() -> float:
    """The resident size of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def wait_until(condition) -> None:
    """Raises `InputError` where it takes too long."""
    end = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > end:
            raise InputError(f"the explorer did not answer within {PATIENCE:g} s")
        time.sleep(0.005)


@explorer_session.table
def words(record: Record) -> str:
    """How soon it answers, and what it keeps."""
    rows = [
        ["until the first rollout is shown, with its error bar", f"{record['first_picture_seconds']:.0f} s"],
        ["from a slider to its rollout: median", f"{record['median_answer']:.2f} s"],
        ["from a slider to its rollout: slowest", f"{record['slowest_answer']:.2f} s"],
        ["programs compiled after the first 20 rollouts", str(record["compiled_later"])],
        ["memory after 20 rollouts", f"{record['megabytes_settled']:.0f} MB"],
        ["largest growth of memory after the first 20 rollouts", f"{record['largest_growth']:.1%}"],
    ]
    return table([f"{record['rollouts']} rollouts of {record['duration']:g} s in one session", "measured"], rows)
