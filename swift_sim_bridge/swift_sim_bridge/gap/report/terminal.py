"""The report in the terminal."""

from swift_sim_bridge.gap.report.sentences import (
    confounder_names,
    finding_name,
    headline,
    improvements,
    recording_of,
    value_lines,
    where,
)


def terminal_text(report: dict) -> str:
    """Return the findings of a report (the content of report.json) in a few lines each."""
    lines = [headline(report)]
    for one in report["findings"]:
        significance = f"{one['significance_sigma']:.0f} standard deviations"
        name = f"{finding_name(one)}{recording_of(one)}"
        lines.append(f"{one['verdict']}: {name}, {significance}. {one['sentence']}")
        lines += [f"  {line}" for line in value_lines(one, report["channels"])]
        lines.append(f"  where: {where(one, report['flights'])}")
        if one["alternatives"]:
            lines.append(f"  could also be: {confounder_names(one)}; to separate them: {one['separating_manoeuvre']}")
    return "\n".join([*lines, *improvements(report)])
