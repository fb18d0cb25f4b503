"""Reads `config/*.yaml`: finds the folder and converts a file to a dataclass.

Each file corresponds to a dataclass in the module that uses it. An unknown key, a missing key without default and a
value of the wrong type are errors that name the file and the key.
"""

import dataclasses
import functools
import os
import sys
import types
import typing
from pathlib import Path

import yaml

from swift_ros.errors import UsageError


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
        content = yaml.safe_load(path.read_text())
    except OSError as error:
        raise UsageError(f"{path} cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise UsageError(f"{path} is not UTF-8 text: {error.reason} at byte {error.start}") from error
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f" at line {mark.line + 1}" if mark else ""
        raise UsageError(f"{path} is not valid YAML{where}; correct it or restore the shipped file") from error
    if not isinstance(content, dict):
        raise UsageError(f"{path} must contain a mapping of keys to values")
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


def build(record_type, content: dict, where: str):
    """Return a dataclass filled from a mapping; nested dataclasses, tuples and `dict[str, ...]` are filled recursively.

    Args:
        record_type: the dataclass.
        content: its values by name.
        where: name of the mapping, for errors.

    Raises:
        UsageError: an unknown or missing key, or a value of the wrong type.
    """
    if not isinstance(content, dict):
        raise UsageError(f"{where} must be a mapping of keys, not {content!r}")
    fields = {f.name: f for f in dataclasses.fields(record_type) if f.init}
    for key in content:
        if key not in fields:
            raise UsageError(f"{where} has the unknown key '{key}'; known keys are {', '.join(fields)}")
    hints = _hints(record_type)
    values = {}
    for name, spec in fields.items():
        if name in content:
            values[name] = _convert(hints[name], content[name], f"{where}, key '{name}'")
        elif spec.default is dataclasses.MISSING and spec.default_factory is dataclasses.MISSING:
            raise UsageError(f"{where} lacks the key '{name}'")
    try:
        return record_type(**values)
    except ValueError as error:
        raise UsageError(f"{where}: {error}") from error


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
        if not isinstance(value, dict):
            raise UsageError(f"{where} must be a mapping, not {value!r}")
        item = typing.get_args(hint)[1]
        return {str(key): _convert(item, entry, f"{where}, key '{key}'") for key, entry in value.items()}
    return _convert_scalar(hint, value, where)


def _convert_tuple(arguments, value, where: str):
    if not isinstance(value, list | tuple):
        raise UsageError(f"{where} must be a list, not {value!r}")
    if len(arguments) == 2 and arguments[1] is Ellipsis:
        return tuple(_convert(arguments[0], item, f"{where}[{i}]") for i, item in enumerate(value))
    if len(value) != len(arguments):
        raise UsageError(f"{where} must have {len(arguments)} entries, not {len(value)}")
    return tuple(_convert(a, item, f"{where}[{i}]") for i, (a, item) in enumerate(zip(arguments, value, strict=True)))


def _convert_scalar(hint, value, where: str):
    if hint is typing.Any:
        return value
    if hint is float and isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    if hint is float and isinstance(value, str) and _is_number(value):  # in YAML 1.1 the value 1e-6 is a text
        return float(value)
    if hint in (int, bool, str) and type(value) is hint:
        return value
    raise UsageError(f"{where} must be of type {getattr(hint, '__name__', hint)}, not {value!r}")


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def load(record_type, path: str | os.PathLike):
    """Return `record_type` filled from the YAML file at `path`. Raises UsageError with file and key.

    A field `folder` of the record is set to the file's folder, to which paths in the file are relative.
    """
    content = read_yaml(path)
    if any(spec.name == "folder" for spec in dataclasses.fields(record_type)):
        content = {"folder": str(Path(path).resolve().parent), **content}
    return build(record_type, content, str(path))


def load_section(record_type, path: str | os.PathLike, section: str):
    """Return `record_type` filled from a section of the YAML file at `path`. Raises UsageError with file and key."""
    content = read_yaml(path)
    if section not in content:
        raise UsageError(f"{path} lacks the section '{section}'")
    return build(record_type, content[section] or {}, f"{path}, section '{section}'")
