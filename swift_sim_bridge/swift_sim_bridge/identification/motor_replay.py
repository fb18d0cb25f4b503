"""The motors: lag and steady-speed map, replayed with the recorded commands and compared with measured rotor speeds.

The replay calls `physics.motors`. No measurement is differentiated: time constants and map are fitted together to the
rotor speeds. Each window starts at a measured speed; its first part, which depends on that speed, is not used.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from swift_ros.recording.flight_table import FlightTable
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.identification import grid, pack
from swift_sim_bridge.identification.advice import manoeuvre
from swift_sim_bridge.identification.regression import Coefficient, NotMeasured, Problem
from swift_sim_bridge.physics import motors
from swift_sim_bridge.physics.state import Parameters, parameters_from_vehicle
from swift_sim_bridge.physics.terms import registry
from swift_sim_bridge.physics.terms.vectors import parts, stack

WINDOW_S = 1.0  # s of each window that is fitted: one cluster of the standard errors
BURN_IN = 6.0  # time constants after which the first speed of a window has decayed to 0.25 %
USEFUL_SPEED = 0.02  # of the highest speed: largest useful standard error of the map at full command
USEFUL_TIME = 0.1  # of a time constant: largest useful standard error
LOOP_HZ = 500.0  # Hz of the rate loop, where the vehicle file does not give it
MAX_TIME_CONSTANT_S = 1.0  # s, bound of the fit: far slower than any motor of a quadrotor
MIN_TIME_CONSTANT_S = 1e-4  # s, bound of the fit: the logarithmic steps need a positive one


@dataclass(frozen=True)
class _Windows:
    """w windows of s steps.

    Attributes:
        dt: (s, w) s.
        command: (s, w, n) motor commands.
        change: (s, w, n) change of the command over a sample interval of a log that skips commands.
        voltage: (s, w) V.
        first: (w, n) rad/s, measured at the start.
        measured: (s, w, n) rad/s after each step.
        t: (s, w) s of flight after each step.
        counts: (s, w), which steps are fitted.
    """

    dt: np.ndarray
    command: np.ndarray
    change: np.ndarray
    voltage: np.ndarray
    first: np.ndarray
    measured: np.ndarray
    t: np.ndarray
    counts: np.ndarray


def problem(tables: list[FlightTable], vehicle: Vehicle) -> Problem:
    """Return the problem of the vehicle's `motor` section. Call it, and its `linearise`, in double precision.

    Raises NotMeasured when the flights lack a channel that it needs.
    """
    flights = [_windows(table, vehicle) for table in tables]
    steps = min(flight.dt.shape[0] for flight in flights)
    flights = [
        _Windows(*(part if name == "first" else part[:steps] for name, part in vars(flight).items()))
        for flight in flights
    ]
    begin, cluster = 0, []
    for flight in flights:
        count = flight.dt.shape[1]
        cluster.append(np.broadcast_to(begin + np.arange(count), (steps, count)))
        begin += count + 2  # clusters of two flights are not adjacent
    joined = {
        name: np.concatenate([getattr(flight, name) for flight in flights], axis=0 if name == "first" else 1)
        for name in vars(flights[0])
    }
    windows, cluster = _Windows(**joined), np.concatenate(cluster, axis=1)
    rotors = windows.first.shape[1]
    each = partial(np.repeat, repeats=rotors)
    slow = [1.0 / table["motor_command"].rate_hz for table in tables if not _every_command(table, vehicle)]
    coefficients = _coefficients(vehicle, 0.5 * max(slow, default=0.0))
    if slow:
        coefficients += (Coefficient("lead of logged commands", "steps", 0.0, np.inf, low=-0.5, high=0.5, prior=0.25),)
    return Problem(
        name="motors",
        coefficients=coefficients,
        channels=(("rotor speed", "rad/s"),),
        measured=windows.measured[windows.counts].ravel(),
        channel=np.zeros(int(windows.counts.sum()) * rotors, int),
        cluster=each(cluster[windows.counts]),
        t=each(windows.t[windows.counts]),
        linearise=_model(windows, vehicle),
        notes=_notes(tables, vehicle),
    )


def _notes(tables: list[FlightTable], vehicle: Vehicle) -> tuple[str, ...]:
    """Return the assumptions where a flight lacks voltages or skips commands."""
    without = [table.name for table in tables if "voltage" not in table]
    notes = (f"{', '.join(without)}: no voltage was recorded, the reference voltage is used",) if without else ()
    slow = [table.name for table in tables if not _every_command(table, vehicle)]
    if slow:
        notes += (f"{', '.join(slow)}: the log skips commands of the flight controller; they are interpolated",)
    return notes


def _windows(table: FlightTable, vehicle: Vehicle) -> _Windows:
    """Return the windows of a flight. Raises NotMeasured when it has none."""
    for name, columns in (("rotor_speed", "rotor speeds"), ("motor_command", "motor commands")):
        if name not in table:
            raise NotMeasured(f"{table.name} has no {columns}")
    speed, count = table["rotor_speed"], len(vehicle.rotors)
    if speed.values.shape[1] != count or table["motor_command"].values.shape[1] != count:
        raise NotMeasured(f"{table.name} has another number of rotors than the vehicle ({count})")
    t = speed.t
    dt = np.diff(t)
    burn_in = BURN_IN * max(vehicle.motor.time_constant_up, vehicle.motor.time_constant_down)
    ahead, steps = int(np.ceil(burn_in / np.median(dt))), int(np.ceil(WINDOW_S / np.median(dt)))
    begins = np.arange(0, len(dt) - ahead - steps + 1, steps)
    known = grid.known(table, ["rotor_speed", "motor_command", *(["voltage"] if "voltage" in table else [])], t)
    begins = np.array([i for i in begins if known[i : i + ahead + steps + 1].all()], dtype=int)
    if not len(begins):
        raise NotMeasured(f"{table.name} has rotor speeds and motor commands for less than {WINDOW_S + burn_in:.1f} s")
    rows = begins + np.arange(ahead + steps)[:, None]
    command, change = _command(table, vehicle, t)
    voltage = pack.voltage_at(table, vehicle, t)
    counts = np.broadcast_to((np.arange(ahead + steps) >= ahead)[:, None], rows.shape)
    first, measured = speed.values[begins], speed.values[rows + 1]
    return _Windows(
        dt=dt[rows],
        command=command[rows],
        change=change[rows],
        voltage=voltage[rows],
        first=first,
        measured=measured,
        t=t[rows + 1],
        counts=counts,
    )


def _command(table: FlightTable, vehicle: Vehicle, t) -> tuple[np.ndarray, np.ndarray]:
    """Return the command (n - 1, rotors) between consecutive times of t (n,), and its change over a sample interval.

    A log as fast as the flight controller's loop has every command, and each is held until the next. A slower log skips
    most of them: they are interpolated, and the fit estimates a lead of the interpolated commands.
    """
    command = table["motor_command"]
    if _every_command(table, vehicle):
        held = command.values[np.clip(np.searchsorted(command.t, t[:-1] + 1e-6, "right") - 1, 0, None)]
        return held, np.zeros_like(held)
    middle, half = 0.5 * (t[1:] + t[:-1]), 0.5 / command.rate_hz
    return grid.at(command, middle), grid.at(command, middle + half) - grid.at(command, middle - half)


def _every_command(table: FlightTable, vehicle: Vehicle) -> bool:
    """Return whether the log has every command of the rate loop."""
    loop_hz = float(vehicle.controller.get("loop_hz", vehicle.controller.get("rate_hz", LOOP_HZ)))
    return table["motor_command"].rate_hz >= 0.9 * loop_hz


def _coefficients(vehicle: Vehicle, skipped_s: float) -> tuple[Coefficient, ...]:
    """Return the coefficients of the map and the time constants, the latter with a systematic error `skipped_s` (s)."""
    cause = "the log skips commands of the flight controller; take its own log"
    speed = USEFUL_SPEED * vehicle.rotor_speed_range[1]
    volts = vehicle.battery.reference_voltage
    found = [
        Coefficient(
            f"motor.map.coefficients[{i}]",
            unit,
            value,
            speed / (volts if unit.endswith("/V") else 1.0),
            manoeuvre("map", vehicle),
            ("motor", "map", "coefficients", i),
        )
        for i, (unit, value) in enumerate(zip(motors.MAP_UNITS, vehicle.motor.map.coefficients, strict=True))
    ]
    found += [
        Coefficient(
            name=f"motor.{key}",
            unit="s",
            start=value,
            tolerance=USEFUL_TIME * value,
            manoeuvre=manoeuvre("time_constant", vehicle),
            path=("motor", key),
            low=MIN_TIME_CONSTANT_S,
            high=MAX_TIME_CONSTANT_S,
            systematic=skipped_s,
            systematic_cause=cause,
        )
        for key in ("time_constant_up", "time_constant_down")
        for value in (getattr(vehicle.motor, key),)
    ]
    return tuple(found)


def _model(windows: _Windows, vehicle: Vehicle) -> Callable:
    """Return `Problem.linearise` of the windows."""
    built = parameters_from_vehicle(vehicle, np.float64)
    inputs = tuple(map(jnp.asarray, (windows.dt, windows.command, windows.change, windows.voltage)))
    first = jnp.asarray(windows.first)

    def linearise(theta):
        speed, columns = _differentiated(jnp.asarray(theta), built, first, inputs)
        columns = np.stack([column[windows.counts].ravel() for column in np.asarray(columns)], axis=-1)
        return np.asarray(speed)[windows.counts].ravel(), columns

    return linearise


@jax.jit
def _differentiated(theta, built: Parameters, first, inputs):
    """Return `_replayed` at theta (k,) and its derivatives (k, s, w, n)."""

    def along(direction):
        return jax.jvp(partial(_replayed, built=built, first=first, inputs=inputs), (theta,), (direction,))

    return jax.vmap(along, out_axes=(None, 0))(jnp.eye(len(theta)))


def _replayed(theta, built: Parameters, first, inputs):
    """Return the speeds (s, w, n) rad/s after each step.

    `theta` holds the map, the time constants and, if there is one, the lead of the logged commands. What an equation of
    the vehicle file adds to the steady speeds is kept.
    """
    lead = theta[7] if len(theta) > 7 else 0.0
    described = replace(
        built.motors, map_coefficients=theta[:5], time_constant_up=theta[5], time_constant_down=theta[6]
    )

    def step(speed, now):
        dt, command, change, voltage = now
        command = jnp.clip(command + lead * change, 0.0, 1.0)
        added = registry.added_speeds(parts(speed), parts(command), voltage, built)
        target = motors.steady_speed(command, voltage, described) + stack(added, like=voltage)
        (speed,) = motors.lag((speed,), (target,), dt[:, None], described)
        return speed, speed

    return jax.lax.scan(step, first, inputs)[1]
