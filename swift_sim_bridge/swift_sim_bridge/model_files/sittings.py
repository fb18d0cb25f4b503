"""The sittings of a training: the runs of its command, and what each of them changed.

A training is described by its conditions, a mapping of everything that it reads. A later sitting may change most of
them; those without which its continuation means nothing are refused.
"""

import dataclasses
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from swift_ros.errors import UsageError
from swift_ros.text import excerpt


@dataclasses.dataclass(frozen=True)
class Sitting:
    """One run of the command.

    Attributes:
        begin: interactions or steps of the training before it.
        end: interactions or steps at which the training is to end.
        changes: conditions that differ from those of the sitting before, [before, now] by key.
    """

    begin: int
    end: int
    changes: dict[str, list] = dataclasses.field(default_factory=dict)


def flat(value, key: str = "") -> dict[str, Any]:
    """Return the values of nested mappings by their path, such as `rewards.crash` or `gates[2].position`."""
    if isinstance(value, Mapping) and value:
        parts = [(f"{key}.{name}" if key else name, part) for name, part in value.items()]
    elif isinstance(value, list) and any(isinstance(part, Mapping) for part in value):
        parts = [(f"{key}[{i}]", part) for i, part in enumerate(value)]
    else:
        return {key: value}
    return {path: leaf for name, part in parts for path, leaf in flat(part, name).items()}


def changes(before: Mapping, now: Mapping) -> dict[str, list]:
    """Return [before, now] of each value that differs, by its path; None where it is absent."""
    first, second = flat(before), flat(now)
    keys = [*first, *(key for key in second if key not in first)]
    return {key: [first.get(key), second.get(key)] for key in keys if first.get(key) != second.get(key)}


def require_same(checkpoint: Path, before: Mapping, now: Mapping, fixed: Iterable[str]) -> None:
    """Refuse a change of a condition without which the continuation of a training means nothing.

    Args:
        checkpoint: file of the training.
        before, now: conditions of the training so far, and of this sitting.
        fixed: keys that must stay, with everything below them.

    Raises:
        UsageError: one of them differs.
    """
    for key, (old, new) in changes(before, now).items():
        if any(key == name or key.startswith((f"{name}.", f"{name}[")) for name in fixed):
            raise UsageError(
                f"{checkpoint} holds a training with '{key}' {excerpt(json.dumps(old))}, which is now "
                f"{excerpt(json.dumps(new))}; restore it, or begin another training with another --out"
            )
