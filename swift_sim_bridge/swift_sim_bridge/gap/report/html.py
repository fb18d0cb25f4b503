"""The report as one HTML page, which needs no other file: it can be sent, and read on a phone."""

import base64
import re
from collections.abc import Mapping
from html import escape
from pathlib import Path

from swift_sim_bridge.effects import Parameter
from swift_sim_bridge.gap.report import html_findings, html_tables
from swift_sim_bridge.gap.report.sentences import headline_sentences

STYLE = Path(__file__).with_name("page.css")
KINDS = {"use": "use", "check": "check on the vehicle", "fly": "fly", "record": "record"}
UNIT = re.compile(r"(?<=\d) (?=%|(ms|s|m|V|A|W|Hz|N|kg|rad|mm|cm)\b)")  # the space before it, after a number
NO_BREAK = "\N{NO-BREAK SPACE}"
SECTIONS = {  # titles of pictures, by the first word of their files' names
    "track": "Where it differs",
    "time": "When and in what it differs",
    "curves": "When and in what it differs",
    "rollouts": "How far the simulation predicts",
    "horizons": "How far the simulation predicts",
}


def html_page(
    report: dict,
    vehicle_file,
    parameters: dict[tuple[str, str], Parameter],
    pictures: Mapping[str, str],
    folder: Path,
) -> str:
    """Return the page.

    Args:
        report: content of report.json.
        vehicle_file: path of the vehicle file.
        parameters: parameters of the catalogue by effect and name (see `effect_help.parameters`).
        pictures: captions by file name.
        folder: of the pictures.
    """
    verdict, *names = headline_sentences(report)
    parts = [
        f"<span class='chip {escape(report['verdict'])}'>{escape(report['verdict'].replace('_', ' '))}</span>",
        f"<h1>{escape(verdict)}</h1>",
        *(f"<p class=lead>{escape(name)}</p>" for name in names),
        html_tables.tiles(report),
        _steps(report.get("next_steps", [])),
        html_findings.findings(report),
        *_pictures(pictures, folder),
        html_tables.tables(report, parameters),
        html_tables.inputs(report, vehicle_file),
    ]
    content = UNIT.sub(NO_BREAK, "".join(parts))
    return (
        "<!doctype html><html lang=en><head><meta charset=utf-8>"
        "<meta name=viewport content='width=device-width,initial-scale=1'><title>Gap report</title>"
        f"<style>{STYLE.read_text()}</style></head><body><main>{content}</main></body></html>\n"
    )


def _steps(steps: list[dict]) -> str:
    """Return what to do next as a numbered list."""
    rows = "".join(
        f"<li><span class=kind>{KINDS[step['kind']]}</span><div>{_with_code(step['text'])}</div>"
        + "".join(f"<pre>{_unbroken_options(command)}</pre>" for command in step["commands"])
        + "</li>"
        for step in steps
    )
    return f"<h2>What to do next</h2><div class=card><ol class=steps>{rows}</ol></div>" if rows else ""


def _unbroken_options(command: str) -> str:
    """Return a command whose lines do not break within the name of an option."""
    return re.sub(r"(?<= )--[\w-]+", r"<span>\g<0></span>", escape(command))


def _with_code(text: str) -> str:
    """Return a text in which parts between backticks are code."""
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", escape(text))


def _pictures(pictures: Mapping[str, str], folder: Path) -> list[str]:
    """Return the pictures in their sections, each within the page itself."""
    sections: dict[str, list[str]] = {}
    for name, caption in pictures.items():
        data = base64.b64encode((folder / name).read_bytes()).decode()
        figure = (
            f"<figure id='{escape(name)}'><img alt='{escape(caption, quote=True)}' src='data:image/png;base64,{data}'>"
            f"<figcaption>{escape(caption)}</figcaption></figure>"
        )
        sections.setdefault(SECTIONS[name.partition(".")[0].partition("_")[0]], []).append(figure)
    return [f"<h2>{title}</h2><div class=pictures>{''.join(found)}</div>" for title, found in sections.items()]
