"""The folder of a batch: its plan, and the record of each case that was opened, scored by the present rules."""

import json
from collections import defaultdict
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import swift_ros
from swift_ros.errors import UsageError
from swift_sim_bridge.referee import seal
from swift_sim_bridge.referee.families import STRANGE_FAMILIES
from swift_sim_bridge.referee.plan import Entry
from swift_sim_bridge.referee.scoring import score

LOG, PLAN, CASES = "log.jsonl", "plan.json", "cases"
REPORT, RESOLVED = "report.json", "resolved.json"  # of a case; the second one after the proposed manoeuvre was flown
MANOEUVRE_FAMILIES = ("poor", "confusable")  # families of our own simulator in which a proposed manoeuvre is flown
# Entries of a record that cannot be computed from the files
RUN_ENTRIES = ("generator", "seconds", "removed", "race_s", "acts_sigma")


@cache
def code_version() -> str:
    """Return a short SHA-256 of the sources of both packages."""
    packages = Path(swift_ros.__file__).parent, Path(__file__).parents[1]
    paths = [(root, path) for root in packages for path in sorted(root.rglob("*.py"))]
    lines = (f"{path.relative_to(root)} {seal.sha256(path.read_bytes())}\n" for root, path in paths)
    return seal.sha256("".join(lines))[:12]


def manoeuvre_is_flown(family: str, generator: str) -> bool:
    """Return whether the manoeuvre that the report of such a case proposes is flown."""
    return generator == "own" and family in MANOEUVRE_FAMILIES


def read_plan(out: Path) -> list[Entry]:
    """Return the entries of the batch in a folder.

    Raises:
        UsageError: the folder has no plan.
    """
    try:
        return [Entry(**entry) for entry in json.loads((out / PLAN).read_text())]
    except OSError as error:
        raise UsageError(f"{out / PLAN} cannot be read: {error.strerror}; give the --out of a run") from error


def read_records(out: Path) -> dict[str, dict]:
    """Return by name the records of all cases that were opened, each with the `code_version` that evaluated it.

    A case is scored anew from its reports; where they were not kept, its record is the one in the log.

    Raises:
        UsageError: a seal of the log is broken, or a report is not the one whose hash is in the log.
    """
    for sentence in seal.broken_seals(out / LOG):
        raise UsageError(f"{out / LOG} does not hold: {sentence}")
    versions, hashes, found = {}, defaultdict(list), {}
    for line in seal.read_log(out / LOG):
        name = line["case"]
        if line["kind"] == "sealed":
            versions[name], hashes[name] = line.get("code", "unknown"), []  # older logs have no code version
        elif line["kind"] == "diagnosed":
            hashes[name].append(line["report_sha256"])
        elif line["kind"] == "opened":
            found[name] = _record(line, hashes[name], out / CASES / name) | {"judged_by": versions[name]}
    return found


def _record(line: dict, hashes: Sequence[str], folder: Path) -> dict:
    """Return the record of an opened case.

    Args:
        line: line of the log in which it was opened.
        hashes: hashes of its reports.
        folder: folder of its reports.
    """
    logged, paths = line["score"], [folder / name for name in (REPORT, RESOLVED)[: len(hashes)]]
    if not paths or not all(path.exists() for path in paths):
        return logged
    for path, sealed in zip(paths, hashes, strict=True):
        if seal.sha256(path.read_bytes()) != sealed:
            raise UsageError(f"{path} is not the report whose hash is in the log")
    report, *second = (json.loads(path.read_text()) for path in paths)
    flown = manoeuvre_is_flown(logged["family"], logged["generator"])
    record = score(line["answer"], report, second[0] if second else None, flown)
    repaired = record["exact"] or record["family"] in STRANGE_FAMILIES
    kept = {key: logged[key] for key in RUN_ENTRIES if key in logged and (key != "removed" or repaired)}
    return record | kept
