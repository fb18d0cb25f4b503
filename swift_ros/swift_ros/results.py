"""Result folders of commands."""

import shutil
from pathlib import Path

from swift_ros.errors import UsageError


def fresh_folder(out: Path, own_names: tuple[str, ...]) -> Path:
    """Create the folder `out`, without the results of an earlier run, and return it.

    Args:
        out: the folder.
        own_names: patterns of the file names that the command writes.

    Raises:
        UsageError: the folder contains other files, or cannot be created.
    """
    if out.exists() and not out.is_dir():
        raise UsageError(f"--out names {out}, which is a file; give a folder")
    present = sorted(out.iterdir()) if out.is_dir() else []
    foreign = [path.name for path in present if not any(path.match(pattern) for pattern in own_names)]
    if foreign:
        raise UsageError(f"{out} contains other files ({', '.join(foreign[:3])}); give another --out")
    shutil.rmtree(out, ignore_errors=True)
    try:
        out.mkdir(parents=True)
    except OSError as error:
        raise UsageError(f"{out} cannot be written: {error.strerror}") from error
    return out
