"""What a report is worth once the answer is open: one record a case, and the rates over all, with their intervals."""

import math
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from swift_sim_bridge.referee.catalogue import EFFECTS
from swift_sim_bridge.referee.simulator.manoeuvres import proposed

NAMED, ALARMS = ("confirmed", "tentative"), ("confirmed", "tentative", "ambiguous", "unknown")
SILENT = ("refused", "broken")  # no answer; whatever a recording of the referee's lacks, something of it can be told
SURE, WELL_SURE = 2.0, 3.0  # multiples of the detectable size from which a name, and a number, is demanded
Z95 = 1.959964
EQUAL = {"payload": {"payload", "mass", "com_offset", "inertia"}}  # told as its parts: with the mass in it
DOUBLES = {  # what may be named in place of an effect that was taken out: with it the flight is the same
    "mass": {"thrust_coefficient", "payload", "inertia"},  # weaker rotors also turn it less, as more inertia does
    "thrust_coefficient": {"mass", "payload", "inertia"},
    "payload": EQUAL["payload"] | {"thrust_coefficient"},
    "flapping_moment": {"com_offset"},  # a centre of mass above or below, where rotors alone drag
}
SINGLES = ("single", "sheet", "gusty", "confusable")


def score(answer: dict, report: dict, again: dict | None = None, followed: bool = False) -> dict:
    """Return what a report says of a case and whether that is right: entries of `METRICS`, None where not asked.

    again: what the tool reports once the manoeuvre is flown that it proposed to tell look-alikes apart; followed:
    whether such a manoeuvre is flown, so that to propose none is a failure.
    """
    hidden, findings, family = answer["hidden"], report.get("findings", []), answer["family"]
    truth = {_hidden_name(one) for one in hidden}
    named = _names(findings, NAMED)
    alarms = [found for found in findings if found["verdict"] in ALARMS]
    ratio = min((_ratio(one, report) for one in hidden), default=None)
    knocked, lacking = bool(answer.get("removed")), answer.get("lacking", "")
    large = bool(hidden) and ratio >= SURE
    demanded = large and not knocked and not lacking and family != "poor"
    exact = same(named, truth) and all(found["verdict"] in NAMED for found in findings)
    sets = [_members(found) for found in findings if found["verdict"] == "ambiguous"]
    honest = exact or _covered(truth, named, sets)
    confirmed = _names(findings, ("confirmed",))
    unknown = any(found["verdict"] == "unknown" for found in findings)
    layers = set().union(*(EFFECTS[one["effect"]].layers for one in hidden))
    nameless = [found for found in findings if found["verdict"] == "unknown" and found["layer"] in layers]
    untestable = {one["effect"] for one in hidden} <= set(report.get("not_testable", {}))  # it says what to fly
    admitted = untestable and not named and not sets
    asked = large and knocked and not truth & set(DOUBLES)
    allowed = _allowed(truth, (EQUAL, DOUBLES) if knocked else (EQUAL,))
    neighbour = not confirmed <= allowed
    excess = family.startswith("null") or (same(named, truth) and not knocked)
    answered = report.get("verdict") not in SILENT
    return {
        "family": family,
        "verdict": report.get("verdict", "none"),
        "truth": sorted(truth),
        "named": sorted(named),
        "sets": [sorted(one) for one in sets],
        "multiple": min((one["multiple"] for one in hidden), default=None),
        "ratio": ratio,
        "alarm": bool(alarms) if answered and not hidden else None,
        "layer": _right_layer(layers, alarms) if demanded else None,
        "exact": exact if demanded else None,
        "exact_confirmed": confirmed == named if demanded and exact else None,
        "honest": honest if demanded else None,
        "confident_wrong": neighbour if answered else None,
        "wrong_name": not named <= allowed if answered else None,
        "unknown_on_knockout": bool(nameless) and not neighbour if asked else None,
        "quantity_on_knockout": not neighbour and any(_stands_for(hidden, one) for one in nameless) if asked else None,
        "unknown_elsewhere": unknown if answered and excess else None,
        "says_ambiguous": honest or admitted if family == "poor" and large else None,
        "missing_channel": honest or admitted if lacking and (large or untestable) else None,
        "told_as": _told_as(exact, honest, admitted, sets) if family == "poor" or lacking else None,
        "proposes": proposed(report) is not None if sets else None,
        "resolved": _resolved(truth, again) if again is not None or (followed and sets) else None,
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


def _name(found: dict) -> str | None:
    """Return an effect of a report with the number of its variant: of the wrong propeller the name is wrong."""
    return f"{found['effect']}[{found['variant']}]" if found.get("variant") else found["effect"]


def _hidden_name(one: dict) -> str:
    """Return a hidden effect as `_name` has it."""
    rotor = next((value for path, value in one["parameters"].items() if short(path) == "rotor"), None)
    return one["effect"] if rotor is None else f"{one['effect']}[{rotor:.0f}]"


def _names(findings: Sequence[dict], verdicts: Sequence[str]) -> set:
    return {_name(found) for found in findings if found["verdict"] in verdicts and found["effect"]}


def _allowed(truth: set, tables: Sequence[dict] = (EQUAL,)) -> set:
    """Return the names that are not wrong: what is true, and what stands for it by the tables."""
    return truth.union(*(table.get(one, ()) for one in truth for table in tables))


def _told_as(exact: bool, honest: bool, admitted: bool, sets: Sequence[set]) -> str | None:
    """Return how a report tells the truth, None where it does not."""
    if not honest:
        return "not testable" if admitted else None
    return "by exact name" if exact else "by a set" if sets else "by a name beside an unknown"


def _covered(truth: set, named: set, sets: Sequence[set]) -> bool:
    """Return whether all that is true is named or a member of a set, each set holds something true, and no more."""
    parts, told = _allowed(truth), named.union(*sets)
    if not truth or not all(one & parts for one in sets) or not named <= parts:
        return False
    return all(one in told or (one in EQUAL and "mass" in told) for one in truth)


def _resolved(truth: set, again: dict | None) -> bool:
    """Return whether the report of what was flown next names what is true and leaves nothing open; None was flown."""
    findings = again["findings"] if again else []
    return same(_names(findings, NAMED), truth) and all(found["verdict"] in NAMED for found in findings)


def _members(found: dict) -> set:
    return {_name(found), *map(_name, found.get("alternatives", []))} - {None}


def _right_layer(layers: set, alarms: Sequence[dict]) -> bool:
    """Return whether the most significant finding lies in a layer in which something is hidden."""
    if not alarms:
        return False
    first = max(alarms, key=lambda found: found.get("significance_sigma") or 0.0)
    return first["layer"] in layers


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


def _stem(path: str) -> str:
    """Return what the numbers of one vector share: terms.body_drag.c[0] is one of c."""
    return short(path).partition("[")[0]


def _parameters(hidden: Sequence[dict], report: dict) -> list[dict]:
    """Return for each hidden number that the tool named: its errors, and whether it lies in the interval."""
    rows, findings = [], report.get("findings", [])
    for one in hidden:
        found = next((f for f in findings if _name(f) == _hidden_name(one) and f["verdict"] in NAMED), None)
        if not found:
            continue
        changes = _changes(one)
        for path, value in one["parameters"].items():
            told = found.get("parameters", {}).get(short(path))
            if told is None or short(path) in ("rotor",):
                continue
            low, high = told["interval95"]
            scale = max(abs(change) for at, change in changes.items() if _stem(at) == _stem(path))
            rows.append(
                {
                    "effect": one["effect"],
                    "parameter": path,
                    "true": value,
                    "found": told["value"],
                    "ratio": _ratio(one, report),
                    "error_of_change": abs(told["value"] - value) / scale,
                    "error_of_value": abs(told["value"] - value) / max(abs(value), 1e-12),
                    "inside": low <= value <= high,
                }
            )
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
    generator, which the hits must reach, or may not exceed where `at_most`; families: that it concerns, all if none,
    and else it tells of how many cases of them it does not ask: of those with less than SURE times what can be
    detected, and of what was taken out and has `DOUBLES`."""

    name: str
    of: Callable
    target: dict[str, float]
    at_most: bool = False
    families: tuple[str, ...] = ()


METRICS = (
    Metric("answered", lambda r: r["verdict"] not in SILENT, {"own": 1.0, "rotorpy": 1.0}),
    Metric("false alarms on nulls", lambda r: r["alarm"], {"own": 0.01, "rotorpy": 0.02}, at_most=True),
    Metric("right layer", lambda r: r["layer"], {"own": 0.98, "rotorpy": 0.95}, families=(*SINGLES, "pair", "triple")),
    Metric("single effect: exact name", lambda r: r["exact"], {"own": 0.95, "rotorpy": 0.92}, families=SINGLES),
    Metric(
        "single effect: exact or honest set", lambda r: r["honest"], {"own": 0.95, "rotorpy": 0.92}, families=SINGLES
    ),
    Metric("pairs exact", lambda r: r["exact"], {"own": 0.9, "rotorpy": 0.8}, families=("pair",)),
    Metric("triples exact", lambda r: r["exact"], {}, families=("triple",)),
    Metric("exact and confirmed, of exact (tentative is exact too)", lambda r: r.get("exact_confirmed"), {}),
    Metric("confident and wrong", lambda r: r["confident_wrong"], {"own": 0.01, "rotorpy": 0.03}, at_most=True),
    Metric("any wrong name", lambda r: r.get("wrong_name"), {}, at_most=True),
    Metric(
        "knocked-out effect: unknown, right layer",
        lambda r: r["unknown_on_knockout"],
        {"own": 0.9},
        families=("knockout",),
    ),
    Metric(
        "knocked-out effect: right axis and quantity",
        lambda r: r.get("quantity_on_knockout"),
        {"own": 0.9},
        families=("knockout",),
    ),
    Metric("unknown on nulls and right answers", lambda r: r["unknown_elsewhere"], {"own": 0.02}, at_most=True),
    Metric("poor flight: says so", lambda r: r["says_ambiguous"], {"own": 0.95}, families=("poor",)),
    Metric(
        "missing channel: named, in a set, or not testable",
        lambda r: r.get("missing_channel"),
        {},
        families=("lacking",),
    ),
    Metric("ambiguous: proposes a manoeuvre", lambda r: r.get("proposes"), {}),
    Metric("ambiguous: resolved by the manoeuvre", lambda r: r.get("resolved"), {"own": 0.9}),
)


@dataclass(frozen=True)
class Number:
    """A number of the score that has a target. target: from and to, by generator."""

    name: str
    target: dict[str, tuple[float, float]]


NUMBERS = {
    "error_of_change_median": Number(
        "parameter error, share of the change: median", {"own": (0.0, 0.01), "rotorpy": (0.0, 0.02)}
    ),
    "error_of_change_p90": Number(
        "parameter error, share of the change: p90", {"own": (0.0, 0.05), "rotorpy": (0.0, 0.08)}
    ),
    "coverage": Number("95 % intervals that hold the truth", {"own": (0.93, 0.97), "rotorpy": (0.85, 0.99)}),
    "held_out_removed_median": Number(
        "held-out excess error removed, where names are exact: median",
        {"own": (0.98, math.inf), "rotorpy": (0.95, math.inf)},
    ),
}
ENOUGH = 450  # intervals, of which the share that holds the truth is near what it is of any number


def summary(records: Sequence[dict], generator: str) -> dict:
    """Return the score of one generator's cases: {"rates": [...], "numbers": {...}}."""
    rates = []
    for metric in METRICS:
        concerned = [record for record in records if not metric.families or record["family"] in metric.families]
        asked = [record for record in concerned if metric.of(record) is not None]
        hits = [record for record in asked if metric.of(record)]
        ways = Counter(record["told_as"] for record in hits if metric.families and record.get("told_as"))
        low, high = wilson(len(hits), len(asked))
        rates.append(
            {
                "name": metric.name,
                "hits": len(hits),
                "count": len(asked),
                "interval95": [low, high],
                "target": metric.target.get(generator),
                "at_most": metric.at_most,
                "not_asked": len(concerned) - len(asked) if metric.families else 0,
                "told_as": dict(ways.most_common()),
            }
        )
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
    for layer in ("all", *sorted({_layer(r) for r in singles})):
        own = [r for r in singles if layer in ("all", _layer(r))]
        rows = []
        for low, high in zip(edges[:-1], edges[1:], strict=True):
            here = [same(set(r["named"]), set(r["truth"])) for r in own if low <= r["multiple"] < high]
            rows.append((low, high, sum(here), len(here)))
        curves[layer] = rows
    return curves


def _layer(record: dict) -> str:
    """Return the layer of a single effect, whichever propeller it is."""
    return EFFECTS[record["truth"][0].partition("[")[0]].layer


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
