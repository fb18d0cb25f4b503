"""The folder of a gap report: residuals over time before and after the repair, findings, figures."""

import json
from pathlib import Path

import cv2
import numpy as np
import rerun as rr

from swift_ros.errors import UsageError
from swift_sim_bridge.gap.report import residual_file
from swift_sim_bridge.gap.report.residual_file import ResidualCurves
from swift_sim_bridge.view import layout, scene
from swift_sim_bridge.view.folders import entity_name, log_pictures
from swift_sim_bridge.view.rows import TIME
from swift_sim_bridge.view.sources import GAP_REPORT

SIDES = {"before": ("vehicle file", (80, 150, 230)), "after": ("repaired vehicle file", (230, 80, 60))}
FULL_MISMATCH = 20.0  # multiples of the noise, at which the color of the path is the darkest


def show(folder: Path, recording: rr.RecordingStream) -> None:
    """Write a gap report to a recording of the viewer. Raises UsageError when its report cannot be read."""
    try:
        report = json.loads((folder / GAP_REPORT).read_text())
        text = findings_text(report)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UsageError(
            f"{folder / 'report.json'} cannot be read as a gap report; run `swiftros gap` again"
        ) from error
    file = folder / residual_file.FILE
    flights = residual_file.read(file) if file.is_file() else []
    if not flights:
        text += f"\n\nThe folder has no {residual_file.FILE}: `swiftros gap` of this version writes it.\n"
    pictures = log_pictures(recording, sorted(folder.glob("*.png")))
    recording.send_blueprint(layout.gap(panels(flights), pictures))
    recording.log("about", rr.TextDocument(text, media_type="text/markdown"), static=True)
    for one in flights:
        log_residuals(recording, one)
        if len(one.p_world):
            recording.log(f"{scene.MAP}/{entity_name(one.name)}", coloured_path(one), static=True)


def findings_text(report: dict) -> str:
    """Return verdict and findings of a report in Markdown."""
    lines = [f"# {report['verdict'].replace('_', ' ')}", ""]
    for one in report["findings"]:
        lines += [f"## {one['effect'] or 'equation'}: {one['verdict']}", "", one["sentence"], ""]
        for name, value in one["parameters"].items():
            low, high = value["interval95"]
            lines.append(f"- {name} = {value['value']:.4g} {value['unit']} (95 %: {low:.4g} to {high:.4g})")
        lines.append("")
    return "\n".join(lines)


def channel_entity(flight: ResidualCurves, i: int) -> str:
    """Return the entity of the curves of a channel."""
    return f"residuals/{entity_name(flight.name)}/{flight.layers[i]}/{entity_name(flight.channels[i])}"


def panels(flights: list[ResidualCurves]) -> dict[str, list[tuple[str, str]]]:
    """Return title and entity of each channel, by layer."""
    found: dict[str, list[tuple[str, str]]] = {}
    for flight in flights:
        for i, (layer, channel, unit) in enumerate(zip(flight.layers, flight.channels, flight.units, strict=True)):
            title = f"{channel}, {unit}" if unit else str(channel)
            title = f"{flight.name}: {title}" if len(flights) > 1 else title
            found.setdefault(str(layer), []).append((title, channel_entity(flight, i)))
    return found


def log_residuals(recording: rr.RecordingStream, flight: ResidualCurves) -> None:
    """Write the curves of all channels before and after the repair."""
    times = rr.TimeColumn(TIME, duration=flight.t)
    for i in range(len(flight.channels)):
        for side, (name, color) in SIDES.items():
            values = getattr(flight, side)
            if len(values):
                entity = f"{channel_entity(flight, i)}/{side}"
                recording.log(entity, rr.SeriesLines(names=name, colors=color), static=True)
                recording.send_columns(entity, [times], rr.Scalars.columns(scalars=values[:, i]))


def coloured_path(flight: ResidualCurves) -> rr.LineStrips3D:
    """Return the flown path, coloured by the mismatch before the repair on a scale of its logarithm."""
    mismatch = np.maximum(flight.mismatch(flight.before), 1.0)
    share = np.clip(np.log(mismatch) / np.log(FULL_MISMATCH), 0.0, 1.0)
    table = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_INFERNO)[:, 0, ::-1]
    pieces = np.stack([flight.p_world[:-1], flight.p_world[1:]], axis=1)
    return rr.LineStrips3D(pieces, colors=table[(60 + 195 * share[:-1]).astype(int)], radii=0.03)
