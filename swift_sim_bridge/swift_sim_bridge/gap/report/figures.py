"""The figures of a gap report: mismatch along the path and over time, residual curves, and rollouts."""

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from swift_ros.track import Track
from swift_sim_bridge.gap.validation.holdout import HoldoutResult
from swift_sim_bridge.gap.validation.mismatch import LAYERS, Mismatch, display_layer
from swift_sim_bridge.plots.track import PLANES, draw_gates

matplotlib.use("Agg")

RECORDED, BEFORE, AFTER = "#999999", "#2b6cb0", "#d7301f"
MODEL_STYLES = {  # colour, line style and label by model of `holdout.MODELS`
    "before": (BEFORE, "-", "vehicle file"),
    "knn": ("#6b6b6b", ":", "nearest neighbours (black box)"),
    "gp": ("#6b6b6b", "--", "Gaussian process (black box)"),
    "after": (AFTER, "-", "repaired vehicle file"),
}
COLOURS = "inferno_r"
MIN_MISMATCH = 2.0  # mismatch in multiples of the noise, at which the colour scale begins: noise alone may reach it
COLOUR_PERCENTILE = 98.0  # percentile of the mismatch at which the colour scale ends
MAX_CURVES, MAX_CURVES_OF_LAYER = 6, 2  # curves in the figure, and curves of one layer in it
CURVE_S = 6.0  # duration of a curve
MIN_IMPROVEMENT = 0.05  # least decrease of a channel's mean square, in multiples of the noise variance, to be shown
ROLLOUTS = 9  # rollouts in the figure; more cover one another


def draw(
    mismatches: tuple[Mismatch, ...], holdout_result: HoldoutResult, folder: Path, track: Track | None = None
) -> dict[str, str]:
    """Write the figures into a folder.

    Args:
        mismatches: one for each recording.
        holdout_result: errors and rollouts on held-out parts of the flights.
        folder: where the figures are written.
        track: track whose gates are drawn, None for none.

    Returns:
        The caption of each figure by its file's name.
    """
    figures = {}
    for number, one in enumerate(mismatches, start=1):
        suffix = f"_{number}" if len(mismatches) > 1 else ""
        if one.p_world is not None:
            figures[f"track{suffix}.png"] = (
                _path_figure(one, track),
                f"{one.name}: the flown path. Darker: the residual exceeds the noise by a larger factor (worst layer).",
            )
        figures[f"time{suffix}.png"] = _time_figure(one), f"{one.name}: the same by layer over time."
        figures[f"curves{suffix}.png"] = (
            _curve_figure(one),
            f"{one.name}: measured minus simulated where the difference is largest. Grey: two standard deviations of "
            "the noise.",
        )
    if any(trajectory.recorded.shape[2] for trajectory in holdout_result.trajectories):
        figures["rollouts.png"] = (
            _rollout_figure(holdout_result),
            "One second of simulation from recorded states, on the last part of each flight, which the fit for this "
            "figure has not used.",
        )
    for name, (figure, _) in figures.items():
        figure.savefig(folder / name, dpi=110)
    return {name: caption for name, (_, caption) in figures.items()}


def _sides(one: Mismatch) -> list[tuple[str, np.ndarray]]:
    """Return title and residual (m, c) before the repair, and after it if there is one."""
    sides = [("with the vehicle file", one.before)]
    return sides if one.after is None else [*sides, ("with the repaired file", one.after)]


def _colour_scale(one: Mismatch) -> LogNorm:
    """Return the colour scale of a recording, from MIN_MISMATCH to nearly its largest mismatch."""
    largest = float(np.nanpercentile(one.worst(one.before), COLOUR_PERCENTILE))
    return LogNorm(MIN_MISMATCH, max(4.0 * MIN_MISMATCH, largest), clip=True)


def _path_figure(one: Mismatch, track: Track | None) -> Figure:
    """Draw the path from above and from the side, coloured by the mismatch."""
    sides, norm = _sides(one), _colour_scale(one)
    figure = Figure(figsize=(6.2 * len(sides) + 0.8, 8.0), layout="constrained")
    axes = figure.subplots(2, len(sides), squeeze=False, sharex="col", height_ratios=(2.0, 1.0))
    for column, (title, residual) in enumerate(sides):
        worst = one.worst(residual)
        for row, (i, j, horizontal, vertical, view) in enumerate(PLANES):
            lines = _coloured_line(axes[row, column], one.p_world[:, [i, j]], worst, norm)
            axes[row, column].set(xlabel=horizontal, ylabel=vertical, title=f"{view}, {title}", aspect="equal")
            axes[row, column].grid(alpha=0.3)
            if track:
                draw_gates(axes[row, column], track, i, j)
    _colour_bar(figure, lines, axes, "mismatch / noise", 0.7)
    return figure


def _colour_bar(figure: Figure, coloured, axes, label: str, shrink: float) -> None:
    """Add a colour bar with plain ticks."""
    low, high = coloured.norm.vmin, coloured.norm.vmax
    ticks = [tick for tick in (2, 3, 5, 10, 20, 30, 50, 100, 200, 300, 500, 1000) if low <= tick <= high]
    bar = figure.colorbar(coloured, ax=axes, label=label, shrink=shrink, ticks=ticks, format="%g")
    bar.minorticks_off()


def _coloured_line(axes, points, value, norm: LogNorm) -> LineCollection:
    """Draw a line through points (n, 2), coloured by a value (n,); grey where it is NaN."""
    axes.plot(*points.T, color="#dddddd", linewidth=0.6, zorder=1)
    pieces, value = np.stack([points[:-1], points[1:]], axis=1), value[:-1]
    known = np.isfinite(value)
    order = np.argsort(value[known])  # the largest on top
    lines = LineCollection(pieces[known][order], cmap=COLOURS, norm=norm, linewidth=2.2, capstyle="round", zorder=2)
    lines.set_array(value[known][order])
    axes.add_collection(lines)
    return lines


def _time_figure(one: Mismatch) -> Figure:
    """Draw the mismatch of each layer over time."""
    sides, norm = _sides(one), _colour_scale(one)
    layers = list(one.layers(one.before))
    figure = Figure(figsize=(13.0, len(sides) * (0.5 * len(layers) + 0.5) + 0.6), layout="constrained")
    axes = figure.subplots(len(sides), 1, squeeze=False, sharex=True)[:, 0]
    for row, (title, residual) in enumerate(sides):
        rows = np.array(list(one.layers(residual).values()))
        image = axes[row].pcolormesh(one.t, np.arange(len(layers)), rows, cmap=COLOURS, norm=norm, shading="nearest")
        axes[row].set_yticks(range(len(layers)), [LAYERS[layer] for layer in layers])
        axes[row].invert_yaxis()
        axes[row].set_title(title, fontsize="medium")
    axes[-1].set_xlabel("time [s]")
    _colour_bar(figure, image, axes, "mismatch / noise", 1.0)
    return figure


def _curve_figure(one: Mismatch) -> Figure:
    """Draw the residuals of the chosen channels in the seconds of their largest mismatch."""
    chosen = _chosen_channels(one)
    rows = -(-len(chosen) // 2)
    figure = Figure(figsize=(13.0, 2.6 * rows + 0.4), layout="constrained")
    axes = figure.subplots(rows, 2, squeeze=False).ravel()
    for number, (panel, i) in enumerate(zip(axes, chosen, strict=False)):
        within = _worst_seconds(one, i)
        t, channel = one.t[within], one.channels[i]
        panel.axhspan(-2.0 * one.noise[i], 2.0 * one.noise[i], color="#dddddd", zorder=0)
        panel.plot(t, one.before[within, i], color=BEFORE, linewidth=1.2, label="vehicle file")
        title = f"{channel.name}: RMS {_rms(one.before[:, i]):.3g} {channel.unit}"
        if one.after is not None:
            panel.plot(t, one.after[within, i], color=AFTER, linewidth=1.2, label="repaired file")
            title += f" before, {_rms(one.after[:, i]):.3g} after"
        panel.set_title(f"{title} (noise {one.noise[i]:.2g})", fontsize="medium")
        panel.set(ylabel=f"[{channel.unit}]", xlim=(t[0], t[-1]))
        panel.grid(alpha=0.3)
        if number == 0:
            panel.legend(fontsize="small", loc="upper right")
    for panel in axes[len(chosen) :]:
        panel.set_visible(False)
    for panel in axes[max(len(chosen) - 2, 0) : len(chosen)]:
        panel.set_xlabel("time [s]")
    return figure


def _chosen_channels(one: Mismatch) -> list[int]:
    """Return the channels that the repair improves most, or without a repair those with the largest mismatch.

    There are at most MAX_CURVES_OF_LAYER of each layer.
    """
    gain = _mean_squares(one.before, one) - (0.0 if one.after is None else _mean_squares(one.after, one))
    layers, chosen = [display_layer(channel) for channel in one.channels], []
    for i in np.argsort(-gain):
        improved = gain[i] > MIN_IMPROVEMENT or len(chosen) < MAX_CURVES_OF_LAYER
        if improved and sum(layers[j] == layers[i] for j in chosen) < MAX_CURVES_OF_LAYER:
            chosen.append(int(i))
    return sorted(chosen[:MAX_CURVES])


def _mean_squares(residual, one: Mismatch) -> np.ndarray:
    """Return the mean squares (c,) of a residual (m, c) in multiples of the noise variance."""
    return np.nanmean(np.square(residual / one.noise), axis=0)


def _worst_seconds(one: Mismatch, i: int) -> slice:
    """Return the CURVE_S in which channel i has its largest mismatch before the repair."""
    count = min(len(one.t), round(CURVE_S / (one.t[1] - one.t[0])))
    squares = np.nan_to_num(np.square(one.before[:, i]))
    first = int(np.argmax(np.convolve(squares, np.ones(count), "valid")))
    return slice(first, first + count)


def _rollout_figure(holdout_result: HoldoutResult) -> Figure:
    """Draw rollouts from above, and their errors by horizon."""
    figure = Figure(figsize=(13.0, 6.0), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.4, 1.0))
    trajectories = max(holdout_result.trajectories, key=lambda one: one.recorded.shape[2])
    chosen = np.unique(np.linspace(0, trajectories.recorded.shape[2] - 1, ROLLOUTS).round().astype(int))
    for style, (lines, width) in {
        RECORDED: (trajectories.recorded[1], 5.0),
        BEFORE: (trajectories.flown[0], 1.6),
        AFTER: (trajectories.flown[1], 1.6),
    }.items():
        left.plot(
            lines[:, chosen, 0],
            lines[:, chosen, 1],
            color=style,
            linewidth=width,
            solid_capstyle="round",
            alpha=0.5 if style == RECORDED else 1.0,
        )
        left.plot(lines[-1, chosen, 0], lines[-1, chosen, 1], "o", color=style, markersize=4)
    left.plot(*trajectories.recorded[1, 0, chosen, :2].T, "k.", markersize=4)
    for colour, label in ((RECORDED, "flown"), (BEFORE, "vehicle file"), (AFTER, "repaired file")):
        left.plot([], [], color=colour, label=label)
    left.legend(fontsize="small")
    left.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", title="from above: one second each, from the black dots")
    left.grid(alpha=0.3)
    _draw_horizons(right, holdout_result.entry["rollout_rmse_m"])
    return figure


def _draw_horizons(axes, errors: dict) -> None:
    """Draw the position error of each model over the horizon."""
    for name, (colour, style, label) in MODEL_STYLES.items():
        axes.plot(
            [float(horizon) for horizon in errors],
            [entry[name] for entry in errors.values()],
            style,
            color=colour,
            marker="o",
            markersize=4,
            label=label,
        )
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="horizon [s]",
        ylabel="position error, RMS [m]",
        title="all rollouts",
    )
    axes.set_xticks([float(horizon) for horizon in errors], list(errors))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.minorticks_off()
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize="small")


def _rms(values) -> float:
    """Return the root mean square of values without NaN."""
    return float(np.sqrt(np.nanmean(np.square(values))))
