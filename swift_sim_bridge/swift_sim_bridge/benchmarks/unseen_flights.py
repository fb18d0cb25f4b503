"""A diagnosis from one flight, tested on other flights of the vehicle, beside black-box models of the same flight.

The referee adds three drag terms to a random vehicle and flies it. From the noisy recording the gap tool makes its
diagnosis and the black-box models learn. Then all simulate two more flights of the vehicle from true states, with the
motor commands of these flights: one along another path, and one along the recorded path, 25 % faster. The recorded
flight has process noise. The two others have none: no model can predict it, and it would dominate all errors.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import jax
import numpy as np

from swift_ros.configuration import build
from swift_ros.recording.flight_table import FlightTable
from swift_ros.text import align
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.api import diagnose
from swift_sim_bridge.gap.effects.catalogue import catalogue
from swift_sim_bridge.gap.inference.sensitivity import with_effect_terms
from swift_sim_bridge.gap.recording.recording import read_recording
from swift_sim_bridge.gap.residuals import rollout
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel
from swift_sim_bridge.gap.validation import black_boxes, parts
from swift_sim_bridge.gap.validation.prediction_errors import HORIZONS_S
from swift_sim_bridge.referee.effects.catalogue import EFFECTS
from swift_sim_bridge.referee.effects.planting import conceal
from swift_sim_bridge.referee.simulator import flight, instruments, paths, vehicles

HIDDEN = ("rotor_drag", "body_drag", "axial_inflow")
DETECTABLE_MULTIPLE = 10.0  # size of each hidden term, in units of the referee's detectable size
SECONDS = 30.0  # length of a flight
FASTER = 1.25  # speed of the third flight, relative to the recorded one
THRUST_SHARE = 0.6  # of the maximum thrust, for the recorded path: FASTER squared times as much is 0.94
UNSEEN = ("another path", "25 % faster")
# Ratio of a black box's error to that of the repaired vehicle that is required, after TARGET_HORIZON.
TARGETS = dict(zip(UNSEEN, (5.0, 20.0), strict=True))
TARGET_HORIZON = "0.5"  # s
MODELS = (*black_boxes.MODELS, "true")
NAMES = dict(zip(MODELS, ("vehicle file", "repaired", "with remainder", "kNN", "GP", "true vehicle"), strict=True))
BOXES = ("knn", "gp")
CHANNELS = (
    "p_world",
    "v_world",
    "q_world_body",
    "gyro_body",
    "specific_force_body",
    "rotor_speed",
    "motor_command",
    "thrust_command",
    "omega_command_body",
    "voltage",
    "current",
)


@dataclass(frozen=True)
class Flights:
    """The flights of one vehicle.

    Attributes:
        nominal: content of the vehicle file that the tool gets.
        true: the same with the hidden terms.
        recording: of the first flight, with noise.
        unseen: the other flights, without noise, by name.
        speeds: highest speed of each flight, m/s.
    """

    nominal: dict
    true: dict
    recording: FlightTable
    unseen: dict[str, FlightTable]
    speeds: dict[str, float]


def fly(seed: int) -> Flights:
    """Return the flights of the vehicle of a seed."""
    rng = np.random.default_rng([seed, 211])
    nominal = true = vehicles.draw_vehicle(rng, f"racer {seed}")
    for name in HIDDEN:
        true = conceal(true, EFFECTS[name].plant(true, DETECTABLE_MULTIPLE * EFFECTS[name].detectable, rng))
    top, seconds = THRUST_SHARE * vehicles.top_thrust(nominal), SECONDS + instruments.LEAD_S
    kind, speed, shaking = str(rng.choice(["lissajous", "gates"])), rng.uniform(9.0, 13.0), rng.uniform(0.2, 0.8)
    long, other = (
        paths.draw_path(rng, kind, length, top, speed, shaking) for length in (FASTER * seconds + 1.0, seconds)
    )
    flown = (paths.paced(long, 1.0, seconds), other, paths.paced(long, FASTER, seconds))
    rough, noise = float(rng.uniform(0.1, 0.6)), nominal["sensors"]["gyro_rad_s"]
    truths = flight.fly(
        [
            flight.Order(true, nominal, path, 3 * seed + i, noise, push)
            for i, (path, push) in enumerate(zip(flown, (rough, 0.0, 0.0), strict=True))
        ]
    )
    noiseless = true | {"sensors": dict.fromkeys(true["sensors"], 0.0)}
    exact = [
        instruments.record(replace(truth, gyro=truth.w), noiseless, rng, channels=CHANNELS, name=name)
        for truth, name in zip(truths[1:], UNSEEN, strict=True)
    ]
    fastest = [float(np.linalg.norm(truth.v, axis=1).max()) for truth in truths]
    return Flights(
        nominal,
        true,
        instruments.record(truths[0], true, rng, channels=CHANNELS, name="recording"),
        dict(zip(UNSEEN, exact, strict=True)),
        dict(zip(("recording", *UNSEEN), fastest, strict=True)),
    )


def evaluate(seed: int, progress: Callable[[str], None] = print) -> dict:
    """Return the record of a seed.

    Args:
        seed: of the vehicle, the paths and the noise.
        progress: called with lines of the diagnosis.

    Returns:
        {"seed", "named": effects and equations that the tool found, "speeds_m_s", "flights": {name of UNSEEN:
        {horizon s: {model: RMS position error m}}}}.
    """
    flights = fly(seed)
    nominal, true = (build(Vehicle, content, "the referee's vehicle") for content in (flights.nominal, flights.true))
    diagnosis = diagnose([flights.recording], nominal, progress, validate=False)
    known = {effect.id: effect for effect in catalogue(nominal)}
    effects = (*(selected.effect for selected in diagnosis.selected), *(known[name] for name in HIDDEN))
    before, after, true = (with_effect_terms(vehicle, effects) for vehicle in (nominal, diagnosis.vehicle, true))
    with jax.enable_x64(True):
        learned = parts.whole(ResidualModel(read_recording(flights.recording, nominal)))
        models = black_boxes.compared([learned], before, after, same_flights=False)
        vehicles, boxes = [*models.vehicles, true], [*models.boxes, models.boxes[0]]
        errors = {name: _errors(table, vehicles, boxes) for name, table in flights.unseen.items()}
    named = [finding["effect"] or finding["equation"] for finding in diagnosis.report["findings"]]
    return {"seed": seed, "named": named, "speeds_m_s": flights.speeds, "flights": errors}


def _errors(table: FlightTable, flown: list[Vehicle], boxes) -> dict:
    """Return {horizon s: {model: RMS position error m}} of one flight."""
    residual_model = ResidualModel(read_recording(table, flown[0]))
    rollouts = rollout.trajectories(residual_model, flown, boxes, 0.0, max(HORIZONS_S), start_s=0.0)
    errors = rollouts.errors(np.round(np.array(HORIZONS_S) / residual_model.recording.dt).astype(int))
    rms = np.sqrt(np.mean(errors**2, axis=1))
    return {
        f"{horizon:.1f}": dict(zip(MODELS, rms[:, h].tolist(), strict=True)) for h, horizon in enumerate(HORIZONS_S)
    }


def ratios(records: Sequence[dict], name: str, horizon: str, box: str) -> np.ndarray:
    """Return the ratio of a black box's error to the repaired vehicle's error, for each seed."""
    rows = [record["flights"][name][horizon] for record in records]
    return np.array([row[box] / row["after"] for row in rows])


def met(records: Sequence[dict]) -> bool:
    """Return whether the median ratios reach the targets, for both black boxes and both unseen flights."""
    return all(
        np.median(ratios(records, name, TARGET_HORIZON, box)) >= target
        for name, target in TARGETS.items()
        for box in BOXES
    )


def table(records: Sequence[dict]) -> str:
    """Return a table of medians over the seeds, with the ranges of the ratios."""
    rows = [
        (
            "unseen flight",
            "after",
            *(f"{NAMES[model]} m" for model in MODELS),
            *(f"{NAMES[box]} / repaired" for box in BOXES),
            "target",
        )
    ]
    for name in UNSEEN:
        for horizon in records[0]["flights"][name]:
            middle = [np.median([record["flights"][name][horizon][model] for record in records]) for model in MODELS]
            times = [ratios(records, name, horizon, box) for box in BOXES]
            rows.append(
                (
                    name,
                    f"{horizon} s",
                    *(f"{value:.2g}" for value in middle),
                    *(f"{np.median(ratio):.1f} ({ratio.min():.1f} to {ratio.max():.1f})" for ratio in times),
                    f"{TARGETS[name]:.0f}" if horizon == TARGET_HORIZON else "",
                )
            )
    return align(rows)
