"""Commands, measurements and states as values of curves, and the names and colors of the curves. No ROS."""

import numpy as np
import rerun as rr

from swift_ros import geometry
from swift_ros.types import BodyRateThrust, GateUpdate, ImuSample, Odometry
from swift_sim_bridge.view.rows import Shape, Values

AXES = ("x", "y", "z")
COMMANDED, MEASURED, TRUE = (235, 130, 20), (60, 150, 235), (150, 150, 150)  # seen on white and on black
# name and color of each curve of an entity
CURVES = {
    **{f"body_rates/{axis}/command": ("commanded", COMMANDED) for axis in AXES},
    **{f"body_rates/{axis}/gyro": ("gyro", MEASURED) for axis in AXES},
    "thrust/command": ("commanded", COMMANDED),
    "thrust/measured": ("specific force z", MEASURED),
    "speed/truth": ("ground truth", TRUE),
    "speed/estimate": ("estimate", MEASURED),
    "error/position": ("estimate to ground truth", (240, 80, 80)),
    "error/deviation": ("standard deviation of the estimate", MEASURED),
}


def styles() -> list[Shape]:
    """Return names and colors of the curves."""
    return [Shape(entity, rr.SeriesLines(names=name, colors=color)) for entity, (name, color) in CURVES.items()]


def motor_styles(count: int) -> list[Shape]:
    """Return the names of the curves of some rotors."""
    names = [f"rotor {number}" for number in range(1, count + 1)]
    return [Shape(f"motors/{name}", rr.SeriesLines(names=names)) for name in ("command", "speed")]


def by_axis(name: str, vector) -> list[Values]:
    """Return body rates (3,) rad/s."""
    return [Values(f"body_rates/{axis}/{name}", (float(value),)) for axis, value in zip(AXES, vector, strict=True)]


def command(one: BodyRateThrust) -> list[Values]:
    """Return body rates, rad/s, and collective thrust, m/s^2, of a command."""
    return [*by_axis("command", one.omega_body), Values("thrust/command", (one.thrust,))]


def imu(sample: ImuSample) -> list[Values]:
    """Return measured body rates, rad/s, and specific force along the thrust, m/s^2."""
    return [*by_axis("gyro", sample.omega_body), Values("thrust/measured", (float(sample.specific_force_body[2]),))]


def speed(name: str, state: Odometry) -> Values:
    """Return the speed of a state, m/s."""
    return Values(f"speed/{name}", (float(np.linalg.norm(state.v_body)),))


def estimate_errors(state: Odometry, truth: Odometry | None) -> list[Values]:
    """Return the distance to the ground truth at the same time, where there is one, and the standard deviation, m."""
    rows = []
    if truth is not None:
        rows.append(Values("error/position", (float(np.linalg.norm(state.p_world - truth.p_world)),)))
    if state.covariance_pose is not None:
        rows.append(Values("error/deviation", (float(np.sqrt(np.trace(state.covariance_pose[:3, :3]))),)))
    return rows


def updates(found: list[GateUpdate]) -> list[Values]:
    """Return how many gates of an image have corrected the state, how many were refused, and the largest distance."""
    accepted = sum(update.accepted for update in found)
    rows = [Values("updates/accepted", (accepted,)), Values("updates/refused", (len(found) - accepted,))]
    distances = [update.mahalanobis for update in found if np.isfinite(update.mahalanobis)]
    return [*rows, Values("updates/mahalanobis", (max(distances),))] if distances else rows


def attitude(state: Odometry) -> Values:
    """Return the tilt of the thrust against the vertical, degrees."""
    up = geometry.rotate(state.q_world_body, np.array([0.0, 0.0, 1.0]))
    return Values("tilt/estimate", (float(np.degrees(np.arccos(np.clip(up[2], -1.0, 1.0)))),))
