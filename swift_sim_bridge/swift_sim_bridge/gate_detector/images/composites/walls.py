"""Pictures of walls, floors, ceilings, grounds and trees, full of corners that are no gates."""

import cv2
import numpy as np

from swift_sim_bridge.gate_detector.images.composites import paint
from swift_sim_bridge.gate_detector.images.composites.panels import with_opacity

WALL_PX_PER_M = 22
MAX_WALL_PX = (900, 400)  # width, height


def floor(shape, paints, rng) -> np.ndarray:
    """Return a tile (h, w) of an indoor floor: slabs, boards, chessboard, carpet, mats or lines of a court."""
    height, width = shape
    tone, kind = paints.tone(), rng.integers(6)
    canvas = np.full(shape, tone, np.float32)
    if kind in (0, 1):
        count = int(rng.integers(2, 9))
        fields = tone * rng.uniform(0.85, 1.1, (count, count)).astype(np.float32)
        canvas = cv2.resize(fields, (width, height), interpolation=cv2.INTER_NEAREST)
        _grid(canvas, count, count, paints.other(tone, 0.1), rng)
    elif kind == 2:
        rows = int(rng.integers(8, 20))
        boards = tone * rng.uniform(0.7, 1.15, (rows, 3)).astype(np.float32)
        canvas = cv2.resize(boards, (width, height), interpolation=cv2.INTER_NEAREST)
        _grid(canvas, 1, rows, 0.5 * tone, rng)
    elif kind == 3:
        count = int(rng.choice([2, 4, 8]))
        canvas = paint.checker(shape, (tone, paints.other(tone, 0.1)), (count, count), rng)
    elif kind == 4:
        for _ in range(rng.integers(1, 6)):
            ends = rng.integers(0, width, 4)
            cv2.line(canvas, (int(ends[0]), 0), (int(ends[0]), height), paints.other(tone), int(rng.integers(1, 8)))
            cv2.line(canvas, (0, int(ends[1])), (width, int(ends[1])), paints.other(tone), int(rng.integers(1, 8)))
    paint.spotted(canvas, rng.uniform(0.1, 0.7), rng)
    return np.clip(canvas, 0, 1.2)


def _grid(canvas, columns: int, rows: int, tone: float, rng):
    height, width = canvas.shape
    thick = max(1, int(rng.uniform(0.005, 0.015) * width))
    for k in range(columns):
        cv2.line(canvas, (k * width // columns, 0), (k * width // columns, height), tone, thick)
    for k in range(rows):
        cv2.line(canvas, (0, k * height // rows), (width, k * height // rows), tone, thick)


def outdoor_ground(shape, paints, rng) -> np.ndarray:
    """Return a tile (h, w) of grass, sand, gravel, asphalt or snow."""
    tone = rng.choice([paints.tone("green"), paints.tone("wood"), paints.tone("grey"), rng.uniform(0.2, 0.9)])
    coarse, fine = paint.noise(shape, rng, (0.6, 2.0)), rng.random(shape, dtype=np.float32)
    canvas = tone * (1 + rng.uniform(0.2, 1.2) * (coarse - 0.5) + rng.uniform(0.0, 0.8) * (fine - 0.5))
    return np.clip(canvas, 0.01, 1.2).astype(np.float32)


def ceiling(shape, paints, rng) -> np.ndarray:
    """Return a tile (h, w) of a ceiling with beams, lamps and panels."""
    tone = paints.tone("white", "grey", "black", "aluminium", "wood")
    canvas = np.full(shape, tone, np.float32)
    kind = rng.random()
    if kind < 0.5:
        count = int(rng.integers(2, 6))
        _grid(canvas, count, count, paints.other(tone, 0.1), rng)
    elif kind < 0.8:
        paint_truss_lines(canvas, paints.other(tone, 0.2), rng)
    for _ in range(rng.integers(0, 4)):
        x, y = (int(v) for v in rng.integers(0, shape[0], 2))
        wide, tall = (int(v) for v in rng.integers(4, 60, 2))
        cv2.rectangle(canvas, (x, y), (x + wide, y + tall), float(rng.uniform(0.8, 3.0)), -1)
    paint.spotted(canvas, rng.uniform(0.0, 0.3), rng)
    return canvas


def paint_truss_lines(canvas, tone: float, rng):
    """Draw beams with diagonals over a canvas."""
    height, width = canvas.shape
    for _ in range(rng.integers(1, 4)):
        y, deep = int(rng.integers(0, height)), int(rng.integers(10, 40))
        for offset in (0, deep):
            cv2.line(canvas, (0, y + offset), (width, y + offset), tone, int(rng.integers(1, 5)))
        for x in range(0, width, deep):
            cv2.line(canvas, (x, y), (x + deep // 2, y + deep), tone, 2)
            cv2.line(canvas, (x + deep // 2, y + deep), (x + deep, y), tone, 2)


def wall(width: float, height: float, tone: float, paints, rng) -> np.ndarray:
    """Return a wall (h, w) of a size in m: bricks or boards, windows, doors, posters, racks, lamps and lettering."""
    scale = min(WALL_PX_PER_M, MAX_WALL_PX[0] / width, MAX_WALL_PX[1] / height)
    shape = max(int(scale * height), 16), max(int(scale * width), 16)
    canvas = np.full(shape, tone, np.float32)
    kind = rng.integers(6)
    if kind == 0:
        _bricks(canvas, scale * rng.uniform(0.15, 0.6), tone, paints.other(tone, 0.05), rng)
    elif kind == 1:
        period = scale * rng.uniform(0.2, 2.0)
        canvas[:] = paint.stripes(shape, (tone, tone * rng.uniform(0.6, 0.95)), period, 0.0, rng)
    elif kind == 2:
        canvas[int(shape[0] * rng.uniform(0.4, 0.9)) :] = paints.tone()
    elif kind == 3:
        period = max(int(scale * rng.uniform(0.3, 1.0)), 3)
        canvas[::period] = canvas[:, ::period] = paints.other(tone, 0.1)
    paint.spotted(canvas, rng.uniform(0.05, 0.4), rng)
    if rng.random() < 0.6:
        _windows(canvas, scale, paints, rng)
    for _ in range(rng.integers(0, 12)):
        FITTINGS[rng.integers(len(FITTINGS))](canvas, scale, paints, rng)
    canvas *= np.linspace(*rng.uniform(0.6, 1.2, 2), shape[0], dtype=np.float32)[:, None]
    return canvas


def _bricks(canvas, tall_px: float, tone, joint, rng):
    height, width = canvas.shape
    tall = max(int(tall_px), 3)
    for row, y in enumerate(range(0, height, tall)):
        cv2.line(canvas, (0, y), (width, y), joint, 1)
        for x in range((row % 2) * tall, width, 2 * tall):
            cv2.line(canvas, (x, y), (x, y + tall), joint, 1)


def _windows(canvas, scale, paints, rng):
    """Draw a row or grid of bright or dark windows with crossbars."""
    height, width = canvas.shape
    wide, tall = (max(int(v), 4) for v in scale * rng.uniform(0.6, 3.0, 2))
    glass = float(rng.choice([rng.uniform(1.0, 3.0), rng.uniform(0.02, 0.3), rng.uniform(0.5, 1.2)]))
    frame, thick = paints.tone(), max(1, int(scale * rng.uniform(0.03, 0.2)))
    gap_x, gap_y = int(wide * rng.uniform(1.1, 2.5)), int(tall * rng.uniform(1.15, 2.0))
    top, rows = int(rng.uniform(0, 0.6) * height), int(rng.integers(1, 4))
    panes = int(rng.integers(1, 4))
    for row in range(rows):
        for x in range(int(rng.integers(0, gap_x)), width, gap_x):
            y = top + row * gap_y
            cv2.rectangle(canvas, (x, y), (x + wide, y + tall), glass * float(rng.uniform(0.7, 1.1)), -1)
            cv2.rectangle(canvas, (x, y), (x + wide, y + tall), frame, thick)
            for k in range(1, panes):
                cv2.line(canvas, (x + k * wide // panes, y), (x + k * wide // panes, y + tall), frame, thick)
            if panes > 1:
                cv2.line(canvas, (x, y + tall // 2), (x + wide, y + tall // 2), frame, thick)


def _door(canvas, scale, paints, rng):
    height, width = canvas.shape
    wide, tall = int(scale * rng.uniform(0.8, 3.0)), int(scale * rng.uniform(2.0, 3.5))
    x = int(rng.integers(0, width))
    cv2.rectangle(canvas, (x, height - tall), (x + wide, height), paints.tone(), -1)
    cv2.rectangle(canvas, (x, height - tall), (x + wide, height), paints.tone(), max(1, int(scale * 0.08)))


def _poster(canvas, scale, paints, rng):
    height, width = canvas.shape
    wide, tall = (max(int(v), 4) for v in scale * rng.uniform(0.5, 3.0, 2))
    x, y = int(rng.integers(0, width)), int(rng.integers(0, height))
    tone = paints.tone()
    cv2.rectangle(canvas, (x, y), (x + wide, y + tall), tone, -1)
    if rng.random() < 0.4:
        cv2.rectangle(canvas, (x, y), (x + wide, y + tall), paints.other(tone), max(1, wide // 20))
    for k in range(rng.integers(0, 4)):
        paint.letter(canvas, (x, y + k * tall // 4, x + wide, y + (k + 1) * tall // 4), paints.other(tone), rng)
    if rng.random() < 0.4:
        paint.emblem(canvas, (x + wide / 2, y + tall / 2), 0.3 * min(wide, tall), (paints.tone(), paints.tone()), rng)


def _lamp(canvas, scale, paints, rng):
    height, width = canvas.shape
    x, y = int(rng.integers(0, width)), int(rng.uniform(0, 0.5) * height)
    bright = float(rng.uniform(1.0, 5.0))
    if rng.random() < 0.5:
        cv2.circle(canvas, (x, y), max(1, int(scale * rng.uniform(0.05, 0.3))), bright, -1)
    else:
        end = (x + int(scale * rng.uniform(0.5, 2.0)), y + max(1, int(scale * 0.1)))
        cv2.rectangle(canvas, (x, y), end, bright, -1)


def _rack(canvas, scale, paints, rng):
    """Draw a rack with shelves and boxes, or wall bars of a gymnasium."""
    height, width = canvas.shape
    wide, tall = (max(int(v), 8) for v in scale * rng.uniform(1.0, 4.0, 2))
    x, top = int(rng.integers(0, width)), height - tall
    tone, thick = paints.tone(), max(1, int(scale * 0.06))
    shelves = int(rng.integers(2, 12))
    for k in range(shelves):
        y = top + k * tall // shelves
        for _ in range(rng.integers(0, 4)):
            left = x + int(rng.integers(0, wide))
            cv2.rectangle(canvas, (left, y), (left + wide // 5, y + tall // shelves), paints.tone(), -1)
        cv2.line(canvas, (x, y), (x + wide, y), tone, thick)
    cv2.rectangle(canvas, (x, top), (x + wide, height), tone, thick)


def _sign(canvas, scale, paints, rng):
    height, width = canvas.shape
    x, y = int(rng.integers(0, width)), int(rng.integers(0, height))
    wide = scale * rng.uniform(1.0, 6.0)
    paint.letter(canvas, (x, y, x + wide, y + scale * rng.uniform(0.3, 1.2)), paints.tone(), rng)


FITTINGS = (_door, _poster, _poster, _lamp, _rack, _sign)


def tree(rng) -> tuple[tuple[float, float], np.ndarray]:
    """Return the size (m) and picture of a tree with a trunk, or of a bush."""
    tall, height, width = rng.uniform(2.0, 12.0), 160, int(160 * rng.uniform(0.5, 1.3))
    x, y = np.linspace(-1, 1, width, dtype=np.float32), np.linspace(-1, 1, height, dtype=np.float32)[:, None]
    leaves = paint.noise((height, width), rng, (0.5, 1.2)) + 0.35 * rng.random((height, width), dtype=np.float32)
    middle = rng.choice([-0.25, 0.25])  # the crown of a tree, or a bush
    crown = x**2 + ((y - middle) / 0.75) ** 2 < 1.1 * leaves
    trunk = (np.abs(x - 0.05 * np.sin(4 * y)) < 0.05) & (y > 0)
    light = 0.5 + 0.5 * np.clip(-0.7 * x - 0.7 * y, -0.8, 0.8)
    tone = rng.uniform(0.03, 0.3) * light * (0.2 + 1.6 * leaves)
    return (tall * width / height, tall), with_opacity(np.where(trunk & ~crown, 0.08, tone), crown | trunk)


def ridge(shape, tone: float, rng) -> np.ndarray:
    """Return the picture of hills or of the edge of a forest."""
    height, width = shape
    line = paint.noise((4, width), rng, (0.3, 3.0))[0]
    below = np.linspace(0, 1, height, dtype=np.float32)[:, None] > 0.7 * line
    return with_opacity(tone * (0.6 + 0.8 * paint.noise(shape, rng, (0.5, 2.0))), below)
