"""MSP of the simulated firmware: framing is robust to split and corrupt bytes, answers decode to the right values."""

import struct

import numpy as np
import pytest
from simulated_controller import ControllerRig, request, sticks

from swift_ros.betaflight import msp, read_back
from swift_ros.betaflight import msp_messages as wire
from swift_ros.betaflight.arming_flags import arming_blocks
from swift_ros.betaflight.msp_messages import Code
from swift_ros.betaflight.sticks import STICK_SIGNS, rates_from_sticks, sticks_from_rates
from swift_sim_bridge.flight_controller.arming import Block
from swift_sim_bridge.flight_controller.configuration import rates
from swift_sim_bridge.flight_controller.configuration.rates import RATES_TYPES, RateProfile
from swift_sim_bridge.flight_controller.firmware_settings import ModeSwitch


def asked(rig, code, payload=b"", version=2):
    """Return the answer to a request as `swift_ros.betaflight` parses it; None when it was refused."""
    frame = msp.encode(msp.Message(code, payload, msp.REQUEST, version))
    (message,) = msp.Parser().feed(rig.controller.feed(frame))
    assert message.code == code and message.version == version
    return message.payload if message.kind == msp.REPLY else None


def test_answers_have_the_framing_of_their_requests():
    rig = ControllerRig()
    for version in (1, 2):
        assert asked(rig, Code.FC_VARIANT, version=version) == b"BTFL"
    inner = struct.pack("<BHH", 0, Code.FC_VARIANT, 0)
    answer = rig.controller.feed(request(255, inner + bytes([msp.crc8(inner)])))
    assert answer[:3] == b"$M>" and answer[4] == 255 and b"BTFL" in answer


def test_unknown_and_invalid_requests_are_refused():
    rig = ControllerRig()
    assert asked(rig, 0x3001) is None  # MSP2_MOTOR_OUTPUT_REORDERING is not simulated
    assert asked(rig, 203, version=1) is None
    assert rig.controller.feed(sticks())[:3] == b"$M>"
    assert asked(rig, Code.SET_RAW_RC, bytes(2 * 19)) is None  # more channels than there are


def test_a_frame_split_anywhere_is_reassembled():
    rig = ControllerRig()
    whole = sticks(throttle=1234) + request(Code.RC)
    answers = b"".join(rig.controller.feed(whole[i : i + 1]) for i in range(len(whole)))
    assert [m.code for m in msp.Parser().feed(answers)] == [Code.SET_RAW_RC, Code.RC]
    rig.tick()
    assert wire.decode_channels(rig.ask(Code.RC))[3] == 1234


def test_incomplete_and_corrupt_frames_are_not_answered_and_later_frames_are():
    rig = ControllerRig()
    corrupt = bytearray(sticks(throttle=1900))
    corrupt[9] ^= 0x40
    assert rig.controller.feed(bytes(corrupt)) == b""
    assert rig.controller.feed(b"noise $M?$X" + b"\x00" * 3) == b""
    torn = sticks()[:12]
    assert rig.controller.feed(torn) == b""
    # The firmware trusts the size of an incomplete frame: it consumes the next frames as its payload.
    answers = [rig.controller.feed(sticks(throttle=1100)) for _ in range(3)]
    assert answers[-1][:3] == b"$M>"
    assert rig.controller.frames in (1, 2)
    rng = np.random.default_rng(3)
    rig.controller.feed(rng.integers(0, 256, 5000, dtype=np.uint8).tobytes() + bytes(300))
    assert rig.controller.feed(sticks())[:3] == b"$M>"


def test_the_hash_covers_the_stick_frames_and_nothing_else():
    first, second = ControllerRig(), ControllerRig()
    first.controller.feed(sticks() + request(Code.ANALOG) + sticks(roll=1501))
    second.controller.feed(sticks())
    second.controller.feed(sticks(roll=1501) + request(Code.RC))
    assert first.controller.commands_sha256 == second.controller.commands_sha256
    second.controller.feed(sticks())
    assert first.controller.commands_sha256 != second.controller.commands_sha256


def test_the_configuration_can_be_read_back():
    rig = ControllerRig()
    found = read_back.read_back(lambda code, payload=b"": asked(rig, code, payload))
    assert read_back.check(found, rig.vehicle, "msp", 3.0) == []
    assert found.box_names == ("ARM", "ANGLE", "FAILSAFE") and found.boxes == (0, 1, 27)
    assert found.channel_map == (0, 1, 3, 2, 4, 5, 6, 7)
    assert found.receiver.min_check_us == 1050 and found.receiver.rc_smoothing == 0
    assert found.failsafe.delay_s == pytest.approx(0.5)
    assert found.advanced.motor_idle == pytest.approx(0.055)
    assert found.pid.angle_limit_deg == 60 and found.reports_rotors


def test_a_firmware_without_a_switch_for_angle_mode_is_refused():
    rig = ControllerRig(modes={"ARM": ModeSwitch(1, 1700, 2100)})
    found = read_back.read_back(lambda code, payload=b"": asked(rig, code, payload))
    with pytest.raises(Exception, match="ANGLE"):
        read_back.check(found, rig.vehicle, "msp", 3.0)


def test_the_status_contains_modes_and_arming_blocks():
    rig = ControllerRig()
    rig.fly(1.0, sticks(throttle=1300, angle=2000))
    status = wire.decode_status(rig.ask(Code.STATUS_EX))
    assert set(arming_blocks(status)) == {"THROTTLE", "BOOT_GRACE_TIME", "CALIBRATING"}
    assert status.modes == 0b010 and len(Block) == status.arming_flags
    rig.arm()
    assert wire.decode_status(rig.ask(Code.STATUS_EX)).modes & 1


def test_measurements_have_the_units_and_signs_of_the_firmware():
    rig = ControllerRig()
    rig.tilt(20.0, (0.0, 1.0, 0.0))  # nose down
    rig.fly(2.0)
    attitude = wire.decode(wire.Attitude, rig.ask(Code.ATTITUDE))
    assert np.degrees([attitude.roll, attitude.pitch]) == pytest.approx([0.0, 20.0], abs=0.1)
    battery = wire.decode(wire.BatteryState, rig.ask(Code.BATTERY_STATE))
    assert (battery.cells, battery.voltage, battery.current) == (4, pytest.approx(16.4), pytest.approx(10.0))
    assert battery.drawn_ah == pytest.approx(0.1, abs=1e-3)
    assert wire.decode(wire.Analog, rig.ask(Code.ANALOG)).voltage == pytest.approx(16.4)
    rig.voltage = 15.4
    rig.fly(0.48)
    assert rig.controller.voltage == pytest.approx(15.4 + np.exp(-1), abs=0.02)  # its meter is slow


def test_multiple_requests_in_one_are_answered_together():
    rig = ControllerRig()
    answer = rig.ask(230, bytes([Code.FC_VARIANT, Code.API_VERSION]))
    assert answer == b"\x04BTFL\x03\x00\x01\x2e"


@pytest.mark.parametrize("family", RATES_TYPES)
def test_firmware_and_link_agree_on_every_rate_curve_without_shared_code(family):
    numbers = {"betaflight": (120, 60, 20), "raceflight": (37, 80, 50), "kiss": (100, 70, 30)}
    rc_rate, super_rate, expo = numbers.get(family, (15, 80, 40))
    rig = ControllerRig()
    rig.controller.rates = RateProfile(RATES_TYPES.index(family), *((n,) * 3 for n in (rc_rate, super_rate, expo)))
    curves = read_back.read_back(lambda code, payload=b"": asked(rig, code, payload)).curves
    for stick in range(1000, 2001, 37):
        theirs = rates_from_sticks(np.array([float(stick)] * 3), curves)
        ours = [
            np.radians(rates.rate_deg_s(rig.controller.rates, axis, rates.deflection_of(stick, axis, 1500)))
            for axis in range(3)
        ]
        assert theirs == pytest.approx(ours, abs=1e-9)
    wanted = np.array([2.0, -3.0, 1.5])
    flown = [
        rates.rate_deg_s(rig.controller.rates, axis, rates.deflection_of(float(stick), axis, 1500))
        for axis, stick in enumerate(sticks_from_rates(wanted, curves))
    ]
    assert np.radians(flown) == pytest.approx(wanted, abs=0.05)  # whole microseconds
    assert rates.STICK_SIGNS == STICK_SIGNS
