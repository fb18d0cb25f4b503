"""What stands around gates and before them: near-gates, poles, people, boards, racks and nets."""

from dataclasses import dataclass, field

import cv2
import numpy as np

from swift_sim_bridge.gate_detector.corner_states import VISIBLE
from swift_sim_bridge.gate_detector.images.composites import paint, surfaces
from swift_sim_bridge.gate_detector.images.composites.panels import Panel, opaque, upright_panel, with_opacity


@dataclass(frozen=True)
class Body:
    """Panels that are painted together.

    Attributes:
        distance: m, by which bodies are ordered.
        panels: from the farthest to the nearest.
        front: its frontal view: it casts the shadow, and posts carry it.
        openings: (k, 4, 3) m, inner corners in the world, of a gate.
        states: (k or 1, 4 or 1), of these corners behind parts of the gate itself.
    """

    distance: float
    panels: tuple[Panel, ...]
    front: Panel
    openings: np.ndarray = field(default_factory=lambda: np.zeros((0, 4, 3)))
    states: np.ndarray = field(default_factory=lambda: np.full((1, 1), VISIBLE))


def near_gate(paints, rng) -> np.ndarray:
    """Return the picture (h, w, 2) of what resembles a gate and is none."""
    side = 160
    tone = paints.tone()
    canvas = np.full((side, side), tone, np.float32)
    opacity = np.zeros((side, side), np.float32)
    bar, kind = int(rng.uniform(0.04, 0.2) * side), rng.integers(7)
    if kind < 2:  # a frame without a side
        cv2.rectangle(opacity, (0, 0), (side - 1, side - 1), 1.0, -1)
        hole = [bar, bar, side - bar, side - bar]
        for missing in rng.choice(4, 1 if kind == 0 else 2, replace=False):
            hole[missing] = 0 if missing < 2 else side
        opacity[hole[1] : hole[3], hole[0] : hole[2]] = 0
    elif kind == 2:
        cv2.circle(opacity, (side // 2, side // 2), side // 2 - 2 - bar // 2, 1.0, bar, cv2.LINE_AA)
    elif kind in (3, 4):  # triangle, pentagon or hexagon
        count = int(rng.choice([3, 5, 6]))
        turn = np.arange(count) * 2 * np.pi / count - np.pi / 2 + rng.uniform(-0.3, 0.3)
        reach = 0.5 * (side - bar) - 2
        points = side / 2 + reach * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
        cv2.polylines(opacity, [points.astype(np.int32)], True, 1.0, bar, cv2.LINE_AA)
    elif kind == 5:  # a closed panel with a painted square
        opacity[:] = 1
        low, high = int(side * rng.uniform(0.1, 0.3)), int(side * rng.uniform(0.7, 0.9))
        cv2.rectangle(canvas, (low, low), (high, high), paints.other(tone), -1)
        if rng.random() < 0.5:
            paint.emblem(canvas, (side / 2, side / 2), side / 5, (paints.tone(), paints.tone()), rng)
    else:  # a cross or an arch
        if rng.random() < 0.5:
            cv2.line(opacity, (0, 0), (side, side), 1.0, bar)
            cv2.line(opacity, (0, side), (side, 0), 1.0, bar)
        else:
            cv2.ellipse(opacity, (side // 2, side), (side // 2 - bar, side - bar), 0, 180, 360, 1.0, bar, cv2.LINE_AA)
    if rng.random() < 0.4:
        kind = rng.choice(surfaces.BAR_PATTERNS)
        surfaces.pattern(canvas, (0, 0, side, side), kind, (tone, paints.other(tone)), rng)
    paint.spotted(canvas, rng.uniform(0, 0.3), rng)
    return with_opacity(canvas, opacity)


def pole(paints, rng) -> tuple[tuple[float, float], np.ndarray]:
    """Return the size (m) and picture of a round pole."""
    light = 1 - rng.uniform(0.2, 0.8) * np.linspace(-1.2, 0.8, 12, dtype=np.float32) ** 2
    canvas = np.repeat(paints.tone() * light[None], 64, axis=0)
    if rng.random() < 0.3:
        canvas[:: int(rng.integers(4, 16))] *= 0.5
        canvas *= np.where(np.arange(64) % 16 < 8, 1.0, rng.uniform(0.2, 1.5)).astype(np.float32)[:, None]
    return (rng.uniform(0.03, 0.35), rng.uniform(1.5, 6.0)), opaque(canvas)


def person(paints, rng) -> tuple[tuple[float, float], np.ndarray]:
    """Return the size (m) and picture of a standing person."""
    canvas, opacity = np.zeros((180, 80), np.float32), np.zeros((180, 80), np.float32)
    shirt, trousers, skin = paints.tone(), paints.tone(), paints.tone("wood", "pink", "orange")
    lean = int(rng.integers(-6, 7))
    for centre, reach, tone in (
        ((40, 100), (15, 24), trousers),
        ((31 + lean, 140), (8, 40), trousers),
        ((49 - lean, 140), (8, 40), trousers),
        ((40, 66), (19, 32), shirt),
        ((20, 72 + lean), (6, 30), shirt),
        ((60, 72 - lean), (6, 30), shirt),
        ((40, 20), (11, 15), skin),
        ((40, 13), (12, 10), paints.tone("black", "wood", "grey")),
    ):
        for target, value in ((canvas, tone), (opacity, 1.0)):
            cv2.ellipse(target, centre, reach, 0, 0, 360, float(value), -1, cv2.LINE_AA)
    paint.spotted(canvas, 0.4, rng)
    return (0.8, 1.8), with_opacity(canvas, opacity)


def board(paints, rng) -> tuple[tuple[float, float], np.ndarray]:
    """Return the size (m) and picture of a board, box or screen."""
    tone = paints.tone()
    size = tuple(float(v) for v in rng.uniform(0.3, 2.0, 2))
    canvas = np.full((int(60 * size[1]) + 8, int(60 * size[0]) + 8), tone, np.float32)
    kind = rng.choice(surfaces.BAR_PATTERNS)
    surfaces.pattern(canvas, (0, 0, canvas.shape[1], canvas.shape[0]), kind, (tone, paints.other(tone)), rng)
    paint.spotted(canvas, 0.3, rng)
    return size, opaque(canvas)


def net(paints, rng) -> tuple[tuple[float, float], np.ndarray]:
    """Return the size (m) and picture of a net, through which corners stay visible."""
    opacity = np.zeros((240, 240), np.float32)
    opacity[:: int(rng.integers(4, 12))] = 1
    opacity[:, :: int(rng.integers(4, 12))] = 1
    return (4.0, 4.0), with_opacity(np.full_like(opacity, paints.tone()), rng.uniform(0.3, 0.9) * opacity)


def stand(paints, rng) -> tuple[tuple[float, float], np.ndarray]:
    """Return the size (m) and picture of a tripod, ladder, chair or table: thin bars at angles."""
    opacity = np.zeros((120, 100), np.float32)
    thick, kind = int(rng.integers(2, 7)), rng.integers(3)
    if kind == 0:
        for foot in (5, 50, 95):
            cv2.line(opacity, (50, 40), (foot, 119), 1.0, thick)
        cv2.line(opacity, (50, 0), (50, 60), 1.0, thick)
        cv2.rectangle(opacity, (38, 0), (62, 14), 1.0, -1)
    elif kind == 1:
        for x in (25, 75):
            cv2.line(opacity, (x, 0), (x, 119), 1.0, thick)
        for y in range(8, 119, int(rng.integers(10, 24))):
            cv2.line(opacity, (25, y), (75, y), 1.0, thick)
    else:
        cv2.rectangle(opacity, (2, 50), (97, 58), 1.0, -1)
        for x in (8, 90):
            cv2.line(opacity, (x, 58), (x, 119), 1.0, thick)
        if rng.random() < 0.5:
            cv2.rectangle(opacity, (2, 0), (12, 50), 1.0, -1)
    tall = float(rng.uniform(0.8, 2.5))
    return (tall * 0.83, tall), with_opacity(np.full_like(opacity, paints.tone()), opacity)


OBJECTS = (pole, pole, person, person, board, stand)


def clutter(count: int, room, aims, looks, paints, rng) -> list[Body]:
    """Return objects that are no gates.

    Args:
        count: number of objects.
        room: `scenes.Room`.
        aims: points (3,) m near the gates; some objects stand before them.
        looks: `CompositeLooks`.
        paints: of the image.
        rng: generator.
    """
    found = []
    for _ in range(count):
        before = len(aims) > 0 and rng.random() < looks.before_share
        resembling = rng.random() < looks.near_gate_share
        if resembling:
            side = float(rng.uniform(*looks.side) * rng.uniform(1.0, 1.4))
            size, picture = (side, side * float(rng.uniform(0.8, 1.25))), near_gate(paints, rng)
        elif before and rng.random() < 0.08:
            size, picture = net(paints, rng)
        else:
            size, picture = OBJECTS[rng.integers(len(OBJECTS))](paints, rng)
        aim = aims[rng.integers(len(aims))] if len(aims) else np.array([*rng.normal(0, 1, 2), 0.0])
        aim = aim if np.hypot(*aim[:2]) > 0.1 else np.array([1.0, 0.0, 0.0])
        azimuth = np.arctan2(aim[1], aim[0])
        if before and not resembling:
            away = np.hypot(*aim[:2]) * rng.uniform(0.25, 0.95)
            azimuth += rng.normal(0, 0.12)
        else:
            away, azimuth = room.radius * rng.uniform(0.25, 1.0), azimuth + rng.normal(0, 0.7)
        on_floor = rng.random() < 0.7
        height = room.floor + size[1] / 2 if on_floor else rng.uniform(room.floor, -room.floor + 1.0)
        if before and picture.shape == (240, 240, 2):
            height = aim[2]
        middle = np.array([away * np.cos(azimuth), away * np.sin(azimuth), height])
        turn = 0.0 if size[0] < 0.5 else rng.normal(0, 0.5)
        solid = picture.shape != (240, 240, 2)
        panel = upright_panel(middle, azimuth + turn, size, picture, solid=solid)
        found.append(Body(float(np.linalg.norm(middle)), (panel,), panel))
    return found
