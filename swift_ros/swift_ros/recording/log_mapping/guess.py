"""The mapping of a log without a mapping file."""

from swift_ros.recording.log_formats.log import Log
from swift_ros.recording.log_mapping import guess_ardupilot, guess_px4, guess_ros
from swift_ros.recording.log_mapping.mapping import Mapping

LOGGED_RATES = {"PX4 ULog": guess_px4.LOGGED_RATES, "ArduPilot DataFlash": guess_ardupilot.LOGGED_RATES}


def guess(log: Log) -> Mapping:
    """Return the mapping of a log that is no table. Raises UsageError where a channel is ambiguous."""
    if log.format == "PX4 ULog":
        return guess_px4.guess(log, {name: name for name in log.topics})
    if log.format == "ArduPilot DataFlash":
        return guess_ardupilot.guess(log)
    return guess_ros.guess(log)
