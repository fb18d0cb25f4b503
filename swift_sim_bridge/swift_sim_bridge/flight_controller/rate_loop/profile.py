"""What the rate loop flies by: gains and the terms that a profile switches on, as arrays.

Which terms there are, and of what kind, is fixed when a pass is traced; their numbers may be batched.
"""

from dataclasses import dataclass, field

import jax

from swift_sim_bridge.flight_controller.rate_loop import mixer, stick_path, throttle_path
from swift_sim_bridge.flight_controller.rate_loop.dynamic_notch import DynamicNotch
from swift_sim_bridge.flight_controller.rate_loop.rpm_filter import RpmFilter


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DMin:
    """D between a share (..., 3) of its gain (0: axis always in full) and all of it, as the gyro and feed-forward move:
    gyro_gain, setpoint_gain (...), (`d_min_*`, `d_max_gain`, `d_max_advance`)."""

    share: jax.Array
    gyro_gain: jax.Array
    setpoint_gain: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RateLoopProfile:
    """Gains (..., 3) on deg/s; iterm_limit (...) and pidsum_limit (..., 3) in PID units; iterm_relax_cutoff_hz (...).

    windup_inverse (...): one over the share of the motors' range in which the I term fades out; motor_idle (...): 0..1;
    yaw_direction (...): -1, or +1 where the propellers turn outwards at the front (`yaw_motors_reversed`);
    motor_output_limit (...): 0..1; setpoint_slew (..., 3) deg/s^2, 0 = free; yaw_lowpass_hz (...), of P; the other
    terms as their records say. relax: SETPOINT or GYRO; relax_yaw, relax_only_growth: `iterm_relax`; watch_runaway:
    time what looks like a runaway takeoff; loop_hz: passes a
    second, 0 for one a physics step; serial_phase_s: for which a frame waits to be read.
    """

    kp: jax.Array
    ki: jax.Array
    kd: jax.Array
    gyro_filters: tuple
    dterm_filters: tuple
    iterm_limit: jax.Array
    iterm_relax_cutoff_hz: jax.Array | None
    windup_inverse: jax.Array | None
    pidsum_limit: jax.Array
    motor_idle: jax.Array
    yaw_direction: jax.Array
    smoothing: stick_path.Smoothing | None = None
    feedforward: stick_path.Feedforward | None = None
    airmode: stick_path.Airmode | None = None
    setpoint_slew: jax.Array | None = None
    rpm_filter: RpmFilter | None = None
    dynamic_notch: DynamicNotch | None = None
    yaw_lowpass_hz: jax.Array | None = None
    d_min: DMin | None = None
    tpa: throttle_path.Tpa | None = None
    anti_gravity: throttle_path.AntiGravity | None = None
    throttle_limit: throttle_path.ThrottleLimit | None = None
    throttle_boost: throttle_path.ThrottleBoost | None = None
    thrust_linear: throttle_path.ThrustLinear | None = None
    sag_compensation: mixer.SagCompensation | None = None
    motor_output_limit: jax.Array | None = None
    mixer_type: str = field(default="LEGACY", metadata={"static": True})
    relax: str = field(default="SETPOINT", metadata={"static": True})
    relax_yaw: bool = field(default=True, metadata={"static": True})
    relax_only_growth: bool = field(default=False, metadata={"static": True})
    rotate_iterm: bool = field(default=False, metadata={"static": True})
    watch_runaway: bool = field(default=False, metadata={"static": True})
    loop_hz: float = field(default=0.0, metadata={"static": True})
    serial_phase_s: float = field(default=0.0, metadata={"static": True})
