"""The folder of a batch: cases are scored by the present rules, with the version of the code that evaluated them."""

import argparse
import json
from collections import Counter
from pathlib import Path

import pytest
from referee_story import finding, hanging, report

from swift_ros.errors import UsageError
from swift_sim_bridge.commands import gap_referee
from swift_sim_bridge.referee import cases, plan, runner, scoring, seal
from swift_sim_bridge.referee.records import code_version, read_records
from swift_sim_bridge.referee.simulator.flight import PASSES


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """Record a vehicle at rest for some seconds: sealing and scoring do not need physics."""
    monkeypatch.setattr(runner.flight, "fly", lambda orders: [hanging(PASSES * len(one.path.p)) for one in orders])
    monkeypatch.setattr(cases, "SECONDS", 1.0)


ENTRIES = plan.make_plan({"own": {"null": 2, "poor": 1}}, 40)


def ambiguous_tool(recordings, vehicle, without):
    """Report wind or mass until the manoeuvre is flown, and then nothing."""
    spin = {"id": "yaw_spin", "seconds": 10.0}
    ambiguous = finding("wind", "ambiguous", alternatives=["mass"], manoeuvre=spin)
    return runner.ToolAnswer(report(*[ambiguous] * (len(recordings) == 1)), None)


def run(out, entries=ENTRIES, tool=ambiguous_tool):
    """Return the printed lines of a run, and its records."""
    lines = []
    return lines, runner.run(entries, out, tool, progress=lines.append)


def rewrite(out, change):
    """Change the lines of a log."""
    lines = [change(line) for line in seal.read_log(out / runner.LOG)]
    (out / runner.LOG).write_text("".join(json.dumps(line) + "\n" for line in lines))


def test_an_evaluated_case_is_scored_anew_from_its_reports(tmp_path, monkeypatch):
    _, records = run(tmp_path)
    (poor,) = (record for record in records if record["family"] == "poor")
    assert poor["resolved"] is False and poor["seconds"] >= 0.0
    logged = {"alarm": None, "resolved": True, "seconds": 7.0}
    rewrite(tmp_path, lambda line: line | {"score": line["score"] | logged} if "score" in line else line)
    _, again = run(tmp_path)
    assert again == [record | {"seconds": 7.0} for record in records]  # the computing time is only in the log
    monkeypatch.setattr(runner.records, "score", lambda *_: scoring.score(*_) | {"verdict": "by other rules"})
    assert {record["verdict"] for record in run(tmp_path)[1]} == {"by other rules"}


def test_without_its_reports_a_case_keeps_the_logged_score_and_a_changed_report_is_refused(tmp_path):
    run(tmp_path)
    rewrite(tmp_path, lambda line: line | {"score": line["score"] | {"verdict": "old"}} if "score" in line else line)
    null, *_ = (entry.name for entry in ENTRIES if entry.family == "null")
    (poor,) = (entry.name for entry in ENTRIES if entry.family == "poor")
    (tmp_path / runner.CASES / null / runner.REPORT).unlink()
    (tmp_path / runner.CASES / poor / runner.RESOLVED).unlink()
    old = [name for name, record in read_records(tmp_path).items() if record["verdict"] == "old"]
    assert sorted(old) == sorted([null, poor])
    (tmp_path / runner.CASES / poor / runner.RESOLVED).write_text(json.dumps(report(finding("wind"))))
    with pytest.raises(UsageError, match="resolved.json is not the report whose hash"):
        read_records(tmp_path)


def test_a_seal_that_was_written_after_the_report_does_not_count(tmp_path):
    run(tmp_path, ENTRIES[:1])
    sealed, diagnosed, opened = seal.read_log(tmp_path / runner.LOG)
    late = [
        sealed,
        diagnosed,
        sealed | {"answer_sha256": seal.answer_hash(opened["answer"] | {"seed": 9}, "0" * 32)},
        opened | {"answer": opened["answer"] | {"seed": 9}, "nonce": "0" * 32},
    ]
    (tmp_path / runner.LOG).write_text("".join(json.dumps(line) + "\n" for line in late))
    assert "no seal is logged before its report" in seal.broken_seals(tmp_path / runner.LOG)[0]
    with pytest.raises(UsageError, match="does not hold"):
        run(tmp_path, ENTRIES[:1])


def test_a_continued_run_reports_cases_that_other_code_evaluated(tmp_path):
    lines, records = run(tmp_path)
    assert not any("other code" in line for line in [*lines, *run(tmp_path)[0]])
    assert {record["judged_by"] for record in records} == {code_version()}
    first = ENTRIES[0].name
    rewrite(tmp_path, lambda line: line | {"code": "0123456789ab"} if line["case"] == first else line)
    lines, records = run(tmp_path)
    assert "1 of 3 cases were evaluated by other code (0123456789ab)" in lines
    assert Counter(record["judged_by"] for record in records) == {code_version(): 2, "0123456789ab": 1}


def asked(*options):
    parser = argparse.ArgumentParser()
    gap_referee.command(parser.add_subparsers())
    return parser.parse_args(["gap-referee", *options])


def test_the_cases_of_a_stopped_run_can_be_scored(tmp_path, capsys):
    def interrupted_tool(*arguments):
        if len(read_records(tmp_path)) == 2:
            raise KeyboardInterrupt
        return ambiguous_tool(*arguments)

    with pytest.raises(UsageError, match="plan.json cannot be read: .*; give the --out of a run"):
        gap_referee.run(asked("--score", "--out", str(tmp_path)))
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, tool=interrupted_tool)
    gap_referee.run(asked("--score", "--out", str(tmp_path)))
    assert "2 of 3 cases evaluated" in capsys.readouterr().out
    result = json.loads((tmp_path / gap_referee.RESULT).read_text())
    assert (result["seed"], result["judged_by"], len(result["cases"])) == (40, {code_version(): 2}, 2)


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ((), "small-0"),
        (("--batch", "full", "--seed", "1000"), "full-1000"),
        (("--families", "null", "pair", "--seed", "3"), "null-pair-3"),
    ],
)
def test_each_batch_has_its_own_default_folder(options, name):
    assert gap_referee.default_out(asked(*options)) == Path("runs") / f"gap-referee-{name}"


def test_every_first_part_of_a_plan_has_all_families_in_proportion():
    entries = plan.make_plan(plan.BATCHES["full"], 1000)
    whole = Counter((entry.generator, entry.family) for entry in entries)
    for share in (0.1, 0.25, 0.5):
        part = Counter((entry.generator, entry.family) for entry in entries[: round(share * len(entries))])
        assert all(abs(part[group] - share * count) <= 1.5 for group, count in whole.items())
    assert sorted(entry.name for entry in entries) == [f"flight-{i:04d}" for i in range(1, len(entries) + 1)]
    assert plan.plan_as_json(entries) == plan.plan_as_json(entries[::-1])
