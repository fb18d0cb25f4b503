"""A clock in passes for a firmware with gyro sync, instead of the wall's: see pass_clock.c."""

import shutil
import subprocess
from pathlib import Path

from swift_ros.errors import UsageError

SOURCE = Path(__file__).with_suffix(".c")


def compiled(folder: Path) -> Path:
    """Return the library, compiled into a folder. Raises UsageError without a C compiler."""
    compiler, library = shutil.which("cc"), Path(folder).resolve() / "pass_clock.so"
    if not compiler:
        raise UsageError("a firmware's clock is compiled and there is no C compiler: sudo apt install build-essential")
    asked = [compiler, "-shared", "-fPIC", "-O2", "-o", str(library), str(SOURCE), "-ldl", "-lpthread"]
    done = subprocess.run(asked, capture_output=True, text=True)
    if done.returncode:
        raise UsageError(f"{SOURCE} does not compile: {done.stderr.strip().splitlines()[0]}")
    return library
