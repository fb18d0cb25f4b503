"""Where in a flight a gain shows: spans of time, segments between gates and flight regimes."""

import numpy as np

from swift_ros import geometry
from swift_ros.race.rules import plane_crossing
from swift_ros.track import Track, to_gate_frame
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel

WINDOW_S = 0.5  # resolution in time
LOCATED_SHARE = 0.8  # of a finding's gain that the reported spans contain
WHOLE_FLIGHT_SHARE = 0.6  # of the windows; a finding that needs more shows in the whole flight
REGIME_PARTS = 5  # of equal duration, into which the values of a quantity are divided
MIN_REGIME_RATIO = 1.5  # gain of a part relative to the mean, for the part to be reported
MAX_SPANS = 10  # reported for one recording; the longest ones


def where_in_flight(residual_model: ResidualModel, gain, track: Track | None) -> dict:
    """Return time spans, segments and flight regime of a gain (m,) in one recording.

    Args:
        residual_model: of the recording.
        gain: (m,) gain at each residual.
        track: the track, if the flight passes its gates.
    """
    good, located = residual_model.good, spans(residual_model.t, gain)
    passed = passages(residual_model.recording, track) if track else []
    return {
        "time": located,
        "segments": segments(passed, located),
        "regime": regime(gain[good], quantities(residual_model, good)),
    }


def spans(t, gain) -> list[list[float]]:
    """Return the spans of time, s, that contain most of a gain (m,) at times t (m,) s.

    If they are most of the flight, the whole flight is returned.
    """
    window = np.floor((t - t[0]) / WINDOW_S).astype(int)
    gains = np.bincount(window, np.maximum(gain, 0.0))
    order = np.argsort(-gains)
    count = int(np.searchsorted(np.cumsum(gains[order]), LOCATED_SHARE * gains.sum())) + 1
    if not gains.any() or count > WHOLE_FLIGHT_SHARE * len(gains):
        return [[float(t[0]), float(t[-1])]]
    chosen = np.sort(order[:count])
    runs = np.split(chosen, np.flatnonzero(np.diff(chosen) > 1) + 1)
    runs = sorted(sorted(runs, key=len, reverse=True)[:MAX_SPANS], key=lambda run: run[0])
    return [[float(t[0] + WINDOW_S * run[0]), float(min(t[-1], t[0] + WINDOW_S * (run[-1] + 1)))] for run in runs]


def regime(gain, known: dict[str, tuple[np.ndarray, str]]) -> str:
    """Return in words the flight regime in which a gain is largest; empty if it does not depend on any quantity.

    Args:
        gain: (m,) gain at each residual.
        known: quantities by name: values (m,) and unit.
    """
    best, text = MIN_REGIME_RATIO, ""
    for name, (values, unit) in known.items():
        edges = np.quantile(values, np.linspace(0.0, 1.0, REGIME_PARTS + 1))
        part = np.clip(np.searchsorted(edges, values, "right") - 1, 0, REGIME_PARTS - 1)
        count = np.bincount(part, minlength=REGIME_PARTS)
        if np.any(count == 0) or gain.mean() <= 0:
            continue
        ratios = np.bincount(part, gain, REGIME_PARTS) / count / gain.mean()
        largest = int(np.argmax(ratios))
        if ratios[largest] > best:
            best = ratios[largest]
            side = _interval(edges[largest], edges[largest + 1], unit, largest)
            text = f"most where the {name} is {side} ({best:.1f} times as much as on average)"
    return text


def _interval(lower: float, upper: float, unit: str, part: int) -> str:
    """Return the range of one of REGIME_PARTS parts of a quantity in words."""
    low, high = f"{lower:.4g}", f"{upper:.4g} {unit}".rstrip()
    if part == REGIME_PARTS - 1:
        return f"above {low} {unit}".rstrip()
    return f"below {high}" if not part else f"between {low} and {high}"


def quantities(residual_model: ResidualModel, good) -> dict[str, tuple[np.ndarray, str]]:
    """Return the quantities that define flight regimes, by name: values (m,) at the good residuals, and unit."""
    recording, rows, found = residual_model.recording, residual_model.filter.rows, {}
    if recording.has("v_world", "q_world_body"):
        v_body = geometry.rotate_inverse(recording.q_world_body, recording.v_world)
        found["speed"] = np.linalg.norm(recording.v_world, axis=1), "m/s"
        found["climb through the rotors"] = v_body[:, 2], "m/s"
    if recording.has("p_world"):
        found["height"] = recording.p_world[:, 2], "m"
    if recording.has("gyro_body"):
        found["body rate"] = np.linalg.norm(recording.gyro_body, axis=1), "rad/s"
    if recording.has("rotor_speed"):
        found["rotor speed"] = recording.rotor_speed.mean(axis=1), "rad/s"
    if recording.has("voltage"):
        found["voltage"] = recording.voltage, "V"
    return {name: (values[rows][good], unit) for name, (values, unit) in found.items()}


def passages(recording, track: Track) -> list[tuple[float, int]]:
    """Return time (s) and number (from 1) of each passage of a gate of the track, in order."""
    if not recording.has("p_world"):
        return []
    found, p = [], recording.p_world
    frames = zip(track.positions, track.rotations, track.inner_sides, strict=True)
    for number, (centre, rotation, side) in enumerate(frames, start=1):
        local = to_gate_frame(centre, rotation, p)
        crossed, _, offset = plane_crossing(local[:-1], local[1:])
        through = crossed & (np.abs(offset) < 0.5 * side).all(axis=1)
        found += [(float(recording.t[i]), number) for i in np.flatnonzero(through)]
    return sorted(found)


def segments(passed: list[tuple[float, int]], located: list[list[float]]) -> list[str]:
    """Return the segments between gates that contain spans of time; none if these are all segments.

    Args:
        passed: time (s) and number of each passage, see `passages`.
        located: begin and end (s) of each span.
    """
    shown, every = set(), set()
    for (begin, first), (end, second) in zip(passed[:-1], passed[1:], strict=True):
        every.add((first, second))
        if any(low < end and high > begin for low, high in located):
            shown.add((first, second))
    return [f"gate {first} to gate {second}" for first, second in sorted(shown)] if shown != every else []
