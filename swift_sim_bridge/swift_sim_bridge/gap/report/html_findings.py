"""The findings of a report as cards of its page, those first that remove most of the error."""

import re
from html import escape

from swift_sim_bridge.gap.report import quantities
from swift_sim_bridge.gap.report.sentences import (
    finding_name,
    likelihood_text,
    parameter_name,
    ranked,
    recording_of,
    significance_text,
    where,
)

SHOWN_TERMS = 4  # of an equation; the others are folded
LEGENDS = {  # what a symbol in an equation means, by a pattern that finds it
    r"\bv_|\|v\||= v\b| v,": "v: velocity along the body's axes (x forward, y left, z up)",
    r"omega": "ω: body rates",
    r"Omega": "Ω: rotor speed",
    r"\bu\b": "u: motor command, 0 to 1",
    r"\bU\b": "U: voltage of the pack",
    r"(?<!\^)\bT(_i)?\b": "T: thrust",
    r"m_p": "M, J₀: mass and inertia without the load; m_p, r: its mass and place; c: centre of mass; rᵀ: transposed",
    r"\bthrust\b": "thrust: the simulated thrust divided by the mass",
    r"\b(up|east|north)_": "up, east, north: the world's axes seen from the body (1: along this axis)",
    r"mega'": "′: rate of change",
    r"modelled": "modelled force, turn: linear and angular acceleration that the vehicle file gives",
    r"within": "within … m of (x, y, z): only near this place",
    r"\bt\b": "t: time",
}
ROUND_PLACE = re.compile(r"-0\.0(?=[,)])")


def findings(report: dict) -> str:
    """Return the section of a report's findings, empty without one."""
    if not report["findings"]:
        return ""
    cards = "".join(_card(one, report) for one in ranked(report["findings"]))
    shares = any("removes" in one for one in report["findings"])
    together = quantities.share(report["improvement"].get("removes", 0.0))
    order = (
        f"Those first that remove most of the error (of its squares, in multiples of the noise); all names together "
        f"remove {together}."
        if shares
        else ""
    )
    title = "<h2>What is missing in the simulation</h2>"
    return f"{title}<p class=small>{order}</p><div class=findings>{cards}</div>"


def _card(finding: dict, report: dict) -> str:
    """Return one finding."""
    title = escape(finding_name(finding) + recording_of(finding))
    if finding["variant"]:
        title += f" {escape(finding['variant'])}"
    place = quantities.html(_place(where(finding, report["flights"])))
    body = _terms(finding, report["channels"]) if finding["effect"] is None else _values(finding)
    caution = f"<p class=note>{quantities.html(finding['caution'])}</p>" if finding.get("caution") else ""
    chip = f"<span class='chip {escape(finding['verdict'])}'>{escape(finding['verdict'])}</span>"
    sentence = quantities.html(_sentence(finding, report["channels"]))
    improved = _most_improved(finding.get("most_improved"), report["channels"])
    evidence = f"in the {escape(finding['layer'])} layer; {significance_text(finding)}"
    return (
        f"<section class=card><div class=head><h3>{title}</h3>{chip}</div>{_bar(finding)}{improved}<p>{sentence}</p>"
        f"{body}{caution}{_confounders(finding)}<p class=small>Seen {place}; {evidence}.</p></section>"
    )


def _bar(finding: dict) -> str:
    """Return the share of the error that a finding removes, as a bar."""
    if "removes" not in finding:
        return ""
    width = f"{100.0 * finding['removes']:.1f}%"
    return (
        f"<div class=bar><i style='--w:{width}'></i><span class=small>removes "
        f"{quantities.share(finding['removes'])} of the error</span></div>"
    )


def _most_improved(entry: dict | None, channels: dict) -> str:
    """Return the channel that a finding improves most, with its error without the finding and with it."""
    if not entry:
        return ""
    channel = channels[entry["channel"]]
    (without, within), unit = quantities.scaled([entry["without"], entry["with"]], channel["unit"])
    unit_text = f" {quantities.html(unit)}" if unit else ""
    return (
        f"<p class=small>{escape(channel['name'])}: {quantities.significant(without or 0.0)}{unit_text} without it, "
        f"{quantities.significant(within or 0.0)}{unit_text} with it</p>"
    )


def _sentence(finding: dict, channels: dict) -> str:
    """Return what a finding means; of an equation, in which channels it is, without repeating its terms."""
    if finding["effect"] or "unexplained" in finding:
        return finding["sentence"]
    names = [channels[channel]["name"] for channel in finding["channels"]]
    more = f" and {len(names) - SHOWN_TERMS} more" if len(names) > SHOWN_TERMS else ""
    shown = ", ".join(names[:SHOWN_TERMS])
    return f"Nothing in the catalogue explains what is left in {shown}{more}. This equation describes it:"


def _values(finding: dict) -> str:
    """Return the parameters of an effect before and after, and its equation."""
    rows = "".join(_value(finding["effect"], name, entry) for name, entry in finding["parameters"].items())
    legend = _legend([finding["equation"]])
    return f"<div class=values>{rows}</div><p class=equation>{quantities.equation(finding['equation'])}</p>{legend}"


def _value(effect: str, name: str, entry: dict) -> str:
    """Return one parameter before and after."""
    was, value, interval, unit = quantities.of_interval(
        entry.get("was"), entry["value"], entry["interval95"], entry["unit"]
    )
    before = f"<span class=was>{quantities.html(was) or 'absent'}</span> → " if "was" in entry else ""
    unit_text = f" {quantities.html(unit)}" if unit else ""
    bounds = f"<small class=small>95 %: {quantities.html(interval)}{unit_text}</small>" if interval else ""
    key = f"<code>{escape(entry['key'])}</code>" if "key" in entry else ""
    return (
        f"<div class=value><div>{quantities.html(parameter_name(effect, name))}{key}</div><div class=now>"
        f"{before}<b class=is>{quantities.html(value)}{unit_text}</b> {bounds}</div></div>"
    )


def _terms(finding: dict, channels: dict) -> str:
    """Return the terms of an equation: those first that remove most of their channel's error, the last ones folded."""
    terms = ranked(list(finding["parameters"].values()))
    if not terms:
        return ""
    rows = [_term(one, channels) for one in terms]
    more = len(rows) - SHOWN_TERMS
    folded = (
        f"<details class=plain><summary>{more} smaller term{'s' if more > 1 else ''}</summary>"
        f"{''.join(rows[SHOWN_TERMS:])}</details>"
        if more > 0
        else ""
    )
    legend = _legend([one["quantity"] for one in terms], difference=True)
    return f"<div class=values>{''.join(rows[:SHOWN_TERMS])}{folded}</div>{legend}"


def _term(entry: dict, channels: dict) -> str:
    """Return one term of an equation."""
    _, value, interval, unit = quantities.of_interval(None, entry["value"], entry["interval95"], entry["unit"])
    quantity = "" if entry["quantity"] == "1" else f" · {quantities.html(_place(entry['quantity']))}"
    unit_text = f" {quantities.html(unit)}" if unit else ""
    removes = f"removes {quantities.share(entry['removes'])} of this channel's error; " if "removes" in entry else ""
    return (
        f"<div class=value><div>{quantities.html(channels[entry['channel']]['name'])}"
        f"<div class=equation>Δ = {quantities.html(value)}{unit_text}{quantity}</div></div>"
        f"<div class=now><small class=small>{removes}95 %: {quantities.html(interval)}</small></div></div>"
    )


def _place(text: str) -> str:
    """Return a text whose places have no negative zero."""
    return ROUND_PLACE.sub("0.0", text)


def _legend(texts: list[str], difference: bool = False) -> str:
    """Return what the symbols in equations mean."""
    joined = "; ".join(texts)
    found = ["Δ: measured minus simulated, of a channel “vs pose” the pose minus the sensor"] if difference else []
    found += [legend for pattern, legend in LEGENDS.items() if re.search(pattern, joined)]
    return f"<p class=small>{escape('; '.join(found))}.</p>" if found else ""


def _confounders(finding: dict) -> str:
    """Return the confounders of a finding and the manoeuvre that separates them, empty without confounders."""
    if not finding["alternatives"]:
        return ""
    manoeuvre = finding["separating_manoeuvre"]
    return f"<p class=note>{escape(likelihood_text(finding))}" + (
        f" <b>To separate them, fly:</b> {escape(manoeuvre)}.</p>" if manoeuvre else "</p>"
    )
