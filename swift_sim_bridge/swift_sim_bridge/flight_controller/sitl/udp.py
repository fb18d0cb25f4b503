"""The UDP packets of Betaflight SITL (4.5, target/SITL/target.h): the vehicle's state to 9003, motor outputs from 9002.

Axes: the firmware turns the packet's rates, which it takes for forward-right-down, into its own, which are FLU; its
attitude is that of a FLU body in a world with z up, unturned; and its accelerometer reads minus what it is sent.
"""

import contextlib
import socket
import struct

import numpy as np

from swift_ros.errors import UsageError

LOOPBACK = "127.0.0.1"
RAW_PORT, MOTOR_PORT, STATE_PORT, RC_PORT = 9001, 9002, 9003, 9004
GYRO_COUNTS_PER_DEG_S = 16.384  # of the gyro that it simulates: 2,000 deg/s fill 15 bits
PACKET_COUNTS_PER_DEG_S = 16.4  # sitl.c, GYRO_SCALE: what it multiplies a packet's rates by, and truncates
COUNTS_LIMIT = 32767
SEA_LEVEL_PA = 101325.0
FRACTIONS_S = 0.5  # the two motor packets leave one after the other
NO_PASS = np.empty(0)  # in the place of motors: the firmware took a state for its first after a silence, and dropped it
FROM_FLU = np.array([1.0, -1.0, -1.0])

_STATE = struct.Struct("<18d")
_RAW = struct.Struct("<H2x16f")


def state_packet(omega_body, q_world_body, specific_force_body) -> bytes:
    """Return the packet of a state: omega_body (3,) rad/s, q_world_body (4,) x y z w, specific_force_body (3,) m/s^2.

    The firmware reads the rates rounded to its gyro's counts (0.061 deg/s), within +-2,000 deg/s. All stamps are zero:
    it would set its clock's rate by the last step of the stamps over the wall clock's, which jumps with every delay.
    """
    counts = np.clip(np.rint(np.degrees(omega_body) * GYRO_COUNTS_PER_DEG_S), -COUNTS_LIMIT, COUNTS_LIMIT)
    # A quarter of a count away from zero: truncation then finds the same whole number, whatever the last bit says.
    rates = np.radians((counts + 0.25 * np.sign(counts)) / PACKET_COUNTS_PER_DEG_S) * FROM_FLU
    x, y, z, w = q_world_body
    acceleration = -np.asarray(specific_force_body)
    return _STATE.pack(0.0, *rates, *acceleration, w, x, y, z, *(0.0,) * 6, SEA_LEVEL_PA)


class UdpSockets:
    """The simulator's ends of the UDP ports. Raises UsageError when one of them is taken."""

    def __init__(self):
        for port in (STATE_PORT, RC_PORT):
            _bound(port).close()  # the firmware lets several share them, and only one of these hears
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
        """Return the motor outputs of the next pass (4,) in 0..1 (firmware order; 1000..2000 us), None when late.

        9002 carries them cut to whole us and, alone, an answer without a pass: NO_PASS. 9001, right after it, has them
        with their fractions.
        """
        if _received(self._motors, patience_s) is None:
            return None
        packet = _received(self._raw, FRACTIONS_S)
        return NO_PASS if packet is None else _outputs(packet)

    def newest(self) -> np.ndarray | None:
        """Return the newest motor outputs (4,) that have come since the last call, None when none have."""
        packet = None
        self._raw.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            while True:
                packet = self._raw.recv(_RAW.size)
        return None if packet is None else _outputs(packet)

    def forget(self) -> None:
        """Drop what lies unread."""
        for end in (self._motors, self._raw):
            end.setblocking(False)
            with contextlib.suppress(BlockingIOError):
                while True:
                    end.recv(_RAW.size)

    def close(self) -> None:
        """Give the ports back."""
        self._motors.close()
        self._raw.close()


def _received(end: socket.socket, patience_s: float) -> bytes | None:
    end.settimeout(patience_s)
    try:
        return end.recv(_RAW.size)
    except TimeoutError:
        return None


def _outputs(packet: bytes) -> np.ndarray:
    return (np.array(_RAW.unpack(packet)[1:5]) - 1000.0) / 1000.0


def _bound(port: int) -> socket.socket:
    end = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        end.bind((LOOPBACK, port))
    except OSError as error:
        end.close()
        raise UsageError(f"UDP port {port}, which Betaflight SITL needs, is in use; end what holds it") from error
    return end
