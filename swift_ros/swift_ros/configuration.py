"""Reads `config/*.yaml`: finds the folder and converts a file to a dataclass.

Each file corresponds to a dataclass in the module that uses it. An unknown key, a missing key without default and a
value of the wrong type are errors that name the file and the key.
"""

import dataclasses
import functools
import json
import math
import os
import re
import sys
import types
import typing
from pathlib import Path

from swift_ros.errors import UsageError
from swift_ros.files.yaml_text import parse_yaml
from swift_ros.plausibility.finding import IMPOSSIBLE, TOO_LARGE
from swift_ros.text import described, did_you_mean, excerpt, nearest

KINDS = {float: "a finite number", int: "a whole number", bool: "true or false", str: "a text"}


def configuration_folder(chosen: str | os.PathLike | None = None) -> Path:
    """Return the configuration folder.

    Args:
        chosen: folder given by the user. Without it, the folder is `$SWIFT_CONFIG`, else that of the repository, else
            the installed one.

    Raises:
        UsageError: the folder does not exist.
    """
    for given, source in ((chosen, "--config"), (os.environ.get("SWIFT_CONFIG"), "$SWIFT_CONFIG")):
        if given:
            folder = Path(given)
            if not folder.is_dir():
                raise UsageError(f"{source} names {folder}, which is not a folder; give one with drone.yaml in it")
            return folder
    return shipped_folder()


def shipped_folder() -> Path:
    """Return the configuration folder of the repository, else the installed one. Raises UsageError without one."""
    for folder in _default_folders():
        if (folder / "drone.yaml").is_file():
            return folder
    raise UsageError("no configuration folder was found; pass --config DIR or set SWIFT_CONFIG")


def _default_folders():
    yield Path(__file__).resolve().parents[2] / "config"
    yield from (prefix / "share" / "swift_ros" / "config" for prefix in prefixes())


def prefixes() -> list[Path]:
    """Return the prefixes of installed ROS packages: sourced workspaces, then this Python environment."""
    sourced = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    return [Path(prefix) for prefix in filter(None, sourced)] + [Path(sys.prefix)]


def read_yaml(path: str | os.PathLike) -> dict:
    """Return the mapping in a YAML file. Raises UsageError with the file and line of an error."""
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{path} cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        raise UsageError(f"{path} is not UTF-8 text at line {line}; save it as UTF-8") from error
    content = parse_yaml(text, str(path), finite=True)
    if content is None:
        raise UsageError(f"{path} is empty; write its keys, or restore the shipped file")
    if not isinstance(content, dict):
        raise UsageError(f"{path} must contain a mapping of keys to values, not {described(content)}")
    return content


def setting(help: str, low: float | None = None, high: float | None = None):
    """Return a dataclass field for a setting; its value is in `config/nodes.yaml`, there is no default.

    Args:
        help: description.
        low: smallest allowed value, None without a range.
        high: largest allowed value.
    """
    limits = None if low is None else (low, high)
    return dataclasses.field(metadata={"help": help, "range": limits})


def within(low: float, high: float = math.inf):
    """Return a dataclass field without default whose value, or each of whose values, lies in a range."""
    return setting("", low, high)


def refuse_outside(options, **values: str) -> None:
    """Raise ValueError for the first of `values`, texts by key, that is none of the options."""
    for name, value in values.items():
        if value not in options:
            raise ValueError(f"'{name}' must be one of {', '.join(options)}, not {described(value)}")


def refuse_falling(**pairs: tuple[float, float]) -> None:
    """Raise ValueError for the first of `pairs`, (lowest, highest) by key, that falls."""
    for name, (low, high) in pairs.items():
        if low > high:
            raise ValueError(
                f"'{name}' must rise from its lowest to its highest value, not from {low:g} to {high:g}; exchange them"
            )


def refuse_larger(whole: tuple[str, float], **parts: float) -> None:
    """Raise ValueError for the first of `parts`, numbers by key, that is larger than the whole, (key, number)."""
    name, limit = whole
    for part, number in parts.items():
        if number > limit:
            raise ValueError(
                f"'{part}' {described(number)} must be at most '{name}' {described(limit)}, of which it is a part; "
                f"give less, or a larger '{name}'"
            )


def build(record_type, content: dict, where: str):
    """Return a dataclass filled from a mapping; nested dataclasses, tuples and `dict[str, ...]` are filled recursively.

    Args:
        record_type: the dataclass.
        content: its values by name.
        where: name of the mapping, for errors.

    Raises:
        UsageError: an unknown or missing key, or a value of the wrong type or outside its range.
    """
    if not isinstance(content, dict):
        raise UsageError(f"{where} must be a mapping of keys, not {described(content)}")
    fields = {f.name: f for f in dataclasses.fields(record_type) if f.init}
    for key in content:
        if key not in fields:
            cure = did_you_mean(nearest(str(key), fields.keys() - content.keys()), fields)
            raise UsageError(f"{where} has the unknown key '{excerpt(str(key))}'; {cure}")
    hints = _hints(record_type)
    values = {}
    for name, spec in fields.items():
        if name in content:
            values[name] = _convert(hints[name], content[name], f"{where}, key '{name}'")
            _check_range(spec.metadata, values[name], f"{where}, key '{name}'")
        elif spec.default is dataclasses.MISSING and spec.default_factory is dataclasses.MISSING:
            raise UsageError(f"{where} lacks the key '{name}'")
    try:
        return record_type(**values)
    except ValueError as error:
        raise UsageError(f"{where}: {error}") from error
    except ArithmeticError as error:
        raise UsageError(f"{where}: {TOO_LARGE}") from error


def _check_range(metadata, value, where: str) -> None:
    """Raise UsageError for a number, or one of a tuple, outside of the range in a field's metadata."""
    low, high = metadata.get("range") or (-math.inf, math.inf)
    for number in value if isinstance(value, tuple) else (value,):
        if isinstance(number, int | float) and not low <= number <= high:
            limits = f"at least {low:,}" if math.isinf(high) else f"from {low:,} to {high:,}"
            meaning = f" ({metadata['help']})" if metadata.get("help") else ""
            raise UsageError(f"{where} must be {limits}, not {described(number)}{meaning}")


def content(record) -> dict:
    """Return a dataclass as the mapping from which `build` fills it, of lists, texts and numbers.

    Fields that do not count in comparisons are left out, such as the folder of a file.
    """
    fields = [spec.name for spec in dataclasses.fields(record) if spec.init and spec.compare]
    values = dataclasses.asdict(record)
    return json.loads(json.dumps({name: values[name] for name in fields}, default=str))


@functools.cache
def _hints(record_type) -> dict:
    return typing.get_type_hints(record_type)


def _convert(hint, value, where: str):
    origin = typing.get_origin(hint)
    if origin in (typing.Union, types.UnionType):
        options = [option for option in typing.get_args(hint) if option is not type(None)]
        return None if value is None else _convert(options[0], value, where)
    if dataclasses.is_dataclass(hint):
        return build(hint, value, where)
    if origin is tuple:
        return _convert_tuple(typing.get_args(hint), value, where)
    if origin is dict:
        value = {} if value is None else value  # a key with nothing below it
        if not isinstance(value, dict):
            raise UsageError(f"{where} must be a mapping, not {described(value)}")
        item = typing.get_args(hint)[1]
        return {str(key): _convert(item, entry, f"{where}, key '{excerpt(str(key))}'") for key, entry in value.items()}
    return _convert_scalar(hint, value, where)


def _convert_tuple(arguments, value, where: str):
    if not isinstance(value, list | tuple):
        raise UsageError(f"{where} must be a list, not {described(value)}")
    if len(arguments) == 2 and arguments[1] is Ellipsis:
        arguments = (arguments[0],) * len(value)
    if len(value) != len(arguments):
        split = len(value) == 2 * len(arguments) and all(
            isinstance(item, int) or (isinstance(item, str) and item.isdigit()) for item in value
        )
        comma = "; decimal commas? write 0.06, not 0,06" if split and float in arguments else ""
        raise UsageError(f"{where} must have {len(arguments)} entries, not {len(value)}{comma}")
    return tuple(
        _convert(hint, item, _entry(where, i))
        for i, (hint, item) in enumerate(zip(arguments, value, strict=True), start=1)
    )


def _entry(where: str, number: int) -> str:
    """Return the name of an entry of a list, from 1: "gate 2" of the key 'gates', else "entry 2"."""
    listed = re.fullmatch(r"(.*), key '(\w+)s'", where)
    return f"{listed[1]}, {listed[2]} {number}" if listed else f"{where}, entry {number}"


def _convert_scalar(hint, value, where: str):
    if hint is typing.Any:
        return value
    if hint is float and isinstance(value, int | float | str) and not isinstance(value, bool):
        number = _number(value)  # in YAML 1.1 the value 1e-6 is a text
        if math.isfinite(number):
            return number
    if hint in (int, bool, str) and type(value) is hint:
        return value
    cure = ""
    if hint is float and isinstance(value, str) and re.fullmatch(r"-?\d+,\d+", value):
        cure = f"; write {value.replace(',', '.')}"
    raise UsageError(f"{where} must be {KINDS.get(hint, hint)}, not {described(value)}{excerpt(cure)}")


def _number(value: int | float | str) -> float:
    """Return the number of a value or text; NaN where it is none, or too large."""
    try:
        return float(value)
    except (ValueError, OverflowError):
        return math.nan


def load(record_type, path: str | os.PathLike):
    """Return `record_type` filled from the YAML file at `path`. Raises UsageError with file and key.

    A field `folder` of the record is set to the file's folder, to which paths in the file are relative. A record with
    `findings` is refused when one of them is impossible.
    """
    record = load_unchecked(record_type, path)
    for finding in record.findings() if hasattr(record, "findings") else ():
        if finding.level == IMPOSSIBLE:
            raise UsageError(f"{path}: {finding.sentence}")
    return record


def load_unchecked(record_type, path: str | os.PathLike):
    """Return a record as `load` does, whatever its findings are."""
    content = read_yaml(path)
    if any(spec.name == "folder" for spec in dataclasses.fields(record_type)):
        content = {"folder": str(Path(path).resolve().parent), **content}
    return build(record_type, content, str(path))


def read_section(path: str | os.PathLike, section: str) -> dict:
    """Return a section of the YAML file at `path`; {} when it is empty. Raises UsageError with file and section."""
    content = read_yaml(path)
    if section not in content:
        raise UsageError(f"{path} lacks the section '{section}'")
    found = content[section] or {}
    if not isinstance(found, dict):
        raise UsageError(f"{path}, section '{section}' must be a mapping of keys, not {described(found)}")
    return found


def load_section(record_type, path: str | os.PathLike, section: str):
    """Return `record_type` filled from a section of the YAML file at `path`. Raises UsageError with file and key."""
    return build(record_type, read_section(path, section), f"{path}, section '{section}'")
