"""Shipped files of the configuration with changes: keys joined by dots, and the new value."""

from pathlib import Path

import yaml
from dotted_keys import set_value

CONFIG = Path(__file__).parents[2] / "config"


def rotors(*rows):
    return [{"position": [x, y, 0.0], "spin": spin} for x, y, spin in rows]


def gates(*rows):
    return [{"position": list(row[:3]), "yaw_deg": row[3], **(row[4] if len(row) > 4 else {})} for row in rows]


LEVEL = (0.0, 0.0, 2.0, 0.0)


def changed(tmp_path, kind: str, changes: dict) -> Path:
    """Write a shipped file with changes and return its path."""
    content = yaml.safe_load((CONFIG / f"{kind}.yaml").read_text())
    for key, value in changes.items():
        set_value(content, key, value)
    path = tmp_path / f"{kind}.yaml"
    path.write_text(yaml.safe_dump(content))
    return path
