"""The pack observer: a planted voltage and a slow voltmeter, thrust that jumps, and the voltage under it."""

import numpy as np
import pytest
from link_story import VEHICLE

from swift_ros.betaflight.pack import Pack, voltage_under
from swift_ros.vehicle import rotor_speed_for_thrust

METER_S = 0.48


def test_the_voltage_under_load_solves_the_packs_equation():
    thrust = np.array([0.0, 9.8, 25.0, 40.0])
    voltage = voltage_under(thrust, 16.4, VEHICLE)
    speed = rotor_speed_for_thrust(thrust, VEHICLE.mass, VEHICLE.thrust_coefficient)
    battery = VEHICLE.battery
    power = 4 * VEHICLE.torque_coefficient * speed**3 / battery.efficiency + battery.avionics_w
    np.testing.assert_allclose(voltage, 16.4 - battery.resistance * power / voltage)


@pytest.mark.parametrize("resistance_share", [1.0, 1.3])
def test_a_slow_voltmeter_is_seen_through(resistance_share):
    """Thrust jumps every 0.3 s; the meter alone would be off by several tenths of a volt."""
    random, pack = np.random.default_rng(3), Pack(VEHICLE, METER_S)
    source, shown, errors, meter_errors = 16.6, 16.6, [], []
    thrust = 0.0
    for tick in range(2000):
        time_s = 0.01 * tick
        source -= 0.00015  # discharged by 0.3 V in 20 s
        if tick % 30 == 0 and tick > 100:
            thrust = random.uniform(5.0, 38.0)
        sag = 16.6 - voltage_under(np.asarray(thrust), 16.6, VEHICLE)
        voltage = source - resistance_share * sag
        shown += (voltage - shown) * (1 - np.exp(-0.01 / METER_S))
        if tick % 2 == 0:
            pack.measure(round(shown, 2), time_s)
        predicted = pack.load(thrust, time_s)
        if tick > 500:
            errors.append(predicted - voltage)
            meter_errors.append(shown - voltage)
    assert np.std(meter_errors) > 0.15
    assert np.sqrt(np.mean(np.square(errors))) < (0.03 if resistance_share == 1 else 0.09)


def test_without_a_reading_there_is_no_voltage():
    pack = Pack(VEHICLE, METER_S)
    pack.measure(0.0, 1.0)
    assert pack.load(9.8, 1.0) is None and pack.source is None
    pack.measure(16.0, 2.0)
    assert 15.7 < pack.load(9.8, 2.0) < 16.0
