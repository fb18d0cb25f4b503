"""The manoeuvres that the tool proposes: the referee, who shares no code with it, flies the same figures."""

import jax
import numpy as np
import pytest

from swift_sim_bridge.gap.effects import catalogue
from swift_sim_bridge.gap.report import content as report
from swift_sim_bridge.gap.validation import experiment_design as proposals
from swift_sim_bridge.referee.simulator import flight, manoeuvres, vehicles
from swift_sim_bridge.referee.simulator.instruments import LEAD_S
from swift_sim_bridge.referee.simulator.paths import TICK_S


def test_tool_and_referee_mean_the_same_by_a_manoeuvre_s_name():
    t = np.arange(0.0, proposals.SIMULATED_S, TICK_S)
    figures = {proposals.DESCRIPTIONS[key]: figure for key, figure in proposals.figures(t).items()}
    assert set(figures) == set(manoeuvres.FIGURES)
    for name, (p, yaw, shake) in figures.items():
        path, recorded = manoeuvres.path(name, proposals.SIMULATED_S), slice(round(LEAD_S / TICK_S), None)
        np.testing.assert_allclose(path.p[recorded], p, atol=1e-9, err_msg=name)
        np.testing.assert_allclose(path.yaw[recorded], yaw, atol=1e-9, err_msg=name)
        rates = np.gradient(shake, TICK_S, axis=0)  # of small turns
        np.testing.assert_allclose(path.shake[recorded][1:-1], rates[1:-1], atol=0.1, err_msg=name)
        np.testing.assert_allclose(path.v[0], 0.0, atol=0.01, err_msg=name)


@pytest.mark.parametrize("name", manoeuvres.FIGURES)
def test_the_sentence_of_a_report_names_manoeuvre_and_seconds(name):
    effect = catalogue.gusts()
    (key,) = (key for key, text in proposals.DESCRIPTIONS.items() if text == name)
    found = proposals.SeparatingManoeuvre(proposals.Manoeuvre(key, 15.0), 7.2)
    for advice, expected in ((found, (name, 15.0)), (None, None)):
        said = {"verdict": "ambiguous", "separating_manoeuvre": report.manoeuvre(effect, {effect.key: advice})}
        assert manoeuvres.proposed({"findings": [{"verdict": "confirmed"}, said]}) == expected


@pytest.fixture(scope="module")
def flown():
    content = vehicles.draw(np.random.default_rng(5), "test")
    paths = {name: manoeuvres.path(name, 10.0) for name in manoeuvres.FIGURES}
    with jax.enable_x64(True):
        truths = flight.fly([flight.Order(content, content, path, 1, 0.02, 0.5) for path in paths.values()])
    return {name: (path, truth) for (name, path), truth in zip(paths.items(), truths, strict=True)}


@pytest.mark.parametrize("name", manoeuvres.FIGURES)
def test_the_referee_s_pilot_stays_near_the_path_and_above_the_ground(flown, name):
    path, truth = flown[name]
    ticks = slice(round(LEAD_S / TICK_S), None)
    there = truth.p[:: len(truth.p) // len(path.p)][ticks]
    away = np.linalg.norm(there - path.p[ticks], axis=1)
    assert away.max() < 2.0  # torque comes before thrust: doublets in a punch lift the vehicle
    assert there[:, 2].min() > 0.05
