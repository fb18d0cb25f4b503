"""The flight table: one recorded flight in SI units, each channel at its own time stamps. No ROS.

`gap` and `identify` read it. It comes from a CSV or Parquet table or from a bag of this graph (`flight_files`). Samples
that cannot be measurements are removed and listed in `rejections` (`flight_checks`).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from swift_ros.camera.model import Camera
from swift_ros.errors import UsageError
from swift_ros.recording.checks import Rejection
from swift_ros.recording.flight_channels import CHANNELS
from swift_ros.recording.log_mapping.motor_order import MotorOrder
from swift_ros.track import Track


@dataclass(frozen=True)
class Samples:
    """Samples of one channel.

    Attributes:
        t: increasing times (n,), s.
        values: (n, k), or (n,) for a channel with one column.
    """

    t: np.ndarray
    values: np.ndarray

    @cached_property
    def rate_hz(self) -> float:
        """Typical rate: the inverse of the median time step, Hz."""
        return float(1.0 / np.median(np.diff(self.t)))


@dataclass(frozen=True)
class RowSampling:
    """What the rows of a channel say about the time between them.

    Attributes:
        between: `held`: a row is the value at its time; of a motor command, the one that the flight controller set then
            and held until its next pass. `mean`: the mean since the row before. `line`: a straight line joins the rows.
            Empty where it is not known.
        late_s: age of a row's value at the row's time, s.
        loop_hz: rate of the flight controller's loop, Hz; 0 where the vehicle file gives it.
    """

    between: str = ""
    late_s: float = 0.0
    loop_hz: float = 0.0

    def at_its_time(self, samples: Samples, channel: str) -> Samples:
        """Return samples at the times of their values: a mean since the row before is half a row old.

        Motor commands keep their times: what drives the motors also depends on the loop.
        """
        if channel == "motor_command" or not (self.between == "mean" or self.late_s) or len(samples.t) < 2:
            return samples
        half_row_s = 0.5 / samples.rate_hz if self.between == "mean" else 0.0
        return Samples(samples.t - self.late_s - half_row_s, samples.values)


@dataclass(frozen=True)
class DetectedGates:
    """Gates that the detector found in images.

    Attributes:
        t: times (n,) of the images, s, not decreasing.
        corners: (n, 4, 2) px: top-left, top-right, bottom-right, bottom-left of the upright gate.
        camera: camera model of the recording.
        track: track of the recording.
    """

    t: np.ndarray
    corners: np.ndarray
    camera: Camera
    track: Track


@dataclass(frozen=True)
class FlightTable:
    """One flight.

    Attributes:
        name: for reports.
        channels: recorded channels, by their name in `CHANNELS`.
        rejections: removed samples, on the same clock.
        detected_gates: gates in images, None without images.
        rotor_speed_modelled: rotor speeds were computed from motor commands, not measured.
        skips_commands: the motors received commands between the recorded ones.
        notes: how a log of another program was read, a line each.
        motor_order: place and spin of its motors as its gyro shows them, None where it does not.
        motor_columns: the columns of its motors.
        contradicted: a physical check of its units and frames does not hold.
        sampling: what is declared about the time between the rows, by channel.
        one_clock: all stamps are of one clock, as in the log of a flight controller.
    """

    name: str
    channels: Mapping[str, Samples]
    rejections: tuple[Rejection, ...] = ()
    detected_gates: DetectedGates | None = None
    rotor_speed_modelled: bool = False
    skips_commands: bool = False
    notes: tuple[str, ...] = ()
    motor_order: MotorOrder | None = None
    motor_columns: tuple[str, ...] = ()
    contradicted: bool = False
    sampling: Mapping[str, RowSampling] = field(default_factory=dict)
    one_clock: bool = False

    def __contains__(self, channel: str) -> bool:
        return channel in self.channels

    def __getitem__(self, channel: str) -> Samples:
        return self.channels[channel]

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time of all channels, s."""
        return min(s.t[0] for s in self.channels.values()), max(s.t[-1] for s in self.channels.values())

    def require(self, *names: str) -> None:
        """Raise UsageError when the flight lacks one of these channels."""
        for name in names:
            if name not in self.channels:
                columns = ", ".join(CHANNELS[name].columns)
                raise UsageError(f"{self.name} lacks {columns}; it has {', '.join(self.channels)}")
