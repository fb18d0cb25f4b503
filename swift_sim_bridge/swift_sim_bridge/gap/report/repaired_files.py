"""The repaired vehicle file: the recorded vehicle's own file with what was taken in, a comment on each change.

What is wrong with the map goes into a repaired track file.
"""

import copy
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import yaml

from swift_sim_bridge.effects import Effect
from swift_sim_bridge.gap.effects.camera import MAP
from swift_sim_bridge.gap.effects.patch import over, value_at
from swift_sim_bridge.identification import repair
from swift_sim_bridge.sensors.terms import sensor_terms
from swift_sim_bridge.sensors.world import flown_track

DIGITS = 7


@dataclass(frozen=True)
class Change:
    """One number: path in the vehicle file, and name for a reader, who is told where it is not certain; values before
    (None where the file had none) and after, standard error, unit."""

    path: tuple
    name: str
    before: float | None
    value: float
    standard_error: float
    unit: str


def text(content: dict, diagnosis, source: Path) -> str:
    """Return the repaired file as YAML; content: of the file at `source`."""
    content, changes, had = copy.deepcopy(content), [], set(content.get("terms") or {})
    for one in (one for one in diagnosis.selected if one.effect.id not in MAP):
        before = content.get("terms") or {}
        content["terms"] = _opened(before, one.effect)
        changes += _given_way(before, content["terms"], one.effect)
        if "rate_loop" in one.effect.channels:  # a file with a dump has its gains in there
            content["controller"].setdefault("pid", copy.deepcopy(diagnosis.vehicle.controller["pid"]))
        errors = np.sqrt(np.diag(one.covariance))
        for parameter, error in zip(one.effect.parameters, errors, strict=True):
            for path in (parameter.path, *parameter.tied):
                change = _changed(content, path, float(error), parameter.unit, diagnosis.vehicle)
                new = path[0] == "terms" and path[1] not in had
                doubt = "" if one.verdict == "confirmed" else f" ({one.verdict})"
                before = None if new else change.before
                changes.append(replace(change, name=change.name + doubt, before=before))
    return repair.text(content, changes, source, "repaired by what its flights show")


def _opened(terms: dict, effect: Effect) -> dict:
    """Return the file's terms with room for an effect; one of which the file has another variant gives way to it."""
    found = dict(terms)
    for name, idle in (effect.idle or {}).items():
        own = found.get(name, {})
        other = effect.exclusive and own.get(effect.part, idle[effect.part]) != idle[effect.part]
        found[name] = over(idle, {} if other else own)
    return found


def _given_way(before: dict, after: dict, effect: Effect) -> list[Change]:
    """Return the change of which of its parts an effect is, where the file had another; no error: it is a number."""
    path = "terms", effect.id, effect.part
    old, new = (terms.get(effect.id, {}).get(effect.part) for terms in (before, after))
    return [Change(path, ".".join(path), old, new, 0.0, "")] if effect.exclusive and old not in (None, new) else []


def track_text(diagnosis) -> str | None:
    """Return the track as it stands, as YAML, where something is wrong with the map; else None."""
    wrong = [one.effect.key for one in diagnosis.selected if one.effect.id in MAP]
    if not wrong:
        return None
    track = flown_track(diagnosis.evidence.residual_models[0].recording.gate_observations.track, sensor_terms(diagnosis.vehicle))
    content = yaml.safe_dump(asdict(track), sort_keys=False, default_flow_style=None, width=110)
    return f"# The track as it stands by the gap tool's findings: {', '.join(wrong)}.\n{content}"


def _changed(content: dict, path: tuple, error: float, unit: str, repaired) -> Change:
    """Set a number of the content to that of the repaired vehicle, in place, and return the change."""
    *folders, last = path
    entry = content
    for key in folders:
        if isinstance(entry[key], tuple):
            entry[key] = list(entry[key])
        entry = entry[key]
    before = float(entry[last])
    entry[last] = float(f"{value_at(repaired, path):.{DIGITS}g}")
    name = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in path)[1:]
    return Change(path, name, before, entry[last], error, unit)
