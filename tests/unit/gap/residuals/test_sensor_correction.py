"""Errors of sensors that are planted in a known motion are corrected."""

from dataclasses import replace

import numpy as np
import pytest
from lissajous_flight import flight, hover, path, vehicle

from swift_sim_bridge.gap.recording.recording import read_recording
from swift_sim_bridge.gap.residuals.sensor_correction import correct
from swift_sim_bridge.sensors import imu_errors
from swift_sim_bridge.sensors.clock import Moving, moving_at
from swift_sim_bridge.sensors.imu_errors import ImuTruth
from swift_sim_bridge.sensors.motion_capture import captured
from swift_sim_bridge.sensors.terms import sensor_terms


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


def test_an_interpolated_pose_is_as_noisy_between_samples_as_at_samples():
    recording = read_recording(flight(6, along=hover), vehicle())
    noise = []
    for delay in (0.0, 0.5, 1.0):
        terms = {**vehicle().terms, "time_offset": {"delay": 0.012 + delay * recording.dt}}
        corrected = correct(recording, sensor_terms(replace(vehicle(), terms=terms)))
        noise.append(np.std(np.diff(corrected.moving.q_world_body[20:-20], 4, axis=0)))
    assert noise[1] == pytest.approx(noise[0], rel=0.3) and noise[2] == pytest.approx(noise[0], rel=0.05)
