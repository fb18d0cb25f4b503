"""Whether the numbers of a camera file describe a camera that a vehicle carries. No ROS."""

from collections.abc import Iterator

import numpy as np

from swift_ros.plausibility.finding import IMPOSSIBLE, ODD, Finding

MIN_COVERED = 0.5  # of the distance from the middle of the image to its corners
WELL_COVERED = 0.95
MAX_LATENCY_S, MAX_DISTANCE_M = 1.0, 1.0
MIN_VIEW_DEG, MAX_RATE_HZ, MAX_ASPECT = 30.0, 500.0, 1.5


def findings(camera) -> list[Finding]:
    """Return what is impossible or odd about a `swift_ros.camera.model.Camera`, the impossible first."""
    impossible = [Finding(IMPOSSIBLE, text) for check in _IMPOSSIBLE for text in check(camera)]
    return impossible + [Finding(ODD, text) for check in _ODD for text in check(camera)]


def _covered(camera) -> float:
    """Return which share of the distance to the farthest corner the lens images; 1 with an image circle."""
    if camera.image_circle_deg is not None:
        return 1.0
    corners = [(u, v) for u in (0.0, camera.width - 1.0) for v in (0.0, camera.height - 1.0)]
    farthest = max(np.hypot((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy) for u, v in corners)
    return float(camera.lens.radius(camera.half_angle, camera.distortion) / farthest)


def _lens(camera) -> Iterator[str]:
    if not (0 <= camera.cx <= camera.width - 1 and 0 <= camera.cy <= camera.height - 1):
        yield (
            f"the principal point ({camera.cx:g}, {camera.cy:g}) is outside of the image of {camera.width} x "
            f"{camera.height} px; give 'cx' and 'cy' in pixels of this image"
        )
    if camera.image_circle_deg is not None and not 1 <= camera.image_circle_deg < 360:
        yield f"'image_circle_deg' {camera.image_circle_deg:g} is no field of view; give the full angle in degrees"
        return
    slope = camera.lens.slope(np.linspace(0.0, camera.half_angle, 200), camera.distortion)
    if camera.image_circle_deg is not None and not np.all(slope > 0):
        yield "by 'distortion' two directions within the image circle have one pixel; calibrate the lens again"
    elif _covered(camera) < MIN_COVERED:
        yield (
            f"by 'distortion' the lens images nothing beyond {np.degrees(camera.half_angle):.0f} degrees, less than "
            "half of the way to the corners of the image; calibrate the lens again"
        )


def _times(camera) -> Iterator[str]:
    if not 0 <= camera.exposure_s <= 1.0 / camera.rate_hz:
        yield f"'exposure_s' {camera.exposure_s:g} s does not fit {camera.rate_hz:g} images a second; give s"
    if not 0 <= camera.processing_latency <= MAX_LATENCY_S:
        yield f"'processing_latency' {camera.processing_latency:g} s is not between 0 and {MAX_LATENCY_S:g} s; give s"


def _mount(camera) -> Iterator[str]:
    distance = float(np.linalg.norm(camera.position))
    if distance > MAX_DISTANCE_M:
        yield f"'position' is {distance:.3g} m from the middle of the vehicle; give m in the body frame"
    if abs(camera.pitch_deg) > 90:
        yield f"'pitch_deg' {camera.pitch_deg:g} is beyond the vertical; turn the camera by 'yaw_deg' and 'roll_deg'"


def _odd_lens(camera) -> Iterator[str]:
    view_deg = 2.0 * np.degrees(camera.half_angle)
    if view_deg < MIN_VIEW_DEG:
        yield f"the field of view is {view_deg:.0f} degrees: gates are rarely in sight; 'fx' and 'fy' are in pixels"
    aspect = max(camera.fx / camera.fy, camera.fy / camera.fx)
    if aspect > MAX_ASPECT:
        yield f"'fx' and 'fy' differ by a factor of {aspect:.1f}; pixels of sensors are nearly square"
    if MIN_COVERED <= _covered(camera) < WELL_COVERED:
        yield f"by 'distortion' the corners of the image show nothing: the lens ends at {view_deg / 2:.0f} degrees"


def _odd_mount(camera) -> Iterator[str]:
    if camera.rate_hz > MAX_RATE_HZ:
        yield f"'rate_hz' is {camera.rate_hz:g}; the stack processes some 30 images a second"
    away_deg = abs((camera.yaw_deg + 180.0) % 360.0 - 180.0)
    if away_deg > 60:
        yield f"the camera looks {away_deg:.0f} degrees to the side, where the pilot does not fly"
    if camera.pitch_deg < -20:
        yield f"the camera looks {-camera.pitch_deg:.0f} degrees downwards; at speed the vehicle leans forward too"


_IMPOSSIBLE = (_lens, _times, _mount)
_ODD = (_odd_lens, _odd_mount)
