"""The figures of a gap report: mismatch along the path and over time, residual curves, and rollouts.

Each is as wide as a column of the page, which is the width of a phone.
"""

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from PIL import Image

from swift_ros.track import Track
from swift_sim_bridge.gap.validation.holdout import HoldoutResult
from swift_sim_bridge.gap.validation.mismatch import LAYERS, Mismatch, display_layer
from swift_sim_bridge.plots.track import PLANES, draw_gates

RECORDED, BEFORE, AFTER = "#999999", "#2b6cb0", "#d7301f"
MODEL_STYLES = {  # colour, line style and label by model of `black_boxes.MODELS`
    "before": (BEFORE, "-", "vehicle file"),
    "knn": ("#6b6b6b", ":", "nearest neighbours (black box)"),
    "gp": ("#6b6b6b", "--", "Gaussian process (black box)"),
    "after": (AFTER, "-", "repaired vehicle file"),
    "with_remainder": (AFTER, ":", "repaired, with a black-box remainder"),
}
COLOURS = "inferno_r"
MIN_MISMATCH = 2.0  # mismatch in multiples of the noise, at which the colour scale begins: noise alone may reach it
COLOUR_PERCENTILE = 98.0  # percentile of the mismatch at which the colour scale ends
MAX_CURVES, MAX_CURVES_OF_LAYER = 6, 2  # curves in the figure, and curves of one layer in it
CURVE_S = 6.0  # duration of a curve
MIN_IMPROVEMENT = 0.05  # least decrease of a channel's mean square, in multiples of the noise variance, to be shown
ROLLOUTS = 9  # rollouts in the figure; more cover one another
WIDTH, DPI = 5.2, 190  # inch; pixels in an inch, so that the figure is sharp on a phone too
ARROWS = 7  # on the path, which show the direction of flight
MIN_ARROW_SHARE = 0.02  # of the path's extent that the vehicle must move from an arrow's tail to its head


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
    figures: dict[str, tuple[Figure, str]] = {}
    for number, one in enumerate(mismatches, start=1):
        suffix = f"_{number}" if len(mismatches) > 1 else ""
        if one.p_world is not None:
            for side, (title, residual) in _sides(one).items():
                caption = (
                    f"{one.name}, {title}: the flown path from its start, with arrows in the direction of flight. "
                    "Darker: the residual exceeds the noise by a larger factor (worst layer)."
                )
                figures[f"track_{side}{suffix}.png"] = _path_figure(one, (title, residual), track), caption
        for side, shown in _sides(one).items():
            caption = f"{one.name}, {shown[0]}: the factor by which residuals exceed the noise, by layer over time."
            figures[f"time_{side}{suffix}.png"] = _time_figure(one, shown), caption
        for i in _chosen_channels(one):
            figures[f"curves_{one.channels[i].id}{suffix}.png"] = (
                _curve_figure(one, i),
                f"{one.name}: {one.channels[i].name} where its difference is largest. Grey: two standard deviations of "
                "the noise.",
            )
    if any(trajectory.recorded.shape[2] for trajectory in holdout_result.trajectories):
        figures["rollouts.png"] = (
            _rollout_figure(holdout_result),
            "One second of simulation from recorded states (black dots), from above, on the last part of each flight, "
            "which the fit for this figure has not used.",
        )
        figures["horizons.png"] = (
            _horizon_figure(holdout_result.entry["rollout_rmse_m"]),
            "The position error of all these simulations by their duration, beside two black-box models.",
        )
    for name, (figure, _) in figures.items():
        _save(figure, folder / name)
    return {name: caption for name, (_, caption) in figures.items()}


def _save(figure: Figure, path: Path) -> None:
    """Write a figure as a PNG file. `Figure.savefig` would draw it twice, which takes a third longer."""
    figure.set_dpi(DPI)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB").save(path)


def _sides(one: Mismatch) -> dict[str, tuple[str, np.ndarray]]:
    """Return title and residual (m, c) before the repair, and after it if there is one."""
    sides = {"before": ("with the vehicle file", one.before)}
    return sides if one.after is None else sides | {"after": ("with the repaired file", one.after)}


def _colour_scale(one: Mismatch) -> LogNorm:
    """Return the colour scale of a recording, from MIN_MISMATCH to nearly its largest mismatch."""
    largest = float(np.nanpercentile(one.worst(one.before), COLOUR_PERCENTILE))
    return LogNorm(MIN_MISMATCH, max(4.0 * MIN_MISMATCH, largest), clip=True)


def _path_figure(one: Mismatch, side: tuple[str, np.ndarray], track: Track | None) -> Figure:
    """Draw the path from above and from the side, coloured by the mismatch of a side's residual (m, c)."""
    what, residual = side
    worst, norm, p = one.worst(residual), _colour_scale(one), one.p_world
    shown = np.concatenate([p, track.corners.reshape(-1, 3)]) if track else p
    extent = np.maximum(np.ptp(shown, axis=0), 0.1 * np.ptp(shown, axis=0).max())
    heights = [np.clip(WIDTH * extent[j] / extent[i], 1.2, 6.0) for i, j, *_ in PLANES]
    figure = Figure(figsize=(WIDTH, sum(heights) + 2.0), layout="constrained")
    axes = figure.subplots(2, 1, height_ratios=heights)
    for panel, (i, j, horizontal, vertical, view) in zip(axes, PLANES, strict=True):
        lines = _coloured_line(panel, p[:, [i, j]], worst, norm)
        panel.set(xlabel=horizontal, ylabel=vertical, title=f"{view}, {what}", aspect="equal")
        panel.set_adjustable("datalim")
        panel.grid(alpha=0.3)
        if track:
            draw_gates(panel, track, i, j)
        _draw_direction(panel, p[:, [i, j]])
    _colour_bar(figure, lines, axes, "mismatch / noise")
    return figure


def _draw_direction(axes, points) -> None:
    """Mark start and end of a path (n, 2), and draw arrows along it in the direction of flight."""
    steps = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    length = MIN_ARROW_SHARE * np.ptp(points, axis=0).max()
    for at in np.linspace(0.0, steps[-1], ARROWS + 2)[1:-1] if length > 0.0 else ():
        tail = int(np.searchsorted(steps, at))
        head = int(np.searchsorted(steps, at + length))
        if head < len(points) and np.linalg.norm(points[head] - points[tail]) > 0.5 * length:
            axes.annotate(
                "",
                points[head],
                points[tail],
                arrowprops={"arrowstyle": "-|>", "facecolor": "white", "edgecolor": "black", "mutation_scale": 15},
                zorder=6,
            )
    style = {"markersize": 8, "markeredgecolor": "white", "zorder": 7, "linestyle": ""}
    axes.plot(*points[0], marker="o", color="#19724a", label="start", **style)
    axes.plot(*points[-1], marker="s", color="#111111", label="end", **style)
    axes.legend(fontsize="small", loc="best", framealpha=0.8, ncols=2, handletextpad=0.1, columnspacing=0.8)


def _colour_bar(figure: Figure, coloured, axes, label: str) -> None:
    """Add a colour bar with plain ticks below the axes."""
    low, high = coloured.norm.vmin, coloured.norm.vmax
    ticks = [tick for tick in (2, 3, 5, 10, 20, 30, 50, 100, 200, 300, 500, 1000) if low <= tick <= high]
    bar = figure.colorbar(
        coloured, ax=axes, label=label, ticks=ticks, format="%g", location="bottom", aspect=40, shrink=0.8
    )
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


def _time_figure(one: Mismatch, side: tuple[str, np.ndarray]) -> Figure:
    """Draw the mismatch of each layer over time, of a side's residual (m, c)."""
    what, residual = side
    layers = one.layers(residual)
    figure = Figure(figsize=(WIDTH, 0.34 * len(layers) + 1.6), layout="constrained")
    axes = figure.subplots()
    rows = np.array(list(layers.values()))
    image = axes.pcolormesh(
        one.t, np.arange(len(layers)), rows, cmap=COLOURS, norm=_colour_scale(one), shading="nearest"
    )
    axes.set_yticks(range(len(layers)), [LAYERS[layer] for layer in layers])
    axes.invert_yaxis()
    axes.set_title(what, fontsize="medium")
    axes.set_xlabel("time [s]")
    _colour_bar(figure, image, axes, "mismatch / noise")
    return figure


def _curve_figure(one: Mismatch, i: int) -> Figure:
    """Draw the residual of channel i in the seconds of its largest mismatch."""
    figure = Figure(figsize=(WIDTH, 2.7), layout="constrained")
    axes = figure.subplots()
    within = _worst_seconds(one, i)
    t, channel = one.t[within], one.channels[i]
    unit = f" {plain_unit(channel.unit)}" if channel.unit else ""
    axes.axhspan(-2.0 * one.noise[i], 2.0 * one.noise[i], color="#dddddd", zorder=0)
    sides = [(one.before, BEFORE, "vehicle file"), (one.after, AFTER, "repaired file")]
    for residual, colour, label in sides[: 1 if one.after is None else 2]:
        text = f"{label}: RMS {_rms(residual[:, i]):.2g}{unit}"
        axes.plot(t, residual[within, i], color=colour, linewidth=1.2, label=text)
    axes.set(xlabel="time [s]", ylabel=f"difference{unit and f' [{unit.strip()}]'}", xlim=(t[0], t[-1]))
    axes.set_title(channel.name, fontsize="medium")
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small", loc="lower center", ncols=2, bbox_to_anchor=(0.5, 1.1), frameon=False)
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
    """Draw rollouts from above."""
    figure = Figure(figsize=(WIDTH, 4.6), layout="constrained")
    axes = figure.subplots()
    trajectories = max(holdout_result.trajectories, key=lambda one: one.recorded.shape[2])
    chosen = np.unique(np.linspace(0, trajectories.recorded.shape[2] - 1, ROLLOUTS).round().astype(int))
    for style, (lines, width) in {
        RECORDED: (trajectories.recorded[1], 5.0),
        BEFORE: (trajectories.flown[0], 1.6),
        AFTER: (trajectories.flown[1], 1.6),
    }.items():
        axes.plot(
            lines[:, chosen, 0],
            lines[:, chosen, 1],
            color=style,
            linewidth=width,
            solid_capstyle="round",
            alpha=0.5 if style == RECORDED else 1.0,
        )
        axes.plot(lines[-1, chosen, 0], lines[-1, chosen, 1], "o", color=style, markersize=4)
    axes.plot(*trajectories.recorded[1, 0, chosen, :2].T, "k.", markersize=4)
    for colour, label in ((RECORDED, "flown"), (BEFORE, "vehicle file"), (AFTER, "repaired file")):
        axes.plot([], [], color=colour, label=label)
    axes.legend(fontsize="small", loc="lower center", ncols=3, bbox_to_anchor=(0.5, 1.0), frameon=False)
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axes.grid(alpha=0.3)
    return figure


def _horizon_figure(errors: dict) -> Figure:
    """Draw the position error of each model over the horizon."""
    figure = Figure(figsize=(WIDTH, 4.6), layout="constrained")
    axes = figure.subplots()
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
    axes.set(xscale="log", yscale="log", xlabel="horizon [s]", ylabel="position error, RMS [m]")
    axes.set_xticks([float(horizon) for horizon in errors], list(errors))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.minorticks_off()
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize="small", loc="lower center", ncols=2, bbox_to_anchor=(0.5, 1.0), frameon=False)
    return figure


def plain_unit(unit: str) -> str:
    """Return a unit with raised powers, as Matplotlib's texts have them."""
    return unit.replace("^2", "²").replace("^3", "³")


def _rms(values) -> float:
    """Return the root mean square of values without NaN."""
    return float(np.sqrt(np.nanmean(np.square(values))))
