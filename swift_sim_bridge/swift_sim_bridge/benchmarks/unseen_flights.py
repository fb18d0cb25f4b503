"""What a diagnosis of one flight is worth on others, beside black boxes that learnt from the same flight.

The referee conceals three drags in a vehicle of its own and flies it; from the recording, with its noise, the tool
diagnoses and the black boxes learn. Then all fly on from true states of two more flights of the vehicle, under the
motor commands of these: one along another path, and one along the recorded path, a quarter faster. The recorded flight
is pushed by chance, these are not: what chance does no model foretells, and it would stand for all of them.
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
from swift_sim_bridge.gap.validation import holdout
from swift_sim_bridge.referee.catalogue import EFFECTS
from swift_sim_bridge.referee.planting import conceal
from swift_sim_bridge.referee.simulator import flight, instruments, paths, vehicles

HIDDEN = ("rotor_drag", "body_drag", "axial_inflow")
TIMES = 10.0  # the size that should be detectable, of each
SECONDS, FASTER = 30.0, 1.25
ROOM = 0.6  # of the vehicle's thrust, for the path that is to be flown faster as well
UNSEEN = ("another path", "25 % faster")
TARGETS = dict(zip(UNSEEN, (5.0, 20.0), strict=True))  # times that the black boxes' error must be larger, at 0.5 s
MODELS = (*holdout.MODELS, "true")
NAMES = dict(zip(MODELS, ("vehicle file", "repaired", "kNN", "GP", "true vehicle"), strict=True))
BOXES, JUDGED = ("knn", "gp"), "0.5"
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
    """nominal: what the tool gets; true: the same with HIDDEN in it; recording: of the first flight, with noise;
    unseen: by name of UNSEEN, the others without noise; speeds: the highest of each, m/s."""

    nominal: dict
    true: dict
    recording: FlightTable
    unseen: dict[str, FlightTable]
    speeds: dict[str, float]


def fly(seed: int) -> Flights:
    """Return the flights of a seed's vehicle."""
    rng = np.random.default_rng([seed, 211])
    nominal = true = vehicles.draw_vehicle(rng, f"racer {seed}")
    for name in HIDDEN:
        true = conceal(true, EFFECTS[name].plant(true, TIMES * EFFECTS[name].detectable, rng))
    top, seconds = ROOM * vehicles.top_thrust(nominal), SECONDS + instruments.LEAD_S
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
    silent = true | {"sensors": dict.fromkeys(true["sensors"], 0.0)}
    exact = [
        instruments.record(replace(truth, gyro=truth.w), silent, rng, channels=CHANNELS, name=name)
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


def judge(seed: int, tell: Callable[[str], None] = print) -> dict:
    """Return {"seed", "named": what the tool named, "speeds_m_s", "flights": {of UNSEEN: {horizon s: {model: root mean
    square position error m}}}} of a seed."""
    flights = fly(seed)
    nominal, true = (build(Vehicle, content, "the referee's vehicle") for content in (flights.nominal, flights.true))
    diagnosis = diagnose([flights.recording], nominal, tell, validate=False)
    known = {effect.id: effect for effect in catalogue(nominal)}
    effects = (*(one.effect for one in diagnosis.selected), *(known[name] for name in HIDDEN))
    before, after, true = (with_effect_terms(vehicle, effects) for vehicle in (nominal, diagnosis.vehicle, true))
    with jax.enable_x64(True):
        boxes = holdout.black_boxes((ResidualModel(read_recording(flights.recording, nominal)),), before, share=1.0)
        errors = {
            name: _errors(table, [before, after, before, before, true], [*boxes, boxes[0]])
            for name, table in flights.unseen.items()
        }
    named = [one["effect"] or one["equation"] for one in diagnosis.report["findings"]]
    return {"seed": seed, "named": named, "speeds_m_s": flights.speeds, "flights": errors}


def _errors(table: FlightTable, flown: list[Vehicle], boxes) -> dict:
    residual_model = ResidualModel(read_recording(table, flown[0]))
    course = rollout.trajectories(residual_model, flown, boxes, 0.0, max(holdout.HORIZONS_S), start_s=0.0)
    errors = course.errors(np.round(np.array(holdout.HORIZONS_S) / residual_model.recording.dt).astype(int))
    rms = np.sqrt(np.mean(errors**2, axis=1))
    return {
        f"{horizon:.1f}": dict(zip(MODELS, rms[:, h].tolist(), strict=True))
        for h, horizon in enumerate(holdout.HORIZONS_S)
    }


def ratios(records: Sequence[dict], name: str, horizon: str, box: str) -> np.ndarray:
    """Return by how many times a black box's error exceeds the repaired vehicle's, of each seed."""
    rows = [record["flights"][name][horizon] for record in records]
    return np.array([row[box] / row["after"] for row in rows])


def met(records: Sequence[dict]) -> bool:
    """Return whether the median ratio reaches the target for both black boxes on both unseen flights."""
    return all(
        np.median(ratios(records, name, JUDGED, box)) >= target for name, target in TARGETS.items() for box in BOXES
    )


def table(records: Sequence[dict]) -> str:
    """Return the figures as text: medians over seeds, and the range of the ratios."""
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
                    *(f"{np.median(one):.1f} ({one.min():.1f} to {one.max():.1f})" for one in times),
                    f"{TARGETS[name]:.0f}" if horizon == JUDGED else "",
                )
            )
    return align(rows)
