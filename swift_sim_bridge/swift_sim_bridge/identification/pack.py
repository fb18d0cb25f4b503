"""The battery pack: voltage by current, and current by the rotors' power (Methods, battery).

U = full - slope charge/capacity - resistance I - U_rc, with U_rc the low-pass filtered current; I U = sum of
torque_coefficient Omega^3 / efficiency + avionics. Every flight is assumed to start with a full pack; the state of its
RC branch then is a nuisance coefficient. A second, faster branch keeps the file's values: a flight does not distinguish
two.
"""

from dataclasses import dataclass, replace

import numpy as np

from swift_ros.recording.flight_table import FlightTable
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.identification import grid
from swift_sim_bridge.identification.advice import manoeuvre
from swift_sim_bridge.identification.regression import Coefficient, NotMeasured, Problem
from swift_sim_bridge.physics.battery import UNITS
from swift_sim_bridge.physics.state import parameters_from_vehicle
from swift_sim_bridge.physics.terms import registry
from swift_sim_bridge.physics.terms.quantities import Load

STEP_S = 0.05  # s over which voltage and current are averaged: faster, only the resistance acts
USEFUL_SHARE = 0.01  # of voltage and of full power: largest useful standard error of the prediction
NOT_FITTED = ("open_circuit_curve", "energy", "temperature_slope")  # keys beside which the pack is not fitted


@dataclass(frozen=True)
class _Pack:
    """One flight in m steps.

    Attributes:
        t: (m,) s.
        dt: (m,) s.
        voltage: (m,) V.
        current: (m,) A.
        mechanical_w: (m,) W; NaN without rotor speeds.
        charge: (m,) A s drawn up to the middle of the step.
        name: of the flight.
        branch: (m,) V over the second RC branch, less what an equation of the vehicle file adds.
    """

    t: np.ndarray
    dt: np.ndarray
    voltage: np.ndarray
    current: np.ndarray
    mechanical_w: np.ndarray
    charge: np.ndarray
    name: str
    branch: np.ndarray | float = 0.0


def problem(tables: list[FlightTable], vehicle: Vehicle, torque_share: float = 0.0) -> Problem:
    """Return the problem of the vehicle's `battery` section.

    Args:
        tables: the flights.
        vehicle: the vehicle.
        torque_share: relative standard error of the torque coefficient, on which the efficiency depends.

    Raises:
        NotMeasured: the flights lack a channel, or the pack has keys that are not fitted.
    """
    not_fitted = [key for key in NOT_FITTED if getattr(vehicle.battery, key)]
    if not_fitted:
        raise NotMeasured(
            f"the file's pack has {', '.join(not_fitted)}, beside which nothing is fitted; remove it first"
        )
    measured_current = all("current" in table for table in tables)
    packs = [_pack(table, vehicle, measured_current) for table in tables]
    powered = measured_current and all(np.isfinite(pack.mechanical_w).all() for pack in packs)
    channels = [("voltage", "V")] + ([("electrical power", "W")] if powered else [])
    measured, channel, cluster, t, begin = [], [], [], [], 0
    for pack in packs:
        seconds = begin + np.floor(pack.t - pack.t[0]).astype(int)
        for i, values in enumerate((pack.voltage, pack.voltage * pack.current)[: len(channels)]):
            measured.append(values)
            channel.append(np.full(len(values), i))
            cluster.append(seconds)
            t.append(pack.t)
        begin = seconds[-1] + 3  # clusters of two flights are not adjacent

    def linearise(theta):
        blocks = [
            block
            for i, pack in enumerate(packs)
            for block in _predict(pack, theta, vehicle.battery.capacity, powered, len(UNITS) + 1 + i)
        ]
        return tuple(np.concatenate(parts) for parts in zip(*blocks, strict=True))

    notes = (
        ()
        if measured_current
        else ("no current was recorded: it is computed from the rotors' power with the file's efficiency",)
    )
    arrays = map(np.concatenate, (measured, channel, cluster, t))
    share = Coefficient("rotors' power over the file's", "", 1.0, np.inf, prior=max(torque_share, 1e-6))
    coefficients = (*_coefficients(vehicle), share, *map(_memory, packs))
    return Problem("battery", coefficients, tuple(channels), *arrays, linearise, notes)


def voltage_at(table: FlightTable, vehicle: Vehicle, t) -> np.ndarray:
    """Return the supply voltage (n,) V at times t (n,) s.

    Between the samples of a slow voltmeter the ohmic drop follows the rotors' power. Without a voltage the reference
    voltage is returned.
    """
    if "voltage" not in table:
        return np.full(len(t), vehicle.battery.reference_voltage)
    measured = table["voltage"]
    plain = grid.at(measured, t)
    if measured.rate_hz > 1.0 / STEP_S or "rotor_speed" not in table:
        return plain
    battery = vehicle.battery
    electrical = _mechanical_w(table, vehicle, t) / battery.efficiency + battery.avionics_w
    drop = battery.resistance * electrical / plain
    return plain - drop + np.interp(t, measured.t, np.interp(measured.t, t, drop))


def _mechanical_w(table: FlightTable, vehicle: Vehicle, t) -> np.ndarray:
    """Return the mechanical power (n,) W of the rotors at times t (n,) s."""
    return vehicle.torque_coefficient * np.sum(grid.at(table["rotor_speed"], t) ** 3, axis=1)


def _pack(table: FlightTable, vehicle: Vehicle, measured_current: bool) -> _Pack:
    """Return a flight in steps. Raises NotMeasured when it lacks a channel."""
    if "voltage" not in table:
        raise NotMeasured(f"{table.name} has no voltage (vbat)")
    if not measured_current and "rotor_speed" not in table:
        raise NotMeasured(f"{table.name} has neither current (ibat) nor rotor speeds")
    meters = ["voltage", "current"] if measured_current else ["voltage"]
    used = [*meters, "rotor_speed"] if "rotor_speed" in table else meters
    t, per_step = _times(table, meters, used)
    if len(t) < 2 * per_step:
        raise NotMeasured(f"in {table.name} {', '.join(used)} hardly overlap in time")
    speeds = "rotor_speed" in table
    mechanical_w = _mechanical_w(table, vehicle, t) if speeds else np.full(len(t), np.nan)
    voltage = grid.at(table["voltage"], t)
    if measured_current:
        current = grid.at(table["current"], t)
    else:
        current = (mechanical_w / vehicle.battery.efficiency + vehicle.battery.avionics_w) / voltage
    charge = np.concatenate([[0.0], np.cumsum(0.5 * (current[1:] + current[:-1]) * np.diff(t))])
    stacked = np.stack([t, voltage, current, mechanical_w, charge], axis=-1)
    whole = len(t) // per_step
    steps = stacked[: whole * per_step].reshape(whole, per_step, -1).mean(axis=1)
    good = grid.known(table, used, steps[:, 0])
    arrays = (steps[:, 0], np.gradient(steps[:, 0]), *steps[:, 1:].T)
    end = len(good) if good.all() else int(np.argmin(good))  # the charge drawn in a gap is unknown
    if end < 2:
        raise NotMeasured(f"{table.name} has voltage and current only in single samples")
    pack, battery = _Pack(*(array[:end] for array in arrays), table.name), vehicle.battery
    cubed = np.nan_to_num(pack.mechanical_w) / vehicle.torque_coefficient
    load = Load(pack.current, pack.charge, (np.cbrt(cubed),))
    branch = -np.asarray(registry.supply_voltage(load, parameters_from_vehicle(vehicle, np.float64)))
    if battery.rc2_resistance:
        branch = branch + battery.rc2_resistance * _lagged(pack, battery.rc2_time, 0.0)[0]
    return replace(pack, branch=branch)


def _times(table: FlightTable, meters: list[str], used: list[str]) -> tuple[np.ndarray, int]:
    """Return the times (n,) s at which the channels are read, and how many of them are averaged.

    A slow meter is read at its time stamps, without averaging; otherwise the channels are read on a dense grid.
    """
    t = grid.uniform_times(table, *used)
    slowest = table[min(meters, key=lambda name: table[name].rate_hz)]
    if len(t) and slowest.rate_hz < 2.0 / STEP_S:
        return slowest.t[(slowest.t >= t[0]) & (slowest.t <= t[-1])], 1
    return t, max(1, round(STEP_S / (t[1] - t[0]))) if len(t) > 1 else 1


def _coefficients(vehicle: Vehicle) -> tuple[Coefficient, ...]:
    """Return the coefficients of the pack with their useful standard errors."""
    battery = vehicle.battery
    volts = USEFUL_SHARE * battery.reference_voltage
    most_w = len(vehicle.rotors) * vehicle.torque_coefficient * vehicle.rotor_speed_range[1] ** 3 / battery.efficiency
    ohms = volts / (most_w / battery.reference_voltage)
    tolerances = {
        "open_circuit_full": volts,
        "open_circuit_slope": 2.0 * volts,
        "resistance": ohms,
        "rc_resistance": ohms,
        "rc_time": 0.3 * battery.rc_time,
        "efficiency": 3.0 * USEFUL_SHARE * battery.efficiency,
        "avionics_w": USEFUL_SHARE * most_w,
    }
    low = {
        "rc_time": 0.1,
        "rc_resistance": 0.02 * battery.rc_resistance,
        "efficiency": 0.05,
    }  # at 0 rc_time would have no effect
    return tuple(
        Coefficient(
            f"battery.{key}",
            unit,
            getattr(battery, key),
            tolerances[key],
            manoeuvre(key, vehicle),
            ("battery", key),
            low=low.get(key, 0.0),
            high=1.0 if key == "efficiency" else np.inf,
        )
        for key, unit in UNITS.items()
    )


def _memory(pack: _Pack) -> Coefficient:
    """Return the coefficient of the RC branch's state at the first sample of a flight.

    It is expressed as the steady current that gives this state: from zero to the current drawn then.
    """
    half = 0.5 * max(pack.current[0], 0.1)
    return Coefficient(f"current before {pack.name}", "A", half, np.inf, prior=half)


def _predict(pack: _Pack, theta, capacity: float, powered: bool, mine: int):
    """Return (predicted (m,), derivative (m, k)) of the voltage, and of the electrical power if `powered`."""
    full, slope, resistance, rc_resistance, rc_time, efficiency, avionics_w, rotors = theta[: len(UNITS) + 1]
    before, nothing, one = theta[mine], np.zeros_like(pack.t), np.ones_like(pack.t)
    lagged, remembered = _lagged(pack, rc_time, before)
    step = 1e-4 * rc_time
    later, sooner = (_lagged(pack, rc_time + sign * step, before)[0] for sign in (1.0, -1.0))
    share = pack.charge / capacity
    voltage = full - slope * share - resistance * pack.current - rc_resistance * lagged - pack.branch
    columns = [one, -share, -pack.current, -lagged, -rc_resistance * (later - sooner) / (2.0 * step), nothing, nothing]
    columns += [nothing] * (len(theta) - len(columns))
    columns[mine] = -rc_resistance * remembered
    blocks = [(voltage, np.stack(columns, axis=-1))]
    if powered:
        columns = [nothing] * len(theta)
        power_w = rotors * pack.mechanical_w / efficiency
        columns[5], columns[6], columns[7] = -power_w / efficiency, one, power_w / rotors
        blocks.append((power_w + avionics_w, np.stack(columns, axis=-1)))
    return blocks


def _lagged(pack: _Pack, rc_time: float, before: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the low-pass filtered current, and how much of its initial value is left.

    Args:
        pack: the flight.
        rc_time: s, time constant of the first-order lag.
        before: A, filtered current at the start.

    Returns:
        The filtered current (m,) A, averaged over each step, and the share (m,) of `before` that it contains.
    """
    keep = np.exp(-pack.dt / rc_time)
    mean = (1.0 - keep) * rc_time / pack.dt
    value, share = before, 1.0
    lagged, remembered = np.empty_like(pack.current), np.empty_like(pack.current)
    for i, current in enumerate(pack.current):
        lagged[i], remembered[i] = current + mean[i] * (value - current), mean[i] * share
        value, share = current + keep[i] * (value - current), keep[i] * share
    return lagged, remembered
