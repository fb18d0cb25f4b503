"""The report as one HTML page."""

from collections.abc import Sequence
from html import escape

from swift_sim_bridge.effects import Parameter
from swift_sim_bridge.gap.report.sentences import (
    confounder_names,
    finding_name,
    headline,
    improvements,
    recording_of,
    value_lines,
    where,
)

STYLE = """body{font:16px/1.5 system-ui,sans-serif;max-width:75rem;margin:2rem auto;padding:0 1rem;color:#222}
h1{line-height:1.25}h2{margin-top:2.5rem}table{border-collapse:collapse}summary{cursor:pointer}
td,th{border-bottom:1px solid #ccc;padding:.35rem .8rem .35rem 0;text-align:left;vertical-align:top}
figure{margin:1.5rem 0}img{max-width:100%}figcaption,.small{color:#555;font-size:.9rem}"""
MODEL_NAMES = {"before": "vehicle file", "after": "repaired", "knn": "nearest neighbours", "gp": "Gaussian process"}
LEGEND = (
    "In equations, u is the motor command, U the voltage and Omega a rotor's speed; v and omega are the body's "
    "velocity and rates (x forward, y left, z up); a prime is a time derivative."
)


def html_page(
    report: dict,
    vehicle_file,
    recordings: list[str],
    pictures: dict[str, str],
    parameters: dict[tuple[str, str], Parameter],
) -> str:
    """Return the page.

    Args:
        report: content of report.json.
        vehicle_file: path of the vehicle file.
        recordings: a line about each recording.
        pictures: captions by file name.
        parameters: parameters of the catalogue by effect and name (see `effect_help.parameters`).
    """
    inputs = [
        ("vehicle file", str(vehicle_file)),
        *(("recording", line) for line in recordings),
        *(("left out", _rejected(one)) for one in report["rejected_data"]),
    ]
    detectable = [
        (name, ", ".join(_detectable(parameters[name, key], value) for key, value in entry.items()))
        for name, entry in report["minimum_detectable"].items()
    ]
    held_out = report["improvement"]["held_out"]
    parts = [
        f"<h1>{escape(headline(report))}</h1>",
        "".join(f"<p>{escape(line)}</p>" for line in improvements(report)),
        _findings(report),
        "".join(_figure(name, caption) for name, caption in pictures.items()),
        _section("Inputs", inputs, is_open=True),
        _section(
            "Errors on parts of the flights that no fit has used",
            _errors(held_out, report["channels"]),
            ["", *MODEL_NAMES.values()],
        ),
        _section("Minimum detectable changes", detectable),
        _section("Effects that these recordings cannot test", report["not_testable"].items()),
    ]
    return (
        "<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport content='width=device-width'>"
        f"<title>Gap report</title><style>{STYLE}</style>{''.join(parts)}"
    )


def _figure(name: str, caption: str) -> str:
    """Return a picture with its caption."""
    return (
        f"<figure><img src='{escape(name)}' alt='{escape(caption)}'><figcaption>{escape(caption)}</figcaption></figure>"
    )


def _errors(held_out: dict, channels: dict) -> list[tuple[str, ...]]:
    """Return a row for each error: its quantity, and its value with each of MODEL_NAMES.

    Args:
        held_out: errors on parts of the flights that no fit has seen.
        channels: entries of the report's channels.
    """
    thirds = held_out.get("thirds_of_speed_m_s", {})
    slow, fast = (f"{thirds.get(key, 0.0):.2g}" for key in ("slow_below", "fast_above"))
    speeds = {"slow": f"slower than {slow} m/s", "middle": f"{slow} to {fast} m/s", "fast": f"faster than {fast} m/s"}
    rows = [("specific force", held_out.get("one_step_rmse", {}), "m/s^2")]
    rows += [
        (f"specific force {axis}, body", one, "m/s^2")
        for axis, one in held_out.get("one_step_rmse_by_axis", {}).items()
    ]
    rows += [
        (f"specific force, {speeds[third]}", one, "m/s^2")
        for third, one in held_out.get("one_step_rmse_by_speed", {}).items()
    ]
    by_channel = held_out.get("one_step_rmse_by_channel", {})
    rows += [(channels[channel]["name"], one, channels[channel]["unit"]) for channel, one in by_channel.items()]
    for horizon, one in held_out.get("rollout_rmse_m", {}).items():
        rows.append((f"position after {horizon} s", one, "m"))
        rows += [
            (f"position after {horizon} s, {axis}, world", by_horizon[horizon], "m")
            for axis, by_horizon in held_out.get("rollout_rmse_m_by_axis", {}).items()
        ]
        rows += [
            (f"position after {horizon} s, {speeds[third]}", by_horizon[horizon], "m")
            for third, by_horizon in held_out.get("rollout_rmse_m_by_speed", {}).items()
            if horizon in by_horizon
        ]
    return [
        (f"{name} [{unit}]" if unit else name, *(f"{one[key]:.2g}" if key in one else "" for key in MODEL_NAMES))
        for name, one, unit in rows
        if one
    ]


def _findings(report: dict) -> str:
    """Return the table of a report's findings."""
    findings, flights, channels = report["findings"], report["flights"], report["channels"]
    if not findings:
        return ""
    rows = "".join(
        f"<tr><td><b>{escape(finding_name(one) + recording_of(one))}</b><br><span class=small>"
        f"{escape(one['verdict'])}, {one['significance_sigma']:.0f} standard deviations, {escape(one['layer'])} layer"
        f"</span></td><td>{escape(one['sentence'])}<br><code>{escape(one['equation'])}</code>"
        f"<br><span class=small>Visible {escape(where(one, flights))}.</span>{_confounders(one)}</td>"
        f"<td>{'<br>'.join(escape(line) for line in value_lines(one, channels))}</td></tr>"
        for one in findings
    )
    legend = f"<p class=small>{escape(LEGEND)}</p>" if any(one["effect"] is None for one in findings) else ""
    heads = "<tr><th>missing effect</th><th>meaning</th><th>value (95 % interval)</th></tr>"
    return f"<table>{heads}{rows}</table>{legend}"


def _confounders(finding: dict) -> str:
    """Return the confounders of a finding and the manoeuvre that separates them, empty without confounders."""
    if not finding["alternatives"]:
        return ""
    manoeuvre = finding["separating_manoeuvre"]
    return f"<br>These recordings cannot distinguish it from: {escape(confounder_names(finding))}." + (
        f"<br><b>To separate them, fly:</b> {escape(manoeuvre)}." if manoeuvre else ""
    )


def _detectable(parameter: Parameter, size: float) -> str:
    """Return the smallest detectable change of a parameter, unless it exceeds the parameter's physical range."""
    physical = size < parameter.high - parameter.low
    return f"{parameter.name}: " + (f"{size:.2g} {parameter.unit}".rstrip() if physical else "no physical change")


def _rejected(entry: dict) -> str:
    """Return an entry of `rejected_data` as a line."""
    begin, end = entry["time"]
    return f"{entry['recording']}, {begin:.2f} s to {end:.2f} s, {entry['channel']}: {entry['reason']}"


def _section(title: str, rows, heads: Sequence[str] = (), is_open: bool = False) -> str:
    """Return a folding table of rows of cells, empty without rows; its columns have heads if there are any."""
    cells = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows)
    if not cells:
        return ""
    opened, top = " open" if is_open else "", "".join(f"<th>{escape(head)}</th>" for head in heads)
    return f"<details{opened}><summary><b>{escape(title)}</b></summary><table><tr>{top}</tr>{cells}</table></details>"
