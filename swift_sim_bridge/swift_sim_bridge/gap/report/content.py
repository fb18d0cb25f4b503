"""The content of report.json, in which every finding is data; sentences are made from it and never read back."""

import numpy as np

from swift_sim_bridge.effects import Effect
from swift_sim_bridge.gap.attribution.evidence import Evidence, SearchResult, SelectedEffect
from swift_sim_bridge.gap.discovery import equation_search, equation_text
from swift_sim_bridge.gap.effects.catalogue import MAP_EFFECTS
from swift_sim_bridge.gap.inference import null_distribution, stepwise
from swift_sim_bridge.gap.validation.experiment_design import SeparatingManoeuvre
from swift_sim_bridge.gap.validation.repair_choice import Repair
from swift_sim_bridge.physics.terms import equation

Advice = dict[str, SeparatingManoeuvre | None]  # by the effect's key; None where no simulated manoeuvre separates

# Significance of an effect relative to that of the equation, above which the layer of the effect counts as a possible
# layer of the cause: the effect may describe a part of it. A smaller share names earlier layers more often.
MIN_SHARE_OF_EQUATION = 0.3
VERDICTS = ("confirmed", "tentative", "ambiguous", "unknown")  # of findings; the last one present is the report's


def report_content(
    evidence: Evidence, found: SearchResult, held_out: dict, advice: Advice, left: dict, chosen: Repair | None = None
) -> dict:
    """Return the content of report.json.

    Args:
        evidence: what was searched.
        found: result of the search.
        held_out: errors before and after the repair on parts of the flights that no fit has seen (see `holdout`).
        advice: manoeuvres that separate the confounders of ambiguous effects.
        left: verdict and findings with the repaired vehicle; empty where nothing was repaired.
        chosen: the repair; None where nothing is repaired.
    """
    findings = [finding(one, evidence, advice) for one in found.selected]
    if found.equation_terms:
        findings.append(equation_finding(found, evidence))
    findings += unexplained_findings(found, evidence)
    findings = [{**one, **repair_entries(one, chosen, bool(found.equation_terms))} for one in findings]
    detectable = minimum_detectable(evidence)
    not_excited = {
        one.id: f"these flights do not excite it; fly: {one.manoeuvre}"
        for one in evidence.effects
        if one.id not in detectable
    }
    rejected = [
        {"recording": one.name} | rejection.as_json()
        for one in (residual_model.recording for residual_model in evidence.residual_models)
        for rejection in one.rejections
    ]
    return {
        "verdict": overall_verdict(findings, evidence, detectable),
        "findings": findings,
        "flights": spans(evidence),
        "channels": {channel.id: channel.as_json() for channel in evidence.residual_models[0].channels},
        "improvement": {"held_out": held_out, "left": left},
        "minimum_detectable": detectable,
        "not_testable": dict(sorted((evidence.not_testable | not_excited).items())),
        "rejected_data": rejected,
    }


def overall_verdict(findings: list[dict], evidence: Evidence, detectable: dict) -> str:
    """Return the verdict of a report: of those of its findings the last one in VERDICTS.

    Args:
        findings: entries of the findings; without one, the verdict depends on whether most of the physics is testable.
        evidence: what was searched.
        detectable: minimum detectable changes, by effect.
    """
    most = evidence.effects and 2 * len(evidence.physics & set(detectable)) >= len(evidence.physics)
    without_findings = "nothing_left_out" if most else "cannot_tell"
    return max((one["verdict"] for one in findings), key=VERDICTS.index, default=without_findings)


def finding(selected: SelectedEffect, evidence: Evidence, advice: Advice) -> dict:
    """Return the entry of a selected effect.

    Args:
        selected: the effect.
        evidence: what was searched.
        advice: see `report_content`; without the effect's key where no manoeuvre was simulated.
    """
    effect, ambiguous = selected.effect, selected.verdict == "ambiguous"
    channels = [channel.id for channel in evidence.residual_models[0].channels if channel.layer == effect.layer]
    manoeuvre = advice.get(effect.key)
    return {
        "verdict": selected.verdict,
        "effect": effect.id,
        "variant": effect.variant,
        "layer": "map" if effect.id in MAP_EFFECTS else effect.layer,
        "channels": channels,
        "where": {"time": spans(evidence), "segments": [], "regime": ""},
        "significance_sigma": selected.significance,
        "parameters": parameters(selected, evidence),
        "equation": effect.equation,
        "sentence": sentence(effect, selected.values),
        "separating_manoeuvre": manoeuvre_sentence(effect, advice) if ambiguous else None,
        "manoeuvre": manoeuvre.manoeuvre.as_json() if ambiguous and manoeuvre else None,
        "alternatives": [alternative(*item) for item in selected.confounders.items()] if ambiguous else [],
    }


def alternative(key: str, weight: float) -> dict:
    """Return the entry of a confounder, by the effect's key."""
    name, _, variant = key.rstrip("]").partition("[")
    return {"effect": name, "variant": variant, "weight": weight}


def manoeuvre_sentence(effect: Effect, advice: Advice) -> str:
    """Return in words what to fly to separate an effect from its confounders.

    Args:
        effect: the effect.
        advice: see `finding`.
    """
    if effect.key not in advice:
        return effect.manoeuvre
    found = advice[effect.key]
    if found is None:
        return f"{effect.manoeuvre}; none of the simulated manoeuvres separates them"
    return f"{found.manoeuvre.text}: {found.separation:.0f} standard deviations apart in simulation"


def equation_finding(found: SearchResult, evidence: Evidence) -> dict:
    """Return the entry of the equation that describes what no effect of the catalogue explains."""
    terms = found.equation_terms
    significance = max(stepwise.significance(term.gain, 1) for term in terms)
    least = MIN_SHARE_OF_EQUATION * significance
    withdrawn = {one.effect.key for one in found.withdrawn}
    strong = [one for one in found.selected if one.significance > least and one.effect.key not in withdrawn]
    layer = equation_search.cause_layer(terms, {one.effect.layer for one in strong})
    channels = list(dict.fromkeys(term.channel for term in terms))
    quantities = sorted({term.name for term in terms if term.name != "1"})
    return {
        "verdict": "unknown",
        "effect": None,
        "variant": "",
        "layer": layer,
        "channels": [channel.id for channel in channels],
        "where": {"time": spans(evidence), "segments": [], "regime": equation_text.domain(terms)},
        "significance_sigma": significance,
        "parameters": {
            f"{term.channel.id}: {term.name}": {
                "value": term.value,
                "unit": term.unit,
                "interval95": [term.value - 1.96 * term.error, term.value + 1.96 * term.error],
                "channel": term.channel.id,
                "quantity": term.name,
            }
            for term in terms
        },
        "equation": equation_text.equation(terms),
        "sentence": "No effect of the catalogue explains the remaining residual of "
        + f"{', '.join(channel.name for channel in channels)}; "
        + (f"it depends on {', '.join(quantities)}." if quantities else "it is constant."),
        "separating_manoeuvre": None,
        "manoeuvre": None,
        "alternatives": [],
    }


def unexplained_findings(found: SearchResult, evidence: Evidence) -> list[dict]:
    """Return an entry for each layer in which a residual remains that neither effects nor an equation explain."""
    entries = []
    for layer in dict.fromkeys(one.channel.layer for one in found.unexplained):
        own = [one for one in found.unexplained if one.channel.layer == layer]
        quantities = sorted({one.quantity for one in own if one.quantity})
        parts = ", ".join(f"{one.channel.name} {one.share:.0%}" for one in own)
        entries.append(
            {
                "verdict": "unknown",
                "effect": None,
                "variant": "",
                "layer": layer,
                "channels": [one.channel.id for one in own],
                "where": {"time": spans(evidence), "segments": [], "regime": ""},
                "significance_sigma": max(one.significance for one in own),
                "parameters": {},
                "equation": "",
                "unexplained": {one.channel.id: one.share for one in own},
                "sentence": "Neither an effect of the catalogue nor an equation explains these shares of the squared "
                f"error: {parts}; "
                + (
                    f"what is left follows curves over {', '.join(quantities)}."
                    if quantities
                    else "what is left changes slowly and follows no quantity of the recording."
                ),
                "separating_manoeuvre": None,
                "manoeuvre": None,
                "alternatives": [],
            }
        )
    return entries


def repair_entries(finding: dict, chosen: Repair | None, has_equation: bool) -> dict:
    """Return the entries of a finding about the repair: whether it has the effect, and the summands of an equation.

    The summands stand in the order of the share of the error that each removes. They belong to the finding of the
    equation, without one to the unexplained residuals of their layer.

    Args:
        finding: the entry.
        chosen: the repair.
        has_equation: whether there is a finding of an equation.
    """
    if chosen is None:
        return {}
    if finding["effect"] is not None:
        names = {(one.effect.id, one.effect.variant) for one in chosen.names}
        return {"in_repair": (finding["effect"], finding["variant"]) in names}
    summands = equation_summands(chosen)
    if "unexplained" not in finding:
        return {"in_repair": bool(summands), "summands": summands}
    own = [one for one in summands if equation.LAYERS[equation.kind_of(one["side"])] == finding["layer"]]
    if has_equation or not own:
        return {"in_repair": False}
    text = "; ".join(
        " ".join(filter(None, (one["side"].replace("_", " "), f"{one['coefficient']:+.3g}", one["unit"])))
        + f" times {one['product']}"
        for one in own
    )
    sentence = f"{finding['sentence']} The repaired file describes a part of it by an equation: {text}."
    return {"in_repair": True, "summands": own, "sentence": sentence}


def equation_summands(chosen: Repair) -> list[dict]:
    """Return the entries of an equation's summands, by decreasing share of the error that each removes."""
    summands = []
    for one in chosen.equation:
        errors = np.sqrt(np.diag(one.covariance))
        for parameter, value, error in zip(one.effect.parameters, one.values, errors, strict=True):
            *_, side, product, _ = parameter.path
            share = chosen.shares.get(parameter.name)
            entry = {"side": side, "product": product, "coefficient": float(value), "unit": parameter.unit}
            low, high = one.effect.idle["equation"][side][product]["range"]
            summands.append(entry | {"standard_error": float(error), "range": [low, high], "removed_share": share})
    return sorted(summands, key=lambda entry: -(entry["removed_share"] or 0.0))


def spans(evidence: Evidence) -> list[list[float]]:
    """Return first and last time of each recording, s."""
    return [[float(residual_model.t[0]), float(residual_model.t[-1])] for residual_model in evidence.residual_models]


def parameters(selected: SelectedEffect, evidence: Evidence) -> dict:
    """Return value, unit and 95 % interval of each parameter of an effect, with the values of the repaired file."""
    intervals, found = selected.interval95(evidence.seconds), {}
    for i, parameter in enumerate(selected.effect.parameters):
        found[parameter.name] = {
            "value": float(selected.values[i]),
            "unit": parameter.unit,
            "interval95": [float(low_or_high) for low_or_high in intervals[:, i]],
        }
    if selected.effect.variant:
        number = int(selected.effect.variant)
        found[selected.effect.part] = {"value": number, "unit": "", "interval95": [number] * 2}
    return found


def minimum_detectable(evidence: Evidence) -> dict:
    """Return the smallest change of each parameter that these recordings can show, by effect and parameter.

    Effects that these recordings do not excite are left out.
    """
    found = (
        null_distribution.minimum_detectable_changes(evidence.effects, evidence.null_distribution)
        | evidence.other_minimum_detectable
    )
    if evidence.search_payload and "mass" in found and "payload" not in evidence.not_testable:
        found["payload"] = dict(found["mass"])  # wherever a payload is fixed, at least its weight shows
    return found


class Size(float):
    """A number with two more formats: "~.3g" is its absolute value, "late|early" a word chosen by its sign."""

    def __format__(self, form: str) -> str:
        if "|" in form:
            return form.split("|")[self < 0.0]
        return format(abs(float(self)), form[1:]) if form.startswith("~") else format(float(self), form)


def sentence(effect: Effect, values) -> str:
    """Return what an effect means at these values (k,), as a sentence."""
    named = {
        parameter.name.replace("[", "_").rstrip("]"): Size(value)
        for parameter, value in zip(effect.parameters, values, strict=True)
    }
    text = effect.sentence.format(values=", ".join(f"{value:.3g}" for value in values), **named)
    return text[0].upper() + text[1:] + "."
