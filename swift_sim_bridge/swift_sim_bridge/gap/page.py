"""The diagnosis for a reader: a few lines, and one page."""

from html import escape

STYLE = ("body{font:16px/1.5 sans-serif;max-width:60em;margin:2em auto;padding:0 1em}table{border-collapse:collapse}"
         "td,th{border:1px solid #ccc;padding:.3em .6em;text-align:left}")  # fmt: skip
VERDICTS = {
    "confirmed": "The simulation leaves something out, and this is it.",
    "tentative": "The simulation leaves something out; what it is, is not certain yet.",
    "ambiguous": "The simulation leaves something out that several effects could be.",
    "unknown": "The simulation leaves out something that is not in the catalogue.",
    "nothing_left_out": "The simulation leaves nothing out that these recordings could show.",
    "not_testable": "These recordings cannot tell.",
}


def text(report: dict) -> str:
    """Return the findings in a few lines."""
    lines = [VERDICTS[report["verdict"]]]
    for one in report["findings"]:
        lines.append(f"{one['verdict']}: {one['effect']}, {one['significance_sigma']:.0f} standard deviations. "
                     f"{one['sentence']}")
        lines += [f"  {name} = {_value(entry)}" for name, entry in one["parameters"].items()]
        if one["alternatives"]:
            rivals = ", ".join(f"{rival['effect']} ({rival['weight']:.0%})" for rival in one["alternatives"])
            lines.append(f"  could be: {rivals}; to tell them apart fly {one['separating_manoeuvre']}")
    return "\n".join(lines)


def html(diagnosis, source) -> str:
    """Return the page."""
    report = diagnosis.report
    rows = "".join(
        f"<tr><td>{escape(one['verdict'])}</td><td>{escape(one['effect'])}</td><td>{escape(one['layer'])}</td>"
        f"<td>{one['significance_sigma']:.0f}</td><td>{escape(one['sentence'])}<br><code>{escape(one['equation'])}</code>"
        f"</td><td>{'<br>'.join(escape(f'{name} = {_value(entry)}') for name, entry in one['parameters'].items())}</td>"
        "</tr>"
        for one in report["findings"]
    )
    findings = ("<table><tr><th>verdict</th><th>effect</th><th>layer</th><th>sigma</th><th>what it means</th>"
                f"<th>value, 95 % interval</th></tr>{rows}</table>") if rows else ""
    least = "".join(
        f"<tr><td>{escape(name)}</td><td>{', '.join(f'{key}: {value:.2g}' for key, value in entry.items())}</td></tr>"
        for name, entry in report["minimum_detectable"].items()
    )
    untold = "".join(f"<tr><td>{escape(name)}</td><td>{escape(reason)}</td></tr>"
                     for name, reason in report["not_testable"].items())
    return (f"<!doctype html><meta charset=utf-8><title>Gap report</title><style>{STYLE}</style>"
            f"<h1>{escape(VERDICTS[report['verdict']])}</h1><p>Vehicle file: {escape(str(source))}</p>{findings}"
            f"<h2>The smallest change that would have been seen</h2><table>{least}</table>"
            f"<h2>What these recordings cannot show</h2><table>{untold}</table>")


def _value(entry: dict) -> str:
    low, high = entry["interval95"]
    return f"{entry['value']:.5g} {entry['unit']} ({low:.5g} .. {high:.5g})"
