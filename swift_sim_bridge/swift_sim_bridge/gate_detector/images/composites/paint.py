"""Paint: tones of coloured paints, and patterns on pictures of brightnesses in 0..1."""

import functools

import cv2
import numpy as np

from swift_ros.camera.grey import grey_levels

NOISE_SIDE = 512  # px of the noise that all pictures are cut from
NOISE_PICTURES = 8
# linear red, green and blue of paints, cloths and materials of gates
COLOURS = {
    "white": (0.9, 0.9, 0.88),
    "black": (0.03, 0.03, 0.035),
    "orange": (0.95, 0.3, 0.03),
    "red": (0.7, 0.04, 0.04),
    "blue": (0.04, 0.12, 0.6),
    "sky blue": (0.25, 0.6, 0.85),
    "green": (0.08, 0.45, 0.12),
    "yellow": (0.9, 0.75, 0.06),
    "pink": (0.85, 0.15, 0.5),
    "violet": (0.3, 0.08, 0.5),
    "wood": (0.55, 0.38, 0.22),
    "aluminium": (0.55, 0.56, 0.58),
    "grey": (0.25, 0.25, 0.25),
}
GREY_CAMERAS = 0.4  # share of the images
MOST_CAST = 0.12  # of a colour camera's channels: error of its white balance
FONTS = (cv2.FONT_HERSHEY_SIMPLEX, cv2.FONT_HERSHEY_DUPLEX, cv2.FONT_HERSHEY_TRIPLEX, cv2.FONT_HERSHEY_SCRIPT_SIMPLEX)
LETTERS = np.array(list("ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789"))


@functools.lru_cache(maxsize=1)
def _noise_pictures() -> np.ndarray:
    """Return fractal noise (n, side, side) float32 in 0..1, the same in every process."""
    rng = np.random.default_rng(20_000_101)
    found = []
    for k in range(NOISE_PICTURES):
        fall = 0.45 + 0.45 * k / (NOISE_PICTURES - 1)  # from smooth clouds to grain
        total, side, weight = np.zeros((NOISE_SIDE, NOISE_SIDE), np.float32), 4, 1.0
        while side <= NOISE_SIDE:
            layer = rng.standard_normal((side, side)).astype(np.float32)
            total += weight * cv2.resize(layer, (NOISE_SIDE, NOISE_SIDE), interpolation=cv2.INTER_CUBIC)
            side, weight = side * 2, weight * fall
        low, high = np.percentile(total, (1, 99))
        found.append(np.clip((total - low) / (high - low), 0, 1))
    return np.stack(found)


def noise(shape, rng, zoom=(1.0, 4.0)) -> np.ndarray:
    """Return fractal noise (h, w) float32 in 0..1, drawn by `rng`.

    Args:
        shape: (h, w).
        rng: generator.
        zoom: range of the enlargement; small values are fine-grained.
    """
    source = _noise_pictures()[rng.integers(NOISE_PICTURES)]
    scale = rng.uniform(*zoom)
    height, width = (int(np.clip(side / scale, 4, NOISE_SIDE)) for side in shape)
    y, x = rng.integers(0, NOISE_SIDE - height + 1), rng.integers(0, NOISE_SIDE - width + 1)
    return cv2.resize(source[y : y + height, x : x + width], (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR)


class Paints:
    """The brightness of colours in the images of one grey camera, or in the grey levels of one colour camera.

    A grey camera weighs red, green and blue. A colour camera has a white balance, and its `grey_levels` are used.
    """

    def __init__(self, rng):
        self._weights = rng.dirichlet((1.2, 2.5, 1.0)) if rng.random() < GREY_CAMERAS else None  # of red, green, blue
        self._cast = rng.uniform(1.0 - MOST_CAST, 1.0 + MOST_CAST, 3)  # of blue, green, red
        self._rng = rng

    def tone(self, *names: str) -> float:
        """Return the brightness of a random paint, or of one of those named."""
        rng = self._rng
        if not names and rng.random() < 0.35:
            return float(rng.uniform(0.02, 0.95))
        chosen = names[rng.integers(len(names))] if names else rng.choice(list(COLOURS))
        faded = np.array(COLOURS[chosen]) * rng.uniform(0.75, 1.1) + rng.uniform(0.0, 0.06)
        if self._weights is not None:
            return float(np.clip(faded @ self._weights, 0.01, 1.0))
        levels = 255 * np.sqrt(np.clip(faded[::-1], 0.0, 1.0))
        return float(self.grey(levels.astype(np.uint8)[None, None])[0, 0])

    def other(self, tone: float, least: float = 0.25) -> float:
        """Return a brightness that differs from `tone`."""
        for _ in range(8):
            found = self.tone()
            if abs(found - tone) > least:
                return found
        return 0.9 if tone < 0.5 else 0.04

    def grey(self, picture) -> np.ndarray:
        """Return the brightness (h, w) float32 of a picture (h, w, 3 or more) uint8, blue first, without gamma."""
        picture = np.ascontiguousarray(picture[..., :3])
        if self._weights is None:
            mixed = grey_levels(cv2.transform(picture, np.diag(self._cast)))
        else:
            mixed = cv2.transform(picture, self._weights[None, ::-1].astype(np.float32))
        return (mixed.astype(np.float32) / 255) ** 2.0


def checker(shape, tones, squares, rng) -> np.ndarray:
    """Return a chessboard (h, w) of two tones, or with random fields, of `squares` (rows, columns)."""
    rows, columns = (max(int(count), 1) for count in squares)
    board = (np.add.outer(np.arange(rows), np.arange(columns)) % 2).astype(np.float32)
    if rng.random() < 0.25:
        board = (rng.random((rows, columns)) < 0.5).astype(np.float32)
    board = tones[0] + (tones[1] - tones[0]) * board
    return cv2.resize(board.astype(np.float32), (shape[1], shape[0]), interpolation=cv2.INTER_NEAREST)


def stripes(shape, tones, period_px: float, angle: float, rng) -> np.ndarray:
    """Return stripes (h, w) of two tones at an angle, rad, to the columns."""
    x, y = np.arange(shape[1], dtype=np.float32), np.arange(shape[0], dtype=np.float32)[:, None]
    phase = (x * np.cos(angle) + y * np.sin(angle)) / max(period_px, 2.0) + rng.random()
    dark = (phase - np.floor(phase)) < rng.uniform(0.3, 0.7)
    return np.where(dark, np.float32(tones[0]), np.float32(tones[1]))


def word(rng, letters: int) -> str:
    """Return random capital letters and digits."""
    return "".join(rng.choice(LETTERS, letters))


def letter(canvas, box, tone: float, rng, text: str | None = None):
    """Write a random word into a box (x0, y0, x1, y1) px of a canvas, turned where the box is upright."""
    x0, y0, x1, y1 = (int(v) for v in box)
    width, height = x1 - x0, y1 - y0
    if min(width, height) < 4:
        return
    upright = height > width
    length, tall = (height, width) if upright else (width, height)
    text = text or word(rng, int(np.clip(rng.uniform(0.5, 1.5) * length / tall, 1, 14)))
    font = FONTS[rng.integers(len(FONTS))]
    (wide, high), _ = cv2.getTextSize(text, font, 1.0, 2)
    scale = min(0.9 * length / wide, 0.75 * tall / high)
    strip = np.zeros((tall, length), np.uint8)
    origin = (int((length - scale * wide) / 2), int((tall + scale * high) / 2))
    cv2.putText(strip, text, origin, font, scale, 255, max(1, int(scale * rng.uniform(2, 5))), cv2.LINE_AA)
    if upright:
        strip = np.rot90(strip, rng.choice([1, 3]))
    blend(canvas, (x0, y0, x1, y1), tone, strip.astype(np.float32) / 255)


def blend(canvas, box, tone, opacity):
    """Paint a tone over a box (x0, y0, x1, y1) px of a canvas with an opacity; the box may exceed the canvas."""
    x0, y0, x1, y1 = (int(v) for v in box)
    height, width = canvas.shape
    left, top, right, bottom = max(x0, 0), max(y0, 0), min(x1, width), min(y1, height)
    if left >= right or top >= bottom:
        return
    part = canvas[top:bottom, left:right]
    part += opacity[top - y0 : bottom - y0, left - x0 : right - x0] * (np.float32(tone) - part)


def emblem(canvas, centre, radius: float, tones, rng):
    """Draw a disc, star, ring, cross or arrow as of a sponsor around a centre (x, y) px."""
    x, y = (int(v) for v in centre)
    size, kind = max(int(radius), 2), rng.integers(5)
    if kind == 0:
        cv2.circle(canvas, (x, y), size, tones[0], -1)
        cv2.circle(canvas, (x, y), int(0.6 * size), tones[1], -1)
    elif kind == 1:
        cv2.circle(canvas, (x, y), size, tones[0], max(1, size // 3))
    elif kind == 2:
        turn = np.arange(10) * np.pi / 5 + rng.uniform(0, 6)
        reach = np.where(np.arange(10) % 2, 0.45, 1.0) * size
        star = np.stack([x + reach * np.cos(turn), y + reach * np.sin(turn)], axis=-1)
        cv2.fillPoly(canvas, [star.astype(np.int32)], tones[0])
    elif kind == 3:
        cv2.rectangle(canvas, (x - size, y - size // 3), (x + size, y + size // 3), tones[0], -1)
        cv2.rectangle(canvas, (x - size // 3, y - size), (x + size // 3, y + size), tones[0], -1)
    else:
        arrow = np.array([(-1, -0.3), (0.2, -0.3), (0.2, -0.8), (1, 0), (0.2, 0.8), (0.2, 0.3), (-1, 0.3)])
        turned = arrow @ np.array([(0, 1), (-1, 0)]) if rng.random() < 0.5 else arrow * rng.choice([1, -1])
        cv2.fillPoly(canvas, [(turned * size + (x, y)).astype(np.int32)], tones[0])


def lamps(canvas, box, brightness: float, rng):
    """Draw a strip of light, or a row of lamps, along the longer side of a box (x0, y0, x1, y1) px."""
    x0, y0, x1, y1 = box
    if min(x1 - x0, y1 - y0) < 1:
        return
    along = np.array([x1 - x0, 0.0]) if x1 - x0 > y1 - y0 else np.array([0.0, y1 - y0])
    across = np.array([0.0, y1 - y0]) if x1 - x0 > y1 - y0 else np.array([x1 - x0, 0.0])
    start, breadth = np.array([x0, y0]) + across * rng.uniform(0.2, 0.8), np.abs(across).max()
    if rng.random() < 0.5:
        ends = [tuple(int(v) for v in start + share * along) for share in (0.0, 1.0)]
        cv2.line(canvas, *ends, brightness, max(1, int(breadth * rng.uniform(0.1, 0.4))))
        return
    count = int(np.clip(np.abs(along).max() / (breadth * rng.uniform(0.6, 2.0) + 2), 2, 40))
    for share in (np.arange(count) + 0.5) / count:
        middle = tuple(int(v) for v in start + share * along)
        cv2.circle(canvas, middle, max(1, int(breadth * 0.2)), brightness, -1)


def spotted(canvas, amount: float, rng):
    """Multiply a canvas by noise of a relative amplitude: dirt, wear, wrinkles and uneven light."""
    canvas *= 1.0 + amount * (noise(canvas.shape, rng) - 0.5)
