"""Frontal pictures of gates: bars, pipes, trusses, cloth, printed banners and lit frames.

Openings lie on whole pixels of the picture, so that their corners are exact.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from swift_sim_bridge.gate_detector.images.composites import paint, surfaces
from swift_sim_bridge.gate_detector.images.composites.panels import with_opacity

MIN_PX, MAX_PX = 24, 420  # side of an opening in the picture
MAX_PICTURE_PX = 900  # longer side of the whole picture

# smallest and largest width of a bar in sides of the opening
BARS = {
    "bars": (0.06, 0.28),
    "banner": (0.3, 1.0),
    "pipe": (0.03, 0.07),
    "truss": (0.09, 0.2),
    "cloth": (0.12, 0.35),
    "led": (0.05, 0.22),
    "checkered": (0.16, 0.34),
    "brackets": (0.04, 0.1),
}


@dataclass(frozen=True)
class Face:
    """The front of a gate.

    Attributes:
        picture: (h, w, 2), see `Panel`.
        size: (2,) m.
        openings: (k, 4, 2) m, inner corners TL, TR, BR, BL to the right of and below the picture's centre.
        tone: of its sides.
    """

    picture: np.ndarray
    size: tuple[float, float]
    openings: np.ndarray
    tone: float


@dataclass(frozen=True)
class Plan:
    """Where bars and openings lie in a picture.

    Attributes:
        shape: (h, w) px.
        openings: boxes (x0, y0, x1, y1) px, end exclusive.
        bars: boxes px of the straight pieces of the frame.
        scale: (2,) m a pixel, to the right and down.
    """

    shape: tuple[int, int]
    openings: list[tuple[int, int, int, int]]
    bars: list[tuple[int, int, int, int]]
    scale: tuple[float, float]


def plan(inner, margins, stacked: int, px: float) -> Plan:
    """Return the plan of a frame.

    Args:
        inner: (2,) m, width and height of an opening.
        margins: widths of the bars left, top, right, bottom in shorter sides of the opening.
        stacked: number of openings, one above the other.
        px: length of the longer side of an opening.
    """
    columns, rows = (max(int(round(px * side / max(inner))), 8) for side in inner)
    unit = min(columns, rows)
    left, top, right, bottom = (max(int(round(unit * margin)), 1) for margin in margins)
    width, bar = left + columns + right, max(int(round(unit * margins[1])), 1)
    height = top + bottom + stacked * rows + (stacked - 1) * bar
    starts = [top + k * (rows + bar) for k in range(stacked)]
    openings = [(left, y, left + columns, y + rows) for y in starts]
    bars = [(0, 0, left, height), (left + columns, 0, width, height), (0, 0, width, top)]
    bars += [(left, y + rows, left + columns, y + rows + bar) for y in starts[:-1]]
    bars += [(0, height - bottom, width, height)]
    return Plan((height, width), openings, bars, (inner[0] / columns, inner[1] / rows))


def face(family: str, inner, side_px: float, looks, paints, rng) -> Face:
    """Return the front of a gate of a family.

    Args:
        family: one of `looks.FAMILIES`.
        inner: (2,) m, width and height of an opening.
        side_px: length of its sides in the image.
        looks: `CompositeLooks`.
        paints: of the image.
        rng: generator.
    """
    margins = draw_margins(family, looks, rng)
    stacked = 2 if family != "banner" and rng.random() < looks.stacked_share else 1
    total = 1 + margins[1] + margins[3] + (stacked - 1) * (1 + margins[1])
    px = float(np.clip(1.6 * side_px, MIN_PX, min(MAX_PX, MAX_PICTURE_PX / total)))
    layout = plan(inner, margins, stacked, px)
    opacity = outline(family, layout, rng)
    canvas, tone = surfaces.painted(family, layout, paints, rng)
    if family == "led" or rng.random() < looks.lit_share:
        light(canvas, layout, rng)
    if rng.random() < 0.3:
        canvas, opacity = canvas[:, ::-1], opacity[:, ::-1]  # seen from behind
        layout = mirrored(layout)
    picture = with_opacity(np.ascontiguousarray(canvas), np.ascontiguousarray(opacity))
    return Face(picture, size(layout), corners(layout), tone)


def draw_margins(family: str, looks, rng) -> np.ndarray:
    """Return the widths (4,) of the bars left, top, right, bottom in shorter sides of the opening."""
    low, high = BARS[family]
    low, high = np.clip((low, high), *looks.bar)
    width = np.exp(rng.uniform(np.log(low), np.log(high)))
    margins = np.full(4, width)
    if family == "banner":
        margins = rng.uniform(low, high, 4)  # the hole is off-centre
    elif rng.random() < 0.3:
        margins[[1, 3]] *= rng.uniform(0.6, 1.8)
    elif rng.random() < 0.2:
        margins[rng.integers(4)] *= rng.uniform(1.2, 2.5)
    return margins


def size(layout: Plan) -> tuple[float, float]:
    """Return width and height of the picture, m."""
    return layout.shape[1] * layout.scale[0], layout.shape[0] * layout.scale[1]


def corners(layout: Plan) -> np.ndarray:
    """Return the inner corners (k, 4, 2) m to the right of and below the picture's centre."""
    middle = np.array([layout.shape[1], layout.shape[0]]) / 2
    boxes = [[(x0, y0), (x1, y0), (x1, y1), (x0, y1)] for x0, y0, x1, y1 in layout.openings]
    return (np.array(boxes, float) - middle) * layout.scale


def mirrored(layout: Plan) -> Plan:
    """Return the plan of the mirrored picture."""
    width = layout.shape[1]
    flip = [[(width - x1, y0, width - x0, y1) for x0, y0, x1, y1 in boxes] for boxes in (layout.openings, layout.bars)]
    return Plan(layout.shape, *flip, layout.scale)


def outline(family: str, layout: Plan, rng) -> np.ndarray:
    """Return the opacity (h, w) float32 of a frame."""
    height, width = layout.shape
    opacity = np.ones(layout.shape, np.float32)
    narrow = min(min(x1 - x0, y1 - y0) for x0, y0, x1, y1 in layout.bars)
    if family == "truss":
        opacity[:] = 0
        for bar in layout.bars:
            lattice(opacity, bar, rng)
    if family != "truss" and rng.random() < (0.7 if family in ("pipe", "banner") else 0.35):
        round_off(opacity, rng.uniform(0.1, 0.9) * min(narrow, 0.25 * width))
    if family == "cloth":
        sag(opacity, layout, rng)
    for x0, y0, x1, y1 in layout.openings:
        opacity[y0:y1, x0:x1] = 0
    if family == "cloth" and rng.random() < 0.6:
        hang(opacity, layout, rng)
    if family in ("brackets", "cloth", "pipe") and rng.random() < (0.9 if family == "brackets" else 0.2):
        gussets(opacity, layout, rng)
    return opacity


def light(canvas, layout: Plan, rng):
    """Draw lamps along the bars, or a strip of light around each opening."""
    brightness = float(rng.uniform(1.3, 6.0))
    if rng.random() < 0.4:
        for bar in layout.bars:
            paint.lamps(canvas, bar, brightness, rng)
        return
    narrow = min(min(x1 - x0, y1 - y0) for x0, y0, x1, y1 in layout.bars)
    thick = max(1, int(rng.uniform(0.15, 0.6) * narrow))
    for x0, y0, x1, y1 in layout.openings:
        cv2.rectangle(canvas, (x0 - thick, y0 - thick), (x1 + thick - 1, y1 + thick - 1), brightness, -1)


def round_off(opacity, radius: float):
    """Round the outer corners."""
    height, width = opacity.shape
    r = int(radius)
    if r < 2:
        return
    mask = np.zeros_like(opacity)
    cv2.rectangle(mask, (r, 0), (width - 1 - r, height - 1), 1.0, -1)
    cv2.rectangle(mask, (0, r), (width - 1, height - 1 - r), 1.0, -1)
    for x in (r, width - 1 - r):
        for y in (r, height - 1 - r):
            cv2.circle(mask, (x, y), r, 1.0, -1, cv2.LINE_AA)
    opacity *= mask


def lattice(opacity, bar, rng):
    """Draw a truss in a bar: two rails and diagonals between."""
    x0, y0, x1, y1 = bar
    long, wide = max(x1 - x0, y1 - y0), min(x1 - x0, y1 - y0)
    part = np.zeros((wide, long), np.float32)
    rail = max(1, int(wide * 0.16))
    part[:rail] = part[-rail:] = 1
    count = max(2, int(long / (wide * rng.uniform(0.8, 1.3))))
    xs = np.linspace(0, long, count + 1)
    for k in range(count):
        ends = (0, wide) if k % 2 else (wide, 0)
        cv2.line(part, (int(xs[k]), ends[0]), (int(xs[k + 1]), ends[1]), 1.0, max(1, int(wide * 0.1)))
        cv2.line(part, (int(xs[k]), 0), (int(xs[k]), wide), 1.0, max(1, int(wide * 0.07)))
    part = part if x1 - x0 > y1 - y0 else part.T
    box = opacity[y0:y1, x0:x1]
    np.maximum(box, part, out=box)


def _bow(length: int, depth: float):
    """Return the points (n, 2) of an arc of a depth below a straight edge of a length, px."""
    share = np.linspace(0, 1, 17)
    return np.stack([share * length, 4 * depth * share * (1 - share)], axis=-1)


def sag(opacity, layout: Plan, rng):
    """Cut arcs from the outer edges of stretched cloth."""
    height, width = layout.shape
    narrow = min(min(x1 - x0, y1 - y0) for x0, y0, x1, y1 in layout.bars)
    depth = rng.uniform(0.0, 0.3, 4) * narrow
    top, side = _bow(width, depth[0]), _bow(height, depth[1])
    cv2.fillPoly(opacity, [top.astype(np.int32)], 0.0)
    cv2.fillPoly(opacity, [((0, height) - _bow(width, depth[2]) * (-1, 1)).astype(np.int32)], 0.0)
    cv2.fillPoly(opacity, [side[:, ::-1].astype(np.int32)], 0.0)
    cv2.fillPoly(opacity, [((width, 0) - _bow(height, depth[3])[:, ::-1] * (1, -1)).astype(np.int32)], 0.0)


def hang(opacity, layout: Plan, rng):
    """Let the cloth of the upper bar sag into the opening between its corners."""
    for x0, y0, x1, _ in layout.openings:
        arc = _bow(x1 - x0, rng.uniform(0.0, 0.05) * (x1 - x0)) + (x0, y0)
        cv2.fillPoly(opacity, [arc.astype(np.int32)], 1.0)


def gussets(opacity, layout: Plan, rng):
    """Brace the inner corners by small triangles."""
    for x0, y0, x1, y1 in layout.openings:
        reach = int(rng.uniform(0.03, 0.09) * min(x1 - x0, y1 - y0))
        for x, y, right, down in ((x0, y0, 1, 1), (x1 - 1, y0, -1, 1), (x1 - 1, y1 - 1, -1, -1), (x0, y1 - 1, 1, -1)):
            triangle = [(x, y), (x + right * reach, y), (x, y + down * reach)]
            cv2.fillPoly(opacity, [np.array(triangle, np.int32)], 1.0)
