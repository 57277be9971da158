"""Hand-written C beside the library, on the same scene and gaits: experiments/limit/rollouts.c, built when it is used.

limit32 and limit64 integrate spring struts and penalty contact by RK4, exact32 and exact64 rigid struts and exact
contact by semi-implicit steps; each reads a scene as text and prints final centres of mass and its wall time.
"""

import functools
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import equinox as eqx
import numpy as np

from jaxgrity import Gait, Overtone, Scene, gaits_of

ROOT = Path(__file__).resolve().parents[2]
SOURCE, BUILT = ROOT / "experiments" / "limit" / "rollouts.c", ROOT / ".cache" / "limit"
FLAGS = "-O3", "-march=native", "-ffast-math", "-mprefer-vector-width=512", "-fopenmp"
KINDS = {"limit32": ["-DREAL=float"], "limit64": [], "exact32": ["-DREAL=float", "-DEXACT"], "exact64": ["-DEXACT"]}


def waves_at(gait: Gait, phases: np.ndarray) -> Gait:
    """A population of the gait at other phases, (gaits, actuators): all waves keep their shapes, as in the programs."""
    ahead = phases - np.asarray(gait.phase)
    found = gaits_of(gait, phases)
    moved = tuple(Overtone(each.size, each.phase + h * ahead) for h, each in enumerate(found.overtones, start=2))
    return eqx.tree_at(lambda g: g.overtones, found, moved) if moved else found


@functools.cache
def programs() -> Path | None:
    """The folder of the four programs, built anew where their source has changed; None, and a line, if they cannot."""
    if shutil.which("cc") is None:
        return _left_out("there is no C compiler (cc)")
    BUILT.mkdir(parents=True, exist_ok=True)
    for name, kind in KINDS.items():
        program = BUILT / name
        if not program.exists() or program.stat().st_mtime < SOURCE.stat().st_mtime:
            command = ["cc", *FLAGS, *kind, str(SOURCE), "-o", f"{program}.new", "-lmvec", "-lm"]
            done = subprocess.run(command, capture_output=True, text=True, check=False)
            if done.returncode:
                return _left_out(f"cc: {(done.stderr.strip() or 'failed').splitlines()[-1]}")
            Path(f"{program}.new").replace(program)
    return BUILT


def _left_out(why: str) -> None:
    print(f"hand-written C is left out: {why}; expected gcc with OpenMP, on Linux", file=sys.stderr)


def roll(
    program: Path, scene: Scene, phases: np.ndarray, steps: int, dt: float, threads: int, sweeps: int | None = None
) -> tuple[np.ndarray, float]:
    """Centre of mass of each gait at the end, (gaits, 3), m, and the wall time that the program measures, s."""
    with tempfile.NamedTemporaryFile("w", suffix=".txt") as file:
        file.write(as_text(scene, phases, steps, dt))
        file.flush()
        command = [str(program), file.name, str(threads), *([str(sweeps)] if sweeps is not None else [])]
        lines = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    facts = dict(word.split("=") for word in lines[-1].split() if "=" in word)
    return np.array([line.split() for line in lines[:-1]], float), float(facts["seconds"])


def as_text(scene: Scene, phases: np.ndarray, steps: int, dt: float) -> str:
    """The scene as the C programs read it; what its model lacks stands as 0."""
    structure, gait, ground, friction = scene.structure, scene.gait, scene.ground, scene.friction
    struts, cables = structure.struts, structure.cables
    counts = [len(structure.nodes), len(struts.edges), len(cables.edges)]
    rows = [counts, *np.column_stack([structure.node_mass, structure.nodes])]
    for members in (struts, cables):
        none = np.zeros(len(members.edges))
        stiffness, damping = (none if x is None else x for x in (members.stiffness, members.damping))
        for (i, j), *numbers in zip(members.edges, stiffness, members.rest_length, damping):
            rows.append([i, j, *numbers])
    contact = [getattr(ground, name, None) or 0.0 for name in ("stiffness", "dissipation")]
    rows.append([scene.gravity, scene.node_damping[0], *contact, friction.mu, getattr(friction, "slip_speed", 1.0)])
    rows.append([gait.amplitude[0], 2 * np.pi * gait.frequency[0], gait.start, gait.ramp])
    rows += [[dt, steps, len(phases)], *phases]
    if gait.overtones:
        rows += [list(gait.amplitude), [len(gait.overtones)]]
        for h, each in enumerate(gait.overtones, start=2):
            rows += [list(each.size), list(each.phase - h * gait.phase)]
    return "\n".join(" ".join(repr(float(x)) if not isinstance(x, int) else str(x) for x in row) for row in rows) + "\n"
