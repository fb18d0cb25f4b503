"""What a ground station is told, in MAVLink: the vehicle's state in north-east-down and forward-right-down axes.

The map is taken as east-north-up (REP 103): x east, y north, z up. Pure: records in, MAVLink messages out. Telemetry
only speaks: there is nothing here, and nothing in its node, that reads what a ground station sends.
"""

import math
import socket
from dataclasses import dataclass

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from swift_ros import geometry
from swift_ros.errors import UsageError
from swift_ros.types import Odometry

TEXT_BYTES = 50  # what one STATUSTEXT holds; longer ones go in chunks
ERROR, WARNING, NOTICE, INFO = (
    getattr(mavlink, f"MAV_SEVERITY_{name}") for name in ("ERROR", "WARNING", "NOTICE", "INFO")
)
_QUARTER = math.sqrt(0.5)
# Attitude of the axes: north-east-down in east-north-up, and forward-right-down in forward-left-up.
Q_NED_ENU = np.array([_QUARTER, _QUARTER, 0.0, 0.0])
Q_FLU_FRD = np.array([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class Battery:
    """V, A while discharging, and what is left of the charge, 0..1; NaN where not known."""

    voltage: float
    current: float
    remaining: float


def ned_from_enu(vector) -> np.ndarray:
    """Return (..., 3) in north-east-down of a vector in east-north-up."""
    vector = np.asarray(vector, dtype=float)
    return np.stack([vector[..., 1], vector[..., 0], -vector[..., 2]], axis=-1)


def frd_from_flu(vector) -> np.ndarray:
    """Return (..., 3) in forward-right-down of a vector in forward-left-up."""
    return np.asarray(vector, dtype=float) * (1.0, -1.0, -1.0)


def q_ned_frd(q_enu_flu) -> np.ndarray:
    """Return the attitude (4,) x y z w that turns forward-right-down into north-east-down vectors."""
    return geometry.quaternion_multiply(geometry.quaternion_multiply(Q_NED_ENU, np.asarray(q_enu_flu)), Q_FLU_FRD)


def roll_pitch_yaw(q_ned_frd) -> tuple[float, float, float]:
    """Return roll, pitch, yaw (rad, Z-Y'-X'') of an attitude (4,) x y z w."""
    x, y, z, w = (float(v) for v in q_ned_frd)
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = math.asin(min(max(2.0 * (w * y - z * x), -1.0), 1.0))
    return roll, pitch, math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def boot_ms(stamp_ns: int) -> int:
    """Return MAVLink's 32-bit milliseconds of a stamp."""
    return (stamp_ns // 1_000_000) % 2**32


def heartbeat(armed: bool, failsafe: bool):
    """Return HEARTBEAT of a quadrotor that flies itself and takes no orders."""
    mode = mavlink.MAV_MODE_FLAG_AUTO_ENABLED | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0)
    status = mavlink.MAV_STATE_ACTIVE if armed else mavlink.MAV_STATE_STANDBY
    if failsafe:
        status = mavlink.MAV_STATE_CRITICAL
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_GENERIC, mode, 0, status, 3
    )


def attitude(state: Odometry):
    """Return ATTITUDE of a state in the map."""
    angles = roll_pitch_yaw(q_ned_frd(state.q_world_body))
    rates = frd_from_flu(state.omega_body)
    return mavlink.MAVLink_attitude_message(boot_ms(state.stamp_ns), *angles, *(float(rate) for rate in rates))


def local_position(state: Odometry):
    """Return LOCAL_POSITION_NED of a state in the map."""
    v_world = geometry.rotate(np.asarray(state.q_world_body, float), np.asarray(state.v_body, float))
    numbers = (*ned_from_enu(state.p_world), *ned_from_enu(v_world))
    return mavlink.MAVLink_local_position_ned_message(boot_ms(state.stamp_ns), *(float(v) for v in numbers))


def battery_messages(battery: Battery) -> list:
    """Return SYS_STATUS and BATTERY_STATUS."""
    mv = 65535 if math.isnan(battery.voltage) else round(1e3 * battery.voltage)
    ca = -1 if math.isnan(battery.current) else round(1e2 * battery.current)
    percent = -1 if math.isnan(battery.remaining) else round(1e2 * battery.remaining)
    status = mavlink.MAVLink_sys_status_message(0, 0, 0, 0, mv, ca, percent, 0, 0, 0, 0, 0, 0)
    function, chemistry = mavlink.MAV_BATTERY_FUNCTION_ALL, mavlink.MAV_BATTERY_TYPE_LIPO
    cells, unknown_temperature = [mv] + [65535] * 9, 32767
    pack = mavlink.MAVLink_battery_status_message(
        0, function, chemistry, unknown_temperature, cells, ca, -1, -1, percent
    )
    return [status, pack]


def status_text(severity: int, text: str, number: int) -> list:
    """Return STATUSTEXT messages of a text, in chunks where it is long; number: 1..65535 tells texts apart."""
    data = text.encode(errors="replace")
    chunks = [data[i : i + TEXT_BYTES] for i in range(0, len(data), TEXT_BYTES)] or [b""]
    number = number if len(chunks) > 1 else 0
    return [mavlink.MAVLink_statustext_message(severity, chunk, number, i) for i, chunk in enumerate(chunks)]


class Station:
    """The way to a ground station: packs messages and sends them, whether or not anybody listens. It never receives.

    endpoint: "udpout:HOST:PORT"; system: MAVLink's system id, 1..255. Raises UsageError for an endpoint that is none.
    """

    def __init__(self, endpoint: str, system: int):
        kind, _, place = endpoint.partition(":")
        host, _, port = place.rpartition(":")
        if kind != "udpout" or not host or not port.isdigit() or not 0 < int(port) < 65536:
            raise UsageError(f"'endpoint' is '{endpoint}'; give udpout:HOST:PORT, such as udpout:127.0.0.1:14550")
        try:
            family, _, _, _, self._address = socket.getaddrinfo(host, int(port), type=socket.SOCK_DGRAM)[0]
        except OSError as error:
            raise UsageError(f"'endpoint' names the host {host}, which cannot be found: {error.strerror}") from error
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._packer = mavlink.MAVLink(None, srcSystem=system, srcComponent=mavlink.MAV_COMP_ID_AUTOPILOT1)
        self.lost = 0

    def send(self, messages) -> None:
        """Send messages, one datagram each; what the network does not take is counted in `lost`."""
        for message in messages:
            try:
                self._socket.sendto(message.pack(self._packer), self._address)
                self._packer.seq = (self._packer.seq + 1) % 256
            except OSError:
                self.lost += 1

    def close(self) -> None:
        self._socket.close()
