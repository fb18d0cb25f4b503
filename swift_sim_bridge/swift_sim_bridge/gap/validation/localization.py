"""Where and when a finding shows: spans of time, segments between gates, and the sort of flight."""

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

WINDOW_S, HOLDS = 0.5, 0.8  # windows that together hold so much of what the finding explains
EVERYWHERE = 0.6  # of the flight: it shows throughout
PARTS, TELLING = 5, 1.5  # a part of the flight that shows it so many times as much as the whole
SPANS = 10
LEAST_SHARE = 0.1  # of what a finding explains in its strongest channel, that it explains in another that it shows in


def locate_findings(diagnosis, vehicle: Vehicle, track: Track | None = None) -> dict:
    """Return the report of a diagnosis with `where` and `channels` told for each finding that is no single recording's:
    when, between which gates, in what sort of flight and along which axes it shows. vehicle: before the repair; track:
    whose gates the flights pass, if any."""
    findings = list(diagnosis.report["findings"])
    effects = tuple(one.effect for one in diagnosis.selected)
    repaired = with_effect_terms(diagnosis.vehicle, effects)
    for taken in diagnosis.selected:
        number = next((i for i, one in enumerate(findings) if _is_of(one, taken.effect)), None)
        if number is None or "recording" in findings[number]:
            continue  # one flight's own: it has its span
        without = with_effect_terms(vehicle, effects)
        for other in (one for one in diagnosis.selected if one is not taken):
            without = inject(without, other.effect, other.values)
        gains = [
            _gain(residual_model, noise, residual_model.residual(without), residual_model.residual(repaired))
            for residual_model, noise in _recorded(diagnosis)
        ]
        findings[number] = findings[number] | _shown(diagnosis, gains, findings[number], track)
    for number in (i for i, one in enumerate(findings) if one["effect"] is None):
        gains = [
            _gain(residual_model, noise, *_with_and_without(diagnosis, i, repaired))
            for i, (residual_model, noise) in enumerate(_recorded(diagnosis))
        ]
        shown = _shown(diagnosis, gains, findings[number], track)
        where = shown["where"] | {"regime": findings[number]["where"]["regime"]}  # the domain of the equation
        findings[number] = findings[number] | {"where": where}
    return {**diagnosis.report, "findings": findings}


def _recorded(diagnosis) -> list[tuple]:
    return list(zip(diagnosis.evidence.residual_models, diagnosis.evidence.noises, strict=True))


def _with_and_without(diagnosis, number: int, repaired: Vehicle) -> tuple[np.ndarray, np.ndarray]:
    """Return what is left (m, c) of a recording, and what of that without what has no name."""
    residual_model = diagnosis.evidence.residual_models[number]
    left = linearise(residual_model, perturbed_variants(repaired, ()))
    library, terms = diagnosis.evidence.library, diagnosis.equation_terms
    return left.residual, equation_search.subtract_terms(library, number, left, terms, residual_model.channels).residual


def _gain(residual_model: ResidualModel, noise, before, after) -> np.ndarray:
    """Return by how much a finding lowers the squares of each residual (m, c)."""
    return np.where(residual_model.good[:, None], (before**2 - after**2) / noise**2, 0.0)


def _shown(diagnosis, gains: list[np.ndarray], finding: dict, track: Track | None) -> dict:
    """Return the entries that tell where a finding shows, by its gains (m, c) in each recording."""
    parts = [
        _where(residual_model, gain.sum(axis=1), track)
        for (residual_model, _), gain in zip(_recorded(diagnosis), gains, strict=True)
    ]
    where = {
        "time": [span for one in parts for span in one["time"]],
        "segments": sorted({name for one in parts for name in one["segments"]}),
        "regime": "; ".join(dict.fromkeys(one["regime"] for one in parts if one["regime"])),
    }
    known = [channel.name for channel in diagnosis.evidence.residual_models[0].channels]
    whole = dict(zip(known, np.sum([gain.sum(axis=0) for gain in gains], axis=0), strict=True))
    own = {name: whole[name] for name in finding["channels"]}
    told = [name for name, gain in own.items() if gain > LEAST_SHARE * max(own.values(), default=0.0)]
    return {"where": where, "channels": told or finding["channels"]}


def _is_of(finding: dict, effect: Effect) -> bool:
    return (finding["effect"], finding["variant"]) == (effect.id, effect.variant)


def _where(residual_model: ResidualModel, gain, track: Track | None) -> dict:
    """Return spans, segments and sort of flight in which gains (m,) are."""
    good, told = residual_model.good, spans(residual_model.t, gain)
    passed = passages(residual_model.recording, track) if track else []
    return {
        "time": told,
        "segments": segments(passed, told),
        "regime": regime(gain[good], quantities(residual_model, good)),
    }


def spans(t, gain) -> list[list[float]]:
    """Return the spans of time, the longest ones, that hold most of what is explained: gain (m,) at times t (m,) s."""
    window = np.floor((t - t[0]) / WINDOW_S).astype(int)
    inside = np.bincount(window, np.maximum(gain, 0.0))
    order = np.argsort(-inside)
    count = int(np.searchsorted(np.cumsum(inside[order]), HOLDS * inside.sum())) + 1
    if not inside.any() or count > EVERYWHERE * len(inside):
        return [[float(t[0]), float(t[-1])]]
    chosen = np.sort(order[:count])
    runs = np.split(chosen, np.flatnonzero(np.diff(chosen) > 1) + 1)
    runs = sorted(sorted(runs, key=len, reverse=True)[:SPANS], key=lambda run: run[0])
    return [[float(t[0] + WINDOW_S * run[0]), float(min(t[-1], t[0] + WINDOW_S * (run[-1] + 1)))] for run in runs]


def regime(gain, known: dict[str, tuple[np.ndarray, str]]) -> str:
    """Return in what sort of flight a finding shows most, empty where in none: gain (m,), and by name values (m,) with
    their unit."""
    best, text = TELLING, ""
    for name, (values, unit) in known.items():
        edges = np.quantile(values, np.linspace(0.0, 1.0, PARTS + 1))
        part = np.clip(np.searchsorted(edges, values, "right") - 1, 0, PARTS - 1)
        count = np.bincount(part, minlength=PARTS)
        if np.any(count == 0) or gain.mean() <= 0:
            continue
        shares = np.bincount(part, gain, PARTS) / count / gain.mean()
        most = int(np.argmax(shares))
        if shares[most] > best:
            low, high = f"{edges[most]:.4g}", f"{edges[most + 1]:.4g} {unit}".rstrip()
            side = (
                f"above {low} {unit}".rstrip()
                if most == PARTS - 1
                else f"below {high}"
                if not most
                else (f"between {low} and {high}")
            )
            best = shares[most]
            text = f"most where the {name} is {side} ({best:.1f} times as much as on average)"
    return text


def quantities(residual_model: ResidualModel, good) -> dict[str, tuple[np.ndarray, str]]:
    """Return what sorts of flight can be told apart: by name the values (m,) at the residuals, and their unit."""
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
    for number, (centre, rotation) in enumerate(zip(track.positions, track.rotations, strict=True), start=1):
        local = to_gate_frame(centre, rotation, p)
        crossed, _, offset = plane_crossing(local[:-1], local[1:])
        through = crossed & (np.abs(offset) < 0.5 * track.inner_side).all(axis=1)
        found += [(float(recording.t[i]), number) for i in np.flatnonzero(through)]
    return sorted(found)


def segments(passed: list[tuple[float, int]], told: list[list[float]]) -> list[str]:
    """Return the segments between gates in which spans of time lie, by the gates' numbers; none when they are all."""
    touched, every = set(), set()
    for (begin, first), (end, second) in zip(passed[:-1], passed[1:], strict=True):
        every.add((first, second))
        if any(low < end and high > begin for low, high in told):
            touched.add((first, second))
    return [f"gate {first} to gate {second}" for first, second in sorted(touched)] if touched != every else []
