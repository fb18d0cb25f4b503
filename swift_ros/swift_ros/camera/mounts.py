"""Mounts of a camera with exchanged axes or signs: what a `camera.yaml` may say by mistake."""

from dataclasses import replace
from itertools import product

import numpy as np

from swift_ros.camera.model import Camera

LEAST_TURN_DEG = 10.0  # between two mounts; a smaller error is one of the calibration's


def other_mounts(camera: Camera) -> dict[str, Camera]:
    """Return mounts with exchanged axes or signs, by the keys of camera.yaml and their values."""
    pitch, yaw, roll = camera.pitch_deg, camera.yaw_deg, camera.roll_deg
    changes = [{"pitch_deg": -pitch}, {"yaw_deg": -yaw}, {"roll_deg": -roll}]
    changes += [{"roll_deg": (roll + turn + 180.0) % 360.0 - 180.0} for turn in (90.0, 180.0, 270.0)]
    for sign, other_sign in product((1.0, -1.0), repeat=2):
        changes.append({"pitch_deg": sign * yaw, "yaw_deg": other_sign * pitch})
        changes.append({"pitch_deg": sign * roll, "roll_deg": other_sign * pitch})
    mounts: dict[str, Camera] = {}
    for change in changes:
        other = replace(camera, **change)
        cosines = [abs(other.q_body_camera @ one.q_body_camera) for one in (camera, *mounts.values())]
        if max(cosines) < np.cos(np.radians(LEAST_TURN_DEG / 2)):
            mounts[" and ".join(f"{key} {value + 0.0:g}" for key, value in change.items())] = other
    return mounts
