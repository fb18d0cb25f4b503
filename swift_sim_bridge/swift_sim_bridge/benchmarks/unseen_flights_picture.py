"""Picture of the errors over time of all models on unseen flights."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from swift_sim_bridge.benchmarks.unseen_flights import MODELS, NAMES, UNSEEN
from swift_sim_bridge.gap.report.figures import MODEL_STYLES

matplotlib.use("Agg")


def draw(records: Sequence[dict], path: Path) -> None:
    """Write the curves to `path` (.png): for each model the median over the seeds, and the band of all seeds."""
    figure = Figure(figsize=(10.0, 4.2), layout="constrained")
    for axes, name in zip(figure.subplots(1, len(UNSEEN), sharey=True), UNSEEN, strict=True):
        horizons = list(records[0]["flights"][name])
        for model in MODELS:
            colour, line, _ = MODEL_STYLES.get(model, ("black", "-.", ""))
            errors = np.array([[record["flights"][name][h][model] for h in horizons] for record in records])
            t = [float(h) for h in horizons]
            axes.fill_between(t, errors.min(axis=0), errors.max(axis=0), color=colour, alpha=0.1, linewidth=0.0)
            axes.plot(t, np.median(errors, axis=0), line, color=colour, marker="o", markersize=3, label=NAMES[model])
        axes.set(xscale="log", yscale="log", xlabel="simulated for [s]", title=name)
        axes.set_xticks(t, horizons, minor=False)
        axes.set_xticks([], minor=True)
        axes.grid(alpha=0.3)
    figure.axes[0].set_ylabel("position error, RMS [m]")
    figure.axes[0].legend(fontsize="small")
    figure.savefig(path, dpi=110)
