"""Commit and reveal: the hash of an answer is logged before the tool runs, the answer itself only afterwards.

The log is a file of JSON lines to which lines are only added, for each case in this order:

sealed      hashes of the answer, the recording and the vehicle file, and the version of the code
diagnosed   hash of the report
flown       where a manoeuvre was proposed and flown: the manoeuvre, and the hash of its recording
diagnosed   hash of the report on both recordings
opened      answer, nonce and score

`broken_seals` lists the opened answers that are not the sealed ones. The hash of a recording can be checked where the
recording was kept.
"""

import hashlib
import json
import secrets
from datetime import datetime, timezone
from pathlib import Path


def sha256(text: str | bytes) -> str:
    """Return the SHA-256 of a text or of bytes, in hexadecimal."""
    return hashlib.sha256(text.encode() if isinstance(text, str) else text).hexdigest()


def canonical(record: dict) -> str:
    """Return a record as JSON with sorted keys and without spaces: equal records give equal texts."""
    return json.dumps(record, sort_keys=True, separators=(",", ":"))


def fresh_nonce() -> str:
    """Return 128 random bits in hexadecimal; without them, an answer could be found from its hash by trial."""
    return secrets.token_hex(16)


def answer_hash(answer: dict, nonce: str) -> str:
    """Return the hash of an answer that is logged before the answer is opened."""
    return sha256(canonical(answer) + nonce)


def append(log: Path, kind: str, case: str, **entries) -> None:
    """Add a line to the log, with its kind, case, time and further entries."""
    line = {"kind": kind, "case": case, "at": datetime.now(timezone.utc).isoformat(timespec="milliseconds")} | entries
    text = json.dumps(line) + "\n"
    if log.exists() and log.read_bytes()[-1:] not in (b"", b"\n"):
        text = "\n" + text  # an interruption has cut the last line
    with open(log, "a") as stream:
        stream.write(text)


def read_log(log: Path) -> list[dict]:
    """Return the log's lines, without one that an interruption has cut."""
    if not log.exists():
        return []
    found = []
    for text in log.read_text().splitlines():
        try:
            found.append(json.loads(text))
        except json.JSONDecodeError:
            continue
    return found


def broken_seals(log: Path) -> list[str]:
    """Return a sentence for each case whose opened answer was not sealed before its report."""
    sealed, diagnosed, wrong = {}, {}, []
    for line in read_log(log):
        case = line["case"]
        if line["kind"] == "sealed":
            sealed[case], diagnosed[case] = line["answer_sha256"], False  # a seal after the report does not count
        elif line["kind"] == "diagnosed":
            diagnosed[case] = case in sealed
        elif line["kind"] == "opened":
            if not diagnosed.get(case):
                wrong.append(f"{case}: no seal is logged before its report")
            elif answer_hash(line["answer"], line["nonce"]) != sealed[case]:
                wrong.append(f"{case}: the answer is not the one that was sealed")
    return wrong
