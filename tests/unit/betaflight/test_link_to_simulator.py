"""The link with the simulated flight controller, which shares no code with it: both follow the same firmware."""

import math
from dataclasses import replace

import numpy as np
import pytest
from link_story import VEHICLE, settings
from simulated_controller import ControllerRig

from swift_ros.betaflight import read_back, sticks
from swift_ros.betaflight.link import MspLink, Phase
from swift_ros.betaflight.pack import voltage_under
from swift_ros.betaflight.watchdog import ClockReading
from swift_ros.types import BodyRateThrust, Odometry


class Flight:
    """A link in lockstep with a simulated flight controller at rest."""

    def __init__(self, **firmware):
        self.rig = ControllerRig(**firmware)
        self.found = read_back.read_back(self._ask)
        receiver = firmware.get("receiver", "msp")
        blocks = read_back.check(self.found, VEHICLE, receiver, 3.0)
        self.link = MspLink(self.found, VEHICLE, settings(receiver=receiver), True, blocks)
        self.link.take_race_state("idle", 0)
        self.thrust, self.omega = 0.0, np.zeros(3)
        self.pilot = True

    @property
    def now(self) -> ClockReading:
        now_s = 1e-3 * self.rig.now_ms
        return ClockReading(self.rig.now_ms * 1_000_000, now_s, working_s=now_s)

    def _ask(self, code, payload=b""):
        try:
            return self.rig.ask(code, payload)
        except AssertionError:  # refused
            return None

    def play(self, seconds: float):
        """Return the setpoint of the last tick."""
        for _ in range(round(100 * seconds)):
            state = Odometry(self.now.ros_ns, np.zeros(3), self.rig.q, np.zeros(3), np.zeros(3))
            self.link.take_state(state, self.now)
            self.link.take_judge_message(self.now)
            frame = None
            if self.pilot:
                self.link.take_command(BodyRateThrust(self.now.ros_ns, self.thrust, self.omega), self.now)
                frame = self.link.answer(self.now)
            frame = frame or self.link.tick(self.now)
            if frame:
                answers = self.rig.controller.feed(frame + self.link.requests(self.now))
                self.link.receive(answers, self.now.steady_s)
            setpoint = self.rig.tick()
        return setpoint

    def race(self):
        self.play(6.0)
        self.link.take_race_state("armed", self.now.ros_ns)
        self.play(0.5)
        self.link.take_race_state("racing", self.now.ros_ns)
        return self.play(0.1)


@pytest.fixture(scope="module")
def flying():
    flight = Flight()
    flight.race()
    return flight


def test_arming_succeeds_and_before_the_grace_time_the_reason_is_reported():
    flight = Flight()
    flight.play(0.3)
    assert any("GRACE" in block for block in flight.link.arming_blocks(flight.now))
    setpoint = flight.race()
    assert flight.link.phase is Phase.RACING and flight.link.armed and setpoint.armed
    assert flight.link.session.frames_bad == 0


RATES = [(3, 0, 0), (0, -7.5, 0), (0, 0, 3.9), (-9.9, 4.2, -1.3), (0.02, 0.02, 0.02), (0, 0, 0)]


@pytest.mark.parametrize("omega", RATES)
def test_the_flown_rates_are_the_commanded_rates(flying, omega):
    flying.thrust, flying.omega = 15.0, np.array(omega, dtype=float)
    setpoint = flying.play(0.05)
    step = np.diff(flying.found.curves.table, axis=1)
    nearest = [np.interp(abs(w), flying.found.curves.table[i, 501:], step[i, 500:]) for i, w in enumerate(omega)]
    assert np.all(np.abs(setpoint.omega_body - omega) <= 0.51 * np.array(nearest) + 1e-9)


@pytest.mark.parametrize("thrust", [4.0, 9.81, 20.0, 34.0])
def test_the_flown_throttle_gives_the_commanded_thrust(flying, thrust):
    flying.thrust, flying.omega = thrust, np.zeros(3)
    setpoint = flying.play(0.05)
    command = flying.found.motor_idle + (1 - flying.found.motor_idle) * setpoint.throttle
    c0, c1, c2, c3, c4 = VEHICLE.motor.map.coefficients
    voltage = float(voltage_under(np.asarray(thrust), flying.link._pack.source_voltage, VEHICLE))
    root = math.sqrt(command)
    speed = c0 + c1 * voltage + c2 * root + c3 * command + c4 * voltage * root
    assert 4 * VEHICLE.thrust_coefficient * speed**2 / VEHICLE.mass == pytest.approx(thrust, rel=0.005, abs=0.03)


def test_the_end_of_the_race_levels_in_angle_mode_and_disarms():
    flight = Flight()
    flight.race()
    flight.thrust = 9.81
    flight.play(0.3)
    flight.link.take_race_state("finished", flight.now.ros_ns)
    flight.rig.tilt(20.0)
    setpoint = flight.play(0.2)
    assert setpoint.omega_body[0] < -1.0 and setpoint.armed  # rotates back to level
    flight.rig.tilt(0.0)
    assert not flight.play(1.6).armed and flight.link.phase is Phase.OVER


def test_a_silent_policy_triggers_the_failsafe_of_the_link_and_a_silent_link_that_of_the_firmware():
    flight = Flight()
    flight.race()
    flight.thrust = 9.81
    flight.play(0.3)
    flight.pilot = False
    flight.play(0.12)
    assert flight.link.failsafe and "ANGLE" in flight.link.modes
    assert not flight.play(1.7).armed

    flight = Flight()
    flight.race()
    end_s = read_back.failsafe_end_s(flight.found.failsafe)
    setpoint = flight.rig.fly(end_s - 0.05)
    assert setpoint.armed and not flight.rig.fly(0.2).armed


def test_other_rate_curves_are_read_back_too():
    for kind, rc, top in (("actual", [200, 200, 150], [700, 700, 400]), ("quick", [1.2, 1.2, 1.0], [700, 700, 400])):
        changes = {"rates_type": kind, "rc_rate": rc, "super_rate": top, "expo": [0.3] * 3}
        vehicle = replace(VEHICLE, controller=VEHICLE.controller | changes)
        flight = Flight(vehicle=vehicle)
        flight.race()
        flight.omega = np.array([4.0, -6.0, 2.0])
        np.testing.assert_allclose(flight.play(0.05).omega_body, flight.omega, atol=0.03)
        assert sticks.FAMILIES.index(kind) == flight.found.rates.rates_type


RADIO = [1500, 1500, 1000, 1500, 1000, 1000, 1000, 1000]  # AETR, ARM, ANGLE, MSP OVERRIDE, FAILSAFE


def radio(flight, *, arm: bool, override: bool):
    flight.rig.controller.receiver.radio = [*RADIO[:4], 1000 + 1000 * arm, 1000, 1000 + 1000 * override, 1000]
    return flight


def test_under_override_the_radio_arms_the_node_flies_and_the_switch_returns_the_sticks():
    flight = radio(Flight(receiver="msp_override", override_channels="AETR2"), arm=False, override=True)
    flight.play(6.0)
    assert flight.link.arming_blocks(flight.now) == ["PILOT: ARM is off on the pilot's radio"]
    radio(flight, arm=True, override=True)
    flight.thrust, flight.omega = 12.0, np.array([2.0, -1.0, 0.5])
    setpoint = flight.race()
    assert flight.link.phase is Phase.RACING and setpoint.armed
    np.testing.assert_allclose(setpoint.omega_body, flight.omega, atol=0.01)
    flight.pilot = False
    setpoint = flight.play(2.5)
    assert flight.link.phase is Phase.OVER and setpoint.armed and setpoint.throttle == 0  # only the pilot can disarm
    assert not radio(flight, arm=False, override=True).play(0.1).armed


def test_an_override_mask_without_the_angle_switch_is_reported():
    flight = radio(Flight(receiver="msp_override", override_channels="AETR"), arm=True, override=True)
    flight.play(6.0)
    assert any("msp_override_channels_mask" in block for block in flight.link.arming_blocks(flight.now))
