"""The provenance of a network, and sentences on what differs from it."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from swift_ros import configuration
from swift_ros.errors import UsageError


@dataclass(frozen=True)
class Part:
    """A part of what a network was trained for, and what it is to fly with.

    Attributes:
        key: of the part in `trained_for`.
        kind: dataclass of its file; None for a plain mapping.
        now: what the network is to fly with.
        differences: (trained, now) -> a text for each difference, the largest first.
        other: the part in the sentence, such as "another track".
        advice: what to do about a difference.
    """

    key: str
    kind: type | None
    now: Any
    differences: Callable[[Any, Any], list[str]]
    other: str
    advice: str


def warnings(model: Path, network: str, parts: tuple[Part, ...]) -> list[str]:
    """Return a sentence for each part that a network was not trained for, and on a provenance that is wrong.

    Args:
        model: the network.
        network: its name in the sentence.
        parts: what is compared; those that the provenance lacks are not.
    """
    stored = _stored(model)
    if isinstance(stored, str):
        return [stored]
    sentences = []
    for part in (part for part in parts if part.key in stored):
        where = f"{model.with_suffix('.json')}, key '{part.key}'"
        try:
            trained = configuration.build(part.kind, stored[part.key], where) if part.kind else stored[part.key]
        except UsageError as error:
            sentences.append(f"what the {network} was trained for is not known: {error}")
            continue
        sentences += _sentence(network, part, part.differences(trained, part.now))
    return sentences


def _stored(model: Path) -> dict | str:
    """Return `trained_for` of a network, empty where its provenance has none, or a sentence on a wrong provenance."""
    path = model.with_suffix(".json")
    try:
        record = json.loads(path.read_text())
        content, digest = record.get("trained_for", {}), record.get("sha256")
        current = hashlib.sha256(model.read_bytes()).hexdigest()
    except OSError:
        return {}  # a network without provenance; one that is missing is an error of its node
    except (ValueError, AttributeError):
        return f"{path} is not the provenance of {model.name}; copy both files of a training together"
    if digest != current:
        return f"{path} describes another {model.name}; copy both files of a training together"
    return content if isinstance(content, dict) else {}


def _sentence(network: str, part: Part, differences: list[str]) -> list[str]:
    """Return the sentence on differences, the first of which is named; none without a difference."""
    if not differences:
        return []
    more = len(differences) - 1
    rest = f", and {more} more difference{'s' * (more > 1)}" if more else ""
    return [f"the {network} was trained for {part.other}: {differences[0]}{rest}; {part.advice}"]


def angles_deg(q_before, q_now):
    """Return the angles (...) between attitudes (..., 4), degrees."""
    return np.degrees(2.0 * np.arccos(np.clip(np.abs(np.sum(q_before * q_now, axis=-1)), 0.0, 1.0)))


def far(before, now, share: float) -> bool:
    """Return whether numbers differ by more than a share of the largest of them."""
    before, now = np.ravel(np.asarray(before, float)), np.ravel(np.asarray(now, float))
    return before.shape != now.shape or bool(np.abs(now - before).max() > (share + 1e-9) * np.abs(before).max())


def difference(name: str, before, now, unit: str) -> str:
    """Return the difference of a value of a file in words; of a list only its name."""
    label = name if " " in name else f"'{name}'"
    if np.ndim(before) or np.ndim(now):
        return f"{label} has other values"
    return f"{label} is {now:.4g}{unit and ' '}{unit}, it was {before:.4g}"
