"""What a report is worth once the answer is open: one record a case, and the rates over all, with their intervals."""

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from swift_sim_bridge.referee.catalogue import EFFECTS
from swift_sim_bridge.referee.manoeuvres import proposed

NAMED, ALARMS = ("confirmed", "tentative"), ("confirmed", "tentative", "ambiguous", "unknown")
SILENT = ("refused", "broken")  # no answer; whatever a recording of the referee's lacks, something of it can be told
SURE, WELL_SURE = 2.0, 3.0  # multiples of the detectable size from which a name, and a number, is demanded
Z95 = 1.959964
EQUAL = {"payload": {"payload", "mass", "com_offset", "inertia"}}  # told as its parts: with the mass in it
DEGENERATE = (  # have exact doubles: flapping is a centre of mass above or below, where rotors alone drag
    "mass", "thrust_coefficient", "payload", "motor_time_constant", "command_latency", "flapping_moment",
)  # fmt: skip


def score(answer: dict, report: dict, again: dict | None = None) -> dict:
    """Return what a report says of a case and whether that is right: entries of `METRICS`, None where not asked.

    again: what the tool reports once the manoeuvre is flown that it proposed to tell look-alikes apart.
    """
    hidden, findings = answer["hidden"], report.get("findings", [])
    truth = {one["effect"] for one in hidden}
    named = {found["effect"] for found in findings if found["verdict"] in NAMED and found["effect"]}
    alarms = [found for found in findings if found["verdict"] in ALARMS]
    ratio = min((_ratio(one, report) for one in hidden), default=None)
    knocked, lacking = bool(answer.get("removed")), answer.get("lacking", "")
    demanded = bool(hidden) and ratio >= SURE and not knocked and not lacking and answer["family"] != "poor"
    exact = same(named, truth) and all(found["verdict"] in NAMED for found in findings)
    sets = [_members(found) for found in findings if found["verdict"] == "ambiguous"]
    honest = exact or _covered(truth, named, sets)
    confirmed = {found["effect"] for found in findings if found["verdict"] == "confirmed" and found["effect"]}
    unknown = any(found["verdict"] == "unknown" for found in findings)
    layers = set().union(*(EFFECTS[one].layers for one in truth))
    nameless = [found for found in findings if found["verdict"] == "unknown" and found["layer"] in layers]
    double = knocked and truth & set(DEGENERATE)  # what may well stand for it
    untestable = truth <= set(report.get("not_testable", {}))  # the report says what to fly to see it
    asked = knocked and ratio >= SURE and not double
    neighbour = _any_wrong(confirmed, truth)
    excess = answer["family"].startswith("null") or (same(named, truth) and not knocked)
    answered = report.get("verdict") not in SILENT
    return {
        "family": answer["family"],
        "verdict": report.get("verdict", "none"),
        "truth": sorted(truth),
        "named": sorted(named),
        "sets": [sorted(one) for one in sets],
        "multiple": min((one["multiple"] for one in hidden), default=None),
        "ratio": ratio,
        "alarm": bool(alarms) if answered and not hidden else None,
        "layer": _right_layer(truth, alarms) if demanded else None,
        "exact": exact if demanded else None,
        "honest": honest if demanded else None,
        "confident_wrong": _any_wrong(confirmed, truth) if answered and not double else None,
        "wrong_name": _any_wrong(named, truth) if answered and not double else None,
        "unknown_on_knockout": bool(nameless) and not neighbour if asked else None,
        "quantity_on_knockout": not neighbour and any(_stands_for(hidden, one) for one in nameless) if asked else None,
        "unknown_elsewhere": unknown if answered and excess else None,
        "says_ambiguous": honest or untestable if answer["family"] == "poor" and ratio >= SURE else None,
        "proposes": proposed(report) is not None if sets else None,
        "resolved": _resolved(truth, again["findings"]) if again is not None else None,
        "parameters": _parameters(hidden, report) if not knocked else [],
    }


def same(named: set, truth: set) -> bool:
    """Return whether the names say what is true; an effect that consists of others may be told as these."""
    if named == truth:
        return True
    for effect in truth & set(EQUAL):
        parts, rest = named & EQUAL[effect], truth - {effect}
        if parts & {effect, "mass"} and named - parts == rest - parts:
            return True
    return False


def _stands_for(hidden: Sequence[dict], found: dict) -> bool:
    """Return whether what has no name goes by a quantity of a hidden effect, on an axis on which that acts."""
    expected = [expression for one in hidden for expression in EFFECTS[one["effect"]].shows(_changes(one))]
    return any(re.fullmatch(expression, term) for expression in expected for term in found.get("parameters", {}))


def _changes(hidden: dict) -> dict[str, float]:
    return {path: value - hidden["nominal"].get(path, 0.0) for path, value in hidden["parameters"].items()}


def _any_wrong(names: set, truth: set) -> bool:
    return not all(_allowed(one, truth) for one in names)


def _allowed(effect: str, truth: set) -> bool:
    return effect in truth or any(effect in EQUAL[one] for one in truth & set(EQUAL))


def _covered(truth: set, named: set, sets: Sequence[set]) -> bool:
    """Return whether all that is true is named or a member of a set, each set holds something true, and no more."""
    parts, told = truth.union(*(EQUAL.get(one, set()) for one in truth)), named.union(*sets)
    if not truth or not all(one & parts for one in sets) or _any_wrong(named, truth):
        return False
    return all(one in told or (one in EQUAL and "mass" in told) for one in truth)


def _resolved(truth: set, findings: Sequence[dict]) -> bool:
    """Return whether the findings name what is true and leave nothing open."""
    named = {found["effect"] for found in findings if found["verdict"] in NAMED}
    return same(named, truth) and all(found["verdict"] in NAMED for found in findings)


def _members(found: dict) -> set:
    return {found["effect"], *(other["effect"] for other in found.get("alternatives", []))} - {None}


def _right_layer(truth: set, alarms: Sequence[dict]) -> bool:
    """Return whether the most significant finding lies in a layer in which something is hidden."""
    if not alarms:
        return False
    first = max(alarms, key=lambda found: found.get("significance_sigma") or 0.0)
    return first["layer"] in set().union(*(EFFECTS[one].layers for one in truth))


def _ratio(hidden: dict, report: dict) -> float:
    """Return size over what the tool itself says it would have detected, else over the catalogue's guess.

    Of an effect with several parameters the one that stands out most counts.
    """
    told = report.get("minimum_detectable", {}).get(hidden["effect"]) or {}
    ratios = []
    for path, change in _changes(hidden).items():
        least = told.get(short(path))
        if least:
            ratios.append(abs(change) / least)
    return max(ratios) if ratios else hidden["multiple"]


def short(path: str) -> str:
    """Return a parameter's own name: terms.body_drag.c[0] is c[0]."""
    return re.split(r"\.", path)[-1]


def _parameters(hidden: Sequence[dict], report: dict) -> list[dict]:
    """Return for each hidden number that the tool named: its errors, and whether it lies in the interval."""
    rows, findings = [], report.get("findings", [])
    for one in hidden:
        found = next((f for f in findings if f["effect"] == one["effect"] and f["verdict"] in NAMED), None)
        if not found:
            continue
        scale = max(map(abs, _changes(one).values()))
        for path, value in one["parameters"].items():
            told = found.get("parameters", {}).get(short(path))
            if told is None or short(path) in ("rotor",):
                continue
            low, high = told["interval95"]
            rows.append({"effect": one["effect"], "parameter": path, "true": value, "found": told["value"],
                         "ratio": _ratio(one, report), "error_of_change": abs(told["value"] - value) / scale,
                         "error_of_value": abs(told["value"] - value) / max(abs(value), 1e-12),
                         "inside": low <= value <= high})  # fmt: skip
    return rows


def wilson(hits: int, count: int) -> tuple[float, float]:
    """Return the 95 % interval of a share by Wilson's score; (0, 1) of nothing."""
    if not count:
        return 0.0, 1.0
    share, z2 = hits / count, Z95**2
    middle = share + z2 / (2 * count)
    reach = Z95 * math.sqrt(share * (1 - share) / count + z2 / (4 * count**2))
    return max(0.0, (middle - reach) / (1 + z2 / count)), min(1.0, (middle + reach) / (1 + z2 / count))


@dataclass(frozen=True)
class Metric:
    """One line of the score table. of(record): whether it is met, None where it is not asked; target: a share, by
    generator, which the hits must reach, or may not exceed where `at_most`."""

    name: str
    of: Callable
    target: dict[str, float]
    at_most: bool = False


def _single(record: dict):
    return record["exact"] if record["family"] in ("single", "sheet", "gusty", "confusable") else None


METRICS = (
    Metric("answered", lambda r: r["verdict"] not in SILENT, {"own": 1.0, "rotorpy": 1.0}),
    Metric("false alarms on nulls", lambda r: r["alarm"], {"own": 0.01, "rotorpy": 0.02}, at_most=True),
    Metric("right layer", lambda r: r["layer"], {"own": 0.98, "rotorpy": 0.95}),
    Metric("single effect: exact name", _single, {"own": 0.95, "rotorpy": 0.92}),
    Metric("single effect: exact or honest set", lambda r: r["honest"] if _single(r) is not None else None,
           {"own": 0.95, "rotorpy": 0.92}),
    Metric("pairs exact", lambda r: r["exact"] if r["family"] == "pair" else None, {"own": 0.9, "rotorpy": 0.8}),
    Metric("triples exact", lambda r: r["exact"] if r["family"] == "triple" else None, {}),
    Metric("confident and wrong", lambda r: r["confident_wrong"], {"own": 0.01, "rotorpy": 0.03}, at_most=True),
    Metric("any wrong name", lambda r: r.get("wrong_name"), {}, at_most=True),
    Metric("knocked-out effect: unknown, right layer", lambda r: r["unknown_on_knockout"], {"own": 0.9}),
    Metric("knocked-out effect: right axis and quantity", lambda r: r.get("quantity_on_knockout"), {"own": 0.9}),
    Metric("unknown on nulls and right answers", lambda r: r["unknown_elsewhere"], {"own": 0.02}, at_most=True),
    Metric("poor flight: says so", lambda r: r["says_ambiguous"], {"own": 0.95}),
    Metric("ambiguous: proposes a manoeuvre", lambda r: r.get("proposes"), {}),
    Metric("ambiguous: resolved by the manoeuvre", lambda r: r.get("resolved"), {"own": 0.9}),
)  # fmt: skip


@dataclass(frozen=True)
class Number:
    """A number of the score that has a target. target: from and to, by generator."""

    name: str
    target: dict[str, tuple[float, float]]


NUMBERS = {
    "error_of_change_median": Number("parameter error, share of the change: median",
                                     {"own": (0.0, 0.01), "rotorpy": (0.0, 0.02)}),
    "error_of_change_p90": Number("parameter error, share of the change: p90",
                                  {"own": (0.0, 0.05), "rotorpy": (0.0, 0.08)}),
    "coverage": Number("95 % intervals that hold the truth", {"own": (0.93, 0.97), "rotorpy": (0.85, 0.99)}),
    "held_out_removed_median": Number("held-out excess error removed, where names are exact: median",
                                      {"own": (0.98, math.inf), "rotorpy": (0.95, math.inf)}),
}  # fmt: skip
ENOUGH = 450  # intervals, of which the share that holds the truth is near what it is of any number


def summary(records: Sequence[dict], generator: str) -> dict:
    """Return the score of one generator's cases: {"rates": [...], "numbers": {...}}."""
    rates = []
    for metric in METRICS:
        met = [bool(value) for value in map(metric.of, records) if value is not None]
        low, high = wilson(sum(met), len(met))
        rates.append({"name": metric.name, "hits": sum(met), "count": len(met), "interval95": [low, high],
                      "target": metric.target.get(generator), "at_most": metric.at_most})  # fmt: skip
    rows = [row for record in records for row in record["parameters"]]
    large = [row["error_of_change"] for row in rows if row["ratio"] >= WELL_SURE]
    values = [row["error_of_value"] for row in rows if row["ratio"] >= WELL_SURE]
    gains = [record["removed"] for record in records if record.get("removed") is not None]
    inside = [row["inside"] for row in rows]
    low, high = wilson(sum(inside), len(inside))
    return {
        "cases": len(records),
        "rates": rates,
        "numbers": {
            "parameters": len(large),
            "error_of_change_median": _quantile(large, 0.5),
            "error_of_change_p90": _quantile(large, 0.9),
            "error_of_value_median": _quantile(values, 0.5),
            "error_of_value_p90": _quantile(values, 0.9),
            "coverage": {"hits": sum(inside), "count": len(inside), "interval95": [low, high]},
            "held_out_removed_median": _quantile(gains, 0.5),
            "held_out_count": len(gains),
            "seconds_median": _quantile([r["seconds"] for r in records if "seconds" in r], 0.5),
            "seconds_p90": _quantile([r["seconds"] for r in records if "seconds" in r], 0.9),
        },
    }


def _quantile(values, share: float) -> float | None:
    return float(np.quantile(values, share)) if len(values) else None


def detection(records: Sequence[dict], edges: Sequence[float]) -> dict[str, list]:
    """Return by layer, and for all, how often single effects were named in each bin of size over detectable:
    [(from, to, hits, count)]."""
    singles = [r for r in records if r["family"] == "single"]
    curves = {}
    for layer in ("all", *sorted({EFFECTS[r["truth"][0]].layer for r in singles})):
        own = [r for r in singles if layer in ("all", EFFECTS[r["truth"][0]].layer)]
        rows = []
        for low, high in zip(edges[:-1], edges[1:], strict=True):
            here = [same(set(r["named"]), set(r["truth"])) for r in own if low <= r["multiple"] < high]
            rows.append((low, high, sum(here), len(here)))
        curves[layer] = rows
    return curves


def missed(result: dict) -> list[str]:
    """Return the rates and numbers of a result, by generator and name, that miss their targets."""
    names = []
    for generator, found in result["score"].items():
        numbers = {number.name: met_by_number(generator, found, key) for key, number in NUMBERS.items()}
        rates = {rate["name"]: met_by_rate(rate) for rate in found["rates"]}
        names += [f"{generator}: {name}" for name, met in (rates | numbers).items() if met is False]
    return names


def met_by_rate(rate: dict) -> bool | None:
    """Return whether a rate meets its target, None where it has none or nothing was asked."""
    if rate["target"] is None or not rate["count"]:
        return None
    share = rate["hits"] / rate["count"]
    return share <= rate["target"] if rate["at_most"] else share >= rate["target"]


def met_by_number(generator: str, found: dict, key: str) -> bool | None:
    """Return whether one of `NUMBERS` meets its target, None where it has none or nothing was measured; of few
    intervals whether they may be a part of many that meet it."""
    value, target = found["numbers"][key], NUMBERS[key].target.get(generator)
    if not target or value is None:
        return None
    low, high = target
    if key != "coverage":
        return low <= value <= high
    if not value["count"]:
        return None
    share = value["hits"] / value["count"]
    least, most = value["interval95"] if value["count"] < ENOUGH else (share, share)
    return least <= high and most >= low
