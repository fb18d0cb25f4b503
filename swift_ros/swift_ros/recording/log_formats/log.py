"""What a log holds: topics of named columns, before anything is known about their meaning."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

ULOG, DATAFLASH, BAGS, TABLES = (".ulg",), (".bin", ".log"), (".mcap",), (".csv", ".parquet")  # suffixes of files
ROS1_BAGS, SQLITE_BAGS = (".bag",), (".db3",)
TABLE = ""  # name of the only topic of a table, whose times are one of its columns


@dataclass(frozen=True)
class LoggedTopic:
    """The messages of one topic.

    Attributes:
        t: times (n,), s; of a table its row numbers.
        columns: values (n,) by name; entries of arrays are `name[0]`, `name[1]` ..
        type: of its messages, where the log names one.
    """

    t: np.ndarray
    columns: Mapping[str, np.ndarray]
    type: str = ""

    @property
    def rate_hz(self) -> float:
        """Typical rate: the inverse of the median time step, Hz; 0 without two messages."""
        steps = np.diff(self.t)
        return float(1.0 / np.median(steps[steps > 0])) if (steps > 0).any() else 0.0


@dataclass(frozen=True)
class Log:
    """A log.

    Attributes:
        path: the file or folder.
        format: name of the format.
        topics: by name, on one clock.
        parameters: of the flight controller, by name.
    """

    path: Path
    format: str
    topics: Mapping[str, LoggedTopic]
    parameters: Mapping[str, float] = field(default_factory=dict)
