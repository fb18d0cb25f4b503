"""Design of the manoeuvre that separates effects which a recording cannot distinguish.

The nominal vehicle flies each manoeuvre of a fixed set in simulation. A manoeuvre separates two effects when the
residuals of the one, at its estimated value, cannot be reproduced by any value of the other (T-optimality).
"""

from dataclasses import dataclass

import jax
import numpy as np

from swift_ros.recording.flight_table import FlightTable
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import Effect
from swift_sim_bridge.gap.inference.normal_equations import solve
from swift_sim_bridge.gap.inference.sensitivity import linearise, parameter_slices, parameter_steps, perturbed_variants
from swift_sim_bridge.gap.nominal import reference_flights, rotor_speed_model
from swift_sim_bridge.gap.recording.recording import read_recording
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel

SIMULATED_S = 12.0  # simulated duration of each manoeuvre; the separation grows in proportion to the duration
STEP_S = 0.005  # sample time of the manoeuvres' paths
LEAD_S = 1.0  # part of a manoeuvre that does not count for the separation: the run-up from rest
DURATIONS_S = (10.0, 20.0, 30.0, 60.0)  # proposed durations; shorter flights have too few seconds to compare
MIN_SEPARATION_SQUARES = 25.0  # squared normalised distance of two effects: five standard deviations
HEIGHT_M = 3.0  # height of all manoeuvres but the low passes: above the ground effect
MAX_PATH_ERROR_M = 4.0  # distance from the path; a vehicle that gets farther away cannot fly the manoeuvre
DESCRIPTIONS = {
    "hover": "hover at one place",
    "climb_and_sink": "climb and sink at up to 5 m/s",
    "throttle_punches": "punch the throttle, level",
    "attitude_doublets": "roll, pitch and yaw doublets at 2 to 4 Hz",
    "attitude_doublets_with_punches": "roll, pitch and yaw doublets with throttle punches",
    "yaw_spin": "spin about yaw at 3 rad/s",
    "straight_passes": "straight passes, forth and back",
    "straight_and_sideways_passes": "straight passes, forth and back, then sideways",
    "fast_passes": "straight passes at up to 15 m/s, 40 m forth and back",
    "yawing_circles": "circles at 8 m/s while yawing",
    "low_passes": "low passes at 0.2 m",
}  # by the manoeuvre's id


@dataclass(frozen=True)
class Manoeuvre:
    """A manoeuvre that a pilot can fly.

    Attributes:
        id: key of DESCRIPTIONS.
        seconds: duration, s.
    """

    id: str
    seconds: float

    @property
    def text(self) -> str:
        """The manoeuvre in words, with its duration."""
        return f"{DESCRIPTIONS[self.id]} for {self.seconds:.0f} s"

    def as_json(self) -> dict:
        """Return the entry `manoeuvre` of a finding in report.json."""
        return {"id": self.id, "seconds": self.seconds}


@dataclass(frozen=True)
class SeparatingManoeuvre:
    """A proposed manoeuvre and how well it separates the confounders.

    Attributes:
        manoeuvre: the manoeuvre.
        separation: distance between the residuals of the two closest effects, standard deviations.
    """

    manoeuvre: Manoeuvre
    separation: float


def _excursion(t, size, period):
    """Return a path (n,) from 0 to `size` and back in each period; it starts and ends at rest."""
    return 0.5 * size * (1.0 - np.cos(2 * np.pi * t / period))


def figures(t) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Return the path of each manoeuvre at times t (n,) s.

    Returns:
        By id: positions (n, 3) m, yaw (n,) rad, and rotation vectors (n, 3) rad of the doublets.
    """
    # no downward acceleration above 0.7 g: the thrust stays upwards, and pilot and controller can follow
    still, none = np.tile([0.0, 0.0, HEIGHT_M], (len(t), 1)), np.zeros_like(t)
    x, y, z = np.eye(3)
    doublets = 0.15 * np.sin(2 * np.pi * np.outer(t, [3.0, 3.7, 1.6])) * [1.0, 1.0, 2.0]
    punches = still + np.outer(0.27 * np.sin(2 * np.pi * 0.8 * t), z)
    passes, sideways = (still + np.outer(_excursion(t, 16.0, 6.0), axis) for axis in (x, y))
    return {
        "hover": (still, none, 0.0 * doublets),
        "climb_and_sink": (still + np.outer(_excursion(t, 8.0, 5.0), z), none, 0.0 * doublets),
        "throttle_punches": (punches, none, 0.0 * doublets),
        "attitude_doublets": (still, none, doublets),
        "attitude_doublets_with_punches": (punches, none, doublets),
        "yaw_spin": (still, 3.0 * t, 0.0 * doublets),
        "straight_passes": (passes, none, 0.0 * doublets),
        "straight_and_sideways_passes": (
            np.where(t[:, None] % 12.0 < 6.0, passes, sideways),
            none,
            0.0 * doublets,
        ),
        "fast_passes": (still + np.outer(_excursion(t, 40.0, 8.0), x), none, 0.0 * doublets),
        "yawing_circles": (
            still + 5.0 * np.stack([np.cos(1.6 * t), np.sin(1.6 * t), 0.1 * np.sin(3.0 * t)], axis=-1),
            0.7 * t,
            0.0 * doublets,
        ),
        "low_passes": (passes - np.outer(np.full_like(t, HEIGHT_M - 0.2), z), none, 0.0 * doublets),
    }


def _path(shapes: list) -> reference_flights.FlightPath:
    """Return figures as one path with a column each; the thrust points along the body's z axis."""
    t = np.arange(0.0, SIMULATED_S, STEP_S)
    rows = [reference_flights.motion_along(p, yaw, STEP_S, doublets) for p, yaw, doublets in shapes]
    return reference_flights.FlightPath(t, *(np.stack(parts, axis=1) for parts in zip(*rows, strict=True)))


def separating_manoeuvre(
    confounders: list[Effect], changes: dict, vehicle: Vehicle, table: FlightTable, weights: tuple[np.ndarray, float]
) -> SeparatingManoeuvre | None:
    """Return the shortest manoeuvre that separates confounders; of equally long ones, the one that separates best.

    Args:
        confounders: the effects to separate.
        changes: by key, the estimated change of each one's parameters.
        vehicle: the nominal vehicle.
        table: the recording; the simulated manoeuvres are measured by its sensors.
        weights: sigma (c,) of the recording's residuals, and the variance inflation.

    Returns:
        None if no manoeuvre separates the confounders.
    """
    sigma, variance_inflation = weights
    shapes = figures(np.arange(0.0, SIMULATED_S, STEP_S))
    with jax.enable_x64(True):
        path = _path(list(shapes.values()))
        traces = reference_flights.fly(vehicle, path)
        tables = reference_flights.reference_tables(traces, path, table, vehicle, 0)
        variants = perturbed_variants(vehicle, tuple(confounders))
        candidates = []
        for i, (name, flown) in enumerate(zip(shapes, tables, strict=True)):
            if np.linalg.norm(traces[i].p_world - path.p_world[:, i], axis=-1).max() > MAX_PATH_ERROR_M:
                continue
            residual_model = ResidualModel(
                read_recording(rotor_speed_model.with_modelled_rotor_speeds(flown, vehicle), vehicle, simulated=True)
            )
            line = linearise(residual_model, variants)
            noise = np.sqrt(np.mean(np.square(line.residual[line.good]), axis=0))  # a fast pass is noisier than a hover
            normalised = line.sensitivity / np.maximum(np.asarray(sigma)[: len(noise)], noise)
            rate = _separation_squares(normalised, confounders, changes) / variance_inflation / (line.t[-1] - line.t[0])
            enough = [seconds for seconds in DURATIONS_S if rate * (seconds - LEAD_S) >= MIN_SEPARATION_SQUARES]
            if enough:
                candidates.append((enough[0], -rate, name))
    if not candidates:
        return None
    seconds, rate, name = min(candidates)
    return SeparatingManoeuvre(Manoeuvre(name, seconds), float(np.sqrt(-rate * (seconds - LEAD_S))))


def _separation_squares(sensitivity, confounders: list[Effect], changes: dict) -> float:
    """Return the smallest sum of squares that remains of one effect's residuals after the best fit of another."""
    rows, size = parameter_slices(tuple(confounders)), parameter_steps(tuple(confounders))
    flat = sensitivity.reshape(len(sensitivity), -1)
    smallest = np.inf
    for effect in confounders:
        change = (changes[effect.key] / size[rows[effect.key]]) @ flat[rows[effect.key]]
        for other in confounders:
            if other.key != effect.key:
                basis = flat[rows[other.key]]
                remaining = change - solve(basis @ basis.T, basis @ change) @ basis
                smallest = min(smallest, float(remaining @ remaining))
    return smallest
