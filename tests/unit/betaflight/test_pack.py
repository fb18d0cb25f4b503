"""The pack observer recovers the voltage under load from a slow voltmeter while the thrust changes in steps."""

import numpy as np
import pytest
from link_story import VEHICLE

from swift_ros.betaflight.pack import PackObserver, voltage_under
from swift_ros.vehicle import rotor_speed_for_thrust

METER_S = 0.48


def test_the_voltage_under_load_solves_the_equation_of_the_battery():
    thrust = np.array([0.0, 9.8, 25.0, 40.0])
    voltage = voltage_under(thrust, 16.4, VEHICLE)
    speed = rotor_speed_for_thrust(thrust, VEHICLE.mass, VEHICLE.thrust_coefficient)
    battery = VEHICLE.battery
    power = 4 * VEHICLE.torque_coefficient * speed**3 / battery.efficiency + battery.avionics_w
    np.testing.assert_allclose(voltage, 16.4 - battery.resistance * power / voltage)


@pytest.mark.parametrize("resistance_share", [1.0, 1.3])
def test_the_voltage_is_predicted_despite_a_slow_voltmeter(resistance_share):
    """The thrust steps every 0.3 s; the voltmeter alone would be wrong by several tenths of a volt."""
    random, pack = np.random.default_rng(3), PackObserver(VEHICLE, METER_S)
    source, reading, errors, meter_errors = 16.6, 16.6, [], []
    thrust = 0.0
    for tick in range(2000):
        time_s = 0.01 * tick
        source -= 0.00015  # discharged by 0.3 V in 20 s
        if tick % 30 == 0 and tick > 100:
            thrust = random.uniform(5.0, 38.0)
        sag = 16.6 - voltage_under(np.asarray(thrust), 16.6, VEHICLE)
        voltage = source - resistance_share * sag
        reading += (voltage - reading) * (1 - np.exp(-0.01 / METER_S))
        if tick % 2 == 0:
            pack.measure(round(reading, 2), time_s)
        predicted = pack.predict(thrust, time_s)
        if tick > 500:
            errors.append(predicted - voltage)
            meter_errors.append(reading - voltage)
    assert np.std(meter_errors) > 0.15
    assert np.sqrt(np.mean(np.square(errors))) < (0.03 if resistance_share == 1 else 0.09)


def test_without_a_reading_there_is_no_voltage():
    pack = PackObserver(VEHICLE, METER_S)
    pack.measure(0.0, 1.0)
    assert pack.predict(9.8, 1.0) is None and pack.source_voltage is None
    pack.measure(16.0, 2.0)
    assert 15.7 < pack.predict(9.8, 2.0) < 16.0
