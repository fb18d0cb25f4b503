"""The panels: blueprints of the viewer."""

import numpy as np
import rerun.blueprint as rrb

from swift_ros.track import Track
from swift_sim_bridge.view import scene
from swift_sim_bridge.view.rows import TIME
from swift_sim_bridge.view.series import AXES

PATHS = (scene.TRUTH_PATH, scene.ESTIMATE_PATH, scene.VIO_PATH)
DARK = (22, 24, 28)  # of map and image, on which their colors are seen in a light viewer too
EYE = np.array([-0.8, -1.2, 0.9])  # from the middle of the track, in multiples of its radius
# title, unit and entity of the panels of curves, by tab
CURVES = {
    "control": (
        *((f"body rate {axis}, rad/s", f"body_rates/{axis}") for axis in AXES),
        ("collective thrust, m/s²", "thrust"),
    ),
    "state": (("speed, m/s", "speed"), ("position error, m", "error"), ("gates of an image", "updates")),
    "vehicle": (
        ("motor commands, 0 to 1", "motors/command"),
        ("rotor speeds, rad/s", "motors/speed"),
        ("battery, V and A", "battery"),
    ),
    "latency": (
        ("age of messages, ms", "latency"),
        ("99th percentile at the race monitor, ms", "diagnostics/latency_p99_ms"),
        ("rates, Hz", "diagnostics/rate_hz"),
    ),
}


def eye_on(positions, reach_m: float) -> rrb.EyeControls3D:
    """Return an eye that sees places (n, 3) m and `reach_m` around each."""
    centre = np.mean(positions, axis=0)
    reach = np.linalg.norm(positions - centre, axis=1).max() + reach_m
    return rrb.EyeControls3D(position=centre + reach * EYE, look_target=centre, eye_up=(0.0, 0.0, 1.0))


def flight(track: Track | None, is_live: bool) -> rrb.Blueprint:
    """Return the panels of a flight: the map on the left, image and log on the right, curves below.

    Args:
        track: at which the eye looks at first; None: at everything.
        is_live: the present time is followed.
    """
    eye = None if track is None else eye_on(track.positions, float(track.outer_sides.max()))
    flown = rrb.VisibleTimeRanges(
        timeline=TIME, start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.cursor_relative()
    )
    space = rrb.Spatial3DView(
        name="map", origin=scene.MAP, overrides=dict.fromkeys(PATHS, flown), background=DARK, eye_controls=eye
    )
    image = rrb.Spatial2DView(name="onboard camera", origin=scene.CAMERA, background=DARK)
    texts = rrb.Tabs(
        rrb.TextLogView(name="log", origin="log"), rrb.TextDocumentView(name="about", origin="about"), active_tab=0
    )
    tabs = [
        rrb.Horizontal(*(rrb.TimeSeriesView(name=title, origin=entity) for title, entity in curves), name=tab)
        for tab, curves in CURVES.items()
    ]
    states = rrb.StateTimelineView(name="race", origin="states")
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(space, rrb.Vertical(image, texts, row_shares=[3, 2]), column_shares=[5, 3]),
            rrb.Tabs(*tabs, states, active_tab=0),
            row_shares=[3, 2],
        ),
        rrb.TimePanel(state="collapsed", timeline=TIME, play_state="following" if is_live else None),
        collapse_panels=True,
    )


def gap(layers: dict[str, list[tuple[str, str]]], pictures: list[str]) -> rrb.Blueprint:
    """Return the panels of a gap report: findings and path above, residuals by layer below.

    Args:
        layers: title and entity of each channel, by layer.
        pictures: entities of the report's figures.
    """
    tabs = [
        rrb.Grid(*(rrb.TimeSeriesView(name=title, origin=entity) for title, entity in channels), name=layer)
        for layer, channels in layers.items()
    ]
    figures = [rrb.Spatial2DView(name=entity.rpartition("/")[2], origin=entity) for entity in pictures]
    path = rrb.Spatial3DView(name="flown path, by mismatch", origin=scene.MAP, background=DARK)
    findings = rrb.TextDocumentView(name="findings", origin="about")
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(rrb.Tabs(path, *figures, active_tab=0), findings, column_shares=[3, 2]),
            *([rrb.Tabs(*tabs, active_tab=0)] if tabs else []),
        ),
        rrb.TimePanel(state="collapsed", timeline=TIME),
        collapse_panels=True,
    )


def training(curves: list[str], pictures: list[str], timeline: str) -> rrb.Blueprint:
    """Return the panels of a training: one for each curve, and its pictures.

    Args:
        curves: names of the quantities.
        pictures: entities of the pictures.
        timeline: on which the curves are.
    """
    views = [rrb.TimeSeriesView(name=name, origin=f"training/{name}") for name in curves]
    figures = [rrb.Spatial2DView(name=entity.rpartition("/")[2], origin=entity) for entity in pictures]
    side = rrb.Tabs(*figures, rrb.TextDocumentView(name="provenance", origin="about"), active_tab=0)
    return rrb.Blueprint(
        rrb.Horizontal(rrb.Grid(*views), side, column_shares=[3, 2]),
        rrb.TimePanel(state="collapsed", timeline=timeline),
        collapse_panels=True,
    )
