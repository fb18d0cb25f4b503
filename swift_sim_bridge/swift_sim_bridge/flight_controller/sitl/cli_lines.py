"""Lines of Betaflight 4.5's CLI that configure the real firmware as a vehicle file and `FirmwareSettings` say."""

from swift_ros.errors import UsageError
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.flight_controller import modes
from swift_sim_bridge.flight_controller.configuration.controller_section import (
    ControllerKeys,
    DumpedController,
    controller_from_vehicle,
)
from swift_sim_bridge.flight_controller.configuration.rates import RATES_TYPES, rate_profile
from swift_sim_bridge.flight_controller.firmware_settings import PERMANENT_IDS, FirmwareSettings
from swift_sim_bridge.physics.terms import command_path

AXES = ("roll", "pitch", "yaw")
PROCEDURES = {"land": "AUTO-LAND", "drop": "DROP"}
FAILSAFE_DELAY_FACTOR = 5  # on the failsafe's delay: the simulation may be five times slower than the wall clock
SERIAL_HZ = 1000  # its serial task handles one request in each run: 100 frames a second and the requests of the link
# Settings that a flight by SITL needs in any case: analogue motor outputs over the whole range, calibrated sensors, and
# no runaway-takeoff prevention, which uses the wall clock.
SITL_SETTINGS = {
    "motor_pwm_protocol": "PWM",
    "min_command": 1000,
    "max_throttle": 2000,
    "pid_process_denom": 1,
    "acc_calibration": "0,0,0,1",
    "gyro_calib_duration": 50,
    "serial_update_rate_hz": SERIAL_HZ,
    "runaway_takeoff_prevention": "OFF",
}
# Prefixes of settings that SITL lacks: dynamic notches, RPM filter, DShot; its voltmeter measures nothing.
LACKING = ("dyn_notch_", "rpm_filter_", "dshot_", "vbat_")
FEATURES = ("AIRMODE", "ANTI_GRAVITY")
# Settings that the keys of a vehicle file without a CLI dump do not describe: switched off.
OFF = {
    "f_roll": 0,
    "f_pitch": 0,
    "f_yaw": 0,
    "d_min_roll": 0,
    "d_min_pitch": 0,
    "d_min_yaw": 0,
    "anti_gravity_gain": 0,
    "tpa_rate": 0,
    "tpa_low_rate": 0,
    "throttle_boost": 0,
    "rc_smoothing": "OFF",
    "yaw_lowpass_hz": 0,
    "gyro_lpf1_type": "PT1",
    "gyro_lpf1_dyn_min_hz": 0,
    "gyro_lpf2_static_hz": 0,
    "dterm_lpf1_type": "PT1",
    "dterm_lpf2_type": "PT1",
    "dterm_lpf1_dyn_min_hz": 0,
}


def command_lines(vehicle: Vehicle, settings: FirmwareSettings) -> list[str]:
    """Return the CLI lines that configure the firmware.

    Args:
        vehicle: vehicle file with its `controller` section, by keys or by a CLI dump.
        settings: receiver, switches and failsafe.

    Raises:
        UsageError: the settings ask for a radio receiver, which SITL does not have.
    """
    if settings.receiver != "msp":
        raise UsageError("flight_controller: Betaflight SITL has no radio; set receiver to msp in simulation.yaml")
    controller = controller_from_vehicle(vehicle)
    if isinstance(controller, DumpedController):
        values, features = _dumped(controller), controller.features
    else:
        values, features = OFF | _gains(controller) | _rates(controller), {"AIRMODE"}
    values |= _receiver_and_failsafe(settings) | SITL_SETTINGS
    values["min_throttle"] = round(1000 + 10 * controller.motor_idle)
    lines = ["feature -GPS", "feature -TELEMETRY", f"map {settings.channel_map}", *_switches(settings)]
    lines += [f"feature {'' if name in features else '-'}{name}" for name in FEATURES]
    return [*lines, *(f"set {name} = {value}" for name, value in values.items())]


def patient_failsafe(settings: FirmwareSettings) -> str:
    """Return the CLI line that extends the failsafe's delay: it runs by the wall clock, which may be the faster one."""
    return f"set failsafe_delay = {round(10 * FAILSAFE_DELAY_FACTOR * settings.failsafe.delay_s)}"


def unsupported_by_sitl(vehicle: Vehicle) -> list[str]:
    """Return what the vehicle file asks for and a flight by SITL does not simulate, one phrase each."""
    controller = controller_from_vehicle(vehicle)
    # Terms of the command path act between the policy and the simulated firmware; SITL reads MSP itself.
    terms = [f"the term {name}" for name in command_path.TERMS if name in vehicle.terms]
    if not isinstance(controller, DumpedController):
        return terms
    s = controller.settings
    names = [f"dyn_notch_count = {s['dyn_notch_count']}"] if s["dyn_notch_count"] else []
    names += ["the RPM filter (dshot_bidir = ON)"] if s["dshot_bidir"] == "ON" else []
    sag = s["vbat_sag_compensation"]
    return [*names, *([f"vbat_sag_compensation = {sag}"] if sag else []), *terms]


def _dumped(controller: DumpedController) -> dict:
    return {name: value for name, value in controller.settings.items() if not name.startswith(LACKING)}


def _gains(controller: ControllerKeys) -> dict:
    relaxed = controller.iterm_relax_cutoff > 0
    values = {
        "gyro_lpf1_static_hz": round(controller.gyro_lpf1_static_hz),
        "dterm_lpf1_static_hz": round(controller.dterm_lpf1_static_hz),
        "dterm_lpf2_static_hz": round(controller.dterm_lpf2_static_hz),
        "iterm_limit": round(controller.iterm_limit),
        "iterm_windup": round(controller.iterm_windup),
        "iterm_relax": "RPY" if relaxed else "OFF",
        "iterm_relax_type": "SETPOINT",
        "pidsum_limit": round(controller.pidsum_limit),
        "pidsum_limit_yaw": round(controller.pidsum_limit_yaw),
        "yaw_motors_reversed": "ON" if controller.yaw_motors_reversed else "OFF",
    }
    if relaxed:
        values["iterm_relax_cutoff"] = round(controller.iterm_relax_cutoff)
    for axis in AXES:
        gains = getattr(controller.pid, axis)
        values |= {f"{term}_{axis}": round(gain) for term, gain in zip("pid", gains, strict=True)}
    return values


def _rates(controller: ControllerKeys) -> dict:
    profile = rate_profile(controller)
    values = {"rates_type": RATES_TYPES[profile.type].upper()}
    for i, axis in enumerate(AXES):
        values[f"{axis}_rc_rate"] = profile.rc_rate[i]
        values[f"{axis}_srate"] = profile.super_rate[i]
        values[f"{axis}_expo"] = profile.expo[i]
        values[f"{axis}_rate_limit"] = profile.limit[i]
    return values


def _receiver_and_failsafe(settings: FirmwareSettings) -> dict:
    failsafe = settings.failsafe
    return {
        "min_check": settings.min_check_us,
        "max_check": settings.max_check_us,
        "mid_rc": settings.mid_us,
        "small_angle": round(settings.small_angle_deg),
        "angle_limit": round(settings.angle_limit_deg),
        "angle_p_gain": settings.level_gain,
        "pwr_on_arm_grace": round(settings.grace_s),
        "failsafe_procedure": PROCEDURES[failsafe.procedure],
        "failsafe_throttle": failsafe.landing_throttle_us,
        "failsafe_delay": round(10 * failsafe.delay_s),
        "failsafe_off_delay": round(10 * failsafe.landing_s),
        "failsafe_throttle_low_delay": round(10 * failsafe.throttle_low_delay_s),
        "failsafe_recovery_delay": round(10 * failsafe.recovery_delay_s),
    }


def _switches(settings: FirmwareSettings) -> list[str]:
    offered = [(name, switch) for name, switch in settings.modes.items() if name in modes.available(settings)]
    return [
        f"aux {i} {PERMANENT_IDS[name]} {switch.aux - 1} {switch.low_us} {switch.high_us} 0 0"
        for i, (name, switch) in enumerate(offered)
    ]
