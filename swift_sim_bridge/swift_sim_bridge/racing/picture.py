"""The picture of a race: the flight from above and from the side, its speed, and the errors of the estimates."""

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from swift_ros.race.result import RaceRecord, RaceResult
from swift_ros.track import Track
from swift_sim_bridge.plots.track import PLANES, draw_gates

matplotlib.use("Agg")

TRUTH, STATE, VIO = "ground_truth/odometry", "state/odometry", "vio/odometry"
STYLES = {STATE: ("#d7301f", 0.7, "state estimate"), VIO: ("#888888", 0.6, "raw VIO")}  # color, line width, label
PASSAGE_COLOR = "#e6550d"


def draw(record: RaceRecord, result: RaceResult, track: Track, path: Path) -> None:
    """Write the picture of one race to `path` (.png)."""
    figure = Figure(figsize=(14, 9), layout="constrained")
    grid = figure.add_gridspec(3, 2, height_ratios=(3.0, 1.0, 1.0))
    views = [figure.add_subplot(grid[0, column]) for column in range(2)]
    truth = _during_race(record, record.odometry[TRUTH])
    lines = None
    for axes, (i, j, horizontal, vertical, title) in zip(views, PLANES, strict=True):
        _draw_estimates(axes, record, i, j)
        lines = _draw_truth(axes, truth, i, j) or lines
        draw_gates(axes, track, i, j)
        axes.set(xlabel=horizontal, ylabel=vertical, title=title, aspect="equal")
        axes.grid(alpha=0.3)
    views[0].legend(loc="lower right", fontsize="small")
    if lines is not None:
        figure.colorbar(lines, ax=views, label="speed [m/s]", shrink=0.8)
    _draw_position_errors(figure.add_subplot(grid[1, :]), record, truth)
    _draw_speed_and_height(figure.add_subplot(grid[2, :]), record, truth)
    figure.suptitle(_title(result, track))
    figure.savefig(path, dpi=110)


def _title(result: RaceResult, track: Track) -> str:
    text = f"{track.name}, seed {result.seed}: {result.end}, {result.gates_passed} of {track.passages} gates"
    if result.time_s is not None:
        text += f", {result.time_s:.2f} s, laps " + ", ".join(f"{lap:.2f}" for lap in result.laps_s) + " s"
    return text if result.finished else f"{text} ({result.crash})"


def _during_race(record: RaceRecord, states: list) -> list:
    """Return the states between the start signal and the end of the race."""
    begin = record.start_ns or 0
    end = record.end_ns or (states[-1].stamp_ns if states else 0)
    return [state for state in states if begin <= state.stamp_ns <= end]


def _seconds(record: RaceRecord, states) -> np.ndarray:
    """Return the stamps of states as s since the start signal."""
    return np.array([1e-9 * (state.stamp_ns - (record.start_ns or 0)) for state in states])


def _draw_estimates(axes, record: RaceRecord, i: int, j: int) -> None:
    """Draw the estimated paths in the plane of the axes i and j of the map."""
    for topic in (VIO, STATE):
        color, width, label = STYLES[topic]
        states = _during_race(record, record.odometry[topic])
        if states:
            p = np.array([state.p_world for state in states])
            axes.plot(p[:, i], p[:, j], color=color, linewidth=width, label=label, zorder=1 if topic == VIO else 3)


def _draw_truth(axes, truth, i: int, j: int):
    """Draw the true path, coloured by speed; return its lines, None without a path."""
    if len(truth) < 2:
        return None
    points = np.array([pose.p_world[[i, j]] for pose in truth])
    speed = np.array([np.linalg.norm(pose.v_body) for pose in truth])
    lines = LineCollection(np.stack([points[:-1], points[1:]], axis=1), cmap="viridis", linewidth=1.6, zorder=2)
    lines.set_array(speed[:-1])
    axes.add_collection(lines)
    axes.autoscale_view()
    return lines


def _draw_position_errors(axes, record: RaceRecord, truth) -> None:
    if len(truth) > 1:
        truth_s, positions = _seconds(record, truth), np.array([pose.p_world for pose in truth])
        for topic in (VIO, STATE):
            color, _, label = STYLES[topic]
            states = _during_race(record, record.odometry[topic])
            if states:
                times = _seconds(record, states)
                expected = np.stack([np.interp(times, truth_s, positions[:, axis]) for axis in range(3)], axis=-1)
                error = np.linalg.norm(np.array([state.p_world for state in states]) - expected, axis=1)
                rms = np.sqrt(np.mean(error * error))
                axes.plot(times, error, color=color, linewidth=1.0, label=f"{label}: RMS {rms:.3f} m")
        axes.legend(loc="upper left", fontsize="small")
    _mark_passages(axes, record)
    axes.set(ylabel="position error [m]", ylim=(0, None))
    axes.grid(alpha=0.3)


def _draw_speed_and_height(axes, record: RaceRecord, truth) -> None:
    if truth:
        axes.plot(_seconds(record, truth), [np.linalg.norm(pose.v_body) for pose in truth], label="speed [m/s]")
        axes.plot(_seconds(record, truth), [pose.p_world[2] for pose in truth], label="height [m]")
        axes.legend(loc="upper left", fontsize="small")
    _mark_passages(axes, record)
    axes.set(xlabel="time since the start signal [s]", ylim=(0, None))
    axes.grid(alpha=0.3)


def _mark_passages(axes, record: RaceRecord) -> None:
    for event in record.events:
        if event.is_passage:
            axes.axvline(1e-9 * (event.stamp_ns - record.start_ns), color=PASSAGE_COLOR, linewidth=0.5, alpha=0.6)
