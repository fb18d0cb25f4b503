"""Camera, gates and looks that a gate detector's network was trained for."""

from pathlib import Path

import numpy as np

from swift_ros import configuration
from swift_ros.camera.model import Camera
from swift_ros.track import Track
from swift_ros.trained_for.comparison import Part, angles_deg, difference, far, warnings

# The detector turns images by the attitude and resamples them: only large differences of the camera matter.
FOCAL, EXPOSURE, VIEW_DEG, MOUNT_DEG, GATE_SIDE = 0.15, 0.5, 10.0, 10.0, 0.2


def of_detector(camera: Camera, track: Track, looks: dict) -> dict:
    """Return `trained_for` of a gate detector's network.

    Args:
        camera: of the training's images.
        track: of the gates in them.
        looks: ranges from which the surfaces were drawn, as in a configuration file.
    """
    return {"camera": configuration.content(camera), "track": configuration.content(track), "looks": looks}


def detector_warnings(model: Path, camera: Camera, track: Track, looks: dict) -> list[str]:
    """Return a sentence for each of camera, gates and looks that a gate detector's network was not trained for.

    Args:
        model: the network.
        camera: that takes the images.
        track: of the gates.
        looks: section `renderer` of simulation.yaml; empty for a real camera.
    """
    advice = "train one with `swiftros train detector --config DIR`"
    parts = (
        Part("camera", Camera, camera, _camera_differences, "another camera", advice),
        Part("track", Track, track, _gate_differences, "other gates", advice),
        Part("looks", None, looks, _looks_differences, "other looks", advice),
    )
    return warnings(model, "gate detector", parts)


def _camera_differences(trained: Camera, camera: Camera) -> list[str]:
    rows = [(name, FOCAL, "px") for name in ("fx", "fy")] + [("exposure_s", EXPOSURE, "s")]
    found = [
        difference(name, getattr(trained, name), getattr(camera, name), unit)
        for name, share, unit in rows
        if far(getattr(trained, name), getattr(camera, name), share)
    ]
    views = [float(np.degrees(2.0 * one.half_angle)) for one in (trained, camera)]
    if abs(views[1] - views[0]) > VIEW_DEG:
        found.append(f"its field of view is {views[1]:.0f} degrees, it was {views[0]:.0f}")
    mounted = float(angles_deg(trained.q_body_camera, camera.q_body_camera))
    if mounted > MOUNT_DEG:
        found.append(f"its mount is turned by {mounted:.0f} degrees")
    return found


def _gate_differences(trained: Track, track: Track) -> list[str]:
    """Compare the frames: their images are drawn at all distances, so that only their shape must be the trained one."""
    before = trained.outer_sides / trained.inner_sides
    now = track.outer_sides / track.inner_sides
    low, high = before.min() / (1.0 + GATE_SIDE), before.max() * (1.0 + GATE_SIDE)
    return [
        f"the frame of gate {i} is {value:.2f} times as wide as its opening, it was {before[0]:.2f} times"
        for i, value in enumerate(now, start=1)
        if not low <= value <= high
    ]


def _looks_differences(trained, looks: dict) -> list[str]:
    found = []
    for name, before in (trained if isinstance(trained, dict) else {}).items():
        old, new = _range(before), _range(looks.get(name))
        if old and new and (new[0] < old[0] or new[1] > old[1]):
            found.append(f"'{name}' is drawn from {new[0]:g} to {new[1]:g}, it was {old[0]:g} to {old[1]:g}")
    return found


def _range(value) -> list | None:
    """Return a value of the looks if it is a pair of numbers."""
    is_pair = isinstance(value, list) and len(value) == 2 and all(isinstance(end, int | float) for end in value)
    return value if is_pair else None
