"""Does the tool work on this installation? Nominal flights must say nothing, planted effects must come back by name.

The flights are the simulator's own, along the same sines through the air: this proves the installation, not the method,
which `gap-referee` judges by flights of other simulators.
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
from swift_sim_bridge.gap.effects.catalogue import catalogue
from swift_sim_bridge.gap.effects.injection import file_values, inject
from swift_sim_bridge.gap.inference.sensitivity import with_effect_terms
from swift_sim_bridge.gap.nominal import reference_flights
from swift_sim_bridge.gap.api import diagnose

NOMINAL, SECONDS, STEP_S = 10, 15.0, 0.005
SHEET = {
    "position_m": 3e-4,
    "attitude_rad": 1.7e-3,
    "gyro_rad_s": 0.03,
    "accel_m_s2": 0.8,
    "rotor_relative": 0.005,
    "vbat_v": 0.02,
    "ibat_a": 0.5,
}  # where the vehicle file does not say
# effect by its key: how far each parameter goes, in the catalogue's steps, which are small and yet matter
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
CLOSE = 0.1  # of what was planted: so near a value counts as found, or within twice its own interval
TOLD = 0.25  # of what was planted: so narrow one of the intervals must be, or nothing was told


@dataclass(frozen=True)
class Case:
    """One flight. planted: an effect's id, or nothing; named: what the tool calls for; verdict: its own; good: whether
    it is right; note: for a reader; seconds: that it took."""

    planted: str
    named: tuple[str, ...]
    verdict: str
    good: bool
    note: str
    seconds: float

    def __str__(self) -> str:
        planted = self.planted or "nothing"
        return f"{'ok  ' if self.good else 'FAIL'} {planted:20} {self.verdict:17} {self.note} ({self.seconds:.0f} s)"


def cases(vehicle: Vehicle, tell: Callable[[str], None] = lambda text: None) -> Iterator[Case]:
    """Yield what came of each flight, as they are flown. tell: hears of the progress of each diagnosis.

    Raises UsageError for a vehicle that cannot fly the path.
    """
    vehicle = replace(vehicle, sensors={**SHEET, **vehicle.sensors})
    effects = {effect.key: effect for effect in catalogue(vehicle)}
    flown = path(vehicle)
    for seed in range(NOMINAL):
        yield _nominal(flight(vehicle, vehicle, flown, seed), vehicle, seed, tell)
    for seed, (key, size) in enumerate(PLANTED.items()):
        effect = effects[key]
        values = file_values(effect, vehicle) + size * np.array([parameter.step for parameter in effect.parameters])
        table = flight(inject(vehicle, effect, values), vehicle, flown, 100 + seed)
        yield _planted(table, vehicle, effect, values, seed, tell)


def path(vehicle: Vehicle) -> reference_flights.FlightPath:
    """Return sines through the air, at up to some 14 m/s where the vehicle has the thrust for it: no motor may come to
    an end of its range, where a flight does what no twin along its path does."""
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
    """Return the recording of a vehicle along a path. file: the vehicle without what is planted."""
    with jax.enable_x64(True):
        whole = with_effect_terms(flown, catalogue(file))  # with all terms, so that one program flies them all
        trace = reference_flights.fly(whole, along, flown.sensors["gyro_rad_s"], seed)[0]
    noise = reference_flights.gyro_noise_samples(along, flown.sensors["gyro_rad_s"], seed)[:, 0]
    table = reference_flights.measure(along, trace, noise, flown, np.random.default_rng([seed, 21]))
    return replace(table, name=f"flight {seed}")


def _nominal(table: FlightTable, vehicle: Vehicle, seed: int, tell) -> Case:
    begin = time.monotonic()
    report = diagnose([table], vehicle, tell, seed).report
    named = _named(report)
    good = report["verdict"] == "nothing_left_out"
    note = "" if good else f"invented {', '.join(named)}"
    return Case("", named, report["verdict"], good, note, time.monotonic() - begin)


def _planted(table: FlightTable, vehicle: Vehicle, effect: Effect, values, seed: int, tell) -> Case:
    begin = time.monotonic()
    report = diagnose([table], vehicle, tell, 100 + seed).report
    return judged(report, effect, values, file_values(effect, vehicle), time.monotonic() - begin)


def judged(report: dict, effect: Effect, values, before, seconds: float = 0.0) -> Case:
    """Return what a report says of a planted effect. values, before (k,): its parameters, planted and in the file."""
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
        return Case(effect.id, named, report["verdict"], False, f"called {', '.join(named) or 'nothing'}", seconds)
    found = [finding["parameters"][parameter.name] for parameter in effect.parameters]
    moved = np.abs(values - before)
    apart = np.abs([one["value"] for one in found] - values)
    doubt = np.array([one["interval95"][1] - one["value"] for one in found])
    close = bool(np.all(apart < np.maximum(CLOSE * moved, 2.0 * doubt)))
    vague, beside = bool(np.all(doubt > TOLD * moved)), [name for name in named if name != effect.id]
    worst = int(np.argmax(apart / moved))
    note = f"off by at most {apart[worst] / moved[worst]:.1%} of it"
    note += f" (interval {doubt[worst] / moved[worst]:.0%})" if apart[worst] > CLOSE * moved[worst] else ""
    note += f", and also {', '.join(beside)}" if beside else ", more than its interval allows" if not close else ""
    note += ", and hardly told" if vague else ""
    return Case(effect.id, named, report["verdict"], close and not vague and not beside, note, seconds)


def _named(report: dict) -> tuple[str, ...]:
    return tuple(one["effect"] or "unknown physics" for one in report["findings"])
