"""The score of one case: its answer compared with the tool's report.

A score is one record of result.json; the keys of a record are part of that file's format.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass

from swift_sim_bridge.referee.concealment import KNOWN
from swift_sim_bridge.referee.families import STRANGE_FAMILIES
from swift_sim_bridge.referee.simulator.manoeuvres import proposed_manoeuvre

NAMED = ("confirmed", "tentative")  # verdicts of a finding that names an effect
ALARMS = ("confirmed", "tentative", "ambiguous", "unknown")  # verdicts of a finding that something is missing
NO_ANSWER = ("refused", "broken")  # verdicts without an answer: every recording of the referee can be diagnosed
MIN_RATIO = 2.0  # size relative to the detectable size from which on an effect must be named
REPORTED_AS_PARTS = {"payload": {"payload", "mass", "com_offset", "inertia"}}  # right if the mass is among the parts
EQUIVALENT = {  # effects that explain the same flight when an effect is knocked out of the catalogue
    "mass": {"thrust_coefficient", "payload", "inertia"},  # weaker rotors also turn the vehicle less, as more inertia
    "thrust_coefficient": {"mass", "payload", "inertia"},
    "payload": REPORTED_AS_PARTS["payload"] | {"thrust_coefficient"},
    "flapping_moment": {"com_offset"},  # a centre of mass above or below, where only the rotors have drag
}


@dataclass(frozen=True)
class _Hidden:
    """What a case conceals.

    Attributes:
        effects: entries of the sealed answer.
        names: of the effects.
        ratio: size of the smallest relative to what is detectable; None where nothing is hidden.
        knocked_out: no name of the tool's catalogue explains them.
        lacking: channel that the recording lacks, "" for none.
        family: of the case.
    """

    effects: list[dict]
    names: set[str]
    ratio: float | None
    knocked_out: bool
    lacking: str
    family: str

    @property
    def large(self) -> bool:
        return self.ratio is not None and self.ratio >= MIN_RATIO

    @property
    def answerable(self) -> bool:
        return self.large and not self.knocked_out and not self.lacking and self.family != "poor"

    @property
    def layers(self) -> set[str]:
        return set().union(*(KNOWN[one["effect"]].layers for one in self.effects))


@dataclass(frozen=True)
class _Reported:
    """What a report states.

    Attributes:
        findings: all that count.
        named: names of effects with a verdict that names them.
        sets: effects of each ambiguous finding.
        untestable: it says that the hidden effects cannot be tested, and states nothing else.
        not_testable: it says that they cannot be tested.
        answered: it has a verdict.
    """

    findings: list[dict]
    named: set[str]
    sets: list[set[str]]
    untestable: bool
    not_testable: bool
    answered: bool

    def with_verdict(self, *verdicts: str) -> list[dict]:
        return [finding for finding in self.findings if finding["verdict"] in verdicts]


def score(answer: dict, report: dict, second_report: dict | None = None, manoeuvre_flown: bool = False) -> dict:
    """Return the record of a case: what the report states and whether it is right.

    Args:
        answer: the sealed answer (see `cases.Case.answer`).
        report: content of report.json.
        second_report: report after the flight of the proposed manoeuvre; None without one.
        manoeuvre_flown: whether a proposed manoeuvre is flown, so that a missing proposal is a failure.

    Returns:
        Entries that `summary.METRICS` reads; None where the case does not count for a metric.
    """
    hidden = _hidden_of(answer, report)
    reported = _reported_of(answer, report, hidden.names)
    manoeuvre_counts = second_report is not None or (manoeuvre_flown and reported.sets)
    return {
        "family": hidden.family,
        "verdict": report.get("verdict", "none"),
        "truth": sorted(hidden.names),
        "named": sorted(reported.named),
        "sets": [sorted(one) for one in reported.sets],
        "multiple": min((one["multiple"] for one in hidden.effects), default=None),
        "ratio": hidden.ratio,
        **_names_scored(hidden, reported),
        **_equations_scored(hidden, reported),
        **_lacks_scored(hidden, reported),
        "proposes": proposed_manoeuvre(report) is not None if reported.sets else None,
        "resolved": _resolved(hidden.names, second_report) if manoeuvre_counts else None,
        "parameters": _parameters(hidden.effects, report) if not hidden.knocked_out else [],
    }


def _hidden_of(answer: dict, report: dict) -> _Hidden:
    effects, family = answer["hidden"], answer["family"]
    return _Hidden(
        effects=effects,
        names={_hidden_name(one) for one in effects},
        ratio=min((_ratio(one, report) for one in effects), default=None),
        knocked_out=bool(answer.get("removed")) or family in STRANGE_FAMILIES,
        lacking=answer.get("lacking", ""),
        family=family,
    )


def _reported_of(answer: dict, report: dict, truth: set[str]) -> _Reported:
    # Errors of the file below what matters may be named or not, unless they are parts of the truth.
    right = _allowed(truth)
    small = set(answer.get("small", ())) - right
    findings = [one for one in report.get("findings", []) if not _is_of(one, small) or _is_of(one, right)]
    named = _names(findings, NAMED)
    sets = [_members(finding) for finding in findings if finding["verdict"] == "ambiguous"]
    not_testable = {one["effect"] for one in answer["hidden"]} <= set(report.get("not_testable", {}))
    return _Reported(
        findings=findings,
        named=named,
        sets=sets,
        untestable=not_testable and not named and not sets,
        not_testable=not_testable,
        answered=report.get("verdict") not in NO_ANSWER,
    )


def _names_scored(hidden: _Hidden, reported: _Reported) -> dict:
    """Return whether alarms, layers and names are right."""
    alarms, confirmed = reported.with_verdict(*ALARMS), _names(reported.findings, ("confirmed",))
    exact, answerable, answered = _is_exact(hidden, reported), hidden.answerable, reported.answered
    allowed = _allowed_for(hidden)
    return {
        "alarm": bool(alarms) if answered and not hidden.effects else None,
        "layer": _right_layer(hidden.layers, alarms) if answerable else None,
        "exact": exact if answerable else None,
        "exact_confirmed": confirmed == reported.named if answerable and exact else None,
        "honest": _is_covered(hidden, reported) if answerable else None,
        "confident_wrong": not confirmed <= allowed if answered else None,
        "wrong_name": not reported.named <= allowed if answered else None,
    }


def _equations_scored(hidden: _Hidden, reported: _Reported) -> dict:
    """Return whether an equation stands for what has no name, and only for that."""
    stated, truth = reported.with_verdict("unknown"), hidden.names
    equations = [finding for finding in stated if finding["layer"] in hidden.layers]
    right = _names(reported.findings, ("confirmed",)) <= _allowed_for(hidden)
    counts = hidden.large and hidden.knocked_out and not truth & set(EQUIVALENT)
    complete = hidden.family.startswith("null") or (same_effects(reported.named, truth) and not hidden.knocked_out)
    return {
        "unknown_on_knockout": right and bool(equations) if counts else None,
        "axis_on_knockout": right and any(_is_on_axis(one, hidden.effects) for one in equations) if counts else None,
        "quantity_on_knockout": right and any(_describes(one, hidden.effects) for one in equations) if counts else None,
        "unknown_elsewhere": bool(stated) if reported.answered and complete else None,
    }


def _lacks_scored(hidden: _Hidden, reported: _Reported) -> dict:
    """Return whether the report is right on a recording that is too poor, or that lacks a channel."""
    poor, lacking = hidden.family == "poor", bool(hidden.lacking)
    exact, covered = _is_exact(hidden, reported), _is_covered(hidden, reported)
    right, testable = covered or reported.untestable, not reported.not_testable
    way = _way_reported(exact, covered, reported.untestable, reported.sets)
    return {
        "says_ambiguous": right if poor and hidden.large else None,
        "missing_channel": right if lacking and (hidden.large or not testable) else None,
        "reported_as": way if poor or lacking else None,
    }


def _is_exact(hidden: _Hidden, reported: _Reported) -> bool:
    """Return whether the names are the true ones, and nothing else is stated."""
    return same_effects(reported.named, hidden.names) and len(reported.with_verdict(*NAMED)) == len(reported.findings)


def _is_covered(hidden: _Hidden, reported: _Reported) -> bool:
    return _is_exact(hidden, reported) or _covered(hidden.names, reported.named, reported.sets)


def _allowed_for(hidden: _Hidden) -> set[str]:
    """Return the names that are not wrong for a case."""
    return _allowed(hidden.names, (REPORTED_AS_PARTS, EQUIVALENT) if hidden.knocked_out else (REPORTED_AS_PARTS,))


def _is_of(finding: dict, effects: set[str]) -> bool:
    """Return whether a finding names one of these effects, or a set with one of them."""
    if finding["verdict"] == "ambiguous":
        return bool(_members(finding) & effects)
    return finding["verdict"] in NAMED and finding["effect"] in effects


def same_effects(named: set, truth: set) -> bool:
    """Return whether the named effects are the true ones; an effect that consists of others may be named by these."""
    if named == truth:
        return True
    for effect in truth & set(REPORTED_AS_PARTS):
        parts, others = named & REPORTED_AS_PARTS[effect], truth - {effect}
        if parts & {effect, "mass"} and named - parts == others - parts:
            return True
    return False


def _is_on_axis(finding: dict, hidden: Sequence[dict]) -> bool:
    """Return whether an unknown finding is on an axis on which a hidden effect acts: by an equation's terms, if any."""
    channels = {entry["channel"] for entry in finding["parameters"].values()} or set(finding.get("channels", ()))
    axes = {expression.partition(": ")[0] for expression in _expected(hidden)}
    return any(re.fullmatch(axis, channel) for axis in axes for channel in channels)


def _expected(hidden: Sequence[dict]) -> list[str]:
    """Return the expressions of the terms that describe hidden effects."""
    return [expression for one in hidden for expression in KNOWN[one["effect"]].expected_terms(_changes(one))]


def _describes(finding: dict, hidden: Sequence[dict]) -> bool:
    """Return whether an equation has a quantity of a hidden effect, on an axis on which the effect acts."""
    expected = _expected(hidden)
    terms = [f"{entry['channel']}: {entry['quantity']}" for entry in finding["parameters"].values()]
    return any(re.fullmatch(expression, term) for expression in expected for term in terms)


def _changes(hidden: dict) -> dict[str, float]:
    """Return the changes of a hidden effect's parameters, by path."""
    return {path: value - hidden["nominal"].get(path, 0.0) for path, value in hidden["parameters"].items()}


def _name(finding: dict) -> str | None:
    """Return the effect of a finding with its variant: another propeller is another effect."""
    return f"{finding['effect']}[{finding['variant']}]" if finding.get("variant") else finding["effect"]


def _hidden_name(hidden: dict) -> str:
    """Return the name of a hidden effect in the form of `_name`."""
    rotor = next((value for path, value in hidden["parameters"].items() if parameter_name(path) == "rotor"), None)
    return hidden["effect"] if rotor is None else f"{hidden['effect']}[{rotor:.0f}]"


def _names(findings: Sequence[dict], verdicts: Sequence[str]) -> set:
    """Return the names of effects with one of these verdicts."""
    return {_name(finding) for finding in findings if finding["verdict"] in verdicts and finding["effect"]}


def _allowed(truth: set, tables: Sequence[dict] = (REPORTED_AS_PARTS,)) -> set:
    """Return the names that are not wrong: the true ones, and those that the tables list for them."""
    return truth.union(*(table.get(one, ()) for one in truth for table in tables))


def _way_reported(exact: bool, covered: bool, untestable: bool, sets: Sequence[set]) -> str | None:
    """Return how a report states the truth, None where it does not."""
    if not covered:
        return "not testable" if untestable else None
    return "by exact name" if exact else "by a set" if sets else "by a name beside an unknown"


def _covered(truth: set, named: set, sets: Sequence[set]) -> bool:
    """Return whether names and sets are right.

    Every true effect is named or in a set, every set has a true effect, and no other effect is named.
    """
    allowed, reported = _allowed(truth), named.union(*sets)
    if not truth or not all(one & allowed for one in sets) or not named <= allowed:
        return False
    return all(one in reported or (one in REPORTED_AS_PARTS and "mass" in reported) for one in truth)


def _resolved(truth: set, second_report: dict | None) -> bool:
    """Return whether the report after the manoeuvre names the true effects and has no ambiguous or unknown finding."""
    findings = second_report["findings"] if second_report else []
    return same_effects(_names(findings, NAMED), truth) and all(one["verdict"] in NAMED for one in findings)


def _members(finding: dict) -> set:
    """Return the effects of an ambiguous finding."""
    return {_name(finding), *map(_name, finding.get("alternatives", []))} - {None}


def _right_layer(layers: set, alarms: Sequence[dict]) -> bool:
    """Return whether the most significant finding is in a layer of a hidden effect."""
    if not alarms:
        return False
    first = max(alarms, key=lambda finding: finding.get("significance_sigma") or 0.0)
    return first["layer"] in layers


def _ratio(hidden: dict, report: dict) -> float:
    """Return the size of an effect relative to the minimum detectable change of the report, else of the catalogue.

    Of several parameters the one with the largest ratio counts.
    """
    detectable = report.get("minimum_detectable", {}).get(hidden["effect"]) or {}
    ratios = []
    for path, change in _changes(hidden).items():
        least = detectable.get(parameter_name(path))
        if least:
            ratios.append(abs(change) / least)
    return max(ratios) if ratios else hidden["multiple"]


def parameter_name(path: str) -> str:
    """Return the last part of a path: c[0] for terms.body_drag.c[0]."""
    return re.split(r"\.", path)[-1]


def _vector_name(path: str) -> str:
    """Return the name of the vector of a path: c for terms.body_drag.c[0]."""
    return parameter_name(path).partition("[")[0]


def _parameters(hidden: Sequence[dict], report: dict) -> list[dict]:
    """Return for each parameter of an effect that the tool named: its errors, and whether its interval is right."""
    rows, findings = [], report.get("findings", [])
    for one in hidden:
        finding = next((f for f in findings if _name(f) == _hidden_name(one) and f["verdict"] in NAMED), None)
        if not finding:
            continue
        changes = _changes(one)
        for path, value in one["parameters"].items():
            found = finding.get("parameters", {}).get(parameter_name(path))
            if found is None or parameter_name(path) in ("rotor",):
                continue
            low, high = found["interval95"]
            scale = max(abs(change) for at, change in changes.items() if _vector_name(at) == _vector_name(path))
            rows.append(
                {
                    "effect": one["effect"],
                    "parameter": path,
                    "true": value,
                    "found": found["value"],
                    "ratio": _ratio(one, report),
                    "error_of_change": abs(found["value"] - value) / scale,
                    "error_of_value": abs(found["value"] - value) / max(abs(value), 1e-12),
                    "inside": low <= value <= high,
                }
            )
    return rows
