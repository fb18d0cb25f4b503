"""The gap tool on a few sealed cases, as `swiftros gap-referee` judges it: flown, sealed, diagnosed, opened, scored."""

from swift_sim_bridge.referee import plan, runner, seal

COUNTS = {"own": {"null": 2, "single": 2, "pair": 1}}
SEED = 520  # for development; the ones that count are from 1000 up


def test_a_sealed_batch_is_judged_without_a_false_alarm_and_without_a_confident_error(tmp_path):
    told = []
    records = runner.run(plan.plan(COUNTS, SEED), tmp_path / "cases", tell=told.append)
    assert len(records) == 5 and len(told) == 5 and "nothing" in "".join(told)
    assert not seal.broken(tmp_path / "cases" / runner.LOG)
    assert all(record["verdict"] not in ("broken", "refused") for record in records)
    assert not any(record["alarm"] for record in records) and not any(record["confident_wrong"] for record in records)
    large = [record for record in records if record["honest"] is not None]
    assert large and all(record["honest"] for record in large)  # by its name, or by a set of what is alike
    assert all(record["removed"] > 0.8 for record in large if record.get("removed") is not None)
