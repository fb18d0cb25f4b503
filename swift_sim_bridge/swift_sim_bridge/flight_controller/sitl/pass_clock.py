"""Clock that counts passes of the rate loop, for a firmware with gyro sync: see pass_clock.c."""

import shutil
import subprocess
from pathlib import Path

from swift_ros.errors import UsageError

SOURCE = Path(__file__).with_suffix(".c")


def compiled(folder: Path) -> Path:
    """Compile the library into a folder and return its path. Raises UsageError without a C compiler."""
    compiler, library = shutil.which("cc"), Path(folder).resolve() / "pass_clock.so"
    if not compiler:
        raise UsageError("the clock of passes needs a C compiler: sudo apt install build-essential")
    arguments = [compiler, "-shared", "-fPIC", "-O2", "-o", str(library), str(SOURCE), "-ldl", "-lpthread"]
    result = subprocess.run(arguments, capture_output=True, text=True)
    if result.returncode:
        raise UsageError(f"{SOURCE} does not compile: {result.stderr.strip().splitlines()[0]}")
    return library
