"""Figure of a replay: flown paths from above, errors over time, and number of detected gates."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from swift_ros.recording.comparison import STATE, TRUTH, VIO, Perception, position_errors
from swift_ros.track import Track

RECORDED, REPLAYED = "#2b6cb0", "#d7301f"


def draw(recorded: Perception, replayed: Perception, track: Track, path: Path) -> None:
    """Write the figure to `path` (.png)."""
    figure = Figure(figsize=(13, 6.5), layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=(1.2, 1.0))
    _paths(figure.add_subplot(grid[:, 0]), recorded, replayed, track)
    _errors(figure.add_subplot(grid[0, 1]), recorded, replayed)
    _gates(figure.add_subplot(grid[1, 1]), recorded, replayed)
    figure.savefig(path, dpi=110)


def _paths(axes, recorded: Perception, replayed: Perception, track: Track) -> None:
    truth = recorded.odometry[TRUTH]
    for states, color, width, label in (
        (truth, "#222222", 2.5, "ground truth"),
        (recorded.odometry[STATE], RECORDED, 1.2, "state, recorded"),
        (replayed.odometry[STATE], REPLAYED, 0.8, "state, replayed"),
        (replayed.odometry[VIO], "#999999", 0.6, "odometry"),
    ):
        if states:
            p = np.array([state.p_world for state in states])
            axes.plot(p[:, 0], p[:, 1], color=color, linewidth=width, label=label)
    if recorded.start_ns is not None:  # other flights than races have no gates
        for number, corners in enumerate(track.corners, start=1):
            axes.plot(corners[:2, 0], corners[:2, 1], color="#e6550d", linewidth=2.5)
            axes.annotate(str(number), corners[0, :2], color="#a63603")
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", title="from above")
    axes.legend(fontsize="small")
    axes.grid(alpha=0.3)


def _errors(axes, recorded: Perception, replayed: Perception) -> None:
    reference, name = (
        (recorded.odometry[TRUTH], "ground truth")
        if recorded.odometry[TRUTH]
        else (recorded.odometry[STATE], "the recorded state")
    )
    begin_ns = reference[0].stamp_ns if reference else 0
    for run, topic, color, label in (
        (recorded, STATE, RECORDED, "state, recorded"),
        (replayed, STATE, REPLAYED, "state, replayed"),
        (replayed, VIO, "#999999", "odometry"),
    ):
        at, error = position_errors(run.odometry[topic], reference)
        if len(at) and run.odometry[topic] is not reference:
            axes.plot(1e-9 * (at - begin_ns), error, color=color, linewidth=0.9, label=label)
    axes.set(xlabel="time [s]", ylabel="error [m]", title=f"distance from {name}", ylim=(0, None))
    if axes.lines:
        axes.legend(fontsize="small")
    axes.grid(alpha=0.3)


def _gates(axes, recorded: Perception, replayed: Perception) -> None:
    begin_ns = min([*recorded.detections, *replayed.detections], default=0)
    for run, color, width, label in ((recorded, RECORDED, 2.0, "recorded"), (replayed, REPLAYED, 0.8, "replayed")):
        if run.detections:
            at = 1e-9 * (np.array(sorted(run.detections)) - begin_ns)
            counts = [len(run.detections[stamp]) for stamp in sorted(run.detections)]
            axes.step(at, counts, where="post", color=color, linewidth=width, label=label)
    axes.set(xlabel="time [s]", ylabel="gates in the image", title="detected gates", ylim=(0, None))
    if axes.lines:
        axes.legend(fontsize="small")
    axes.grid(alpha=0.3)
