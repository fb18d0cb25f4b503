"""MAVLink telemetry for a ground station: the vehicle's state in north-east-down and forward-right-down axes. No ROS.

The map is east-north-up (REP 103): x east, y north, z up. Telemetry is sent only: neither this module nor its node
reads what a ground station sends.
"""

import math
import socket
from dataclasses import dataclass

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from swift_ros import geometry
from swift_ros.errors import UsageError
from swift_ros.text import described
from swift_ros.types import Odometry

MAX_FLOAT = float(np.finfo(np.float32).max)
TEXT_BYTES = 50  # of one STATUSTEXT; longer texts are sent in chunks
ERROR, WARNING, NOTICE, INFO = (
    getattr(mavlink, f"MAV_SEVERITY_{name}") for name in ("ERROR", "WARNING", "NOTICE", "INFO")
)
_HALF_SQRT = math.sqrt(0.5)
# Rotations between axes: north-east-down in east-north-up, and forward-right-down in forward-left-up.
Q_NED_ENU = np.array([_HALF_SQRT, _HALF_SQRT, 0.0, 0.0])
Q_FLU_FRD = np.array([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class Battery:
    """State of the battery; unknown values are NaN.

    Attributes:
        voltage: V.
        current: A, positive while discharging.
        remaining: remaining charge, 0 to 1.
    """

    voltage: float
    current: float
    remaining: float


def udp_address(endpoint: str) -> tuple[str, int]:
    """Return host and port of "udpout:HOST:PORT". Raises ValueError."""
    kind, _, place = endpoint.partition(":")
    host, _, port = place.rpartition(":")
    if kind != "udpout" or not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise ValueError(f"'endpoint' is {described(endpoint)}; give udpout:HOST:PORT, such as udpout:127.0.0.1:14550")
    return host, int(port)


def ned_from_enu(vector) -> np.ndarray:
    """Convert a vector (..., 3) from east-north-up to north-east-down."""
    vector = np.asarray(vector, dtype=float)
    return np.stack([vector[..., 1], vector[..., 0], -vector[..., 2]], axis=-1)


def frd_from_flu(vector) -> np.ndarray:
    """Convert a vector (..., 3) from forward-left-up to forward-right-down."""
    return np.asarray(vector, dtype=float) * (1.0, -1.0, -1.0)


def q_ned_frd(q_enu_flu) -> np.ndarray:
    """Return the attitude (4,) x y z w that rotates forward-right-down into north-east-down vectors."""
    return geometry.quaternion_multiply(geometry.quaternion_multiply(Q_NED_ENU, np.asarray(q_enu_flu)), Q_FLU_FRD)


def roll_pitch_yaw(q_ned_frd) -> tuple[float, float, float]:
    """Return roll, pitch, yaw (rad, Z-Y'-X'') of an attitude (4,) x y z w."""
    x, y, z, w = (float(v) for v in q_ned_frd)
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = math.asin(min(max(2.0 * (w * y - z * x), -1.0), 1.0))
    return roll, pitch, math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def boot_ms(stamp_ns: int) -> int:
    """Return a stamp as MAVLink's time since boot, ms in 32 bits."""
    return (stamp_ns // 1_000_000) % 2**32


def _floats(values) -> list[float]:
    """Return numbers as MAVLink sends them: of 32 bits, an absurd one as the largest; NaN stays."""
    return np.clip(np.asarray(values, dtype=float), -MAX_FLOAT, MAX_FLOAT).tolist()


def _whole(value: float, low: int, high: int, for_nan: int) -> int:
    """Return a whole number between bounds; MAVLink has a number of its own for NaN."""
    return for_nan if math.isnan(value) else round(min(max(value, low), high))


def heartbeat(armed: bool, failsafe: bool):
    """Return HEARTBEAT of an autonomous quadrotor that accepts no commands."""
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
    return mavlink.MAVLink_attitude_message(boot_ms(state.stamp_ns), *_floats((*angles, *rates)))


def local_position(state: Odometry):
    """Return LOCAL_POSITION_NED of a state in the map."""
    v_world = geometry.rotate(np.asarray(state.q_world_body, float), np.asarray(state.v_body, float))
    numbers = (*ned_from_enu(state.p_world), *ned_from_enu(v_world))
    return mavlink.MAVLink_local_position_ned_message(boot_ms(state.stamp_ns), *_floats(numbers))


def battery_messages(battery: Battery) -> list:
    """Return SYS_STATUS and BATTERY_STATUS."""
    mv = _whole(1e3 * battery.voltage, 0, 65534, 65535)
    ca = _whole(1e2 * battery.current, 0, 32767, -1)
    percent = _whole(1e2 * battery.remaining, 0, 100, -1)
    status = mavlink.MAVLink_sys_status_message(0, 0, 0, 0, mv, ca, percent, 0, 0, 0, 0, 0, 0)
    function, chemistry = mavlink.MAV_BATTERY_FUNCTION_ALL, mavlink.MAV_BATTERY_TYPE_LIPO
    cells, unknown_temperature = [mv] + [65535] * 9, 32767
    pack = mavlink.MAVLink_battery_status_message(
        0, function, chemistry, unknown_temperature, cells, ca, -1, -1, percent
    )
    return [status, pack]


def status_text(severity: int, text: str, number: int) -> list:
    """Return the STATUSTEXT messages of a text.

    Args:
        severity: MAV_SEVERITY_*.
        text: the text; a long one is split into chunks.
        number: identifier of the text, 1..65535.
    """
    data = text.encode(errors="replace")
    chunks = [data[i : i + TEXT_BYTES] for i in range(0, len(data), TEXT_BYTES)] or [b""]
    number = number if len(chunks) > 1 else 0
    return [mavlink.MAVLink_statustext_message(severity, chunk, number, i) for i, chunk in enumerate(chunks)]


class Station:
    """Sends messages to a ground station by UDP, whether or not it runs. It never receives.

    Attributes:
        lost: number of messages that the network did not accept.
    """

    def __init__(self, endpoint: str, system: int):
        """Open the socket.

        Args:
            endpoint: "udpout:HOST:PORT".
            system: MAVLink's system id, 1..255.

        Raises:
            ValueError: the endpoint is invalid.
            UsageError: its host cannot be found.
        """
        host, port = udp_address(endpoint)
        try:
            family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        except OSError as error:
            raise UsageError(f"'endpoint' names the host {host}, which cannot be found: {error.strerror}") from error
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.connect(address)  # else the socket would receive from every interface
        self._packer = mavlink.MAVLink(None, srcSystem=system, srcComponent=mavlink.MAV_COMP_ID_AUTOPILOT1)
        self.lost = 0

    def send(self, messages) -> None:
        """Send messages, one datagram each."""
        for message in messages:
            data = message.pack(self._packer)
            try:
                try:
                    self._socket.send(data)
                except ConnectionRefusedError:  # of the last message: no station was there
                    self._socket.send(data)
                self._packer.seq = (self._packer.seq + 1) % 256
            except OSError:
                self.lost += 1

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
