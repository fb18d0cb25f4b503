"""Manoeuvres that separate confounders: only residuals that no value of the other effect reproduces count."""

from types import SimpleNamespace

import numpy as np
import pytest

from swift_ros.configuration import configuration_folder, load
from swift_ros.vehicle import GRAVITY, Vehicle
from swift_sim_bridge.gap.recording import recording
from swift_sim_bridge.gap.validation import experiment_design
from swift_sim_bridge.gap.validation.experiment_design import Manoeuvre


def effect(key):
    return SimpleNamespace(key=key, parameters=(SimpleNamespace(step=1.0),))


def test_the_separation_counts_only_residuals_that_the_other_effect_cannot_reproduce():
    rng = np.random.default_rng(0)
    both, alone = rng.standard_normal((2, 400, 1))
    sensitivity = np.stack([both + 0.1 * alone, both])
    confounders, changes = [effect("mass"), effect("thrust")], {"mass": np.array([2.0]), "thrust": np.array([2.0])}
    separation = experiment_design._separation_squares(sensitivity, confounders, changes)
    assert separation == pytest.approx(400 * (2.0 * 0.1) ** 2, rel=0.3)
    identical = np.stack([both, both])
    assert experiment_design._separation_squares(identical, confounders, changes) == pytest.approx(0.0, abs=1e-9)


def test_a_manoeuvre_is_data_and_its_sentence_follows_from_it():
    punches = Manoeuvre("throttle_punches", 20.0)
    assert punches.as_json() == {"id": "throttle_punches", "seconds": 20.0}
    assert punches.text == "punch the throttle, level for 20 s"
    assert set(experiment_design.DESCRIPTIONS) == set(experiment_design.figures(np.arange(3.0)))


def test_every_manoeuvre_can_be_flown_and_the_shortest_is_long_enough_to_be_read():
    t = np.arange(0.0, experiment_design.SIMULATED_S, experiment_design.STEP_S)
    figures = experiment_design.figures(t)
    path = experiment_design._path(list(figures.values()))
    assert path.p_world.shape == (len(t), len(figures), 3)
    assert np.all(path.p_world[..., 2] > 0.1)
    assert np.all(path.a_world[..., 2] > -0.8 * GRAVITY)  # the rotors cannot pull downwards
    assert np.linalg.norm(path.a_world[20:-20] + [0.0, 0.0, GRAVITY], axis=-1).max() < 4.0 * GRAVITY
    assert min(experiment_design.DURATIONS_S) > recording.MIN_DURATION_S


def test_a_manoeuvre_that_the_vehicle_cannot_fly_is_not_proposed(monkeypatch):
    def fallen(_, path):
        return [SimpleNamespace(p_world=p - [0.0, 0.0, 5.0]) for p in np.moveaxis(path.p_world, 1, 0)]

    vehicle = load(Vehicle, configuration_folder() / "drone.yaml")
    monkeypatch.setattr(experiment_design.reference_flights, "fly", fallen)
    monkeypatch.setattr(experiment_design.reference_flights, "reference_tables", lambda traces, *_: traces)
    assert experiment_design.separating_manoeuvre([], {}, vehicle, None, (np.ones(1), 1.0)) is None


def test_a_manoeuvre_that_is_noisier_than_the_recording_counts_for_less(monkeypatch):
    """Both manoeuvres separate the effects; the residuals of one scatter ten times as much as the recording's."""
    line = SimpleNamespace(t=np.linspace(0.0, 12.0, 400), sensitivity=np.zeros((2, 400, 1)), good=np.ones(400, bool))
    line.sensitivity[0, ::2], line.sensitivity[1, 1::2] = 2.0, 2.0
    confounders, changes = [effect("mass"), effect("thrust")], {"mass": np.ones(1), "thrust": np.ones(1)}
    flights = experiment_design.reference_flights
    monkeypatch.setattr(experiment_design, "figures", lambda t: {"calm": None, "rough": None})
    monkeypatch.setattr(experiment_design, "_path", lambda _: SimpleNamespace(p_world=np.zeros((1, 2, 3))))
    monkeypatch.setattr(flights, "fly", lambda *_: [SimpleNamespace(p_world=np.zeros((1, 3)))] * 2)
    monkeypatch.setattr(flights, "reference_tables", lambda *_: [None, None])
    monkeypatch.setattr(experiment_design, "perturbed_variants", lambda *_: None)
    monkeypatch.setattr(experiment_design.rotor_speed_model, "with_modelled_rotor_speeds", lambda *_: None)
    # A simulated flight is not checked for contradictions: its noise may look like one, which would end the diagnosis.
    monkeypatch.setattr(experiment_design, "read_recording", lambda *_, simulated: simulated or pytest.fail())
    monkeypatch.setattr(experiment_design, "ResidualModel", lambda _: None)

    def proposed(*noises) -> Manoeuvre:
        remaining = iter(noises)
        monkeypatch.setattr(
            experiment_design,
            "linearise",
            lambda *_: SimpleNamespace(**vars(line), residual=np.full((400, 1), next(remaining))),
        )
        return experiment_design.separating_manoeuvre(confounders, changes, None, None, (np.ones(1), 1.0)).manoeuvre

    assert proposed(0.1, 10.0) == Manoeuvre("calm", 10.0)
    assert proposed(10.0, 0.1) == Manoeuvre("rough", 10.0)
