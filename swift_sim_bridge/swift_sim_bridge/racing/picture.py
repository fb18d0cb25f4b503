"""The picture of a race: the flight from above and from the side, and errors, speed, thrust and battery over time."""

from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from PIL import Image

from swift_ros.race.judge import ENDS
from swift_ros.race.result import RaceRecord, RaceResult, judge_again
from swift_ros.track import Track
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.plots.track import OUTLINE, PLANES, draw_gates

matplotlib.use("Agg")

TRUTH, STATE, VIO = "ground_truth/odometry", "state/odometry", "vio/odometry"
STYLES = {STATE: ("#111111", 0.8, "state estimate"), VIO: ("#999999", 0.6, "raw VIO")}  # color, line width, label
PALETTE = 256  # colors of the file
TEXT_SHARE, TEXT_MARGIN = 0.28, 0.17  # distance of the text from the end, and from the edges, as shares of the axes
TIME = "time since the start signal [s]"
SPEED_WIDTH = 4.5  # points: the speed is seen on both sides of the estimate, which lies on it
# without the dark colors, on which the estimate would not be seen
SPEED_COLORS = ListedColormap(matplotlib.colormaps["viridis"](np.linspace(0.22, 1.0, 256)))
PASSAGE_COLOR, END_COLOR, THRUST_COLOR, BATTERY_COLOR = "#e6550d", "#d7191c", "#756bb1", "#31a354"


def draw(record: RaceRecord, result: RaceResult, track: Track, vehicle: Vehicle, path: Path) -> None:
    """Write the picture of one race to `path` (.png)."""
    compose(record, result, track, vehicle).savefig(path, dpi=100)
    with Image.open(path) as picture:  # a third of the bytes; MAXCOVERAGE keeps the colors of small marks
        reduced = picture.convert("RGB").quantize(PALETTE, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    reduced.save(path, optimize=True)


def compose(record: RaceRecord, result: RaceResult, track: Track, vehicle: Vehicle) -> Figure:
    """Return the picture of one race."""
    record = _as_in_result(record, track, vehicle)
    figure = Figure(figsize=(14, 9), layout="constrained")
    upper, lower = figure.add_gridspec(2, 1, height_ratios=(2.7, 1.0))
    left, right = upper.subgridspec(1, 2, width_ratios=(1.0, 1.05))
    right = right.subgridspec(2, 1, height_ratios=(1.25, 1.0))
    views = [figure.add_subplot(left), figure.add_subplot(right[0])]
    truth = _during_race(record, record.odometry[TRUTH])
    lines = None
    for axes, (i, j, horizontal, vertical, title) in zip(views, PLANES, strict=True):
        _draw_estimates(axes, record, i, j)
        lines = _draw_truth(axes, truth, i, j) or lines
        draw_gates(axes, track, i, j)
        axes.set(xlabel=horizontal, ylabel=vertical, aspect="equal")
        axes.set_title(title, loc="right")
        axes.grid(alpha=0.3)
    if not result.finished:
        _show_end(views, record, result, track)
    # above the axes: a legend within them would hide gates
    views[0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, frameon=False, fontsize="small")
    if lines is not None:
        figure.colorbar(lines, ax=views[1], label="true speed [m/s]", location="top", shrink=0.7, aspect=40)
    panels = [figure.add_subplot(place) for place in (right[1], *lower.subgridspec(1, 3))]
    for axes, draw_panel in zip(
        panels, (_draw_errors, _draw_speed_and_height, _draw_thrust, _draw_battery), strict=True
    ):
        draw_panel(axes, record)
        _mark_times(axes, record, result)
    figure.suptitle(_title(result, track), color="black" if result.finished else END_COLOR, weight="bold")
    return figure


def _title(result: RaceResult, track: Track) -> str:
    text = f"{track.name}, seed {result.seed}: {result.end}, {result.gates_passed} of {track.passages} gates"
    if result.time_s is not None:
        text += f", {result.time_s:.2f} s, laps " + ", ".join(f"{lap:.2f}" for lap in result.laps_s) + " s"
    return text if result.finished else f"{text} ({result.crash})"


def _during_race(record: RaceRecord, states: list) -> list:
    """Return the states or commands between the start signal and the end of the race."""
    begin = record.start_ns or 0
    end = record.end_ns or (states[-1].stamp_ns if states else 0)
    return [state for state in states if begin <= state.stamp_ns <= end]


def _seconds(record: RaceRecord, stamps_ns) -> np.ndarray:
    """Return stamps as s since the start signal."""
    return np.array([1e-9 * (stamp_ns - (record.start_ns or 0)) for stamp_ns in stamps_ns])


def _times(record: RaceRecord, states) -> np.ndarray:
    return _seconds(record, (state.stamp_ns for state in states))


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
    pieces = np.stack([points[:-1], points[1:]], axis=1)
    lines = LineCollection(pieces, cmap=SPEED_COLORS, linewidth=SPEED_WIDTH, capstyle="round", zorder=2)
    lines.set_array(speed[:-1])
    axes.add_collection(lines)
    axes.autoscale_view()
    return lines


def _as_in_result(record: RaceRecord, track: Track, vehicle: Vehicle) -> RaceRecord:
    """Return a record with the events and the end that its result has, which were judged again."""
    events = judge_again(record, track, vehicle)
    end_ns = next((event.stamp_ns for event in events if event.state in ENDS), None)
    return replace(record, events=events, end_ns=end_ns)


def _show_end(views, record: RaceRecord, result: RaceResult, track: Track) -> None:
    """Mark where a race ended in both views; write in the first by what, and when."""
    states = _during_race(record, record.odometry[TRUTH] or record.odometry[STATE])
    if not states:
        return
    path = np.array([state.p_world for state in states])
    for axes, (i, j, *_) in zip(views, PLANES, strict=True):
        axes.plot(path[-1, i], path[-1, j], "X", color=END_COLOR, markersize=15, markeredgecolor="white", zorder=7)
    i, j, *_ = PLANES[0]
    text = f"{result.crash}\n{_times(record, states)[-1]:.2f} s after the start"
    drawn = np.concatenate([path, track.corners.reshape(-1, 3), track.positions])[:, [i, j]]
    _write_end(views[0], path[-1, [i, j]], text, drawn)


def _write_end(axes, place, text: str, drawn) -> None:
    """Write beside the place (2,) of the end what ended the race, where most room is left.

    Args:
        axes: Matplotlib axes.
        place: (2,) in the data of the axes.
        text: to be written.
        drawn: (n, 2), what must not be covered: gates and path.
    """
    low, high = np.array([axes.get_xlim(), axes.get_ylim()]).T
    angles = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    reach = TEXT_SHARE * (high - low)[0] * np.array([[0.6], [1.0]])[..., None]
    candidates = (place + reach * np.stack([np.cos(angles), np.sin(angles)], axis=-1)).reshape(-1, 2)
    room = np.min(np.linalg.norm(candidates[:, None] - drawn, axis=-1), axis=1)
    room[
        np.any((candidates < low + TEXT_MARGIN * (high - low)) | (candidates > high - 0.06 * (high - low)), axis=1)
    ] = -1
    axes.annotate(
        text,
        place,
        candidates[np.argmax(room)],
        ha="center",
        va="center",
        color=END_COLOR,
        weight="bold",
        arrowprops={"arrowstyle": "-", "color": END_COLOR},
        path_effects=OUTLINE,
        zorder=6,
    )


def _draw_errors(axes, record: RaceRecord) -> None:
    truth = _during_race(record, record.odometry[TRUTH])
    if len(truth) > 1:
        truth_s, positions = _times(record, truth), np.array([pose.p_world for pose in truth])
        for topic in (VIO, STATE):
            color, _, label = STYLES[topic]
            states = _during_race(record, record.odometry[topic])
            if states:
                times = _times(record, states)
                expected = np.stack([np.interp(times, truth_s, positions[:, axis]) for axis in range(3)], axis=-1)
                error = np.linalg.norm(np.array([state.p_world for state in states]) - expected, axis=1)
                rms = np.sqrt(np.mean(error * error))
                axes.plot(times, error, color=color, linewidth=1.0, label=f"{label}: RMS {rms:.3f} m")
    axes.set(xlabel=TIME, ylabel="position error [m]", ylim=(0, None))


def _draw_speed_and_height(axes, record: RaceRecord) -> None:
    truth = _during_race(record, record.odometry[TRUTH])
    if truth:
        times = _times(record, truth)
        axes.plot(times, [np.linalg.norm(pose.v_body) for pose in truth], label="speed [m/s]")
        axes.plot(times, [pose.p_world[2] for pose in truth], label="height [m]")
    axes.set(xlabel=TIME, ylabel="true speed, height", ylim=(0, None))


def _draw_thrust(axes, record: RaceRecord) -> None:
    commands = _during_race(record, record.commands)
    if commands:
        thrust = np.array([command.thrust for command in commands])
        label = f"commanded: mean {thrust.mean():.1f} m/s²"
        axes.plot(_times(record, commands), thrust, color=THRUST_COLOR, linewidth=0.9, label=label)
    axes.set(xlabel=TIME, ylabel="thrust [m/s²]", ylim=(0, None))


def _draw_battery(axes, record: RaceRecord) -> None:
    begin, end = record.start_ns or 0, record.end_ns
    readings = [(t, volts) for t, volts in record.voltages if begin <= t and (end is None or t <= end)]
    if readings:
        stamps, volts = zip(*readings, strict=True)
        label = f"{volts[0]:.1f} V to {volts[-1]:.1f} V"
        axes.plot(_seconds(record, stamps), volts, color=BATTERY_COLOR, linewidth=1.4, label=label)
    axes.set(xlabel=TIME, ylabel="battery [V]")


def _mark_times(axes, record: RaceRecord, result: RaceResult) -> None:
    """Mark passages, and the end of a race that did not finish; add the legend above the curves."""
    for event in record.events:
        if event.is_passage:
            axes.axvline(1e-9 * (event.stamp_ns - record.start_ns), color=PASSAGE_COLOR, linewidth=0.5, alpha=0.6)
    if not result.finished and record.end_ns is not None:
        axes.axvline(_seconds(record, [record.end_ns])[0], color=END_COLOR, linewidth=2.0)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 0.97), ncols=2, frameon=False, fontsize="small")
    axes.grid(alpha=0.3)
