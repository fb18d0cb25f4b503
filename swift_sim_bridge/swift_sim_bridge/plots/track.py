"""The gates of a track, projected onto two axes of the map."""

import numpy as np
from matplotlib import patheffects

from swift_ros.track import Track

FRAME_COLOR, NUMBER_COLOR = "#e6550d", "#a63603"
# The two views of a flight: axes of the map to the right and upwards, their labels, title.
PLANES = ((0, 1, "x [m]", "y [m]", "from above"), (0, 2, "x [m]", "z [m]", "from the side"))
ARROW_M = 0.9  # length of the arrow of passage; the number is placed as far on the other side of the opening
NUMBER_ABOVE_M = 0.3  # keeps the number off the line of flight
MIN_ARROW_M = 0.3  # in the picture; a passage that is seen more nearly end-on has a dot or a cross in place of an arrow
OUTLINE = [patheffects.withStroke(linewidth=2.5, foreground="white")]  # of texts, which stand on lines


def draw_gates(axes, track: Track, i: int, j: int) -> None:
    """Draw inner and outer edges, number and direction of passage of each gate.

    A passage towards the viewer is drawn as a dot, away from the viewer as a cross, as in diagrams of fields.

    Args:
        axes: Matplotlib axes.
        track: the track.
        i, j: axes of the map (0, 1, 2 for x, y, z) that are drawn to the right and upwards.
    """
    towards = np.cross(np.eye(3)[i], np.eye(3)[j])
    for number, (corners, centre, rotation, inner_side, outer_side) in enumerate(
        zip(track.corners, track.positions, track.rotations, track.inner_sides, track.outer_sides, strict=True), start=1
    ):
        outer = centre + (corners - centre) * outer_side / inner_side
        for ring, width in ((corners, 2.5), (outer, 0.8)):
            closed = ring[[0, 1, 2, 3, 0]]
            axes.plot(closed[:, i], closed[:, j], color=FRAME_COLOR, linewidth=width, solid_capstyle="round", zorder=4)
        passage = ARROW_M * rotation[:, 0]
        tip, place = centre + passage, centre - passage + [0.0, 0.0, NUMBER_ABOVE_M]
        if np.hypot(passage[i], passage[j]) > MIN_ARROW_M:
            arrow = {"arrowstyle": "->", "color": FRAME_COLOR, "linewidth": 1.5}
            axes.annotate("", (tip[i], tip[j]), (centre[i], centre[j]), arrowprops=arrow, zorder=4)
        else:
            marker = "." if passage @ towards > 0 else "x"
            axes.plot(centre[i], centre[j], marker, color=FRAME_COLOR, markersize=8, zorder=4)
            place = outer[np.argmax(outer[:, i])] + 0.3 * np.eye(3)[i]
        axes.text(
            place[i],
            place[j],
            str(number),
            color=NUMBER_COLOR,
            weight="bold",
            ha="center",
            va="center",
            path_effects=OUTLINE,
            zorder=5,
        )
