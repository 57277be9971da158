"""Ctrl-C ends a command within a second, also while a compiled program runs."""

import atexit
import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from types import FrameType

INTERRUPTED = 130
"""Exit code after Ctrl-C: 128 + SIGINT, as of other programs."""
GRACE = 0.5
"""Time that a command has to end by itself after Ctrl-C, s."""


@contextlib.contextmanager
def ended_by_interrupt(advice: str | None = "") -> Iterator[None]:
    """End the process on Ctrl-C with one line and exit code `INTERRUPTED`, after `GRACE` at the latest.

    Python raises KeyboardInterrupt between two of its own instructions, so not while a compiled program runs, and it
    ignores what is raised in a callback. So another thread hears of the signal too. `advice` is the end of the line;
    None: no line.
    """
    said, heard = threading.Lock(), threading.Event()

    def say() -> None:
        if said.acquire(blocking=False) and advice is not None:
            print(f"\ninterrupted{advice}", file=sys.stderr)

    def end() -> None:
        with contextlib.suppress(OSError):  # where nobody reads them any more
            say()
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(INTERRUPTED)  # an ordinary end would wait for programs that still run, or crash

    def watch(signals: int) -> None:
        with os.fdopen(signals, "rb", buffering=0) as numbers:
            while number := numbers.read(1):
                if number[0] == signal.SIGINT:
                    time.sleep(GRACE)
                    end()

    def hear(number: int, frame: FrameType | None) -> None:
        heard.set()
        raise KeyboardInterrupt

    with contextlib.ExitStack() as undone:
        # only the main thread may ask for signals; a process in the background may have been told to ignore this one
        free = signal.getsignal(signal.SIGINT) is signal.default_int_handler
        if free and threading.current_thread() is threading.main_thread():
            reading, writing = os.pipe()
            os.set_blocking(writing, False)
            threading.Thread(target=watch, args=(reading,), daemon=True).start()
            undone.callback(os.close, writing)
            undone.callback(signal.set_wakeup_fd, signal.set_wakeup_fd(writing, warn_on_full_buffer=False))
            undone.callback(signal.signal, signal.SIGINT, signal.signal(signal.SIGINT, hear))
        try:
            yield
        except KeyboardInterrupt:
            say()
            if heard.is_set():
                atexit.register(end)
            sys.exit(INTERRUPTED)
