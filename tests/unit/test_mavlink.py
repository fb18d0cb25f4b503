"""MAVLink telemetry has the right axes and units and needs no running ground station."""

import math
import socket

import numpy as np
import pytest
from patience import PATIENCE_S
from pymavlink.dialects.v20 import common

from swift_ros import geometry, mavlink
from swift_ros.types import Odometry


def headed(yaw):
    return geometry.quaternion_from_yaw(np.asarray(yaw))


NORTH = headed(math.pi / 2)  # x east, y north: a heading to the north


def turned(q, axis, angle):
    return geometry.quaternion_multiply(q, geometry.quaternion_from_rotation_vector(angle * np.eye(3)[axis]))


def state(**fields):
    rest = {"stamp_ns": 1_500_000_000, "p_world": np.zeros(3), "q_world_body": NORTH, "v_body": np.zeros(3)}
    return Odometry(**{**rest, "omega_body": np.zeros(3), **fields})


@pytest.mark.parametrize(
    "q, roll, pitch, yaw",
    [
        (NORTH, 0, 0, 0),
        (headed(0.0), 0, 0, math.pi / 2),  # to the east
        (headed(math.pi), 0, 0, -math.pi / 2),  # to the west
        (turned(NORTH, 0, 0.3), 0.3, 0, 0),  # about the nose: right side down in both
        (turned(NORTH, 1, 0.3), 0, -0.3, 0),  # FLU: positive is nose down; FRD: nose up
        (turned(NORTH, 2, 0.3), 0, 0, -0.3),  # FLU: positive is to the left
    ],
)
def test_attitude_in_north_east_down(q, roll, pitch, yaw):
    message = mavlink.attitude(state(q_world_body=q))
    np.testing.assert_allclose((message.roll, message.pitch, message.yaw), (roll, pitch, yaw), atol=1e-9)
    assert message.time_boot_ms == 1500


def test_the_attitude_rotates_body_vectors_as_the_vehicle_does():
    random = np.random.default_rng(0)
    for _ in range(20):
        q, v_flu = geometry.normalize(random.normal(size=4)), random.normal(size=3)
        in_ned = geometry.rotate(mavlink.q_ned_frd(q), mavlink.frd_from_flu(v_flu))
        np.testing.assert_allclose(in_ned, mavlink.ned_from_enu(geometry.rotate(q, v_flu)), atol=1e-12)


def test_rates_position_and_velocity_are_converted():
    flying = state(p_world=np.array([1, 2, 3]), v_body=np.array([5, 1, -2]), omega_body=np.array([0.1, 0.2, 0.3]))
    rates = mavlink.attitude(flying)
    np.testing.assert_allclose((rates.rollspeed, rates.pitchspeed, rates.yawspeed), (0.1, -0.2, -0.3))
    position = mavlink.local_position(flying)
    np.testing.assert_allclose((position.x, position.y, position.z), (2, 1, -3))
    # nose to the north: forward is north, left is west, up is up
    np.testing.assert_allclose((position.vx, position.vy, position.vz), (5, -1, 2), atol=1e-12)


def test_the_heartbeat_contains_arming_and_failsafe():
    armed = mavlink.heartbeat(armed=True, failsafe=False)
    assert armed.base_mode & common.MAV_MODE_FLAG_SAFETY_ARMED and armed.system_status == common.MAV_STATE_ACTIVE
    disarmed = mavlink.heartbeat(armed=False, failsafe=False)
    assert not disarmed.base_mode & common.MAV_MODE_FLAG_SAFETY_ARMED
    assert mavlink.heartbeat(armed=True, failsafe=True).system_status == common.MAV_STATE_CRITICAL


def receiver(port=0):
    listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    listener.bind(("127.0.0.1", port))
    listener.settimeout(PATIENCE_S)
    return listener, f"udpout:127.0.0.1:{listener.getsockname()[1]}"


def test_a_ground_station_decodes_what_is_sent():
    listener, endpoint = receiver()
    station, decoder = mavlink.Station(endpoint, 7), common.MAVLink(None)
    long = "gate 3 of lap 2 passed with a margin of 0.41 m after 12.345 s of the race"
    sent = [
        mavlink.heartbeat(True, False),
        mavlink.attitude(state()),
        mavlink.local_position(state()),
        *mavlink.battery_messages(mavlink.Battery(15.93, 42.5, 0.83)),
        *mavlink.status_text(mavlink.NOTICE, long, 5),
    ]
    station.send(sent)
    received = [decoder.decode(bytearray(listener.recv(300))) for _ in sent]
    assert [message.get_type() for message in received] == [
        "HEARTBEAT",
        "ATTITUDE",
        "LOCAL_POSITION_NED",
        "SYS_STATUS",
        "BATTERY_STATUS",
        "STATUSTEXT",
        "STATUSTEXT",
    ]
    assert {message.get_srcSystem() for message in received} == {7}
    assert [message.get_seq() for message in received] == list(range(len(sent)))
    assert (received[3].voltage_battery, received[3].current_battery, received[3].battery_remaining) == (
        15930,
        4250,
        83,
    )
    assert (
        received[5].text + received[6].text == long
        and received[5].id == received[6].id == 5
        and received[6].chunk_seq == 1
    )
    station.close()
    listener.close()


def test_unknown_battery_values_are_reported_as_unknown():
    status, pack = mavlink.battery_messages(mavlink.Battery(math.nan, math.nan, math.nan))
    assert (status.voltage_battery, status.current_battery, status.battery_remaining) == (65535, -1, -1)
    assert pack.voltages[0] == 65535 and pack.battery_remaining == -1


@pytest.mark.parametrize("value", [1e-300, -1e300, math.inf, -math.inf, math.nan])
def test_absurd_values_are_sent_as_the_largest_that_fit(value):
    listener, endpoint = receiver()
    station = mavlink.Station(endpoint, 7)
    odd = Odometry(0, np.full(3, value), np.array([value, 0.0, 0.0, 1.0]), np.full(3, value), np.full(3, value))
    battery = mavlink.battery_messages(mavlink.Battery(value, value, value))
    station.send([mavlink.attitude(odd), mavlink.local_position(odd), *battery])
    decoder = common.MAVLink(None)
    received = [decoder.decode(bytearray(listener.recv(300))) for _ in range(4)]
    rate = received[0].rollspeed
    assert (
        math.isnan(rate)
        if math.isnan(value)
        else math.isclose(rate, np.clip(value, -3.4e38, 3.4e38), abs_tol=0.01, rel_tol=0.01)
    )
    assert received[2].battery_remaining in (-1, 0, 100)


def test_a_ground_station_may_be_missing_or_start_late():
    listener, endpoint = receiver()
    port = listener.getsockname()[1]
    listener.close()
    station = mavlink.Station(endpoint, 1)
    for _ in range(50):
        station.send([mavlink.heartbeat(False, False)])
    listener, _ = receiver(port)
    station.send([mavlink.heartbeat(True, False)])
    received = common.MAVLink(None).decode(bytearray(listener.recv(300)))
    assert received.get_seq() == 50 and received.base_mode & common.MAV_MODE_FLAG_SAFETY_ARMED
    assert station.lost == 0
    assert station._socket.getsockname()[0] == "127.0.0.1"  # not 0.0.0.0, which receives from every interface
    station.close()
    listener.close()


@pytest.mark.parametrize("endpoint", ["", "127.0.0.1:14550", "udpin:127.0.0.1:14550", "udpout:127.0.0.1", "udpout::1"])
def test_an_invalid_endpoint_is_refused_with_an_example(endpoint):
    with pytest.raises(ValueError, match="udpout:127.0.0.1:14550"):
        mavlink.Station(endpoint, 1)
