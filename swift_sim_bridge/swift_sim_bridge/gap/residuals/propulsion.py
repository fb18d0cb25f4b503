"""Residuals of motors and battery: rotor speeds, voltage and electrical power."""

from dataclasses import replace

import numpy as np

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.recording.recording import Recording
from swift_sim_bridge.gap.residuals import physics_replay
from swift_sim_bridge.gap.residuals.filters import Filter, apply, averaged, lagged
from swift_sim_bridge.physics import battery
from swift_sim_bridge.physics.state import Parameters, parameters_from_vehicle
from swift_sim_bridge.physics.terms import registry
from swift_sim_bridge.physics.terms.quantities import Load

NUISANCE_STEPS = 2e-4, 1e-6, 1e-3  # of the derivatives to shift s, bend s^2 and shift s of the part `sent`
BATTERY_CHANNELS = ("voltage", "current")  # on which the residuals of the battery depend
MAX_ABOVE_FULL_V = 0.1  # by which a voltage may exceed that of a full pack: errors of its sensor and of the file


def rotor_speed_residuals(recording: Recording, low: Filter, parameters: Parameters) -> np.ndarray:
    """Return measured rotor speeds minus those that the motor commands give, (b, m, r) rad/s."""
    record = recording.motor_record
    difference = record.rotor_speed - physics_replay.rotor_speeds(parameters, record)
    return _filtered(recording, low, difference)


def row_sensitivity(recording: Recording, low: Filter, parameters: Parameters) -> np.ndarray:
    """Return the change (3, m, r) rad/s of these residuals per standard deviation of the rows' nuisance parameters.

    Args:
        recording: a recording with rows of motor commands that are slower than the loop.
        low: the filter.
        parameters: of one vehicle, (1, ...).
    """
    record, rows = recording.motor_record, recording.motor_record.rows
    steps = NUISANCE_STEPS
    moved = [rows.moved(steps[0]), rows.moved(-steps[0]), *(rows.moved(*step) for step in np.diag(steps)[1:]), rows]
    commands = [replace(record, rows=one).step_command for one in moved]
    later, earlier, *others, plain = physics_replay.rotor_speeds_under(parameters, record, commands)
    slopes = [(later - earlier) / (2.0 * steps[0])]
    slopes += [(speed - plain) / step for speed, step in zip(others, steps[1:], strict=True)]
    change = np.stack([sigma * slope for sigma, slope in zip(rows.sigma, slopes, strict=True)])
    return -_filtered(recording, low, change)


def pack_start_sensitivity(recording: Recording, low: Filter, vehicle: Vehicle) -> np.ndarray:
    """Return the change (k, m) of the voltage's residual with the state of the battery's k branches at the first row.

    What the vehicle drew before is not recorded. Each change is V per V at the start.
    """
    times = [time for time in (vehicle.battery.rc_time, vehicle.battery.rc2_time) if time]
    measured, t = ~recording.in_gap(*BATTERY_CHANNELS), recording.t - recording.t[0]
    found = [np.exp(-t / time) for time in times]
    rows = [averaged((one - one[measured].mean())[:, None], recording.dt)[low.rows, 0] for one in found]
    return np.array(rows).reshape(len(rows), len(low.rows))


def _filtered(recording: Recording, low: Filter, speed) -> np.ndarray:
    """Return rotor speeds (b, n, r) at the times of the motor record as filtered ones (b, m, r)."""
    t = recording.motor_record.t
    on_grid = np.stack([[np.interp(recording.t, t, rotor) for rotor in of_variant.T] for of_variant in speed])
    return np.moveaxis(apply(low.smooth, np.moveaxis(on_grid, -1, 0)), 0, 1)


def battery_residuals(recording: Recording, low: Filter, vehicles: list[Vehicle]) -> np.ndarray:
    """Return measured minus modelled voltage and power.

    The voltage is without its mean, because the initial charge is unknown.

    Args:
        recording: the recording.
        low: gives the times of the residuals.
        vehicles: b vehicles.

    Returns:
        (b, m, 1) V, or with a measured current (b, m, 2) V and W.
    """
    measured, found = ~recording.in_gap(*BATTERY_CHANNELS), []
    for vehicle in vehicles:
        voltage, power_w = _battery_errors(recording, vehicle)
        columns = [voltage - voltage[measured].mean()]
        if recording.has("current"):
            columns.append(power_w)
        found.append(averaged(np.stack(columns, axis=-1), recording.dt)[low.rows])
    return np.stack(found)


def voltage_above_full(recording: Recording, vehicle: Vehicle) -> float:
    """Return by how much the measured voltage exceeds on average that of a pack that is full at the first row, V.

    It is negative for a pack that was not full. No pack is fuller: a positive one is an error of the vehicle.
    """
    return float(_battery_errors(recording, vehicle)[0][~recording.in_gap(*BATTERY_CHANNELS)].mean())


def excess_above_full(recording: Recording, vehicle: Vehicle, file: Vehicle) -> float:
    """Return by how much a vehicle needs a pack fuller than full, V, beyond errors of the sensor.

    Zero where the vehicle of the file needs one, too.

    Args:
        recording: a recording with a voltage.
        vehicle: the vehicle, such as a repaired one.
        file: the vehicle of the file.
    """
    if voltage_above_full(recording, file) >= MAX_ABOVE_FULL_V:
        return 0.0
    return max(voltage_above_full(recording, vehicle) - MAX_ABOVE_FULL_V, 0.0)


def _battery_errors(recording: Recording, vehicle: Vehicle) -> tuple[np.ndarray, np.ndarray]:
    """Return measured minus modelled voltage (n,) V of a pack that is full at the first row, and power (n,) W.

    Without a measured current the power is without meaning.
    """
    cubed = np.sum(recording.rotor_speed**3, axis=1)
    parameters = parameters_from_vehicle(vehicle, np.float64, np.asarray)
    pack = parameters.battery
    power_w = vehicle.torque_coefficient * cubed / pack.efficiency + pack.avionics_w
    drawn = recording.current if recording.has("current") else power_w / recording.voltage
    charge = np.cumsum(drawn) * recording.dt
    sag = lagged(drawn, recording.dt, pack.rc_time) * pack.rc_resistance
    if pack.rc2_time:
        sag = sag + lagged(drawn, recording.dt, pack.rc2_time) * pack.rc2_resistance
    open_circuit = np.asarray(battery.open_circuit(charge, pack, None))
    load = Load(drawn, charge, tuple(recording.rotor_speed.T))
    added = np.asarray(registry.supply_voltage(load, parameters))
    voltage = recording.voltage - (open_circuit - battery.resistance(pack, None) * drawn - sag + added)
    return voltage, recording.voltage * drawn - power_w
