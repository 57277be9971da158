"""Compiled programs kept for later processes. Nothing here may import Equinox: see below."""

import os
import sys
from pathlib import Path

import jax

from jaxgrity.core.errors import InputError
from jaxgrity.core.typed import typed

CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxgrity"
"""Folder of compiled programs where neither the caller nor JAX_COMPILATION_CACHE_DIR names one."""


@typed
def keep_compiled(folder: str | Path | None = None) -> Path:
    """Keep compiled programs in a folder, for other processes and for later ones.

    Call it right after `import jaxgrity`. Run-time checks of diffrax then mark a rollout as failed (NaN) instead of
    raising an error: a program with calls into Python cannot be kept. Equinox reads that setting (EQX_ON_ERROR) at its
    import, which the first use of any other name of jaxgrity causes. Bad options are refused before, as always.

    Args:
        folder: by default that of JAX_COMPILATION_CACHE_DIR or JAX's configuration, else `~/.cache/jaxgrity`. A missing
            one is made.

    Returns:
        The folder.

    Raises:
        InputError: Equinox is imported already, and not set to EQX_ON_ERROR=nan.

    Example:
        >>> jaxgrity.keep_compiled("compiled").name
        'compiled'
    """
    if os.environ.setdefault("EQX_ON_ERROR", "nan") != "nan":
        raise InputError(f"EQX_ON_ERROR = {os.environ['EQX_ON_ERROR']!r}: expected 'nan' to keep compiled programs")
    if "equinox" in sys.modules and sys.modules["equinox"]._config.EQX_ON_ERROR != "nan":
        raise InputError(
            "keep_compiled: Equinox is imported already, with checks that cannot be kept; expected this call right "
            "after `import jaxgrity`, or EQX_ON_ERROR=nan in the environment"
        )
    chosen = Path(folder or jax.config.jax_compilation_cache_dir or CACHE)  # type: ignore[attr-defined]
    jax.config.update("jax_compilation_cache_dir", str(chosen))
    if "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS" not in os.environ:
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    return chosen
