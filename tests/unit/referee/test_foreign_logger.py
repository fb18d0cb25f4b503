"""The referee's recordings as the loggers of other people write them, and how small errors of the file are scored."""

import numpy as np
import pytest
from referee_story import finding, hanging, report

from swift_sim_bridge.referee import cases, concealment, scoring
from swift_sim_bridge.referee.simulator.flight import LOOP_S
from swift_sim_bridge.referee.simulator.foreign_logger import RESOLUTION, Logger, record
from swift_sim_bridge.referee.simulator.instruments import LEAD_S
from swift_sim_bridge.referee.simulator.vehicles import draw_vehicle

TRUTH = hanging(3000)


def logged(logger: Logger):
    content = draw_vehicle(np.random.default_rng(1), "racer")
    return record(TRUTH, content, np.random.default_rng(2), logger, (), "flight")


@pytest.mark.parametrize("divisor", [2, 3, 4, 10])
def test_a_row_has_the_command_at_its_time_the_mean_since_the_last_row_or_an_older_one(divisor):
    dense = TRUTH.u[round(LEAD_S / LOOP_S) :]
    passes = np.arange(divisor, len(dense), divisor)
    for commands, expected in (
        ("held", dense[passes]),
        ("mean", np.mean([dense[passes - back] for back in range(divisor)], axis=0)),
        ("late", dense[passes - round(0.5 * divisor)]),
    ):
        table = logged(Logger(divisor, commands, late=0.5 if commands == "late" else 0.0))
        np.testing.assert_allclose(table["motor_command"].t, passes * LOOP_S, atol=1e-9)
        np.testing.assert_allclose(table["motor_command"].values, expected)
        assert np.array_equal(table["gyro_body"].t, table["motor_command"].t)


def test_lost_rows_jitter_and_coarse_numbers_are_as_large_as_the_answer_says():
    logger = Logger(2, jitter=0.05, lost=0.03, coarse=True)
    t = logged(logger)["motor_command"].t
    row_s = 2.0 * LOOP_S
    steps = np.round(np.diff(t) / row_s)
    assert 0.01 < (steps - 1.0).sum() / len(steps) < 0.06 and steps.max() < 5
    assert np.std(t - row_s * np.round(t / row_s)) == pytest.approx(0.05 * row_s, rel=0.15)
    gyro = logged(logger)["gyro_body"].values / RESOLUTION["gyro_body"]
    np.testing.assert_allclose(gyro, np.round(gyro), atol=1e-6)


def test_a_small_error_of_the_file_may_be_named_or_not_and_anything_else_is_an_alarm():
    case = next(case for case in (cases.draw_case("null_foreign", seed) for seed in range(9)) if case.notes["small"])
    assert len(case.notes["small"]) == concealment.SMALL_COUNT and case.vehicle != case.order.content
    small = case.notes["small"][0]
    other = next(name for name in ("wind", "ground_effect") if name not in case.notes["small"])
    for names, alarm in (((), False), ((small,), False), ((small, other), True)):
        record = scoring.score(case.answer, report(*(finding(name) for name in names)))
        assert record["alarm"] == record["confident_wrong"] == alarm
    for first, second, alarm in ((small, other, False), (other, small, False), (other, "propeller_stall", True)):
        one_of_both = finding(first, "ambiguous", alternatives=(second,))
        assert scoring.score(case.answer, report(one_of_both))["alarm"] == alarm


def test_a_small_error_of_the_file_does_not_hide_the_parts_by_which_a_load_is_named():
    case = cases.draw_case("foreign_pose_commands", 330)
    answer = {**case.answer, "small": ["mass", "com_offset", "wind"]}
    assert [one["effect"] for one in answer["hidden"]] == ["payload"]
    record = scoring.score(answer, report(finding("mass"), finding("com_offset"), finding("wind")))
    assert record["named"] == ["com_offset", "mass"] and record["exact"]
    small = {**answer, "small": ["thrust_coefficient"]}
    in_a_set = finding("mass", "ambiguous", alternatives=("thrust_coefficient",))
    record = scoring.score(small, report(finding("com_offset"), in_a_set))
    assert record["sets"] == [["mass", "thrust_coefficient"]] and record["honest"] and not record["exact"]
