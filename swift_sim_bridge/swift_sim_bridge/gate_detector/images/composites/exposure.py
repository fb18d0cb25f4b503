"""From the brightness of a scene to the published image: glare, motion, lens, sensor and compression."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from swift_ros.camera import model as lens

BLUR_POSES = 7  # largest number of poses averaged over the exposure
FULL = 255.0


@dataclass(frozen=True)
class Motion:
    """The motion of the image of a still scene.

    Attributes:
        flow: (H, W, 2) float32 px, during the time unit.
        exposure: share of the time unit, in which light is collected.
        readout: share of the time unit from the first to the last row; the middle row is at the time 0.
    """

    flow: np.ndarray
    exposure: float
    readout: float


def draw_motion(view, looks, rng) -> Motion | None:
    """Return a random rotation of the camera during the exposure, or None in a third of the cases."""
    if rng.random() < 0.34 or looks.motion_px == looks.rolling_px == 0.0:
        return None
    omega = rng.normal(0, 1, 3) * (1.0, 1.0, 0.7) / view.focal_px  # rad: about one px in the middle of the image
    x, y, z = cv2.split(view.rays[::8, ::8])
    moved = cv2.merge(
        [x + omega[1] * z - omega[2] * y, y + omega[2] * x - omega[0] * z, z + omega[0] * y - omega[1] * x]
    )
    pixels, _ = lens.project(view.camera, moved.astype(np.float64))
    still, _ = lens.project(view.camera, view.rays[::8, ::8].astype(np.float64))
    height, width = view.rays.shape[:2]
    small = (pixels - still).astype(np.float32)
    flow = cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR)
    exposure = abs(rng.normal(0, looks.motion_px))
    return Motion(flow, float(exposure), float(rng.normal(0, looks.rolling_px)) if rng.random() < 0.5 else 0.0)


def moved(image, motion: Motion):
    """Return the mean of an image (H, W) over the exposure, with the skew of the readout."""
    height, width = image.shape
    rows = (np.arange(height, dtype=np.float32) / (height - 1) - 0.5)[:, None, None] * np.float32(motion.readout)
    grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).astype(np.float32)
    longest = motion.exposure * float(np.median(np.linalg.norm(motion.flow[::16, ::16], axis=-1)))
    count = int(np.clip(np.ceil(longest), 1, BLUR_POSES))
    total = np.zeros_like(image)
    second: Any = None
    for k in range(count):
        time = rows + np.float32(motion.exposure * ((k + 0.5) / count - 0.5))
        total += cv2.remap(image, grid - time * motion.flow, second, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return total / count


def moved_points(points, motion: Motion):
    """Return where points (..., 2) px of the still image lie after the skew of the readout."""
    height, width = motion.flow.shape[:2]
    found = np.array(points, dtype=float)
    for _ in range(4):
        inside = np.clip(np.rint(found), 0, (width - 1, height - 1)).astype(int)
        time = (np.clip(found[..., 1:], 0, height - 1) / (height - 1) - 0.5) * motion.readout
        found = points + time * motion.flow[inside[..., 1], inside[..., 0]]
    return found


def glowing(image, rng):
    """Return a scene (H, W) with the glow of what is brighter than 1."""
    bright = np.maximum(image - 1.0, 0.0)
    if bright.max() < 0.2:
        return image
    small = cv2.resize(bright, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    near, far = (cv2.GaussianBlur(small, (0, 0), sigma) for sigma in (rng.uniform(0.6, 2.0), rng.uniform(4.0, 12.0)))
    glow = rng.uniform(0.1, 0.5) * near + rng.uniform(0.0, 0.3) * far
    return image + cv2.resize(glow, (image.shape[1], image.shape[0]), interpolation=cv2.INTER_LINEAR)


def flare(image, rng):
    """Add a sun or strong lamp with streaks and reflections to a scene (H, W)."""
    height, width = image.shape
    x, y = rng.uniform(-0.1, 1.1) * width, rng.uniform(-0.2, 0.7) * height
    across, along = np.arange(width, dtype=np.float32) - x, np.arange(height, dtype=np.float32)[:, None] - y
    squared = across * across + along * along
    reach = rng.uniform(0.05, 0.3) * width
    image += np.float32(rng.uniform(0.2, 1.5)) / (1 + squared / (reach * reach))
    image += np.float32(rng.uniform(0.0, 4.0)) * (squared < (0.1 * reach) ** 2)
    for share in rng.uniform(0.3, 1.9, rng.integers(0, 4)):
        centre = (int(x + share * (width / 2 - x)), int(y + share * (height / 2 - y)))
        ghost = np.zeros_like(image)
        cv2.circle(ghost, centre, int(rng.uniform(4, 40)), float(rng.uniform(0.02, 0.15)), -1, cv2.LINE_AA)
        image += ghost


def developed(image, view, looks, rng):
    """Return grey levels (H, W) float32 of a scene: defocus, vignetting, exposure, gamma and local contrast."""
    if rng.random() < 0.6:
        sigma = looks.defocus_px * rng.random() ** 2.5
        image = cv2.GaussianBlur(image, (0, 0), sigma) if sigma > 0.25 else image
    away = 1 - np.clip(view.rays[..., 2], 0, 1)
    image = image * (1 - np.float32(rng.uniform(*looks.vignetting)) * away / max(float(away.max()), 1e-3))
    levels = FULL * toned(image, looks, rng)
    if rng.random() < 0.12:  # local exposure
        levels = cv2.createCLAHE(float(rng.uniform(1, 4)), (4, 4)).apply(levels.astype(np.uint8)).astype(np.float32)
    return levels


def toned(image, looks, rng):
    """Return the values (H, W) in 0..1 of a scene by an exposure, with a black level and a curve of contrast."""
    few = image[::5, ::5]
    low, middle, high = np.percentile(few, (1, 50, 97))
    black = rng.uniform(0.0, 0.8) * low  # veiling light that the camera or its driver takes away
    wanted = rng.uniform(*looks.light) ** 2
    if rng.random() < 0.5:  # exposed for the middle
        gain = wanted / max(middle - black, 0.3 * (high - black), 1e-3)
    else:  # exposed for the bright parts
        gain = rng.uniform(0.5, 1.5) / max(high - black, 1e-3)
    image = np.clip((image - np.float32(black)) * np.float32(gain), 0, None)
    if rng.random() < 0.3:  # a shoulder instead of clipping
        image = 1 - np.exp(-1.3 * image)
    return np.minimum(image, 1.0) ** np.float32(0.5 * rng.uniform(*looks.gamma))


def recorded(levels, looks, rng):
    """Return the published image (H, W) uint8 of grey levels: resolution, sharpening, noise and compression.

    Args:
        levels: (H, W) float32.
        looks: `CompositeLooks`.
        rng: generator.

    Returns:
        The image, and the standard deviation of its noise, grey levels.
    """
    height, width = levels.shape
    if rng.random() < looks.reduced_share:
        share = rng.uniform(0.4, 0.9)
        small = cv2.resize(levels, (round(share * width), round(share * height)), interpolation=cv2.INTER_AREA)
        levels = cv2.resize(small, (width, height), interpolation=rng.choice([cv2.INTER_LINEAR, cv2.INTER_CUBIC]))
    if rng.random() < looks.sharpened_share:
        soft = cv2.GaussianBlur(levels, (0, 0), rng.uniform(0.7, 2.0))
        levels = levels + rng.uniform(0.3, 1.5) * (levels - soft)
    sigma = float(rng.uniform(*looks.noise)) * rng.random()
    shot = rng.random()
    grain = rng.standard_normal((height, width), dtype=np.float32)
    if rng.random() < 0.3:  # noise that a camera has smoothed or a demosaicing has spread
        grain = 1.6 * cv2.GaussianBlur(grain, (0, 0), 0.7)
    strength = sigma * ((1 - shot) + shot * np.sqrt(np.clip(levels, 0, FULL) / 128))
    levels = levels + strength * grain
    if rng.random() < 0.15:  # fixed pattern of rows and columns
        levels = levels + sigma * 0.3 * (rng.standard_normal((height, 1)) + rng.standard_normal((1, width)))
    image = np.clip(np.rint(levels), 0, FULL).astype(np.uint8)
    if rng.random() < looks.jpeg_share:
        quality = int(rng.integers(looks.jpeg_quality[0], looks.jpeg_quality[1] + 1))
        _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
        image = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)
    return image, sigma
