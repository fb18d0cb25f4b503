"""What a saved recording of the Rerun viewer holds."""

from pathlib import Path

import numpy as np


class RerunFile:
    """The chunks of an .rrd file, by entity."""

    def __init__(self, path: Path):
        """Read a file."""
        from rerun.chunk import RrdReader

        reader = RrdReader(path)
        self.has_blueprint = bool(reader.blueprints())
        self._chunks: dict[str, list] = {}
        for chunk in reader.stream().to_chunks():
            self._chunks.setdefault(chunk.entity_path.strip("/"), []).append(chunk)

    @property
    def entities(self) -> set[str]:
        """The paths of all entities, without the first slash."""
        return set(self._chunks)

    def column(self, entity: str, component: str, timeline: str = "time") -> tuple[np.ndarray, list]:
        """Return times (n,) s, and values of a component, such as "Scalars:scalars", in the order of time.

        On a timeline that counts, the times are its numbers; those of static values are NaN.
        """
        rows = []
        for chunk in self._chunks[entity]:
            batch = chunk.to_record_batch()
            if component not in batch.schema.names:
                continue
            values = batch.column(component).to_pylist()
            stamps = [np.nan] * len(values)
            if timeline in batch.schema.names:
                column = batch.column(timeline)
                scale = 1e-9 if str(column.type).startswith("duration") else 1
                stamps = [scale * stamp for stamp in column.cast("int64").to_pylist()]
            rows += [(t, value) for t, value in zip(stamps, values, strict=True) if value is not None]
        rows.sort(key=lambda row: row[0])
        return np.array([t for t, _ in rows]), [value for _, value in rows]

    def curve(self, entity: str, timeline: str = "time") -> tuple[np.ndarray, np.ndarray]:
        """Return times (n,) and values (n, k) of curves."""
        t, values = self.column(entity, "Scalars:scalars", timeline)
        return t, np.array(values)

    def texts(self, entity: str) -> list[str]:
        """Return the lines of a log, or the text of a document."""
        component = "TextLog:text" if entity.startswith("log/") else "TextDocument:text"
        return [text for (text,) in self.column(entity, component)[1]]
