"""The rate loop's profile from a CLI dump (Betaflight 4.5, pid_init.c, gyro_init.c, mixer_init.c)."""

import numpy as np

from swift_sim_bridge.flight_controller.configuration import rates
from swift_sim_bridge.flight_controller.configuration.cli_settings import AXES
from swift_sim_bridge.flight_controller.configuration.controller_section import DumpedController
from swift_sim_bridge.flight_controller.rate_loop import dynamic_notch, filters, mixer, rpm_filter, stick_path
from swift_sim_bridge.flight_controller.rate_loop import throttle_path as throttle
from swift_sim_bridge.flight_controller.rate_loop.profile import DMin, RateLoopProfile

# pid.h: factors from the gains that users set to PID units per deg, deg/s and deg/s^2.
PTERM_SCALE = 0.032029
ITERM_SCALE = 0.244381
DTERM_SCALE = 0.000529
FEEDFORWARD_SCALE = 0.013754
ITERM_SHARES = np.array([1.0, 1.0, 2.5])  # pid_init.c: factor on I of roll, pitch, yaw
D_MIN_GAIN = 0.00008 / 35.0  # pid_init.c: D_MIN_GAIN_FACTOR over D_MIN_LOWPASS_HZ
AVERAGING_FRAMES = {"OFF": 1, "2_POINT": 2, "3_POINT": 3, "4_POINT": 4}


def profile_from_dump(controller: DumpedController) -> RateLoopProfile:
    """Return the unbatched profile, in plain numbers, of a flight controller with a CLI dump."""
    s = controller.settings
    per_axis = lambda name: np.array([s[f"{name}_{axis}"] for axis in AXES], dtype=float)  # noqa: E731
    smoothing = _smoothing(s)
    return RateLoopProfile(
        kp=per_axis("p") * PTERM_SCALE,
        ki=integral_gains(per_axis("i")),
        kd=per_axis("d") * DTERM_SCALE,
        gyro_filters=_gyro_filters(s, controller.loop_hz),
        dterm_filters=_dterm_filters(s, controller.loop_hz),
        iterm_limit=float(s["iterm_limit"]),
        iterm_relax_cutoff_hz=None if s["iterm_relax"] == "OFF" else float(s["iterm_relax_cutoff"]),
        windup_inverse=None if s["iterm_windup"] == 100 else 100.0 / (100.0 - s["iterm_windup"]),
        pidsum_limit=np.array([s["pidsum_limit"], s["pidsum_limit"], s["pidsum_limit_yaw"]], dtype=float),
        motor_idle=controller.motor_idle / 100.0,
        yaw_direction=1.0 if controller.yaw_motors_reversed else -1.0,
        smoothing=smoothing,
        # The firmware's feed-forward is zero without smoothing.
        feedforward=_feedforward(controller, per_axis("f")) if smoothing is not None and any(per_axis("f")) else None,
        airmode=stick_path.Airmode(s["airmode_start_throttle_percent"] / 100.0, "AIRMODE" in controller.features),
        setpoint_slew=_slew(s),
        rpm_filter=_rpm_filter(s),
        dynamic_notch=_dynamic_notch(s, controller.loop_hz),
        yaw_lowpass_hz=float(s["yaw_lowpass_hz"]) or None,
        d_min=_d_min(s, per_axis("d"), per_axis("d_min")),
        tpa=_tpa(s),
        anti_gravity=_anti_gravity(s) if "ANTI_GRAVITY" in controller.features else None,
        throttle_limit=_throttle_limit(s),
        throttle_boost=_boost(s),
        thrust_linear=throttle.ThrustLinear(s["thrust_linear"] / 100.0) if s["thrust_linear"] else None,
        sag_compensation=_sag(s, controller.cells),
        motor_output_limit=_output_limit(controller),
        mixer_type=s["mixer_type"] if s["mixer_type"] in mixer.TYPES else "LEGACY",
        relax=s["iterm_relax_type"],
        relax_yaw="RPY" in s["iterm_relax"],
        relax_only_growth="INC" in s["iterm_relax"],
        rotate_iterm=s["iterm_rotation"] == "ON",
        watch_runaway=s["runaway_takeoff_prevention"] == "ON",
        loop_hz=controller.loop_hz,
        serial_phase_s=controller.serial_phase_s,
    )


def integral_gains(numbers):
    """Return Ki (3,), PID units per deg, for the I gains (3,) that a user sets."""
    return numbers * ITERM_SHARES * ITERM_SCALE


def _smoothing(s) -> stick_path.Smoothing | None:
    if s["rc_smoothing"] == "OFF":
        return None

    # rc.c, rcSmoothingSetFilterCutoffs: whole Hz, from the frame rate where none is set.
    factors = ("rc_smoothing_auto_factor", "rc_smoothing_auto_factor_throttle", "rc_smoothing_auto_factor")
    set_hz = np.array([s[f"rc_smoothing_{name}_cutoff"] for name in ("setpoint", "throttle", "feedforward")], float)
    share = np.where(set_hz > 0, 0.0, [1.5 / (1.0 + s[factor] / 10.0) for factor in factors])
    by_rate_hz = np.maximum(stick_path.SLOWEST_SMOOTHING_HZ, np.floor(stick_path.FRAMES_HZ * share))
    return stick_path.Smoothing(np.where(set_hz > 0, set_hz, by_rate_hz), share)


def _feedforward(controller: DumpedController, gains) -> stick_path.Feedforward:
    s = controller.settings
    curves = rates.rate_profile(controller)
    return stick_path.Feedforward(
        gain=gains * 0.01 * FEEDFORWARD_SCALE,
        smooth=1.0 - 0.01 * s["feedforward_smooth_factor"],
        jitter=float(s["feedforward_jitter_factor"]),
        boost=0.1 * s["feedforward_boost"],
        transition=s["feedforward_transition"] / 100.0,
        max_rate_limit=float(s["feedforward_max_rate_limit"]),
        max_rate=np.array([rates.full_rate_deg_s(curves, axis) for axis in range(3)]),
        averaging=AVERAGING_FRAMES[s["feedforward_averaging"]],
    )


def _slew(s):
    limits = np.array([s["acc_limit"], s["acc_limit"], s["acc_limit_yaw"]], dtype=float) * 100.0
    return limits if limits.any() else None


def _lowpass(s, name: str, loop_hz: float, corrected: bool) -> tuple:
    """Return the filter `name` as a tuple of one or no filter; `corrected` as in `filters.Lowpass`."""
    kind, hz = s[f"{name}_type"], s[f"{name}_static_hz"]
    low, high = (s.get(f"{name}_dyn_{end}_hz", 0) for end in ("min", "max"))
    if 0 < low <= high:
        return (throttle.Sweep(float(low), float(high), float(s[f"{name}_dyn_expo"]), kind),)
    if not hz or (kind == "BIQUAD" and hz > 0.5 * loop_hz):
        return ()
    return (filters.Lowpass(float(hz), kind, corrected),)


def _notch(s, centre: str, cutoff: str, loop_hz: float) -> tuple:
    centre_hz, cutoff_hz = s[centre], s[cutoff]
    if centre_hz > 0.5 * loop_hz:
        centre_hz = 0.5 * loop_hz if cutoff_hz < 0.5 * loop_hz else 0
    return (filters.Notch(float(centre_hz), float(cutoff_hz)),) if 0 < cutoff_hz < centre_hz else ()


def _gyro_filters(s, loop_hz: float) -> tuple:
    """Return the gyro filters. The second low-pass comes first: it downsamples the gyro to the rate of the loop.

    gyro_init.c gives a fixed PT2 or PT3 the gain of a PT1.
    """
    return (
        *_lowpass(s, "gyro_lpf2", loop_hz, corrected=False),
        *_notch(s, "gyro_notch1_hz", "gyro_notch1_cutoff", loop_hz),
        *_notch(s, "gyro_notch2_hz", "gyro_notch2_cutoff", loop_hz),
        *_lowpass(s, "gyro_lpf1", loop_hz, corrected=False),
    )


def _dterm_filters(s, loop_hz: float) -> tuple:
    return (
        *_notch(s, "dterm_notch_hz", "dterm_notch_cutoff", loop_hz),
        *_lowpass(s, "dterm_lpf1", loop_hz, corrected=True),
        *_lowpass(s, "dterm_lpf2", loop_hz, corrected=True),
    )


def _rpm_filter(s) -> rpm_filter.RpmFilter | None:
    if s["dshot_bidir"] == "OFF" or not s["rpm_filter_harmonics"]:
        return None
    weights = tuple(weight / 100.0 for weight in s["rpm_filter_weights"][: s["rpm_filter_harmonics"]])
    return rpm_filter.RpmFilter(
        q=s["rpm_filter_q"] / 100.0,
        min_hz=float(s["rpm_filter_min_hz"]),
        fade_hz=float(s["rpm_filter_fade_range_hz"]),
        lowpass_hz=float(s["rpm_filter_lpf_hz"]),
        weights=weights,
    )


def _dynamic_notch(s, loop_hz: float) -> dynamic_notch.DynamicNotch | None:
    if not s["dyn_notch_count"] or loop_hz < dynamic_notch.SLOWEST_HZ:
        return None
    return dynamic_notch.DynamicNotch(
        q=s["dyn_notch_q"] / 100.0,
        min_hz=float(s["dyn_notch_min_hz"]),
        max_hz=float(s["dyn_notch_max_hz"]),
        count=s["dyn_notch_count"],
        loop_hz=loop_hz,
    )


def _d_min(s, d, d_min) -> DMin | None:
    share = np.where((d_min > 0) & (d_min < d), d_min / np.maximum(d, 1.0), 0.0)
    if not share.any():
        return None
    gain = D_MIN_GAIN * s["d_max_gain"]
    return DMin(share, gain, gain * s["d_max_advance"] / 100.0)


def _tpa(s) -> throttle.Tpa | None:
    if not s["tpa_rate"] and not s["tpa_low_rate"]:
        return None
    breakpoint = min(max((s["tpa_breakpoint"] - 1000) / 1000.0, 0.0), 0.99)
    low = min(min(max((s["tpa_low_breakpoint"] - 1000) / 1000.0, 0.01), 1.0), breakpoint)
    return throttle.Tpa(
        rate=s["tpa_rate"] / 100.0,
        breakpoint=breakpoint,
        low_rate=s["tpa_low_rate"] / 100.0,
        low_breakpoint=max(low, 1e-6),
        on_p=s["tpa_mode"] == "PD",
        low_always=s["tpa_low_always"] == "ON",
    )


def _anti_gravity(s) -> throttle.AntiGravity | None:
    if not s["anti_gravity_gain"]:
        return None
    cutoff_hz = float(s["anti_gravity_cutoff_hz"])
    return throttle.AntiGravity(float(s["anti_gravity_gain"]), s["anti_gravity_p_gain"] / 100.0, cutoff_hz)


def _throttle_limit(s) -> throttle.ThrottleLimit | None:
    if s["throttle_limit_type"] == "OFF" or s["throttle_limit_percent"] == 100:
        return None
    return throttle.ThrottleLimit(s["throttle_limit_percent"] / 100.0, s["throttle_limit_type"])


def _boost(s) -> throttle.ThrottleBoost | None:
    if not s["throttle_boost"]:
        return None
    return throttle.ThrottleBoost(0.1 * s["throttle_boost"], float(s["throttle_boost_cutoff"]))


def _sag(s, cells: int) -> mixer.SagCompensation | None:
    low_cell_v = s["vbat_warning_cell_voltage"] / 100.0
    if not s["vbat_sag_compensation"] or low_cell_v >= mixer.CELL_FULL_V or not cells:
        return None
    lowpass_hz = 10.0 / s["vbat_sag_lpf_period"]  # battery.h, GET_BATTERY_LPF_FREQUENCY
    return mixer.SagCompensation(s["vbat_sag_compensation"] / 100.0, low_cell_v, float(cells), lowpass_hz)


def _output_limit(controller: DumpedController):
    """Return the usable share of the motors' range above idle (`initEscEndpoints`); None for the whole range."""
    s = controller.settings
    share = s["motor_output_limit"] / 100.0
    if not controller.digital:
        top = (s["max_throttle"] - s["min_command"]) / 1000.0
        idle = controller.motor_idle / 100.0
        share = share * (top - idle) / (1.0 - idle)
    return None if share == 1.0 else share
