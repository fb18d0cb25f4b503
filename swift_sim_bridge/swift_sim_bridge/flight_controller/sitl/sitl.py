"""Betaflight SITL, the firmware itself as a program of this machine: started, set up and stepped. No ROS.

    with Sitl("betaflight_SITL.elf", scratch_folder, lines=["set p_roll = 52"]) as sitl:
        sitl.rest()                                                   # until its gyro is calibrated
        sitl.send_sticks([1500, 1500, 1000, 1500, 1000])              # a frame of its channel map, us
        motors = sitl.step(omega_body, q_world_body, specific_force)  # (4,) in 0..1, after one pass of its loop
        answer = sitl.ask(101)                                        # MSP, a payload

A binary built with gyro sync (the firmware's SIMULATOR_GYROPID_SYNC) runs its rate loop once for every state that it
is sent, at its own nominal period whatever the wall clock says: `sitl.stepped`. Any other runs it by the wall clock,
and a state is answered by the pass that happens next. Its remaining tasks (serial port, receiver, failsafe) run by the
wall clock in both.
"""

import contextlib
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
from swift_sim_bridge.flight_controller.sitl import cli
from swift_sim_bridge.flight_controller.sitl.program import Program
from swift_sim_bridge.flight_controller.sitl.udp import LOOPBACK, NO_PASS, UdpSockets, state_packet
from swift_sim_bridge.tcp_ports import require_free

MSP_PORT = 5761
LOOP_HZ = 8000  # of its simulated gyro, and with pid_process_denom 1 of its rate loop
OLDEST_VERSION, NEWEST_VERSION = (4, 5, 0), (4, 5, 99)
START_S, RETRY_S, ANSWER_S = 20.0, 0.05, 5.0
START_TRIES, LOOP_START_S = 20, 0.3
REST_S, REST_PATIENCE_S = 0.7, 30.0
SILENCE_S, FORGOTTEN_S = 0.3, 0.6  # sitl.c: after 0.5 s of silence the next state is taken for a first one, and dropped
LOOK_S, SETTLE_S = 0.1, 0.01
SET_MOTOR, CHUNK = 214, 4096
MOTORS_ON = "set motor_pwm_protocol = PWM"  # its default, DShot, it lacks: no motor would ever be written
OFF_US, PROBE_US = 1000, 1100
CALIBRATING = 1 << 12
AT_REST = (np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.array([0.0, 0.0, GRAVITY]))


class Sitl:
    """The running firmware. Use as a context: leaving it ends the program, which also ends with this process.

    binary: the program; folder: an empty or new one for its settings (eeprom.bin) and log; lines: of its CLI, typed
    before the first flight; counted: whether its clock counts the passes of a program with gyro sync (see
    `pass_clock`). stepped: whether it was built with gyro sync; version: (4, 5, x); log: the file of what it prints.
    Raises UsageError when it cannot be started, does not answer, refuses a line or is of another version.
    """

    def __init__(self, binary, folder, lines=(), counted: bool = False):
        self._program = Program(binary, folder, counted)
        self.log = self._program.log
        self._sent_s = self._heard_s = -np.inf
        self._motors = np.zeros(4)
        self._msp, self._parser = None, msp.Parser()
        require_free(MSP_PORT, "Betaflight SITL needs it: end what holds it", host="")
        self._link = UdpSockets()
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
        """Type lines of its CLI; it restarts with what they set. Raises UsageError for one that it refuses."""
        self._msp.close()
        cli.set_up(MSP_PORT, lines)
        self._program.await_end()
        self._start()

    # Stepping.

    def step(self, omega_body, q_world_body, specific_force_body, patience_s: float = ANSWER_S) -> np.ndarray:
        """Send a state and return the motor outputs (4,) in 0..1 of the pass that it starts, or that comes next.

        omega_body (3,) rad/s, q_world_body (4,), specific_force_body (3,) m/s^2. Outputs: 0 disarmed, idle..1 armed.
        Raises UsageError when the firmware has ended or does not answer.
        """
        self._send(omega_body, q_world_body, specific_force_body)
        while (motors := self._await(patience_s)) is NO_PASS:
            self._send(omega_body, q_world_body, specific_force_body)
        return self._hear(motors)

    def exchange(self, omega_body, q_world_body, specific_force_body) -> np.ndarray:
        """Send a state as in `step` and return the newest motor outputs that are there, without waiting.

        Raises UsageError when the firmware has ended or has not answered for long.
        """
        self._send(omega_body, q_world_body, specific_force_body)
        motors = self._link.newest()
        if motors is not None:
            return self._hear(motors)
        silent_s = time.monotonic() - self._heard_s
        if silent_s > LOOK_S:
            self._look(silent_s, ANSWER_S)
        return self._motors

    def _await(self, patience_s: float) -> np.ndarray:
        begun_s = time.monotonic()
        while (motors := self._link.receive(LOOK_S)) is None:
            self._look(time.monotonic() - begun_s, patience_s)
        return motors

    def _look(self, silent_s: float, patience_s: float) -> None:
        """Raise UsageError when the firmware has ended, or was silent for longer than `patience_s`."""
        self._program.check()
        if silent_s > patience_s:
            raise UsageError(f"Betaflight SITL has not answered for {patience_s:.0f} s; see {self.log}")

    def _send(self, *state) -> None:
        if time.monotonic() - self._sent_s > SILENCE_S:
            self._break_silence()
        self._sent_s = time.monotonic()
        self._link.send(state_packet(*state))

    def _hear(self, motors: np.ndarray) -> np.ndarray:
        self._motors, self._heard_s = motors, time.monotonic()
        return motors

    def rest(self, seconds: float = REST_S) -> None:
        """Send states of rest, as many as the loop passes in `seconds`, and go on until the gyro is calibrated."""
        for _ in range(round(seconds * LOOP_HZ)):
            self.step(*AT_REST)
        deadline = time.monotonic() + REST_PATIENCE_S
        while self.status().arming_disable & CALIBRATING:
            if time.monotonic() > deadline:
                raise UsageError(f"Betaflight SITL does not end its gyro's calibration; see {self.log}")
            for _ in range(round(LOOK_S * LOOP_HZ)):
                self.step(*AT_REST)

    def _break_silence(self) -> None:
        """Let the firmware take a state for its first: it drops it, and drops none of those that follow."""
        time.sleep(max(0.0, self._sent_s + FORGOTTEN_S - time.monotonic()))
        self._link.send(state_packet(*AT_REST))
        time.sleep(SETTLE_S)
        self._link.forget()
        self._heard_s = time.monotonic()

    # MSP.

    def ask(self, code: int, payload: bytes = b"") -> bytes:
        """Return the payload of the answer to an MSP request. Raises UsageError when it is refused or stays away."""
        answer = self._msp.ask(code, payload)
        if answer is None:
            raise UsageError(f"Betaflight SITL refuses MSP {code}; is it Betaflight 4.5?")
        return answer

    def status(self) -> wire.Status:
        """Return MSP_STATUS_EX."""
        return wire.decode_status(self.ask(Code.STATUS_EX))

    def send_sticks(self, channels_us) -> None:
        """Send MSP_SET_RAW_RC, at most 18 channels in the channel map's order; its acknowledgement is not awaited."""
        self.send(Code.SET_RAW_RC, wire.encode_channels(channels_us))

    def send(self, code: int, payload: bytes = b"") -> None:
        """Send an MSP request whose answer is not awaited; `heard` has it later, if nothing is asked in between."""
        self._msp.write(msp.encode(msp.Message(code, payload, msp.REQUEST)))

    def heard(self, code: int) -> list[bytes]:
        """Return the payloads of the answers to requests `code` that have come since the last call."""
        payloads = []
        while (chunk := self._msp.read()) is not None:
            messages = self._parser.feed(chunk[0])
            payloads += [one.payload for one in messages if one.code == code and one.kind == msp.REPLY]
        return payloads

    def open_port(self) -> socket.socket:
        """Return a connection to the MSP port, which lets in one client: from now on `ask` and the like fail."""
        self._msp.close()
        self._msp = None
        begun_s = time.monotonic()
        while True:
            time.sleep(LOOK_S)  # until it has noticed; a client too many is closed again
            connection = socket.create_connection((LOOPBACK, MSP_PORT), timeout=ANSWER_S)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            with contextlib.suppress(OSError):
                connection.sendall(msp.encode(msp.Message(Code.API_VERSION, kind=msp.REQUEST)))
                if connection.recv(CHUNK):
                    return connection
            connection.close()
            self._look(time.monotonic() - begun_s, START_S)

    # The program.

    def runs(self) -> bool:
        """Return whether the firmware still runs."""
        return self._program.runs()

    def inherit_priority(self) -> None:
        """Let the firmware run as urgently as the calling thread."""
        self._program.inherit_priority()

    def close(self) -> None:
        """End the firmware and give the ports back."""
        self._end()
        self._link.close()

    def _start(self) -> None:
        """Start the firmware and connect to it; again when it comes up dead, as on a busy machine one time in three.

        Its TCP server and its main thread share unguarded lists (dyad), so that a port may open and never answer. And
        its scheduler starts the rate loop only when first called within 250 us of being set up (scheduler.c: a later
        first call finds the next pass a whole period away, for ever).
        """
        for _ in range(START_TRIES):
            self._program.start()
            self._msp = self._connection()
            if self._comes_up():
                self.version = self._checked_version()
                return
            self._end()
        raise UsageError(f"Betaflight SITL does not come up, in {START_TRIES} tries; see {self.log}")

    def _comes_up(self) -> bool:
        deadline = time.monotonic() + LOOP_START_S
        try:
            while not struct.unpack_from("<H", self.ask(Code.STATUS_EX))[0]:  # period of the last pass, us
                if time.monotonic() > deadline:
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
        deadline = time.monotonic() + START_S
        while True:
            self._program.check()
            try:
                return connect(f"tcp://{LOOPBACK}:{MSP_PORT}", 0, 0.0)
            except UsageError as error:
                if time.monotonic() > deadline:
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
        """Return whether the rate loop stands while no state comes: a disarmed motor's test value stays with MSP."""
        self.stepped = False
        self.ask(SET_MOTOR, struct.pack("<8H", *[PROBE_US] * 8))
        time.sleep(LOOK_S)
        outputs = struct.unpack("<8H", self.ask(Code.MOTOR))
        self.ask(SET_MOTOR, struct.pack("<8H", *[OFF_US] * 8))
        return PROBE_US not in outputs
