"""Runs a command with clocks slower by a factor: for races in real time on a machine that is too slow for them.

    python scripts/slow_clock.py 2 swiftros race --real-time

All processes of the command see the same slow clocks, so the graph behaves as on a machine that is as much faster.
Only times that the kernel reports by itself, of files and of CPU time, are true. Needs Linux and a C compiler.
"""

import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

SOURCE = Path(__file__).with_suffix(".c")
MIN_FACTOR, MAX_FACTOR = 1.0, 100.0


def main(words: list[str]) -> None:
    """Replace this process by the command."""
    try:
        factor, command = float(words[0]), words[1:]
    except (IndexError, ValueError):
        factor, command = 0.0, []
    if not MIN_FACTOR <= factor <= MAX_FACTOR or not command:
        sys.exit(f"usage: slow_clock.py FACTOR COMMAND...; FACTOR is a number from {MIN_FACTOR:g} to {MAX_FACTOR:g}")
    if not shutil.which(command[0]):
        sys.exit(f"slow_clock: there is no command {command[0]}")
    origins = time.time_ns(), time.clock_gettime_ns(time.CLOCK_MONOTONIC)
    environment = {"LD_PRELOAD": str(compiled()), "SLOW_CLOCK": " ".join(map(str, (round(1000 * factor), *origins)))}
    os.execvpe(command[0], command, os.environ | environment)


def compiled() -> Path:
    """Compile the library into the folder for temporary files and return its path."""
    compiler = shutil.which("cc")
    if not compiler:
        sys.exit("slow_clock: a C compiler is missing: sudo apt install build-essential")
    library = Path(tempfile.mkdtemp(prefix="slow_clock-")) / "slow_clock.so"
    arguments = [compiler, "-shared", "-fPIC", "-O2", "-Wall", "-Wextra", "-o", str(library), str(SOURCE), "-ldl"]
    result = subprocess.run(arguments, capture_output=True, text=True)
    if result.returncode:
        sys.exit(f"slow_clock: {SOURCE} does not compile: {result.stderr.strip().splitlines()[0]}")
    return library


if __name__ == "__main__":
    main(sys.argv[1:])
