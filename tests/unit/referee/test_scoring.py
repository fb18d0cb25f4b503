"""What a report is worth: each story is an answer, a report, and the score."""

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
from swift_sim_bridge.referee import scoring, tables
from swift_sim_bridge.referee.catalogue import EFFECTS, got, written
from swift_sim_bridge.referee.simulator import instruments, vehicles
from swift_sim_bridge.referee.simulator.flight import LOOP_HZ
from swift_sim_bridge.referee.simulator.plant import GRAVITY


def rates(*records):
    return {rate["name"]: (rate["hits"], rate["count"]) for rate in scoring.summary(records, "own")["rates"]}


def missed(*records):
    return scoring.missed({"score": {"own": scoring.summary(records, "own")}})


def test_a_neighbour_s_name_is_wrong_a_set_with_the_truth_is_honest():
    hidden = answer("rotor_drag")
    wrong = scoring.score(hidden, report(finding("linear_drag")))
    assert (wrong["exact"], wrong["honest"], wrong["confident_wrong"]) == (False, False, True)
    careful = scoring.score(hidden, report(finding("linear_drag", "ambiguous", alternatives=["rotor_drag"])))
    assert (careful["exact"], careful["honest"], careful["confident_wrong"]) == (False, True, False)
    more = scoring.score(hidden, report(finding("rotor_drag"), finding("mass", "tentative")))
    assert (more["exact"], more["honest"], more["confident_wrong"]) == (False, False, False)
    beside = scoring.score(hidden, report(finding("rotor_drag"), finding("wind", "ambiguous", alternatives=["mass"])))
    assert (beside["exact"], beside["honest"]) == (False, False)


def test_a_small_effect_need_not_be_named_and_the_tool_s_own_floor_says_what_is_small():
    assert scoring.score(answer("rotor_drag", multiple=1.0), report())["exact"] is None
    blind = report() | {"minimum_detectable": {"rotor_drag": {"c[0]": 1.0}}}
    assert scoring.score(answer("rotor_drag"), blind)["exact"] is None
    sharp = report() | {"minimum_detectable": {"rotor_drag": {"c[0]": 0.1}}}
    assert scoring.score(answer("rotor_drag"), sharp)["exact"] is False


def test_a_payload_may_be_told_as_its_mass_and_its_place():
    assert scoring.same({"mass", "com_offset"}, {"payload"}) and scoring.same({"payload"}, {"payload"})
    assert not scoring.same({"com_offset"}, {"payload"}) and not scoring.same({"mass", "wind"}, {"payload"})


def test_a_number_s_error_is_told_as_a_share_of_the_change_and_of_the_value():
    numbers = {"c[0]": {"value": 0.9, "interval95": [0.8, 1.1]}, "c[1]": {"value": 0.6, "interval95": [0.55, 0.65]}}
    rows = scoring.score(answer("body_drag"), report(finding("body_drag", parameters=numbers)))["parameters"]
    assert [row["inside"] for row in rows] == [True, False]
    assert rows[1]["error_of_change"] == pytest.approx(0.1) and rows[1]["error_of_value"] == pytest.approx(0.2)


@pytest.mark.parametrize("verdict", ["refused", "broken"])
def test_a_tool_that_says_nothing_is_not_clean(verdict):
    nothing = {"verdict": verdict, "findings": [], "error": "matrix is singular"}
    of_null, of_single = (scoring.score(case, nothing) for case in (answer(family="null"), answer("rotor_drag")))
    assert {of_null[key] for key in ("alarm", "confident_wrong", "wrong_name", "unknown_elsewhere")} == {None}
    assert (of_single["exact"], of_single["layer"], of_single["confident_wrong"]) == (False, False, None)
    assert rates(of_null, of_single)["answered"] == (0, 2)
    assert rates(of_null)["false alarms on nulls"] == (0, 0)
    assert "own: answered" in missed(of_null)
    assert rates(scoring.score(answer(family="null"), report()))["false alarms on nulls"] == (0, 1)


def test_right_names_beside_an_unknown_are_flagged():
    beside = scoring.score(answer("rotor_drag"), report(finding("rotor_drag"), equation("specific force z: t")))
    alone = scoring.score(answer("rotor_drag"), report(finding("rotor_drag")))
    astray = scoring.score(answer("rotor_drag"), report(finding("wind"), equation("specific force z: t")))
    assert [one["unknown_elsewhere"] for one in (beside, alone, astray)] == [True, False, None]
    assert [one["exact"] for one in (beside, alone, astray)] == [False, True, False]
    assert rates(beside, alone, astray)["unknown on nulls and right answers"] == (1, 2)


def test_a_wrong_name_counts_even_if_it_is_a_guess():
    guess = scoring.score(answer("rotor_drag"), report(finding("rotor_drag"), finding("mass", "tentative")))
    assert (guess["confident_wrong"], guess["wrong_name"]) == (False, True)
    assert rates(guess)["any wrong name"] == (1, 1) and "own: any wrong name" not in missed(guess)


def knocked_out(effect, numbers, *terms, layer="force"):
    """Return whether layer, and whether axis and quantity are right of an equation for what was taken out. numbers: of
    the effect, by name."""
    parameters = {f"terms.{effect}.{name}": value for name, value in numbers.items()}
    hidden = answer(effect, family="knockout", removed=[effect], parameters=parameters)
    record = scoring.score(hidden, report(equation(*terms, layer=layer)))
    return record["unknown_on_knockout"], record["quantity_on_knockout"]


def test_a_knocked_out_effect_must_come_back_as_unknown_and_not_as_a_neighbour():
    hidden = answer("rotor_drag", family="knockout", removed=["rotor_drag"])
    for said, right in ((equation("specific force x: Omega v_x"), True), (finding("linear_drag"), False)):
        record = scoring.score(hidden, report(said))
        assert (record["unknown_on_knockout"], record["quantity_on_knockout"]) == (right, right)
    assert knocked_out("rotor_drag", {"k_d": 1e-5}, "specific force x: v_x", layer="motor") == (False, False)
    for verdict, right in (("confirmed", False), ("tentative", True)):
        both = report(finding("linear_drag", verdict), equation("specific force x: Omega v_x"))
        record = scoring.score(hidden, both)
        assert (record["unknown_on_knockout"], record["quantity_on_knockout"]) == (right, right)


@pytest.mark.parametrize(
    ("term", "right"),
    [
        ("specific force x: v_x", True),
        ("specific force y: |v| v_y", True),
        ("specific force x: Omega v_x", True),
        ("specific force x: v_y", False),
        ("specific force z: Omega v_z", False),
        ("specific force x: 1", False),
        ("specific force x: v_x v_z", False),
        ("angular acceleration x: v_x", False),
    ],
)
def test_of_a_drag_the_speed_along_its_own_axis_is_the_right_quantity(term, right):
    assert knocked_out("rotor_drag", {"k_d": 1e-5}, term) == (True, right)
    assert knocked_out("rotor_drag", {"k_d": 1e-5}, "specific force y: t", term) == (True, right)


def test_of_a_vector_the_axes_count_on_which_its_larger_numbers_act():
    bias = {"bias[0]": 0.1, "bias[1]": -0.2, "bias[2]": 0.05}
    for axis, right in (("x", True), ("y", True), ("z", False)):
        assert knocked_out("accel_bias", bias, f"specific force {axis}: 1", layer="imu") == (True, right)
    centre = {"position[0]": 0.004, "position[1]": 0.001}
    for axis, right in (("y", True), ("x", False)):
        assert knocked_out("com_offset", centre, f"angular acceleration {axis}: thrust", layer="moment")[1] == right


def test_of_a_damaged_propeller_its_own_thrust_is_the_right_quantity():
    damage = {"rotor": 2.0, "loss": 0.05}
    for quantity, right in (("thrust of rotor 2", True), ("thrust", True), ("thrust of rotor 3", False)):
        assert knocked_out("damaged_propeller", damage, f"angular acceleration x: {quantity}") == (True, right)


def test_exact_doubles_are_not_asked_for_when_they_are_taken_out_but_what_is_none_of_them_is_a_wrong_name():
    assert knocked_out("mass", {"mass": 1.0}, "specific force z: thrust") == (None, None)
    hidden = answer("mass", family="knockout", removed=["mass"])
    for name, wrong in (("thrust_coefficient", False), ("payload", False), ("wind", True)):
        record = scoring.score(hidden, report(finding(name)))
        assert (record["confident_wrong"], record["wrong_name"]) == (wrong, wrong)
        (rate,) = (
            one
            for one in scoring.summary([record], "own")["rates"]
            if "right layer" in one["name"] and "knocked" in one["name"]
        )
        assert (rate["count"], rate["not_asked"]) == (0, 1)
    assert scoring.score(answer("mass"), report(finding("thrust_coefficient")))["confident_wrong"]  # it was there
    late = answer("motor_time_constant", family="knockout", removed=["motor_time_constant"])
    assert scoring.score(late, report())["unknown_on_knockout"] is False  # nothing is just like a lag


def test_a_table_tells_how_many_cases_of_a_family_it_does_not_ask():
    records = [scoring.score(answer("rotor_drag", multiple=size), report(finding("rotor_drag"))) for size in (4.0, 1.0)]
    table = tables.text({"score": {"own": scoring.summary(records, "own")}})
    (row,) = (line for line in table.splitlines() if line.startswith("single effect: exact name"))
    assert "1/1 = 100.0 % (1 more not asked)" in row


def test_exact_names_are_told_apart_by_whether_they_are_confirmed():
    sure, likely = (
        scoring.score(answer("rotor_drag"), report(finding("rotor_drag", verdict)))
        for verdict in ("confirmed", "tentative")
    )
    assert rates(sure, likely)["exact and confirmed, of exact (tentative is exact too)"] == (1, 2)


def untestable(*findings):
    return report(*findings) | {"not_testable": {"wind": "fly laps both ways"}}


def test_that_an_effect_cannot_be_tested_does_not_excuse_a_wrong_claim():
    hidden = answer("wind", family="poor")
    told = {
        "by exact name": report(finding("wind")),
        "not testable": untestable(),
        "by a set": report(finding("mass", "ambiguous", alternatives=["wind"])),
    }
    records = [scoring.score(hidden, said) for said in told.values()]
    assert [(one["says_ambiguous"], one["told_as"]) for one in records] == [(True, way) for way in told]
    for verdict in ("confirmed", "tentative", "ambiguous"):
        wrong = scoring.score(hidden, untestable(finding("mass", verdict, alternatives=["payload"])))
        assert (wrong["says_ambiguous"], wrong["told_as"]) == (False, None)
    table = tables.text({"score": {"own": scoring.summary(records, "own")}})
    assert "  of which 1 by exact name, 1 not testable, 1 by a set" in table


def test_of_a_recording_that_lacks_channels_a_report_must_name_doubt_or_say_that_it_cannot_tell():
    def told(said, multiple=4.0):
        hidden = answer("wind", family="lacking", multiple=multiple) | {"lacking": "no_velocity"}
        return scoring.score(hidden, said)["missing_channel"]

    assert told(report(finding("wind"))) and told(untestable()) and told(untestable(), multiple=1.0)
    assert told(report(), multiple=1.0) is None  # too small to be asked for
    assert not any(map(told, (report(), report(finding("mass")), untestable(finding("mass", "tentative")))))


def test_the_wrong_propeller_is_a_wrong_name():
    numbers = {"terms.damaged_propeller.rotor": 2, "terms.damaged_propeller.loss": 0.05}
    loss = {"loss": {"value": 0.05, "interval95": [0.04, 0.06]}}

    def propeller(number, verdict="confirmed", **more):
        return finding("damaged_propeller", verdict, parameters=loss, **more) | {"variant": str(number)}

    for number, right in ((2, True), (3, False)):
        record = scoring.score(answer("damaged_propeller", parameters=numbers), report(propeller(number)))
        assert (record["exact"], record["honest"], record["confident_wrong"]) == (right, right, not right)
        assert len(record["parameters"]) == right
        assert scoring.detection([record], (1.0, 9.0))["force"] == [(1.0, 9.0, int(right), 1)]
    either = propeller(3, "ambiguous")
    for other, honest in ((2, True), (1, False)):
        either["alternatives"] = [{"effect": "damaged_propeller", "variant": str(other), "weight": 0.5}]
        record = scoring.score(answer("damaged_propeller", parameters=numbers), report(either))
        assert (record["exact"], record["honest"]) == (False, honest)


def test_a_number_s_error_is_a_share_of_the_change_of_numbers_of_its_own_unit():
    hidden = answer(
        "payload",
        parameters={"terms.payload.mass": 0.1, "terms.payload.position[0]": 0.02, "terms.payload.position[1]": -0.04},
    )
    told = {"mass": 0.11, "position[0]": 0.03, "position[1]": -0.04}
    numbers = {name: {"value": value, "interval95": [value, value]} for name, value in told.items()}
    rows = scoring.score(hidden, report(finding("payload", parameters=numbers)))["parameters"]
    np.testing.assert_allclose([row["error_of_change"] for row in rows], [0.1, 0.25, 0.0], atol=1e-9)


def test_a_set_without_a_manoeuvre_that_can_be_flown_resolves_nothing():
    hidden = answer("wind", family="poor")
    vague = report(finding("wind", "ambiguous", alternatives=["mass"]))
    assert scoring.score(hidden, vague, followed=True)["resolved"] is False
    assert scoring.score(hidden, vague, followed=False)["resolved"] is None
    assert scoring.score(hidden, report(finding("wind")), followed=True)["resolved"] is None  # nothing was open
    assert scoring.score(hidden, vague, again=report(finding("wind")), followed=True)["resolved"] is True


@pytest.fixture(scope="module")
def terms():
    """All terms that a report may hold, of a recording with all channels."""
    content = vehicles.draw(np.random.default_rng(5), "test")
    hover = np.sqrt(content["mass"] * GRAVITY / (4 * content["thrust_coefficient"]))
    truth = hanging(9 * LOOP_HZ)
    table = instruments.record(replace(truth, spin=truth.spin - 1000.0 + hover), content, np.random.default_rng(0))
    vehicle = configuration.build(Vehicle, content, "test")
    with jax.enable_x64(True):
        residual_model = ResidualModel(read_recording(table, vehicle))
        own = features.build_features(residual_model, Variants((vehicle,), ("",)))
    names = [
        f"{channel.name}: {name}" for channel, one in zip(residual_model.channels, own, strict=True) for name in one.names
    ]
    return [*names, "specific force x: north_x within 2.5 m of (1.0, -2.0, 3.1)"]


@pytest.mark.parametrize("name", EFFECTS)
def test_tool_and_referee_mean_the_same_by_a_quantity(terms, name):
    content, effect = vehicles.draw(np.random.default_rng(5), "test"), EFFECTS[name]
    values = effect.planted(content, effect.detectable, np.random.default_rng(1))
    expected = effect.shows({written(path): x - got(content, path, effect.idle) for path, x in values.items()})
    assert expected and all(any(re.fullmatch(one, term) for term in terms) for one in expected)
    assert sum(any(re.fullmatch(one, term) for one in expected) for term in terms) < 0.06 * len(terms)


def numbered(errors, inside):
    """Return a record with parameters of such errors, of which so many lie in their intervals."""
    rows = [
        {"ratio": 9.0, "error_of_change": error, "error_of_value": error, "inside": i < inside}
        for i, error in enumerate(errors)
    ]
    return scoring.score(answer("rotor_drag"), report(finding("rotor_drag"))) | {"parameters": rows, "removed": 0.97}


def test_errors_intervals_and_held_out_flights_have_targets_too():
    names = missed(numbered([0.02] * 8 + [0.07] * 2, 5))
    assert names == [f"own: {number.name}" for number in scoring.NUMBERS.values()]
    good = numbered([0.005] * 10, 10) | {"removed": 0.995}
    assert missed(good) == []  # ten of ten intervals say little
    assert missed(*[good] * 50) == ["own: 95 % intervals that hold the truth"]  # five hundred of them are too wide
    table = tables.text({"score": {"own": scoring.summary([good] * 50, "own")}})
    (row,) = (line for line in table.splitlines() if line.startswith("95 % intervals"))
    assert "500/500 = 100.0 %" in row and row.endswith("93 to 97 %  not met")
    assert "where names are exact" in table


def test_scores_of_older_runs_are_summed_up_without_what_they_do_not_hold():
    record = scoring.score(answer("rotor_drag"), report(finding("rotor_drag")))
    old = {key: value for key, value in record.items() if key not in ("wrong_name", "quantity_on_knockout")}
    assert rates(old) == rates(record) | {"any wrong name": (0, 0)}
    assert "any wrong name" not in tables.text({"score": {"own": scoring.summary([old], "own")}})


@pytest.mark.parametrize(("hits", "count", "low", "high"), [(0, 200, 0.0, 0.0188), (190, 200, 0.910, 0.973)])
def test_wilson_s_interval_is_the_tabulated_one(hits, count, low, high):
    np.testing.assert_allclose(scoring.wilson(hits, count), (low, high), atol=1e-3)
