"""The picture of a training of the policy: its curves, and the lines of the last trial over the time-optimal lap."""

import math
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from swift_ros.track import Track
from swift_sim_bridge.model_files.whole_file import replacing
from swift_sim_bridge.pilot.episodes.randomization import TICK
from swift_sim_bridge.pilot.episodes.rewards import TERMS
from swift_sim_bridge.pilot.episodes.time_optimal import Guide
from swift_sim_bridge.pilot.trial import Trial
from swift_sim_bridge.plots.curves import Curve, draw_curve
from swift_sim_bridge.plots.track import PLANES, draw_gates

matplotlib.use("Agg")

PROGRESS = "progress", "pace"  # terms of the reward that are many times larger than the others
CURVES = (
    Curve("reward per second of flight", {"reward_per_s": ""}),
    Curve(
        f"the same: terms but {' and '.join(PROGRESS)}",
        {f"{name}_reward_per_s": name.replace("_", " ") for name in TERMS if name not in PROGRESS},
    ),
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
SHADED = 0.02, 1.0  # shares of the values between which colours differ: on the podium speed and thrust are far lower
END_COLOR, LAP_COLOR = "#cb181d", "black"  # of a race that did not finish, and of the time-optimal lap


def draw(path: Path, rows: list[dict], races: Trial, track: Track, guide: Guide | None = None) -> None:
    """Write the picture of a training (.png); the file is replaced at once or not at all.

    Args:
        path: the file.
        rows: of the log, the last one of `races`.
        races: the last trial.
        track: of the races.
        guide: the time-optimal lap that the training follows, None without one.
    """
    figure = Figure(figsize=(20, 9), layout="constrained")
    left, right = figure.add_gridspec(1, 2, width_ratios=(1.0, 1.6))
    shown = [curve for curve in CURVES if any(key in row for key in curve.keys for row in rows)]
    grid = left.subgridspec(math.ceil(len(shown) / 2), 2)
    millions = np.array([1e-6 * row["interactions"] for row in rows])
    axes = None
    for number, curve in enumerate(shown):
        axes = figure.add_subplot(grid[number // 2, number % 2], sharex=axes)
        draw_curve(axes, rows, millions, curve)
        if number >= len(shown) - 2:
            axes.set_xlabel("million interactions", fontsize="small")
    unfinished = np.asarray(races.passage_ticks)[:, -1] < 0
    _draw_views(figure, right, races, track, guide)
    last = rows[-1]
    ended = f"; x: end of the {unfinished.sum()} that did not finish" if unfinished.any() else ""
    ended += "; black: the time-optimal lap" if guide else ""
    figure.suptitle(
        f"{track.name}, {last['interactions'] / 1e6:.2f} million interactions: {100 * last['finish_rate']:.0f} % of "
        f"{len(unfinished)} trial races finished; lines of {len(races.lines)} of them{ended}",
        fontsize="medium",
    )
    with replacing(path) as partial:
        figure.savefig(partial, format="png", dpi=90)


def _draw_views(figure: Figure, place, races: Trial, track: Track, guide: Guide | None) -> None:
    """Draw the lines from above and from the side, on the left coloured by speed, on the right by thrust."""
    lines, ends = np.asarray(races.lines, float), np.asarray(races.end)[np.asarray(races.passage_ticks)[:, -1] < 0]
    speed = np.linalg.norm(np.diff(lines, axis=1), axis=-1) / TICK
    shades = {"speed [m/s]": speed, "thrust of the rotors [N]": np.asarray(races.thrusts, float)[:, 1:]}
    grid = place.subgridspec(2, 2, height_ratios=(2.0, 1.0))
    for column, (label, shade) in enumerate(shades.items()):
        views = [figure.add_subplot(grid[row, column]) for row in range(2)]
        for axes, (i, j, horizontal, vertical, title) in zip(views, PLANES, strict=True):
            colored = _draw_lines(axes, lines[..., [i, j]], shade)
            for way in np.split(np.asarray(guide.points), 2, axis=1) if guide else ():
                axes.plot(way[..., i].T, way[..., j].T, color=LAP_COLOR, linewidth=0.8, zorder=3)
            draw_gates(axes, track, i, j)
            axes.scatter(ends[:, i], ends[:, j], marker="x", color=END_COLOR, zorder=6)
            axes.set(xlabel=horizontal, ylabel=vertical, title=title, aspect="equal")
            axes.grid(alpha=0.3)
        figure.colorbar(colored, ax=views, label=label, location="bottom", shrink=0.8)


def _draw_lines(axes, points, shade):
    """Draw lines (n, ticks, 2), coloured by the values (n, ticks - 1) of a shade, and return them."""
    pieces = np.stack([points[:, :-1], points[:, 1:]], axis=2).reshape(-1, 2, 2)
    shade = shade.ravel()
    flown = np.isfinite(shade) & np.isfinite(pieces).all(axis=(1, 2))
    lines = LineCollection(list(pieces[flown]), cmap="viridis", linewidth=0.9, alpha=0.8, zorder=2)
    lines.set_array(shade[flown])
    if flown.any():
        lines.set_clim(*np.quantile(shade[flown], SHADED))
    axes.add_collection(lines)
    axes.autoscale_view()
    return lines
