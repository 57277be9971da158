"""The frame of every command: set JAX up, read the settings, and report bad input in one line.

Import it before anything else of jaxgrity: it sets Equinox's reaction to failed checks, which Equinox reads once.
"""

import contextlib
import gc
import os
import shlex
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

# Read by Equinox when it is imported: diffrax's own checks, which options have passed before, then mark a rollout NaN
# instead of calling back from the compiled program, which JAX could not keep for the next run.
os.environ.setdefault("EQX_ON_ERROR", "nan")

# Read by OpenBLAS when JAX loads it for its factorisations: those of a robot are small, and on a machine with other
# work threads that wait for each other make them up to a hundred times slower. Cores are used as devices.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import jax

from jaxgrity.cli.command_line import from_command_line, while_read
from jaxgrity.cli.interrupts import ended_by_interrupt
from jaxgrity.core.compiled import keep_compiled
from jaxgrity.core.errors import InputError
from jaxgrity.io.files import check_folder

LOOPS = "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=1000000000,-unroll-full-max-count=16"
"""On a CPU, a whole loop of small steps is one kernel, instead of some hundred that are dispatched one by one. No loop
over robots is unrolled, since that would keep LLVM from using vector instructions for it."""
VECTORS = "--xla_cpu_prefer_vector_width=512"
"""Vectors as long as the processor has them, where LLVM would take half of that; answers are the same to the bit."""
FUSIONS = "--xla_cpu_use_fusion_emitters=false"
"""XLA's older way of making kernels. It compiles in two thirds of the time, and its kernels run up to a fifth faster.
Answers agree to rounding. JAX 0.11 no longer has it, and would end at a flag that it does not know."""
COLLECTED = 200_000, 50, 100
"""Python's thresholds of garbage collection. Tracing makes millions of objects that live on in caches. With Python's
own thresholds, looking through them takes a fifth of the time."""

Settings = TypeVar("Settings")


def cores() -> int:
    """The number of cores for this process; all where the system does not say."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def command_header() -> dict:
    """The header of every result: its command, without folders and --resume, and the cores."""
    words = [word for word in sys.argv[1:] if word not in ("--resume", "--restart")]
    for option in ("--out", "--beside"):
        if option in words:
            words[words.index(option) + 1] = "FOLDER"
    if "--out" in words:
        del words[words.index("--out") : words.index("--out") + 2]
    script = Path(sys.argv[0])
    if script.name == "__main__.py":  # python -m jaxgrity
        program = [script.parent.name]
    elif script.suffix == ".py":
        program = ["python", script.name if script.is_absolute() else str(script)]
    else:
        program = [script.name]
    return {"command": shlex.join([*program, *words]), "cores": cores()}


def configure() -> None:
    """Float64 allowed, loops compiled whole, compiled programs kept: for scripts, and for their processes."""
    # what the user has set comes later, and wins
    flags = (LOOPS, VECTORS, FUSIONS if jax.__version_info__ < (0, 11) else "", os.environ.get("XLA_FLAGS", ""))
    os.environ["XLA_FLAGS"] = " ".join(filter(None, flags))
    gc.set_threshold(*COLLECTED)
    jax.config.update("jax_enable_x64", True)
    keep_compiled()


def join_hosts() -> None:
    """Make one machine of all processes started with this script by SLURM, or with JAX_COORDINATOR_ADDRESS.

    JAX_COORDINATOR_ADDRESS (HOST:PORT of the first), JAX_NUM_PROCESSES and JAX_PROCESS_ID go together: `InputError`
    where one is missing.
    """
    known = os.environ
    if "JAX_COORDINATOR_ADDRESS" in known:
        numbers = [known.get(name, "") for name in ("JAX_NUM_PROCESSES", "JAX_PROCESS_ID")]
        if not all(number.isdigit() for number in numbers):
            raise InputError(
                f"JAX_NUM_PROCESSES = {numbers[0]!r}, JAX_PROCESS_ID = {numbers[1]!r}: expected two numbers, since "
                "JAX_COORDINATOR_ADDRESS is set"
            )
        jax.distributed.initialize(num_processes=int(numbers[0]), process_id=int(numbers[1]))
    elif int(known.get("SLURM_STEP_NUM_TASKS", 1)) > 1:
        jax.distributed.initialize()


@while_read()
def run(main: Callable[[Settings], None], settings: type[Settings], **how: Any) -> None:
    """Call `main` with `settings` from the command line, read as `from_command_line` is told, as `execute` does."""
    configure()
    undocumented = (settings.__doc__ or "").startswith(f"{settings.__name__}(")  # as dataclasses do it by themselves
    described = sys.modules[settings.__module__] if undocumented else settings
    execute(main, from_command_line(settings, description=described.__doc__, **how))


def execute(main: Callable[[Settings], None], chosen: Settings) -> None:
    """Call `main` with the chosen settings: every core is a device, or as many as JAX_NUM_CPU_DEVICES says.

    Of several processes of one machine only the first prints and writes files. The exit code is 2 on bad input and 130
    on Ctrl-C, each with one line.
    """
    platforms = jax.config.jax_platforms  # type: ignore[attr-defined]
    if "cpu" in (platforms or "cpu") and "JAX_NUM_CPU_DEVICES" not in os.environ:
        jax.config.update("jax_num_cpu_devices", cores())
    try:
        join_hosts()
        if isinstance(out := getattr(chosen, "out", None), Path):
            check_folder(out, f"--out {out}")
        first, alone = jax.process_index() == 0, hasattr(chosen, "resume") and jax.process_count() == 1
        advice = "; the same command with --resume continues from the saved state" if alone else ""
        with ended_by_interrupt(advice if first else None), contextlib.ExitStack() as others:
            if not first:
                others.enter_context(contextlib.redirect_stdout(others.enter_context(open(os.devnull, "w"))))
                chosen.out = Path(others.enter_context(tempfile.TemporaryDirectory()))  # type: ignore[attr-defined]
            main(chosen)
    except BrokenPipeError:
        raise  # for `while_read`
    except (InputError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
