"""Whether the numbers of a camera file describe a camera that a vehicle carries. No ROS."""

import dataclasses
from collections.abc import Iterator

import numpy as np

from swift_ros.plausibility.finding import Finding, first_findings

MIN_COVERED = 0.5  # of the distance from the middle of the image to its corners
WELL_COVERED = 0.95
MAX_CIRCLE, MIN_CIRCLE = 1.05, 0.25  # radius of the image circle over the distance of a corner, and of half a side
MAX_BEYOND = 0.25  # share of the image circle's diameter that lies outside of the image
LEAST_CIRCLE_DEG = 10.0  # of a lens whose image circle is within the image
MAX_TANGENTIAL, HIGH_TANGENTIAL = 0.03, 0.01  # p1 and p2 of a pinhole lens; calibrations find 0.005 at most
MAX_PINHOLE_DEG = 165.0
MAX_LATENCY_S, LONG_LATENCY_S, MAX_DISTANCE_M = 1.0, 0.3, 1.0
VIEW_DEG, LOW_VIEW_DEG = 5.0, 30.0
RATES_HZ, COMMON_RATES_HZ = (2.0, 2000.0), (10.0, 500.0)
MAX_ASPECT, WRONG_ASPECT, HIGH_ASPECT = 2.5, 1.5, 1.1  # above the second, a wrong image circle is blamed on it
SIDES_PX = (32, 10_000)
MAX_CROPPED = 1.5  # between width and height over those of a calibration; an image cropped from 4:3 to 16:9 has 1.33
MAX_OFF_CENTRE = 0.15  # of the principal point, as a share of the side
MAX_PITCH_DEG, HIGH_PITCH_DEG, LOW_PITCH_DEG = 75.0, 60.0, -35.0  # racers tilt their cameras by 20 to 55 degrees
MAX_AWAY_DEG, LARGE_AWAY_DEG = 120.0, 60.0  # of the heading of the optical axis
LONG_EXPOSURE_S = 0.02


def findings(camera) -> list[Finding]:
    """Return what is impossible about a `swift_ros.camera.model.Camera`, or else what is odd."""
    return first_findings(camera, ((_sizes,), (_coefficients,), (_lens, _times, _mount)), (_odd_lens, _odd_mount))


def _corner_px(camera) -> float:
    """Return the distance of the farthest corner of the image from the principal point, px."""
    corners = [(u, v) for u in (-0.5, camera.width - 0.5) for v in (-0.5, camera.height - 0.5)]
    return float(max(np.hypot(u - camera.cx, v - camera.cy) for u, v in corners))


def _covered(camera) -> float:
    """Return which share of the distance to the farthest corner the lens images; 1 with an image circle."""
    if camera.image_circle_deg is not None:
        return 1.0
    corners = [(u, v) for u in (0.0, camera.width - 1.0) for v in (0.0, camera.height - 1.0)]
    farthest = max(np.hypot((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy) for u, v in corners)
    return float(camera.lens.radius(camera.half_angle, camera.distortion) / farthest)


def _beyond(camera) -> float:
    """Return the share of the image circle's diameter outside of the image: beyond one side, or along both axes.

    A fisheye may fill the width of an image and end beyond its top and bottom.
    """
    radii = camera.lens.radius(camera.half_angle, camera.distortion) * np.array([camera.fx, camera.fy])
    middle, size = np.array([camera.cx, camera.cy]), np.array([camera.width, camera.height])
    beyond = np.maximum([radii - (middle + 0.5), radii - (size - 0.5 - middle)], 0.0) / (2.0 * radii)
    return float(max(beyond.max(), beyond.sum(axis=0).min()))


def _aspect(camera) -> float:
    return max(camera.fx / camera.fy, camera.fy / camera.fx)


def _sizes(camera) -> Iterator[str]:
    sides = (camera.width, camera.height)
    if not SIDES_PX[0] <= min(sides) <= max(sides) <= SIDES_PX[1]:
        yield f"'width' {camera.width} and 'height' {camera.height} are no image; give the pixels of a whole image"
    aspect = _aspect(camera)
    if aspect > MAX_ASPECT:
        yield f"'fx' and 'fy' differ by a factor of {aspect:.1f}, and pixels of sensors are nearly square; correct one"
    if not (1 <= camera.cx <= camera.width - 2 and 1 <= camera.cy <= camera.height - 2):
        yield (
            f"the principal point ({camera.cx:g}, {camera.cy:g}) is not within the image of {camera.width} x "
            f"{camera.height} px; {_principal_point_cure(camera)}"
        )


def _principal_point_cure(camera) -> str:
    """Return what to do about a principal point outside of the image."""
    cure = "give 'cx' and 'cy' in pixels of this image"
    if 0 <= min(camera.cx, camera.cy) < 1:
        return f"{cure}, not as shares"
    width, height = round(2.0 * camera.cx + 1.0), round(2.0 * camera.cy + 1.0)
    scales = (width / camera.width, height / camera.height)
    if min(scales) <= 1 or max(scales) > MAX_CROPPED * min(scales):
        return cure
    if any(_lens(dataclasses.replace(camera, width=width, height=height))):
        return cure
    return (
        f"the calibration is of a larger image, about {width} x {height} px: scale 'fx', 'fy', 'cx' and 'cy' to this "
        "image"
    )


def _coefficients(camera) -> Iterator[str]:
    circle, k = camera.image_circle_deg, camera.distortion
    if circle is not None and not 0 < circle < 360:
        yield f"'image_circle_deg' {circle:g} is no field of view; give the full angle in degrees"
    elif circle is not None and circle < LEAST_CIRCLE_DEG:
        yield f"'image_circle_deg' {circle:g} is the field of view of a telescope; give degrees, not radians"
    elif camera.model == "pinhole" and circle is not None and circle > MAX_PINHOLE_DEG - 45.0:
        yield (
            f"'model' is pinhole, and no such lens has an 'image_circle_deg' of {circle:g}; give the model of the "
            "calibration, kannala_brandt for a fisheye, or remove 'image_circle_deg'"
        )
    elif camera.model == "pinhole" and len(k) >= 4 and max(map(abs, k[2:4])) > MAX_TANGENTIAL:
        yield (
            f"'model' is pinhole, and the third and fourth value of 'distortion', {k[2]:g} and {k[3]:g}, shift the "
            "image as no lens does; give the model of the calibration, kannala_brandt for k1 to k4 of a fisheye"
        )
    elif camera.model == "double_sphere" and not (-1 <= k[0] <= 1 and 0 <= k[1] <= 1):
        yield (
            f"'distortion' of the 'model' double_sphere is xi {k[0]:g} and alpha {k[1]:g}; xi lies in -1 to 1 and "
            "alpha in 0 to 1; give the values of the calibration in this order"
        )
    elif circle is not None and not np.all(
        camera.lens.slope(np.linspace(0.0, camera.half_angle, 200), camera.distortion) > 0
    ):
        yield (
            f"by 'distortion' two directions within the image circle have one pixel; give the coefficients of the "
            f"'model' {camera.model}, or the model of the calibration"
        )


def _lens(camera) -> Iterator[str]:
    half = camera.half_angle
    if camera.image_circle_deg is not None:
        radius_px = float(max(camera.fx, camera.fy) * camera.lens.radius(half, camera.distortion))
        corner_px, side_px = _corner_px(camera), 0.5 * min(camera.width, camera.height)
        fits = MIN_CIRCLE * side_px <= radius_px <= MAX_CIRCLE * corner_px
        beyond, aspect = _beyond(camera), _aspect(camera)
        if aspect > WRONG_ASPECT and not (fits and beyond <= MAX_BEYOND):
            yield (
                f"'fx' {camera.fx:g} and 'fy' {camera.fy:g} differ by a factor of {aspect:.1f}, and pixels of sensors "
                "are nearly square; correct one"
            )
        elif not fits:
            yield (
                f"by 'fx' and 'fy' the 'image_circle_deg' has a radius of {radius_px:.0f} px, and the corners of the "
                f"image are {corner_px:.0f} px from the middle; give the focal length in pixels of this image"
            )
        elif beyond > MAX_BEYOND:
            yield (
                f"by 'fx', 'fy', 'cx' and 'cy' the image circle lies outside of the image with {beyond:.0%} of its "
                "diameter; give all four in pixels of this image, or leave 'image_circle_deg' out"
            )
    elif _covered(camera) < MIN_COVERED:
        yield (
            f"by 'distortion' the lens images nothing beyond {np.degrees(half):.0f} degrees, less than half of the way "
            f"to the corners of the image; give the coefficients of the 'model' {camera.model}, or calibrate again"
        )
    elif camera.model == "pinhole" and 2.0 * np.degrees(half) > MAX_PINHOLE_DEG:
        yield (
            f"by 'fx' and 'fy' a pinhole lens sees {2.0 * np.degrees(half):.0f} degrees; give the focal length in "
            "pixels of this image, or the 'model' of a fisheye"
        )
    if 2.0 * np.degrees(half) < VIEW_DEG:
        yield f"the field of view is {2.0 * np.degrees(half):.2g} degrees; give 'fx' and 'fy' in pixels of this image"


def _times(camera) -> Iterator[str]:
    if not RATES_HZ[0] <= camera.rate_hz <= RATES_HZ[1]:
        yield f"'rate_hz' is {camera.rate_hz:g}: give images per second, not the time between two"
    elif not 0 <= camera.exposure_s <= 1.0 / camera.rate_hz:
        yield (
            f"'exposure_s' {camera.exposure_s:g} s is not between 0 and the {1.0 / camera.rate_hz:.3g} s from one of "
            f"{camera.rate_hz:g} images a second to the next; give the time for which the shutter is open, in s: "
            "cameras of racers have 0.0005 to 0.01"
        )
    if not 0 <= camera.processing_latency <= MAX_LATENCY_S:
        yield (
            f"'processing_latency' {camera.processing_latency:g} s is not between 0 and {MAX_LATENCY_S:g} s; give the "
            "time from an image's stamp until its gates correct the state, in s: 0.01 to 0.1 on board"
        )


def _mount(camera) -> Iterator[str]:
    distance = float(np.linalg.norm(camera.position))
    if distance > MAX_DISTANCE_M:
        yield f"'position' is {distance:.3g} m from the middle of the vehicle; give m in the body frame"
    if abs(camera.pitch_deg) > 90:
        yield f"'pitch_deg' {camera.pitch_deg:g} is beyond the vertical; turn the camera by 'yaw_deg' and 'roll_deg'"
    elif abs(camera.pitch_deg) > MAX_PITCH_DEG:
        where = "sky" if camera.pitch_deg > 0 else "ground"
        yield (
            f"by 'pitch_deg' {camera.pitch_deg:g} the camera looks at the {where}, where no gate is ahead; give the "
            "angle of the optical axis above the body's x axis, 20 to 55 degrees of racers"
        )
    if _away_deg(camera) > MAX_AWAY_DEG:
        yield f"by 'yaw_deg' {camera.yaw_deg:g} the camera looks backwards, where no gate is ahead; give 0 for forwards"


def _away_deg(camera) -> float:
    return abs((camera.yaw_deg + 180.0) % 360.0 - 180.0)


def _odd_lens(camera) -> Iterator[str]:
    view_deg = 2.0 * np.degrees(camera.half_angle)
    if view_deg < LOW_VIEW_DEG:
        yield f"the field of view is {view_deg:.0f} degrees: gates are rarely in sight; 'fx' and 'fy' are in pixels"
    aspect = _aspect(camera)
    if aspect > HIGH_ASPECT:
        yield f"'fx' and 'fy' differ by a factor of {aspect:.1f}; pixels of sensors are nearly square"
    if MIN_COVERED <= _covered(camera) < WELL_COVERED:
        yield f"by 'distortion' the corners of the image show nothing: the lens ends at {view_deg / 2:.0f} degrees"
    middle = np.array([(camera.width - 1) / 2, (camera.height - 1) / 2])
    off = np.abs(np.array([camera.cx, camera.cy]) - middle) / (camera.width, camera.height)
    if off.max() > MAX_OFF_CENTRE:
        yield f"the principal point is {100 * off.max():.0f} % of a side off the middle of the image; see 'cx' and 'cy'"
    if camera.model == "pinhole" and len(camera.distortion) >= 4:
        tangential = max(map(abs, camera.distortion[2:4]))
        if tangential > HIGH_TANGENTIAL:
            yield f"p1 or p2 of 'distortion' is {tangential:g}; calibrations find 0.005 at most"


def _odd_mount(camera) -> Iterator[str]:
    if not COMMON_RATES_HZ[0] <= camera.rate_hz <= COMMON_RATES_HZ[1]:
        yield f"'rate_hz' is {camera.rate_hz:g}; the stack processes some 30 images a second"
    if camera.exposure_s > LONG_EXPOSURE_S:
        yield f"'exposure_s' is {camera.exposure_s:g}: at racing speed the images are blurred"
    if camera.processing_latency > LONG_LATENCY_S:
        yield f"'processing_latency' is {camera.processing_latency:g} s; the paper's vehicle needs 0.04 s"
    if _away_deg(camera) > LARGE_AWAY_DEG:
        yield f"the camera looks {_away_deg(camera):.0f} degrees to the side, where the pilot does not fly"
    if not LOW_PITCH_DEG <= camera.pitch_deg <= HIGH_PITCH_DEG:
        side = "downwards; at speed the vehicle leans forward too" if camera.pitch_deg < 0 else "upwards"
        yield f"the camera looks {abs(camera.pitch_deg):.0f} degrees {side}"
