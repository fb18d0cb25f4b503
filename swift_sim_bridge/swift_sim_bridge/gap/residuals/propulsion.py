"""Residuals of motors and battery: rotor speeds, voltage and electrical power."""

import numpy as np

from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.recording.recording import Recording
from swift_sim_bridge.gap.residuals import physics_replay
from swift_sim_bridge.gap.residuals.filters import Filter, apply, averaged, lagged
from swift_sim_bridge.physics import battery
from swift_sim_bridge.physics.state import Parameters, parameters_from_vehicle
from swift_sim_bridge.physics.terms import registry
from swift_sim_bridge.physics.terms.quantities import Load

BATTERY_CHANNELS = ("voltage", "current")  # on which the residuals of the battery depend


def rotor_speed_residuals(recording: Recording, low: Filter, parameters: Parameters) -> np.ndarray:
    """Return measured rotor speeds minus those that the motor commands give, (b, m, r) rad/s."""
    record = recording.motor_record
    difference = record.rotor_speed - physics_replay.rotor_speeds(parameters, record)
    on_grid = np.stack(
        [[np.interp(recording.t, record.t, rotor) for rotor in of_variant.T] for of_variant in difference]
    )
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
    cubed, found = np.sum(recording.rotor_speed**3, axis=1), []
    measured = ~recording.in_gap(*BATTERY_CHANNELS)
    for vehicle in vehicles:
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
        columns = [voltage - voltage[measured].mean()]
        if recording.has("current"):
            columns.append(recording.voltage * recording.current - power_w)
        found.append(averaged(np.stack(columns, axis=-1), recording.dt)[low.rows])
    return np.stack(found)
