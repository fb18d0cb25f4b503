"""What is shown at one time, and the stream that it is written to.

Curves are written in columns: a bag has thousands of values a second, and one call for each would take longer than the
flight. No more than `COLUMN_ROWS` of a curve are in memory.
"""

from collections import defaultdict
from typing import NamedTuple

import numpy as np
import rerun as rr

TIME = "time"  # timeline of a flight, s
COLUMN_ROWS = 500  # values of a curve that are written at once; 5 s at 100 Hz

rr.set_strict_mode(True)  # a fault of ours is an exception, not a warning and a missing curve


class Values(NamedTuple):
    """Values of one or more curves at one time.

    Attributes:
        entity: path of the curves in the viewer.
        values: one for each curve.
    """

    entity: str
    values: tuple[float, ...]


class Shape(NamedTuple):
    """Anything else that is shown from one time on.

    Attributes:
        entity: its path in the viewer.
        archetype: of Rerun.
    """

    entity: str
    archetype: object


Row = Values | Shape


class Stream:
    """Writes rows to a Rerun recording."""

    def __init__(self, recording: rr.RecordingStream, timeline: str = TIME):
        """Make it for a recording, with a timeline in seconds."""
        self.recording, self._timeline = recording, timeline
        self._columns: dict[str, list[tuple[float, tuple[float, ...]]]] = defaultdict(list)

    def add(self, time_s: float, rows: list[Row]) -> None:
        """Write rows at a time, s."""
        for row in rows:
            if isinstance(row, Values):
                column = self._columns[row.entity]
                if column and len(column[-1][1]) != len(row.values):
                    self._write(row.entity)
                column.append((time_s, row.values))
                if len(column) >= COLUMN_ROWS:
                    self._write(row.entity)
            else:
                self.recording.set_time(self._timeline, duration=time_s)
                self.recording.log(row.entity, row.archetype)

    def add_static(self, rows: list[Shape]) -> None:
        """Write shapes that are there at all times."""
        for row in rows:
            self.recording.log(row.entity, row.archetype, static=True)

    def flush(self) -> None:
        """Write all values that are still in memory."""
        for entity in [entity for entity, column in self._columns.items() if column]:
            self._write(entity)
        self.recording.flush()

    def _write(self, entity: str) -> None:
        column = self._columns[entity]
        times, values = np.array([t for t, _ in column]), np.array([values for _, values in column], float)
        columns = rr.Scalars.columns(scalars=values[:, 0] if values.shape[1] == 1 else values)
        self.recording.send_columns(entity, [rr.TimeColumn(self._timeline, duration=times)], columns)
        column.clear()
