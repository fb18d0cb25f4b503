"""Cases are sealed before the tool runs and opened after it; an interrupted run continues; the score is right."""

import argparse
import json
import sys
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from referee_story import equation, finding, hanging, report

from swift_ros.errors import UsageError
from swift_sim_bridge.commands import gap_referee
from swift_sim_bridge.referee import cases, families, picture, plan, runner, scoring, seal, summary, tables
from swift_sim_bridge.referee.effects.catalogue import EFFECTS
from swift_sim_bridge.referee.effects.changes import CHANGES, CHANGES_OF_ROTORPY, FACTORS, FAR
from swift_sim_bridge.referee.effects.laws import RELATED
from swift_sim_bridge.referee.effects.planting import conceal, value_at
from swift_sim_bridge.referee.simulator import manoeuvres
from swift_sim_bridge.referee.simulator.flight import PASSES
from swift_sim_bridge.referee.simulator.rotorpy_flight import EFFECTS_OF_ROTORPY, package, parameters_of


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """Record a vehicle at rest for some seconds: sealing and scoring do not need physics."""
    monkeypatch.setattr(runner.flight, "fly", lambda orders: [hanging(PASSES * len(one.path.p)) for one in orders])
    monkeypatch.setattr(runner.holdout, "removed_share", lambda *_: 1.0)
    monkeypatch.setattr(cases, "SECONDS", 1.0)


def perfect_tool(entries):
    """Return a tool that knows the plan, and with it all answers."""
    remaining = iter(entries)

    def tool(recordings, vehicle, without):
        entry = next(remaining)
        assert recordings[0].name == "flight.csv" and "null" not in vehicle.name
        case = cases.draw_case(entry.family, entry.seed, entry.effect, entry.multiple)
        if case.removed:
            assert case.removed == ("gyro_bias",)
            return runner.ToolAnswer(report(equation(*(f"gyro_{axis}: 1" for axis in "xyz"), layer="imu")), None)
        return runner.ToolAnswer(
            report(
                *(
                    finding(
                        one.effect,
                        layer=EFFECTS[one.effect].layer,
                        parameters={
                            scoring.parameter_name(path): {"value": value, "interval95": [value - 1, value + 1]}
                            for path, value in one.parameters.items()
                        },
                    )
                    for one in case.hidden
                )
            ),
            {},
        )

    return tool


def constant_tool(recordings, vehicle, without):
    """Always report the mass."""
    return runner.ToolAnswer(
        report(finding("mass", parameters={"mass": {"value": 1.0, "interval95": [0.99, 1.01]}})), None
    )


FAULTS = (
    "false alarms on null cases",
    "confident and wrong",
    "any wrong name",
    "unknown on null cases and correct answers",
)


def few():
    entries = plan.make_plan({"own": {"null": 3, "single": 4, "pair": 2, "knockout": 1}}, 64)
    return [replace(one, effect="gyro_bias", multiple=4.0) if one.family == "knockout" else one for one in entries]


def rates(records):
    return {rate["name"]: (rate["hits"], rate["count"]) for rate in summary.summarise(records, "own")["rates"]}


def test_a_perfect_tool_reaches_every_target_and_a_tool_that_always_reports_the_mass_does_not(tmp_path):
    entries = few()
    best = runner.run(entries, tmp_path / "best", perfect_tool(entries), progress=lambda *_: None)
    worst = runner.run(entries, tmp_path / "worst", constant_tool, progress=lambda *_: None)
    for name, hits in rates(best).items():
        assert hits[0] == (0 if name in FAULTS else hits[1]), name
    assert rates(best)["pairs exact"] == (2, 2)
    assert rates(best)["knock-out: correct axis and quantity"] == (1, 1)
    assert rates(worst)["knock-out: unknown, correct layer"] == (0, 1)
    assert rates(worst)["false alarms on null cases"] == (3, 3)
    assert rates(worst)["confident and wrong"][0] >= 8
    result = {"score": {"own": summary.summarise(worst, "own")}}
    assert "own: false alarms on null cases" in summary.missed_targets(result)
    assert "not met" in tables.score_table(result)
    picture.draw_detection(best, tmp_path / "curves.png")
    assert (tmp_path / "curves.png").stat().st_size > 1000


def test_the_command_prints_the_missed_targets(tmp_path, monkeypatch, capsys):
    parser = argparse.ArgumentParser()
    gap_referee.command(parser.add_subparsers())
    asked = ["gap-referee", "--families", "null", "--count", "2", "--generator", "own", "--out"]
    run_batch = runner.run
    for tool, status in ((constant_tool, 1), (lambda *_: runner.ToolAnswer(report(), None), 0)):
        monkeypatch.setattr(runner, "run", partial(run_batch, tool=tool, progress=lambda *_: None))
        assert gap_referee.run(parser.parse_args([*asked, str(tmp_path / str(status))])) == status
        assert ("missed targets: own: false alarms on null cases" in capsys.readouterr().out) == bool(status)


def test_the_log_has_the_seal_before_the_report_and_the_answer_after_it(tmp_path):
    entries = few()[:2]
    runner.run(entries, tmp_path, constant_tool, progress=lambda *_: None)
    log = tmp_path / runner.LOG
    assert [(line["case"], line["kind"]) for line in seal.read_log(log)] == [
        (entry.name, kind) for entry in entries for kind in ("sealed", "diagnosed", "opened")
    ]
    assert seal.broken_seals(log) == []
    assert "hidden" not in log.read_text().splitlines()[0]


@pytest.mark.parametrize("lie", ["answer", "nonce"])
def test_an_answer_that_was_changed_after_the_seal_is_detected(tmp_path, lie):
    runner.run(few()[:1], tmp_path, constant_tool, progress=lambda *_: None)
    log = tmp_path / runner.LOG
    lines = seal.read_log(log)
    if lie == "answer":
        lines[-1]["answer"]["seed"] += 1
    else:
        lines[-1]["nonce"] = "0" * 32
    log.write_text("".join(json.dumps(line) + "\n" for line in lines))
    assert "not the one that was sealed" in seal.broken_seals(log)[0]


def test_an_interrupted_run_continues_and_evaluates_no_case_twice(tmp_path):
    entries, diagnosed = few(), []

    def interrupted_tool(recordings, vehicle, without):
        diagnosed.append(vehicle.name)
        if len(diagnosed) == 3:
            raise KeyboardInterrupt
        return constant_tool(recordings, vehicle, without)

    with pytest.raises(KeyboardInterrupt):
        runner.run(entries, tmp_path, interrupted_tool, progress=lambda *_: None)
    with open(tmp_path / runner.LOG, "a") as log:
        log.write('{"kind": "sealed", "ca')  # and the disk was full
    records = runner.run(entries, tmp_path, interrupted_tool, progress=lambda *_: None)
    assert len(records) == len(entries)
    assert len(diagnosed) == len(entries) + 1
    assert seal.broken_seals(tmp_path / runner.LOG) == []
    with pytest.raises(UsageError, match="another batch"):
        runner.run(entries[:-1], tmp_path, interrupted_tool)


def test_a_tool_that_raises_is_scored_and_does_not_end_the_run(tmp_path):
    def bad(recordings, vehicle, without):
        raise ValueError("matrix is singular")

    records = runner.run(few()[:2], tmp_path, bad, progress=lambda *_: None)
    assert [record["verdict"] for record in records] == ["broken", "broken"]
    assert rates(records)["answered"] == (0, 2)
    case = few()[0].name
    assert "singular" in json.loads((tmp_path / runner.CASES / case / runner.REPORT).read_text())["error"]


def ambiguous_tool(truth, manoeuvre, second):
    """Return a tool that cannot distinguish the true effect from wind, until it has two recordings."""

    def tool(recordings, vehicle, without):
        if len(recordings) == 2:
            assert [one.name for one in recordings] == [runner.RECORDING, runner.MANOEUVRE]
            return runner.ToolAnswer(report(second), None)
        return runner.ToolAnswer(report(finding(truth, "ambiguous", alternatives=["wind"], manoeuvre=manoeuvre)), None)

    return tool


SPIN = {"id": "yaw_spin", "seconds": 10.0}


def test_a_proposed_manoeuvre_is_flown_by_the_same_vehicle_and_must_resolve_the_ambiguity(tmp_path):
    entries = plan.make_plan({"own": {"poor": 1}}, 40)
    (truth,) = (one.effect for one in cases.draw_case("poor", 40).hidden)
    still_ambiguous = finding(truth, "ambiguous", alternatives=["wind"])
    for second, resolved in ((finding(truth), True), (finding("wind"), False), (still_ambiguous, False)):
        out = tmp_path / str(len(list(tmp_path.iterdir())))
        (record,) = runner.run(entries, out, ambiguous_tool(truth, SPIN, second), keep=True, progress=lambda *_: None)
        assert (record["says_ambiguous"], record["proposes"], record["resolved"]) == (True, True, resolved)
        assert rates([record])["ambiguous: resolved by the manoeuvre"] == (int(resolved), 1)
        log = {line["kind"]: line for line in seal.read_log(out / runner.LOG)}
        assert list(log) == ["sealed", "diagnosed", "flown", "opened"]
        flown = (out / runner.CASES / entries[0].name / runner.MANOEUVRE).read_bytes()
        assert log["flown"]["recording_sha256"] == seal.sha256(flown)
    assert (log["flown"]["manoeuvre"], log["flown"]["seconds"]) == ("yaw_spin", 10.0)


def test_a_finding_without_a_manoeuvre_is_no_proposal(tmp_path):
    entries = plan.make_plan({"own": {"poor": 1}}, 40)
    (truth,) = (one.effect for one in cases.draw_case("poor", 40).hidden)
    (record,) = runner.run(entries, tmp_path, ambiguous_tool(truth, None, finding(truth)), progress=lambda *_: None)
    assert (record["says_ambiguous"], record["proposes"], record["resolved"]) == (True, False, False)
    assert manoeuvres.proposed_manoeuvre(report()) is None


def test_a_case_is_determined_by_its_family_and_seed():
    first, again, other = (cases.draw_case("pair", seed) for seed in (7, 7, 8))
    assert first.answer == again.answer and first.vehicle == again.vehicle
    assert first.answer != other.answer
    np.testing.assert_array_equal(first.order.path.p, again.order.path.p)


def test_seeds_for_reviews_are_refused_without_the_option():
    with pytest.raises(UsageError, match="kept for reviews"):
        plan.make_plan({"own": {"null": 1}}, 10_000)
    assert plan.make_plan({"own": {"null": 1}}, 10_000, review=True)
    for family, hint in (("gusty", "give --generator own"), ("windy", "known are null, null_sheet")):
        with pytest.raises(UsageError, match=f"unknown to rotorpy; {hint}"):
            plan.make_plan({"rotorpy": {family: 1}}, 0)


@pytest.mark.parametrize(("first", "begin"), [(995, 1000), (9995, 10_000)])
def test_seeds_of_two_purposes_are_refused(first, begin):
    with pytest.raises(UsageError, match=f"from {begin} up they serve another purpose"):
        plan.make_plan({"own": {"null": 3, "single": 6}}, first, review=True)
    assert len(plan.make_plan({"own": {"null": 3, "single": 5}}, first, review=True)) == 8


def test_results_cannot_go_into_a_file(tmp_path):
    (tmp_path / "notes").write_text("keep")
    with pytest.raises(UsageError, match="notes cannot be written: "):
        runner.run(few(), tmp_path / "notes", constant_tool, progress=lambda *_: None)
    assert (tmp_path / "notes").read_text() == "keep"


def test_a_batch_without_a_case_is_refused():
    for counts in ({"rotorpy": plan.BATCHES["small"]["rotorpy"]}, {"rotorpy": {"null": 0}}):
        with pytest.raises(UsageError, match="no case of rotorpy"):
            plan.make_plan(counts, 0)


def test_the_full_plan_has_every_effect_at_every_size_and_enough_null_cases():
    entries = plan.make_plan(plan.BATCHES["full"], 1000)
    own = [entry for entry in entries if entry.generator == "own"]
    assert sum(entry.family.startswith("null") for entry in own) >= 200
    assert sum(entry.family.startswith("null") for entry in entries) - 200 >= 60
    singles = {(entry.effect, entry.multiple) for entry in own if entry.family == "single"}
    assert singles == {(name, multiple) for name in EFFECTS for multiple in families.MULTIPLES}
    assert len({entry.effect for entry in plan.make_plan({"own": {"single": 20}}, 0)}) == 20


@pytest.mark.parametrize("name", EFFECTS)
def test_a_hidden_effect_is_in_the_true_file_and_not_in_the_file_that_the_tool_gets(name):
    case = cases.draw_case("single", 3, name, 4.0)
    (hidden,) = case.hidden
    assert hidden.effect == name and 3.9 < hidden.multiple < 4.1
    assert case.vehicle != case.order.content
    effect = EFFECTS[name]
    values = effect.plant(case.vehicle, effect.detectable, np.random.default_rng(0))
    true = conceal(case.vehicle, values)
    assert all(value_at(true, path) == value for path, value in values.items())
    assert case.vehicle == cases.draw_case("single", 3, name, 4.0).vehicle  # nothing was written into it


@pytest.mark.parametrize("family", families.FAMILIES)
def test_each_family_hides_its_number_of_effects(family):
    counts = {"pair": 2, "triple": 3, "foreign_pair": 2}
    for seed in range(3):
        case = cases.draw_case(family, seed)
        assert len(case.hidden) == (0 if family.startswith("null") else counts.get(family, 1))
        related = family in ("strange", "strange_race") and case.hidden[0].effect in RELATED
        assert bool(case.removed) == (family == "knockout" or related)
        assert (family in ("null_sheet", "sheet")) == (case.order.content["sensors"] != case.vehicle["sensors"])
        assert (family in ("null_pilot", "far")) == (case.order.nominal != case.vehicle)
        assert ("foreign" in family) == (case.logger is not None)


@pytest.mark.parametrize("for_rotorpy", [False, True])
def test_pose_and_commands_alone_are_recorded_of_each_change_that_the_simulator_has(for_rotorpy):
    known = CHANGES_OF_ROTORPY if for_rotorpy else tuple(CHANGES)
    drawn = [cases.draw_case("pose_commands", seed, for_rotorpy=for_rotorpy) for seed in range(len(known))]
    assert {case.notes["change"] for case in drawn} == set(known)
    for case in drawn:
        name, _, (least, most) = CHANGES[case.notes["change"]]
        assert case.hidden[0].effect == name and least <= case.hidden[0].size <= most
        assert set(case.channels) == {"p_world", "q_world_body", "motor_command"}


def test_a_far_file_is_wrong_by_its_factor_and_the_vehicle_that_flies_is_not():
    drawn = [cases.draw_case("far", seed) for seed in range(12)]
    factors = [max(case.notes["factor"], 1.0 / case.notes["factor"]) for case in drawn]
    found = {(case.hidden[0].effect, round(factor)) for case, factor in zip(drawn, factors, strict=True)}
    assert found == {(name, factor) for name in FAR for factor in FACTORS}
    for case in drawn:
        assert case.order.content == case.order.nominal
        for path in FAR[case.hidden[0].effect]:
            ratio = value_at(case.vehicle, path) / value_at(case.order.content, path)
            assert ratio == pytest.approx(case.notes["factor"], rel=1e-4)


def test_a_load_for_rotorpy_changes_mass_inertia_and_the_places_of_the_rotors():
    case = cases.draw_case("pose_commands", 0, for_rotorpy=True)
    with_load, without = parameters_of(case.order.content), parameters_of(case.vehicle)
    assert with_load["mass"] == pytest.approx(without["mass"] + case.hidden[0].size)
    assert with_load["rotor_pos"]["r0"][2] > 0.0 and with_load["Ixx"] > without["Ixx"]


def test_cases_for_rotorpy_hide_only_effects_that_rotorpy_simulates():
    for seed in range(8):
        case = cases.draw_case("pair", seed, for_rotorpy=True)
        assert {one.effect for one in case.hidden} <= set(EFFECTS_OF_ROTORPY)
        assert case.vehicle["motor"]["map"]["coefficients"][4] == 0.0


def test_without_rotorpy_the_error_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "rotorpy.vehicles", None)
    with pytest.raises(UsageError, match="pip install rotorpy"):
        package()


def test_a_scale_that_a_file_lacks_is_one_and_its_size_is_the_difference_from_one():
    (hidden,) = cases.draw_case("single", 7, "rate_scale", 1.0).answer["hidden"]
    assert set(hidden["nominal"].values()) == {1.0}
    apart = [abs(value - hidden["nominal"][path]) for path, value in hidden["parameters"].items()]
    assert max(apart) == pytest.approx(hidden["size"])
