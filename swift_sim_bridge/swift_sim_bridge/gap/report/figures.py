"""The pictures of a gap report: where on the path and when it does not match, the curves, and the rollouts."""

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from swift_ros.track import Track
from swift_sim_bridge.gap.validation.holdout import HoldoutResult
from swift_sim_bridge.gap.validation.mismatch import LAYERS, Mismatch, display_layer
from swift_sim_bridge.plots.track import draw_gates

matplotlib.use("Agg")

RECORDED, BEFORE, AFTER = "#999999", "#2b6cb0", "#d7301f"
MODELS = {
    "before": (BEFORE, "-", "vehicle file"),
    "knn": ("#6b6b6b", ":", "nearest neighbours (black box)"),
    "gp": ("#6b6b6b", "--", "Gaussian process (black box)"),
    "after": (AFTER, "-", "repaired vehicle file"),
}
PLANES = ((0, 1, "x [m]", "y [m]", "from above"), (0, 2, "x [m]", "z [m]", "from the side"))
COLOURS = "inferno_r"
QUIET = 2.0  # times the noise
CURVES, CURVES_OF_LAYER, SHOWN_S = 6, 2, 6.0
MENDED = 0.05  # of the noise squared, which the repair of a channel must be worth to be shown
COURSES = 9


def draw(
    mismatches: tuple[Mismatch, ...], proof: HoldoutResult, folder: Path, track: Track | None = None
) -> dict[str, str]:
    """Write the pictures into a folder and return what each shows, by its file's name. track: of the gates to draw."""
    shown = {}
    for number, one in enumerate(mismatches, start=1):
        suffix = f"_{number}" if len(mismatches) > 1 else ""
        if one.p_world is not None:
            _save(
                _track(one, track),
                folder,
                shown,
                f"track{suffix}.png",
                f"{one.name}: the flown path. The darker, the more times the noise the recording is off what the "
                "simulation makes of the same inputs (worst layer).",
            )
        _save(_times(one), folder, shown, f"time{suffix}.png", f"{one.name}: the same by layer over time.")
        _save(
            _curves(one),
            folder,
            shown,
            f"curves{suffix}.png",
            f"{one.name}: measured less simulated, where it was worst. Grey: twice what a perfect simulation would "
            "leave, by the noise alone.",
        )
    if any(course.recorded.shape[2] for course in proof.trajectories):
        _save(
            _fan(proof),
            folder,
            shown,
            "rollouts.png",
            "Simulated on for a second from recorded states, on the last part of each flight, which the fit behind "
            "this picture has not seen.",
        )
    return shown


def _save(figure: Figure, folder: Path, shown: dict[str, str], name: str, caption: str) -> None:
    figure.savefig(folder / name, dpi=110)
    shown[name] = caption


def _sides(one: Mismatch) -> list[tuple[str, np.ndarray]]:
    sides = [("with the vehicle file", one.before)]
    return sides if one.after is None else [*sides, ("with the repaired file", one.after)]


def _norm(one: Mismatch) -> LogNorm:
    """Return the colour scale of a recording: from what noise alone may show in a moment to nearly the worst."""
    return LogNorm(QUIET, max(4.0 * QUIET, float(np.nanpercentile(one.worst(one.before), 98.0))), clip=True)


def _track(one: Mismatch, track: Track | None) -> Figure:
    sides, norm = _sides(one), _norm(one)
    figure = Figure(figsize=(6.2 * len(sides) + 0.8, 8.0), layout="constrained")
    axes = figure.subplots(2, len(sides), squeeze=False, sharex="col", height_ratios=(2.0, 1.0))
    for column, (title, residual) in enumerate(sides):
        worst = one.worst(residual)
        for row, (i, j, horizontal, vertical, view) in enumerate(PLANES):
            lines = _coloured(axes[row, column], one.p_world[:, [i, j]], worst, norm)
            axes[row, column].set(xlabel=horizontal, ylabel=vertical, title=f"{view}, {title}", aspect="equal")
            axes[row, column].grid(alpha=0.3)
            if track:
                draw_gates(axes[row, column], track, i, j)
    _scale(figure, lines, axes, "mismatch, times the noise", 0.7)
    return figure


def _scale(figure: Figure, coloured, axes, label: str, shrink: float) -> None:
    low, high = coloured.norm.vmin, coloured.norm.vmax
    ticks = [tick for tick in (2, 3, 5, 10, 20, 30, 50, 100, 200, 300, 500, 1000) if low <= tick <= high]
    bar = figure.colorbar(coloured, ax=axes, label=label, shrink=shrink, ticks=ticks, format="%g")
    bar.minorticks_off()


def _coloured(axes, points, value, norm: LogNorm) -> LineCollection:
    axes.plot(*points.T, color="#dddddd", linewidth=0.6, zorder=1)  # also where nothing could be compared
    pieces, value = np.stack([points[:-1], points[1:]], axis=1), value[:-1]
    there = np.isfinite(value)
    order = np.argsort(value[there])  # the worst on top
    lines = LineCollection(pieces[there][order], cmap=COLOURS, norm=norm, linewidth=2.2, capstyle="round", zorder=2)
    lines.set_array(value[there][order])
    axes.add_collection(lines)
    return lines


def _times(one: Mismatch) -> Figure:
    sides, norm = _sides(one), _norm(one)
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
    _scale(figure, image, axes, "times the noise", 1.0)
    return figure


def _curves(one: Mismatch) -> Figure:
    chosen = _most_telling(one)
    rows = -(-len(chosen) // 2)
    figure = Figure(figsize=(13.0, 2.6 * rows + 0.4), layout="constrained")
    axes = figure.subplots(rows, 2, squeeze=False).ravel()
    for number, (panel, i) in enumerate(zip(axes, chosen, strict=False)):
        within = _worst_seconds(one, i)
        t, channel = one.t[within], one.channels[i]
        panel.axhspan(-2.0 * one.noise[i], 2.0 * one.noise[i], color="#dddddd", zorder=0)
        panel.plot(t, one.before[within, i], color=BEFORE, linewidth=1.2, label="vehicle file")
        title = f"{channel.name}: off by {_rms(one.before[:, i]):.3g} {channel.unit}"
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


def _most_telling(one: Mismatch) -> list[int]:
    """Return the channels in which the repair mends most, or which match worst where nothing was repaired; few of each
    layer."""
    gain = _squares(one.before, one) - (0.0 if one.after is None else _squares(one.after, one))
    layers, chosen = [display_layer(channel) for channel in one.channels], []
    for i in np.argsort(-gain):
        mended = gain[i] > MENDED or len(chosen) < CURVES_OF_LAYER
        if mended and sum(layers[j] == layers[i] for j in chosen) < CURVES_OF_LAYER:
            chosen.append(int(i))
    return sorted(chosen[:CURVES])


def _squares(residual, one: Mismatch) -> np.ndarray:
    return np.nanmean(np.square(residual / one.noise), axis=0)


def _worst_seconds(one: Mismatch, i: int) -> slice:
    """Return the SHOWN_S in which a channel matches worst before the repair."""
    count = min(len(one.t), round(SHOWN_S / (one.t[1] - one.t[0])))
    squares = np.nan_to_num(np.square(one.before[:, i]))
    first = int(np.argmax(np.convolve(squares, np.ones(count), "valid")))
    return slice(first, first + count)


def _fan(proof: HoldoutResult) -> Figure:
    figure = Figure(figsize=(13.0, 6.0), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.4, 1.0))
    course = max(proof.trajectories, key=lambda one: one.recorded.shape[2])
    chosen = np.unique(np.linspace(0, course.recorded.shape[2] - 1, COURSES).round().astype(int))
    for style, (lines, width) in {
        RECORDED: (course.recorded[1], 5.0),
        BEFORE: (course.flown[0], 1.6),
        AFTER: (course.flown[1], 1.6),
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
    left.plot(*course.recorded[1, 0, chosen, :2].T, "k.", markersize=4)
    for colour, label in ((RECORDED, "flown"), (BEFORE, "vehicle file"), (AFTER, "repaired file")):
        left.plot([], [], color=colour, label=label)
    left.legend(fontsize="small")
    left.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", title="from above: one second each, from the black dots")
    left.grid(alpha=0.3)
    _horizons(right, proof.entry["rollout_rmse_m"])
    return figure


def _horizons(axes, errors: dict) -> None:
    for name, (colour, style, label) in MODELS.items():
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
        xlabel="simulated for [s]",
        ylabel="off the flown path by [m], RMS",
        title="all rollouts",
    )
    axes.set_xticks([float(horizon) for horizon in errors], list(errors))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.minorticks_off()
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize="small")


def _rms(values) -> float:
    return float(np.sqrt(np.nanmean(np.square(values))))
