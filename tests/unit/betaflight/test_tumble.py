"""A vehicle with two motors in the wrong order tumbles; its flight ends with a sentence that says so."""

import shutil
from functools import partial

import numpy as np
import pytest
import yaml
from link_story import Story, settings

from swift_ros import configuration
from swift_ros.betaflight import msp, read_back
from swift_ros.betaflight.link import MspLink, Phase
from swift_ros.betaflight.watchdog import ClockReading
from swift_ros.types import BodyRateThrust
from swift_ros.vehicle import GRAVITY
from swift_sim_bridge.simulation.simulated_vehicle import TICK_NS, SimulatedVehicle

FOLDER = configuration.configuration_folder()


class Flight:
    """A link that flies a simulated vehicle by its true state, in lockstep."""

    def __init__(self, folder):
        self.vehicle = SimulatedVehicle(folder, 1000)
        found = read_back.read_back(self._ask)
        self.link = MspLink(found, self.vehicle.vehicle, settings(), lockstep=True)
        self.link.take_race_state("idle", 0)
        self.thrust, self.omega = 0.0, np.zeros(3)

    def _ask(self, code, payload=b""):
        request = msp.encode(msp.Message(code, payload, msp.REQUEST))
        answer = next(iter(msp.Parser().feed(self.vehicle.flight_controller.feed(request))))
        return answer.payload if answer.kind == msp.REPLY else None

    def play(self, seconds: float, race_state: str = ""):
        """Announce a state of the race and fly for a time, or until the flight is over."""
        if race_state:
            self.link.take_race_state(race_state, self.vehicle.tick * TICK_NS)
        for _ in range(round(100 * seconds)):
            now_s = 0.01 * self.vehicle.tick
            now = ClockReading(self.vehicle.tick * TICK_NS, now_s, working_s=now_s)
            self.link.take_state(self.vehicle.sense(now.ros_ns).truth, now)
            self.link.take_judge_message(now)
            self.link.take_command(BodyRateThrust(now.ros_ns, self.thrust, self.omega), now)
            frame = self.link.answer(now)
            assert frame is not None
            answers = self.vehicle.flight_controller.feed(frame + self.link.requests(now))
            self.link.receive(answers, now_s)
            self.vehicle.advance()
            if self.link.phase is Phase.OVER:
                break
        return self

    def race(self):
        """Arm, start, and take off with turns about all axes."""
        self.play(6.0).play(0.5, "armed")
        self.thrust, self.omega = 1.3 * GRAVITY, np.array([2.0, -1.0, 0.5])
        return self.play(1.0, "racing")


def folder_with(tmp_path, order):
    """Return a configuration folder whose rotors are in another order than the firmware's."""
    folder = tmp_path / "config"
    shutil.copytree(FOLDER, folder)
    content = yaml.safe_load((FOLDER / "drone.yaml").read_text())
    content["rotors"] = [content["rotors"][i] for i in order]
    (folder / "drone.yaml").write_text(yaml.safe_dump(content))
    return folder


@pytest.mark.parametrize("order", [(1, 0, 2, 3), (3, 1, 2, 0)], ids=["right", "diagonal"])
def test_a_vehicle_with_two_motors_swapped_ends_its_flight_as_tumbling(tmp_path, monkeypatch, order):
    # The checks refuse such a file; the wires of a real vehicle can be swapped although its file is right.
    monkeypatch.setattr(configuration, "load", configuration.load_unchecked)
    flight = Flight(folder_with(tmp_path, order)).race()
    [(level, text)] = flight.link.events
    assert level == "error" and flight.link.failsafe and flight.link.phase is Phase.OVER
    assert "the vehicle tumbles: its body rate about " in text and "check the order of the motors" in text
    assert text.endswith("the motors stop at once")


def test_a_sound_vehicle_does_not_tumble():
    flight = Flight(FOLDER).race()
    assert not flight.link.events and flight.link.phase is Phase.RACING


def test_a_short_knock_is_no_tumble():
    story = Story().race()
    knock = partial(story.link._tumble.update, np.array([0.0, 30.0, 0.0]), np.zeros(3))
    knock(0.0), knock(0.1)
    story.link._tumble.update(np.zeros(3), np.zeros(3), 0.12)
    knock(0.2)
    assert not story.link._tumble.fault(0.2)
