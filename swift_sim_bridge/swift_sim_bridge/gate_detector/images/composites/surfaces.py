"""The surfaces of frames: paint, patterns, prints, folds and round pipes."""

import cv2
import numpy as np

from swift_sim_bridge.gate_detector.images.composites import paint

BRIGHTEST = 1.15  # of a surface; what is brighter shines, see `panels.SHINING`
BAR_PATTERNS = ("plain", "plain", "split", "stripes", "checker", "lettering", "emblems", "tape", "ends")


def painted(family: str, layout, paints, rng) -> tuple[np.ndarray, float]:
    """Return the brightnesses (h, w) of a frame and the tone of its sides.

    Args:
        family: of `looks.FAMILIES`.
        layout: `frames.Plan`.
        paints: of the image.
        rng: generator.
    """
    tone = base_tone(family, paints)
    canvas = np.full(layout.shape, tone, np.float32)
    if family == "banner":
        print_banner(canvas, layout, tone, paints, rng)
    elif family == "checkered":
        checkered(canvas, layout, paints, rng)
    elif family in ("bars", "cloth", "led", "pipe"):
        pattern_bars(canvas, layout, tone, paints, rng)
    if family == "cloth":
        fold(canvas, rng)
    if family == "pipe" or (family in ("bars", "truss", "brackets") and rng.random() < 0.25):
        round_bars(canvas, layout, rng)
    if rng.random() < 0.25:
        border(canvas, layout, paints.other(tone), rng)
    paint.spotted(canvas, rng.uniform(0.0, 0.35), rng)
    if rng.random() < 0.4:
        canvas *= uneven(canvas.shape, rng)
    return np.minimum(canvas, BRIGHTEST), tone


def uneven(shape, rng) -> np.ndarray:
    """Return light (h, 1) or (1, w) that rises or falls from one side of a frame to the other."""
    along = rng.integers(2)
    slope = np.linspace(*rng.uniform(0.55, 1.25, 2), shape[along], dtype=np.float32)
    return slope if along else slope[:, None]


def base_tone(family: str, paints) -> float:
    """Return the tone that most of a frame has."""
    if family == "led":
        return paints.tone("black", "grey", "blue", "white")
    if family == "truss":
        return paints.tone("aluminium", "black", "grey", "white")
    if family == "cloth":
        return paints.tone("orange", "blue", "white", "red", "yellow", "green", "pink", "sky blue", "black")
    return paints.tone()


def pattern_bars(canvas, layout, tone, paints, rng):
    """Paint the bars, each in its way or all in the same."""
    same = rng.random() < 0.6
    kind, second = rng.choice(BAR_PATTERNS), paints.other(tone)
    for bar in layout.bars:
        if not same:
            kind, second = rng.choice(BAR_PATTERNS), paints.other(tone, 0.1)
        pattern(canvas, bar, kind, (tone, second), rng)


def pattern(canvas, bar, kind: str, tones, rng):
    """Paint a bar (x0, y0, x1, y1) px in one of BAR_PATTERNS with two tones."""
    x0, y0, x1, y1 = bar
    part = canvas[y0:y1, x0:x1]
    height, width = part.shape
    if min(height, width) < 1:
        return
    wide, long = min(height, width), max(height, width)
    across = width > height
    if kind == "split":
        cut = int(rng.uniform(0.25, 0.75) * long)

        if across:
            part[:, :cut] = tones[1]
        else:
            part[:cut] = tones[1]
    elif kind == "stripes":
        angle = rng.choice([0.0, 0.79, -0.79, 0.5]) + (0.0 if across else np.pi / 2)
        part[:] = paint.stripes(part.shape, tones, wide * rng.uniform(0.6, 4.0), angle, rng)
    elif kind == "checker":
        rows = rng.integers(2, 5)
        count = max(2, int(rows * long / wide))
        part[:] = paint.checker(part.shape, tones, (rows, count) if across else (count, rows), rng)
    elif kind == "lettering":
        for low, high in runs(long, wide, rng):
            box = (x0 + low, y0, x0 + high, y1) if across else (x0, y0 + low, x1, y0 + high)
            paint.letter(canvas, box, tones[1], rng)
    elif kind == "emblems":
        for low, high in runs(long, wide, rng):
            middle = (x0 + (low + high) / 2, y0 + wide / 2) if across else (x0 + wide / 2, y0 + (low + high) / 2)
            paint.emblem(canvas, middle, 0.4 * wide, tones[::-1], rng)
    elif kind == "tape":
        for at in rng.uniform(0, long, rng.integers(1, 5)):
            wide_px = max(1, int(rng.uniform(0.1, 0.6) * wide))
            if across:
                part[:, int(at) : int(at) + wide_px] = tones[1]
            else:
                part[int(at) : int(at) + wide_px] = tones[1]
    elif kind == "ends":
        reach = int(rng.uniform(0.08, 0.3) * long)
        for end in (slice(0, reach), slice(long - reach, long)):
            if across:
                part[:, end] = tones[1]
            else:
                part[end] = tones[1]


def runs(long: int, wide: int, rng) -> list[tuple[float, float]]:
    """Return the places (start, end) px of lettering or emblems along a bar."""
    count = int(np.clip(long / (wide * rng.uniform(2.0, 8.0)), 1, 6))
    ends = np.linspace(0.05 * long, 0.95 * long, count + 1)
    return list(zip(ends[:-1], ends[1:], strict=True))


def checkered(canvas, layout, paints, rng):
    """Paint bars with chessboards at their ends and lettering between, as of AlphaPilot's gates."""
    dark, bright = paints.tone("black", "blue", "grey"), paints.tone("white", "yellow", "sky blue")
    canvas[:] = dark if rng.random() < 0.8 else bright
    upright = paints.tone("blue", "black", "red", "violet", "green") if rng.random() < 0.6 else dark
    for x0, y0, x1, y1 in layout.bars:
        across, wide = x1 - x0 > y1 - y0, min(x1 - x0, y1 - y0)
        if across or rng.random() < 0.5:
            reach = int(wide * rng.uniform(0.8, 2.2))
            for place in ((0, reach), ((x1 - x0 if across else y1 - y0) - reach, x1 - x0 if across else y1 - y0)):
                box = (x0 + place[0], y0, x0 + place[1], y1) if across else (x0, y0 + place[0], x1, y0 + place[1])
                rows = rng.integers(2, 5)
                squares = (rows, max(2, int(rows * reach / max(wide, 1))))
                pattern_box(canvas, box, paint.checker, (dark, bright), squares if across else squares[::-1], rng)
            paint.letter(canvas, middle_of((x0, y0, x1, y1), reach), bright, rng)
        else:
            canvas[y0 + wide : y1 - wide, x0:x1] = upright
            pattern(canvas, (x0, y0 + wide, x1, y1 - wide), rng.choice(["plain", "emblems"]), (upright, bright), rng)


def middle_of(bar, reach: int):
    """Return the box of a bar without its ends."""
    x0, y0, x1, y1 = bar
    return (x0 + reach, y0, x1 - reach, y1) if x1 - x0 > y1 - y0 else (x0, y0 + reach, x1, y1 - reach)


def pattern_box(canvas, box, draw, tones, squares, rng):
    """Fill a box (x0, y0, x1, y1) px of a canvas by a pattern of squares."""
    x0, y0, x1, y1 = (max(int(v), 0) for v in box)
    part = canvas[y0:y1, x0:x1]
    if part.size:
        part[:] = draw(part.shape, tones, squares, rng)


def print_banner(canvas, layout, tone, paints, rng):
    """Print a large panel: bands, chessboards, lettering, emblems and pictures."""
    height, width = canvas.shape
    kind = rng.integers(5)
    second = paints.other(tone)
    if kind == 0:
        rows = rng.integers(5, 14)
        canvas[:] = paint.checker(canvas.shape, (tone, second), (rows, rows * width / height), rng)
    elif kind == 1:
        angle = rng.uniform(0, np.pi)
        canvas[:] = paint.stripes(canvas.shape, (tone, second), width * rng.uniform(0.08, 0.5), angle, rng)
    elif kind == 2:
        canvas[:] = tone + (second - tone) * paint.noise(canvas.shape, rng, (0.8, 3.0))
    for _ in range(rng.integers(0, 9)):
        x, y = rng.uniform(0, width), rng.uniform(0, height)
        reach = rng.uniform(0.05, 0.2) * width
        if rng.random() < 0.5:
            paint.emblem(canvas, (x, y), reach, (paints.tone(), paints.tone()), rng)
        else:
            paint.letter(canvas, (x, y, x + 3 * reach, y + reach), paints.tone(), rng)


def fold(canvas, rng):
    """Shade folds and wrinkles of cloth."""
    waves = np.sin(np.linspace(0, rng.uniform(10, 60), canvas.shape[1]) + rng.uniform(0, 6)).astype(np.float32)
    soft = paint.noise(canvas.shape, rng, (2.0, 6.0)) - 0.5
    canvas *= 1 + rng.uniform(0.0, 0.2) * waves * (0.5 + soft) + rng.uniform(0.1, 0.5) * soft


def round_bars(canvas, layout, rng):
    """Shade bars as round pipes: bright along a line, dark at the edges."""
    shift, depth = rng.uniform(-0.5, 0.5), rng.uniform(0.3, 0.8)
    for x0, y0, x1, y1 in layout.bars:
        across = x1 - x0 > y1 - y0
        share = np.linspace(-1, 1, min(x1 - x0, y1 - y0), dtype=np.float32)
        light = 1 - depth * np.clip(np.abs(share - shift), 0, 1.3) ** 2
        canvas[y0:y1, x0:x1] *= light[:, None] if across else light


def border(canvas, layout, tone, rng):
    """Draw a thin line around openings or along the outer edge."""
    height, width = canvas.shape
    thick = max(1, int(rng.uniform(0.01, 0.04) * min(height, width)))
    if rng.random() < 0.6:
        for x0, y0, x1, y1 in layout.openings:
            cv2.rectangle(canvas, (x0 - thick, y0 - thick), (x1 + thick - 1, y1 + thick - 1), tone, -1)
    else:
        cv2.rectangle(canvas, (0, 0), (width - 1, height - 1), tone, thick)
