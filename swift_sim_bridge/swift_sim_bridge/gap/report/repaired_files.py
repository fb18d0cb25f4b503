"""The repaired files: the vehicle file with the selected effects, a comment on each change, and the repaired track.

Errors of the map go into the track file.
"""

import copy
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import yaml

from swift_sim_bridge.effects import Effect
from swift_sim_bridge.gap.attribution.evidence import SelectedEffect
from swift_sim_bridge.gap.effects.catalogue import MAP_EFFECTS
from swift_sim_bridge.gap.effects.patch import key_of, over, value_at
from swift_sim_bridge.identification import repair
from swift_sim_bridge.physics.terms import equation
from swift_sim_bridge.sensors.terms import sensor_terms
from swift_sim_bridge.sensors.world import flown_track

ERROR_DIGITS = 4  # significant digits of a covariance
DIGITS = 7  # significant digits of a number in the file; more than any estimate is accurate to


@dataclass(frozen=True)
class Change:
    """A change of one number of the vehicle file.

    Attributes:
        path: keys from the top of the file.
        name: path as text, with the verdict of the effect if it is not confirmed.
        before: value in the file, None if it had none.
        value: value in the repaired file.
        standard_error: standard error of the value.
        unit: unit of the value.
    """

    path: tuple
    name: str
    before: float | None
    value: float
    standard_error: float
    unit: str


def vehicle_text(content: dict, diagnosis, source: Path) -> str:
    """Return the repaired vehicle file as YAML.

    Args:
        content: content of the vehicle file that was diagnosed.
        diagnosis: a `gap.pipeline.diagnosis.Diagnosis`.
        source: path of that file.
    """
    content, changes, original_terms = copy.deepcopy(content), [], set(content.get("terms") or {})
    for one in (one for one in diagnosis.selected if one.effect.id not in MAP_EFFECTS):
        before = content.get("terms") or {}
        content["terms"] = _with_entry(before, one.effect)
        changes += _variant_change(before, content["terms"], one.effect)
        if "rate_loop" in one.effect.channels:  # a file that names a dump has the gains there
            content["controller"].setdefault("pid", copy.deepcopy(diagnosis.vehicle.controller["pid"]))
        errors = np.sqrt(np.diag(one.covariance))
        verdict = "" if one.verdict == "confirmed" else f" ({_verdict_text(one)})"
        for parameter, error in zip(one.effect.parameters, errors, strict=True):
            for path in (parameter.path, *parameter.tied):
                change = _set_value(content, path, float(error), parameter.unit, diagnosis.vehicle)
                new = path[0] == "terms" and path[1] not in original_terms
                changes.append(replace(change, name=change.name + verdict, before=None if new else change.before))
    if known := _covariances(diagnosis.selected):
        content["terms"]["equation"] = equation.with_covariance(content["terms"]["equation"], known)
    return repair.text(content, changes, source, "repaired from its recordings")


def _verdict_text(one: SelectedEffect) -> str:
    """Return the verdict of an effect, of an ambiguous one with the weights of all that it could be."""
    weights = ", ".join(f"{key} {weight:.2g}" for key, weight in one.confounders.items())
    return f"ambiguous: {weights}" if one.verdict == "ambiguous" else one.verdict


def _covariances(selected) -> dict[str, dict[str, float]]:
    """Return the covariance of each pair of summands of an equation, by their names."""
    found = {}
    for one in (one for one in selected if one.effect.id.startswith(equation.PREFIX)):
        names = [parameter.name for parameter in one.effect.parameters]
        for name, row in zip(names, one.covariance, strict=True):
            found[name] = {other: float(f"{value:.{ERROR_DIGITS}g}") for other, value in zip(names, row, strict=True)}
    return found


def _with_entry(terms: dict, effect: Effect) -> dict:
    """Return the file's terms with an entry for an effect; another variant of an exclusive effect is replaced."""
    found = dict(terms)
    for name, idle in (effect.idle or {}).items():
        entry = found.get(name, {})
        other = effect.exclusive and entry.get(effect.part, idle[effect.part]) != idle[effect.part]
        found[name] = copy.deepcopy(over(idle, {} if other else entry))  # idle entries are shared and must not change
    return found


def _variant_change(before: dict, after: dict, effect: Effect) -> list[Change]:
    """Return the change of the variant's number if the file had another; it has no standard error."""
    path = "terms", effect.id, effect.part
    old, new = (terms.get(effect.id, {}).get(effect.part) for terms in (before, after))
    return [Change(path, ".".join(path), old, new, 0.0, "")] if effect.exclusive and old not in (None, new) else []


def track_text(diagnosis) -> str | None:
    """Return the repaired track file as YAML, None if the diagnosis has no error of the map."""
    errors = [one.effect.key for one in diagnosis.selected if one.effect.id in MAP_EFFECTS]
    if not errors:
        return None
    recording = diagnosis.evidence.residual_models[0].recording
    track = flown_track(recording.gate_observations.track, sensor_terms(diagnosis.vehicle))
    content = yaml.safe_dump(asdict(track), sort_keys=False, default_flow_style=None, width=110)
    return f"# The track with the map errors that the gap tool found: {', '.join(errors)}.\n{content}"


def _set_value(content: dict, path: tuple, error: float, unit: str, repaired) -> Change:
    """Set a number of the content to the repaired vehicle's value, in place, and return the change."""
    *parents, last = path
    entry = content
    for key in parents:
        if isinstance(entry[key], tuple):
            entry[key] = list(entry[key])
        entry = entry[key]
    before = float(entry[last])
    entry[last] = float(f"{value_at(repaired, path):.{DIGITS}g}")
    return Change(path, key_of(path), before, entry[last], error, unit)
