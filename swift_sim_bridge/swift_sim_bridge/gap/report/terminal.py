"""The report in the terminal."""

from swift_ros.text import align
from swift_sim_bridge.gap.report import quantities
from swift_sim_bridge.gap.report.html_tables import MODEL_NAMES
from swift_sim_bridge.gap.report.sentences import (
    finding_name,
    headline,
    improvements,
    likelihood_text,
    ranked,
    recording_of,
    significance_text,
    value_lines,
    where,
)

MAX_TERMS = 5  # terms of an equation that the terminal shows; the page shows all


def terminal_text(report: dict) -> str:
    """Return the findings of a report (the content of report.json) in a few lines each, and what to do next."""
    lines = [headline(report)]
    for one in ranked(report["findings"]):
        evidence = significance_text(one)
        if "removes" in one:
            evidence += f", removes {quantities.share(one['removes'])} of the error"
        lines.append(f"{one['verdict']}: {finding_name(one)}{recording_of(one)}, {evidence}. {one['sentence']}")
        values = value_lines(one, report["channels"])
        lines += [f"  {line}" for line in values[:MAX_TERMS]]
        if len(values) > MAX_TERMS:
            lines.append(f"  and {len(values) - MAX_TERMS} smaller terms, in the report")
        lines.append(f"  where: {where(one, report['flights'])}")
        if one["alternatives"]:
            lines.append(f"  {likelihood_text(one)} To separate them: {one['separating_manoeuvre']}")
        if one.get("caution"):
            lines.append(f"  note: {one['caution']}")
    lines += improvements(report)
    lines += unseen_flights(report.get("unseen_flights", []))
    for step in report.get("next_steps", []):
        lines += [f"{step['kind']}: {step['text']}", *(f"  {command}" for command in step["commands"])]
    return "\n".join(lines)


def unseen_flights(entries: list[dict]) -> list[str]:
    """Return a table of the errors of the specific force on each unseen flight, by axis and model; empty without."""
    rows = [("specific force, m/s^2", "axis", *MODEL_NAMES.values())]
    for one in (one for one in entries if "one_step_rmse" in one):
        leveled = one["one_step_rmse_with_level_by_axis"]
        for axis, errors in one["one_step_rmse_by_axis"].items():
            cells = (f"{errors[model]:.3f} ({leveled[axis][model]:.3f})" for model in MODEL_NAMES)
            rows.append((one["recording"], axis, *cells))
    title = (
        "On flights that no fit has used; the remainder has the running level of the flight, "
        "in brackets all models have one:"
    )
    return [title, align(rows)] if len(rows) > 1 else []
