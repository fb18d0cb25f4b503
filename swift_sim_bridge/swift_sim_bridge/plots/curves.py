"""The curves of a training, in small axes one below the other."""

from typing import NamedTuple

import numpy as np

MOST_INSIDE = 4  # labels of a legend inside the axes; more stand below
HEADROOM = 1.1  # of an axis from a given lowest value, above the largest value


class Curve(NamedTuple):
    """One axes of a picture.

    Attributes:
        title: quantity with its unit.
        keys: of the rows that are drawn, with the label of each; "" for none.
        scale: Matplotlib's scale of the values.
        factor: on the values, for their unit.
        limits: lowest and highest value shown; None: as the values are, and a little more.
    """

    title: str
    keys: dict[str, str]
    scale: str = "linear"
    factor: float = 1.0
    limits: tuple[float | None, float | None] = (None, None)


def draw_curve(axes, rows: list[dict], x, curve: Curve) -> None:
    """Draw quantities of a log into Matplotlib axes. A row that lacks one leaves a gap; what all lack has no line.

    Args:
        axes: Matplotlib axes.
        rows: of the log.
        x: (n,), place of each row.
        curve: what is drawn.
    """
    for key, label in curve.keys.items():
        values = [row.get(key) for row in rows]
        if values.count(None) == len(values):
            continue
        y = curve.factor * np.array([np.nan if value is None else value for value in values], float)
        axes.plot(x, y, marker=".", markersize=3, linewidth=1.2, label=label or None)
    axes.set_title(curve.title, fontsize="small", loc="left")
    axes.set_yscale(curve.scale)
    low, high = curve.limits
    drawn = np.concatenate([[0.0], *(line.get_ydata() for line in axes.lines)])
    highest = drawn.max(where=np.isfinite(drawn), initial=0.0)
    if low is not None:
        axes.set_ylim(low, high or HEADROOM * highest or 1.0)
    axes.tick_params(labelsize="small")
    axes.grid(alpha=0.3)
    if (count := len(axes.get_legend_handles_labels()[0])) > MOST_INSIDE:
        axes.legend(fontsize="x-small", loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=4, frameon=False)
    elif count:
        axes.legend(fontsize="x-small", loc="best")
