"""What to fly to tell effects apart: manoeuvres that the nominal vehicle flies, of each what the rivals would do to it.

A manoeuvre separates two effects when no size of the one looks like the other at its fitted size (T-optimality).
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

SECONDS, STEP_S, LEAD_S = 12.0, 0.005, 1.0  # of each manoeuvre, from which longer ones are told
DURATIONS_S = (10.0, 20.0, 30.0, 60.0)  # that are proposed: with fewer seconds the search has too few to compare
APART = 25.0  # squares between what two effects do, five standard deviations
HEIGHT_M = 3.0
ASTRAY_M = 4.0  # off the path: the vehicle cannot fly it


@dataclass(frozen=True)
class SeparatingManoeuvre:
    """text: what to fly; apart: by how many standard deviations the two nearest effects then differ."""

    text: str
    apart: float


def _swing(t, size, period):
    """Return a way forth and back that begins and ends at rest."""
    return 0.5 * size * (1.0 - np.cos(2 * np.pi * t / period))


def _figures(t) -> dict:
    """Return by name positions (n, 3) m, yaw (n,) rad, and rotation vectors (n, 3) rad that shake the body."""
    # nothing sinks faster than at 0.7 g: thrust stays upwards, and pilot and controller can follow
    still, none = np.tile([0.0, 0.0, HEIGHT_M], (len(t), 1)), np.zeros_like(t)
    x, y, z = np.eye(3)
    shake = 0.15 * np.sin(2 * np.pi * np.outer(t, [3.0, 3.7, 1.6])) * [1.0, 1.0, 2.0]
    punch = still + np.outer(0.27 * np.sin(2 * np.pi * 0.8 * t), z)
    passes, sideways = (still + np.outer(_swing(t, 16.0, 6.0), axis) for axis in (x, y))
    return {
        "hover at one place": (still, none, 0.0 * shake),
        "climb and sink at up to 5 m/s": (still + np.outer(_swing(t, 8.0, 5.0), z), none, 0.0 * shake),
        "punch the throttle, level": (punch, none, 0.0 * shake),
        "roll, pitch and yaw doublets at 2 to 4 Hz": (still, none, shake),
        "roll, pitch and yaw doublets with throttle punches": (punch, none, shake),
        "spin about yaw at 3 rad/s": (still, 3.0 * t, 0.0 * shake),
        "straight passes, forth and back": (passes, none, 0.0 * shake),
        "straight passes, forth and back, then sideways": (
            np.where(t[:, None] % 12.0 < 6.0, passes, sideways),
            none,
            0.0 * shake,
        ),
        "straight passes at up to 15 m/s, 40 m forth and back": (
            still + np.outer(_swing(t, 40.0, 8.0), x),
            none,
            0.0 * shake,
        ),
        "circles at 8 m/s while yawing": (
            still + 5.0 * np.stack([np.cos(1.6 * t), np.sin(1.6 * t), 0.1 * np.sin(3.0 * t)], axis=-1),
            0.7 * t,
            0.0 * shake,
        ),
        "low passes at 0.2 m": (passes - np.outer(np.full_like(t, HEIGHT_M - 0.2), z), none, 0.0 * shake),
    }


def _path(figures: list) -> reference_flights.FlightPath:
    """Return figures as paths, the thrust along the body's z axis."""
    t = np.arange(0.0, SECONDS, STEP_S)
    rows = [reference_flights.motion_along(p, yaw, STEP_S, shake) for p, yaw, shake in figures]
    return reference_flights.FlightPath(t, *(np.stack(parts, axis=1) for parts in zip(*rows, strict=True)))


def separating_manoeuvre(
    rivals: list[Effect], changes: dict, vehicle: Vehicle, table: FlightTable, weights
) -> SeparatingManoeuvre | None:
    """Return the shortest manoeuvre that tells rivals apart, of several the one that does it best, None where none.

    changes: by key, what each would change of its parameters; table: of the recording, whose instruments measure it;
    weights: sigma (c,) of its residuals, and how many samples count as one.
    """
    sigma, copies = weights
    known = _figures(np.arange(0.0, SECONDS, STEP_S))
    with jax.enable_x64(True):
        path = _path(list(known.values()))
        traces = reference_flights.fly(vehicle, path)
        tables = reference_flights.reference_tables(traces, path, table, vehicle, 0)
        variants = perturbed_variants(vehicle, tuple(rivals))
        enough = []
        for i, (name, flown) in enumerate(zip(known, tables, strict=True)):
            if np.linalg.norm(traces[i].p_world - path.p_world[:, i], axis=-1).max() > ASTRAY_M:
                continue
            residual_model = ResidualModel(
                read_recording(rotor_speed_model.with_modelled_rotor_speeds(flown, vehicle), vehicle)
            )
            line = linearise(residual_model, variants)
            own = np.sqrt(np.mean(np.square(line.residual[line.good]), axis=0))  # a fast pass is noisier than a hover
            weighed = line.columns / np.maximum(np.asarray(sigma)[: len(own)], own)
            a_second = _apart(weighed, rivals, changes) / copies / (line.t[-1] - line.t[0])
            least = [seconds for seconds in DURATIONS_S if a_second * (seconds - LEAD_S) >= APART]
            if least:
                enough.append((least[0], -a_second, name))
    if not enough:
        return None
    seconds, a_second, name = min(enough)
    return SeparatingManoeuvre(f"{name} for {seconds:.0f} s", float(np.sqrt(-a_second * (seconds - LEAD_S))))


def _apart(columns, rivals: list[Effect], changes: dict) -> float:
    """Return the least squares between what one effect does at its size and what any other can do."""
    own, size = parameter_slices(tuple(rivals)), parameter_steps(tuple(rivals))
    flat = columns.reshape(len(columns), -1)
    least = np.inf
    for one in rivals:
        done = (changes[one.key] / size[own[one.key]]) @ flat[own[one.key]]
        for other in rivals:
            if other.key != one.key:
                theirs = flat[own[other.key]]
                rest = done - solve(theirs @ theirs.T, theirs @ done) @ theirs
                least = min(least, float(rest @ rest))
    return least
