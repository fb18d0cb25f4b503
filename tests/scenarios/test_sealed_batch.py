"""The gap tool on a few sealed cases, as `swiftros gap-referee` evaluates it."""

from swift_sim_bridge.referee import plan, runner, seal

COUNTS = {"own": {"null": 2, "single": 2, "pair": 1}}
SEED = 520  # a seed for development; those for tests are from 1000 up


def test_a_sealed_batch_has_no_false_alarm_and_no_wrong_confirmed_effect(tmp_path):
    lines = []
    records = runner.run(plan.make_plan(COUNTS, SEED), tmp_path / "cases", progress=lines.append)
    assert len(records) == 5 and len(lines) == 5 and "nothing" in "".join(lines)
    assert not seal.broken_seals(tmp_path / "cases" / runner.LOG)
    assert all(record["verdict"] not in ("broken", "refused") for record in records)
    assert not any(record["alarm"] for record in records) and not any(record["confident_wrong"] for record in records)
    large = [record for record in records if record["honest"] is not None]
    assert large and all(record["honest"] for record in large)  # by its name, or in a set of confounders
    assert all(record["removed"] > 0.8 for record in large if record.get("removed") is not None)


def test_a_pose_and_motor_commands_alone_show_a_load_and_a_cut_propeller(tmp_path):
    """The load first looks like a wrong motor map, and the pack was not full at the first row."""
    entries = [
        plan.Entry(f"flight-{number:04d}", "own", "pose_commands", seed) for number, seed in ((1, 6017), (2, 6076))
    ]
    records = runner.run(entries, tmp_path / "cases", progress=lambda line: None)
    assert [record["named"] for record in records] == [["payload"], ["damaged_propeller[4]"]]
    assert all(record["exact"] and record["verdict"] == "confirmed" for record in records)
