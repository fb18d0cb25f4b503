"""Commit and reveal: the hash of an answer is public before the tool runs, the answer itself only afterwards.

The log is a file of JSON lines that only grows: `sealed` (hashes of answer, recording and vehicle file, and of the code
that judges), `diagnosed` (hash of the report), where a manoeuvre was proposed `flown` (which, hash of its recording)
and `diagnosed` again, `opened` (answer, nonce, score). `broken` says which opened answers do not hold; the hash of a
recording is for a reader who kept it.
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
    """Return the one text of a record: JSON with sorted keys."""
    return json.dumps(record, sort_keys=True, separators=(",", ":"))


def fresh_nonce() -> str:
    """Return 128 random bits, by which an answer cannot be found by trying."""
    return secrets.token_hex(16)


def hash_of(answer: dict, nonce: str) -> str:
    """Return what is published of an answer before it is opened."""
    return sha256(canonical(answer) + nonce)


def append(log: Path, kind: str, case: str, **more) -> None:
    """Add a line to the log."""
    line = {"kind": kind, "case": case, "at": datetime.now(timezone.utc).isoformat(timespec="milliseconds")} | more
    text = json.dumps(line) + "\n"
    if log.exists() and log.read_bytes()[-1:] not in (b"", b"\n"):
        text = "\n" + text  # an interruption cut the last line short
    with open(log, "a") as stream:
        stream.write(text)


def lines(log: Path) -> list[dict]:
    """Return the log's lines; one that an interruption cut short is left out."""
    if not log.exists():
        return []
    found = []
    for text in log.read_text().splitlines():
        try:
            found.append(json.loads(text))
        except json.JSONDecodeError:
            continue
    return found


def broken(log: Path) -> list[str]:
    """Return a sentence for each case whose opened answer is not the one that was sealed before its report."""
    sealed, diagnosed, wrong = {}, {}, []
    for line in lines(log):
        case = line["case"]
        if line["kind"] == "sealed":
            sealed[case], diagnosed[case] = line["answer_sha256"], False  # a seal after the report seals nothing
        elif line["kind"] == "diagnosed":
            diagnosed[case] = case in sealed
        elif line["kind"] == "opened":
            if not diagnosed.get(case):
                wrong.append(f"{case}: no seal stands before its report")
            elif hash_of(line["answer"], line["nonce"]) != sealed[case]:
                wrong.append(f"{case}: the answer is not the one that was sealed")
    return wrong
