"""The picture of a training of the policy: its curves, and the lines flown in the last trial over the track."""

import math
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from swift_ros.track import Track
from swift_sim_bridge.model_files.whole_file import replacing
from swift_sim_bridge.pilot.episodes.randomization import TICK
from swift_sim_bridge.pilot.trial import Trial
from swift_sim_bridge.plots.curves import Curve, draw_curve
from swift_sim_bridge.plots.track import PLANES, draw_gates

matplotlib.use("Agg")

CURVES = (
    Curve("reward per second of flight", {"reward_per_s": ""}),
    Curve("trial races finished [%]", {"finish_rate": ""}, factor=100.0, limits=(-3.0, 103.0)),
    Curve("lap [s]", {"median_lap_s": "median", "best_lap_s": "best"}),
    Curve("gates passed in a trial race (mean)", {"passages": ""}, limits=(0.0, None)),
    Curve("margin to the frames [m]", {"mean_margin_m": "mean", "min_margin_m": "least"}, limits=(0.0, None)),
    Curve("difficulty, sigma of the exploration", {"difficulty": "difficulty", "sigma": "sigma"}, limits=(-0.03, 1.03)),
    Curve("divergence of an update", {"kl": ""}),  # of PPO
    Curve("norm of the gradient", {"gradient_norm": ""}, scale="log"),  # of backpropagation
    Curve("learning rate", {"learning_rate": ""}, scale="log"),
    Curve("interactions/s", {"steps_per_s": ""}, limits=(0.0, None)),
)
END_COLOR = "#cb181d"  # of a race that did not finish


def draw(path: Path, rows: list[dict], races: Trial, track: Track) -> None:
    """Write the picture of a training (.png); the file is replaced at once or not at all.

    Args:
        path: the file.
        rows: of the log, the last one of `races`.
        races: the last trial.
        track: of the races.
    """
    figure = Figure(figsize=(16, 9), layout="constrained")
    left, right = figure.add_gridspec(1, 2)
    shown = [curve for curve in CURVES if any(key in row for key in curve.keys for row in rows)]
    grid = left.subgridspec(math.ceil(len(shown) / 2), 2)
    millions = np.array([1e-6 * row["interactions"] for row in rows])
    axes = None
    for number, curve in enumerate(shown):
        axes = figure.add_subplot(grid[number // 2, number % 2], sharex=axes)
        draw_curve(axes, rows, millions, curve)
        if number >= len(shown) - 2:
            axes.set_xlabel("million interactions", fontsize="small")
    lines, unfinished = np.asarray(races.lines, float), np.asarray(races.passage_ticks)[:, -1] < 0
    views = [figure.add_subplot(half) for half in right.subgridspec(2, 1)]
    colored = None
    for axes, (i, j, horizontal, vertical, title) in zip(views, PLANES, strict=True):
        colored = _draw_lines(axes, lines[..., [i, j]], lines)
        draw_gates(axes, track, i, j)
        ends = np.asarray(races.end)[unfinished]
        axes.scatter(ends[:, i], ends[:, j], marker="x", color=END_COLOR, zorder=6)
        axes.set(xlabel=horizontal, ylabel=vertical, title=title, aspect="equal")
        axes.grid(alpha=0.3)
    if colored is not None:
        figure.colorbar(colored, ax=views, label="speed [m/s]", shrink=0.8)
    last = rows[-1]
    ended = f"; x: end of the {unfinished.sum()} that did not finish" if unfinished.any() else ""
    figure.suptitle(
        f"{track.name}, {last['interactions'] / 1e6:.2f} million interactions: {100 * last['finish_rate']:.0f} % of "
        f"{len(unfinished)} trial races finished; lines of {len(lines)} of them{ended}",
        fontsize="medium",
    )
    with replacing(path) as partial:
        figure.savefig(partial, format="png", dpi=90)


def _draw_lines(axes, points, positions):
    """Draw lines (n, ticks, 2), coloured by the speed along positions (n, ticks, 3), and return them."""
    pieces = np.stack([points[:, :-1], points[:, 1:]], axis=2).reshape(-1, 2, 2)
    speed = np.linalg.norm(np.diff(positions, axis=1), axis=-1).ravel() / TICK
    flown = np.isfinite(speed)
    lines = LineCollection(list(pieces[flown]), cmap="viridis", linewidth=0.9, alpha=0.8, zorder=2)
    lines.set_array(speed[flown])
    axes.add_collection(lines)
    axes.autoscale_view()
    return lines
