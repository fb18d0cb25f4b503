"""Betaflight 4.5's CLI settings that shape motor commands: defaults, ranges, and which of them are simulated.

Names, ranges and defaults: cli/settings.c, flight/pid.c (`resetPidProfile`), fc/controlrate_profile.c, pg/*.c.
"""

from dataclasses import dataclass

from swift_ros.errors import UsageError

OFF_ON = ("OFF", "ON")
FILTER_TYPES = ("PT1", "BIQUAD", "PT2", "PT3")
AXES = ("roll", "pitch", "yaw")
DEFAULT_FEATURES = frozenset({"AIRMODE", "ANTI_GRAVITY"})  # config/feature.c


@dataclass(frozen=True)
class Number:
    """A setting with `count` whole numbers from low to high, separated by commas."""

    default: int | tuple[int, ...]
    low: int
    high: int
    count: int = 1


@dataclass(frozen=True)
class Choice:
    """A setting with one of several names."""

    default: str
    options: tuple[str, ...]


@dataclass(frozen=True)
class Unmodelled:
    """A setting that is not simulated; with a value in `off` it has no effect."""

    default: str
    off: tuple[str, ...]


def _axes(pattern: str, roll: Number, pitch: Number, yaw: Number) -> dict[str, Number]:
    return {pattern.format(axis): number for axis, number in zip(AXES, (roll, pitch, yaw), strict=True)}


def _gains(letter: str, defaults: tuple[int, int, int], high: int) -> dict[str, Number]:
    return _axes(letter + "_{}", *(Number(default, 0, high) for default in defaults))


MASTER = {
    "gyro_lpf1_type": Choice("PT1", FILTER_TYPES),
    "gyro_lpf1_static_hz": Number(250, 0, 1000),
    "gyro_lpf1_dyn_min_hz": Number(250, 0, 1000),
    "gyro_lpf1_dyn_max_hz": Number(500, 0, 1000),
    "gyro_lpf1_dyn_expo": Number(5, 0, 10),
    "gyro_lpf2_type": Choice("PT1", FILTER_TYPES),
    "gyro_lpf2_static_hz": Number(500, 0, 1000),
    "gyro_notch1_hz": Number(0, 0, 1000),
    "gyro_notch1_cutoff": Number(0, 0, 1000),
    "gyro_notch2_hz": Number(0, 0, 1000),
    "gyro_notch2_cutoff": Number(0, 0, 1000),
    "dyn_notch_count": Number(3, 0, 5),
    "dyn_notch_q": Number(300, 1, 1000),
    "dyn_notch_min_hz": Number(100, 20, 250),
    "dyn_notch_max_hz": Number(600, 200, 1000),
    "rpm_filter_harmonics": Number(3, 0, 3),
    "rpm_filter_weights": Number((100, 100, 100), 0, 100, 3),
    "rpm_filter_q": Number(500, 250, 3000),
    "rpm_filter_min_hz": Number(100, 30, 200),
    "rpm_filter_fade_range_hz": Number(50, 0, 1000),
    "rpm_filter_lpf_hz": Number(150, 100, 500),
    "dshot_bidir": Choice("OFF", OFF_ON),
    "pid_process_denom": Number(1, 1, 16),
    "min_throttle": Number(1070, 750, 2250),
    "max_throttle": Number(2000, 750, 2250),
    "min_command": Number(1000, 750, 2250),
    "dshot_idle_value": Number(550, 0, 2000),
    "motor_pwm_protocol": Choice(
        "DSHOT600",
        (
            "PWM",
            "ONESHOT125",
            "ONESHOT42",
            "MULTISHOT",
            "BRUSHED",
            "DSHOT150",
            "DSHOT300",
            "DSHOT600",
            "PROSHOT1000",
            "DISABLED",
        ),
    ),
    "yaw_motors_reversed": Choice("OFF", OFF_ON),
    "mixer_type": Choice("LEGACY", ("LEGACY", "LINEAR", "DYNAMIC", "EZLANDING")),
    "vbat_warning_cell_voltage": Number(350, 100, 500),
    "vbat_sag_lpf_period": Number(2, 1, 255),
    "deadband": Number(0, 0, 32),
    "yaw_deadband": Number(0, 0, 100),
    "airmode_start_throttle_percent": Number(25, 0, 100),
    "rc_smoothing": Choice("ON", OFF_ON),
    "rc_smoothing_auto_factor": Number(30, 0, 250),
    "rc_smoothing_auto_factor_throttle": Number(30, 0, 250),
    "rc_smoothing_setpoint_cutoff": Number(0, 0, 255),
    "rc_smoothing_feedforward_cutoff": Number(0, 0, 255),
    "rc_smoothing_throttle_cutoff": Number(0, 0, 255),
    "runaway_takeoff_prevention": Choice("ON", OFF_ON),
    "runaway_takeoff_deactivate_delay": Number(500, 100, 1000),
    "runaway_takeoff_deactivate_throttle_percent": Number(20, 0, 100),
}

PID_PROFILE = {
    **_gains("p", (45, 47, 45), 250),
    **_gains("i", (80, 84, 80), 250),
    **_gains("d", (40, 46, 0), 250),
    **_gains("f", (120, 125, 120), 1000),
    **_gains("d_min", (30, 34, 0), 250),
    "d_max_gain": Number(37, 0, 100),
    "d_max_advance": Number(20, 0, 200),
    "dterm_lpf1_type": Choice("PT1", FILTER_TYPES),
    "dterm_lpf1_static_hz": Number(75, 0, 1000),
    "dterm_lpf1_dyn_min_hz": Number(75, 0, 1000),
    "dterm_lpf1_dyn_max_hz": Number(150, 0, 1000),
    "dterm_lpf1_dyn_expo": Number(5, 0, 10),
    "dterm_lpf2_type": Choice("PT1", FILTER_TYPES),
    "dterm_lpf2_static_hz": Number(150, 0, 1000),
    "dterm_notch_hz": Number(0, 0, 1000),
    "dterm_notch_cutoff": Number(0, 0, 1000),
    "vbat_sag_compensation": Number(0, 0, 150),
    "anti_gravity_gain": Number(80, 0, 250),
    "anti_gravity_cutoff_hz": Number(5, 2, 50),
    "anti_gravity_p_gain": Number(100, 0, 250),
    "acc_limit": Number(0, 0, 500),
    "acc_limit_yaw": Number(0, 0, 500),
    "iterm_rotation": Choice("OFF", OFF_ON),
    "iterm_relax": Choice("RP", ("OFF", "RP", "RPY", "RP_INC", "RPY_INC")),
    "iterm_relax_type": Choice("SETPOINT", ("GYRO", "SETPOINT")),
    "iterm_relax_cutoff": Number(15, 1, 50),
    "iterm_windup": Number(85, 30, 100),
    "iterm_limit": Number(400, 0, 500),
    "pidsum_limit": Number(500, 100, 1000),
    "pidsum_limit_yaw": Number(400, 100, 1000),
    "yaw_lowpass_hz": Number(100, 0, 500),
    "throttle_boost": Number(5, 0, 100),
    "throttle_boost_cutoff": Number(15, 5, 50),
    "motor_output_limit": Number(100, 1, 100),
    "thrust_linear": Number(0, 0, 150),
    "feedforward_transition": Number(0, 0, 100),
    "feedforward_averaging": Choice("OFF", ("OFF", "2_POINT", "3_POINT", "4_POINT")),
    "feedforward_smooth_factor": Number(25, 0, 95),
    "feedforward_jitter_factor": Number(7, 0, 20),
    "feedforward_boost": Number(15, 0, 50),
    "feedforward_max_rate_limit": Number(90, 0, 200),
    "tpa_mode": Choice("D", ("PD", "D")),
    "tpa_rate": Number(65, 0, 100),
    "tpa_breakpoint": Number(1350, 1000, 2000),
    "tpa_low_rate": Number(20, 0, 100),
    "tpa_low_breakpoint": Number(1050, 1000, 2000),
    "tpa_low_always": Choice("OFF", OFF_ON),
}

RATE_PROFILE = {
    "rates_type": Choice("ACTUAL", ("BETAFLIGHT", "RACEFLIGHT", "KISS", "ACTUAL", "QUICK")),
    "quickrates_rc_expo": Choice("OFF", OFF_ON),
    **_axes("{}_rc_rate", *(Number(7, 1, 255),) * 3),
    **_axes("{}_expo", *(Number(0, 0, 100),) * 3),
    **_axes("{}_srate", *(Number(67, 0, 255),) * 3),
    **_axes("{}_rate_limit", *(Number(1998, 200, 1998),) * 3),
    "thr_mid": Number(50, 0, 100),
    "thr_expo": Number(0, 0, 100),
    "throttle_limit_type": Choice("OFF", ("OFF", "SCALE", "CLIP")),
    "throttle_limit_percent": Number(100, 25, 100),
}

UNMODELLED = {
    "abs_control_gain": Unmodelled("0", ("0",)),
    "use_integrated_yaw": Unmodelled("OFF", ("OFF",)),
    "transient_throttle_limit": Unmodelled("0", ("0",)),
    "crash_recovery": Unmodelled("OFF", ("OFF",)),
    "dyn_idle_min_rpm": Unmodelled("0", ("0",)),
    "rpm_limit": Unmodelled("OFF", ("OFF",)),
    "yaw_spin_recovery": Unmodelled("AUTO", ("OFF",)),
    "gyro_overflow_detect": Unmodelled("ALL", ("OFF",)),
    "pid_at_min_throttle": Unmodelled("ON", ("ON",)),
    "vbat_cutoff_percent": Unmodelled("100", ("100",)),
    "fpv_mix_degrees": Unmodelled("0", ("0",)),
    "thr_corr_value": Unmodelled("0", ("0",)),
    "auto_profile_cell_count": Unmodelled("0", ("0",)),
    "yaw_control_reversed": Unmodelled("OFF", ("OFF",)),
    "level_race_mode": Unmodelled("OFF", ("OFF",)),
    "3d_switched_mode": Unmodelled("OFF", ("OFF",)),
}
# Modes that are not simulated and that a switch can activate in flight, by permanent number (msp/msp_box.c).
UNMODELLED_MODES = {
    2: "HORIZON",
    4: "ANTI GRAVITY",
    5: "MAG",
    6: "HEADFREE",
    12: "PASSTHRU",
    28: "AIR MODE",
    29: "3D",
    30: "FPV ANGLE MIX",
    35: "FLIP OVER AFTER CRASH",
    36: "PREARM",
    45: "PARALYZE",
    46: "GPS RESCUE",
    47: "ACRO TRAINER",
    49: "LAUNCH CONTROL",
}
UNMODELLED_FEATURES = frozenset({"3D", "MOTOR_STOP", "SERVO_TILT"})

# Prefixes of settings that do not affect motor commands.
IGNORED_PREFIXES = (
    "3d_",
    "abs_control_",
    "acc_",
    "acro_trainer_",
    "adc_",
    "align_",
    "altitude_",
    "angle_",
    "auto_disarm",
    "baro_",
    "bat_capacity",
    "battery_",
    "beeper_",
    "blackbox_",
    "box_user_",
    "camera_",
    "cbat_",
    "cc2500_",
    "channel_forwarding",
    "cpu_",
    "craft_name",
    "crash_",
    "crashflip_",
    "crsf_",
    "current_meter",
    "dashboard_",
    "debug_mode",
    "displayport_",
    "dshot_",
    "dyn_idle_",
    "enable_stick",
    "esc_",
    "expresslrs_",
    "ez_landing_",
    "failsafe_",
    "flash_",
    "flysky_",
    "force_battery",
    "frsky_",
    "gimbal_",
    "gps_",
    "gyro_1_",
    "gyro_2_",
    "gyro_cal",
    "gyro_filter_debug",
    "gyro_hardware",
    "gyro_high",
    "gyro_offset",
    "gyro_to_use",
    "horizon_",
    "hott_",
    "i2c",
    "ibat",
    "ibus_",
    "imu_",
    "input_filtering",
    "integrated_yaw",
    "launch_",
    "led",
    "mag_",
    "mavlink_",
    "max7456_",
    "max_aux",
    "max_check",
    "mco",
    "mid_rc",
    "min_check",
    "motor_kv",
    "motor_output_reordering",
    "motor_poles",
    "motor_pwm_inversion",
    "motor_pwm_rate",
    "msp_",
    "osd_",
    "pid_in_tlm",
    "pilot_name",
    "pinio_",
    "profile_name",
    "pwr_on_arm",
    "rangefinder",
    "rate_6pos",
    "rateprofile_name",
    "rc_smoothing_debug",
    "rcdevice_",
    "reboot_",
    "report_cell",
    "rpm_limit_",
    "rssi_",
    "rx_",
    "sbus_",
    "scheduler_",
    "sdcard_",
    "sdio_",
    "serial",
    "servo_",
    "simplified_",
    "small_angle",
    "spektrum_",
    "srxl2_",
    "stats_",
    "system_",
    "task_",
    "telemetry_",
    "thr_corr_angle",
    "timezone_",
    "tlm_",
    "tri_",
    "usb_",
    "use_cbat",
    "use_unsynced",
    "use_vbat",
    "vbat_",
    "vcd_",
    "vtx_",
    "yaw_spin_threshold",
)


def all_defaults() -> dict:
    """Return the default value of every simulated setting."""
    return {name: setting.default for table in (MASTER, PID_PROFILE, RATE_PROFILE) for name, setting in table.items()}


def number_of(name: str, value: str) -> int:
    """Return the firmware's number of a choice's value."""
    return _setting(name).options.index(value)


def range_of(name: str) -> tuple[int, int]:
    """Return the lowest and the highest value of a simulated setting that is a number."""
    setting = _setting(name)
    assert isinstance(setting, Number), name
    return setting.low, setting.high


def _setting(name: str) -> Number | Choice:
    return MASTER.get(name) or PID_PROFILE.get(name) or RATE_PROFILE[name]


def value_of(name: str, text: str, where: str):
    """Parse the text of a simulated setting.

    Args:
        name: CLI name of the setting.
        text: its value as text.
        where: beginning of an error's sentence.

    Returns:
        A number, a tuple of numbers or a name.

    Raises:
        UsageError: the value is outside the range of the firmware.
    """
    setting = _setting(name)
    if isinstance(setting, Choice):
        if text.upper() not in setting.options:
            raise UsageError(f"{where}: {name} = {text} is not one of {', '.join(setting.options)}")
        return text.upper()
    try:
        numbers = tuple(int(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != setting.count or not all(setting.low <= number <= setting.high for number in numbers):
        many = f"{setting.count} whole numbers" if setting.count > 1 else "a whole number"
        raise UsageError(f"{where}: {name} = {text} is not {many} from {setting.low} to {setting.high}")
    return numbers if setting.count > 1 else numbers[0]
