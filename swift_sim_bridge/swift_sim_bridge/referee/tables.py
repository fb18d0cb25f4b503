"""The referee's score as a table for a reader."""

from swift_ros.text import align


def text(result: dict) -> str:
    """Return the score tables of all generators of a result."""
    return "\n\n".join(_one(name, found) for name, found in result["score"].items())


def _one(generator: str, found: dict) -> str:
    rows = [(f"{generator}: {found['cases']} cases", "share", "95 % interval", "target", "")]
    for rate in found["rates"]:
        if not rate["count"]:
            continue
        share, (low, high) = rate["hits"] / rate["count"], rate["interval95"]
        met, target = "", ""
        if rate["target"] is not None:
            met = "met" if (share <= rate["target"] if rate["at_most"] else share >= rate["target"]) else "not met"
            target = f"{'<=' if rate['at_most'] else '>='} {100 * rate['target']:.0f} %"
        rows.append((rate["name"], f"{rate['hits']}/{rate['count']} = {100 * share:.1f} %",
                     f"{100 * low:.1f} to {100 * high:.1f} %", target, met))  # fmt: skip
    numbers, coverage = found["numbers"], found["numbers"]["coverage"]
    if coverage["count"]:
        low, high = coverage["interval95"]
        rows.append(("95 % intervals that hold the truth", f"{coverage['hits']}/{coverage['count']} = "
                     f"{100 * coverage['hits'] / coverage['count']:.1f} %", f"{100 * low:.1f} to {100 * high:.1f} %",
                     "95 %", ""))  # fmt: skip
    if numbers["parameters"]:
        for of in ("change", "value"):
            median, tail = (100 * numbers[f"error_of_{of}_{part}"] for part in ("median", "p90"))
            rows.append((f"parameter error, share of the {of}", f"median {median:.2g} %", f"p90 {tail:.2g} %",
                         f"{numbers['parameters']} parameters", ""))  # fmt: skip
    if numbers["held_out_count"]:
        rows.append(("held-out excess error removed", f"median {100 * numbers['held_out_removed_median']:.1f} %",
                     f"{numbers['held_out_count']} flights", "", ""))  # fmt: skip
    if numbers["seconds_median"] is not None:
        rows.append(("time a case", f"median {numbers['seconds_median']:.1f} s", f"p90 {numbers['seconds_p90']:.1f} s",
                     "", ""))  # fmt: skip
    return align(rows)
