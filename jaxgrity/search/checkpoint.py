"""A search's folder: one process at a time, its state saved whole, and taken up again where it was left."""

import contextlib
import fcntl
import hashlib
import inspect
import json
import re
import zlib
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from types import CodeType, FunctionType, MethodType
from typing import Any, NamedTuple
from zipfile import BadZipFile

import jax
import jax.numpy as jnp
import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed
from jaxgrity.io.files import PART, read_json, save_arrays, save_json, write_whole
from jaxgrity.model.scene import Scene
from jaxgrity.search.genetic_algorithm import EvolutionState, Generation, Record

SETTINGS, STATE, RESULTS = "run.json", "state_{}.npz", ("summary.json", "gait.json", "population.npz")
"""Names of the files of a search: its settings, the state of each evolution, and what it found."""
PROMOTED, POLISHED = "promoted.npz", "polished.npz"
"""Names of the files with the results of the stages after evolution, for a search that is resumed."""
RUN_OR_RESTART = "expected a run of this version, or restart"
"""End of messages on files of a search that cannot be read."""
PROBE, SPACE = ".probe", 2**20
"""Name and size (bytes) of a file that shows whether there is space for what a search writes."""
ADDRESS = re.compile(" at 0x[0-9a-fA-F]+")
"""Part of the text of a function that differs between processes."""


class Checkpoint(NamedTuple):
    """The folder of a search that is under way."""

    folder: Path
    states: tuple[EvolutionState, ...]
    """of its evolutions, as far as they got"""

    def save(self, number: int, state: EvolutionState) -> None:
        """Keep the state of one of the evolutions, in place of the one before."""
        evaluated = {} if state.evaluated is None else state.evaluated._asdict()
        save_arrays(
            self.folder / STATE.format(number),
            number=state.number,
            key=state.key,
            genes=state.genes,
            **({} if state.memory is None else {"memory": state.memory}),
            **{f"record_{name}": part for name, part in state.record._asdict().items()},
            **{f"evaluated_{name}": part for name, part in evaluated.items()},
        )

    def done(self) -> None:
        """Nothing is left to go on with."""
        settings = read_json(self.folder / SETTINGS)
        save_json(self.folder / SETTINGS, {**settings, "done": True})


@typed
@contextlib.contextmanager
def open_checkpoint(
    folder: Path, settings: dict[str, Any], resume: bool = False, restart: bool = False
) -> Iterator[Checkpoint]:
    """Hold `folder` for this process alone, and find out what of a search with these settings is there.

    Raises `InputError` if another process holds it, or if it cannot be written to. An unfinished search in it needs
    `resume` or `restart`. To resume needs a search with the same settings.
    """
    with contextlib.ExitStack() as held:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            _lock(held.enter_context(open(folder / ".lock", "w")), folder)
            for left in folder.glob(f".*{PART}"):
                left.unlink()
            found = _begin(folder, json.loads(json.dumps(settings, default=str)), resume, restart)
            # a disk that is full is found now, not after the first generation
            write_whole(folder / PROBE, lambda file: file.write(bytes(SPACE)))
            (folder / PROBE).unlink()
        except OSError as error:
            said = error.strerror or error
            raise InputError(f"{folder}: {said}; expected a folder that can be written to") from error
        yield found


def _lock(lock, folder: Path) -> None:
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise InputError(f"{folder}: another run is writing there; expected another folder") from error


def _begin(folder: Path, settings: dict[str, Any], resume: bool, restart: bool) -> Checkpoint:
    found = None if restart else _run_in(folder)  # a damaged one is no reason not to begin again
    if resume:
        if found is None:
            raise InputError(f"{folder}: has no run; expected one to resume")
        check_same_settings(folder, found["settings"], settings)
        return Checkpoint(folder, load_states(folder))
    if _unfinished(found) and load_states(folder):
        raise InputError(f"{folder}: holds an unfinished run; expected resume, restart or another folder")
    for left in left_over(folder):
        left.unlink(missing_ok=True)
    save_json(folder / SETTINGS, {"settings": settings, "done": False})
    return Checkpoint(folder, ())


def check_same_settings(folder: Path, before: dict[str, Any], now: dict[str, Any]) -> None:
    """Raise `InputError` where the run in a folder that is to be resumed has had other settings."""
    differ = [f"{name} = {before.get(name)}, not {value}" for name, value in now.items() if before.get(name) != value]
    if differ:
        raise InputError(f"{folder}: its run has {', '.join(differ)}; expected the same to resume it")


def _run_in(folder: Path) -> dict[str, Any] | None:
    """The settings of the folder's run, and whether it is done; None without a run."""
    if not (folder / SETTINGS).exists():
        return None
    try:
        run = read_json(folder / SETTINGS)
    except InputError as error:
        raise InputError(f"{error}; {RUN_OR_RESTART}") from error
    if not isinstance(run.get("settings"), dict):
        raise InputError(f"{folder / SETTINGS}: has no settings; {RUN_OR_RESTART}")
    return run


def _unfinished(run: dict[str, Any] | None) -> bool:
    return run is not None and not run.get("done")


def holds_unfinished(folder: Path) -> bool:
    """Whether the folder has a run that could go on: without `restart` a new one is refused."""
    return _unfinished(_run_in(folder)) and (folder / STATE.format(0)).exists()


def left_over(folder: Path) -> list[Path]:
    """What an earlier run left in the folder that a new one takes away or writes over."""
    names = [*folder.glob(STATE.format("*")), *(folder / name for name in (SETTINGS, PROMOTED, POLISHED, *RESULTS))]
    return [path for path in names if path.exists()]


def saved_arrays(path: Path) -> dict[str, np.ndarray]:
    """The arrays of a file of a search, by their names. Raises `InputError` for a damaged one."""
    try:
        with open(path, "rb") as file, np.load(file) as arrays:
            return dict(arrays)
    except (ValueError, EOFError, BadZipFile, zlib.error) as error:
        raise InputError(f"{path}: damaged: {error}; {RUN_OR_RESTART}") from error


@typed
def load_states(folder: Path) -> tuple[EvolutionState, ...]:
    """The states of a run's searches, as far as they got."""
    found: list[EvolutionState] = []
    while (path := folder / STATE.format(len(found))).exists():
        saved = saved_arrays(path)
        if missing := [name for name in Record._fields if f"record_{name}" not in saved]:
            raise InputError(f"{path}: has no record_{missing[0]}; {RUN_OR_RESTART}")
        record = Record(*(saved[f"record_{name}"] for name in Record._fields))
        evaluated = None
        if f"evaluated_{Generation._fields[0]}" in saved:
            evaluated = Generation(*(jnp.asarray(saved[f"evaluated_{name}"]) for name in Generation._fields))
        genes = jnp.asarray(saved["genes"])
        memory = saved.get("memory")
        found.append(EvolutionState(int(saved["number"]), saved["key"], genes, record, evaluated, memory))
    return tuple(found)


def fingerprint(scene: Scene) -> str:
    """A hash of everything that a scene says, by which a search knows its scene again, in another process too.

    Functions count by their names and by what they are made of (`_identity`), without the functions that they call.
    """
    leaves, structure = jax.tree.flatten(scene)
    digest = hashlib.sha256(ADDRESS.sub("", str(structure)).encode())
    for held in _held(structure):
        digest.update(_identity(held).encode())
    for leaf in leaves:
        digest.update(np.asarray(leaf, float).tobytes())
    return digest.hexdigest()


def _held(structure: Any) -> Iterator[Any]:
    """Static values of a tree's nodes whose text has an address."""
    data = structure.node_data()
    if data is not None and ADDRESS.search(repr(data[1])):
        yield data[1]
    for child in structure.children():
        yield from _held(child)


def _identity(value: Any, within: tuple[int, ...] = ()) -> str:
    """A text that all processes agree on: of a function its module, name, code, defaults and closure.

    `within` are the values, by their `id`, that hold this one.
    """
    value = inspect.unwrap(value) if callable(value) else value
    parts: Any
    if id(value) in within:
        return "itself"
    if isinstance(value, FunctionType):
        closed = tuple(cell.cell_contents for cell in value.__closure__ or ())
        parts = value.__module__, value.__qualname__, value.__code__, value.__defaults__, value.__kwdefaults__, closed
    elif isinstance(value, MethodType):
        parts = value.__func__, value.__self__
    elif isinstance(value, CodeType):
        parts = value.co_code, value.co_names, value.co_consts
    elif isinstance(value, partial):
        parts = value.func, value.args, value.keywords
    elif isinstance(value, np.ndarray | jax.Array):
        parts = str(value.dtype), value.shape, np.asarray(value).tobytes()
    elif isinstance(value, dict):
        parts = tuple(value.items())
    elif isinstance(value, set | frozenset):
        return f"{{{','.join(sorted(_identity(part, within) for part in value))}}}"
    elif isinstance(value, tuple | list):
        parts = value
    elif ADDRESS.search(repr(value)) and hasattr(value, "__dict__") and not isinstance(value, type):
        kind, called = type(value), type(value).__call__ if callable(value) else None
        parts = kind.__module__, kind.__qualname__, vars(value), called
    else:
        return ADDRESS.sub("", repr(value))
    return f"({','.join(_identity(part, (*within, id(value))) for part in parts)})"
