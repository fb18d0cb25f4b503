"""The provenance of a model: command, configuration, seed and figures, in a JSON file beside it."""

import dataclasses
import hashlib
import json
import subprocess
from collections.abc import Iterable
from pathlib import Path

from swift_ros.errors import UsageError


def configuration_hash(files: Iterable[Path], settings) -> str:
    """Return the SHA-256 of a training's settings and files.

    Args:
        files: the files that the training reads, in a fixed order.
        settings: a dataclass.

    Raises:
        UsageError: a file cannot be read.
    """
    digest = hashlib.sha256(json.dumps(dataclasses.asdict(settings), sort_keys=True).encode())
    for file in files:
        try:
            digest.update(Path(file).read_bytes())
        except OSError as error:
            raise UsageError(f"{file} cannot be read: {error.strerror}") from error
    return digest.hexdigest()


def file_hash(path: Path) -> str:
    """Return the SHA-256 of a file, which identifies a model in result.json."""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


def source_commit() -> str | None:
    """Return the commit of the sources, with `+` if the tree has uncommitted changes; None outside a git checkout."""
    folder = Path(__file__).resolve().parent
    try:
        command = ["git", "describe", "--always", "--abbrev=12", "--dirty=+", "--exclude=*"]
        return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None


def write_provenance(model: Path, *, command: str, configuration: str, seed: int, figures: dict) -> Path:
    """Write MODEL.json beside a model and return its path.

    Args:
        model: path of the model's file.
        command: the command that reproduces it.
        configuration: SHA-256 of the settings.
        seed: of the training.
        figures: what was measured, units in the names.
    """
    record = {
        "model": model.name,
        "sha256": file_hash(model),
        "command": command,
        "configuration_sha256": configuration,
        "seed": seed,
        "source": source_commit(),
        "figures": figures,
    }
    path = model.with_suffix(".json")
    path.write_text(json.dumps(record, indent=2) + "\n")
    return path
