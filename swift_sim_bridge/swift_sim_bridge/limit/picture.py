"""The picture of a limit: the flying lap over the gates, coloured by speed, and speed, thrust and rates over time."""

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from swift_ros.track import Track
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.limit.line import Line
from swift_sim_bridge.limit.models import AS_FLOWN, FULL_THRUST, TITLES
from swift_sim_bridge.limit.solve import LAP, RACE
from swift_sim_bridge.plots.track import PLANES, draw_gates

matplotlib.use("Agg")

COLORS = {FULL_THRUST: "#888888", AS_FLOWN: "#756bb1"}
START_COLOR, PASSAGE_COLOR = "#3182bd", "#e6550d"
AXES = ("roll", "pitch", "yaw")
PANELS = ("speed [m/s]", "force along the body's z axis [N]", "body rates as flown [rad/s]")


def draw(path: Path, lines: dict[str, dict[str, Line]], track: Track, vehicle: Vehicle) -> None:
    """Write the picture (.png).

    Args:
        path: the file.
        lines: by course and model, see `solve.solve_limit`.
        track, vehicle: of the lines.
    """
    figure = Figure(figsize=(14, 9), layout="constrained")
    upper, lower = figure.add_gridspec(2, 1, height_ratios=(2.2, 1.0))
    views = [figure.add_subplot(place) for place in upper.subgridspec(1, 2)]
    colored = None
    for axes, (i, j, horizontal, vertical, title) in zip(views, PLANES, strict=True):
        start = lines[RACE][AS_FLOWN].p_world[: _first_segment(lines[RACE][AS_FLOWN])]
        axes.plot(start[:, i], start[:, j], color=START_COLOR, linewidth=1.0, label="from the podium")
        ideal = lines[LAP][FULL_THRUST].p_world
        axes.plot(ideal[:, i], ideal[:, j], color=COLORS[FULL_THRUST], linewidth=1.0, label="with full thrust")
        colored = _draw_speed(axes, lines[LAP][AS_FLOWN], i, j)
        draw_gates(axes, track, i, j)
        axes.set(xlabel=horizontal, ylabel=vertical, aspect="equal")
        axes.set_title(title, loc="right")
        axes.grid(alpha=0.3)
    views[0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, frameon=False, fontsize="small")
    figure.colorbar(colored, ax=views[1], label="speed as flown [m/s]", location="top", shrink=0.7, aspect=40)
    panels = [figure.add_subplot(place) for place in lower.subgridspec(1, 3)]
    for kind, line in lines[LAP].items():
        style = {"color": COLORS[kind], "linewidth": 1.2}
        panels[0].plot(line.t_s, line.speed, label=TITLES[kind], **style)
        thrust = vehicle.mass * line.specific_force_body[:, 2]
        panels[1].plot(line.t_s, thrust, label=f"mean {line.mean(thrust):.1f} N", **style)
    flown = lines[LAP][AS_FLOWN]
    panels[2].plot(flown.t_s, flown.omega_body, linewidth=1.0, label=AXES)
    for axes, title in zip(panels, PANELS, strict=True):
        for passage_s in np.cumsum(flown.segments_s):
            axes.axvline(passage_s, color=PASSAGE_COLOR, linewidth=0.5, alpha=0.6)
        axes.set(xlabel="time since gate 1 [s]")
        axes.set_title(title, fontsize="small", loc="left")
        place = {"loc": "lower right", "bbox_to_anchor": (1.0, 0.97)}  # above the curves
        axes.legend(fontsize="x-small", ncols=3, frameon=False, **place)
        axes.grid(alpha=0.3)
    figure.suptitle(_title(lines, track, vehicle), weight="bold")
    figure.savefig(path, dpi=100)


def _first_segment(line: Line) -> int:
    """Return the number of points of the first segment."""
    return int(np.searchsorted(line.t_s, line.segments_s[0])) + 1


def _draw_speed(axes, line: Line, i: int, j: int) -> LineCollection:
    points = line.p_world[:, [i, j]]
    drawn = LineCollection(np.stack([points[:-1], points[1:]], axis=1), cmap="viridis", linewidth=3.5, zorder=2)
    drawn.set_array(line.speed[:-1])
    axes.add_collection(drawn)
    axes.autoscale_view()
    return drawn


def _title(lines, track: Track, vehicle: Vehicle) -> str:
    parts = [
        f"{TITLES[kind]}: lap {lines[LAP][kind].t_s[-1]:.3f} s, race {lines[RACE][kind].t_s[-1]:.2f} s"
        for kind in (FULL_THRUST, AS_FLOWN)
    ]
    return f"{track.name}, {vehicle.name}; {'; '.join(parts)}"
