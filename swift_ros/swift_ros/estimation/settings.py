"""Settings of the node state_estimator: its section of `config/nodes.yaml`."""

from dataclasses import dataclass

from swift_ros.configuration import refuse_outside, setting

FILTERS = ("corners", "drift")
ALIGNMENTS = ("podium", "map")


@dataclass(frozen=True)
class EstimatorSettings:
    """Settings of the estimator. The `vio_*` describe the errors of the odometry: the process noise of both filters."""

    filter: str = setting("corners: Kalman filter on the corner rays; drift: the paper's filter on positions")
    alignment: str = setting("where the first odometry is: podium (track.yaml's start) or map (odom is the map)")
    history_s: float = setting("length of the odometry buffer for late images, s", 0.1, 10.0)
    start_sigma_m: float = setting("standard deviation of the vehicle's position at the start, m", 0.0, 10.0)
    start_yaw_sigma_deg: float = setting("standard deviation of its heading at the start, degrees", 0.0, 180.0)
    vio_return_s: float = setting(
        "corner filter: time constant with which the integral of the velocity returns to the position, s", 0.01, 1000.0
    )
    vio_walk: float = setting("drift without accelerometer, m per square root of a flown metre", 0.0, 1.0)
    vio_rotation_ref: float = setting("body rate that doubles the variance of these errors, rad/s", 0.01, 1000.0)
    vio_still_walk: float = setting("the same at rest, m per square root of a second", 0.0, 1.0)
    vio_rate_share: float = setting("error of the odometry's velocity relative to the speed", 0.0, 1.0)
    vio_rate_memory_s: float = setting("correlation time of this error, s", 0.01, 100.0)
    vio_velocity_sigma: float = setting("white noise of the odometry's velocity, m/s", 0.0001, 10.0)
    imu_accel_sigma: float = setting("noise of the accelerometer from sample to sample, m/s^2", 0.0, 100.0)
    imu_accel_bias: float = setting("standard deviation of its bias, m/s^2", 0.0, 10.0)
    vio_scale: float = setting("standard deviation of the odometry's scale", 0.0, 0.5)
    vio_tilt_deg: float = setting("standard deviation of roll and pitch, degrees", 0.0, 45.0)
    vio_tilt_memory_s: float = setting("correlation time of roll and pitch errors, s", 0.01, 100.0)
    vio_yaw_walk_deg: float = setting("random walk of the heading, degrees per square root of a second", 0.0, 45.0)
    corner_sigma_deg: float = setting(
        "standard deviation of the ray to a corner of confidence 1, on each axis, degrees", 0.01, 10.0
    )
    corner_confidence_power: float = setting("power of the confidence that this is divided by", 0.0, 5.0)
    corner_sigma_share: float = setting("part proportional to the angle of the gate's diagonal, relative", 0.0, 0.1)
    corner_bias_share: float = setting("share of a corner's variance that is the same in images of one view", 0.0, 0.99)
    view_change_deg: float = setting("motion of a gate's corners that changes this part, degrees", 0.01, 90.0)
    gate_chi_square: float = setting("largest chi-square of a gate's eight corner residuals", 8.0, 1000.0)
    rival_margin: float = setting("smallest chi-square difference to the second-best gate of the map", 0.0, 1000.0)
    refusal_widening_m: float = setting(
        "position uncertainty added per successive image with all gates refused, m", 0.0, 10.0
    )
    drift_sigma: float = setting("drift filter: white part of the drift, m per square root of a second", 0.0, 10.0)
    drift_rate_sigma: float = setting(
        "drift filter: random walk of its rate, m/s per square root of a second", 0.0, 10.0
    )
    drift_chi_square: float = setting("drift filter: largest chi-square of a gate's position", 3.0, 1000.0)
    drift_yaw_s: float = setting(
        "drift filter: time over which the heading is averaged after the first gate, s", 0.0, 60.0
    )
    drift_yaw_sigma_deg: float = setting(
        "drift filter: standard deviation of the heading from one gate, degrees", 0.1, 90.0
    )

    def __post_init__(self):
        refuse_outside(FILTERS, filter=self.filter)
        refuse_outside(ALIGNMENTS, alignment=self.alignment)
