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


def test_a_pose_and_motor_commands_alone_show_a_load_a_cut_propeller_and_a_weak_pack(tmp_path):
    """The load first looks like a wrong motor map, the pack was not full at the first row; the weak pack hovers."""
    seeds = {"flight-0001": 6017, "flight-0002": 6076, "flight-0003": 6463}
    entries = [plan.Entry(name, "own", "pose_commands", seed) for name, seed in seeds.items()]
    *named, weak_pack = runner.run(entries, tmp_path / "cases", progress=lambda line: None)
    assert [record["named"] for record in named] == [["payload"], ["damaged_propeller[4]"]]
    assert all(record["exact"] and record["verdict"] == "confirmed" for record in named)
    (confounders,) = weak_pack["sets"]
    assert {"battery_sag", "thrust_coefficient"} <= set(confounders) and weak_pack["verdict"] == "ambiguous"
