"""The numbers of a report on its page: the errors before and after, what could have been seen, and the inputs."""

from collections.abc import Sequence
from html import escape

from swift_sim_bridge.effects import Parameter
from swift_sim_bridge.gap.report import quantities
from swift_sim_bridge.gap.report.sentences import changed, finding_name, improved_channels, parameter_name

MODEL_NAMES = {
    "before": "file",
    "after": "repaired",
    "with_remainder": "with remainder",
    "knn": "kNN alone",
    "gp": "GP alone",
}
MAX_TILES = 4


def tiles(report: dict) -> str:
    """Return the errors that the repair changes most, on parts of the flights that no fit has used; empty without."""
    held_out = report["improvement"]["held_out"]
    entries = [
        ("position after 0.5 s of simulation", held_out.get("rollout_rmse_m", {}).get("0.5"), "m"),
        ("specific force", held_out.get("one_step_rmse"), "m/s^2"),
        ("corners of gates in images", held_out.get("reprojection_rmse_px"), "px"),
    ]
    by_channel = held_out.get("one_step_rmse_by_channel", {})
    channels = report["channels"]
    entries += [
        (channels[one]["name"], by_channel[one], channels[one]["unit"]) for one in improved_channels(by_channel)
    ]
    shown = [(name, errors, unit) for name, errors, unit in entries if errors and changed(errors)][:MAX_TILES]
    if not shown:
        return ""
    cards = "".join(_tile(*one) for one in shown)
    return (
        f"<div class=tiles>{cards}</div><p class=small>Errors (RMS) on parts of the flights that no fit has used.</p>"
    )


def _tile(name: str, errors: dict, unit: str) -> str:
    """Return an error before and after, with those of the black boxes."""
    values, unit = quantities.scaled([errors[key] for key in MODEL_NAMES if key in errors], unit)
    texts = dict(zip((key for key in MODEL_NAMES if key in errors), map(quantities.significant, values), strict=True))
    unit_text = f" {quantities.html(unit)}" if unit else ""
    boxes = ""
    if "gp" in texts:
        alone = f"black boxes alone: {texts['knn']} (kNN), {texts['gp']} (GP)"
        boxes = f"with the remainder: {texts['with_remainder']}; {alone}{unit_text}"
    return (
        f"<div class=tile><span class=small>{escape(name)}</span>"
        f"<b><span class=was>{texts['before']} →</span> <span class=is>{texts['after']}{unit_text}</span></b>"
        f"<span class=small>{boxes}</span></div>"
    )


def tables(report: dict, parameters: dict[tuple[str, str], Parameter]) -> str:
    """Return the folded tables of errors, of the second diagnosis, and of what could and could not have been seen."""
    detectable = [
        (
            name.replace("_", " "),
            ", ".join(_detectable(name, parameters[name, key], value) for key, value in entry.items()),
        )
        for name, entry in report["minimum_detectable"].items()
    ]
    left = report["improvement"]["left"]
    second = [(finding_name(one), one["verdict"], one["sentence"]) for one in left.get("findings", [])]
    if left and not second:
        second = [("no further effect",)]
    untestable = [(name.replace("_", " "), reason) for name, reason in report["not_testable"].items()]
    held_out = report["improvement"]["held_out"]
    parts = [
        _section(
            "Errors on parts of the flights that no fit has used",
            _errors(held_out, report["channels"]),
            ["", *MODEL_NAMES.values()],
            "numbers",
        ),
        *(
            _section(
                f"Errors on the unseen flight {one['recording']}",
                _errors(one, report["channels"]),
                ["", *MODEL_NAMES.values()],
                "numbers",
            )
            for one in report.get("unseen_flights", [])
        ),
        _section("What a second diagnosis finds, with the repaired vehicle", second),
        _section("The smallest changes that these recordings can show", detectable, kind="units"),
        _section("What these recordings cannot test", untestable),
    ]
    return f"<h2>Numbers</h2>{''.join(parts)}" if any(parts) else ""


def inputs(report: dict, vehicle_file) -> str:
    """Return the vehicle file, the recordings, and what of them was left out."""
    rows = [("vehicle file", str(vehicle_file))]
    rows += [("recording", _recording(one)) for one in report.get("recordings", [])]
    rows += [("left out", _rejected(one)) for one in report["rejected_data"]]
    return _section("Inputs", rows)


def _recording(entry: dict) -> str:
    """Return name, duration and rates of a recording as a line."""
    rates = ", ".join(f"{name} {rate:.0f}/s" for name, rate in entry["rows_per_second"].items())
    return f"{entry['name']}: {entry['seconds']:.1f} s; {rates}"


def _errors(held_out: dict, channels: dict) -> list[tuple[str, ...]]:
    """Return a row for each error: its quantity, and its value with each of MODEL_NAMES.

    Args:
        held_out: errors on parts of the flights, or on flights, that no fit has seen.
        channels: entries of the report's channels.
    """
    thirds = held_out.get("thirds_of_speed_m_s", {})
    slow, fast = (quantities.significant(thirds.get(key, 0.0), 3) for key in ("slow_below", "fast_above"))
    speeds = {"slow": f"slower than {slow} m/s", "middle": f"{slow} to {fast} m/s", "fast": f"faster than {fast} m/s"}
    forces = "specific force; the remainder has the running level of the flight"
    rows = [(forces, held_out.get("one_step_rmse", {}), "m/s^2")]
    rows += [
        (f"specific force {axis}, body", one, "m/s^2")
        for axis, one in held_out.get("one_step_rmse_by_axis", {}).items()
    ]
    rows += [
        (f"specific force {axis}, all models with a running level", one, "m/s^2")
        for axis, one in held_out.get("one_step_rmse_with_level_by_axis", {}).items()
    ]
    rows += [
        (f"specific force, {speeds[third]}", one, "m/s^2")
        for third, one in held_out.get("one_step_rmse_by_speed", {}).items()
    ]
    by_channel = held_out.get("one_step_rmse_by_channel", {})
    rows += [
        (channels[channel]["name"], one, channels[channel]["unit"])
        for channel, one in by_channel.items()
        if channel in channels
    ]
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
        (
            f"{name} [{unit}]" if unit else name,
            *(quantities.significant(one[key]) if key in one else "" for key in MODEL_NAMES),
        )
        for name, one, unit in rows
        if one
    ]


def _detectable(effect: str, parameter: Parameter, size: float) -> str:
    """Return the smallest detectable change of a parameter, unless it exceeds the parameter's physical range."""
    name = parameter_name(effect, parameter.name)
    if size >= parameter.high - parameter.low:
        return f"{name}: no physical change"
    (value,), unit = quantities.scaled([size], parameter.unit)
    return f"{name}: {quantities.significant(value or 0.0)} {unit}".rstrip()


def _rejected(entry: dict) -> str:
    """Return an entry of `rejected_data` as a line."""
    begin, end = entry["time"]
    return f"{entry['recording']}, {begin:.2f} s to {end:.2f} s, {entry['channel']}: {entry['reason']}"


def _section(title: str, rows, heads: Sequence[str] = (), kind: str = "") -> str:
    """Return a folded table of rows of cells, empty without rows; its columns have heads if there are any."""
    show = quantities.html if kind else escape
    cells = "".join(f"<tr>{''.join(f'<td>{show(cell)}</td>' for cell in row)}</tr>" for row in rows)
    if not cells:
        return ""
    top = f"<tr>{''.join(f'<th>{escape(head)}</th>' for head in heads)}</tr>" if heads else ""
    return f"<details><summary>{escape(title)}</summary><table class='{kind}'>{top}{cells}</table></details>"
