"""What is wrong with the camera that flew, or with the map: effects that show where corners of gates are seen."""

import numpy as np

from swift_sim_bridge.effects import Effect, Parameter, vector

NEEDS = ("gate_observations", "p_world", "q_world_body", "gyro_body")
LAYER = "camera"
MAP = ("gate_displaced", "map_scale")  # of the track file, not the vehicle's


def camera() -> tuple[Effect, ...]:
    """Return the effects of the camera and its images."""
    still = {"rotation": [0.0, 0.0, 0.0], "position": [0.0, 0.0, 0.0]}
    extrinsic, focal = ("terms", "camera_extrinsic"), ("terms", "camera_focal")
    return (
        Effect(
            "camera_extrinsic",
            LAYER,
            (
                *vector("rotation", "rad", (*extrinsic, "rotation"), 1e-3, 0.3),
                *vector("position", "m", (*extrinsic, "position"), 2e-3, 0.2),
            ),
            "R_BC (1 + [rotation]x), p_BC + position",
            "the camera is turned (rad, optical frame) and shifted (m, body frame) by {values}",
            "gates at the left, right, top and bottom of the image, near and far",
            NEEDS,
            {"camera_extrinsic": still},
        ),
        Effect(
            "camera_focal",
            LAYER,
            (
                Parameter("scale", "", (*focal, "scale"), 1e-3, -0.2, 0.2),
                *vector("centre_px", "px", (*focal, "centre_px"), 0.1, 30.0, 2),
            ),
            "f (1 + scale), c + centre_px",
            "focal length (share) and centre (px) are off by {values}",
            "gates at the edge of the image, near and far",
            NEEDS,
            {"camera_focal": {"scale": 0.0, "centre_px": [0.0, 0.0]}},
        ),
        Effect(
            "rolling_shutter",
            LAYER,
            (Parameter("readout", "s", ("terms", "rolling_shutter", "readout"), 5e-4, -0.05, 0.05),),
            "row v is exposed readout (v / (height - 1) - 1/2) after the stamp",
            "the rows of an image are exposed within {readout:.4g} s",
            "fast rolls and yaws before a gate, then the same gate at rest",
            NEEDS,
            {"rolling_shutter": {"readout": 0.0}},
        ),
        Effect(
            "processing_latency",
            LAYER,
            (Parameter("delay", "s", ("terms", "processing_latency", "delay"), 5e-4, -0.3, 0.3),),
            "image(t) = scene(t - delay)",
            "images show what was {delay:~.4g} s {delay:before|after} their stamps",
            "fast passes and turns before a gate",
            NEEDS,
            {"processing_latency": {"delay": 0.0}},
            retimes=True,
        ),
    )


def track(gates: int) -> tuple[Effect, ...]:
    """Return the effects of a map of so many gates; of none without any."""
    if not gates:
        return ()
    return (
        *(_displaced(number) for number in range(1, gates + 1)),
        Effect(
            "map_scale",
            LAYER,
            (Parameter("scale", "", ("terms", "map_scale", "scale"), 1e-3, -0.2, 0.2),),
            "p_gate = p_start + (1 + scale) (p_map - p_start)",
            "gates stand {scale:~.2%} {scale:farther from|nearer to} the podium",
            "all gates, each from both sides",
            NEEDS,
            {"map_scale": {"scale": 0.0}},
        ),
    )


def _displaced(number: int) -> Effect:
    path = ("terms", "gate_displaced", "gates", number)
    yaw = Parameter("yaw", "rad", (*path, "yaw"), 5e-3, -np.pi / 3, np.pi / 3)
    idle = {"gate_displaced": {"gates": {number: {"position": [0.0, 0.0, 0.0], "yaw": 0.0}}}}
    return Effect(
        "gate_displaced",
        LAYER,
        (*vector("position", "m", (*path, "position"), 0.01, 3.0), yaw),
        "p_gate = p_map + position, psi_gate = psi_map + yaw",
        f"gate {number} stands {{values}} (m, rad of yaw) beside its place on the map",
        "the gate from three sides, slowly",
        NEEDS,
        idle,
        "gate",
        str(number),
    )
