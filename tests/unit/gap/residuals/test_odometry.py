"""The scale of VIO against a pose whose stamps scatter."""

import numpy as np
import pytest
from lissajous_flight import STEP_S, vehicle

from swift_ros.recording.flight_table import FlightTable, Samples
from swift_sim_bridge.gap.effects.catalogue import catalogue
from swift_sim_bridge.gap.inference.sensitivity import linearise, perturbed_variants
from swift_sim_bridge.gap.recording.recording import read_recording
from swift_sim_bridge.gap.residuals.residual_model import ResidualModel

SCALE, JITTER_S = 0.03, 0.005


def fitted_scale(with_velocity: bool) -> float:
    """Return the scale that least squares finds in a level flight of 3 m/s."""
    rng, t, pace = np.random.default_rng(4), np.arange(0.0, 30.0, STEP_S), np.array([1.5, 1.9, 2.3])
    level = np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1))
    seen_s = (t + JITTER_S * rng.standard_normal(len(t)))[:, None]
    values = {
        "p_world": 2.0 * np.sin(pace * seen_s),
        "q_world_body": level,
        "gyro_body": 1e-3 * rng.standard_normal((len(t), 3)),
        "p_vio": (1.0 + SCALE) * 2.0 * np.sin(pace * t[:, None]),
        "q_vio_body": level,
    }
    if with_velocity:
        values["v_world"] = 2.0 * pace * np.cos(pace * seen_s) + 0.02 * rng.standard_normal((len(t), 3))
    table = FlightTable("flight", {name: Samples(t, one) for name, one in values.items()})
    effects = tuple(effect for effect in catalogue(vehicle()) if effect.id == "vio_scale")
    line = linearise(
        ResidualModel(read_recording(table, vehicle())), perturbed_variants(vehicle(), effects, central=False)
    )
    change, residual = line.sensitivity[0][line.good], line.residual[line.good]
    return -float(np.sum(change * residual) / np.sum(change**2)) * effects[0].parameters[0].step


def test_the_recorded_velocity_shows_the_scale_though_the_poses_stamps_scatter():
    """The slope of the position has noise that is in the residual, too, and hides a part of the scale."""
    assert fitted_scale(with_velocity=True) == pytest.approx(SCALE, rel=0.01)
    assert fitted_scale(with_velocity=False) < 0.99 * SCALE
