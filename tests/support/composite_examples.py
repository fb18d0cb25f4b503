"""Settings, cameras and plain scenes for the tests of composites."""

from pathlib import Path

import numpy as np

from swift_ros import configuration
from swift_ros.camera.model import Camera
from swift_sim_bridge.gate_detector.images.composites.looks import CompositeLooks
from swift_sim_bridge.gate_detector.images.composites.scenes import Surroundings

MOUNT = {"position": (0.0, 0.0, 0.0), "pitch_deg": 0.0, "rate_hz": 30.0, "exposure_s": 0.005}
MOUNT |= {"processing_latency": 0.04}
FISHEYE = (-0.004, 0.037, -0.036, 0.006)
CAMERAS = {
    "pinhole": Camera(480, 360, 300.0, 300.0, 239.5, 179.5, (), model="pinhole", **MOUNT),
    "distorted pinhole": Camera(
        480, 360, 320.0, 318.0, 236.0, 183.0, (-0.2, 0.05, 2e-3, -1e-3), model="pinhole", **MOUNT
    ),
    "kannala_brandt": Camera(480, 360, 180.0, 180.0, 239.5, 179.5, FISHEYE, **MOUNT),
    "image circle": Camera(384, 384, 137.3, 137.3, 191.5, 191.5, FISHEYE, image_circle_deg=163.0, **MOUNT),
    "double_sphere": Camera(480, 360, 150.0, 150.0, 239.5, 179.5, (-0.2, 0.6), model="double_sphere", **MOUNT),
}
# nothing but the gates: no other objects, no noise, no motion
CLEAN = {"photograph_share": 0.0, "own_gate_share": 0.0, "negative_share": 0.0, "scenes": ("plain",)}
CLEAN |= {"stacked_share": 0.0, "thick_share": 0.0, "lit_share": 0.0, "clutter": (0, 0), "backlit_share": 0.0}
CLEAN |= {"flare_share": 0.0, "motion_px": 0.0, "rolling_px": 0.0, "defocus_px": 0.0, "vignetting": (0.0, 0.0)}
CLEAN |= {"noise": (0.0, 0.0), "jpeg_share": 0.0, "sharpened_share": 0.0, "reduced_share": 0.0}
ONE_GATE = CLEAN | {"families": ("bars",), "gates": (1, 1)}


def looks(**changed) -> CompositeLooks:
    """Return the settings of `config/training.yaml` with some values changed."""
    path = Path(__file__).resolve().parents[2] / "config" / "training.yaml"
    content = configuration.read_section(path, "detector")["composites"]
    return configuration.build(CompositeLooks, content | changed, f"{path}, section 'detector'")


def black(view, room, paints, rng) -> Surroundings:
    """Return a black background."""
    return Surroundings(np.zeros(view.rays.shape[:2], np.float32), 1e6, 0.0, 1.0, dark=True)


def white(family, layout, paints, rng):
    """Return a white surface."""
    return np.ones(layout.shape, np.float32), 1.0
