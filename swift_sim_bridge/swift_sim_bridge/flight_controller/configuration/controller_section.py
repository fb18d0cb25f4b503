"""The vehicle file's `controller` section of type betaflight, in the firmware's names and units.

Either its keys describe a rate loop without optional terms (`ControllerKeys`), or `dump: FILE` names a CLI dump, of
which all simulated settings are used (`DumpKeys`, `DumpedController`).
"""

from dataclasses import dataclass
from pathlib import Path

from swift_ros.configuration import build
from swift_ros.errors import UsageError
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.flight_controller.configuration import cli_dump, cli_settings
from swift_sim_bridge.flight_controller.rate_loop.runaway import RunawaySettings

FIRMWARE_SETTINGS = (  # keys of the section that are settings of the firmware, with its names and ranges
    "gyro_lpf1_static_hz",
    "dterm_lpf1_static_hz",
    "dterm_lpf2_static_hz",
    "iterm_limit",
    "iterm_windup",
    "pidsum_limit",
    "pidsum_limit_yaw",
)


@dataclass(frozen=True)
class AxisGains:
    """P, I, D of each axis as the firmware's configurator shows them."""

    roll: tuple[float, float, float]
    pitch: tuple[float, float, float]
    yaw: tuple[float, float, float]


@dataclass(frozen=True)
class ControllerKeys:
    """The `controller` section by keys; units are those of the configurator.

    Attributes:
        type: "betaflight".
        rates_type: curve family of roll, pitch and yaw.
        rc_rate, super_rate, expo: (3,) of roll, pitch, yaw.
        pid: gains.
        gyro_lpf1_static_hz: Hz, PT1 low-pass on the gyro; 0 for none.
        dterm_lpf1_static_hz, dterm_lpf2_static_hz: Hz, PT1 low-passes on D; 0 for none.
        iterm_limit: PID units.
        iterm_windup: percent of the motors' range above which the I term stops growing.
        iterm_relax_cutoff: Hz, on all axes; 0 for no I-term relax.
        pidsum_limit, pidsum_limit_yaw: PID units.
        motor_idle: percent of the motors' range.
        yaw_motors_reversed: whether the propellers turn outwards at the front.
        loop_hz: passes per second; 0 for one pass in each physics step.
        serial_phase_s: s, 0 to 0.01, that a frame waits until the serial task reads it.
    """

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
            hundredths = f": 'dshot_idle_value' is in hundredths of a percent, {self.motor_idle / 100:g} percent here"
            raise ValueError(
                f"'motor_idle' {self.motor_idle:g} must be a percentage from 0 to below 100"
                + (hundredths if 100 < self.motor_idle < 10_000 else "")
            )


def check_firmware_ranges(keys: ControllerKeys) -> None:
    """Raise UsageError for the first key that the firmware does not take as a setting of the same name.

    The variants of a vehicle, by which the gap tool differentiates, may be outside: of them this is not asked.
    """
    values = {name: getattr(keys, name) for name in FIRMWARE_SETTINGS}
    if keys.iterm_relax_cutoff:
        values["iterm_relax_cutoff"] = keys.iterm_relax_cutoff
    for axis in cli_settings.AXES:
        values |= {f"{letter}_{axis}": gain for letter, gain in zip("pid", getattr(keys.pid, axis), strict=True)}
    for name, value in values.items():
        low, high = cli_settings.range_of(name)
        if not low <= value <= high:
            raise UsageError(f"controller: {name} is {value:g}, and the firmware takes {low} to {high}; correct it")


def _check_times(keys) -> None:
    """Raise ValueError for an invalid loop rate or delay of the serial task."""
    if not (keys.loop_hz == 0 or keys.loop_hz >= 100):
        raise ValueError("'loop_hz' must be 0, for one pass a physics step, or at least 100")
    if not 0 <= keys.serial_phase_s <= 0.01:
        raise ValueError("'serial_phase_s' must be from 0 to 0.01: the serial task reads MSP at 100 Hz")


@dataclass(frozen=True)
class DumpKeys:
    """The `controller` section with a CLI dump.

    Attributes:
        type: "betaflight".
        dump: file with the CLI's `diff all` or `dump all`, relative to the vehicle file's folder.
        gyro_hz: samples per second of the gyro, which a dump does not contain.
        loop_hz: passes per second; 0 for gyro_hz / pid_process_denom.
        serial_phase_s: s, 0 to 0.01, that a frame waits until the serial task reads it.
        pid: gains that replace those of the dump; None to keep them.
    """

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
    """A flight controller configured by a CLI dump.

    Attributes:
        settings: settings by their CLI names.
        features: features that are switched on.
        unmodelled: functions that the dump switches on and that are not simulated, one phrase each.
        loop_hz: passes per second.
        serial_phase_s: s that a frame waits until the serial task reads it.
        cells: number of cells of the pack in series.
    """

    settings: dict
    features: frozenset[str]
    unmodelled: tuple[str, ...]
    loop_hz: float
    serial_phase_s: float
    cells: int

    @property
    def pid(self) -> AxisGains:
        """The gains."""
        return AxisGains(*(tuple(self.settings[f"{letter}_{axis}"] for letter in "pid") for axis in cli_settings.AXES))

    @property
    def digital(self) -> bool:
        """Whether the motor protocol is digital: its idle is a share of the range, not a pulse."""
        return "SHOT" in self.settings["motor_pwm_protocol"] and self.settings["motor_pwm_protocol"] not in (
            "ONESHOT125",
            "ONESHOT42",
            "MULTISHOT",
        )

    @property
    def motor_idle(self) -> float:
        """Idle in percent of the motors' range."""
        s = self.settings
        return s["dshot_idle_value"] / 100.0 if self.digital else (s["min_throttle"] - s["min_command"]) / 10.0

    @property
    def yaw_motors_reversed(self) -> bool:
        """Whether the propellers turn outwards at the front."""
        return self.settings["yaw_motors_reversed"] == "ON"

    @property
    def iterm_relax_cutoff(self) -> int:
        """Cutoff of I-term relax, Hz."""
        return self.settings["iterm_relax_cutoff"]

    @property
    def runaway(self) -> RunawaySettings | None:
        """Settings of runaway-takeoff prevention; None where it is off."""
        if self.settings["runaway_takeoff_prevention"] == "OFF":
            return None
        names = ("runaway_takeoff_deactivate_throttle_percent", "runaway_takeoff_deactivate_delay")
        return RunawaySettings(*(self.settings[name] for name in names))


def controller_from_vehicle(vehicle: Vehicle) -> ControllerKeys | DumpedController:
    """Return the vehicle's `controller` section. Raises UsageError for another type or an invalid key."""
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
    """Return the functions in the vehicle's CLI dump that are not simulated, one phrase each.

    Raises UsageError as `controller_from_vehicle`.
    """
    controller = controller_from_vehicle(vehicle)
    return controller.unmodelled if isinstance(controller, DumpedController) else ()
