"""Several recordings of one vehicle: shared effects, effects of single recordings, and the repaired file."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from motor_log import VEHICLE as LOGGED
from motor_log import log
from report_example import FINDING, PARAMETERS, REPORT

from swift_ros.configuration import configuration_folder, load
from swift_ros.errors import UsageError
from swift_ros.recording.flight_table import FlightTable, Samples
from swift_ros.vehicle import Vehicle
from swift_sim_bridge.gap import api
from swift_sim_bridge.gap.attribution.evidence import SearchResult, SelectedEffect
from swift_sim_bridge.gap.effects.catalogue import catalogue, gusts
from swift_sim_bridge.gap.inference import sensitivity
from swift_sim_bridge.gap.inference.null_distribution import NullDistribution, minimum_detectable_changes, pooled
from swift_sim_bridge.gap.pipeline import multi_flight, prepare, references
from swift_sim_bridge.gap.recording.recording import read_recording
from swift_sim_bridge.gap.report.html import html_page
from swift_sim_bridge.gap.report.sentences import headline
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel

VEHICLE = load(Vehicle, configuration_folder() / "drone.yaml")
EFFECTS = {effect.key: effect for effect in catalogue(VEHICLE)}


def selected(key: str, values) -> SelectedEffect:
    return SelectedEffect(EFFECTS[key], np.array(values), 1e-4 * np.eye(len(values)), 9.0)


def test_a_shared_effect_is_reported_once_and_battery_sag_only_for_the_flight_that_has_it(monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", 8)
    logs = [log(5, lag_s=0.040), log(6, lag_s=0.040, resistance=0.03)]
    found = api.diagnose(logs, LOGGED, lambda text: None)
    named = {(one["effect"], one.get("recording")): one["parameters"] for one in found.report["findings"]}
    assert set(named) == {("motor_time_constant", None), ("battery_sag", "log 6")}
    assert named["motor_time_constant", None]["time_constant_up"]["value"] == pytest.approx(0.040, rel=0.02)
    assert named["battery_sag", "log 6"]["resistance"]["value"] == pytest.approx(0.03, rel=0.05)
    assert found.vehicle.battery.resistance == pytest.approx(0.03, rel=0.05)


def test_battery_air_and_calibration_differ_between_flights_and_the_airframe_does_not():
    own = set(multi_flight.per_flight(VEHICLE))
    assert {"battery_sag", "wind", "accel_bias", "gyro_bias", "time_offset", "marker_offset"} <= own
    assert not own & {"mass", "rotor_drag", "com_offset", "motor_time_constant", "imu_lever_arm", "inertia"}


def test_a_channel_that_not_all_recordings_have_is_left_out_of_all_with_a_message():
    one, other, messages = log(5), log(6), []
    poorer = replace(other, channels={name: samples for name, samples in other.channels.items() if name != "current"})
    kept = multi_flight.comparable([one, poorer], messages.append)
    assert [set(table.channels) for table in kept] == [set(poorer.channels)] * 2
    assert messages == ["left out, as not all recordings can show it: ibat"]
    assert multi_flight.comparable([one, other], messages.append) == [one, other] and len(messages) == 1


def test_residuals_that_not_all_recordings_have_are_used_in_none(monkeypatch):
    sparse, messages = replace(log(6), skips_commands=True), []
    residual_models = [ResidualModel(read_recording(one, LOGGED)) for one in (log(5), sparse)]
    one, other = prepare.in_common(residual_models, messages.append)
    assert [channel.name for channel in one.channels] == ["voltage", "electrical power"]
    assert one.channels == other.channels
    assert messages == ["left out, as not all recordings can show it: rotors"]
    assert one.residual(LOGGED).shape[1] == 2


def test_reference_flights_of_a_flight_in_gusts_have_gusts():
    calm, windy = (ResidualModel(None, own) for own in ((), ((gusts(), np.array([6.0])),)))
    assert "gust" not in references.in_own_air(VEHICLE, calm).terms
    assert references.in_own_air(VEHICLE, windy).terms["gust"]["wind_20ft"] == 6.0


def test_shared_effects_are_not_certain_where_one_recording_has_many_of_its_own():
    shared = (selected("mass", [0.8]),)
    assert multi_flight._limit_certainty(shared, [(), (selected("gyro_bias", [0.0, 0.0, 0.1]),)])[0].is_certain
    many = selected("gyro_bias", [0.0, 0.0, 0.1]), selected("accel_bias", [0.0, 0.0, 0.1])
    assert not multi_flight._limit_certainty(shared, [(), many])[0].is_certain


def test_recordings_without_a_common_channel_are_refused_with_what_to_record():
    posed, felt = (
        FlightTable(name, {channel: Samples(np.arange(9.0), np.zeros(9)) for channel in channels})
        for name, channels in (
            ("a.csv", ("p_world", "thrust_command")),
            ("b.csv", ("specific_force_body", "thrust_command")),
        )
    )
    with pytest.raises(
        UsageError,
        match="a.csv, b.csv: these recordings have no channel in common that can be compared; record in each",
    ):
        multi_flight.comparable([posed, felt], pytest.fail)


def test_the_repaired_file_has_the_mean_of_per_flight_effects_and_no_wind():
    first = selected("accel_bias", [0.4, 0.0, 0.0]), selected("wind", [3.0, 0.0, 0.0])
    second = selected("accel_bias", [0.2, 0.2, 0.0]), selected("gyro_bias", [0.01, 0.0, 0.0])
    means = {one.effect.id: one for one in multi_flight._means([first, second])}
    assert set(means) == {"accel_bias", "gyro_bias"}
    assert means["accel_bias"].values == pytest.approx([0.3, 0.1, 0.0])
    assert np.diag(means["accel_bias"].covariance) == pytest.approx(0.5e-4)


def test_a_confounder_that_all_flights_together_exclude_is_dropped():
    lift = EFFECTS["lift_cross"]
    distribution = SimpleNamespace(slices={"lift_cross": slice(0, 2)}, minimum_detectable=np.array([2.0, 2.0]))
    evidence, nothing = SimpleNamespace(effects=(lift,), null_distribution=distribution), SearchResult()
    step = sensitivity.parameter_steps((lift,))

    def remaining(one, found):
        single = multi_flight.SingleRecording(None, (one,), np.zeros(6))
        return multi_flight._exclude_shared(single, evidence, found).own_effects[0].confounders

    wind = replace(
        selected("wind", [1.0, 0.0, 0.0]),
        confounders={"lift_cross": 0.9, "wind": 0.1},
        changes={"lift_cross": 5.0 * step, "wind": np.ones(3)},
    )
    assert remaining(wind, nothing) == {"wind": 1.0}
    small = replace(wind, changes={"lift_cross": 3.0 * step, "wind": np.ones(3)})
    assert remaining(small, nothing) == wind.confounders
    present = SearchResult((selected("lift_cross", [0.1, 0.1]),))
    assert remaining(wind, present) == wind.confounders


def test_an_ambiguous_effect_is_resolved_by_a_recording_that_identifies_it():
    ambiguous = replace(
        selected("accel_scale", [0.0, 0.0, 0.03]),
        confounders={"accel_scale": 0.5, "accel_bias": 0.5},
        changes={"accel_scale": np.array([0.0, 0.0, 0.03]), "accel_bias": np.array([0.0, 0.0, 0.3])},
    )
    certain = replace(selected("accel_bias", [0.0, 0.0, 0.25]), confounders={"accel_bias": 1.0})
    hover, punch = (multi_flight.SingleRecording(None, (one,), np.zeros(6)) for one in (ambiguous, certain))
    (resolved,), (kept,) = (one.own_effects for one in multi_flight._resolve_by_other_flights([hover, punch], VEHICLE))
    assert resolved.effect.key == "accel_bias" and resolved.confounders == {"accel_bias": 1.0} and kept is certain
    assert resolved.values == pytest.approx([0.0, 0.0, 0.3])
    assert multi_flight._resolve_by_other_flights([hover, hover], VEHICLE)[0].own_effects == (ambiguous,)
    twice = multi_flight.SingleRecording(None, (ambiguous, replace(ambiguous, significance=5.0)), np.zeros(6))
    assert len(multi_flight._resolve_by_other_flights([twice, punch], VEHICLE)[0].own_effects) == 1


def test_the_likeliest_of_what_a_flight_can_have_alone_stands_for_its_set():
    """The mass is likelier still, but belongs to all flights, whose search has not found it."""
    changes = {"accel_scale": np.array([0.0, 0.0, 0.03]), "accel_bias": np.array([0.0, 0.0, 0.3]), "mass": np.ones(1)}
    weights = {"mass": 0.5, "accel_bias": 0.4, "accel_scale": 0.1}
    own = replace(selected("accel_scale", changes["accel_scale"]), confounders=weights, changes=changes)
    evidence = SimpleNamespace(effects=tuple(EFFECTS.values()))
    single = multi_flight.SingleRecording(evidence, (own,), np.zeros(6))
    (likeliest,) = multi_flight._with_likeliest_first(single, VEHICLE).own_effects
    assert likeliest.effect.key == "accel_bias" and likeliest.values == pytest.approx([0.0, 0.0, 0.3])
    assert likeliest.confounders == weights


def test_the_bias_of_the_products_is_weighted_by_the_duration_of_each_flight():
    def part(bias):
        return NullDistribution(
            *[np.ones(1)] * 6, np.array([[bias, bias]]), np.ones((3, 1)), np.zeros(1), {"mass": slice(0, 1)}
        )

    assert pooled([part(1.0), part(4.0)], [30, 10]).bias_gradient == pytest.approx([3.5])


def test_the_bias_of_an_estimate_is_weighted_by_the_information_of_each_flight():
    def part(bias, information):
        ones = [np.ones(1)] * 4
        return NullDistribution(
            *ones,
            np.array([bias]),
            np.array([information]),
            np.ones((1, 2)),
            np.ones((3, 1)),
            np.zeros(1),
            {"mass": slice(0, 1)},
        )

    assert pooled([part(20.0, 1.0), part(0.5, 99.0)], [30, 10]).bias == pytest.approx([0.695])


def test_a_propeller_without_information_does_not_hide_detectable_ones():
    blades = [EFFECTS[f"damaged_propeller[{i}]"] for i in (1, 2, 3)]
    slices = {effect.key: slice(i, i + 1) for i, effect in enumerate(blades)}
    distribution = SimpleNamespace(slices=slices, minimum_detectable=np.array([2.0, np.inf, 4.0]))
    largest = {"damaged_propeller": {"loss": pytest.approx(4.0 * sensitivity.parameter_steps(blades)[2])}}
    assert (
        minimum_detectable_changes(blades, distribution)
        == minimum_detectable_changes(blades[::-1], distribution)
        == largest
    )


def test_the_minimum_detectable_change_is_the_smallest_over_flights_for_each_parameter():
    first = {"camera_extrinsic": {"rotation[0]": 0.001, "position[0]": 0.5}, "mass": {"mass": 0.01}}
    second = {"camera_extrinsic": {"rotation[0]": 0.003, "position[0]": 0.1}}
    assert multi_flight._smallest([first, second]) == first | {
        "camera_extrinsic": {"rotation[0]": 0.001, "position[0]": 0.1}
    }


def test_errors_are_averaged_over_the_flights_that_have_them():
    whole = {"one_step_rmse": {"before": 3.0, "unit": "V"}, "rollout_rmse_m": {"0.5": {"before": 1.0}}}
    assert multi_flight._mean_entry([{"one_step_rmse": {"before": 4.0, "unit": "V"}}, whole]) == whole | {
        "one_step_rmse": {"before": pytest.approx(np.sqrt(12.5)), "unit": "V"}
    }


def test_the_page_names_the_recording_of_a_finding():
    sure = FINDING | {"verdict": "confirmed", "alternatives": []}
    report = REPORT | {
        "verdict": "confirmed",
        "findings": [
            sure,
            sure | {"effect": "accel_bias", "recording": "first.csv"},
            sure | {"effect": "accel_bias", "recording": "second.csv"},
        ],
    }
    html = html_page(report, "drone.yaml", PARAMETERS, {}, Path())
    assert "accel bias in first.csv" in html and "accel bias in second.csv" in html
    assert headline(report) == "The simulation lacks rotor drag and accel bias."
