"""Profile of the compiled rate loop: gains and coefficients of optional terms, as arrays.

`configuration` makes it from a vehicle file. The terms and their kinds are fixed when a pass is traced; their numbers
may be batched.
"""

from dataclasses import dataclass, field

import jax

from swift_sim_bridge.flight_controller.rate_loop import mixer, stick_path, throttle_path
from swift_sim_bridge.flight_controller.rate_loop.dynamic_notch import DynamicNotch
from swift_sim_bridge.flight_controller.rate_loop.rpm_filter import RpmFilter


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DMin:
    """D gain that rises from a minimum as gyro and feed-forward move (`d_min_*`, `d_max_gain`, `d_max_advance`).

    Attributes:
        share: (..., 3), minimum as a share of the full gain; 0 for an axis that always has the full gain.
        gyro_gain: (...) on the gyro's change.
        setpoint_gain: (...) on the feed-forward.
    """

    share: jax.Array
    gyro_gain: jax.Array
    setpoint_gain: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RateLoopProfile:
    """Profile of the rate loop. An optional term is None, or an empty tuple, where it is off.

    Attributes:
        kp: (..., 3) PID units per deg/s.
        ki: (..., 3) PID units per deg.
        kd: (..., 3) PID units per deg/s^2.
        gyro_filters: filters of the gyro, in their order.
        dterm_filters: filters of the D term, in their order.
        iterm_limit: (...) PID units.
        iterm_relax_cutoff_hz: (...) Hz of the low-pass on the setpoint.
        windup_inverse: (...), one over the share of the motors' range in which the growth of the I term fades out.
        pidsum_limit: (..., 3) PID units.
        motor_idle: (...), motor command at zero throttle, 0 to 1.
        yaw_direction: (...), -1, or +1 with propellers that turn outwards at the front (`yaw_motors_reversed`).
        smoothing, feedforward, airmode: see `stick_path`.
        setpoint_slew: (..., 3) deg/s^2, limit of the setpoint's change; 0 for none.
        rpm_filter, dynamic_notch: see the modules of these names.
        yaw_lowpass_hz: (...) Hz of the low-pass on the P term of yaw.
        d_min: see `DMin`.
        tpa, anti_gravity, throttle_limit, throttle_boost, thrust_linear: see `throttle_path`.
        sag_compensation: see `mixer`.
        motor_output_limit: (...), share of the motors' range, 0 to 1.
        mixer_type: one of `mixer.TYPES`.
        relax: "SETPOINT" or "GYRO", kind of I-term relax.
        relax_yaw: whether I-term relax acts on yaw.
        relax_only_growth: whether I-term relax allows the I term to shrink.
        rotate_iterm: whether the I term stays constant in space while the body rotates.
        watch_runaway: whether to detect a runaway takeoff.
        loop_hz: passes per second; 0 for one pass in each physics step.
        serial_phase_s: s that a frame waits until the serial task reads it.
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
