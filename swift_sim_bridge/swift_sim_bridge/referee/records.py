"""What a folder holds of a batch: its plan, and a record of each case that was opened, scored by today's rules."""

import json
from collections import defaultdict
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import swift_ros
from swift_ros.errors import UsageError
from swift_sim_bridge.referee import seal
from swift_sim_bridge.referee.plan import Entry
from swift_sim_bridge.referee.scoring import score

LOG, PLAN, CASES = "log.jsonl", "plan.json", "cases"
REPORT, RESOLVED = "report.json", "resolved.json"  # and what is told once the proposed manoeuvre is flown
FOLLOWED = ("poor", "confusable")  # families of our own simulator in which a report's proposal is flown
ONLY_THE_RUN = ("generator", "seconds", "removed")  # entries of a record that no file tells


@cache
def code() -> str:
    """Return a short SHA-256 of the sources of both packages, as this process found them."""
    packages = Path(swift_ros.__file__).parent, Path(__file__).parents[1]
    paths = [(root, path) for root in packages for path in sorted(root.rglob("*.py"))]
    lines = (f"{path.relative_to(root)} {seal.sha256(path.read_bytes())}\n" for root, path in paths)
    return seal.sha256("".join(lines))[:12]


def followed(family: str, generator: str) -> bool:
    """Return whether the manoeuvre is flown that a report of such a case proposes."""
    return generator == "own" and family in FOLLOWED


def plan(out: Path) -> list[Entry]:
    """Return the entries of the batch that a folder holds. Raises UsageError when it holds none."""
    try:
        return [Entry(**entry) for entry in json.loads((out / PLAN).read_text())]
    except OSError as error:
        raise UsageError(f"{out / PLAN} cannot be read: {error.strerror}; give the --out of a run") from error


def records(out: Path) -> dict[str, dict]:
    """Return by name the records of all cases that were opened, with the `code` that judged each; where its reports
    were not kept, as it was scored then.

    Raises UsageError for a log that does not hold, or a report that is not the one in it.
    """
    for sentence in seal.broken(out / LOG):
        raise UsageError(f"{out / LOG} does not hold: {sentence}")
    judged_by, hashes, found = {}, defaultdict(list), {}
    for line in seal.lines(out / LOG):
        name = line["case"]
        if line["kind"] == "sealed":
            judged_by[name], hashes[name] = line.get("code", "unknown"), []  # older logs do not tell
        elif line["kind"] == "diagnosed":
            hashes[name].append(line["report_sha256"])
        elif line["kind"] == "opened":
            found[name] = _scored(line, hashes[name], out / CASES / name) | {"judged_by": judged_by[name]}
    return found


def _scored(line: dict, hashes: Sequence[str], folder: Path) -> dict:
    """Return the record of an opened case, whose reports have such hashes."""
    logged, paths = line["score"], [folder / name for name in (REPORT, RESOLVED)[: len(hashes)]]
    if not paths or not all(path.exists() for path in paths):
        return logged
    for path, told in zip(paths, hashes, strict=True):
        if seal.sha256(path.read_bytes()) != told:
            raise UsageError(f"{path} is not the report whose hash is in the log")
    report, *again = (json.loads(path.read_text()) for path in paths)
    own = followed(logged["family"], logged["generator"])
    record = score(line["answer"], report, again[0] if again else None, own)
    kept = {key: logged[key] for key in ONLY_THE_RUN if key in logged and (key != "removed" or record["exact"])}
    return record | kept
