"""The vehicle file's `controller` section of type betaflight: a profile in the firmware's own names and units."""

from dataclasses import dataclass

from swift_ros.configuration import build
from swift_ros.errors import UsageError
from swift_ros.vehicle import Vehicle


@dataclass(frozen=True)
class AxisGains:
    """P, I, D of each axis as the firmware's configurator shows them."""

    roll: tuple[float, float, float]
    pitch: tuple[float, float, float]
    yaw: tuple[float, float, float]


@dataclass(frozen=True)
class Controller:
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

    def __post_init__(self):
        if not 0 <= self.motor_idle < 100:
            raise ValueError("'motor_idle' must be a percentage from 0 to below 100")
        if not 30 <= self.iterm_windup <= 100:
            raise ValueError("'iterm_windup' must be a percentage from 30 to 100")


def controller_from_vehicle(vehicle: Vehicle) -> Controller:
    """Return the vehicle's firmware profile. Raises UsageError when it is not Betaflight's or a key is wrong."""
    where = f"the vehicle '{vehicle.name}', controller"
    if vehicle.controller.get("type") != "betaflight":
        raise UsageError(f"{where} is of type {vehicle.controller.get('type')!r}; only 'betaflight' can be simulated")
    return build(Controller, vehicle.controller, where)
