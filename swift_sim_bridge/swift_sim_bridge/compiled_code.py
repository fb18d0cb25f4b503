"""Compiled code that outlives a run: compiling takes a third of the CPU time of a diagnosis."""

import os
import platform
import zlib
from pathlib import Path

import jax

MIN_COMPILE_TIME = "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"
CPU_DESCRIPTION = Path("/proc/cpuinfo")


def keep_compiled_code() -> None:
    """Make JAX keep what it compiles in the user's cache folder, less than a megabyte for a kind of recording.

    JAX_COMPILATION_CACHE_DIR and JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS of the environment win. Where the folder
    cannot be made, each run compiles anew.
    """
    if jax.config.jax_compilation_cache_dir is None:
        folder = cache_folder()
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            return
        jax.config.update("jax_compilation_cache_dir", str(folder))
    if MIN_COMPILE_TIME not in os.environ:  # JAX would keep nothing that compiles within a second
        jax.config.update(MIN_COMPILE_TIME.lower(), 0.0)


def cache_folder() -> Path:
    """Return the folder of compiled code: another one for each instruction set, as homes may be shared by machines."""
    user = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    text = CPU_DESCRIPTION.read_text() if CPU_DESCRIPTION.exists() else ""
    features = next((line for line in text.splitlines() if line.startswith(("flags", "Features"))), "")
    return Path(user) / "swiftros" / f"compiled-{platform.machine()}-{zlib.crc32(features.encode()):08x}"
