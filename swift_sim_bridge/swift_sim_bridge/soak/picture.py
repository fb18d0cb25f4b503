"""Picture of a soak: memory and late commands by minute."""

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from swift_sim_bridge.soak.run import Minute

matplotlib.use("Agg")


def draw(minutes: list[Minute], title: str, path: Path) -> None:
    """Write the picture to `path` (.png)."""
    figure = Figure(figsize=(11, 8), layout="constrained")
    memory, late = figure.subplots(2, 1, sharex=True)
    numbers = np.array([minute.minute for minute in minutes])
    names = sorted({name for minute in minutes for name in minute.memory_mb})
    sizes = [[minute.memory_mb.get(name, np.nan) for minute in minutes] for name in names]
    for name, row in zip(names, sizes, strict=True):
        memory.plot(numbers, row, label=name, marker=".", markersize=3)
    memory.plot(numbers, np.nansum(sizes, axis=0), color="black", linewidth=2, label="together")
    memory.set(ylabel="memory (PSS) [MB]", ylim=(0, None), title=title)
    memory.legend(fontsize="x-small", ncols=3)
    counts = [[len(rows) for rows in (minute.late, minute.unexplained)] for minute in minutes]
    explained, others = np.array(counts).T if counts else ([], [])
    late.bar(numbers, explained, color="#9ecae1", label="explained by stalls of the machine")
    late.bar(numbers, others, bottom=explained, color="#de2d26", label="not explained")
    late.set(xlabel="minute", ylabel="commands later than 50 ms")
    late.legend(fontsize="small")
    for axes in (memory, late):
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=110)
