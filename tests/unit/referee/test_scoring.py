"""The score of a report: each test has an answer, a report, and the expected score."""

import re
from dataclasses import replace

import jax
import numpy as np
import pytest
from referee_story import answer, equation, finding, hanging, report

from swift_ros import configuration
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap.discovery import features
from swift_sim_bridge.gap.recording.recording import read_recording
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel
from swift_sim_bridge.gap.residuals.variants import Variants
from swift_sim_bridge.referee import scoring, summary, tables
from swift_sim_bridge.referee.effects.catalogue import EFFECTS
from swift_sim_bridge.referee.effects.planting import path_text, value_at
from swift_sim_bridge.referee.simulator import instruments, vehicles
from swift_sim_bridge.referee.simulator.flight import LOOP_HZ
from swift_sim_bridge.referee.simulator.plant import GRAVITY


def rates(*records):
    return {rate["name"]: (rate["hits"], rate["count"]) for rate in summary.summarise(records, "own")["rates"]}


def missed(*records):
    return summary.missed_targets({"score": {"own": summary.summarise(records, "own")}})


def test_another_effect_is_wrong_and_a_set_with_the_true_effect_is_honest():
    hidden = answer("rotor_drag")
    wrong = scoring.score(hidden, report(finding("linear_drag")))
    assert (wrong["exact"], wrong["honest"], wrong["confident_wrong"]) == (False, False, True)
    careful = scoring.score(hidden, report(finding("linear_drag", "ambiguous", alternatives=["rotor_drag"])))
    assert (careful["exact"], careful["honest"], careful["confident_wrong"]) == (False, True, False)
    more = scoring.score(hidden, report(finding("rotor_drag"), finding("mass", "tentative")))
    assert (more["exact"], more["honest"], more["confident_wrong"]) == (False, False, False)
    beside = scoring.score(hidden, report(finding("rotor_drag"), finding("wind", "ambiguous", alternatives=["mass"])))
    assert (beside["exact"], beside["honest"]) == (False, False)


def test_an_effect_below_the_minimum_detectable_change_of_the_report_need_not_be_named():
    assert scoring.score(answer("rotor_drag", multiple=1.0), report())["exact"] is None
    blind = report() | {"minimum_detectable": {"rotor_drag": {"c[0]": 1.0}}}
    assert scoring.score(answer("rotor_drag"), blind)["exact"] is None
    sharp = report() | {"minimum_detectable": {"rotor_drag": {"c[0]": 0.1}}}
    assert scoring.score(answer("rotor_drag"), sharp)["exact"] is False


def test_a_payload_may_be_reported_as_mass_and_centre_of_mass():
    assert scoring.same_effects({"mass", "com_offset"}, {"payload"}) and scoring.same_effects({"payload"}, {"payload"})
    assert not scoring.same_effects({"com_offset"}, {"payload"}) and not scoring.same_effects(
        {"mass", "wind"}, {"payload"}
    )


def test_a_parameter_error_is_relative_to_the_change_and_to_the_value():
    numbers = {"c[0]": {"value": 0.9, "interval95": [0.8, 1.1]}, "c[1]": {"value": 0.6, "interval95": [0.55, 0.65]}}
    rows = scoring.score(answer("body_drag"), report(finding("body_drag", parameters=numbers)))["parameters"]
    assert [row["inside"] for row in rows] == [True, False]
    assert rows[1]["error_of_change"] == pytest.approx(0.1) and rows[1]["error_of_value"] == pytest.approx(0.2)


@pytest.mark.parametrize("verdict", ["refused", "broken"])
def test_a_tool_without_an_answer_does_not_count_as_correct(verdict):
    nothing = {"verdict": verdict, "findings": [], "error": "matrix is singular"}
    of_null, of_single = (scoring.score(case, nothing) for case in (answer(family="null"), answer("rotor_drag")))
    assert {of_null[key] for key in ("alarm", "confident_wrong", "wrong_name", "unknown_elsewhere")} == {None}
    assert (of_single["exact"], of_single["layer"], of_single["confident_wrong"]) == (False, False, None)
    assert rates(of_null, of_single)["answered"] == (0, 2)
    assert rates(of_null)["false alarms on null cases"] == (0, 0)
    assert "own: answered" in missed(of_null)
    assert rates(scoring.score(answer(family="null"), report()))["false alarms on null cases"] == (0, 1)


def test_an_unknown_finding_beside_right_names_is_counted():
    beside = scoring.score(answer("rotor_drag"), report(finding("rotor_drag"), equation("specific_force_z: t")))
    alone = scoring.score(answer("rotor_drag"), report(finding("rotor_drag")))
    wrong = scoring.score(answer("rotor_drag"), report(finding("wind"), equation("specific_force_z: t")))
    assert [one["unknown_elsewhere"] for one in (beside, alone, wrong)] == [True, False, None]
    assert [one["exact"] for one in (beside, alone, wrong)] == [False, True, False]
    assert rates(beside, alone, wrong)["unknown on null cases and correct answers"] == (1, 2)


def test_a_tentative_wrong_name_counts_as_a_wrong_name():
    guess = scoring.score(answer("rotor_drag"), report(finding("rotor_drag"), finding("mass", "tentative")))
    assert (guess["confident_wrong"], guess["wrong_name"]) == (False, True)
    assert rates(guess)["any wrong name"] == (1, 1) and "own: any wrong name" not in missed(guess)


def knocked_out(effect, parameters, *terms, layer="force"):
    """Return whether the layer, and whether axis and quantity of an equation for a knocked-out effect are right."""
    parameters = {f"terms.{effect}.{name}": value for name, value in parameters.items()}
    hidden = answer(effect, family="knockout", removed=[effect], parameters=parameters)
    record = scoring.score(hidden, report(equation(*terms, layer=layer)))
    return record["unknown_on_knockout"], record["quantity_on_knockout"]


def test_a_knocked_out_effect_must_become_an_equation_and_not_another_effect():
    hidden = answer("rotor_drag", family="knockout", removed=["rotor_drag"])
    for said, right in ((equation("specific_force_x: Omega v_x"), True), (finding("linear_drag"), False)):
        record = scoring.score(hidden, report(said))
        assert (record["unknown_on_knockout"], record["quantity_on_knockout"]) == (right, right)
    assert knocked_out("rotor_drag", {"k_d": 1e-5}, "specific_force_x: v_x", layer="motor") == (False, False)
    for verdict, right in (("confirmed", False), ("tentative", True)):
        both = report(finding("linear_drag", verdict), equation("specific_force_x: Omega v_x"))
        record = scoring.score(hidden, both)
        assert (record["unknown_on_knockout"], record["quantity_on_knockout"]) == (right, right)


@pytest.mark.parametrize(
    ("term", "right"),
    [
        ("specific_force_x: v_x", True),
        ("specific_force_y: |v| v_y", True),
        ("specific_force_x: Omega v_x", True),
        ("specific_force_x: v_y", False),
        ("specific_force_z: Omega v_z", False),
        ("specific_force_x: 1", False),
        ("specific_force_x: v_x v_z", False),
        ("angular_acceleration_x: v_x", False),
    ],
)
def test_the_right_quantity_of_a_drag_is_the_speed_along_its_axis(term, right):
    assert knocked_out("rotor_drag", {"k_d": 1e-5}, term) == (True, right)
    assert knocked_out("rotor_drag", {"k_d": 1e-5}, "specific_force_y: t", term) == (True, right)


def test_of_a_vector_the_axes_of_its_large_entries_count():
    bias = {"bias[0]": 0.1, "bias[1]": -0.2, "bias[2]": 0.05}
    for axis, right in (("x", True), ("y", True), ("z", False)):
        assert knocked_out("accel_bias", bias, f"specific_force_{axis}: 1", layer="imu") == (True, right)
    centre = {"position[0]": 0.004, "position[1]": 0.001}
    for axis, right in (("y", True), ("x", False)):
        assert knocked_out("com_offset", centre, f"angular_acceleration_{axis}: thrust", layer="moment")[1] == right


def test_the_right_quantity_of_a_damaged_propeller_is_its_thrust():
    damage = {"rotor": 2.0, "loss": 0.05}
    for quantity, right in (("thrust of rotor 2", True), ("thrust", True), ("thrust of rotor 3", False)):
        assert knocked_out("damaged_propeller", damage, f"angular_acceleration_x: {quantity}") == (True, right)


def test_a_knocked_out_effect_with_an_equivalent_need_not_become_an_equation_but_other_names_are_wrong():
    assert knocked_out("mass", {"mass": 1.0}, "specific_force_z: thrust") == (None, None)
    hidden = answer("mass", family="knockout", removed=["mass"])
    for name, wrong in (("thrust_coefficient", False), ("payload", False), ("wind", True)):
        record = scoring.score(hidden, report(finding(name)))
        assert (record["confident_wrong"], record["wrong_name"]) == (wrong, wrong)
        (rate,) = (
            one
            for one in summary.summarise([record], "own")["rates"]
            if "correct layer" in one["name"] and "knock-out" in one["name"]
        )
        assert (rate["count"], rate["not_asked"]) == (0, 1)
    assert scoring.score(answer("mass"), report(finding("thrust_coefficient")))[
        "confident_wrong"
    ]  # it was in the catalogue
    late = answer("motor_time_constant", family="knockout", removed=["motor_time_constant"])
    assert scoring.score(late, report())["unknown_on_knockout"] is False  # a lag has no equivalent


def test_the_table_has_the_number_of_cases_that_are_not_required():
    records = [scoring.score(answer("rotor_drag", multiple=size), report(finding("rotor_drag"))) for size in (4.0, 1.0)]
    table = tables.score_table({"score": {"own": summary.summarise(records, "own")}})
    (row,) = (line for line in table.splitlines() if line.startswith("single effect: exact name  "))
    assert "1/1 = 100.0 % (1 more not required)" in row


def test_exact_names_are_counted_by_whether_they_are_confirmed():
    sure, likely = (
        scoring.score(answer("rotor_drag"), report(finding("rotor_drag", verdict)))
        for verdict in ("confirmed", "tentative")
    )
    assert rates(sure, likely)["of the exact ones confirmed, else tentative"] == (1, 2)


def untestable(*findings):
    return report(*findings) | {"not_testable": {"wind": "fly laps both ways"}}


def test_a_wrong_name_counts_also_if_the_effect_is_not_testable():
    hidden = answer("wind", family="poor")
    reports = {
        "by exact name": report(finding("wind")),
        "not testable": untestable(),
        "by a set": report(finding("mass", "ambiguous", alternatives=["wind"])),
    }
    records = [scoring.score(hidden, one) for one in reports.values()]
    assert [(one["says_ambiguous"], one["reported_as"]) for one in records] == [(True, way) for way in reports]
    for verdict in ("confirmed", "tentative", "ambiguous"):
        wrong = scoring.score(hidden, untestable(finding("mass", verdict, alternatives=["payload"])))
        assert (wrong["says_ambiguous"], wrong["reported_as"]) == (False, None)
    table = tables.score_table({"score": {"own": summary.summarise(records, "own")}})
    assert "  of which 1 by exact name, 1 not testable, 1 by a set" in table


def test_with_missing_channels_a_report_must_name_the_effect_or_list_it_as_not_testable():
    def right(tool_report, multiple=4.0):
        hidden = answer("wind", family="lacking", multiple=multiple) | {"lacking": "no_velocity"}
        return scoring.score(hidden, tool_report)["missing_channel"]

    assert right(report(finding("wind"))) and right(untestable()) and right(untestable(), multiple=1.0)
    assert right(report(), multiple=1.0) is None  # too small to be required
    assert not any(map(right, (report(), report(finding("mass")), untestable(finding("mass", "tentative")))))


def test_another_propeller_is_a_wrong_name():
    numbers = {"terms.damaged_propeller.rotor": 2, "terms.damaged_propeller.loss": 0.05}
    loss = {"loss": {"value": 0.05, "interval95": [0.04, 0.06]}}

    def propeller(number, verdict="confirmed", **more):
        return finding("damaged_propeller", verdict, parameters=loss, **more) | {"variant": str(number)}

    for number, right in ((2, True), (3, False)):
        record = scoring.score(answer("damaged_propeller", parameters=numbers), report(propeller(number)))
        assert (record["exact"], record["honest"], record["confident_wrong"]) == (right, right, not right)
        assert len(record["parameters"]) == right
        assert summary.detection_curves([record], (1.0, 9.0))["force"] == [(1.0, 9.0, int(right), 1)]
    either = propeller(3, "ambiguous")
    for other, honest in ((2, True), (1, False)):
        either["alternatives"] = [{"effect": "damaged_propeller", "variant": str(other), "weight": 0.5}]
        record = scoring.score(answer("damaged_propeller", parameters=numbers), report(either))
        assert (record["exact"], record["honest"]) == (False, honest)


def test_a_parameter_error_is_relative_to_the_largest_change_of_its_vector():
    hidden = answer(
        "payload",
        parameters={"terms.payload.mass": 0.1, "terms.payload.position[0]": 0.02, "terms.payload.position[1]": -0.04},
    )
    found = {"mass": 0.11, "position[0]": 0.03, "position[1]": -0.04}
    numbers = {name: {"value": value, "interval95": [value, value]} for name, value in found.items()}
    rows = scoring.score(hidden, report(finding("payload", parameters=numbers)))["parameters"]
    np.testing.assert_allclose([row["error_of_change"] for row in rows], [0.1, 0.25, 0.0], atol=1e-9)


def test_an_ambiguous_finding_without_a_manoeuvre_is_not_resolved():
    hidden = answer("wind", family="poor")
    vague = report(finding("wind", "ambiguous", alternatives=["mass"]))
    assert scoring.score(hidden, vague, manoeuvre_flown=True)["resolved"] is False
    assert scoring.score(hidden, vague, manoeuvre_flown=False)["resolved"] is None
    assert (
        scoring.score(hidden, report(finding("wind")), manoeuvre_flown=True)["resolved"] is None
    )  # nothing was ambiguous
    assert scoring.score(hidden, vague, second_report=report(finding("wind")), manoeuvre_flown=True)["resolved"] is True


@pytest.fixture(scope="module")
def terms():
    """Return all terms that a report may have, for a recording with all channels."""
    content = vehicles.draw_vehicle(np.random.default_rng(5), "test")
    hover = np.sqrt(content["mass"] * GRAVITY / (4 * content["thrust_coefficient"]))
    truth = hanging(9 * LOOP_HZ)
    table = instruments.record(
        replace(truth, rotor_speed=truth.rotor_speed - 1000.0 + hover), content, np.random.default_rng(0)
    )
    vehicle = configuration.build(Vehicle, content, "test")
    with jax.enable_x64(True):
        residual_model = ResidualModel(read_recording(table, vehicle))
        own = features.build_features(residual_model, Variants((vehicle,), ("",)))
    names = [
        f"{channel.id}: {name}" for channel, one in zip(residual_model.channels, own, strict=True) for name in one.names
    ]
    return [*names, "specific_force_x: north_x within 2.5 m of (1.0, -2.0, 3.1)"]


@pytest.mark.parametrize("name", EFFECTS)
def test_the_expected_terms_of_each_effect_are_terms_of_the_tool(terms, name):
    content, effect = vehicles.draw_vehicle(np.random.default_rng(5), "test"), EFFECTS[name]
    values = effect.plant(content, effect.detectable, np.random.default_rng(1))
    expected = effect.expected_terms(
        {path_text(path): x - value_at(content, path, effect.idle) for path, x in values.items()}
    )
    assert expected and all(any(re.fullmatch(one, term) for term in terms) for one in expected)
    assert sum(any(re.fullmatch(one, term) for one in expected) for term in terms) < 0.06 * len(terms)


def record_with_errors(errors, inside):
    """Return a record with these parameter errors, the first `inside` of them within their intervals."""
    rows = [
        {"ratio": 9.0, "error_of_change": error, "error_of_value": error, "inside": i < inside}
        for i, error in enumerate(errors)
    ]
    return scoring.score(answer("rotor_drag"), report(finding("rotor_drag"))) | {"parameters": rows, "removed": 0.97}


def test_parameter_errors_coverage_and_held_out_flights_have_targets():
    names = missed(record_with_errors([0.02] * 8 + [0.07] * 2, 5))
    assert names == [f"own: {number.name}" for number in summary.NUMBERS.values()]
    good = record_with_errors([0.005] * 10, 10) | {"removed": 0.995}
    assert missed(good) == []  # ten of ten intervals are too few
    assert missed(*[good] * 50) == ["own: 95 % intervals that contain the truth"]  # 500 of 500 intervals are too wide
    table = tables.score_table({"score": {"own": summary.summarise([good] * 50, "own")}})
    (row,) = (line for line in table.splitlines() if line.startswith("95 % intervals"))
    assert "500/500 = 100.0 %" in row and row.endswith("93 to 97 %  not met")
    assert "where names are exact" in table


def test_records_of_older_runs_are_summarised_without_missing_entries():
    record = scoring.score(answer("rotor_drag"), report(finding("rotor_drag")))
    old = {key: value for key, value in record.items() if key not in ("wrong_name", "quantity_on_knockout")}
    assert rates(old) == rates(record) | {"any wrong name": (0, 0)}
    assert "any wrong name" not in tables.score_table({"score": {"own": summary.summarise([old], "own")}})


@pytest.mark.parametrize(("hits", "count", "low", "high"), [(0, 200, 0.0, 0.0188), (190, 200, 0.910, 0.973)])
def test_wilson_s_interval_is_the_tabulated_one(hits, count, low, high):
    np.testing.assert_allclose(summary.wilson_interval(hits, count), (low, high), atol=1e-3)
