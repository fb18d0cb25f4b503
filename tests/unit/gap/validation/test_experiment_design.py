"""What to fly to tell look-alikes apart: a manoeuvre counts by what no size of the one effect does like the other."""

from types import SimpleNamespace

import numpy as np
import pytest

from swift_ros.configuration import configuration_folder, load
from swift_ros.vehicle import GRAVITY, Vehicle
from swift_sim_bridge.gap.recording import recording
from swift_sim_bridge.gap.validation import experiment_design


def effect(key):
    return SimpleNamespace(key=key, parameters=(SimpleNamespace(step=1.0),))


def test_effects_are_as_far_apart_as_no_size_of_the_other_hides():
    rng = np.random.default_rng(0)
    both, alone = rng.standard_normal((2, 400, 1))
    columns = np.stack([both + 0.1 * alone, both])
    rivals, changes = [effect("mass"), effect("thrust")], {"mass": np.array([2.0]), "thrust": np.array([2.0])}
    assert experiment_design._apart(columns, rivals, changes) == pytest.approx(400 * (2.0 * 0.1) ** 2, rel=0.3)
    assert experiment_design._apart(np.stack([both, both]), rivals, changes) == pytest.approx(0.0, abs=1e-9)


def test_every_manoeuvre_can_be_flown_and_the_shortest_is_a_recording_that_the_tool_takes():
    t = np.arange(0.0, experiment_design.SECONDS, experiment_design.STEP_S)
    figures = experiment_design._figures(t)
    path = experiment_design._path(list(figures.values()))
    assert path.p_world.shape == (len(t), len(figures), 3)
    assert np.all(path.p_world[..., 2] > 0.1)
    assert np.all(path.a_world[..., 2] > -0.8 * GRAVITY)  # rotors do not pull downwards
    assert np.linalg.norm(path.a_world[20:-20] + [0.0, 0.0, GRAVITY], axis=-1).max() < 4.0 * GRAVITY
    assert min(experiment_design.DURATIONS_S) > recording.LEAST_S


def test_a_manoeuvre_that_the_vehicle_cannot_fly_is_not_advised(monkeypatch):
    def fallen(_, path):
        return [SimpleNamespace(p_world=p - [0.0, 0.0, 5.0]) for p in np.moveaxis(path.p_world, 1, 0)]

    vehicle = load(Vehicle, configuration_folder() / "drone.yaml")
    monkeypatch.setattr(experiment_design.twins, "fly", fallen)
    monkeypatch.setattr(experiment_design.twins, "tables_of", lambda traces, *_: traces)
    assert experiment_design.separating_manoeuvre([], {}, vehicle, None, (np.ones(1), 1.0)) is None


def test_a_manoeuvre_that_is_noisier_than_the_recording_counts_for_less(monkeypatch):
    """Both tell the rivals apart; the second scatters ten times as much as the flight that called for a manoeuvre."""
    line = SimpleNamespace(t=np.linspace(0.0, 12.0, 400), sensitivity=np.zeros((2, 400, 1)), good=np.ones(400, bool))
    line.sensitivity[0, ::2], line.sensitivity[1, 1::2] = 2.0, 2.0
    noises = iter([0.1, 10.0])
    rivals, changes = [effect("mass"), effect("thrust")], {"mass": np.ones(1), "thrust": np.ones(1)}
    monkeypatch.setattr(experiment_design, "_figures", lambda t: {"calm": None, "rough": None})
    monkeypatch.setattr(experiment_design, "_path", lambda _: SimpleNamespace(p_world=np.zeros((1, 2, 3))))
    monkeypatch.setattr(experiment_design.twins, "fly", lambda *_: [SimpleNamespace(p_world=np.zeros((1, 3)))] * 2)
    monkeypatch.setattr(experiment_design.twins, "tables_of", lambda *_: [None, None])
    monkeypatch.setattr(experiment_design, "variants_of", lambda *_: None)
    monkeypatch.setattr(experiment_design.spun, "completed", lambda *_: None)
    monkeypatch.setattr(experiment_design.check, "read", lambda *_: None)
    monkeypatch.setattr(
        experiment_design,
        "linearise",
        lambda *_: SimpleNamespace(**vars(line), residual=np.full((400, 1), next(noises))),
    )
    advice = experiment_design.separating_manoeuvre(rivals, changes, None, None, (np.ones(1), 1.0))
    assert advice.text == "calm for 10 s"
    noises = iter([10.0, 0.1])
    assert (
        experiment_design.separating_manoeuvre(rivals, changes, None, None, (np.ones(1), 1.0)).text == "rough for 10 s"
    )
