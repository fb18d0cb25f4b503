"""Procedural grey textures for gates, walls, floor and objects: each family is a function of a random generator.

The detector's training uses neither the `HELD_OUT` families nor the seeds of the evaluation, so that the evaluation
shows surfaces that the network has not been trained on.
"""

import cv2
import numpy as np

SIDE = 256  # texels


def _two_tones(rng):
    """Return two tones (0..1) that differ, in random order."""
    dark, light = np.sort(rng.uniform(0.0, 1.0, 2))
    if light - dark < 0.25:
        dark, light = max(0.0, dark - 0.2), min(1.0, light + 0.2)
    return (dark, light) if rng.random() < 0.5 else (light, dark)


def _grid():
    """Return x and y (SIDE, SIDE) of the texels, 0..1."""
    return np.meshgrid(np.arange(SIDE, dtype=np.float32) / SIDE, np.arange(SIDE, dtype=np.float32) / SIDE)


def fractal(rng):
    """Clouds: random grids of doubling resolution and falling strength."""
    image = np.zeros((SIDE, SIDE), np.float32)
    falloff = rng.uniform(0.4, 0.8)
    for octave in range(1, 8):
        grid = rng.standard_normal((2**octave, 2**octave)).astype(np.float32)
        image += falloff**octave * cv2.resize(grid, (SIDE, SIDE), interpolation=cv2.INTER_CUBIC)
    low, high = np.sort(rng.uniform(0, 1, 2))
    image = (image - image.min()) / np.ptp(image)
    return low + (high - low + 0.1) * image


def plain(rng):
    """One tone with a slight grain."""
    grain = rng.standard_normal((SIDE, SIDE)).astype(np.float32)
    return rng.uniform(0.03, 0.97) + rng.uniform(0.0, 0.05) * cv2.GaussianBlur(grain, (0, 0), 1.5) * 2


def checker(rng):
    """A checkerboard."""
    a, b = _two_tones(rng)
    count = rng.integers(2, 17, 2)
    x, y = _grid()
    return np.where((np.floor(x * count[0]) + np.floor(y * count[1])) % 2 > 0, a, b)


def stripes(rng):
    """Straight stripes of any direction."""
    a, b = _two_tones(rng)
    x, y = _grid()
    wave = (rng.integers(-8, 9) * x + rng.integers(1, 13) * y) % 1.0
    return np.where(wave < rng.uniform(0.2, 0.8), a, b)


def dots(rng):
    """Filled circles."""
    a, b = _two_tones(rng)
    image = np.full((SIDE, SIDE), a, np.float32)
    for _ in range(rng.integers(8, 80)):
        cv2.circle(image, rng.integers(0, SIDE, 2).tolist(), int(rng.integers(2, 24)), b + rng.normal(0, 0.1), -1)
    return image


def rectangles(rng):
    """Filled and hollow rectangles, which resemble gates most."""
    image = np.full((SIDE, SIDE), rng.uniform(0, 1), np.float32)
    for _ in range(rng.integers(4, 40)):
        corner, size = rng.integers(-20, SIDE, 2), rng.integers(6, 110, 2)
        thick = -1 if rng.random() < 0.6 else int(rng.integers(1, 10))
        cv2.rectangle(image, corner.tolist(), (corner + size).tolist(), rng.uniform(0, 1), thick)
    return image


def bricks(rng):
    """Brickwork with joints."""
    a, b = _two_tones(rng)
    rows, columns = rng.integers(4, 24), rng.integers(2, 12)
    x, y = _grid()
    row = np.floor(y * rows)
    shift = x * columns + 0.5 * (row % 2)
    joint = (y * rows % 1.0 < 0.12) | (shift % 1.0 < 0.06)
    tones = b + 0.1 * rng.standard_normal((rows, columns + 1))
    return np.where(joint, a, tones[row.astype(int), np.floor(shift).astype(int)])


def lettering(rng):
    """Random letters of several fonts and sizes."""
    a, b = _two_tones(rng)
    ink = np.zeros((SIDE, SIDE), np.uint8)
    for _ in range(rng.integers(3, 16)):
        text = "".join(chr(c) for c in rng.integers(65, 91, rng.integers(1, 8)))
        where = rng.integers(-20, SIDE, 2).tolist()
        cv2.putText(ink, text, where, int(rng.integers(0, 5)), rng.uniform(0.5, 3.0), 255, int(rng.integers(1, 8)))
    return a + (b - a) * ink.astype(np.float32) / 255


def panels(rng):
    """A regular grid of panels with frames, like windows."""
    a, b = _two_tones(rng)
    count = rng.integers(1, 7, 2)
    x, y = _grid()
    thick = rng.uniform(0.03, 0.25)
    frame = (x * count[0] % 1.0 < thick) | (y * count[1] % 1.0 < thick)
    tones = b + 0.15 * rng.standard_normal((count[1], count[0]))
    return np.where(frame, a, tones[np.floor(y * count[1]).astype(int), np.floor(x * count[0]).astype(int)])


def rings(rng):
    """Hollow circles."""
    a, b = _two_tones(rng)
    image = np.full((SIDE, SIDE), a, np.float32)
    for _ in range(rng.integers(4, 30)):
        centre, radius = rng.integers(0, SIDE, 2).tolist(), int(rng.integers(8, 60))
        cv2.circle(image, centre, radius, rng.uniform(0, 1), int(rng.integers(1, 10)))
    return np.clip(image * 0.8 + b * 0.2, 0, 1)


def polygons(rng):
    """Filled triangles to pentagons."""
    image = np.full((SIDE, SIDE), rng.uniform(0, 1), np.float32)
    for _ in range(rng.integers(8, 50)):
        points = rng.integers(0, SIDE, 2) + rng.integers(-50, 51, (rng.integers(3, 6), 2))
        cv2.fillPoly(image, [points.astype(np.int32)], rng.uniform(0, 1))
    return image


def waves(rng):
    """Curved waves."""
    a, b = _two_tones(rng)
    x, y = _grid()
    turns = 2 * np.pi * rng.integers(1, 10, 4)
    wave = np.sin(turns[0] * x + np.sin(turns[1] * y)) * np.sin(turns[2] * y + np.sin(turns[3] * x))
    return a + (b - a) * (0.5 + 0.5 * wave)


TRAINED = {f.__name__: f for f in (fractal, plain, checker, stripes, dots, rectangles, bricks, lettering, panels)}
HELD_OUT = {f.__name__: f for f in (rings, polygons, waves)}
FAMILIES = TRAINED | HELD_OUT


def draw(family: str, rng) -> np.ndarray:
    """Return one texture (SIDE, SIDE) uint8 of a family, with random clouds and rotation.

    Raises:
        KeyError: there is no such family.
    """
    image = np.asarray(FAMILIES[family](rng), np.float32)
    if rng.random() < 0.5:
        cloud = rng.standard_normal((8, 8)).astype(np.float32)
        image = image + rng.uniform(0, 0.15) * cv2.resize(cloud, (SIDE, SIDE), interpolation=cv2.INTER_CUBIC)
    if rng.random() < 0.3:
        image = np.rot90(image, rng.integers(0, 4))
    return (255 * np.clip(image, 0, 1)).astype(np.uint8)


def stack(families, count: int, rng) -> np.ndarray:
    """Return `count` textures (count, SIDE, SIDE) uint8, one of each family in turn."""
    names = list(families)
    return np.stack([draw(names[i % len(names)], rng) for i in range(count)])
