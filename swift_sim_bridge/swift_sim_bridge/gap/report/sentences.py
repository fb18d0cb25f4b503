"""The wording that the terminal and the page share: sentences made from the content of report.json."""

MAX_SPANS = 4  # spans of time that a sentence lists
MAX_CHANNELS = 4  # channels that a sentence lists
MAX_ERROR_RATIO = 0.9  # error after the repair relative to before, below which a sentence names the channel
MIN_CHANGE = 0.02  # relative change of an error below which the repair has not changed it
VERDICTS = {  # by verdict of the report; a report with the verdict "confirmed" needs no more than the names
    "tentative": "The simulation lacks an effect, which is identified with low confidence.",
    "ambiguous": "The simulation lacks an effect, and several effects could explain it.",
    "unknown": "The simulation lacks an effect that is not in the catalogue.",
    "nothing_left_out": "The simulation lacks nothing that these recordings can show.",
    "not_testable": "These recordings can show no effect.",
}


def headline(report: dict) -> str:
    """Return the verdict of a report in a sentence, and the names of the effects that are confirmed or probable."""
    verdict, findings = VERDICTS.get(report["verdict"]), report["findings"]
    confirmed = [finding_name(one) for one in findings if one["verdict"] == "confirmed"]
    probable = [finding_name(one) for one in findings if one["verdict"] == "tentative"]
    probable += [
        f"either {finding_name(one)} or {confounder_names(one, weighted=False)}"
        for one in findings
        if one["verdict"] == "ambiguous"
    ]
    sentences = [verdict] if verdict else []
    if confirmed:
        sentences.append(f"{'Confirmed:' if verdict else 'The simulation lacks'} {_listed(confirmed)}.")
    if probable:
        sentences.append(f"Probable: {_listed(probable)}.")
    return " ".join(sentences)


def _listed(names: list[str]) -> str:
    """Return names as a list in a sentence, each once."""
    *others, last = dict.fromkeys(names)
    return f"{', '.join(others)} and {last}" if others else last


def improvements(report: dict) -> list[str]:
    """Return sentences about the errors that the repair changes on held-out parts, and about what remains after it."""
    held_out, sentences = report["improvement"]["held_out"], []
    step, corners = (_changed(held_out.get(key, {})) for key in ("one_step_rmse", "reprojection_rmse_px"))
    if errors := _changed(held_out.get("rollout_rmse_m", {}).get("0.5", {})):
        sentences.append(
            f"the position error after 0.5 s of simulation changes from {errors['before']:.2g} m to "
            f"{errors['after']:.2g} m{_black_boxes(errors, 'm')}."
        )
    if step:
        sentences.append(
            f"the error of the specific force changes from {step['before']:.2g} m/s^2 to "
            f"{step['after']:.2g} m/s^2{_black_boxes(step, 'm/s^2')}."
        )
    if improved := _improved_channels(held_out.get("one_step_rmse_by_channel", {}), report["channels"]):
        sentences.append(f"{improved}.")
    if corners:
        sentences.append(
            f"the reprojection error of gate corners changes from {corners['before']:.2g} px to "
            f"{corners['after']:.2g} px."
        )
    where = "On parts of the flights that no fit has used,"
    sentences = [f"{'There,' if i else where} {sentence}" for i, sentence in enumerate(sentences)]
    if left := report["improvement"]["left"]:
        names = ", ".join(f"{finding_name(one)} ({one['verdict']})" for one in left["findings"])
        sentences.append(f"A second diagnosis, with the repaired vehicle, finds {names or 'no further effect'}.")
    return sentences


def _black_boxes(errors: dict, unit: str) -> str:
    """Return the errors of the black-box models, if there are any."""
    models = {"knn", "gp"}
    return f" (black boxes: {errors['knn']:.2g} and {errors['gp']:.2g} {unit})" if models <= set(errors) else ""


def _changed(errors: dict) -> dict:
    """Return errors by model, empty where the repair has not changed them."""
    return errors if errors and abs(errors["after"] - errors["before"]) > MIN_CHANGE * errors["before"] else {}


def _improved_channels(errors: dict, channels: dict) -> str:
    """Return the channels whose errors the repair lowers most, with both errors.

    Args:
        errors: errors by model, by channel.
        channels: entries of the report's channels.
    """
    ratios = {channel: one["after"] / one["before"] for channel, one in errors.items() if one["before"]}
    shown = [channel for channel in sorted(ratios, key=ratios.get) if ratios[channel] < MAX_ERROR_RATIO][:MAX_CHANNELS]
    sentences = []
    for channel in shown:
        entry = channels[channel]
        before, after = (f"{errors[channel][key]:.2g} {entry['unit']}".rstrip() for key in ("before", "after"))
        sentences.append(f"the error of {entry['name']} changes from {before} to {after}")
    return "; ".join(sentences)


def finding_name(finding: dict) -> str:
    """Return the name of a finding's effect."""
    return (finding["effect"] or "unknown physics").replace("_", " ")


def recording_of(finding: dict) -> str:
    """Return in which of several recordings a finding is, empty if it is in all."""
    return f" in {finding['recording']}" if "recording" in finding else ""


def where(finding: dict, flights: list) -> str:
    """Return where a finding is visible: flight regime, segments of the track, times.

    Args:
        finding: entry of the finding.
        flights: first and last time of each recording; a span of time that is a whole recording is not listed.
    """
    entry = finding["where"]
    parts = [entry["regime"]] if entry["regime"] else []
    if entry["segments"]:
        parts.append("from " + ", ".join(entry["segments"]))
    if spans := [span for span in entry["time"] if span not in flights]:
        parts.append(
            "at "
            + ", ".join(f"{begin:.1f} to {end:.1f} s" for begin, end in spans[:MAX_SPANS])
            + (" and more" if len(spans) > MAX_SPANS else "")
        )
    return "; ".join(parts) or "throughout"


def confounder_names(finding: dict, weighted: bool = True) -> str:
    """Return the names of the other effects that could explain a finding, with their weights if `weighted`."""
    own = finding["effect"], finding["variant"]
    return ", ".join(
        " ".join(
            filter(
                None,
                (other["effect"].replace("_", " "), other["variant"], weighted and f"({other['weight']:.0%})"),
            )
        )
        for other in finding["alternatives"]
        if (other["effect"], other["variant"]) != own
    )


def value_lines(finding: dict, channels: dict) -> list[str]:
    """Return a line for each parameter of a finding, or for each term of an equation.

    Args:
        finding: entry of the finding.
        channels: entries of the report's channels.
    """
    entries = finding["parameters"]
    if finding["effect"]:
        return [f"{name} = {_value(entry)}" for name, entry in entries.items()]
    return [
        f"{channels[entry['channel']]['name']}: {_value(entry)}"
        + ("" if entry["quantity"] == "1" else f" times {entry['quantity']}")
        for entry in entries.values()
    ]


def _value(entry: dict) -> str:
    """Return a value with its unit and its 95 % interval."""
    low, high = entry["interval95"]
    return " ".join(filter(None, (f"{entry['value']:.5g}", entry["unit"], f"({low:.5g} .. {high:.5g})")))
