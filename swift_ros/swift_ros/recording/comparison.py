"""Compares a recording with its replay, field by field, and both with ground truth."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from swift_ros import geometry
from swift_ros.graph.topic_table import full_name
from swift_ros.messages.gates import from_detections, from_gate_poses
from swift_ros.messages.motion import from_odometry
from swift_ros.messages.stamps import from_time
from swift_ros.race.judge import ENDS, RACING
from swift_ros.recording import bags
from swift_ros.text import align
from swift_ros.types import GateCorners, Odometry, RelativeGatePose

# Two detections in the same image are the same gate up to these distances. Larger ones match different gates, smaller
# ones lose gates that both runs found.
SAME_GATE_PX = 20.0  # px; mean distance of their corners
SAME_GATE_M = 2.0  # m; of their positions; the nearest gates of the shipped track are 2.7 m from each other
TRUTH, STATE, VIO = "ground_truth/odometry", "state/odometry", "vio/odometry"


@dataclass
class Perception:
    """Perception in a bag.

    Attributes:
        detections: detected gates by stamp of the image, ns.
        poses: poses of gates by stamp of the image, ns.
        accepted: number of accepted corrections by stamp of the image, ns.
        odometry: odometry by topic.
        start_ns: start of the race, ns; None without a race.
        end_ns: end of the race, ns; None without a race.
    """

    detections: dict[int, list[GateCorners]] = field(default_factory=dict)
    poses: dict[int, list[RelativeGatePose]] = field(default_factory=dict)
    accepted: dict[int, int] = field(default_factory=dict)
    odometry: dict[str, list[Odometry]] = field(default_factory=lambda: {TRUTH: [], STATE: [], VIO: []})
    start_ns: int | None = None
    end_ns: int | None = None


def read_perception(bag: Path) -> Perception:
    """Return the perception in a bag."""
    found = Perception()
    names = ("gates/detections", "gates/poses", "state/updates", "race/status", TRUTH, STATE, VIO)
    short = {full_name(name): name for name in names}
    for topic, message, _ in bags.read(bag, short):
        name, stamp_ns = short[topic], from_time(message.header.stamp)
        if name in found.odometry:
            found.odometry[name].append(from_odometry(message))
        elif name == "gates/detections":
            found.detections[stamp_ns] = from_detections(message)
        elif name == "gates/poses":
            found.poses[stamp_ns] = from_gate_poses(message)
        elif name == "state/updates":
            found.accepted[stamp_ns] = sum(update.accepted for update in message.updates)
        elif message.state == RACING and found.start_ns is None:
            found.start_ns = stamp_ns
        elif message.state in ENDS and found.end_ns is None:
            found.end_ns = stamp_ns
    return found


def compare(recorded: Perception, replayed: Perception) -> dict:
    """Return the comparison as written to `result.json`: counts, px, m, degrees; None without data.

    Errors relative to ground truth are those from the start to the end of the race, or of the whole recording without a
    race.
    """
    corners = [
        distance
        for a, b in _pairs(recorded.detections, replayed.detections)
        for distance in _matched(a, b, _corners_px, SAME_GATE_PX)
    ]
    positions = [
        distance
        for a, b in _pairs(recorded.poses, replayed.poses)
        for distance in _matched(a, b, _position_m, SAME_GATE_M)
    ]
    return {
        "images": {"recorded": len(recorded.detections), "replayed": len(replayed.detections)},
        "gates": {**_both(recorded, replayed, lambda p: _total(p.detections)), "matched": len(corners)},
        "corners_px": _spread(np.concatenate(corners) if corners else np.array([])),
        "poses": {**_both(recorded, replayed, lambda p: _total(p.poses)), "matched": len(positions)},
        "pose_position_m": _spread(np.array(positions)),
        "corrections_accepted": _both(recorded, replayed, lambda p: sum(p.accepted.values())),
        "states": _both(recorded, replayed, lambda p: len(p.odometry[STATE])),
        "state_difference": state_error(replayed.odometry[STATE], recorded.odometry[STATE]),
        "state_to_truth": _both(recorded, replayed, lambda p: _truth_error(p, recorded, STATE)),
        "vio_to_truth": _both(recorded, replayed, lambda p: _truth_error(p, recorded, VIO)),
    }


def table(result: dict) -> str:
    """Return the comparison as a text table."""
    rows = [("", "recorded", "replayed", "difference")]
    for name, key in (
        ("processed images", "images"),
        ("detected gates", "gates"),
        ("gate poses", "poses"),
        ("accepted corrections", "corrections_accepted"),
        ("states", "states"),
    ):
        row = result[key]
        matched = f"{row['matched']} matched" if row.get("matched") else ""
        if row["recorded"] or row["replayed"]:
            rows.append((name, str(row["recorded"]), str(row["replayed"]), matched))
    for name, key, unit in (("corners", "corners_px", "px"), ("gate positions", "pose_position_m", "m")):
        spread = result[key]
        if spread:
            rows.append((name, "", "", f"median {spread['median']:.3g}, max {spread['max']:.3g} {unit}"))
    if result["state_difference"]:
        error = result["state_difference"]
        rows.append(("state", "", "", f"RMS {error['rmse_m']:.3g}, max {error['max_m']:.3g} m"))
    for name, key in (("state to ground truth", "state_to_truth"), ("odometry to ground truth", "vio_to_truth")):
        rows.append((name, _error_text(result[key]["recorded"]), _error_text(result[key]["replayed"]), ""))
    return align(rows)


def _error_text(error: dict | None) -> str:
    return f"RMS {error['rmse_m']:.3f} m, {error['rms_deg']:.2f} deg" if error else "-"


def state_error(states: list[Odometry], reference: list[Odometry], window=(None, None)) -> dict | None:
    """Return the error of states relative to a reference interpolated to their stamps.

    Args:
        states: the states.
        reference: the reference, in the order of its stamps.
        window: first and last stamp (ns) to compare, None for no limit.

    Returns:
        Number of states, RMS and maximum distance (m) and RMS angle (degrees); None without common stamps.
    """
    if len(states) == 0 or len(reference) < 2:
        return None
    at, times = _stamps(states), _stamps(reference)
    first, last = (times[0], times[-1])
    first, last = max(first, window[0] or first), min(last, window[1] or last)
    inside = (at >= first) & (at <= last)
    if not inside.any():
        return None
    at = at[inside]
    after = np.clip(np.searchsorted(times, at), 1, len(times) - 1)
    share = ((at - times[after - 1]) / (times[after] - times[after - 1]))[:, None]
    p, q = (np.array([getattr(state, name) for state in reference]) for name in ("p_world", "q_world_body"))
    p_reference = (1.0 - share) * p[after - 1] + share * p[after]
    q_reference = q[np.where(share[:, 0] < 0.5, after - 1, after)]  # of the nearer sample; they are 10 ms apart
    chosen = [state for state, is_inside in zip(states, inside, strict=True) if is_inside]
    distance = np.linalg.norm(np.array([state.p_world for state in chosen]) - p_reference, axis=1)
    q_error = geometry.quaternion_multiply(
        geometry.quaternion_conjugate(q_reference), np.array([state.q_world_body for state in chosen])
    )
    angle = np.degrees(np.linalg.norm(geometry.rotation_vector_from_quaternion(q_error), axis=1))
    rms, rms_angle = (float(np.sqrt(np.mean(values**2))) for values in (distance, angle))
    return {"count": len(chosen), "rmse_m": rms, "max_m": float(distance.max()), "rms_deg": rms_angle}


def position_errors(states: list[Odometry], reference: list[Odometry]) -> tuple[np.ndarray, np.ndarray]:
    """Return the stamps (n,) ns of the states within a reference and their distances (n,) m from it."""
    if len(states) == 0 or len(reference) < 2:
        return np.array([]), np.array([])
    at, times = _stamps(states), _stamps(reference)
    inside = (at >= times[0]) & (at <= times[-1])
    p = np.array([state.p_world for state in reference])
    expected = np.stack([np.interp(at[inside] - times[0], times - times[0], p[:, axis]) for axis in range(3)], axis=-1)
    positions = np.array([state.p_world for state in states])[inside]
    return at[inside], np.linalg.norm(positions - expected, axis=1)


def _stamps(states: list[Odometry]) -> np.ndarray:
    return np.array([state.stamp_ns for state in states], dtype=np.int64)


def _truth_error(perception: Perception, recorded: Perception, topic: str) -> dict | None:
    """Return the error relative to the recording's ground truth, which the replay only copies."""
    return state_error(perception.odometry[topic], recorded.odometry[TRUTH], (recorded.start_ns, recorded.end_ns))


def _both(recorded: Perception, replayed: Perception, value) -> dict:
    return {"recorded": value(recorded), "replayed": value(replayed)}


def _total(by_stamp: dict[int, list]) -> int:
    return sum(len(gates) for gates in by_stamp.values())


def _pairs(recorded: dict[int, list], replayed: dict[int, list]):
    """Yield the entries of both for each common stamp."""
    return ((recorded[stamp], replayed[stamp]) for stamp in sorted(recorded.keys() & replayed.keys()))


def _corners_px(a: GateCorners, b: GateCorners) -> np.ndarray:
    return np.linalg.norm(a.corners_px - b.corners_px, axis=1)


def _position_m(a: RelativeGatePose, b: RelativeGatePose) -> float:
    return float(np.linalg.norm(a.p_body - b.p_body))


def _matched(first: list, second: list, distance, max_distance: float) -> list:
    """Match the gates of two lists, nearest pairs first, and return the distances of the matches."""
    candidates = [(np.mean(distance(a, b)), i, j) for i, a in enumerate(first) for j, b in enumerate(second)]
    used_first, used_second, result = set(), set(), []
    for mean, i, j in sorted(candidates):
        if mean <= max_distance and i not in used_first and j not in used_second:
            used_first.add(i)
            used_second.add(j)
            result.append(distance(first[i], second[j]))
    return result


def _spread(values: np.ndarray) -> dict | None:
    if values.size == 0:
        return None
    median, high = np.percentile(values, (50, 95))
    return {"median": float(median), "p95": float(high), "max": float(values.max())}
