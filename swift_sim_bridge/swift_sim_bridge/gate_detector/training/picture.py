"""The picture of a training of the gate detector: its curves, and some validation images with labels and detections."""

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from swift_sim_bridge.gate_detector.training.validation import SHOWN, SHOWN_CONFIDENCE, ShownImage
from swift_sim_bridge.model_files.whole_file import replacing
from swift_sim_bridge.plots.curves import Curve, draw_curve

matplotlib.use("Agg")

LOSSES = {"corner_loss": "corners", "affinity_loss": "affinity fields"}
RECALLS = {"recall_at_precision_0.95": "at precision 95 %", "recall_0.3": "above 0.3", "recall_0.5": "above 0.5"}
PRECISIONS = {"precision_0.3": "above 0.3", "precision_0.5": "above 0.5"}
CURVES = (
    Curve("loss", LOSSES, scale="log"),
    Curve("recall [%]", RECALLS, factor=100.0, limits=(-3.0, 103.0)),
    Curve("precision [%]", PRECISIONS, factor=100.0, limits=(-3.0, 103.0)),
    Curve("median error of a corner [px]", {"median_error_px": ""}, limits=(0.0, None)),
    Curve("learning rate", {"learning_rate": ""}, scale="log"),
)
TRUE_COLOR, FOUND_COLOR = "#41ab5d", "#ef3b2c"


def draw(path: Path, rows: list[dict], shown: list[ShownImage]) -> None:
    """Write the picture of a training (.png); the file is replaced at once or not at all.

    Args:
        path: the file.
        rows: of the log.
        shown: images of the last validation.
    """
    figure = Figure(figsize=(16, 9), layout="constrained")
    columns = SHOWN // 2
    left, right = figure.subfigures(1, 2, width_ratios=(1.0, 2.4))
    steps = np.array([row["step"] for row in rows])
    for axes, curve in zip(left.subplots(len(CURVES), 1, sharex=True), CURVES, strict=True):
        draw_curve(axes, rows, steps, curve)
    left.axes[-1].set_xlabel("step", fontsize="small")
    for axes, image in zip(right.subplots(2, columns).ravel(), shown, strict=False):
        axes.imshow(image.panorama, cmap="gray", vmin=0, vmax=255)
        axes.scatter(*image.true.T, marker="+", s=45, linewidth=1.0, color=TRUE_COLOR)
        axes.scatter(*image.found.T, s=45, linewidth=0.8, facecolors="none", edgecolors=FOUND_COLOR)
    for axes in right.axes:
        axes.set_axis_off()
    last = rows[-1]
    right.suptitle(
        f"validation images, step {last['step']}: true visible corners (green crosses), detected ones above "
        f"{SHOWN_CONFIDENCE} (red circles)",
        fontsize="medium",
    )
    with replacing(path) as partial:
        figure.savefig(partial, format="png", dpi=90)
