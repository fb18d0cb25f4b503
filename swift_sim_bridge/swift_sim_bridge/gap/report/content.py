"""The content of report.json."""

import numpy as np
from scipy import stats

from swift_sim_bridge.effects import Effect
from swift_sim_bridge.gap.discovery import equation_search, equation_text
from swift_sim_bridge.gap.effects.camera import MAP
from swift_sim_bridge.gap.inference import null_distribution, stepwise

DOUBTFUL = 0.3  # of the significance of what has no name: a name beside it may be a part of that
VERDICTS = ("confirmed", "tentative", "ambiguous", "unknown")  # of findings; the last one present is the report's


def report_content(evidence, found, held_out: dict, advice: dict, left: dict) -> dict:
    """Return the content of report.json.

    held_out: errors on parts that no fit has seen (see `prove`); advice: by key what tells look-alikes apart, None
    where nothing does; left: what the repaired vehicle still leaves out, empty where nothing was repaired.
    """
    findings = [finding(one, evidence, advice) for one in found.selected]
    if found.equation_terms:
        findings.append(nameless(found, evidence))
    verdict = overall_verdict(findings, "nothing_left_out" if evidence.effects else "not_testable")
    told = minimum_detectable(evidence)
    unexcited = {
        one.id: f"nothing in these flights shows it; fly: {one.manoeuvre}"
        for one in evidence.effects
        if one.id not in told
    }
    rejected = [
        {"recording": one.name} | rejection.as_json()
        for one in (residual_model.recording for residual_model in evidence.residual_models)
        for rejection in one.rejections
    ]
    return {
        "verdict": verdict,
        "findings": findings,
        "flights": spans(evidence),
        "improvement": {"held_out": held_out, "left": left},
        "minimum_detectable": told,
        "not_testable": dict(sorted((evidence.not_testable | unexcited).items())),
        "rejected_data": rejected,
    }


def overall_verdict(findings: list[dict], without_findings: str) -> str:
    """Return the verdict of a report: the highest of its findings, or `without_findings` if there are none."""
    return max((one["verdict"] for one in findings), key=VERDICTS.index, default=without_findings)


def finding(one, evidence, advice: dict) -> dict:
    """Return a finding's entry; advice: see `content`, without its key where no manoeuvre was tried."""
    effect, open_question = one.effect, one.verdict == "ambiguous"
    channels = [channel.name for channel in evidence.residual_models[0].channels if channel.layer == effect.layer]
    return {
        "verdict": one.verdict,
        "effect": effect.id,
        "variant": effect.variant,
        "layer": "map" if effect.id in MAP else effect.layer,
        "channels": channels,
        "where": {"time": spans(evidence), "segments": [], "regime": ""},
        "significance_sigma": one.significance,
        "parameters": parameters(one, evidence),
        "equation": effect.equation,
        "sentence": sentence(effect, one.values),
        "separating_manoeuvre": manoeuvre(effect, advice) if open_question else None,
        "manoeuvre": manoeuvre_entry(effect, advice) if open_question else None,
        "alternatives": [alternative(key, weight) for key, weight in one.confounders.items()] if open_question else [],
    }


def alternative(key: str, weight: float) -> dict:
    """Return the entry of an effect, by its key, that could be the one found."""
    name, _, variant = key.rstrip("]").partition("[")
    return {"effect": name, "variant": variant, "weight": weight}


def manoeuvre(effect: Effect, advice: dict) -> str:
    """Return what to fly to tell an effect from its look-alikes; advice: see `finding`."""
    if effect.key not in advice:
        return effect.manoeuvre
    found = advice[effect.key]
    if found is None:
        return f"{effect.manoeuvre}; no manoeuvre of the tool's own tells them apart in simulation"
    return f"{found.manoeuvre.text}: {found.separation:.0f} standard deviations apart in simulation"


def manoeuvre_entry(effect: Effect, advice: dict) -> dict | None:
    """Return the id and the duration (s) of the manoeuvre that `manoeuvre` describes, None if no simulated manoeuvre
    separates the confounders; advice: see `finding`."""
    found = advice.get(effect.key)
    return found.manoeuvre.as_json() if found else None


def nameless(found, evidence) -> dict:
    """Return the entry of what no effect of the catalogue explains."""
    terms = found.equation_terms
    sigma = max(stepwise.significance(term.gain, 1) for term in terms)
    layer = equation_search.cause_layer(
        terms, {one.effect.layer for one in found.selected if one.significance > DOUBTFUL * sigma}
    )
    coefficients = {
        f"{term.channel.name}: {term.name}": {
            "value": term.value,
            "unit": term.unit,
            "interval95": [term.value - 1.96 * term.error, term.value + 1.96 * term.error],
        }
        for term in terms
    }
    axes = list(dict.fromkeys(term.channel.name for term in terms))
    goes = sorted({term.name for term in terms if term.name != "1"})
    return {
        "verdict": "unknown",
        "effect": None,
        "variant": "",
        "layer": layer,
        "channels": axes,
        "where": {"time": spans(evidence), "segments": [], "regime": equation_text.domain(terms)},
        "significance_sigma": sigma,
        "parameters": coefficients,
        "equation": equation_text.equation(terms),
        "sentence": f"No effect of the catalogue explains what is left of {', '.join(axes)}; "
        + (f"it goes with {', '.join(goes)}." if goes else "it is constant."),
        "separating_manoeuvre": None,
        "manoeuvre": None,
        "alternatives": [],
    }


def spans(evidence) -> list[list[float]]:
    """Return first and last time of each recording."""
    return [[float(residual_model.t[0]), float(residual_model.t[-1])] for residual_model in evidence.residual_models]


def parameters(one, evidence) -> dict:
    """Return value, unit and 95 % interval of each parameter of a finding, as they stand in the repaired file."""
    seconds = sum(int(residual_model.t[-1] - residual_model.t[0]) for residual_model in evidence.residual_models)
    half = stats.t.ppf(0.975, max(seconds - 1, 1)) * np.sqrt(np.diag(one.covariance))
    found = {}
    for i, parameter in enumerate(one.effect.parameters):
        value = float(one.values[i])
        found[parameter.name] = {
            "value": value,
            "unit": parameter.unit,
            "interval95": [value - float(half[i]), value + float(half[i])],
        }
    if one.effect.variant:
        number = int(one.effect.variant)
        found[one.effect.part] = {"value": number, "unit": "", "interval95": [number] * 2}
    return found


def minimum_detectable(evidence) -> dict:
    """Return the smallest change of each parameter that these recordings can show, by effect; without those that
    nothing shows."""
    found = (
        null_distribution.minimum_detectable_changes(evidence.effects, evidence.null_distribution)
        | evidence.other_minimum_detectable
    )
    if evidence.search_payload and "mass" in found and "payload" not in evidence.not_testable:
        found["payload"] = dict(found["mass"])  # of a load, wherever it is fixed, its weight shows at least
    return found


class Size(float):
    """A number that a sentence can also name by its size alone, "~.3g", and by a word for its sign, "late|early"."""

    def __format__(self, form: str) -> str:
        if "|" in form:
            return form.split("|")[self < 0.0]
        return format(abs(float(self)), form[1:]) if form.startswith("~") else format(float(self), form)


def sentence(effect: Effect, values) -> str:
    """Return what an effect means at these values."""
    named = {
        parameter.name.replace("[", "_").rstrip("]"): Size(value)
        for parameter, value in zip(effect.parameters, values, strict=True)
    }
    text = effect.sentence.format(values=", ".join(f"{value:.3g}" for value in values), **named)
    return text[0].upper() + text[1:] + "."
