"""The evidence of a flight: residuals, sensitivities and reference flights, of which noise is no effect."""

from dataclasses import replace
from functools import cache

import jax
import numpy as np
import pytest
from lissajous_flight import REFERENCE_FLIGHTS, SHEET, STEP_S, flight, hover, vehicle

from swift_ros.recording.flight_table import FlightTable, Samples
from swift_sim_bridge.gap.attribution import gauss_newton
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
