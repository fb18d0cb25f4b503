"""UDP packets of Betaflight SITL (4.5, target/SITL/target.h): state of the vehicle to 9003, motor outputs from 9002.

Axes: the packet's rates are forward-right-down, which the firmware converts to its own axes (FLU). The packet's
attitude is that of a FLU body in a world with z up. The firmware's accelerometer measures minus the packet's value.
"""

import contextlib
import socket
import struct

import numpy as np

from swift_ros.errors import UsageError

LOOPBACK = "127.0.0.1"
RAW_PORT, MOTOR_PORT, STATE_PORT, RC_PORT = 9001, 9002, 9003, 9004  # UDP ports of SITL
GYRO_COUNTS_PER_DEG_S = 16.384  # of the simulated gyro: 2,000 deg/s are 15 bits
PACKET_COUNTS_PER_DEG_S = 16.4  # sitl.c, GYRO_SCALE: factor on a packet's rates before they are truncated to counts
MAX_COUNTS = 32767  # of a 16-bit gyro
SEA_LEVEL_PA = 101325.0  # air pressure in the state packet; the vehicle has no barometer
RAW_PACKET_TIMEOUT_S = 0.5  # longest time from the packet of 9002 to that of 9001, which the firmware sends right after
NO_PASS = np.empty(0)  # instead of motor outputs: the firmware dropped the first state after a silence
FROM_FLU = np.array([1.0, -1.0, -1.0])  # signs of forward-right-down

_STATE = struct.Struct("<18d")
_RAW = struct.Struct("<H2x16f")


def state_packet(omega_body, q_world_body, specific_force_body) -> bytes:
    """Return the packet of a state.

    The firmware reads the rates rounded to counts of its gyro (0.061 deg/s), within +-2,000 deg/s. All stamps are
    zero, because the firmware would scale its clock by the ratio of the stamps' step to the wall clock's step.

    Args:
        omega_body: (3,) rad/s.
        q_world_body: (4,) x y z w.
        specific_force_body: (3,) m/s^2.
    """
    counts = np.clip(np.rint(np.degrees(omega_body) * GYRO_COUNTS_PER_DEG_S), -MAX_COUNTS, MAX_COUNTS)
    # A quarter of a count away from zero: truncation then gives this count despite rounding errors.
    rates = np.radians((counts + 0.25 * np.sign(counts)) / PACKET_COUNTS_PER_DEG_S) * FROM_FLU
    x, y, z, w = q_world_body
    acceleration = -np.asarray(specific_force_body)
    return _STATE.pack(0.0, *rates, *acceleration, w, x, y, z, *(0.0,) * 6, SEA_LEVEL_PA)


class UdpSockets:
    """The simulator's sockets for the UDP ports. Raises UsageError when a port is in use."""

    def __init__(self):
        for port in (STATE_PORT, RC_PORT):
            _bound(port).close()  # several firmwares can share a port, but only one of them would receive
        self._motors = _bound(MOTOR_PORT)
        try:
            self._raw = _bound(RAW_PORT)
        except UsageError:
            self._motors.close()
            raise

    def send(self, packet: bytes) -> None:
        """Send a state."""
        self._motors.sendto(packet, (LOOPBACK, STATE_PORT))

    def receive(self, patience_s: float) -> np.ndarray | None:
        """Return the motor outputs of the next pass, in the firmware's order.

        Port 9002 sends them truncated to whole us; it also answers a state without a pass. After a pass, port 9001
        sends them with their fractions.

        Args:
            patience_s: s to wait at most.

        Returns:
            (4,) in 0..1 (1000..2000 us); NO_PASS for an answer without a pass; None when nothing arrives in time.
        """
        if _received(self._motors, patience_s) is None:
            return None
        packet = _received(self._raw, RAW_PACKET_TIMEOUT_S)
        return NO_PASS if packet is None else _outputs(packet)

    def newest(self) -> np.ndarray | None:
        """Return the newest motor outputs (4,) received since the last call; None without new ones."""
        packet = None
        self._raw.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            while True:
                packet = self._raw.recv(_RAW.size)
        return None if packet is None else _outputs(packet)

    def discard(self) -> None:
        """Discard all unread packets."""
        for udp_socket in (self._motors, self._raw):
            udp_socket.setblocking(False)
            with contextlib.suppress(BlockingIOError):
                while True:
                    udp_socket.recv(_RAW.size)

    def close(self) -> None:
        """Free the ports."""
        self._motors.close()
        self._raw.close()


def _received(udp_socket: socket.socket, patience_s: float) -> bytes | None:
    udp_socket.settimeout(patience_s)
    try:
        return udp_socket.recv(_RAW.size)
    except TimeoutError:
        return None


def _outputs(packet: bytes) -> np.ndarray:
    return (np.array(_RAW.unpack(packet)[1:5]) - 1000.0) / 1000.0


def _bound(port: int) -> socket.socket:
    udp_socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        udp_socket.bind((LOOPBACK, port))
    except OSError as error:
        udp_socket.close()
        cure = "end the program that uses it"
        raise UsageError(f"UDP port {port}, which Betaflight SITL needs, is in use; {cure}") from error
    return udp_socket
