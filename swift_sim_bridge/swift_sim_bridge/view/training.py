"""The folder of a training of the pilot or of the gate detector: curves of its log, pictures, provenance."""

from pathlib import Path

import rerun as rr

from swift_sim_bridge.view import layout
from swift_sim_bridge.view.folders import log_pictures, numbers, read_rows
from swift_sim_bridge.view.sources import TRAINING_LOGS, training_log


def show(folder: Path, recording: rr.RecordingStream) -> None:
    """Write a training to a recording of the viewer. Raises UsageError when its log cannot be read."""
    log = training_log(folder)
    timeline, rows = TRAINING_LOGS[log.name], [numbers(row) for row in read_rows(log)]
    names = sorted({name for row in rows for name in row} - {timeline})
    pictures = log_pictures(recording, sorted(folder.glob("*.png")))
    recording.send_blueprint(layout.training(names, pictures, timeline))
    for name in names:
        known = [(int(row[timeline]), row[name]) for row in rows if name in row and timeline in row]
        steps, values = zip(*known, strict=True) if known else ((), ())
        times = rr.TimeColumn(timeline, sequence=steps)
        recording.send_columns(f"training/{name}", [times], rr.Scalars.columns(scalars=values))
    text = "\n\n".join(f"## {file.name}\n\n```json\n{file.read_text()}\n```" for file in sorted(folder.glob("*.json")))
    recording.log("about", rr.TextDocument(text or "no provenance yet", media_type="text/markdown"), static=True)
