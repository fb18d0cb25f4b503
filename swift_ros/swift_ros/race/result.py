"""The result of one race, computed from its record and the simulator's report. No ROS; `race_bag` reads the record.

`swiftros race` writes results, `swiftros check` computes them again.
"""

import dataclasses
import hashlib
import math
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from swift_ros.race.judge import ENDS, FINISHED, LOST, Judge, RaceEvent
from swift_ros.track import Track
from swift_ros.types import BodyRateThrust, Odometry
from swift_ros.vehicle import Vehicle

BAG, REPORT, FAULTS, RESULT = "bag", "simulator.json", "faults.json", "result.json"
CUT_SHORT = "the bag stops before the race ends"


@dataclass(frozen=True)
class RaceResult:
    """A row of `result.json`; None where a value is not known.

    Attributes:
        seed: of the race.
        finished: the last gate was passed.
        end: state at the end, one of `judge.ENDS`.
        time_s: start signal to finish.
        laps_s: each flying lap that was completed.
        gates_passed: number of passages.
        crash: what ended the race, unless it finished.
        min_gate_margin_m, mean_gate_margin_m: hull to inner edge at the passages.
        state_rmse_m, vio_rmse_m: position errors of state estimate and raw VIO.
        thrust_to_weight: largest possible, at the start and at the end.
        msp_sha256, truth_sha256: of the MSP bytes and of ground truth.
    """

    seed: int | None
    finished: bool
    end: str
    time_s: float | None
    laps_s: list[float]
    gates_passed: int
    crash: str | None
    min_gate_margin_m: float | None
    mean_gate_margin_m: float | None
    state_rmse_m: float | None
    vio_rmse_m: float | None
    thrust_to_weight: list[float] | None
    msp_sha256: str | None
    truth_sha256: str | None


@dataclass(frozen=True)
class RaceRecord:
    """A race as its bag has it.

    Attributes:
        odometry: by topic.
        events: as published on race/status.
        start_ns, end_ns: stamps of the start signal and of the end; None without one.
        commands: sent to the flight controller.
        voltages: stamp (ns) and V of each reading of the battery.
    """

    odometry: dict[str, list[Odometry]]
    events: list[RaceEvent]
    start_ns: int | None
    end_ns: int | None
    commands: list[BodyRateThrust] = field(default_factory=list)
    voltages: list[tuple[int, float]] = field(default_factory=list)


def judge_again(record: RaceRecord, track: Track, vehicle: Vehicle) -> list[RaceEvent]:
    """Return passages and end of a race, judged again from ground truth; without ground truth as published.

    An end that does not follow from poses (stopped, lost) is the published one.
    """
    truth = record.odometry["ground_truth/odometry"]
    published = [event for event in record.events if event.is_passage or event.state in ENDS]
    ends = [k for k, event in enumerate(published) if event.state in ENDS]
    published = published[: ends[0] + 1] if ends else published  # after the finish a race may be stopped, too
    if not truth or record.start_ns is None:
        return published
    judge = Judge(track, vehicle.hull_radius, vehicle.hull_height)
    judge.start(record.start_ns)
    events = [event for pose in truth for event in judge.update(pose)]
    if events and events[-1].state in ENDS:
        return events
    return events + [event for event in published if event.state in ENDS and not event.is_passage]


def result_of(record: RaceRecord, track: Track, vehicle: Vehicle, report: dict) -> RaceResult:
    """Return the result of a recorded race.

    Args:
        record: of the race.
        track, vehicle: that were flown.
        report: the simulator's `simulator.json` and the runner's "faults"; values of absent keys are None.
    """
    events = judge_again(record, track, vehicle)
    passages = [event for event in events if event.is_passage]
    ended = events[-1] if events and events[-1].state in ENDS else None
    end = ended.state if ended else LOST  # the recording stops before the race ends: the recorder was lost
    first_gate = [1e-9 * event.stamp_ns for event in passages[:: len(track.gates)]]
    margins = [event.margin_m for event in passages if not math.isnan(event.margin_m)]
    truth = record.odometry["ground_truth/odometry"]
    finished = end == FINISHED
    return RaceResult(
        seed=report.get("seed"),
        finished=finished,
        end=end,
        time_s=1e-9 * (passages[-1].stamp_ns - record.start_ns) if finished and record.start_ns is not None else None,
        laps_s=[round(lap, 6) for lap in np.diff(first_gate).tolist()],
        gates_passed=len(passages),
        crash=None if finished else ended.text if ended else "; ".join(report.get("faults", [])) or CUT_SHORT,
        min_gate_margin_m=min(margins, default=None),
        mean_gate_margin_m=float(np.mean(margins)) if margins else None,
        state_rmse_m=position_rmse(record, "state/odometry"),
        vio_rmse_m=position_rmse(record, "vio/odometry"),
        thrust_to_weight=report.get("thrust_to_weight"),
        msp_sha256=report.get("msp_sha256"),
        truth_sha256=truth_hash(truth, record.end_ns) if truth else None,
    )


def position_rmse(record: RaceRecord, topic: str) -> float | None:
    """Return the RMS distance (m) between a topic's positions and ground truth during the race, without alignment.

    It is None if either is missing.
    """
    truth, estimate = record.odometry["ground_truth/odometry"], record.odometry[topic]
    if not truth or record.start_ns is None:
        return None
    end_ns = record.end_ns or truth[-1].stamp_ns
    last_ns = min(end_ns, truth[-1].stamp_ns)
    compared = [state for state in estimate if max(record.start_ns, truth[0].stamp_ns) <= state.stamp_ns <= last_ns]
    if not compared:
        return None
    t, t_truth = ([1e-9 * (state.stamp_ns - truth[0].stamp_ns) for state in states] for states in (compared, truth))
    p_truth = np.array([pose.p_world for pose in truth])
    expected = np.stack([np.interp(t, t_truth, p_truth[:, axis]) for axis in range(3)], axis=-1)
    error = np.array([state.p_world for state in compared]) - expected
    return float(np.sqrt(np.mean(np.sum(error * error, axis=1))))


def truth_hash(truth: list[Odometry], end_ns: int | None) -> str:
    """Return the SHA-256 of ground truth (stamps, poses and velocities) up to the end of the race."""
    digest = hashlib.sha256()
    for pose in truth:
        if end_ns is None or pose.stamp_ns <= end_ns:
            values = (*pose.p_world, *pose.q_world_body, *pose.v_body, *pose.omega_body)
            digest.update(struct.pack("<q13d", pose.stamp_ns, *values))
    return digest.hexdigest()


def summary(races: list[RaceResult], models: dict[str, str]) -> dict:
    """Return the content of `result.json`.

    Args:
        races: the results.
        models: SHA-256 of each network, by file name.
    """
    laps = [lap for race in races for lap in race.laps_s]
    return {
        "races": [dataclasses.asdict(race) for race in races],
        "finish_rate": sum(race.finished for race in races) / len(races) if races else None,
        "best_lap_s": min(laps, default=None),
        "median_lap_s": float(np.median(laps)) if laps else None,
        "models": models,
    }


def model_hashes(config: Path) -> dict[str, str]:
    """Return the SHA-256 of each network in a configuration folder, by file name."""
    files = sorted((config / "models").glob("*.onnx"))
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def disagreements(stored: Any, computed: Any, where: str = "") -> list[str]:
    """Return a sentence for each value that differs between two results.

    Args:
        stored: as written.
        computed: as computed again; numbers may differ by a relative 1e-9.
        where: path of the value, for the sentence.
    """
    if isinstance(stored, dict) and isinstance(computed, dict):
        keys = dict.fromkeys((*stored, *computed))
        return [line for key in keys for line in disagreements(stored.get(key), computed.get(key), f"{where}.{key}")]
    if isinstance(stored, list) and isinstance(computed, list) and len(stored) == len(computed):
        pairs = enumerate(zip(stored, computed, strict=True))
        return [line for i, (a, b) in pairs for line in disagreements(a, b, f"{where}[{i}]")]
    if isinstance(stored, int | float) and isinstance(computed, int | float):
        same = math.isclose(stored, computed, rel_tol=1e-9, abs_tol=1e-9)
    else:
        same = stored == computed
    return [] if same else [f"{where.lstrip('.')}: {stored} was written, {computed} follows from the bag"]
