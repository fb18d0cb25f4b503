"""The score of many cases: rates with their intervals and targets, errors of parameters, detection curves."""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from swift_sim_bridge.referee.effects.catalogue import EFFECTS
from swift_sim_bridge.referee.families import CHANGED, STRANGE_FAMILIES
from swift_sim_bridge.referee.scoring import NO_ANSWER, same_effects

MIN_RATIO = 3.0  # size relative to the detectable size from which on an estimate counts for the parameter errors
MIN_INTERVALS = 450  # intervals from which on their coverage is compared without its standard error, 1 %
MIN_REMOVED = 0.8  # of the excess error on another flight, by the repair of a vehicle with physics without a name
SAME_RACE = 0.01  # share by which race times of worlds may differ that count as the same
MIN_ACTION = 10.0  # standard deviations by which physics without a name must act in a flight to be asked for
MAX_VALUE_ERROR = 0.05  # of a value that the file has wrong by a large factor
Z95 = 1.959964  # 97.5 % quantile of the normal distribution
SINGLES = ("single", "sheet", "gusty", "confusable", "foreign")  # families with one effect in a complete recording
PAIRS = ("pair", "foreign_pair")


@dataclass(frozen=True)
class Metric:
    """One rate of the score table.

    Attributes:
        name: name in the table.
        of: of(record) returns whether the metric is met, None where the case does not count.
        target: by generator the share that must be reached, or not exceeded if `at_most`.
        at_most: whether the target is an upper bound.
        families: families of cases that it covers, all if empty. If given, the table also has the number of their cases
            that do not count: effects below `scoring.MIN_RATIO`, and knocked-out effects with an equivalent.
    """

    name: str
    of: Callable[[dict], bool | None]
    target: dict[str, float]
    at_most: bool = False
    families: tuple[str, ...] = ()


def _accurate(record: dict) -> bool:
    """Return whether each estimated value is nearly the true one."""
    return all(row["error_of_value"] <= MAX_VALUE_ERROR for row in record["parameters"])


def _is_same_race(race_s: dict, world: str) -> bool | None:
    """Return whether a race takes as long in a world as in the concealed one, s; None if it does not finish there."""
    concealed, own = race_s["concealed"], race_s[world]
    if concealed is None:
        return None
    return own is not None and abs(own - concealed) <= SAME_RACE * concealed


def _where_it_acts(met: Callable[[dict], bool | None]) -> Callable[[dict], bool | None]:
    """Return the metric of the cases whose concealed physics acts in the recorded flight; a stall may never begin."""
    return lambda record: met(record) if record.get("acts_sigma", math.inf) >= MIN_ACTION else None


METRICS = (
    Metric("answered", lambda r: r["verdict"] not in NO_ANSWER, {"own": 1.0, "rotorpy": 1.0}),
    Metric("false alarms on null cases", lambda r: r["alarm"], {"own": 0.01, "rotorpy": 0.02}, at_most=True),
    Metric(
        "correct layer", lambda r: r["layer"], {"own": 0.98, "rotorpy": 0.95}, families=(*SINGLES, *PAIRS, "triple")
    ),
    Metric("single effect: exact name", lambda r: r["exact"], {"own": 0.95, "rotorpy": 0.92}, families=SINGLES),
    Metric(
        "single effect: exact name or set that holds it",
        lambda r: r["honest"],
        {"own": 0.95, "rotorpy": 0.92},
        families=SINGLES,
    ),
    Metric("pairs exact", lambda r: r["exact"], {"own": 0.9, "rotorpy": 0.8}, families=PAIRS),
    Metric("triples exact", lambda r: r["exact"], {}, families=("triple",)),
    Metric("of the exact ones confirmed, else tentative", lambda r: r.get("exact_confirmed"), {}),
    Metric("confident and wrong", lambda r: r["confident_wrong"], {"own": 0.01, "rotorpy": 0.03}, at_most=True),
    Metric("any wrong name", lambda r: r.get("wrong_name"), {}, at_most=True),
    Metric(
        "knock-out: unknown, correct layer",
        lambda r: r["unknown_on_knockout"],
        {"own": 0.9},
        families=("knockout",),
    ),
    Metric(
        "knock-out: correct axis and quantity",
        lambda r: r.get("quantity_on_knockout"),
        {"own": 0.9},
        families=("knockout",),
    ),
    Metric(
        "physics without a name: unknown, correct layer and axis",
        _where_it_acts(lambda r: r.get("axis_on_knockout")),
        {"own": 0.9},
        families=STRANGE_FAMILIES,
    ),
    Metric(
        "physics without a name: correct quantity, too",
        _where_it_acts(lambda r: r["quantity_on_knockout"]),
        {},
        families=STRANGE_FAMILIES,
    ),
    Metric(
        f"physics without a name: {100 * MIN_REMOVED:.0f} % of the excess error on another flight removed",
        _where_it_acts(lambda r: r["removed"] >= MIN_REMOVED if r.get("removed") is not None else None),
        {"own": 0.9},
        families=STRANGE_FAMILIES,
    ),
    Metric(
        f"physics without a name: race in the repaired world as long, within {100 * SAME_RACE:.0f} %",
        lambda r: _is_same_race(r["race_s"], "repaired") if "race_s" in r else None,
        {"own": 0.9},
        families=("strange_race",),
    ),
    Metric(
        "physics without a name: race in the world of the file as long",
        lambda r: _is_same_race(r["race_s"], "file") if "race_s" in r else None,
        {},
        families=("strange_race",),
    ),
    Metric("unknown on null cases and correct answers", lambda r: r["unknown_elsewhere"], {"own": 0.02}, at_most=True),
    Metric("poor flight: reported as such", lambda r: r["says_ambiguous"], {"own": 0.95}, families=("poor",)),
    Metric(
        "missing channel: named, in a set, or not testable",
        lambda r: r.get("missing_channel"),
        {},
        families=("lacking",),
    ),
    Metric(
        "pose and commands: exact name or set that holds it",
        lambda r: r["honest"],
        {"own": 0.9, "rotorpy": 0.9},
        families=CHANGED,
    ),
    Metric(
        "pose and commands: nothing left out",
        lambda r: r["verdict"] == "nothing_left_out",
        {"own": 0.0, "rotorpy": 0.0},
        at_most=True,
        families=CHANGED,
    ),
    Metric("far: exact name", lambda r: r["exact"], {"own": 0.9, "rotorpy": 0.9}, families=("far",)),
    Metric("far: exact name, and each value within 5 %", lambda r: r["exact"] and _accurate(r), {}, families=("far",)),
    Metric("ambiguous: proposes a manoeuvre", lambda r: r.get("proposes"), {}),
    Metric("ambiguous: resolved by the manoeuvre", lambda r: r.get("resolved"), {"own": 0.9}),
)


@dataclass(frozen=True)
class Number:
    """A number of the score that has a target.

    Attributes:
        name: name in the table.
        target: lower and upper bound by generator.
    """

    name: str
    target: dict[str, tuple[float, float]]


NUMBERS = {
    "error_of_change_median": Number(
        "parameter error, share of the change: median", {"own": (0.0, 0.01), "rotorpy": (0.0, 0.02)}
    ),
    "error_of_change_p90": Number(
        "parameter error, share of the change: p90", {"own": (0.0, 0.05), "rotorpy": (0.0, 0.08)}
    ),
    "coverage": Number("95 % intervals that contain the truth", {"own": (0.93, 0.97), "rotorpy": (0.85, 0.99)}),
    "held_out_removed_median": Number(
        "excess error on held-out parts removed, where names are exact: median",
        {"own": (0.98, math.inf), "rotorpy": (0.95, math.inf)},
    ),
}


def wilson_interval(hits: int, count: int) -> tuple[float, float]:
    """Return the 95 % interval of a share by Wilson's score; (0, 1) for a count of zero."""
    if not count:
        return 0.0, 1.0
    share, z2 = hits / count, Z95**2
    middle = share + z2 / (2 * count)
    reach = Z95 * math.sqrt(share * (1 - share) / count + z2 / (4 * count**2))
    return max(0.0, (middle - reach) / (1 + z2 / count)), min(1.0, (middle + reach) / (1 + z2 / count))


def summarise(records: Sequence[dict], generator: str) -> dict:
    """Return the score of one generator's cases: {"cases", "rates": [...], "numbers": {...}}."""
    return {
        "cases": len(records),
        "rates": [_rate(metric, records, generator) for metric in METRICS],
        "numbers": _numbers(records),
    }


def _rate(metric: Metric, records: Sequence[dict], generator: str) -> dict:
    """Return the entry of one metric."""
    covered = [record for record in records if not metric.families or record["family"] in metric.families]
    asked = [record for record in covered if metric.of(record) is not None]
    hits = [record for record in asked if metric.of(record)]
    ways = Counter(record["reported_as"] for record in hits if metric.families and record.get("reported_as"))
    low, high = wilson_interval(len(hits), len(asked))
    return {
        "name": metric.name,
        "hits": len(hits),
        "count": len(asked),
        "interval95": [low, high],
        "target": metric.target.get(generator),
        "at_most": metric.at_most,
        "not_asked": len(covered) - len(asked) if metric.families else 0,
        "reported_as": dict(ways.most_common()),
    }


def _numbers(records: Sequence[dict]) -> dict:
    """Return errors and coverage of estimated parameters, the held-out error removed, and the computing time."""
    rows = [row for record in records for row in record["parameters"]]
    changes = [row["error_of_change"] for row in rows if row["ratio"] >= MIN_RATIO]
    values = [row["error_of_value"] for row in rows if row["ratio"] >= MIN_RATIO]
    removed = [record["removed"] for record in records if record["exact"] and record.get("removed") is not None]
    seconds = [record["seconds"] for record in records if "seconds" in record]
    inside = [row["inside"] for row in rows]
    low, high = wilson_interval(sum(inside), len(inside))
    return {
        "parameters": len(changes),
        "error_of_change_median": _quantile(changes, 0.5),
        "error_of_change_p90": _quantile(changes, 0.9),
        "error_of_value_median": _quantile(values, 0.5),
        "error_of_value_p90": _quantile(values, 0.9),
        "coverage": {"hits": sum(inside), "count": len(inside), "interval95": [low, high]},
        "held_out_removed_median": _quantile(removed, 0.5),
        "held_out_count": len(removed),
        "seconds_median": _quantile(seconds, 0.5),
        "seconds_p90": _quantile(seconds, 0.9),
    }


def _quantile(values: Sequence[float], share: float) -> float | None:
    """Return a quantile, None without values."""
    return float(np.quantile(values, share)) if len(values) else None


def detection_curves(records: Sequence[dict], edges: Sequence[float]) -> dict[str, list]:
    """Return how often single effects were named, by layer and for all, in bins of size relative to detectable size.

    Args:
        records: scores of cases.
        edges: edges of the bins.

    Returns:
        By layer: [(lower edge, upper edge, hits, count)].
    """
    singles = [record for record in records if record["family"] == "single"]
    curves = {}
    for layer in ("all", *sorted({_layer(record) for record in singles})):
        of_layer = [record for record in singles if layer in ("all", _layer(record))]
        rows = []
        for low, high in zip(edges[:-1], edges[1:], strict=True):
            hits = [
                same_effects(set(record["named"]), set(record["truth"]))
                for record in of_layer
                if low <= record["multiple"] < high
            ]
            rows.append((low, high, sum(hits), len(hits)))
        curves[layer] = rows
    return curves


def _layer(record: dict) -> str:
    """Return the layer of a single effect, without its variant."""
    return EFFECTS[record["truth"][0].partition("[")[0]].layer


def missed_targets(result: dict) -> list[str]:
    """Return the rates and numbers of a result, by generator and name, that miss their targets."""
    names = []
    for generator, found in result["score"].items():
        numbers = {number.name: number_meets_target(generator, found, key) for key, number in NUMBERS.items()}
        rates = {rate["name"]: rate_meets_target(rate) for rate in found["rates"]}
        names += [f"{generator}: {name}" for name, met in (rates | numbers).items() if met is False]
    return names


def rate_meets_target(rate: dict) -> bool | None:
    """Return whether a rate meets its target, None without a target or a case that counts."""
    if rate["target"] is None or not rate["count"]:
        return None
    share = rate["hits"] / rate["count"]
    return share <= rate["target"] if rate["at_most"] else share >= rate["target"]


def number_meets_target(generator: str, found: dict, key: str) -> bool | None:
    """Return whether one of NUMBERS meets its target, None without a target or a value.

    Below MIN_INTERVALS the coverage meets its target if the target is within its uncertainty.
    """
    value, target = found["numbers"][key], NUMBERS[key].target.get(generator)
    if not target or value is None:
        return None
    low, high = target
    if key != "coverage":
        return low <= value <= high
    if not value["count"]:
        return None
    share = value["hits"] / value["count"]
    least, most = value["interval95"] if value["count"] < MIN_INTERVALS else (share, share)
    return least <= high and most >= low
