"""The referee's score as a table for a reader."""

import math

from swift_ros.text import align
from swift_sim_bridge.referee.scoring import NUMBERS, met_by_number, met_by_rate


def text(result: dict) -> str:
    """Return the score tables of all generators of a result."""
    return "\n\n".join(_one(name, found) for name, found in result["score"].items())


def _one(generator: str, found: dict) -> str:
    rows = [(f"{generator}: {found['cases']} cases", "share", "95 % interval", "target", "")]
    for rate in found["rates"]:
        if rate["count"] or rate["not_asked"]:
            rows.append((rate["name"], _asked(rate), _reach(rate), _bound(rate), _told(met_by_rate(rate))))
        if rate["told_as"]:
            ways = ", ".join(f"{count} {way}" for way, count in rate["told_as"].items())
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
                    _told(met_by_number(generator, found, key)),
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
    """Return one of `NUMBERS`, and its interval or of how many it is; nothing where nothing was measured."""
    value = numbers[key]
    if key == "coverage":
        return (_share(value), _reach(value)) if value["count"] else ("", "")
    count = f"{numbers['held_out_count']} flights" if "held_out" in key else f"{numbers['parameters']} parameters"
    return ("", "") if value is None else (f"{100 * value:.3g} %", count)


def _asked(rate: dict) -> str:
    """Return a rate's share, and how many more cases of its families it does not ask."""
    share = _share(rate) if rate["count"] else "0/0"
    return f"{share} ({rate['not_asked']} more not asked)" if rate["not_asked"] else share


def _share(rate: dict) -> str:
    return f"{rate['hits']}/{rate['count']} = {100 * rate['hits'] / rate['count']:.1f} %"


def _reach(rate: dict) -> str:
    low, high = rate["interval95"]
    return f"{100 * low:.1f} to {100 * high:.1f} %"


def _bound(rate: dict) -> str:
    return "" if rate["target"] is None else f"{'<=' if rate['at_most'] else '>='} {100 * rate['target']:.0f} %"


def _range(target: tuple[float, float] | None) -> str:
    if not target:
        return ""
    low, high = (100 * end for end in target)
    return f"<= {high:.0f} %" if not low else f">= {low:.0f} %" if math.isinf(high) else f"{low:.0f} to {high:.0f} %"


def _told(met: bool | None) -> str:
    return {True: "met", False: "not met", None: ""}[met]
