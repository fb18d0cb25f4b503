"""Detection curves: how often a single effect is named, over its size relative to the detectable size."""

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from swift_sim_bridge.referee.summary import detection_curves, wilson_interval

matplotlib.use("Agg")

EDGES = (0.3, 0.7, 1.5, 3.0, 7.0, 15.0)  # of the bins, each around one of `families.MULTIPLES`


def draw_detection(records: list[dict], path: Path) -> None:
    """Write the curves of each generator to `path` (.png): for all effects, and for those of each layer."""
    generators = sorted({record["generator"] for record in records})
    figure = Figure(figsize=(6.5 * max(len(generators), 1), 4.5), layout="constrained")
    for column, generator in enumerate(generators):
        axes = figure.add_subplot(1, len(generators), column + 1)
        for layer, rows in detection_curves([r for r in records if r["generator"] == generator], EDGES).items():
            rows = [row for row in rows if row[3]]
            size = [np.sqrt(row[0] * row[1]) for row in rows]
            share = [row[2] / row[3] for row in rows]
            count = sum(row[3] for row in rows)
            if layer == "all" and rows:
                bands = np.array([wilson_interval(row[2], row[3]) for row in rows]).T
                axes.fill_between(size, *bands, color="black", alpha=0.12)
            style = {"color": "black", "linewidth": 2.5} if layer == "all" else {"linewidth": 1.0, "alpha": 0.8}
            axes.plot(size, share, "o-", markersize=4, label=f"{layer} ({count})", **style)
        axes.set(
            xscale="log",
            ylim=(-0.03, 1.03),
            xlabel="size / detectable size",
            ylabel="share named exactly",
            title=f"{generator}: single effects",
        )
        axes.axhline(0.95, color="gray", linewidth=0.8, linestyle=":")
        axes.grid(alpha=0.3)
        axes.legend(fontsize="small", loc="lower right")
    figure.savefig(path, dpi=110)
