"""Reading `config/*.yaml`: where the folder is, and how a file becomes a dataclass.

One place per number: each file is mirrored by a dataclass in the module that uses it; a key the dataclass lacks, a
missing key without default and a value of the wrong type are errors that name file and key.
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
    """Return the configuration folder: `chosen`, else `$SWIFT_CONFIG`, else the installed or the repository's one.

    Raises UsageError when the folder does not exist.
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
    """Return where ROS packages may be installed: the sourced workspaces, then this Python environment."""
    sourced = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    return [Path(prefix) for prefix in filter(None, sourced)] + [Path(sys.prefix)]


def read_yaml(path: str | os.PathLike) -> dict:
    """Return the mapping in a YAML file. Raises UsageError naming the file (and line) when it cannot."""
    path = Path(path)
    try:
        content = yaml.safe_load(path.read_text())
    except OSError as error:
        raise UsageError(f"{path} cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise UsageError(f"{path} is no text in UTF-8: {error.reason} at byte {error.start}") from error
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f" at line {mark.line + 1}" if mark else ""
        raise UsageError(f"{path} is not valid YAML{where}; correct it or restore the shipped file") from error
    if not isinstance(content, dict):
        raise UsageError(f"{path} must hold a mapping of keys to values")
    return content


def setting(help: str, low: float | None = None, high: float | None = None):
    """Return a dataclass field without default: its value stands in `config/nodes.yaml`, and only there."""
    limits = None if low is None else (low, high)
    return dataclasses.field(metadata={"help": help, "range": limits})


def build(record_type, content: dict, where: str):
    """Return `record_type` (a dataclass) filled from the mapping `content`; `where` names it in errors.

    Nested dataclasses, tuples of dataclasses and `dict[str, ...]` are filled recursively. Raises UsageError for an
    unknown or missing key and for a value of the wrong type.
    """
    if not isinstance(content, dict):
        raise UsageError(f"{where} must be a mapping of keys, not {content!r}")
    fields = {f.name: f for f in dataclasses.fields(record_type) if f.init}
    for key in content:
        if key not in fields:
            raise UsageError(f"{where} has the unknown key '{key}'; known are {', '.join(fields)}")
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
    if hint is float and isinstance(value, str) and _is_number(value):  # YAML 1.1 reads 1e-6 as text
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
    """Return `record_type` filled from the YAML file at `path`. Raises UsageError naming file and key.

    A record with a field `folder` gets that of the file, to which paths in it are relative.
    """
    content = read_yaml(path)
    if any(spec.name == "folder" for spec in dataclasses.fields(record_type)):
        content = {"folder": str(Path(path).resolve().parent), **content}
    return build(record_type, content, str(path))


def load_section(record_type, path: str | os.PathLike, section: str):
    """Return `record_type` filled from a section of the YAML file at `path`. Raises UsageError naming file and key."""
    content = read_yaml(path)
    if section not in content:
        raise UsageError(f"{path} lacks the section '{section}'")
    return build(record_type, content[section] or {}, f"{path}, section '{section}'")
