"""Definitions of message types, as MCAP files store them: `ros2msg` text and RIHS01 hash."""

import json
from pathlib import Path

from swift_ros.configuration import prefixes
from swift_ros.errors import UsageError


def _share(package: str) -> Path:
    """Return the installed `share` folder of a message package. Raises UsageError when it is not installed."""
    for prefix in prefixes():
        if (prefix / "share" / package / "package.xml").is_file():
            return prefix / "share" / package
    raise UsageError(f"the message package {package} is not installed; run make setup")


_PRIMITIVES = ("bool", "byte", "char", "float32", "float64", "int", "uint", "string", "wstring")


def schema_text(type_name: str) -> str:
    """Return the concatenated `ros2msg` definition of a type and of all types nested in it."""
    written, text = set(), []
    pending = [type_name]
    while pending:
        name = pending.pop(0)
        if name in written:
            continue
        written.add(name)
        package, _, message = name.split("/")
        definition = (_share(package) / "msg" / f"{message}.msg").read_text()
        short = f"{package}/{message}"
        text.append(definition if not text else f"{'=' * 80}\nMSG: {short}\n{definition}")
        pending += _used_types(definition, package)
    return "\n".join(text)


def _used_types(definition: str, package: str) -> list[str]:
    """Return the names of the message types in the fields of a definition."""
    names = []
    for line in definition.splitlines():
        words = line.split("#")[0].split()
        kind = words[0].split("[")[0].split("<")[0] if len(words) > 1 else ""
        if not kind or kind.startswith(_PRIMITIVES):
            continue
        kind = kind if "/" in kind else "std_msgs/Header" if kind == "Header" else f"{package}/{kind}"
        owner, message = kind.split("/")[0], kind.split("/")[-1]
        names.append(f"{owner}/msg/{message}")
    return names


def type_hash(type_name: str) -> str:
    """Return the RIHS01 hash of a type, "" when its description is not installed."""
    package, _, message = type_name.split("/")
    description = _share(package) / "msg" / f"{message}.json"
    if not description.is_file():
        return ""
    hashes = json.loads(description.read_text()).get("type_hashes", [])
    return next((row["hash_string"] for row in hashes if row["type_name"] == type_name), "")
