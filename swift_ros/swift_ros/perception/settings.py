"""Settings of the gate detector. No ROS."""

from dataclasses import dataclass

from swift_ros.configuration import refuse_outside, setting

# By name in the configuration: the name in ONNX Runtime, and its options. TensorRT uses FP16, the others FP32.
PROVIDERS = {
    "tensorrt": ("TensorrtExecutionProvider", {"trt_fp16_enable": True}),
    "cuda": ("CUDAExecutionProvider", {}),
    "cpu": ("CPUExecutionProvider", {}),
}


@dataclass(frozen=True)
class DetectorSettings:
    """Section `gate_detector` of nodes.yaml."""

    model: str = setting("ONNX file, relative to the configuration folder")
    providers: tuple[str, ...] = setting("tensorrt, cuda, cpu: the first that is installed runs the model")
    peak_threshold: float = setting("smallest height of a corner's peak", 0.0, 1.0)
    edge_threshold: float = setting("smallest agreement of the affinity field with an edge", -1.0, 1.0)
    most_peaks: int = setting("largest number of corners of one class, the strongest are kept", 1, 64)
    corner_outset_px: float = setting(
        "corners of large gates lie by so much too far from the gate's centre, px in the panorama", -2.0, 2.0
    )
    attitude_patience_s: float = setting(
        "real time: largest age of the odometry whose attitude is used for an image, s", 0.0, 1.0
    )

    def __post_init__(self):
        if not self.providers:
            raise ValueError(f"'providers' names none; list one or more of {', '.join(PROVIDERS)}")
        for provider in self.providers:
            refuse_outside(PROVIDERS, providers=provider)
