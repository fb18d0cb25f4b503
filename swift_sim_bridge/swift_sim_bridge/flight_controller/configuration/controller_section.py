"""The vehicle file's `controller` section of type betaflight: a profile in the firmware's own names and units.

Its keys describe a plain loop; `dump: FILE` names what the CLI of a flight controller prints, which is simulated whole.
"""

from dataclasses import dataclass
from pathlib import Path

from swift_ros.configuration import build
from swift_ros.errors import UsageError
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.flight_controller.configuration import cli_dump, cli_settings
from swift_sim_bridge.flight_controller.rate_loop.runaway import RunawaySettings


@dataclass(frozen=True)
class AxisGains:
    """P, I, D of each axis as the firmware's configurator shows them."""

    roll: tuple[float, float, float]
    pitch: tuple[float, float, float]
    yaw: tuple[float, float, float]


@dataclass(frozen=True)
class ControllerKeys:
    """rc_rate, super_rate, expo: (3,) roll, pitch, yaw; the rest as the comments of `config/drone.yaml` say."""

    type: str
    rates_type: str
    rc_rate: tuple[float, float, float]
    super_rate: tuple[float, float, float]
    expo: tuple[float, float, float]
    pid: AxisGains
    gyro_lpf1_static_hz: float
    dterm_lpf1_static_hz: float
    dterm_lpf2_static_hz: float
    iterm_limit: float
    iterm_windup: float
    iterm_relax_cutoff: float
    pidsum_limit: float
    pidsum_limit_yaw: float
    motor_idle: float
    yaw_motors_reversed: bool
    loop_hz: float = 0.0
    serial_phase_s: float = 0.0

    def __post_init__(self):
        _check_times(self)
        if not 0 <= self.motor_idle < 100:
            raise ValueError("'motor_idle' must be a percentage from 0 to below 100")
        if not 30 <= self.iterm_windup <= 100:
            raise ValueError("'iterm_windup' must be a percentage from 30 to 100")


def _check_times(keys) -> None:
    if not (keys.loop_hz == 0 or keys.loop_hz >= 100):
        raise ValueError("'loop_hz' must be 0, for one pass a physics step, or at least 100")
    if not 0 <= keys.serial_phase_s <= 0.01:
        raise ValueError("'serial_phase_s' must be from 0 to 0.01: the serial task reads MSP at 100 Hz")


@dataclass(frozen=True)
class DumpKeys:
    """dump: file of the CLI's `diff all` or `dump all`, from the vehicle file's folder; gyro_hz: of the gyro's samples,
    which the dump does not tell; loop_hz: of the rate loop, 0 for gyro_hz / pid_process_denom; serial_phase_s: 0..0.01
    for which a frame of MSP waits until the serial task reads it; pid: gains instead of the dump's."""

    type: str
    dump: str
    gyro_hz: float = 8000.0
    loop_hz: float = 0.0
    serial_phase_s: float = 0.0
    pid: AxisGains | None = None

    def __post_init__(self):
        _check_times(self)
        if not self.gyro_hz >= 100:
            raise ValueError("'gyro_hz' must be at least 100")


@dataclass(frozen=True)
class DumpedController:
    """A flight controller as its dump sets it up; settings: by their CLI names; loop_hz: of the rate loop; cells: of
    the pack; serial_phase_s as in the keys; unmodelled: what the dump switches on and this simulator lacks."""

    settings: dict
    features: frozenset[str]
    unmodelled: tuple[str, ...]
    loop_hz: float
    serial_phase_s: float
    cells: int

    @property
    def pid(self) -> AxisGains:
        return AxisGains(*(tuple(self.settings[f"{letter}_{axis}"] for letter in "pid") for axis in cli_settings.AXES))

    @property
    def digital(self) -> bool:
        """Whether motors hear a digital protocol, whose idle is a share and not a pulse."""
        return "SHOT" in self.settings["motor_pwm_protocol"] and self.settings["motor_pwm_protocol"] not in (
            "ONESHOT125",
            "ONESHOT42",
            "MULTISHOT",
        )

    @property
    def motor_idle(self) -> float:
        """Percent of the motors' range, which begins where they stop."""
        s = self.settings
        return s["dshot_idle_value"] / 100.0 if self.digital else (s["min_throttle"] - s["min_command"]) / 10.0

    @property
    def yaw_motors_reversed(self) -> bool:
        return self.settings["yaw_motors_reversed"] == "ON"

    @property
    def iterm_relax_cutoff(self) -> int:
        return self.settings["iterm_relax_cutoff"]

    @property
    def runaway(self) -> RunawaySettings | None:
        """Of runaway-takeoff prevention, None where it is off."""
        if self.settings["runaway_takeoff_prevention"] == "OFF":
            return None
        names = ("runaway_takeoff_deactivate_throttle_percent", "runaway_takeoff_deactivate_delay")
        return RunawaySettings(*(self.settings[name] for name in names))


def controller_from_vehicle(vehicle: Vehicle) -> ControllerKeys | DumpedController:
    """Return the vehicle's firmware profile. Raises UsageError when it is not Betaflight's or a key is wrong."""
    where = f"the vehicle '{vehicle.name}', controller"
    if vehicle.controller.get("type") != "betaflight":
        raise UsageError(f"{where} is of type {vehicle.controller.get('type')!r}; only 'betaflight' can be simulated")
    if "dump" not in vehicle.controller:
        return build(ControllerKeys, vehicle.controller, where)
    keys = build(DumpKeys, vehicle.controller, where)
    dump = cli_dump.read(Path(vehicle.folder) / keys.dump)
    loop_hz = keys.loop_hz or keys.gyro_hz / dump.settings["pid_process_denom"]
    settings = dump.settings
    if keys.pid is not None:
        settings = settings | {
            f"{letter}_{axis}": gain
            for axis, gains in vars(keys.pid).items()
            for letter, gain in zip("pid", gains, strict=True)
        }
    return DumpedController(
        settings, dump.features, dump.unmodelled, loop_hz, keys.serial_phase_s, vehicle.battery.cells
    )


def unmodelled(vehicle: Vehicle) -> tuple[str, ...]:
    """Return what the vehicle's flight controller does that is not simulated, one line each, as far as its dump tells.

    Raises UsageError as `controller_from_vehicle`.
    """
    controller = controller_from_vehicle(vehicle)
    return controller.unmodelled if isinstance(controller, DumpedController) else ()
