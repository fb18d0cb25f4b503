"""The simulator's report describes the last flight, and needs no more memory in a long run."""

from types import SimpleNamespace

import pytest

from swift_sim_bridge.bridge import report

TICK_NS = 10_000_000


@pytest.fixture
def vehicle():
    """Return a vehicle whose hashes and battery follow its tick."""
    vehicle = SimpleNamespace(tick=0, crash=None, impact_m_s=None, speed_m_s=0.0, firmware=None)
    vehicle.crash_s = vehicle.disarmed_s = None
    vehicle.flight_controller = SimpleNamespace(commands_sha256="0")
    vehicle.truth_sha256, vehicle.pack = "0", (0.0, 0.0, None)
    vehicle.thrust_to_weight = lambda pack: 4.0 - pack[0]
    return vehicle


def fly(found, vehicle, ticks):
    for _ in range(ticks):
        found.note(vehicle.tick * TICK_NS)
        vehicle.tick += 1
        vehicle.flight_controller.commands_sha256 = str(vehicle.tick)
        vehicle.pack = (1e-5 * vehicle.tick, 0.0, None)


def test_the_report_ends_with_the_tick_before_the_end(vehicle):
    found = report.RaceReport(3, vehicle)
    fly(found, vehicle, 100)
    found.end(50 * TICK_NS)
    assert found.as_dict()["ticks"] == 49 and found.as_dict()["msp_sha256"] == "49"


def test_a_long_run_keeps_a_bounded_number_of_marks_and_reports_the_last_flight(vehicle):
    found = report.RaceReport(3, vehicle)
    fly(found, vehicle, 3 * report.MARKS)
    assert len(found._marks) == report.MARKS
    found.end((vehicle.tick - 10) * TICK_NS)
    fly(found, vehicle, report.MARKS)
    found.arm()
    start = vehicle.pack[0]
    fly(found, vehicle, 200)
    found.end((vehicle.tick - 1) * TICK_NS)
    last = found.as_dict()
    assert last["ticks"] == vehicle.tick - 2
    assert last["thrust_to_weight"] == [round(4.0 - start, 4), round(4.0 - 1e-5 * (vehicle.tick - 2), 4)]
