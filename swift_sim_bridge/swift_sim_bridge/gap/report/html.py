"""The diagnosis for a reader: a few lines, and one page."""

from collections.abc import Sequence
from html import escape

STYLE = """body{font:16px/1.5 system-ui,sans-serif;max-width:75rem;margin:2rem auto;padding:0 1rem;color:#222}
h1{line-height:1.25}h2{margin-top:2.5rem}table{border-collapse:collapse}summary{cursor:pointer}
td,th{border-bottom:1px solid #ccc;padding:.35rem .8rem .35rem 0;text-align:left;vertical-align:top}
figure{margin:1.5rem 0}img{max-width:100%}figcaption,.small{color:#555;font-size:.9rem}"""
SPANS_SHOWN = 4
CHANNELS_SHOWN, BETTER = 4, 0.9  # in a sentence: those that miss by less than this share of what they did
HARDLY = 0.02  # a change of an error by less than this share is not worth a sentence
MODELS = {"before": "vehicle file", "after": "repaired", "knn": "nearest neighbours", "gp": "Gaussian process"}
LEGEND = (
    "In equations u and U are motor command and voltage, Omega a rotor's speed, v and omega the body's velocity "
    "and rates (x forward, y left, z up); a prime marks a rate of change."
)
VERDICTS = {  # but for "confirmed", which the names tell
    "tentative": "The simulation leaves something out; what it is, is not certain yet.",
    "ambiguous": "The simulation leaves something out that several effects could be.",
    "unknown": "The simulation leaves out something that is not in the catalogue.",
    "nothing_left_out": "The simulation leaves nothing out that these recordings could show.",
    "not_testable": "These recordings cannot tell.",
}


def text(report: dict) -> str:
    """Return the findings in a few lines."""
    lines = [headline(report)]
    for one in report["findings"]:
        sure = f"{one['significance_sigma']:.0f} standard deviations"
        lines.append(f"{one['verdict']}: {_name(one)}{_flight(one)}, {sure}. {one['sentence']}")
        lines += [f"  {line}" for line in _values(one)]
        lines.append(f"  where: {_where(one['where'], report['flights'])}")
        if one["alternatives"]:
            lines.append(f"  could also be: {_rivals(one)}; to tell them apart: {one['separating_manoeuvre']}")
    return "\n".join([*lines, *improvements(report)])


def headline(report: dict) -> str:
    """Return the verdict in a sentence, and in others what is certain beside it and what is probable."""
    told, found = VERDICTS.get(report["verdict"]), report["findings"]
    sure = [_name(one) for one in found if one["verdict"] == "confirmed"]
    guessed = [_name(one) for one in found if one["verdict"] == "tentative"]
    guessed += [f"either {_name(one)} or {_rivals(one, False)}" for one in found if one["verdict"] == "ambiguous"]
    said = [told] if told else []
    if sure:
        said.append(f"{'It certainly' if told else 'The simulation'} leaves out {_listed(sure)}.")
    if guessed:
        said.append(f"Probably it leaves out {_listed(guessed)}.")
    return " ".join(said)


def _listed(names: list[str]) -> str:
    *others, last = dict.fromkeys(names)
    return f"{', '.join(others)} and {last}" if others else last


def improvements(report: dict) -> list[str]:
    """Return what the repair is worth where no fit has seen the flights, in sentences; nothing of what it leaves as it
    was."""
    held_out, found = report["improvement"]["held_out"], []
    step, corners = (_unlike(held_out.get(key, {})) for key in ("one_step_rmse", "reprojection_rmse_px"))
    if errors := _unlike(held_out.get("rollout_rmse_m", {}).get("0.5", {})):
        found.append(
            f"half a second of simulation ends {errors['after']:.2g} m off the flown path instead of "
            f"{errors['before']:.2g} m{_boxes(errors, 'm')}."
        )
    if step:
        found.append(
            f"the accelerometer is predicted to {step['after']:.2g} m/s^2 instead of "
            f"{step['before']:.2g} m/s^2{_boxes(step, 'm/s^2')}."
        )
    if better := _better(held_out.get("one_step_rmse_by_channel", {})):
        found.append(f"{better}.")
    if corners:
        found.append(
            f"corners of gates are {corners['after']:.2g} px from where camera and map put them instead of "
            f"{corners['before']:.2g} px."
        )
    where = "On parts of the flights that no fit has seen,"
    found = [f"{'There' if i else where} {one}" for i, one in enumerate(found)]
    if left := report["improvement"]["left"]:
        named = ", ".join(f"{_name(one)} ({one['verdict']})" for one in left["findings"])
        found.append(f"Diagnosed again, the repaired vehicle leaves out {named or 'nothing that these flights show'}.")
    return found


def _boxes(errors: dict, unit: str) -> str:
    """Return how far off the black boxes are, where they were asked."""
    return f" (black boxes: {errors['knn']:.2g} and {errors['gp']:.2g} {unit})" if {"knn", "gp"} <= set(errors) else ""


def _unlike(errors: dict) -> dict:
    """Return errors by model, or nothing where the repair hardly changes them."""
    return errors if errors and abs(errors["after"] - errors["before"]) > HARDLY * errors["before"] else {}


def _better(channels: dict) -> str:
    """Return of which channels the repaired vehicle misses less, and how much, the most improved ones first."""
    shares = {name: one["after"] / one["before"] for name, one in channels.items() if one["before"]}
    shown = [name for name in sorted(shares, key=shares.get) if shares[name] < BETTER][:CHANNELS_SHOWN]
    sizes = {
        name: [f"{channels[name][key]:.2g} {channels[name]['unit']}".rstrip() for key in ("after", "before")]
        for name in shown
    }
    return "; ".join(f"{name} is {after} off instead of {before}" for name, (after, before) in sizes.items())


def html(report: dict, source, recordings: list[str], pictures: dict[str, str], parameters: dict) -> str:
    """Return the page. source: the vehicle file; recordings: a line about each; pictures: captions by file name;
    parameters: by effect and name."""
    parts = [
        f"<h1>{escape(headline(report))}</h1>",
        "".join(f"<p>{escape(line)}</p>" for line in improvements(report)),
        _findings(report["findings"], report["flights"]),
        "".join(
            f"<figure><img src='{escape(name)}' alt='{escape(caption)}'><figcaption>{escape(caption)}</figcaption>"
            "</figure>"
            for name, caption in pictures.items()
        ),
        _section(
            "What was read",
            [
                ("vehicle file", str(source)),
                *(("recording", line) for line in recordings),
                *(("left out", _rejected(one)) for one in report["rejected_data"]),
            ],
            True,
        ),
        _section(
            "Errors on parts that no fit has seen",
            _errors(report["improvement"]["held_out"]),
            heads=["", *MODELS.values()],
        ),
        _section(
            "The smallest change that would have been seen",
            [
                (name, ", ".join(_smallest(parameters[name, key], value) for key, value in entry.items()))
                for name, entry in report["minimum_detectable"].items()
            ],
        ),
        _section("What these recordings cannot show", report["not_testable"].items()),
    ]
    return (
        "<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport content='width=device-width'>"
        f"<title>Gap report</title><style>{STYLE}</style>{''.join(parts)}"
    )


def _errors(held_out: dict) -> list[tuple[str, ...]]:
    """Return errors by axis and speed as rows: of what, and by each of the models."""
    thirds = held_out.get("thirds_of_speed_m_s", {})
    slow, fast = (f"{thirds.get(key, 0.0):.2g}" for key in ("slow_below", "fast_above"))
    sides = {"slow": f"slower than {slow} m/s", "middle": f"{slow} to {fast} m/s", "fast": f"faster than {fast} m/s"}
    rows = [("specific force", held_out.get("one_step_rmse", {}), "m/s^2")]
    rows += [
        (f"specific force {axis}, body", one, "m/s^2")
        for axis, one in held_out.get("one_step_rmse_by_axis", {}).items()
    ]
    rows += [
        (f"specific force, {sides[third]}", one, "m/s^2")
        for third, one in held_out.get("one_step_rmse_by_speed", {}).items()
    ]
    rows += [(name, one, one["unit"]) for name, one in held_out.get("one_step_rmse_by_channel", {}).items()]
    for horizon, one in held_out.get("rollout_rmse_m", {}).items():
        rows.append((f"position after {horizon} s", one, "m"))
        rows += [
            (f"position after {horizon} s, {axis}, world", by[horizon], "m")
            for axis, by in held_out.get("rollout_rmse_m_by_axis", {}).items()
        ]
        rows += [
            (f"position after {horizon} s, {sides[third]}", by[horizon], "m")
            for third, by in held_out.get("rollout_rmse_m_by_speed", {}).items()
            if horizon in by
        ]
    return [
        (f"{name} [{unit}]" if unit else name, *(f"{one[key]:.2g}" if key in one else "" for key in MODELS))
        for name, one, unit in rows
        if one
    ]


def _findings(findings: list[dict], flights: list) -> str:
    if not findings:
        return ""
    rows = "".join(
        f"<tr><td><b>{escape(_name(one) + _flight(one))}</b><br><span class=small>{escape(one['verdict'])}, "
        f"{one['significance_sigma']:.0f} standard deviations, {escape(one['layer'])} layer</span></td>"
        f"<td>{escape(one['sentence'])}<br><code>{escape(one['equation'])}</code>"
        f"<br><span class=small>Shows {escape(_where(one['where'], flights))}.</span>{_alternatives(one)}</td>"
        f"<td>{'<br>'.join(escape(line) for line in _values(one))}</td></tr>"
        for one in findings
    )
    legend = f"<p class=small>{escape(LEGEND)}</p>" if any(one["effect"] is None for one in findings) else ""
    return (
        "<table><tr><th>what was left out</th><th>what it means</th><th>value (95 % interval)</th></tr>"
        f"{rows}</table>{legend}"
    )


def _values(one: dict) -> list[str]:
    """Return the numbers of a finding, a line each; of an equation its terms, channel by channel."""
    if one["effect"]:
        return [f"{name} = {_value(entry)}" for name, entry in one["parameters"].items()]
    terms = ((*name.rsplit(": ", 1), entry) for name, entry in one["parameters"].items())
    return [f"{channel}: {_value(entry)}" + ("" if term == "1" else f" times {term}") for channel, term, entry in terms]


def _smallest(parameter, size: float) -> str:
    """Return the smallest change of a parameter that would have been seen, unless no such vehicle could be."""
    seen = f"{size:.2g} {parameter.unit}".rstrip() if size < parameter.high - parameter.low else "none that could be"
    return f"{parameter.name}: {seen}"


def _alternatives(one: dict) -> str:
    if not one["alternatives"]:
        return ""
    fly = one["separating_manoeuvre"]
    return f"<br>These recordings cannot tell it from: {escape(_rivals(one))}." + (
        f"<br><b>Fly this to tell them apart:</b> {escape(fly)}." if fly else ""
    )


def _section(title: str, rows, is_open: bool = False, heads: Sequence[str] = ()) -> str:
    """Return a table that folds, of rows of cells, with the columns' heads if there are any."""
    cells = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows)
    if not cells:
        return ""
    opened, top = " open" if is_open else "", "".join(f"<th>{escape(head)}</th>" for head in heads)
    return f"<details{opened}><summary><b>{escape(title)}</b></summary><table><tr>{top}</tr>{cells}</table></details>"


def _name(one: dict) -> str:
    return (one["effect"] or "unknown physics").replace("_", " ")


def _flight(one: dict) -> str:
    """Return in which of several recordings alone a finding is."""
    return f" in {one['recording']}" if "recording" in one else ""


def _where(where: dict, flights: list) -> str:
    """Return where a finding shows, in words: the sort of flight, segments of the track, spans of time that are no
    whole flight."""
    said = [where["regime"]] if where["regime"] else []
    if where["segments"]:
        said.append("from " + ", ".join(where["segments"]))
    if spans := [span for span in where["time"] if span not in flights]:
        said.append(
            "at "
            + ", ".join(f"{begin:.1f} to {end:.1f} s" for begin, end in spans[:SPANS_SHOWN])
            + (" and more" if len(spans) > SPANS_SHOWN else "")
        )
    return "; ".join(said) or "throughout"


def _rivals(one: dict, weighed: bool = True) -> str:
    """Return the names of the others that a finding could be, with their weights unless told otherwise."""
    own = one["effect"], one["variant"]
    return ", ".join(
        " ".join(
            filter(None, (rival["effect"].replace("_", " "), rival["variant"], weighed and f"({rival['weight']:.0%})"))
        )
        for rival in one["alternatives"]
        if (rival["effect"], rival["variant"]) != own
    )


def _rejected(one: dict) -> str:
    begin, end = one["time"]
    return f"{one['recording']}, {begin:.2f} s to {end:.2f} s, {one['channel']}: {one['reason']}"


def _value(entry: dict) -> str:
    low, high = entry["interval95"]
    return " ".join(filter(None, (f"{entry['value']:.5g}", entry["unit"], f"({low:.5g} .. {high:.5g})")))
