"""What to fly to tell look-alikes apart: a manoeuvre counts by what no size of the one effect does like the other."""

from types import SimpleNamespace

import numpy as np
import pytest

from swift_ros.configuration import configuration_folder, load
from swift_ros.vehicle import GRAVITY, Vehicle
from swift_sim_bridge.gap import check, manoeuvres


def effect(key):
    return SimpleNamespace(key=key, parameters=(SimpleNamespace(step=1.0),))


def test_effects_are_as_far_apart_as_no_size_of_the_other_hides():
    rng = np.random.default_rng(0)
    both, alone = rng.standard_normal((2, 400, 1))
    columns = np.stack([both + 0.1 * alone, both])
    rivals, changes = [effect("mass"), effect("thrust")], {"mass": np.array([2.0]), "thrust": np.array([2.0])}
    assert manoeuvres._apart(columns, rivals, changes) == pytest.approx(400 * (2.0 * 0.1) ** 2, rel=0.3)
    assert manoeuvres._apart(np.stack([both, both]), rivals, changes) == pytest.approx(0.0, abs=1e-9)


def test_every_manoeuvre_can_be_flown_and_the_shortest_is_a_recording_that_the_tool_takes():
    t = np.arange(0.0, manoeuvres.SECONDS, manoeuvres.STEP_S)
    figures = manoeuvres._figures(t)
    path = manoeuvres._path(list(figures.values()))
    assert path.p_world.shape == (len(t), len(figures), 3)
    assert np.all(path.p_world[..., 2] > 0.1)
    assert np.all(path.a_world[..., 2] > -0.8 * GRAVITY)  # rotors do not pull downwards
    assert np.linalg.norm(path.a_world[20:-20] + [0.0, 0.0, GRAVITY], axis=-1).max() < 4.0 * GRAVITY
    assert min(manoeuvres.DURATIONS_S) > check.LEAST_S


def test_a_manoeuvre_that_the_vehicle_cannot_fly_is_not_advised(monkeypatch):
    def fallen(_, path):
        return [SimpleNamespace(p_world=p - [0.0, 0.0, 5.0]) for p in np.moveaxis(path.p_world, 1, 0)]

    vehicle = load(Vehicle, configuration_folder() / "drone.yaml")
    monkeypatch.setattr(manoeuvres.twins, "fly", fallen)
    monkeypatch.setattr(manoeuvres.twins, "tables_of", lambda traces, *_: traces)
    assert manoeuvres.advice([], {}, vehicle, None, (np.ones(1), 1.0)) is None
