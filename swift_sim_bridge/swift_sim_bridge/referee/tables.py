"""The referee's score as a text table."""

import math

from swift_ros.text import align
from swift_sim_bridge.referee.summary import NUMBERS, number_meets_target, rate_meets_target


def score_table(result: dict) -> str:
    """Return the score tables of all generators of a result (the content of result.json)."""
    return "\n\n".join(_generator_table(name, found) for name, found in result["score"].items())


def _generator_table(generator: str, found: dict) -> str:
    """Return the table of one generator."""
    rows = [(f"{generator}: {found['cases']} cases", "share", "95 % interval", "target", "")]
    for rate in found["rates"]:
        if rate["count"] or rate["not_asked"]:
            rows.append(
                (rate["name"], _share_and_rest(rate), _interval(rate), _bound(rate), _met(rate_meets_target(rate)))
            )
        if rate["reported_as"]:
            ways = ", ".join(f"{count} {way}" for way, count in rate["reported_as"].items())
            rows.append((f"  of which {ways}", "", "", "", ""))
    numbers = found["numbers"]
    for key, number in NUMBERS.items():
        value, extent = _value(numbers, key)
        if value:
            rows.append(
                (
                    number.name,
                    value,
                    extent,
                    _range(number.target.get(generator)),
                    _met(number_meets_target(generator, found, key)),
                )
            )
    if numbers["parameters"]:
        median, tail = (100 * numbers[f"error_of_value_{part}"] for part in ("median", "p90"))
        rows.append(("parameter error, share of the value", f"median {median:.2g} %", f"p90 {tail:.2g} %", "", ""))
    if numbers["seconds_median"] is not None:
        rows.append(
            ("time a case", f"median {numbers['seconds_median']:.1f} s", f"p90 {numbers['seconds_p90']:.1f} s", "", "")
        )
    return align(rows)


def _value(numbers: dict, key: str) -> tuple[str, str]:
    """Return one of NUMBERS, and its interval or count; empty where nothing was measured."""
    value = numbers[key]
    if key == "coverage":
        return (_share(value), _interval(value)) if value["count"] else ("", "")
    count = f"{numbers['held_out_count']} flights" if "held_out" in key else f"{numbers['parameters']} parameters"
    return ("", "") if value is None else (f"{100 * value:.3g} %", count)


def _share_and_rest(rate: dict) -> str:
    """Return a rate's share, and the number of cases of its families that do not count."""
    share = _share(rate) if rate["count"] else "0/0"
    return f"{share} ({rate['not_asked']} more not required)" if rate["not_asked"] else share


def _share(rate: dict) -> str:
    """Return hits and count with their share in percent."""
    return f"{rate['hits']}/{rate['count']} = {100 * rate['hits'] / rate['count']:.1f} %"


def _interval(rate: dict) -> str:
    """Return a 95 % interval in percent."""
    low, high = rate["interval95"]
    return f"{100 * low:.1f} to {100 * high:.1f} %"


def _bound(rate: dict) -> str:
    """Return the target of a rate."""
    return "" if rate["target"] is None else f"{'<=' if rate['at_most'] else '>='} {100 * rate['target']:.0f} %"


def _range(target: tuple[float, float] | None) -> str:
    """Return the target of a number."""
    if not target:
        return ""
    low, high = (100 * end for end in target)
    return f"<= {high:.0f} %" if not low else f">= {low:.0f} %" if math.isinf(high) else f"{low:.0f} to {high:.0f} %"


def _met(met: bool | None) -> str:
    """Return whether a target is met, in words."""
    return {True: "met", False: "not met", None: ""}[met]
