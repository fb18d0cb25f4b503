"""The provenance of a model: command, configuration, seed and figures, in a JSON file beside it."""

import dataclasses
import hashlib
import json
import re
import subprocess
from collections.abc import Iterable
from pathlib import Path

from swift_ros.errors import UsageError
from swift_sim_bridge.model_files.whole_file import replacing


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


@dataclasses.dataclass(frozen=True)
class Origin:
    """Where a model comes from.

    Attributes:
        command: that reproduces it.
        configuration_sha256: of the settings.
        seed: of the training.
        trained_for: track, vehicle or camera, see `swift_ros.trained_for`.
        sittings: see `sittings.Sitting`, as mappings.
        started_from: SHA-256 of the first networks by their file's name; empty for random ones.
    """

    command: str
    configuration_sha256: str
    seed: int
    trained_for: dict
    sittings: list
    started_from: dict = dataclasses.field(default_factory=dict)


def write_provenance(model: Path, origin: Origin, figures: dict) -> Path:
    """Write MODEL.json beside a model and return its path.

    Args:
        model: path of the model's file.
        origin: where it comes from.
        figures: what was measured, units in the names.
    """
    record = {"model": model.name, "sha256": file_hash(model), "source": source_commit()}
    record |= dataclasses.asdict(origin) | {"figures": figures}
    path = model.with_suffix(".json")
    write_record(path, record)
    return path


def write_record(path: Path, record: dict) -> None:
    """Write a provenance, with each list of numbers or texts on one line."""
    text = re.sub(
        r"\[\n[^][{}]*\]", lambda found: f"[{' '.join(found[0][1:-1].split())}]", json.dumps(record, indent=2)
    )
    with replacing(path) as partial:
        partial.write_text(text + "\n")
