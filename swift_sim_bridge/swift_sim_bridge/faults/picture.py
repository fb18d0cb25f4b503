"""Picture of the endings of races with faults: how they ended by kind of fault, and how fast the crashes were."""

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from swift_sim_bridge.faults.ending import ENDINGS, FELL, FINISHED_RACE, LANDED, STRUCK, Ending

matplotlib.use("Agg")

COLORS = {FINISHED_RACE: "#31a354", LANDED: "#6baed6", FELL: "#fd8d3c", STRUCK: "#e6550d"}
UNDEFINED = "undefined"


def draw(endings: list[Ending], path: Path) -> None:
    """Write the picture to `path` (.png)."""
    kinds = sorted({ending.fault.kind for ending in endings}, reverse=True)
    figure = Figure(figsize=(12, 1.5 + 0.4 * len(kinds)), layout="constrained")
    counts, speeds = figure.subplots(1, 2, sharey=True)
    left = np.zeros(len(kinds))
    for way in (*ENDINGS, UNDEFINED):
        chosen = [e for e in endings if bool(e.problems) == (way == UNDEFINED) and way in (e.way, UNDEFINED)]
        number = np.array([sum(e.fault.kind == kind for e in chosen) for kind in kinds])
        counts.barh(kinds, number, left=left, color=COLORS.get(way, "black"), label=way)
        left += number
    counts.set(xlabel="draws", title=f"how {len(endings)} races with a fault ended")
    counts.legend(fontsize="small")
    crashed = [ending for ending in endings if ending.impact_m_s is not None]
    rows = np.array([kinds.index(ending.fault.kind) for ending in crashed])
    shift = np.random.default_rng(0).uniform(-0.25, 0.25, len(crashed))  # keeps equal speeds apart
    speeds.scatter(
        [ending.impact_m_s for ending in crashed], rows + shift, c=[COLORS[ending.way] for ending in crashed], s=18
    )
    speeds.set(xlabel="closing speed of the crash [m/s]", title="impacts above 1.5 m/s", xlim=(0, None))
    for axes in (counts, speeds):
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=110)
