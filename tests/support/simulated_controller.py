"""A simulated flight controller at rest for tests: level unless a test tilts it, with ticks of 10 ms."""

import dataclasses
import struct

import numpy as np

from swift_ros import configuration, geometry
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.flight_controller.firmware import FlightController, Readings
from swift_sim_bridge.flight_controller.firmware_settings import FirmwareSettings

FOLDER = configuration.configuration_folder()
TICK_NS = 10_000_000
SET_RAW_RC = 200
# Frame channels in the order of the shipped map, AETR1234.
LEVEL = {"roll": 1500, "pitch": 1500, "throttle": 1000, "yaw": 1500}
LEVEL |= dict.fromkeys(("arm", "angle", "msp", "off"), 1000)


def shipped(**changes) -> FirmwareSettings:
    settings = configuration.load_section(FirmwareSettings, FOLDER / "simulation.yaml", "flight_controller")
    return dataclasses.replace(settings, **changes)


def request(command: int, payload: bytes = b"") -> bytes:
    """Return an MSP version 1 request, encoded here to share no code with the two sides under test."""
    body = bytes([len(payload), command]) + payload
    checksum = 0
    for byte in body:
        checksum ^= byte
    return b"$M<" + body + bytes([checksum])


def sticks(**channels) -> bytes:
    """Return an MSP_SET_RAW_RC request: centred sticks, closed throttle, switches off, except for `channels`."""
    values = LEVEL | channels
    assert len(values) == len(LEVEL)
    return request(SET_RAW_RC, struct.pack("<8H", *values.values()))


class ControllerRig:
    """A flight controller with a settable attitude and battery voltage.

    Attributes:
        controller: the flight controller.
        now_ms: ms since power-on.
        last: setpoint of the last tick.
    """

    def __init__(self, vehicle=None, **changes):
        self.vehicle = vehicle or configuration.load(Vehicle, FOLDER / "drone.yaml")
        self.q = np.array([0.0, 0.0, 0.0, 1.0])
        self.voltage = 16.4
        self.controller = FlightController(shipped(**changes), self.vehicle, self.readings())
        self.now_ms = 0
        self.last = None

    def readings(self) -> Readings:
        rotors = np.zeros(4)
        return Readings(self.q, np.zeros(3), self.voltage, 10.0, 360.0, rotors, rotors)

    def tilt(self, degrees: float, axis=(1.0, 0.0, 0.0)) -> None:
        self.q = geometry.quaternion_from_rotation_vector(np.radians(degrees) * np.array(axis))

    def tick(self, frame: bytes = b""):
        """Give it bytes, run one tick and return the setpoint."""
        if frame:
            self.controller.feed(frame)
        self.last = self.controller.update(self.now_ms * 1_000_000, self.readings())
        self.now_ms += 10
        return self.last

    def fly(self, seconds: float, frame: bytes = b""):
        """Run ticks for a time with the same frame in each; return the last setpoint."""
        for _ in range(round(100 * seconds)):
            self.tick(frame)
        return self.last

    def arm(self):
        """Wait for the grace time and arm."""
        self.fly(6.0, sticks())
        return self.fly(0.1, sticks(arm=2000))

    def ask(self, command: int, payload: bytes = b"") -> bytes:
        """Return the payload of the answer to a request."""
        answer = self.controller.feed(request(command, payload))
        assert answer[:3] == b"$M>" and answer[4] == command, answer
        return answer[5:-1]
