"""The gates of a track, projected onto two axes of the map."""

from swift_ros.track import Track

FRAME_COLOR, NUMBER_COLOR = "#e6550d", "#a63603"
# The two views of a flight: axes of the map to the right and upwards, their labels, title.
PLANES = ((0, 1, "x [m]", "y [m]", "from above"), (0, 2, "x [m]", "z [m]", "from the side"))
ARROW_M = 0.9  # length of the arrow of passage; the number is placed as far on the other side of the opening
NUMBER_ABOVE_M = 0.3  # keeps the number off the line of flight


def draw_gates(axes, track: Track, i: int, j: int) -> None:
    """Draw inner and outer edges, number and direction of passage of each gate.

    Args:
        axes: Matplotlib axes.
        track: the track.
        i, j: axes of the map (0, 1, 2 for x, y, z) that are drawn to the right and upwards.
    """
    for number, (corners, centre, rotation, inner_side, outer_side) in enumerate(
        zip(track.corners, track.positions, track.rotations, track.inner_sides, track.outer_sides, strict=True), start=1
    ):
        outer = centre + (corners - centre) * outer_side / inner_side
        for ring, width in ((corners, 2.5), (outer, 0.8)):
            closed = ring[[0, 1, 2, 3, 0]]
            axes.plot(closed[:, i], closed[:, j], color=FRAME_COLOR, linewidth=width, solid_capstyle="round", zorder=4)
        tip = centre + ARROW_M * rotation[:, 0]
        axes.annotate(
            "", (tip[i], tip[j]), (centre[i], centre[j]), arrowprops={"arrowstyle": "->", "color": FRAME_COLOR}
        )
        place = centre - ARROW_M * rotation[:, 0] + [0.0, 0.0, NUMBER_ABOVE_M]
        axes.text(
            place[i], place[j], str(number), color=NUMBER_COLOR, weight="bold", ha="center", va="center", zorder=5
        )
