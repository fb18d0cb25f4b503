"""The gap tool on flights with effects planted by the simulator: it identifies these effects and no others."""

from dataclasses import replace
from functools import cache

import jax
import numpy as np
import pytest
from lissajous_flight import REFERENCE_FLIGHTS, SHEET, STEP_S, flight, hover, path, vehicle

from swift_ros.errors import UsageError
from swift_ros.recording.flight_table import FlightTable, Samples
from swift_sim_bridge.gap import api
from swift_sim_bridge.gap.attribution import gauss_newton
from swift_sim_bridge.gap.attribution.evidence import SearchResult, SelectedEffect
from swift_sim_bridge.gap.attribution.process_noise import MIN_EXCESS_SHARE_OF_FORCES, excess_process_noise
from swift_sim_bridge.gap.effects.catalogue import catalogue, draught, gusts, payload
from swift_sim_bridge.gap.effects.injection import file_values, inject
from swift_sim_bridge.gap.inference import normal_equations, null_distribution, sensitivity
from swift_sim_bridge.gap.inference.sensitivity import linearise, perturbed_variants
from swift_sim_bridge.gap.nominal import phase_surrogates, reference_flights
from swift_sim_bridge.gap.nominal.noise_sheet import estimate_noise_sheet
from swift_sim_bridge.gap.nominal.recorded_flight import RecordedFlight
from swift_sim_bridge.gap.pipeline import prepare, references
from swift_sim_bridge.gap.pipeline.diagnosis import Options
from swift_sim_bridge.gap.recording.recording import read_recording
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel
from swift_sim_bridge.gap.residuals.sensor_correction import correct
from swift_sim_bridge.gap.validation import localization, repair_choice
from swift_sim_bridge.sensors import imu_errors
from swift_sim_bridge.sensors.clock import Moving, moving_at
from swift_sim_bridge.sensors.imu_errors import ImuTruth
from swift_sim_bridge.sensors.motion_capture import captured
from swift_sim_bridge.sensors.terms import sensor_terms


@cache
def nominal() -> tuple:
    """Return the evidence of a nominal flight, and its sensitivities."""
    with jax.enable_x64(True), pytest.MonkeyPatch.context() as patched:
        patched.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
        evidence = prepare.prepare_evidence([flight(2)], vehicle(), Options(lambda text: None))
        variants = perturbed_variants(vehicle(), evidence.effects, central=False)
        return evidence, linearise(evidence.residual_models[0], variants)


def test_injecting_the_values_of_the_file_changes_nothing_and_every_parameter_has_a_sensitivity():
    evidence, line = nominal()
    for effect in evidence.effects:
        values = file_values(effect, vehicle())
        assert file_values(effect, inject(vehicle(), effect, values)) == pytest.approx(values)
    assert np.all(np.isfinite(line.residual)) and np.all(np.isfinite(line.sensitivity))
    assert np.all(np.abs(line.sensitivity).max(axis=(1, 2)) > 0)


def test_the_residuals_of_a_nominal_flight_are_as_noisy_as_those_of_reference_flights():
    evidence, line = nominal()
    assert np.all(line.residual[line.good].std(axis=0) < 1.5 * evidence.sigmas[0])


def test_scale_error_and_bias_of_a_gyro_are_corrected():
    recording = read_recording(flight(2), vehicle())
    terms = sensor_terms(
        replace(
            vehicle(),
            terms={
                **vehicle().terms,
                "gyro_scale": {"scale": [0.1, -0.1, 0.05]},
                "gyro_bias": {"bias": [0.1, 0.0, -0.2]},
            },
        )
    )
    true, still = recording.gyro_body, np.zeros_like(recording.gyro_body)
    read = imu_errors.distort(ImuTruth(recording.dt, true, still, still, still[:, :1]), terms, None)[0]
    assert np.abs(read - true).max() > 0.3
    assert correct(replace(recording, gyro_body=read), terms).gyro_body == pytest.approx(true, abs=2e-3)


def test_marker_offset_and_time_offset_of_a_pose_are_corrected():
    t, moving = (
        path().t,
        Moving(*(part[:, 0] for part in (path().p_world, path().q_world_body, path().v_world, path().omega_body))),
    )
    terms = sensor_terms(
        replace(vehicle(), terms={"marker_offset": {"position": [0.1, -0.05, 0.05]}, "time_offset": {"delay": 0.02}})
    )
    seen = captured(moving_at(t - 0.02, t, moving), terms)
    recording = replace(
        read_recording(flight(2), vehicle()),
        t=t,
        p_world=seen.p_world,
        q_world_body=seen.q_world_body,
        v_world=seen.v_world,
        gyro_body=moving.omega_body,
    )
    found, inside = correct(recording, terms).moving, slice(20, -20)
    assert np.abs(seen.v_world - moving.v_world)[inside].max() > 0.3
    assert found.p_world[inside] == pytest.approx(moving.p_world[inside], abs=1e-9)
    assert found.v_world[inside] == pytest.approx(moving.v_world[inside], abs=1e-9)


def test_process_noise_is_distinguished_from_measurement_noise():
    evidence, _ = nominal()
    with jax.enable_x64(True):
        known = sensitivity.with_effect_terms(vehicle(), evidence.effects)
        assert not excess_process_noise(evidence, known).any()
        pushed = np.array([0.5, 0.5, 0.5, 2.5, 2.5, 2.5])
        rough = ResidualModel(read_recording(flight(5, pushed), vehicle()))
        found = excess_process_noise(replace(evidence, residual_models=(rough,)), known)
    assert found == pytest.approx(pushed, rel=0.25)


def test_the_larger_rotor_noise_of_a_heavier_vehicle_is_not_taken_for_process_noise(monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
    heavy = {"mass": [1.15 * vehicle().mass]}
    with jax.enable_x64(True):
        evidence = prepare.prepare_evidence([flight(7, **heavy)], vehicle(), Options(lambda text: None))
        (mass,) = (effect for effect in evidence.effects if effect.id == "mass")
        known = inject(sensitivity.with_effect_terms(vehicle(), evidence.effects), mass, heavy["mass"])
        assert evidence.rotor_noise_ratio[0] == pytest.approx(1.15**2, rel=0.05)
        assert not excess_process_noise(evidence, known, MIN_EXCESS_SHARE_OF_FORCES).any()
        assert excess_process_noise(
            replace(evidence, rotor_noise_ratio=(1.0,)), known, MIN_EXCESS_SHARE_OF_FORCES
        ).any()


def test_an_interpolated_pose_is_as_noisy_between_samples_as_at_samples():
    recording = read_recording(flight(6, along=hover), vehicle())
    noise = []
    for delay in (0.0, 0.5, 1.0):
        terms = {**vehicle().terms, "time_offset": {"delay": 0.012 + delay * recording.dt}}
        corrected = correct(recording, sensor_terms(replace(vehicle(), terms=terms)))
        noise.append(np.std(np.diff(corrected.moving.q_world_body[20:-20], 4, axis=0)))
    assert noise[1] == pytest.approx(noise[0], rel=0.3) and noise[2] == pytest.approx(noise[0], rel=0.05)


def test_noise_alone_gives_no_time_offset():
    (late,) = (effect for effect in catalogue(vehicle()) if effect.id == "time_offset")
    variants, sizes = perturbed_variants(vehicle(), (late,), central=False), []
    for seed in (6, 7, 8):
        line = linearise(ResidualModel(read_recording(flight(seed, along=hover), vehicle())), variants)
        sums = normal_equations.accumulate(line, line.residual.std(axis=0) + 1e-9)
        sizes.append(-sums.gradient.sum() / sums.information.sum())
    assert abs(np.mean(sizes)) < 1.0  # of its steps


def test_the_noise_of_a_slow_pose_is_not_taken_for_a_vio_scale_error():
    rng, noise_m, t = np.random.default_rng(9), 1e-3, np.arange(0.0, 30.0, STEP_S)
    p, level = 0.05 * np.sin(np.array([0.5, 0.6, 0.7]) * t[:, None]), np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1))
    noisy = p + noise_m * rng.standard_normal(p.shape)
    rows = {
        "p_world": noisy,
        "q_world_body": level,
        "gyro_body": 1e-3 * rng.standard_normal(p.shape),
        "p_vio": p,
        "q_vio_body": level,
    }
    table = FlightTable("slow flight", {name: Samples(t, values) for name, values in rows.items()})
    effects = tuple(effect for effect in catalogue(vehicle()) if effect.id == "vio_scale")
    residual_model = ResidualModel(read_recording(table, vehicle()))
    line = linearise(residual_model, perturbed_variants(vehicle(), effects, central=False))
    own = sensitivity.parameter_slices(effects)
    calm = null_distribution.estimate_null_distribution(
        [replace(line, residual=rng.standard_normal(line.residual.shape))], own
    )
    sums = normal_equations.accumulate(line, calm.sigma)
    seen = phase_surrogates.with_pose_noise(
        calm, RecordedFlight(table, residual_model, line, vehicle()), effects, noise_m, 3
    )
    total_bias = (seen.bias_gradient - calm.bias_gradient) * null_distribution.seconds_with_data(line)
    assert -sums.gradient.sum() / sums.information.sum() * effects[0].parameters[0].step < -0.1  # a tenth and more
    assert total_bias == pytest.approx(sums.gradient.sum(axis=0), rel=0.2)


def test_a_hover_identifies_the_gyro_scale_only_on_axes_that_rotate(monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
    found = api.diagnose(
        [flight(4, along=hover, gyro_scale=[0.0, 0.0, 0.04])], vehicle(), lambda text: None, validate=False
    )
    (one,) = found.report["findings"]
    sizes = [one["parameters"][f"scale[{i}]"]["value"] for i in range(3)]
    assert one["effect"] == "gyro_scale" and sizes == pytest.approx([0.0, 0.0, 0.04], abs=2e-3)


def test_rotor_noise_is_estimated_also_where_rotor_speeds_change_much():
    table = flight(3)
    assert np.ptp(table["rotor_speed"].values) > 2000.0
    report = estimate_noise_sheet(table, replace(vehicle(), sensors={}))
    assert report["rotor_relative"] == pytest.approx(SHEET["rotor_relative"], rel=0.03)


def test_the_rate_loop_of_a_reference_flight_reads_the_recorded_gyro():
    with jax.enable_x64(True):
        traces = reference_flights.fly(vehicle(), hover(), SHEET["gyro_rad_s"], 6)
    table = reference_flights.reference_tables(traces, hover(), flight(6, along=hover), vehicle(), 6)[0]
    noise = table["gyro_body"].values[:, 2] - traces[0].omega_body[:, 2]
    yaw = traces[0].motor_command @ [rotor.spin for rotor in vehicle().rotors]
    assert abs(np.corrcoef(np.diff(noise), np.diff(yaw))[0, 1]) > 0.9


def test_planted_drag_and_motor_lag_are_identified_and_reduce_the_errors_on_held_out_parts(monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
    recording = flight(3, rotor_drag=[6e-5], motor_time_constant=[0.038])
    found = api.diagnose([recording], vehicle(), lambda text: None)
    entries = {one["effect"]: one for one in found.report["findings"]}
    assert set(entries) == {"rotor_drag", "motor_time_constant"}
    assert entries["rotor_drag"]["parameters"]["k_d"]["value"] == pytest.approx(6e-5, rel=0.03)
    assert entries["motor_time_constant"]["parameters"]["time_constant_up"]["value"] == pytest.approx(0.038, rel=0.02)
    assert found.vehicle.motor.time_constant_down == pytest.approx(0.038, rel=0.02)
    shown = found.report["improvement"]["held_out"]
    assert shown["rollout_rmse_m"]["0.5"]["after"] < 0.7 * shown["rollout_rmse_m"]["0.5"]["before"]
    step = shown["one_step_rmse"]
    assert step["after"] < min(step["knn"], step["gp"]) and max(step["knn"], step["gp"]) < step["before"]
    for axis in "xy":
        force, way = shown["one_step_rmse_by_axis"][axis], shown["rollout_rmse_m_by_axis"][axis]["0.5"]
        assert force["after"] < 0.7 * force["before"] and way["after"] < way["before"]
    assert shown["one_step_rmse_by_speed"]["fast"]["before"] > shown["one_step_rmse_by_speed"]["slow"]["before"]
    assert found.report["improvement"]["left"] == {"verdict": "nothing_left_out", "findings": []}
    where = {one["effect"]: one for one in localization.locate_findings(found, vehicle())["findings"]}
    assert where["rotor_drag"]["channels"] == ["specific_force_x", "specific_force_y"]
    assert where["motor_time_constant"]["channels"] == [f"rotor_speed_{i}" for i in (1, 2, 3, 4)]


def test_propellers_that_stall_are_identified_and_the_repaired_vehicle_leaves_nothing(monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
    found = api.diagnose([flight(3, propeller_stall=[2.0])], vehicle(), lambda text: None)
    (entry,) = found.report["findings"]
    low, high = entry["parameters"]["slope"]["interval95"]
    assert entry["effect"] == "propeller_stall" and low < 2.0 < high
    assert found.vehicle.terms["propeller_stall"]["slope"] == pytest.approx(2.0, rel=0.15)
    assert found.report["improvement"]["left"] == {"verdict": "nothing_left_out", "findings": []}


def test_a_local_draught_is_identified_and_located(monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
    center = path().p_world[round(4.0 / STEP_S), 0] + [0.3, 0.2, -0.2]
    report = api.diagnose(
        [flight(6, local_draught=np.array([-2.0, 6.0, 0.0, *center, 1.8]))],
        vehicle(),
        progress=lambda text: None,
        validate=False,
    ).report
    (one,) = report["findings"]
    assert one["effect"] == "local_draught"
    size = {name: entry["value"] for name, entry in one["parameters"].items()}
    assert np.linalg.norm([size[f"center[{i}]"] - center[i] for i in range(3)]) < 0.6
    for name, true in (("velocity[0]", -2.0), ("velocity[1]", 6.0), ("radius", 1.8)):
        low, high = one["parameters"][name]["interval95"]
        assert low < true < high and high - low < 12.0, name


@pytest.mark.parametrize(
    "planted", [(0.06, 0.04, -0.03, 0.01), pytest.param((0.1, 0.02, -0.01, -0.04), marks=pytest.mark.slow)]
)
def test_a_payload_is_identified_with_mass_and_position_and_not_as_mass_inertia_and_offset(planted, monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
    found = api.diagnose([flight(51, payload=planted)], vehicle(), lambda text: None, seed=3)
    (load,) = found.report["findings"]
    assert (load["effect"], load["verdict"]) == ("payload", "confirmed")
    for name, true in zip(("mass", *(f"position[{i}]" for i in range(3))), planted, strict=True):
        low, high = load["parameters"][name]["interval95"]
        assert abs(load["parameters"][name]["value"] - true) < max(0.1 * abs(true), 2 * (high - low))
    assert found.vehicle.terms["payload"]["mass"] == pytest.approx(planted[0], rel=0.05)
    assert found.report["improvement"]["held_out"]["rollout_rmse_m"]["0.5"]["after"] < 0.02
    assert found.report["improvement"]["left"] == {"verdict": "nothing_left_out", "findings": []}


def test_mass_and_centre_of_mass_without_more_inertia_are_not_taken_for_a_payload(monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
    heavier = flight(52, mass=[1.06 * vehicle().mass], com_offset=[0.003, -0.002, 0.0])
    found = api.diagnose([heavier], vehicle(), lambda text: None, seed=3, validate=False)
    assert {one["effect"] for one in found.report["findings"]} == {"mass", "com_offset"}


@pytest.mark.slow
def test_a_hover_shows_mass_and_balance_of_a_payload_but_not_its_position(monkeypatch):
    """In a hover, the noise of rotor speeds looks like more inertia, as of a payload far above or below."""
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
    loaded = flight(55, along=hover, payload=[0.06, 0.02, -0.03, 0.0])
    found = api.diagnose([loaded], vehicle(), lambda text: None, seed=3, validate=False).report["findings"]
    assert {one["effect"] for one in found if one["layer"] == "moment"} == {"com_offset"}
    (weight,) = (one for one in found if one["layer"] == "force")
    assert "mass" in {weight["effect"], *(other["effect"] for other in weight["alternatives"])}


@pytest.mark.slow
def test_a_damaged_propeller_in_a_hover_is_identified_and_not_as_a_shifted_centre_of_mass(monkeypatch):
    """Its moment, as of a shifted centre of mass, is larger than its loss of thrust."""
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
    damaged = flight(56, along=hover, **{"damaged_propeller[2]": [0.024]})
    (found,) = api.diagnose([damaged], vehicle(), lambda text: None, seed=3, validate=False).report["findings"]
    assert (found["effect"], found["variant"]) == ("damaged_propeller", "2")
    assert found["parameters"]["loss"]["value"] == pytest.approx(0.024, rel=0.05)


def test_half_the_inertia_is_identified_although_to_first_order_it_looks_like_none(monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
    half = np.diag(vehicle().inertia_matrix) * [1.0, 1.0, 0.5]
    report = api.diagnose([flight(53, inertia=half)], vehicle(), lambda text: None, validate=False).report
    (found,) = report["findings"]
    assert (found["effect"], found["verdict"]) == ("inertia", "confirmed")
    assert found["parameters"]["inertia[2]"]["value"] == pytest.approx(half[2], rel=0.02)


def test_a_hover_uses_the_same_samples_for_every_vehicle():
    """A vehicle whose rotors are too weak to hover is not taken for one on the ground."""
    weak = replace(vehicle(), thrust_coefficient=0.6 * vehicle().thrust_coefficient)
    with jax.enable_x64(True):
        still = ResidualModel(read_recording(flight(54, along=hover), vehicle()))
        lines = [linearise(still, perturbed_variants(one, ())) for one in (vehicle(), weak)]
    assert lines[0].good.mean() > 0.9 and np.array_equal(lines[0].good, lines[1].good)


@pytest.mark.parametrize("sought", [draught((1.0, 2.0, 1.0), 2.0), gusts(), payload((0.03, 0.0, 0.0))])
def test_effects_without_a_null_distribution_are_fitted_again_for_the_hold_out(sought):
    """Draughts, gusts and payloads are not part of the null distribution."""
    evidence, _ = nominal()
    with jax.enable_x64(True):
        complete = sensitivity.with_effect_terms(vehicle(), (*evidence.effects, sought))
        values, covariance = gauss_newton.gauss_newton_fit(evidence, complete, [sought], {}, 0.7)
    assert np.isfinite(values[sought.key]).all() and np.isfinite(covariance[sought.key]).all()


def test_clock_drift_that_is_knocked_out_becomes_an_equation_and_no_constant_delay(monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
    report = api.diagnose(
        [flight(7, clock_drift=[500.0])], vehicle(), lambda text: None, knocked_out=("clock_drift",), validate=False
    ).report
    (one,) = report["findings"]
    assert one["verdict"] == "unknown" and one["layer"] == "imu"
    for axis in "xyz":
        size = one["parameters"][f"gyro_{axis}: t modelled turn {axis}"]["value"]
        assert size == pytest.approx(-500e-6, rel=0.1), axis


def test_an_imu_lever_arm_is_identified_without_single_rotor_speeds(monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
    table = flight(4, imu_lever_arm=[0.02, -0.03, 0.01])
    table = replace(table, channels={name: one for name, one in table.channels.items() if name != "rotor_speed"})
    report = api.diagnose([table], vehicle(), lambda text: None, validate=False).report
    (one,) = report["findings"]
    assert one["effect"] == "imu_lever_arm"
    for i, true in enumerate((0.02, -0.03, 0.01)):
        assert one["parameters"][f"position[{i}]"]["value"] == pytest.approx(true, abs=0.005)


def test_a_tilted_map_is_distinguished_from_an_accelerometer_bias(monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
    report = api.diagnose(
        [flight(8, map_tilt=np.array([0.012, -0.007]))], vehicle(), progress=lambda text: None, validate=False
    ).report
    (one,) = report["findings"]
    assert one["effect"] == "map_tilt" and not one["alternatives"]
    found = [one["parameters"][f"rotation[{i}]"]["value"] for i in range(2)]
    assert found == pytest.approx([0.012, -0.007], abs=0.0015)


def test_a_quaternion_in_another_order_is_refused():
    table = flight(1)
    q = table["q_world_body"]
    turned = Samples(q.t, q.values[:, [3, 0, 1, 2]])
    with pytest.raises(UsageError, match="has w first"):
        read_recording(FlightTable("flight", {**table.channels, "q_world_body": turned}), vehicle())


def test_a_knocked_out_drag_becomes_an_equation_which_the_repaired_vehicle_flies(monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
    recording = flight(4, linear_drag=[0.3, 0.3, 0.45])
    found = api.diagnose([recording], vehicle(), lambda text: None, knocked_out=("linear_drag",))
    (equation,) = [one for one in found.report["findings"] if one["verdict"] == "unknown"]
    assert equation["layer"] == "force" and found.report["verdict"] == "unknown"
    assert equation["parameters"]["specific_force_x: v_x"]["value"] == pytest.approx(-0.3 / 0.87, rel=0.1)
    assert equation["parameters"]["specific_force_x: v_x"]["unit"] == "1/s"
    assert not [one for one in found.report["findings"] if one["verdict"] == "confirmed"]
    (where,) = [
        one["where"] for one in localization.locate_findings(found, vehicle())["findings"] if one["effect"] is None
    ]
    assert where["time"] and where["regime"] == equation["where"]["regime"]
    flown = found.vehicle.terms["equation"]
    assert flown["force_x"]["v_x"]["coefficient"] == pytest.approx(-0.3, rel=0.1)
    assert equation["in_repair"] and equation["summands"][0]["removed_share"] > 0.5
    unseen = found.report["improvement"]["held_out"]
    assert unseen["one_step_rmse"]["after"] < 0.5 * unseen["one_step_rmse"]["before"]
    assert unseen["rollout_rmse_m"]["0.5"]["after"] < 0.2 * unseen["rollout_rmse_m"]["0.5"]["before"]


def repair_of(recording: FlightTable, found_names: dict, withdrawn: bool):
    """Return (repair, reported effects) where a search has found these effects with their values, or given them up."""
    effects = {effect.key: effect for effect in catalogue(vehicle())}
    names = tuple(
        SelectedEffect(effects[key], np.array(values), np.eye(len(values)), 50.0, is_certain=not withdrawn)
        for key, values in found_names.items()
    )
    with jax.enable_x64(True):
        evidence = prepare.prepare_evidence([recording], vehicle(), Options(lambda text: None))
        found = SearchResult(() if withdrawn else names, (), evidence, names if withdrawn else ())
        chosen = repair_choice.choose_repair(vehicle(), found, lambda text: None)
    return chosen, repair_choice.reported(found, chosen).selected


def test_a_name_of_which_an_equation_explains_more_stays_where_the_unseen_part_gets_better(monkeypatch):
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
    chosen, reported = repair_of(flight(3, rotor_drag=[6e-5]), {"rotor_drag": [4e-5]}, withdrawn=True)
    (drag,) = chosen.names
    assert drag.values == pytest.approx([6e-5], rel=0.03) and not chosen.left_out
    assert [(one.effect.id, one.verdict) for one in reported] == [("rotor_drag", "tentative")]


def test_a_name_without_which_the_unseen_part_is_better_is_not_in_the_repair(monkeypatch):
    """The accelerometer is off in the first half of the flight alone: no bias of the whole flight."""
    monkeypatch.setattr(references, "REFERENCE_FLIGHTS", REFERENCE_FLIGHTS)
    table = flight(3)
    t, force = table["specific_force_body"].t, table["specific_force_body"].values.copy()
    force[t < t[0] + 0.5 * (t[-1] - t[0])] += [0.0, 1.5, 0.0]
    changed = FlightTable("shifted", {**table.channels, "specific_force_body": Samples(t, force)})
    chosen, reported = repair_of(changed, {"accel_bias": [0.0, 1.0, 0.0]}, withdrawn=False)
    assert not chosen.names and [one.effect.id for one in chosen.left_out] == ["accel_bias"]
    assert [one.verdict for one in reported] == ["tentative"]
