"""What a path holds: a flight, a gap report or a training. No Rerun."""

from pathlib import Path

from swift_ros.errors import UsageError
from swift_ros.recording.replay import find_bag

BAG, GAP, TRAINING = "bag", "gap", "training"
GAP_REPORT = "report.json"
# logs of `pilot.train` and `gate_detector.training.train`, and the quantity over which their rows are drawn
TRAINING_LOGS = {"progress.jsonl": "interactions", "log.jsonl": "step"}


def recognise(path: Path) -> tuple[str, Path]:
    """Return what a path holds, and the bag or folder that holds it.

    Args:
        path: a bag, an .mcap file, a folder with one bag below such as that of a race, or the folder of a gap report or
            of a training.

    Raises:
        UsageError: it is none of these, or holds more than one bag.
    """
    if not path.exists():
        raise UsageError(f"{path} does not exist; give a bag, or the folder of a race, a gap report or a training")
    if (path / GAP_REPORT).is_file():
        return GAP, path
    if training_log(path) is not None:
        return TRAINING, path
    if path.is_file() and path.suffix != ".mcap":
        raise UsageError(f"{path} is no .mcap file; give a bag, or the folder of a race, a gap report or a training")
    if path.is_dir() and next(path.rglob("*.mcap"), None) is None:
        raise UsageError(
            f"{path} holds neither a bag nor {GAP_REPORT} (of a gap report) nor {' or '.join(TRAINING_LOGS)} (of a "
            "training)"
        )
    return BAG, find_bag(path)


def training_log(folder: Path) -> Path | None:
    """Return the log of the training in a folder; None without one."""
    return next((folder / name for name in TRAINING_LOGS if (folder / name).is_file()), None)
