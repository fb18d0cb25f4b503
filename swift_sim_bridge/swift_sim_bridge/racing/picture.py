"""The picture of a race: the flight from above and from the side, its speed, the estimate, and the errors over time."""

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from swift_ros.race.result import RaceRecord, RaceResult
from swift_ros.track import Track

matplotlib.use("Agg")

PLANES = ((0, 1, "x [m]", "y [m]", "from above"), (0, 2, "x [m]", "z [m]", "from the side"))
STATE, VIO = "state/odometry", "vio/odometry"
STYLES = {STATE: ("#d7301f", 0.7, "state estimate"), VIO: ("#888888", 0.6, "raw VIO")}


def draw(record: RaceRecord, result: RaceResult, track: Track, path: Path) -> None:
    """Write the picture of one race to `path` (.png)."""
    figure = Figure(figsize=(14, 9), layout="constrained")
    grid = figure.add_gridspec(3, 2, height_ratios=(3.0, 1.0, 1.0))
    views = [figure.add_subplot(grid[0, column]) for column in range(2)]
    truth = _flown(record, record.odometry["ground_truth/odometry"])
    lines = None
    for axes, (i, j, horizontal, vertical, title) in zip(views, PLANES, strict=True):
        for topic in (VIO, STATE):
            color, width, label = STYLES[topic]
            states = _flown(record, record.odometry[topic])
            if states:
                p = np.array([state.p_world for state in states])
                axes.plot(p[:, i], p[:, j], color=color, linewidth=width, label=label, zorder=1 if topic == VIO else 3)
        lines = _speed_line(axes, truth, i, j) or lines
        gates(axes, track, i, j)
        axes.set(xlabel=horizontal, ylabel=vertical, title=title, aspect="equal")
        axes.grid(alpha=0.3)
    views[0].legend(loc="lower right", fontsize="small")
    if lines is not None:
        figure.colorbar(lines, ax=views, label="speed [m/s]", shrink=0.8)
    _errors(figure.add_subplot(grid[1, :]), record, truth)
    _speed_and_height(figure.add_subplot(grid[2, :]), record, truth)
    figure.suptitle(_title(result, track))
    figure.savefig(path, dpi=110)


def _title(result: RaceResult, track: Track) -> str:
    text = f"{track.name}, seed {result.seed}: {result.end}, {result.gates_passed} of {track.passages} gates"
    if result.time_s is not None:
        text += f", {result.time_s:.2f} s, laps " + ", ".join(f"{lap:.2f}" for lap in result.laps_s) + " s"
    return text if result.finished else f"{text} ({result.crash})"


def _flown(record: RaceRecord, states: list) -> list:
    """The states between start signal and end."""
    begin = record.start_ns or 0
    end = record.end_ns or (states[-1].stamp_ns if states else 0)
    return [state for state in states if begin <= state.stamp_ns <= end]


def _seconds(record: RaceRecord, states) -> np.ndarray:
    return np.array([1e-9 * (state.stamp_ns - (record.start_ns or 0)) for state in states])


def _speed_line(axes, truth, i: int, j: int):
    if len(truth) < 2:
        return None
    points = np.array([pose.p_world[[i, j]] for pose in truth])
    speed = np.array([np.linalg.norm(pose.v_body) for pose in truth])
    lines = LineCollection(np.stack([points[:-1], points[1:]], axis=1), cmap="viridis", linewidth=1.6, zorder=2)
    lines.set_array(speed[:-1])
    axes.add_collection(lines)
    axes.autoscale_view()
    return lines


def gates(axes, track: Track, i: int, j: int) -> None:
    """Draw the gates with their numbers and directions into a view of the axes i and j of the map."""
    for number, (corners, centre, rotation) in enumerate(
        zip(track.corners, track.positions, track.rotations, strict=True), start=1
    ):
        outer = centre + (corners - centre) * track.outer_side / track.inner_side
        for ring, width in ((corners, 2.5), (outer, 0.8)):
            closed = ring[[0, 1, 2, 3, 0]]
            axes.plot(closed[:, i], closed[:, j], color="#e6550d", linewidth=width, solid_capstyle="round", zorder=4)
        tip = centre + 0.9 * rotation[:, 0]
        axes.annotate("", (tip[i], tip[j]), (centre[i], centre[j]), arrowprops={"arrowstyle": "->", "color": "#e6550d"})
        name = centre - 0.9 * rotation[:, 0] + [0.0, 0.0, 0.3]
        axes.text(name[i], name[j], str(number), color="#a63603", weight="bold", ha="center", va="center", zorder=5)


def _errors(axes, record: RaceRecord, truth) -> None:
    if len(truth) > 1:
        at, positions = _seconds(record, truth), np.array([pose.p_world for pose in truth])
        for topic in (VIO, STATE):
            color, _, label = STYLES[topic]
            states = _flown(record, record.odometry[topic])
            if states:
                times = _seconds(record, states)
                expected = np.stack([np.interp(times, at, positions[:, axis]) for axis in range(3)], axis=-1)
                error = np.linalg.norm(np.array([state.p_world for state in states]) - expected, axis=1)
                rms = np.sqrt(np.mean(error * error))
                axes.plot(times, error, color=color, linewidth=1.0, label=f"{label}: RMS {rms:.3f} m")
        axes.legend(loc="upper left", fontsize="small")
    _passages(axes, record)
    axes.set(ylabel="position error [m]", ylim=(0, None))
    axes.grid(alpha=0.3)


def _speed_and_height(axes, record: RaceRecord, truth) -> None:
    if truth:
        axes.plot(_seconds(record, truth), [np.linalg.norm(pose.v_body) for pose in truth], label="speed [m/s]")
        axes.plot(_seconds(record, truth), [pose.p_world[2] for pose in truth], label="height [m]")
        axes.legend(loc="upper left", fontsize="small")
    _passages(axes, record)
    axes.set(xlabel="time since the start signal [s]", ylim=(0, None))
    axes.grid(alpha=0.3)


def _passages(axes, record: RaceRecord) -> None:
    for event in record.events:
        if event.is_passage:
            axes.axvline(1e-9 * (event.stamp_ns - record.start_ns), color="#e6550d", linewidth=0.5, alpha=0.6)
