"""The wording that the terminal and the page share: sentences made from the content of report.json."""

from swift_sim_bridge.gap.report import quantities

MAX_SPANS = 4  # spans of time that a sentence lists
MAX_CHANNELS = 4  # channels that a sentence lists
MAX_ERROR_RATIO = 0.9  # error after the repair relative to before, below which a sentence names the channel
MIN_CHANGE = 0.02  # relative change of an error below which the repair has not changed it
MIN_LIKELIHOOD_RATIO = 3.0  # of two effects, below which neither is clearly likelier (Kass and Raftery 1995)
NUMBERED = {
    "motor_map": ("c", 0),
    "rotor_gain": ("gain of rotor ", 1),
}  # effects whose entries are no axes; first number
VERDICTS = {  # by verdict of the report; a report with the verdict "confirmed" needs no more than the names
    "tentative": "The simulation lacks an effect, which is identified with low confidence.",
    "ambiguous": "The simulation lacks an effect, and several effects could explain it.",
    "unknown": "The simulation lacks an effect that is not in the catalogue.",
    "nothing_left_out": "The simulation lacks nothing that these recordings can show.",
    "cannot_tell": "These recordings cannot tell: most of the physics is not testable with them.",
}


def headline(report: dict) -> str:
    """Return the verdict of a report in a sentence, and the names of the effects that are confirmed or probable."""
    return " ".join(headline_sentences(report))


def headline_sentences(report: dict) -> list[str]:
    """Return the verdict of a report and the names of its effects, as one to three sentences."""
    verdict, findings = VERDICTS.get(report["verdict"]), ranked(report["findings"])
    confirmed = [finding_name(one) for one in findings if one["verdict"] == "confirmed"]
    probable = [finding_name(one) for one in findings if one["verdict"] == "tentative"]
    probable += [set_text(one) for one in findings if one["verdict"] == "ambiguous"]
    sentences = [verdict] if verdict else []
    if confirmed:
        sentences.append(f"{'Confirmed:' if verdict else 'The simulation lacks'} {_listed(confirmed)}.")
    if probable:
        sentences.append(f"Probable: {_listed(probable)}.")
    return sentences


def ranked(findings: list[dict]) -> list[dict]:
    """Return findings by the share of the error that each removes, the largest first."""
    return sorted(findings, key=lambda one: -one.get("removes", 0.0))


def significance_text(finding: dict) -> str:
    """Return the significance of a finding; beside others that imitate it a name may have none."""
    sigma = finding["significance_sigma"]
    return f"{sigma:.0f} standard deviations" if sigma >= 2.0 else "not significant beside the others"


def _listed(names: list[str]) -> str:
    """Return names as a list in a sentence, each once."""
    *others, last = dict.fromkeys(names)
    return f"{', '.join(others)} and {last}" if others else last


def improvements(report: dict) -> list[str]:
    """Return sentences about the errors that the repair changes on held-out parts, and about what remains after it."""
    held_out, sentences = report["improvement"]["held_out"], []
    step, corners = (changed(held_out.get(key, {})) for key in ("one_step_rmse", "reprojection_rmse_px"))
    if errors := changed(held_out.get("rollout_rmse_m", {}).get("0.5", {})):
        sentences.append(
            f"the position error after 0.5 s of simulation changes from {errors['before']:.2g} m to "
            f"{errors['after']:.2g} m{_black_boxes(errors, 'm')}."
        )
    if step:
        sentences.append(
            f"the error of the specific force changes from {step['before']:.2g} m/s^2 to "
            f"{step['after']:.2g} m/s^2{_black_boxes(step, 'm/s^2')}."
        )
    if improved := _improvement_text(held_out.get("one_step_rmse_by_channel", {}), report["channels"]):
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
    """Return the errors of the repair with its remainder and of black-box models alone, if there are any."""
    if "gp" not in errors:
        return ""
    return (
        f", with the remainder to {errors['with_remainder']:.2g} {unit} "
        f"(black boxes alone: {errors['knn']:.2g} and {errors['gp']:.2g} {unit})"
    )


def changed(errors: dict) -> dict:
    """Return errors by model, empty where the repair has not changed them."""
    return errors if errors and abs(errors["after"] - errors["before"]) > MIN_CHANGE * errors["before"] else {}


def improved_channels(errors: dict) -> list[str]:
    """Return the ids of the channels whose errors (by model, by channel) the repair lowers most."""
    ratios = {channel: one["after"] / one["before"] for channel, one in errors.items() if one["before"]}
    return [one for one in sorted(ratios, key=ratios.__getitem__) if ratios[one] < MAX_ERROR_RATIO][:MAX_CHANNELS]


def _improvement_text(errors: dict, channels: dict) -> str:
    """Return the channels whose errors the repair lowers most, with both errors.

    Args:
        errors: errors by model, by channel.
        channels: entries of the report's channels.
    """
    sentences = []
    for channel in improved_channels(errors):
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


def set_text(finding: dict) -> str:
    """Return the effects that could explain an ambiguous finding with their weights, the finding's own first."""
    text = f"either {_weighted(_own_alternative(finding))} or {confounder_names(finding)}"
    return f"{text} (none clearly likelier)" if is_close(finding) else text


def confounder_names(finding: dict) -> str:
    """Return the names of the other effects that could explain a finding, with their weights."""
    own = _own_alternative(finding)
    return ", ".join(_weighted(other) for other in finding["alternatives"] if other is not own)


def likelihood_text(finding: dict) -> str:
    """Return in a sentence how likely an ambiguous finding is beside the other effects that could explain it."""
    names, own = confounder_names(finding), _own_alternative(finding)
    if is_close(finding):
        return f"These recordings cannot distinguish it ({share_text(own)}) from: {names}; none is clearly likelier."
    return f"The likeliest ({share_text(own)}); these recordings cannot distinguish it from: {names}."


def is_close(finding: dict) -> bool:
    """Return whether another effect is about as likely as an ambiguous finding's own."""
    own = _own_alternative(finding)
    others = [other["weight"] for other in finding["alternatives"] if other is not own]
    return own["weight"] < MIN_LIKELIHOOD_RATIO * max(others, default=0.0)


def _own_alternative(finding: dict) -> dict:
    """Return the entry of an ambiguous finding's own effect among its alternatives."""
    own = finding["effect"], finding["variant"]
    return next(one for one in finding["alternatives"] if (one["effect"], one["variant"]) == own)


def _weighted(alternative: dict) -> str:
    """Return the name of one of several effects with its weight."""
    name = " ".join(filter(None, (alternative["effect"].replace("_", " "), alternative["variant"])))
    return f"{name} ({share_text(alternative)})"


def share_text(alternative: dict) -> str:
    """Return the weight of one of several effects, in percent."""
    return quantities.share(alternative["weight"])


def parameter_name(effect: str, name: str) -> str:
    """Return the name of a parameter for a reader: entries of a body vector have axes in place of numbers."""
    base, _, index = name.rstrip("]").partition("[")
    if base.find("_") > 1:  # k_d is a symbol
        base = base.replace("_", " ")
    if not index:
        return base
    if effect in NUMBERED:
        base, first = NUMBERED[effect]
        return f"{base}{int(index) + first}"
    return f"{base} {'xyz'[int(index)]}"


def value_lines(finding: dict, channels: dict) -> list[str]:
    """Return a line for each parameter of a finding, or for each term of an equation, those that remove most first.

    Args:
        finding: entry of the finding.
        channels: entries of the report's channels.
    """
    entries = finding["parameters"]
    if finding["effect"]:
        return [f"{parameter_name(finding['effect'], name)}: {value_text(entry)}" for name, entry in entries.items()]
    return [
        f"{channels[entry['channel']]['name']}: {value_text(entry)}"
        + ("" if entry["quantity"] == "1" else f" times {entry['quantity']}")
        + (f"; removes {quantities.share(entry['removes'])} of its error" if "removes" in entry else "")
        for entry in ranked(list(entries.values()))
    ]


def value_text(entry: dict) -> str:
    """Return a parameter before and after, with its unit and its 95 % interval, as text of a terminal."""
    was, value, interval, unit = quantities.of_interval(
        entry.get("was"), entry["value"], entry["interval95"], entry["unit"]
    )
    change = f"{was or 'absent'} -> {value}" if "was" in entry else value
    return quantities.plain(" ".join(filter(None, (change, unit, f"({interval})" if interval else ""))))
