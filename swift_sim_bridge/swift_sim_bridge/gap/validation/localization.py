"""Localization of findings: the times, segments between gates and flight regimes in which they show, and how much."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from swift_ros import geometry
from swift_ros.race.rules import plane_crossing
from swift_ros.track import Track, to_gate_frame
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import Effect
from swift_sim_bridge.gap.discovery import equation_search
from swift_sim_bridge.gap.effects.injection import inject
from swift_sim_bridge.gap.inference.sensitivity import linearise, perturbed_variants, with_effect_terms
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel
from swift_sim_bridge.gap.validation.mismatch import repaired_for
from swift_sim_bridge.physics.terms import equation

WINDOW_S = 0.5  # resolution in time
LOCATED_SHARE = 0.8  # of a finding's gain that the reported spans contain
WHOLE_FLIGHT_SHARE = 0.6  # of the windows; a finding that needs more shows in the whole flight
REGIME_PARTS = 5  # of equal duration, into which the values of a quantity are divided
MIN_REGIME_RATIO = 1.5  # gain of a part relative to the mean, for the part to be reported
MAX_SPANS = 10  # reported for one recording; the longest ones
MIN_CHANNEL_SHARE = 0.1  # of the gain in the finding's strongest channel, for another channel to be reported


def locate_findings(diagnosis, vehicle: Vehicle, track: Track | None = None) -> dict:
    """Return the report of a diagnosis with `where`, `channels`, `removes` and `most_improved` of each finding.

    Findings of a single one of several recordings keep their entries but `removes`: the share of the squared error of
    the vehicle file, in multiples of the noise, that comes back without the finding while all others stay.

    Args:
        diagnosis: the diagnosis (`pipeline.diagnosis.Diagnosis`).
        vehicle: the vehicle before the repair.
        track: the track, if the flights pass its gates.
    """
    effects = tuple(one.effect for one in diagnosis.selected)
    repaired, nothing = (with_effect_terms(some, effects) for some in (diagnosis.vehicle, vehicle))
    before, after = ([one.residual(some) for one, _ in _recordings(diagnosis)] for some in (nothing, repaired))
    repair = _Repair(
        diagnosis=diagnosis,
        nothing=nothing,
        named=_without_equation(diagnosis, nothing, repaired),
        repaired=repaired,
        after=after,
        totals=[float(gain.sum()) for gain in _gains(diagnosis, before, [0.0] * len(before))],
    )
    findings = [finding | _location(repair, finding, vehicle, track) for finding in diagnosis.report["findings"]]
    together = _share(_gains(diagnosis, before, after), sum(repair.totals))
    improvement = diagnosis.report["improvement"] | {"removes": together}
    return {**diagnosis.report, "findings": findings, "improvement": improvement}


@dataclass(frozen=True)
class _Repair:
    """What all findings of a diagnosis are located with.

    Attributes:
        diagnosis: the diagnosis.
        nothing: the vehicle before the repair, with the terms of all effects idle.
        named: the vehicle with the names of the repair and without its equation.
        repaired: the repaired vehicle; the same one if the vehicle file does not carry the equation.
        after: residuals (m, c) of each recording after the repair.
        totals: squared error of each recording before the repair, in multiples of the noise.
    """

    diagnosis: Any
    nothing: Vehicle
    named: Vehicle
    repaired: Vehicle
    after: list[np.ndarray]
    totals: list[float]


def _location(repair: _Repair, finding: dict, vehicle: Vehicle, track: Track | None) -> dict:
    """Return the entries of a finding that `locate_findings` adds."""
    diagnosis = repair.diagnosis
    if "recording" in finding:
        names = [residual_model.recording.name for residual_model, _ in _recordings(diagnosis)]
        i = names.index(finding["recording"])
        return {"removes": _share([_gain_in_one_recording(diagnosis, vehicle, i, finding)], repair.totals[i])}
    if "unexplained" in finding:
        return _location_of_unexplained(repair, finding, track)
    if finding["effect"] is None:
        return _location_of_equation(repair, finding, track)
    selected = next((one for one in diagnosis.selected if _is_of(finding, one.effect)), None)
    return _location_of_name(repair, selected, finding, track) if selected else {}


def _location_of_name(repair: _Repair, selected, finding: dict, track: Track | None) -> dict:
    """Return the entries of the finding of a selected effect."""
    diagnosis, without = repair.diagnosis, repair.nothing
    for other in (one for one in diagnosis.selected if one is not selected):
        without = inject(without, other.effect, other.values)
    worse = [one.residual(without) for one, _ in _recordings(diagnosis)]
    gains = _gains(diagnosis, worse, repair.after)
    return _entries(diagnosis, gains, finding, track) | {
        "removes": _share(gains, sum(repair.totals)),
        "most_improved": _most_improved(diagnosis, gains, worse, repair.after),
    }


def _location_of_unexplained(repair: _Repair, finding: dict, track: Track | None) -> dict:
    """Return the entries of a residual that nothing explains."""
    diagnosis = repair.diagnosis
    own = np.isin([channel.id for channel in diagnosis.evidence.residual_models[0].channels], finding["channels"])
    left = _gains(diagnosis, [one * own for one in repair.after], [0.0] * len(repair.after))
    return _entries(diagnosis, left, finding, track)


def _location_of_equation(repair: _Repair, finding: dict, track: Track | None) -> dict:
    """Return the entries of an equation."""
    diagnosis = repair.diagnosis
    gains = [
        _gain(residual_model, noise, *_equation_residuals(diagnosis, i, repair.named, repair.repaired))
        for i, (residual_model, noise) in enumerate(_recordings(diagnosis))
    ]
    entries = _entries(diagnosis, gains, finding, track)
    domain = entries["where"] | {"regime": finding["where"]["regime"]}  # of the equation
    return {
        **entries,
        "where": domain,
        "removes": _share(gains, sum(repair.totals)),
        "parameters": _with_shares(finding["parameters"], diagnosis, repair.named),
    }


def _gain_in_one_recording(diagnosis, vehicle: Vehicle, i: int, finding: dict) -> np.ndarray:
    """Return the gain (m, c) of a finding that belongs to recording i alone."""
    residual_model, noise = _recordings(diagnosis)[i]
    own, effects = diagnosis.own_effects[i], tuple(one.effect for one in diagnosis.selected)
    rest = tuple(one for one in own if not _is_of(finding, one.effect))
    without, repaired = (
        residual_model.residual(with_effect_terms(repaired_for(diagnosis, vehicle, some), effects))
        for some in (rest, own)
    )
    return _gain(residual_model, noise, without, repaired)


def _recordings(diagnosis) -> list[tuple[ResidualModel, np.ndarray]]:
    """Return the residual model and the noise (c,) of each recording."""
    return list(zip(diagnosis.evidence.residual_models, diagnosis.evidence.noises, strict=True))


def _without_equation(diagnosis, vehicle: Vehicle, repaired: Vehicle) -> Vehicle:
    """Return the vehicle with the names of the repair and without its equation.

    Args:
        diagnosis: the diagnosis.
        vehicle: the vehicle before the repair.
        repaired: the repaired vehicle, which may have the equation.
    """
    names = [one for one in diagnosis.selected if not one.effect.id.startswith(equation.PREFIX)]
    if len(names) == len(diagnosis.selected):
        return repaired
    for one in names:
        vehicle = inject(vehicle, one.effect, one.values)
    return vehicle


def _equation_residuals(diagnosis, number: int, named: Vehicle, repaired: Vehicle) -> tuple[np.ndarray, np.ndarray]:
    """Return the residuals (m, c) of one recording before and after the equation.

    Args:
        diagnosis: the diagnosis.
        number: index of the recording.
        named: the vehicle with the names of the repair and without its equation.
        repaired: the repaired vehicle; the same one if the vehicle file does not carry the equation.
    """
    if named is not repaired:
        residual_model = diagnosis.evidence.residual_models[number]
        return residual_model.residual(named), residual_model.residual(repaired)
    return _linear_equation_residuals(diagnosis, number, named)


def _linear_equation_residuals(diagnosis, number: int, named: Vehicle) -> tuple[np.ndarray, np.ndarray]:
    """Return the residuals (m, c) of one recording before and after the terms that the equation search has found."""
    residual_model = diagnosis.evidence.residual_models[number]
    line = linearise(residual_model, perturbed_variants(named, ()))
    library, terms = diagnosis.evidence.library, diagnosis.equation_terms
    after = equation_search.subtract_terms(library, number, line, terms, residual_model.channels)
    return line.residual, after.residual


def _with_shares(parameters: dict, diagnosis, named: Vehicle) -> dict:
    """Return the entries of an equation's terms, each with the share of its channel's squared error that it removes."""
    channels = diagnosis.evidence.residual_models[0].channels
    before, without = np.zeros(len(channels)), dict.fromkeys(parameters, 0.0)
    for number, (residual_model, _) in enumerate(_recordings(diagnosis)):
        good = residual_model.good[:, None]
        left, rest = (np.where(good, one, 0.0) for one in _linear_equation_residuals(diagnosis, number, named))
        before += np.square(left).sum(axis=0)
        for term in diagnosis.equation_terms:
            c = channels.index(term.channel)
            own = diagnosis.evidence.library.features[number][c]
            part = term.value * np.where(good[:, 0], own.values[:, own.names.index(term.name)], 0.0)
            without[f"{term.channel.id}: {term.name}"] += np.sum(np.square(rest[:, c] + part) - np.square(rest[:, c]))
    ids = [channel.id for channel in channels]
    squares = {key: before[ids.index(entry["channel"])] for key, entry in parameters.items()}
    return {
        key: entry | {"removes": float(np.clip(without[key] / max(squares[key], 1e-300), 0.0, 1.0))}
        for key, entry in parameters.items()
    }


def _gains(diagnosis, before: list, after: list) -> list[np.ndarray]:
    """Return the gain (m, c) in each recording between its residuals (m, c) before and after."""
    return [
        _gain(residual_model, noise, *residuals)
        for (residual_model, noise), *residuals in zip(_recordings(diagnosis), before, after, strict=True)
    ]


def _most_improved(diagnosis, gains: list, worse: list, after: list) -> dict:
    """Return the channel in which a gain (m, c) is largest, and its root mean squares without and with the finding."""
    c = int(np.argmax(sum(gain.sum(axis=0) for gain in gains)))
    good = [residual_model.good for residual_model, _ in _recordings(diagnosis)]

    def rms(residuals: list) -> float:
        return float(
            np.sqrt(np.mean(np.concatenate([one[rows, c] ** 2 for one, rows in zip(residuals, good, strict=True)])))
        )

    channel = diagnosis.evidence.residual_models[0].channels[c]
    return {"channel": channel.id, "without": rms(worse), "with": rms(after)}


def _share(gains: list[np.ndarray], total: float) -> float:
    """Return the gains (m, c) of all recordings as a share of the total squares, 0 to 1."""
    return float(np.clip(sum(gain.sum() for gain in gains) / max(total, 1e-300), 0.0, 1.0))


def _gain(residual_model: ResidualModel, noise, before, after) -> np.ndarray:
    """Return the decrease of the normalised squares of each residual (m, c)."""
    return np.where(residual_model.good[:, None], (before**2 - after**2) / noise**2, 0.0)


def _entries(diagnosis, gains: list[np.ndarray], finding: dict, track: Track | None) -> dict:
    """Return the entries `where` and `channels` of a finding, from its gain (m, c) in each recording."""
    parts = [
        _where(residual_model, gain.sum(axis=1), track)
        for (residual_model, _), gain in zip(_recordings(diagnosis), gains, strict=True)
    ]
    where = {
        "time": [span for part in parts for span in part["time"]],
        "segments": sorted({name for part in parts for name in part["segments"]}),
        "regime": "; ".join(dict.fromkeys(part["regime"] for part in parts if part["regime"])),
    }
    ids = [channel.id for channel in diagnosis.evidence.residual_models[0].channels]
    totals = dict(zip(ids, np.sum([gain.sum(axis=0) for gain in gains], axis=0), strict=True))
    own = {channel: totals[channel] for channel in finding["channels"]}
    shown = [channel for channel, gain in own.items() if gain > MIN_CHANNEL_SHARE * max(own.values(), default=0.0)]
    return {"where": where, "channels": shown or finding["channels"]}


def _is_of(finding: dict, effect: Effect) -> bool:
    return (finding["effect"], finding["variant"]) == (effect.id, effect.variant)


def _where(residual_model: ResidualModel, gain, track: Track | None) -> dict:
    """Return time spans, segments and flight regime of a gain (m,) in one recording."""
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
