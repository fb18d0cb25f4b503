"""The folder that a command writes its results into."""

import shutil
from pathlib import Path

from swift_ros.errors import UsageError


def fresh_folder(out: Path, ours: tuple[str, ...]) -> Path:
    """Return `out`, made, with what an earlier run left there removed.

    ours: patterns of the names that the command itself writes. Raises UsageError when there is anything else.
    """
    if out.exists() and not out.is_dir():
        raise UsageError(f"--out names {out}, which is a file; give a folder")
    there = sorted(out.iterdir()) if out.is_dir() else []
    foreign = [path.name for path in there if not any(path.match(pattern) for pattern in ours)]
    if foreign:
        raise UsageError(f"{out} holds other things ({', '.join(foreign[:3])}); give another --out")
    shutil.rmtree(out, ignore_errors=True)
    try:
        out.mkdir(parents=True)
    except OSError as error:
        raise UsageError(f"{out} cannot be written: {error.strerror}") from error
    return out
