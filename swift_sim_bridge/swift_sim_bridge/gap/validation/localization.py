"""Localization of findings: by how much each lowers the error, in which channels, and where in the flights."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from swift_ros.track import Track
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.effects import Effect
from swift_sim_bridge.gap.discovery import equation_search
from swift_sim_bridge.gap.effects.injection import inject
from swift_sim_bridge.gap.inference.sensitivity import linearise, perturbed_variants, with_effect_terms
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel
from swift_sim_bridge.gap.validation.flight_regimes import where_in_flight
from swift_sim_bridge.gap.validation.mismatch import repaired_for
from swift_sim_bridge.physics.terms import equation

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
        where_in_flight(residual_model, gain.sum(axis=1), track)
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
