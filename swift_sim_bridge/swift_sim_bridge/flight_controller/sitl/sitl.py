"""Betaflight SITL, the real firmware as a program on this machine: start it, configure it and step it. No ROS.

    with Sitl("betaflight_SITL.elf", scratch_folder, lines=["set p_roll = 52"]) as sitl:
        sitl.await_calibration()                                      # of the gyro, at rest
        sitl.send_sticks([1500, 1500, 1000, 1500, 1000])              # a frame in the order of its channel map, us
        motors = sitl.step(omega_body, q_world_body, specific_force)  # (4,) in 0..1, after one pass of its rate loop
        answer = sitl.ask(101)                                        # payload of the answer to an MSP request

A binary built with gyro sync (the firmware's option SIMULATOR_GYROPID_SYNC) runs one pass of its rate loop for every
state that it receives, at its nominal period and independently of the wall clock: `sitl.stepped` is true. Any other
binary runs the rate loop by the wall clock, and the next pass answers a state. The firmware's other tasks (serial
port, receiver, failsafe) run by the wall clock in both cases.
"""

import contextlib
import select
import socket
import struct
import time

import numpy as np

from swift_ros.betaflight import msp
from swift_ros.betaflight import msp_messages as wire
from swift_ros.betaflight.msp_messages import Code
from swift_ros.betaflight.transport import connect
from swift_ros.errors import UsageError
from swift_ros.vehicle import GRAVITY
from swift_ros.working_time import WorkingTime
from swift_sim_bridge.flight_controller.sitl import cli
from swift_sim_bridge.flight_controller.sitl.program import Program
from swift_sim_bridge.flight_controller.sitl.udp import LOOPBACK, NO_PASS, UdpSockets, state_packet
from swift_sim_bridge.tcp_ports import require_free

MSP_PORT = 5761  # TCP
LOOP_HZ = 8000  # of its simulated gyro, and of its rate loop with pid_process_denom 1
OLDEST_VERSION, NEWEST_VERSION = (4, 5, 0), (4, 5, 99)
# Patience is in working time, the limits of the firmware's own clock in steady time.
START_S = 20.0  # longest time until the MSP port opens
RETRY_S = 0.05  # between two tries to connect
ANSWER_S = 5.0  # longest time to wait for an answer
START_TRIES = 20  # of starting the program; on a busy machine one in three fails, see `Sitl._start`
LOOP_START_S = 0.3  # longest time from the first answer until the rate loop runs
REST_S = 0.7  # of states at rest: longer than the gyro's calibration of 0.5 s (`cli_lines.SITL_SETTINGS`)
CALIBRATION_TIMEOUT_S = 30.0  # longest time until the gyro is calibrated
# sitl.c: after 0.5 s without a state, the firmware drops the next state. SILENCE_S is below and DROP_S above 0.5 s.
SILENCE_S, DROP_S = 0.3, 0.6
CHECK_S = 0.1  # between two checks of the program while it does not answer
SETTLE_S = 0.01  # until the firmware has handled the state that it drops
SET_MOTOR = 214  # MSP code
CHUNK_BYTES = 4096  # read from a socket at once
MOTORS_ON = "set motor_pwm_protocol = PWM"  # SITL lacks DShot, the default: it would write no motor outputs
OFF_US, PROBE_US = 1000, 1100  # motor test values: off, and one that is recognised in the outputs
CALIBRATING = 1 << 12  # arming-disable flag
AT_REST = (np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.array([0.0, 0.0, GRAVITY]))


class Sitl:
    """The running firmware. As a context manager it ends the program on exit; the program also ends with this process.

    Attributes:
        stepped: whether the binary was built with gyro sync.
        version: (4, 5, x).
        log: file with the program's output.
    """

    def __init__(self, binary, folder, lines=(), counted: bool = False):
        """Start and configure the firmware.

        Args:
            binary: path or name of the program.
            folder: an empty or new folder for its settings (eeprom.bin) and log.
            lines: lines of its CLI, entered before the first flight.
            counted: whether the program's clock counts the passes of its rate loop (see `pass_clock`); needs gyro sync.

        Raises:
            UsageError: it cannot be started, does not answer, refuses a line or has another version.
        """
        self._working_time = WorkingTime()
        self._program = Program(binary, folder, counted)
        self.log = self._program.log
        self._sent_s = self._received_s = -np.inf
        self._motors = np.zeros(4)
        self._msp, self._parser = None, msp.Parser()
        require_free(MSP_PORT, "Betaflight SITL needs it: end the program that uses it", host="")
        self._udp = UdpSockets()
        try:
            self._start()
            self.set_up([MOTORS_ON, *lines])
            self.stepped = self._waits_for_states()
        except BaseException:
            self.close()
            raise

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        self.close()

    def set_up(self, lines) -> None:
        """Enter lines of its CLI; it restarts with the new settings. Raises UsageError for a refused line."""
        self._msp.close()
        cli.set_up(MSP_PORT, lines)
        self._program.await_end()
        self._start()

    # Stepping.

    def step(self, omega_body, q_world_body, specific_force_body, patience_s: float = ANSWER_S) -> np.ndarray:
        """Send a state and return the motor outputs of the next pass of the rate loop.

        Args:
            omega_body: (3,) rad/s.
            q_world_body: (4,) x y z w.
            specific_force_body: (3,) m/s^2.
            patience_s: s of working time to wait at most.

        Returns:
            (4,) motor outputs: 0 when disarmed, motor idle to 1 when armed.

        Raises:
            UsageError: the firmware has ended or does not answer.
        """
        self._send(omega_body, q_world_body, specific_force_body)
        while (motors := self._await(patience_s)) is NO_PASS:
            self._send(omega_body, q_world_body, specific_force_body)
        return self._note(motors)

    def exchange(self, omega_body, q_world_body, specific_force_body) -> np.ndarray:
        """Send a state as `step` does and return the newest motor outputs received, without waiting.

        Raises UsageError when the firmware has ended or has not answered for ANSWER_S.
        """
        self._send(omega_body, q_world_body, specific_force_body)
        motors = self._udp.newest()
        if motors is not None:
            return self._note(motors)
        silent_s = time.monotonic() - self._received_s
        if silent_s > CHECK_S:
            self._check(silent_s, ANSWER_S)
        return self._motors

    def _await(self, patience_s: float) -> np.ndarray:
        begun_s = self._working_time.now_s()
        while (motors := self._udp.receive(CHECK_S)) is None:
            self._check(self._working_time.now_s() - begun_s, patience_s)
        return motors

    def _check(self, silent_s: float, patience_s: float) -> None:
        """Raise UsageError when the firmware has ended or was silent for longer than `patience_s`."""
        self._program.check()
        if silent_s > patience_s:
            raise UsageError(f"Betaflight SITL has not answered for {patience_s:.0f} s; see {self.log}")

    def _send(self, *state) -> None:
        if time.monotonic() - self._sent_s > SILENCE_S:
            self._break_silence()
        self._sent_s = time.monotonic()
        self._udp.send(state_packet(*state))

    def _note(self, motors: np.ndarray) -> np.ndarray:
        self._motors, self._received_s = motors, time.monotonic()
        return motors

    def await_calibration(self, seconds: float = REST_S) -> None:
        """Send states at rest until the gyro is calibrated, for `seconds` of the rate loop's time at least."""
        for _ in range(round(seconds * LOOP_HZ)):
            self.step(*AT_REST)
        deadline_s = self._working_time.now_s() + CALIBRATION_TIMEOUT_S
        while self.status().arming_disable & CALIBRATING:
            if self._working_time.now_s() > deadline_s:
                raise UsageError(f"Betaflight SITL does not finish the gyro calibration; see {self.log}")
            for _ in range(round(CHECK_S * LOOP_HZ)):
                self.step(*AT_REST)

    def _break_silence(self) -> None:
        """Send the state that the firmware drops after a silence, so that it drops none of the following ones."""
        time.sleep(max(0.0, self._sent_s + DROP_S - time.monotonic()))
        self._udp.send(state_packet(*AT_REST))
        time.sleep(SETTLE_S)
        self._udp.discard()
        self._received_s = time.monotonic()

    # MSP.

    def ask(self, code: int, payload: bytes = b"") -> bytes:
        """Return the payload of the answer to an MSP request. Raises UsageError when it is refused or not answered."""
        answer = self._msp.ask(code, payload)
        if answer is None:
            raise UsageError(f"Betaflight SITL refuses MSP {code}; is it Betaflight 4.5?")
        return answer

    def status(self) -> wire.Status:
        """Return MSP_STATUS_EX."""
        return wire.decode_status(self.ask(Code.STATUS_EX))

    def send_sticks(self, channels_us) -> None:
        """Send MSP_SET_RAW_RC, at most 18 channels in the channel map's order, without waiting for the answer."""
        self.send(Code.SET_RAW_RC, wire.encode_channels(channels_us))

    def send(self, code: int, payload: bytes = b"") -> None:
        """Send an MSP request without waiting; `answers` returns its answer later, unless `ask` is called before."""
        self._msp.write(msp.encode(msp.Message(code, payload, msp.REQUEST)))

    def answers(self, code: int) -> list[bytes]:
        """Return the payloads of the answers to requests `code` received since the last call."""
        payloads = []
        while (chunk := self._msp.read()) is not None:
            messages = self._parser.feed(chunk[0])
            payloads += [message.payload for message in messages if message.code == code and message.kind == msp.REPLY]
        return payloads

    def open_port(self) -> socket.socket:
        """Return a connection to the MSP port, which accepts one client: from now on the MSP methods here fail."""
        self._msp.close()
        self._msp = None
        begun_s = self._working_time.now_s()
        while True:
            time.sleep(CHECK_S)  # until it has noticed the close; it closes a second connection
            connection = socket.create_connection((LOOPBACK, MSP_PORT), timeout=ANSWER_S)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            with contextlib.suppress(OSError):
                connection.sendall(msp.encode(msp.Message(Code.API_VERSION, kind=msp.REQUEST)))
                if self._first_bytes(connection):
                    return connection
            connection.close()
            self._check(self._working_time.now_s() - begun_s, START_S)

    def _first_bytes(self, connection: socket.socket) -> bytes:
        """Return the first bytes that arrive; none when the firmware closes the connection or is silent too long."""
        deadline_s = self._working_time.now_s() + ANSWER_S
        while self._working_time.now_s() < deadline_s:
            if select.select([connection], [], [], CHECK_S)[0]:
                return connection.recv(CHUNK_BYTES)
        return b""

    # The program.

    def runs(self) -> bool:
        """Return whether the firmware still runs."""
        return self._program.runs()

    def inherit_priority(self) -> None:
        """Give the firmware the scheduling priority of the calling thread."""
        self._program.inherit_priority()

    def close(self) -> None:
        """End the firmware and free the ports."""
        self._end()
        self._udp.close()

    def _start(self) -> None:
        """Start the firmware and connect to it; try again when it does not work, one time in three on a busy machine.

        Its TCP server and its main thread share lists without a lock (dyad), so a port may open and never answer. Its
        scheduler starts the rate loop only if it is first called within 250 us of its initialisation (scheduler.c: a
        later first call always finds the next pass one period away).
        """
        for _ in range(START_TRIES):
            self._program.start()
            self._msp = self._connection()
            if self._loop_starts():
                self.version = self._checked_version()
                return
            self._end()
        raise UsageError(f"Betaflight SITL does not start in {START_TRIES} tries; see {self.log}")

    def _loop_starts(self) -> bool:
        """Return whether the firmware answers and its rate loop runs."""
        deadline_s = self._working_time.now_s() + LOOP_START_S
        try:
            while not struct.unpack_from("<H", self.ask(Code.STATUS_EX))[0]:  # period of the last pass, us
                if self._working_time.now_s() > deadline_s:
                    return False
        except UsageError:
            self._program.check()
            return False
        return True

    def _end(self) -> None:
        if self._msp is not None:
            self._msp.close()
            self._msp = None
        self._program.end()

    def _connection(self):
        clock = self._working_time.now_s
        deadline_s = clock() + START_S
        while True:
            self._program.check()
            try:
                return connect(f"tcp://{LOOPBACK}:{MSP_PORT}", 0, 0.0, clock=clock)
            except UsageError as error:
                if clock() > deadline_s:
                    raise UsageError(
                        f"Betaflight SITL opens no MSP port {MSP_PORT} within {START_S:.0f} s; see {self.log}"
                    ) from error
            time.sleep(RETRY_S)

    def _checked_version(self) -> tuple[int, int, int]:
        variant = self.ask(Code.FC_VARIANT)[:4]
        found = wire.decode(wire.FcVersion, self.ask(Code.FC_VERSION))
        version = (found.major, found.minor, found.patch)
        if variant != b"BTFL" or not OLDEST_VERSION <= version <= NEWEST_VERSION:
            name = f"{variant.decode('ascii', 'replace')} {found.major}.{found.minor}.{found.patch}"
            raise UsageError(f"{self._program.binary} is {name}; give a SITL binary of Betaflight 4.5")
        return version

    def _waits_for_states(self) -> bool:
        """Return whether the rate loop stops without states: a motor test value then never reaches the outputs."""
        self.stepped = False
        self.ask(SET_MOTOR, struct.pack("<8H", *[PROBE_US] * 8))
        time.sleep(CHECK_S)
        outputs = struct.unpack("<8H", self.ask(Code.MOTOR))
        self.ask(SET_MOTOR, struct.pack("<8H", *[OFF_US] * 8))
        return PROBE_US not in outputs
