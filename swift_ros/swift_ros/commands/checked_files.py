"""Reads the files of a configuration folder with all that is wrong in them, where other commands stop at the first."""

import dataclasses
import importlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from swift_ros import configuration
from swift_ros.commands.section_table import JOINT_CHECKS, RECORDS, SECTIONS
from swift_ros.errors import UsageError
from swift_ros.plausibility.finding import IMPOSSIBLE, ODD, Finding
from swift_ros.text import did_you_mean, excerpt, nearest
from swift_ros.trained_for.folder import warnings

NAMES = (*RECORDS, *SECTIONS)
OTHERS = {
    "cameras": "camera.yaml",
    "tracks": "track.yaml",
    "vehicles": "drone.yaml",
}  # folders of other files, and their kind
OPTIONAL = ("training.yaml",)  # a race needs the others


@dataclasses.dataclass
class Checked:
    """What was read and found.

    Attributes:
        folder: the configuration folder; None for files that are checked alone.
        records: by file name, those of sections by (file name, section). A file or section with a finding that is
            impossible has none.
        findings: (file or folder, finding), in the order of reading.
        files: that were read.
    """

    folder: Path | None = None
    records: dict[Any, Any] = dataclasses.field(default_factory=dict)
    findings: list[tuple[Path, Finding]] = dataclasses.field(default_factory=list)
    files: list[Path] = dataclasses.field(default_factory=list)

    def add(self, path: Path, found: Iterable[Finding]) -> bool:
        """Add findings about a file; return whether none of them is impossible."""
        found = list(found)
        self.findings += [(path, finding) for finding in found]
        return all(finding.level != IMPOSSIBLE for finding in found)

    def refuse(self, path: Path, error: UsageError) -> None:
        """Add what a reader of the file says, as an impossible finding without the name of the file."""
        self.add(path, [Finding(IMPOSSIBLE, str(error).removeprefix(str(path)).lstrip(":, "))])


def check_file(path: Path) -> Checked:
    """Return what is impossible or odd about one file of any kind. Raises UsageError for a file of no known kind."""
    checked = Checked()
    _read(checked, path, None)
    _check_jointly(checked)
    return checked


def check_folder(folder: Path) -> Checked:
    """Return what is impossible or odd about a configuration folder, its other cameras, tracks and vehicles.

    A folder without files of these names is a collection, whose files are checked one by one.

    Raises UsageError when the folder has no file of a configuration.
    """
    if not any((folder / name).is_file() for name in NAMES):
        return _check_others(folder)
    checked = Checked(folder)
    missing = [name for name in NAMES if not (folder / name).is_file()]
    for names, level in (([n for n in missing if n not in OPTIONAL], IMPOSSIBLE), (OPTIONAL, ODD)):
        if lacking := [name for name in names if name in missing]:
            sentence = f"has no {' and no '.join(lacking)}; copy the missing files from the folder config"
            checked.add(folder, [Finding(level, sentence)])
    for name in NAMES:
        if name not in missing:
            _read(checked, folder / name, name)
    _check_jointly(checked)
    if not missing and all(finding.level != IMPOSSIBLE for _, finding in checked.findings):
        checked.add(folder, [Finding(ODD, sentence) for sentence in warnings(folder)])
    for others, name in OTHERS.items():
        for path in _yaml_files(folder / others):
            _check_alone(checked, path, name)
    return checked


def _check_alone(checked: Checked, path: Path, name: str) -> None:
    """Check a file by itself as one of the kind `name`."""
    alone = Checked()
    _read(alone, path, name)
    _check_jointly(alone)
    checked.findings += alone.findings
    checked.files += alone.files


def _yaml_files(folder: Path) -> list[Path]:
    return sorted([*folder.glob("*.yaml"), *folder.glob("*.yml")])


def _check_others(folder: Path) -> Checked:
    """Check each YAML file of a folder by itself."""
    paths = _yaml_files(folder)
    if not paths:
        raise UsageError(f"{folder} holds neither a result.json nor files of a configuration; give a folder with one")
    each = [check_file(path) for path in paths]
    return Checked(None, {}, [found for one in each for found in one.findings], paths)


def _read(checked: Checked, path: Path, name: str | None) -> None:
    """Read a file into `checked`; without a name its content decides of which kind it is."""
    checked.files.append(path)
    try:
        content = configuration.read_yaml(path)
    except UsageError as error:
        checked.refuse(path, error)
        return
    name = name or _kind(path, content)
    if name in RECORDS:
        _read_record(checked, path, name)
        return
    misspelt = set()
    for key in content:
        if key not in SECTIONS[name]:
            meant = nearest(str(key), SECTIONS[name].keys() - content.keys())
            misspelt.add(meant)
            cure = did_you_mean(meant, SECTIONS[name])
            checked.add(path, [Finding(IMPOSSIBLE, f"has the unknown section '{excerpt(str(key))}'; {cure}")])
    for section in SECTIONS[name]:
        if section not in misspelt:
            _read_section(checked, path, name, section)


def _kind(path: Path, content: dict) -> str:
    """Return the name in NAMES of the kind of a file: its own, or the one that has most of its keys."""
    if path.name in NAMES:
        return path.name
    shared = {name: len(set(content) & _keys(name)) for name in NAMES}
    best = max(shared, key=lambda name: shared[name])
    if not shared[best]:
        raise UsageError(f"{path} is no file of a vehicle, track, camera, nodes, simulation or training")
    return best


def _keys(name: str) -> set[str]:
    if name in SECTIONS:
        return set(SECTIONS[name])
    return {spec.name for spec in dataclasses.fields(named(RECORDS[name]))}


def _read_record(checked: Checked, path: Path, name: str) -> None:
    try:
        record = configuration.load_unchecked(named(RECORDS[name]), path)
    except UsageError as error:
        checked.refuse(path, error)
        return
    if checked.add(path, record.findings()):
        checked.records[name] = record


def _read_section(checked: Checked, path: Path, name: str, section: str) -> None:
    try:
        record_type = named(SECTIONS[name][section])
    except ModuleNotFoundError as error:
        if error.name != "swift_sim_bridge":
            raise
        sentence = f"section '{section}' is not checked: the package swift_sim_bridge is not installed here"
        checked.add(path, [Finding(ODD, sentence)])
        return
    try:
        checked.records[name, section] = configuration.load_section(record_type, path, section)
    except UsageError as error:
        checked.refuse(path, error)


def _check_jointly(checked: Checked) -> None:
    """Add the findings that need more than one record, or the simulator."""
    for name in JOINT_CHECKS:
        try:
            check = named(name)
        except ModuleNotFoundError as error:
            if error.name != "swift_sim_bridge":
                raise
            continue
        for file, finding in check(checked.records, checked.folder):
            path = next((path for path in checked.files if path.name == file), None)
            checked.add(path or checked.files[-1], [finding])


def named(name: str):
    """Return what "module:name" names."""
    module, _, member = name.partition(":")
    return getattr(importlib.import_module(module), member)
