"""The repaired vehicle file: the whole file with the identified values, and a comment on each change."""

from collections.abc import Iterable
from pathlib import Path

import yaml

HEADER = "# The quadrotor of {source}, {how}. SI units, body frame forward-left-up from the centre of mass."


def text(content: dict, changes: Iterable, source: Path, how: str = "as identified") -> str:
    """Return a vehicle file as YAML.

    Args:
        content: of the file.
        changes: each with `path`, `name`, `value`, `before` (or None), `standard_error` and `unit`.
        source: the original file; paths in the content that are relative to it become absolute.
        how: the values were obtained, for the header.
    """
    lines = [HEADER.format(source=source.name, how=how)]
    content = _absolute(content, source)
    for key, value in content.items():
        for change in changes:
            if change.path[0] == key:
                lines.append(_comment(change))
        # lists and entries of terms on one line each, the rest one value a line
        plain = not isinstance(value, list) and (not isinstance(value, dict) or not any(map(_nested, value.values())))
        style = False if plain else None
        lines.append(yaml.safe_dump({key: value}, sort_keys=False, default_flow_style=style, width=110).rstrip())
    return "\n".join(lines) + "\n"


def _nested(value) -> bool:
    """Return whether a value is a list or a mapping."""
    return isinstance(value, dict | list)


def _comment(change) -> str:
    """Return the comment on a change."""
    value = f"{change.value:.5g} +- {change.standard_error:.2g} {change.unit}".rstrip()
    before = "which the file did not have" if change.before is None else f"was {change.before:.5g}"
    return f"# {change.name}: {value}, {before}"


def _absolute(content: dict, source: Path) -> dict:
    """Return the content with an absolute path of the flight controller's dump."""
    controller = content.get("controller")
    if not isinstance(controller, dict) or not isinstance(controller.get("dump"), str):
        return content
    return content | {"controller": controller | {"dump": str((source.parent / controller["dump"]).resolve())}}
