"""Runs sealed cases through the tool: fly, record, seal, diagnose, open, score. It goes on where it stopped."""

import dataclasses
import json
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import yaml

from swift_ros.configuration import load
from swift_ros.errors import UsageError
from swift_ros.recording import flight_files
from swift_ros.recording.flight_table import FlightTable
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.referee import cases, holdout, records, seal
from swift_sim_bridge.referee.plan import Entry, as_json
from swift_sim_bridge.referee.records import CASES, LOG, PLAN, REPORT, RESOLVED
from swift_sim_bridge.referee.scoring import score
from swift_sim_bridge.referee.simulator import flight, manoeuvres, rotorpy_flight
from swift_sim_bridge.referee.simulator.flight import Truth

ANSWERS = "answers"
GROUP = 4  # cases of our own simulator flown at once, each with a flight held out
RECORDING, VEHICLE = "flight.csv", "vehicle.yaml"
MANOEUVRE = "manoeuvre.csv"  # what the report proposed to fly


class Told(NamedTuple):
    """What a tool answers: the dict of its report, and the repaired vehicle file's content, or None."""

    report: dict
    repaired: dict | None


Tool = Callable[[list[FlightTable], Vehicle, tuple[str, ...]], Told]


def gap_tool(recordings: list[FlightTable], vehicle: Vehicle, without: tuple[str, ...]) -> Told:
    """Return what `swiftros gap` says, with effects taken out of its library; the referee's own flights prove it."""
    from swift_sim_bridge.gap.api import diagnose

    diagnosis = diagnose(recordings, vehicle, progress=lambda *_: None, knocked_out=without, validate=False)
    return Told(diagnosis.report, dataclasses.asdict(diagnosis.vehicle))


@dataclass(frozen=True)
class Flown:
    """A case that was flown: its entry of the plan, the case, what was recorded; held_out() returns the truth of the
    held-out flight, which RotorPy flies only where somebody asks."""

    entry: Entry
    case: cases.Case
    table: FlightTable
    held_out: Callable[[], Truth]


def run(entries: Sequence[Entry], out: Path, tool: Tool = gap_tool, keep: bool = False, tell=print) -> list[dict]:
    """Judge all entries that `out` has no score of yet; return the records of all, by today's rules (see `judged`).
    keep: recordings too.

    Raises UsageError when `out` holds something else.
    """
    _open_folder(entries, out)
    done = records.records(out)
    rest = [entry for entry in entries if entry.name not in done]
    if done:
        tell(f"{len(done)} of {len(entries)} cases were judged before")
        others = [record["judged_by"] for record in done.values() if record["judged_by"] != records.code()]
        if others:
            tell(f"{len(others)} of {len(done)} cases were judged by other code ({', '.join(sorted(set(others)))})")
    begun = time.monotonic()
    for number, flown in enumerate(_flown(rest), start=1):
        done[flown.entry.name] = _judge(flown, out, tool, keep)
        tell(f"{len(done)} of {len(entries)}: {_line(done[flown.entry.name])}{_left(begun, number, len(rest))}")
    done = records.records(out)
    return [done[entry.name] for entry in entries]


def _open_folder(entries: Sequence[Entry], out: Path) -> None:
    if (out / PLAN).exists():
        if as_json(records.plan(out)) != as_json(entries):
            raise UsageError(f"{out} holds another batch of cases; give another --out, or the same options to go on")
        return
    if out.is_dir() and any(out.iterdir()):
        raise UsageError(f"{out} holds other things; give another --out")
    try:
        (out / ANSWERS).mkdir(parents=True)
        (out / CASES).mkdir()
        (out / PLAN).write_text(json.dumps(as_json(entries), indent=1) + "\n")
    except OSError as error:
        raise UsageError(f"{out} cannot be written: {error.strerror}") from error


def _flown(entries: Sequence[Entry]) -> Iterator[Flown]:
    """Yield the flights of all entries in order; those of our own simulator are flown several at once."""
    ahead: dict[str, Flown] = {}
    own = [entry for entry in entries if entry.generator == "own"]
    for entry in entries:
        if entry.generator == "rotorpy":
            yield _by_rotorpy(entry)
            continue
        if entry.name not in ahead:
            begin = own.index(entry)
            ahead = {flown.entry.name: flown for flown in _by_own(own[begin : begin + GROUP])}
        yield ahead.pop(entry.name)


def _by_own(entries: Sequence[Entry]) -> list[Flown]:
    drawn = [cases.draw(entry.family, entry.seed, entry.effect, entry.multiple) for entry in entries]
    orders = [order for case in drawn for order in (case.order, case.held_out)]
    padded = orders + orders[-1:] * (2 * GROUP - len(orders))  # one shape is compiled once
    truths = flight.fly(padded)
    return [
        Flown(entry, case, case.record(truths[2 * i], entry.name), partial(truths.__getitem__, 2 * i + 1))
        for i, (entry, case) in enumerate(zip(entries, drawn, strict=True))
    ]


def _by_rotorpy(entry: Entry) -> Flown:
    case = cases.draw(entry.family, entry.seed, entry.effect, entry.multiple, plain_pack=True)
    truth = rotorpy_flight.fly(case.order)
    return Flown(entry, case, case.record(truth, entry.name), partial(rotorpy_flight.fly, case.held_out))


def _judge(flown: Flown, out: Path, tool: Tool, keep: bool) -> dict:
    """Seal the answer, let the tool work from files, open the answer and return the score."""
    name, log, folder = flown.entry.name, out / LOG, out / CASES / flown.entry.name
    folder.mkdir(exist_ok=True)
    recording, vehicle = folder / RECORDING, folder / VEHICLE
    flight_files.write(flown.table, recording)
    vehicle.write_text(yaml.safe_dump(flown.case.vehicle, sort_keys=False))
    nonce, answer = seal.fresh_nonce(), json.loads(json.dumps(flown.case.answer | {"case": name}))
    (out / ANSWERS / f"{name}.json").write_text(json.dumps({"answer": answer, "nonce": nonce}, indent=1) + "\n")
    files = {"recording_sha256": recording, "vehicle_sha256": vehicle}
    hashes = {key: seal.sha256(path.read_bytes()) for key, path in files.items()}
    seal.append(log, "sealed", name, answer_sha256=seal.hash_of(answer, nonce), code=records.code(), **hashes)

    told, seconds = _diagnosed(tool, flown, [recording], folder / REPORT, log)
    again = _followed(tool, flown, told.report, folder, log)

    opened = json.loads((out / ANSWERS / f"{name}.json").read_text())
    result = score(opened["answer"], told.report, again, records.followed(flown.entry.family, flown.entry.generator))
    result |= {"generator": flown.entry.generator, "seconds": seconds}
    if result["exact"] and told.repaired:
        result["removed"] = holdout.removed(
            flown.held_out(), flown.case.vehicle, told.repaired, flown.case.order.content
        )
    seal.append(log, "opened", name, answer=opened["answer"], nonce=opened["nonce"], score=result)
    if not keep:
        for table in (recording, folder / MANOEUVRE):
            table.unlink(missing_ok=True)
    return result


def _diagnosed(tool: Tool, flown: Flown, recordings: Sequence[Path], report: Path, log: Path) -> tuple[Told, float]:
    """Return what the tool says of recordings, and after how many seconds; write its report and publish the hash."""
    begun = time.monotonic()
    told = _told(tool, recordings, report.with_name(VEHICLE), flown.case.removed)
    seconds = time.monotonic() - begun
    text = json.dumps(told.report, indent=1) + "\n"
    report.write_text(text)
    seal.append(log, "diagnosed", flown.entry.name, report_sha256=seal.sha256(text), seconds=round(seconds, 2))
    return told, seconds


def _followed(tool: Tool, flown: Flown, report: dict, folder: Path, log: Path) -> dict | None:
    """Return what the tool reports once the same vehicle has flown what it proposed to tell look-alikes apart; None
    where it proposed nothing, or where nobody asks."""
    proposed = manoeuvres.proposed(report)
    if proposed is None or not records.followed(flown.entry.family, flown.entry.generator):
        return None
    truth = flight.fly([dataclasses.replace(flown.case.held_out, path=manoeuvres.path(*proposed))])[0]
    recording, name = folder / MANOEUVRE, flown.entry.name
    flight_files.write(flown.case.record(truth, name, number=2), recording)
    seal.append(
        log,
        "flown",
        name,
        manoeuvre=proposed[0],
        seconds=proposed[1],
        recording_sha256=seal.sha256(recording.read_bytes()),
    )
    return _diagnosed(tool, flown, [folder / RECORDING, recording], folder / RESOLVED, log)[0].report


def _told(tool: Tool, recordings: Sequence[Path], vehicle: Path, without: tuple[str, ...]) -> Told:
    """Return what the tool says; that it refuses, or breaks, is an answer as well."""
    try:
        return tool([flight_files.read(path) for path in recordings], load(Vehicle, vehicle), without)
    except UsageError as error:
        return Told({"verdict": "refused", "findings": [], "error": str(error)}, None)
    except Exception:  # a tool that breaks must be judged, not end the run
        return Told({"verdict": "broken", "findings": [], "error": traceback.format_exc()}, None)


def _line(record: dict) -> str:
    truth = " + ".join(record["truth"]) or "nothing"
    size = f" at {record['multiple']:.3g} x" if record["multiple"] else ""
    sets = "".join(f" or {{{', '.join(one)}}}" for one in record["sets"])
    said = (" + ".join(record["named"]) or "no name") + sets
    then = {True: "; its manoeuvre decided", False: "; its manoeuvre did not decide"}.get(record.get("resolved"), "")
    return f"{record['generator']} {record['family']}, hidden {truth}{size}; said {record['verdict']}: {said}{then}"


def _left(begun: float, number: int, total: int) -> str:
    left = (time.monotonic() - begun) / number * (total - number)
    return f" (about {left / 60:.0f} min left)" if left > 90 else f" (about {left:.0f} s left)" if left else ""
