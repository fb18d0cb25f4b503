"""Self-test of the installation: nominal flights must give no finding, planted effects must be identified.

The flights are the tool's own reference flights along one path of sines. They test the installation, not the method;
`gap-referee` evaluates the method with flights of other simulators.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import jax
import numpy as np

from swift_ros.errors import UsageError
from swift_ros.recording.flight_table import FlightTable
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import Effect
from swift_sim_bridge.gap.api import diagnose
from swift_sim_bridge.gap.effects.catalogue import catalogue
from swift_sim_bridge.gap.effects.injection import file_values, inject
from swift_sim_bridge.gap.inference.sensitivity import with_effect_terms
from swift_sim_bridge.gap.nominal import reference_flights

NOMINAL = 10  # number of nominal flights
SECONDS = 15.0  # duration of a flight
STEP_S = 0.005  # sample time of a flight
SHEET = {
    "position_m": 3e-4,
    "attitude_rad": 1.7e-3,
    "gyro_rad_s": 0.03,
    "accel_m_s2": 0.8,
    "rotor_relative": 0.005,
    "vbat_v": 0.02,
    "ibat_a": 0.5,
}  # noise sheet: standard deviations of a sample, for those that the vehicle file lacks
# planted effects by key: change of each parameter in steps of the catalogue; the self-test expects all of them by name
PLANTED = {
    "motor_time_constant": 15,
    "battery_sag": 12,
    "rotor_drag": 15,
    "body_drag": 15,
    "axial_inflow": 8,
    "thrust_axis_tilt": 12,
    "com_offset": 10,
    "damaged_propeller[2]": 8,
    "accel_bias": 15,
    "time_offset": 12,
}
MAX_ERROR = 0.1  # error relative to the planted change that is accepted; also accepted: twice the half interval
MAX_HALF_INTERVAL = 0.25  # half interval relative to the planted change that at least one parameter must stay below


@dataclass(frozen=True)
class Case:
    """Result of one flight.

    Attributes:
        planted: id of the planted effect, empty for a nominal flight.
        named: effects that the tool reports.
        verdict: verdict of the report.
        good: whether the report is right.
        note: explanation.
        seconds: computing time, s.
    """

    planted: str
    named: tuple[str, ...]
    verdict: str
    good: bool
    note: str
    seconds: float

    def __str__(self) -> str:
        planted = self.planted or "nothing"
        return f"{'ok  ' if self.good else 'FAIL'} {planted:20} {self.verdict:17} {self.note} ({self.seconds:.0f} s)"


def cases(vehicle: Vehicle, progress: Callable[[str], None] = lambda text: None) -> Iterator[Case]:
    """Yield the result of each flight.

    Args:
        vehicle: vehicle of the flights.
        progress: called with one line of text at each stage of a diagnosis.

    Raises:
        UsageError: the vehicle cannot fly the path.
    """
    vehicle = replace(vehicle, sensors={**SHEET, **vehicle.sensors})
    effects = {effect.key: effect for effect in catalogue(vehicle)}
    along = path(vehicle)
    for seed in range(NOMINAL):
        yield _nominal(flight(vehicle, vehicle, along, seed), vehicle, seed, progress)
    for seed, (key, size) in enumerate(PLANTED.items()):
        effect = effects[key]
        values = file_values(effect, vehicle) + size * np.array([parameter.step for parameter in effect.parameters])
        table = flight(inject(vehicle, effect, values), vehicle, along, 100 + seed)
        report, seconds = _diagnosed(table, vehicle, 100 + seed, progress)
        yield judge(report, effect, values, file_values(effect, vehicle), seconds)


def path(vehicle: Vehicle) -> reference_flights.FlightPath:
    """Return a path of sines, at up to about 14 m/s if the vehicle has the thrust for it.

    No motor may reach the end of its range: there a flight differs from the reference flights along its path.

    Raises:
        UsageError: the vehicle is too weak.
    """
    size = min(1.0, (vehicle.thrust_to_weight - 1.0) / 4.0)
    if size < 0.1:
        raise UsageError(
            f"{vehicle.name} has a thrust-to-weight of {vehicle.thrust_to_weight:.2f}; the self-test needs 1.4"
        )
    t = np.arange(-1.0, SECONDS + 1.0, STEP_S)
    p = np.array([7.0, 6.0, 1.5]) * np.sin(np.array([1.5, 1.7, 1.3]) * t[:, None] + [0.0, 1.0, 2.0]) + [0.0, 0.0, 6.0]
    p = size * (p + 0.5 * np.sin(np.array([4.1, 3.7, 4.6]) * t[:, None]))
    yaw = 0.8 * np.sin(0.9 * t) + 0.4 * np.sin(2.3 * t)
    inside = slice(round(1 / STEP_S), round((1 + SECONDS) / STEP_S))
    parts = (part[inside][:, None] for part in reference_flights.motion_along(p, yaw, STEP_S))
    return reference_flights.FlightPath(t[inside] - t[inside][0], *parts)


def flight(flown: Vehicle, file: Vehicle, along: reference_flights.FlightPath, seed: int) -> FlightTable:
    """Return the recording of a vehicle along a path.

    Args:
        flown: the vehicle with the planted effect.
        file: the vehicle without it.
        along: the path.
        seed: seed of the flight.
    """
    with jax.enable_x64(True):
        whole = with_effect_terms(flown, catalogue(file))  # with all terms, so that one compiled program flies them all
        trace = reference_flights.fly(whole, along, flown.sensors["gyro_rad_s"], seed)[0]
    noise = reference_flights.gyro_noise_samples(along, flown.sensors["gyro_rad_s"], seed)[:, 0]
    table = reference_flights.measure(along, trace, noise, flown, np.random.default_rng([seed, 21]))
    return replace(table, name=f"flight {seed}")


def _diagnosed(table: FlightTable, vehicle: Vehicle, seed: int, progress) -> tuple[dict, float]:
    """Return the report of a flight and the computing time, s."""
    begin = time.monotonic()
    report = diagnose([table], vehicle, progress, seed).report
    return report, time.monotonic() - begin


def _nominal(table: FlightTable, vehicle: Vehicle, seed: int, progress) -> Case:
    """Return the result of a nominal flight, which must have no finding."""
    report, seconds = _diagnosed(table, vehicle, seed, progress)
    named = _named(report)
    good = report["verdict"] == "nothing_left_out"
    return Case("", named, report["verdict"], good, "" if good else f"false alarm: {', '.join(named)}", seconds)


def judge(report: dict, effect: Effect, values, before, seconds: float = 0.0) -> Case:
    """Return whether a report identifies a planted effect.

    Args:
        report: content of report.json.
        effect: the planted effect.
        values: its planted parameters (k,).
        before: its parameters (k,) in the vehicle file.
        seconds: computing time, s.
    """
    named = _named(report)
    finding = next(
        (
            one
            for one in report["findings"]
            if (one["effect"], one["variant"]) == (effect.id, effect.variant)
            and one["verdict"] in ("confirmed", "tentative")
        ),
        None,
    )
    if finding is None:
        return Case(effect.id, named, report["verdict"], False, f"reported {', '.join(named) or 'nothing'}", seconds)
    found = [finding["parameters"][parameter.name] for parameter in effect.parameters]
    change = np.abs(values - before)
    error = np.abs([one["value"] for one in found] - values)
    half_interval = np.array([one["interval95"][1] - one["value"] for one in found])
    accurate = bool(np.all(error < np.maximum(MAX_ERROR * change, 2.0 * half_interval)))
    vague = bool(np.all(half_interval > MAX_HALF_INTERVAL * change))
    others = [name for name in named if name != effect.id]
    worst = int(np.argmax(error / change))
    note = f"largest error {error[worst] / change[worst]:.1%} of the change"
    if error[worst] > MAX_ERROR * change[worst]:
        note += f" (interval {half_interval[worst] / change[worst]:.0%})"
    if others:
        note += f", and also {', '.join(others)}"
    elif not accurate:
        note += ", more than its interval allows"
    note += ", and the interval is too wide" if vague else ""
    return Case(effect.id, named, report["verdict"], accurate and not vague and not others, note, seconds)


def _named(report: dict) -> tuple[str, ...]:
    """Return the names of a report's findings."""
    return tuple(one["effect"] or "unknown physics" for one in report["findings"])
