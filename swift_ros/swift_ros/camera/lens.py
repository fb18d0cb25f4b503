"""Lenses: the radius at which a ray is imaged by its angle from the optical axis, for a focal length of one pixel.

A lens is described by `radius(angle)`, which rises up to the edge of the image, and by its derivative. Functions take
arrays of any library, and numbers. Coefficients have the order and meaning of OpenCV (pinhole, Kannala-Brandt) and of
Kalibr (double sphere: Usenko, Demmel and Cremers 2018).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from swift_ros.geometry import array_namespace

PINHOLE, KANNALA_BRANDT, DOUBLE_SPHERE = "pinhole", "kannala_brandt", "double_sphere"
MAX_ANGLE = np.radians(89.0)  # of a pinhole lens; the radius is infinite at 90 degrees
STEPS = 2000  # of the search for the edge of a lens
ITERATIONS = 20  # of the inverse of radius and tangential part: converged to 1e-9 for lenses as calibrations find them
CONVERGED = 1e-13  # rad or a share of the focal length; a smaller step of the inverse ends it
TANGENTIAL_SHARE = 0.02  # of the radius, by which the tangential part may move the corners of the image


@dataclass(frozen=True)
class Lens:
    """A lens model.

    Attributes:
        coefficients: names of the coefficients, separated by spaces, for each allowed number of them.
        radius: (angle (...) rad, coefficients) -> radius (...).
        slope: (angle (...) rad, coefficients) -> its derivative (...).
        tangential: (x, y (...), coefficients) -> shifts (...), (...) of a point of the image plane; None without.
    """

    coefficients: tuple[str, ...]
    radius: Callable
    slope: Callable
    tangential: Callable | None = None

    @property
    def counts(self) -> tuple[int, ...]:
        """Allowed numbers of coefficients."""
        return tuple(len(names.split()) for names in self.coefficients)


def _kannala_brandt(theta, k):
    squared = theta * theta
    return theta * (1 + squared * (k[0] + squared * (k[1] + squared * (k[2] + squared * k[3]))))


def _kannala_brandt_slope(theta, k):
    squared = theta * theta
    return 1 + squared * (3 * k[0] + squared * (5 * k[1] + squared * (7 * k[2] + squared * 9 * k[3])))


def _pinhole_polynomials(k) -> tuple[tuple, tuple]:
    """Return the coefficients of the squared radius, its square and its cube above and below the fraction line."""
    k = (*k, *(0.0,) * (8 - len(k)))  # k1 k2 p1 p2 k3 k4 k5 k6
    return (k[0], k[1], k[4]), (k[5], k[6], k[7])


def _even(c, squared):
    return 1 + squared * (c[0] + squared * (c[1] + squared * c[2]))


def _even_slope(c, squared):
    """Return the derivative with respect to the squared radius."""
    return c[0] + squared * (2 * c[1] + squared * 3 * c[2])


def _pinhole(theta, k):
    above, below = _pinhole_polynomials(k)
    plane = _functions(theta).tan(theta)
    return plane * _even(above, plane * plane) / _even(below, plane * plane)


def _pinhole_slope(theta, k):
    above, below = _pinhole_polynomials(k)
    plane = _functions(theta).tan(theta)
    squared = plane * plane
    top, bottom = _even(above, squared), _even(below, squared)
    ratio_slope = (_even_slope(above, squared) * bottom - top * _even_slope(below, squared)) / (bottom * bottom)
    return (1 + squared) * (top / bottom + 2 * squared * ratio_slope)


def _pinhole_tangential(x, y, k):
    p1, p2 = k[2:4] if len(k) >= 4 else (0.0, 0.0)
    squared = x * x + y * y
    return 2 * p1 * x * y + p2 * (squared + 2 * x * x), p1 * (squared + 2 * y * y) + 2 * p2 * x * y


def _double_sphere(theta, k):
    return _double_sphere_parts(theta, k)[0]


def _double_sphere_slope(theta, k):
    return _double_sphere_parts(theta, k)[1]


def _double_sphere_parts(theta, k):
    """Return radius and slope."""
    xi, alpha = k
    xp = _functions(theta)
    sine, cosine = xp.sin(theta), xp.cos(theta)
    shifted = xi + cosine
    distance = xp.sqrt(sine * sine + shifted * shifted)
    depth = alpha * distance + (1 - alpha) * shifted
    depth_slope = alpha * (sine * cosine - shifted * sine) / distance - (1 - alpha) * sine
    return sine / depth, (cosine * depth - sine * depth_slope) / (depth * depth)


def _functions(value) -> Any:
    return np if isinstance(value, float | int | np.floating) else array_namespace(value)


LENSES = {
    KANNALA_BRANDT: Lens(("k1 k2 k3 k4",), _kannala_brandt, _kannala_brandt_slope),
    PINHOLE: Lens(
        ("", "k1 k2 p1 p2", "k1 k2 p1 p2 k3", "k1 k2 p1 p2 k3 k4 k5 k6"),
        _pinhole,
        _pinhole_slope,
        _pinhole_tangential,
    ),
    DOUBLE_SPHERE: Lens(("xi alpha",), _double_sphere, _double_sphere_slope),
}


def wrong_count(model: str, count: int) -> str | None:
    """Return a sentence when a lens model has another number of coefficients, and which models have this one."""
    lens = LENSES[model]
    if count in lens.counts:
        return None
    wanted = " or ".join(names or "none" for names in lens.coefficients)
    others = [
        f"{other} has {names}"
        for other in LENSES
        for names in LENSES[other].coefficients
        if count and len(names.split()) == count
    ]
    cure = f", or correct 'model': {', '.join(others)}" if others else ""
    return (
        f"'distortion' of a {model} lens has {' or '.join(map(str, lens.counts))} values, not {count}; give "
        f"{wanted}{cure}"
    )


def edge_angle(lens: Lens, coefficients, largest_radius: float) -> float:
    """Return the angle (rad) up to which a lens images rays: at a radius, or where the radius no longer rises."""
    limit = MAX_ANGLE if lens.tangential else np.pi
    angles = np.linspace(0.0, limit, STEPS + 1)[1:]
    with np.errstate(all="ignore"):
        radius, slope = lens.radius(angles, coefficients), lens.slope(angles, coefficients)
    ends = ~(np.isfinite(radius) & (radius > 0) & (slope > 0)) | (radius >= largest_radius)
    last = int(np.argmax(ends)) if ends.any() else STEPS - 1
    reached = ends.any() and radius[last] >= largest_radius and slope[last] > 0
    if not reached:
        return float(angles[max(last - 1, 0)])
    low, high = (float(angles[last - 1]) if last else 0.0), float(angles[last])
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if lens.radius(middle, coefficients) < largest_radius else (low, middle)
    return high


def angle_of(lens: Lens, coefficients, radius, edge: float):
    """Return the angles (...) of radii (...) up to that of the edge: the inverse of `Lens.radius`, by Newton's method.

    Args:
        lens: the lens.
        coefficients: of the lens.
        radius: (...).
        edge: rad, largest angle.
    """
    xp = array_namespace(radius)
    if lens is LENSES[KANNALA_BRANDT]:  # nearly its own inverse: no bracket, a third of the time
        angle = radius
        for _ in range(6):  # converged to machine precision inside the circle after four
            angle = angle - (lens.radius(angle, coefficients) - radius) / lens.slope(angle, coefficients)
        return angle
    low, high = xp.zeros_like(radius), xp.full_like(radius, edge)
    angle = xp.clip(xp.atan(radius), 0.0, edge)
    for _ in range(ITERATIONS):  # with bisection where a step leaves the bracket
        error = lens.radius(angle, coefficients) - radius
        low, high = xp.where(error < 0, angle, low), xp.where(error < 0, high, angle)
        stepped = angle - error / lens.slope(angle, coefficients)
        before, angle = angle, xp.where((stepped >= low) & (stepped <= high), stepped, 0.5 * (low + high))
        if has_converged(angle - before):
            break
    return angle


def has_converged(step) -> bool:
    """Whether a step (...) of an iteration is negligible; False for arrays of another library, for its compiler."""
    return isinstance(step, np.ndarray) and not (np.abs(step) > CONVERGED).any()
