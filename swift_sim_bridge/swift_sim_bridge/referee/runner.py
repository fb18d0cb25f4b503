"""Runs sealed cases through the tool: fly, record, seal, diagnose, open, score. An interrupted run can be continued."""

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

from swift_ros.configuration import load_unchecked
from swift_ros.errors import UsageError
from swift_ros.recording import flight_files
from swift_ros.recording.flight_table import FlightTable
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.referee import cases, families, holdout, race, records, seal
from swift_sim_bridge.referee.plan import Entry, plan_as_json
from swift_sim_bridge.referee.records import CASES, LOG, PLAN, REPORT, RESOLVED
from swift_sim_bridge.referee.scoring import score
from swift_sim_bridge.referee.simulator import flight, manoeuvres, rotorpy_flight
from swift_sim_bridge.referee.simulator.flight import Truth

ANSWERS = "answers"
GROUP = 4  # cases of our own simulator that are flown in one call, each with a held-out flight
RECORDING, VEHICLE = "flight.csv", "vehicle.yaml"
MANOEUVRE = "manoeuvre.csv"  # recording of the proposed manoeuvre
RACED = ("file", "repaired", "concealed")  # worlds in which a race is flown: of the file, its repair, and the true one


class ToolAnswer(NamedTuple):
    """The answer of a tool.

    Attributes:
        report: content of its report.json.
        repaired: content of the repaired vehicle file, or None.
    """

    report: dict
    repaired: dict | None


Tool = Callable[
    [list[FlightTable], Vehicle, tuple[str, ...]], ToolAnswer
]  # of recordings, vehicle, knocked-out effects


def gap_tool(recordings: list[FlightTable], vehicle: Vehicle, knocked_out: tuple[str, ...]) -> ToolAnswer:
    """Return the answer of `swiftros gap`, without hold-out validation: the referee has held-out flights of its own."""
    from swift_sim_bridge.gap.api import diagnose  # here alone: no other code of the referee imports the tool

    diagnosis = diagnose(recordings, vehicle, progress=lambda *_: None, knocked_out=knocked_out, validate=False)
    return ToolAnswer(diagnosis.report, dataclasses.asdict(diagnosis.vehicle))


@dataclass(frozen=True)
class FlownCase:
    """A case that was flown.

    Attributes:
        entry: its entry of the plan.
        case: the case.
        table: its recording.
        truth: truth of this flight.
        held_out: held_out() returns the truth of the held-out flight; RotorPy flies it only on demand.
    """

    entry: Entry
    case: cases.Case
    table: FlightTable
    truth: Truth
    held_out: Callable[[], Truth]


def run(entries: Sequence[Entry], out: Path, tool: Tool = gap_tool, keep: bool = False, progress=print) -> list[dict]:
    """Evaluate all entries of which a folder has no record yet.

    Args:
        entries: the plan.
        out: folder of the batch.
        tool: the tool to evaluate.
        keep: whether to keep the recordings.
        progress: called with one line of text for each case.

    Returns:
        The records of all entries (see `records.read_records`).

    Raises:
        UsageError: the folder holds something else.
    """
    _open_folder(entries, out)
    done = records.read_records(out)
    remaining = [entry for entry in entries if entry.name not in done]
    if done:
        progress(f"{len(done)} of {len(entries)} cases were evaluated before")
        others = [record["judged_by"] for record in done.values() if record["judged_by"] != records.code_version()]
        if others:
            versions = ", ".join(sorted(set(others)))
            progress(f"{len(others)} of {len(done)} cases were evaluated by other code ({versions})")
    begin = time.monotonic()
    for number, flown in enumerate(_fly(remaining), start=1):
        done[flown.entry.name] = _evaluate(flown, out, tool, keep)
        left = _time_left(begin, number, len(remaining))
        progress(f"{len(done)} of {len(entries)}: {_line(done[flown.entry.name])}{left}")
    done = records.read_records(out)
    return [done[entry.name] for entry in entries]


def _open_folder(entries: Sequence[Entry], out: Path) -> None:
    """Make the folder of a batch, or check that it holds the same batch."""
    if (out / PLAN).exists():
        if plan_as_json(records.read_plan(out)) != plan_as_json(entries):
            raise UsageError(f"{out} holds another batch of cases; give another --out, or the same options to go on")
        return
    if out.is_dir() and any(out.iterdir()):
        raise UsageError(f"{out} holds other things; give another --out")
    try:
        (out / ANSWERS).mkdir(parents=True)
        (out / CASES).mkdir()
        (out / PLAN).write_text(json.dumps(plan_as_json(entries), indent=1) + "\n")
    except OSError as error:
        raise UsageError(f"{out} cannot be written: {error.strerror}") from error


def _fly(entries: Sequence[Entry]) -> Iterator[FlownCase]:
    """Yield the flown cases in order; those of our own simulator are flown in groups."""
    ahead: dict[str, FlownCase] = {}
    own = [entry for entry in entries if entry.generator == "own"]
    for entry in entries:
        if entry.generator == "rotorpy":
            yield _fly_rotorpy(entry)
            continue
        if entry.name not in ahead:
            begin = own.index(entry)
            ahead = {flown.entry.name: flown for flown in _fly_own(own[begin : begin + GROUP])}
        yield ahead.pop(entry.name)


def _fly_own(entries: Sequence[Entry]) -> list[FlownCase]:
    """Fly cases with the referee's own simulator, each with its held-out flight."""
    drawn = [cases.draw_case(entry.family, entry.seed, entry.effect, entry.multiple) for entry in entries]
    orders = [order for case in drawn for order in (case.order, case.held_out)]
    padded = orders + orders[-1:] * (2 * GROUP - len(orders))  # always one shape, which is compiled once
    truths = flight.fly(padded)
    return [
        FlownCase(entry, case, case.record(truth, entry.name), truth, partial(truths.__getitem__, 2 * i + 1))
        for i, (entry, case, truth) in enumerate(zip(entries, drawn, truths[::2], strict=False))
    ]


def _fly_rotorpy(entry: Entry) -> FlownCase:
    """Fly a case with RotorPy."""
    case = cases.draw_case(entry.family, entry.seed, entry.effect, entry.multiple, for_rotorpy=True)
    truth = rotorpy_flight.fly(case.order)
    return FlownCase(entry, case, case.record(truth, entry.name), truth, partial(rotorpy_flight.fly, case.held_out))


def _evaluate(flown: FlownCase, out: Path, tool: Tool, keep: bool) -> dict:
    """Seal the answer of a case, let the tool diagnose its files, open the answer and return the record."""
    name, log, folder = flown.entry.name, out / LOG, out / CASES / flown.entry.name
    folder.mkdir(exist_ok=True)
    recording, vehicle = folder / RECORDING, folder / VEHICLE
    flight_files.write(flown.table, recording)
    vehicle.write_text(yaml.safe_dump(flown.case.vehicle, sort_keys=False))
    nonce, answer = seal.fresh_nonce(), json.loads(json.dumps(flown.case.answer | {"case": name}))
    (out / ANSWERS / f"{name}.json").write_text(json.dumps({"answer": answer, "nonce": nonce}, indent=1) + "\n")
    files = {"recording_sha256": recording, "vehicle_sha256": vehicle}
    hashes = {key: seal.sha256(path.read_bytes()) for key, path in files.items()}
    seal.append(
        log, "sealed", name, answer_sha256=seal.answer_hash(answer, nonce), code=records.code_version(), **hashes
    )

    found, seconds = _diagnose(tool, flown, [recording], folder / REPORT, log)
    second_report = _fly_manoeuvre(tool, flown, found.report, folder, log)

    opened = json.loads((out / ANSWERS / f"{name}.json").read_text())
    manoeuvre_flown = records.manoeuvre_is_flown(flown.entry.family, flown.entry.generator)
    result = score(opened["answer"], found.report, second_report, manoeuvre_flown)
    result |= {"generator": flown.entry.generator, "seconds": seconds}
    if (result["exact"] or flown.entry.family in families.STRANGE_FAMILIES) and found.repaired:
        true_content = flown.case.order.content
        result["removed"] = holdout.removed_share(flown.held_out(), flown.case.vehicle, found.repaired, true_content)
    if flown.entry.family in families.STRANGE_FAMILIES:
        result["acts_sigma"] = holdout.significance(flown.truth, flown.case.vehicle, flown.case.order.content)
    if flown.entry.family == "strange_race":
        worlds = flown.case.vehicle, found.repaired or flown.case.vehicle, flown.case.order.content
        result["race_s"] = dict(zip(RACED, race.race_times(worlds, flown.case.vehicle), strict=True))
    seal.append(log, "opened", name, answer=opened["answer"], nonce=opened["nonce"], score=result)
    if not keep:
        for table in (recording, folder / MANOEUVRE):
            table.unlink(missing_ok=True)
    return result


def _diagnose(
    tool: Tool, flown: FlownCase, recordings: Sequence[Path], report: Path, log: Path
) -> tuple[ToolAnswer, float]:
    """Return the tool's answer and its computing time (s); write its report and log the hash."""
    begin = time.monotonic()
    found = _ask(tool, recordings, report.with_name(VEHICLE), flown.case.removed)
    seconds = time.monotonic() - begin
    text = json.dumps(found.report, indent=1) + "\n"
    report.write_text(text)
    seal.append(log, "diagnosed", flown.entry.name, report_sha256=seal.sha256(text), seconds=round(seconds, 2))
    return found, seconds


def _fly_manoeuvre(tool: Tool, flown: FlownCase, report: dict, folder: Path, log: Path) -> dict | None:
    """Return the report after the same vehicle has flown the proposed manoeuvre as a second recording.

    None if the report proposes nothing, or if manoeuvres of this family are not flown.
    """
    proposed = manoeuvres.proposed_manoeuvre(report)
    if proposed is None or not records.manoeuvre_is_flown(flown.entry.family, flown.entry.generator):
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
    return _diagnose(tool, flown, [folder / RECORDING, recording], folder / RESOLVED, log)[0].report


def _ask(tool: Tool, recordings: Sequence[Path], vehicle: Path, knocked_out: tuple[str, ...]) -> ToolAnswer:
    """Return the tool's answer; a refusal and an exception are answers as well."""
    try:
        return tool([flight_files.read(path) for path in recordings], load_unchecked(Vehicle, vehicle), knocked_out)
    except UsageError as error:
        return ToolAnswer({"verdict": "refused", "findings": [], "error": str(error)}, None)
    except Exception:  # an exception of the tool is scored and does not end the run
        return ToolAnswer({"verdict": "broken", "findings": [], "error": traceback.format_exc()}, None)


def _line(record: dict) -> str:
    """Return a record as a line."""
    truth = " + ".join(record["truth"]) or "nothing"
    size = f" at {record['multiple']:.3g} x" if record["multiple"] else ""
    sets = "".join(f" or {{{', '.join(one)}}}" for one in record["sets"])
    named = (" + ".join(record["named"]) or "no name") + sets
    resolved = {True: "; resolved by its manoeuvre", False: "; not resolved by its manoeuvre"}
    after = resolved.get(record.get("resolved"), "")
    case = f"{record['generator']} {record['family']}"
    return f"{case}, hidden {truth}{size}; reported {record['verdict']}: {named}{after}"


def _time_left(begin: float, number: int, total: int) -> str:
    """Return the expected remaining time after `number` of `total` cases, empty after the last."""
    left = (time.monotonic() - begin) / number * (total - number)
    return f" (about {left / 60:.0f} min left)" if left > 90 else f" (about {left:.0f} s left)" if left else ""
