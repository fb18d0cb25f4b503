"""The figure of an identification: measurements, and predictions with the vehicle file before and after."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from swift_sim_bridge.identification.regression import Fit

SHOWN_S = 8  # s of the flight in each panel
COLUMNS = 3
MEASURED, BEFORE, AFTER = "#999999", "#2b6cb0", "#d7301f"


def draw(fits: list[Fit], path: Path) -> None:
    """Write the figure of the fits to `path` (.png): SHOWN_S seconds of each channel."""
    panels = [(fit, i) for fit in fits for i in range(len(fit.problem.channels))]
    rows = -(-len(panels) // COLUMNS)
    figure = Figure(figsize=(5.5 * COLUMNS, 2.6 * rows + 0.6), layout="constrained")
    for number, (fit, i) in enumerate(panels, start=1):
        _channel(figure.add_subplot(rows, COLUMNS, number), fit, i)
    figure.savefig(path, dpi=100)


def _channel(axes, fit: Fit, i: int) -> None:
    """Draw one channel."""
    problem = fit.problem
    name, unit = problem.channels[i]
    rows = np.flatnonzero((problem.channel == i) & np.isin(problem.cluster, _shown(problem.cluster)))
    _, first = np.unique(problem.t[rows], return_index=True)  # of several rotors with equal times the first
    rows = rows[first]
    t = problem.t[rows]
    axes.plot(t, problem.measured[rows], color=MEASURED, linewidth=2.0, label="measured")
    axes.plot(t, fit.before[rows], color=BEFORE, linewidth=0.9, label="vehicle file")
    title = name
    if fit.free.any():
        axes.plot(t, fit.after[rows], color=AFTER, linewidth=0.9, label="identified")
        before, after = fit.held_out[name]
        title += f"\nRMS error on unseen blocks: {before:.3g} before, {after:.3g} after"
    axes.set(xlabel="t [s]", ylabel=f"[{unit}]")
    axes.set_title(title, fontsize="medium")
    axes.grid(alpha=0.3)
    if i == 0:
        axes.legend(fontsize="x-small", loc="upper right", framealpha=0.6)


def _shown(cluster) -> np.ndarray:
    """Return the clusters (seconds) in the middle of the longest interval without a gap."""
    seconds = np.unique(cluster)
    longest = max(np.split(seconds, np.flatnonzero(np.diff(seconds) > 1) + 1), key=len)
    begin = max(0, (len(longest) - SHOWN_S) // 2)
    return longest[begin : begin + SHOWN_S]
